"""Records sequences of random manipulations in the simulator, or imports ARCSim runs, as data/raw/."""

import shutil
from pathlib import Path

from clothkit.runtime.stage import stage
from clothkit.simulation.arcsim import import_runs
from clothkit.simulation.arcsim_runs import files, read_runs
from clothkit.simulation.generation import generate

RAW = Path("data/raw")
PARTS = ("states", "manipulations.parquet", "attempts.parquet", "topologies.parquet", "cloths.parquet")


def main() -> None:
    """Simulate or import, and publish the five raw artifacts."""
    with stage("simulate") as s:
        sequences = read_runs(s.params.runs, s.params.sequences) if s.params.source == "arcsim" else []
        work = s.work(inputs=files(sequences))
        raw = work / "raw"
        shutil.rmtree(raw, ignore_errors=True)
        if sequences:
            print(import_runs(raw, sequences, work=work, attributes=s.attributes))
        else:
            print(generate(raw, s.params, work=work, attributes=s.attributes))
        for part in PARTS:
            s.publish(raw / part, RAW / part)


if __name__ == "__main__":
    main()
