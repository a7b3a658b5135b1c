"""Record sequences of random manipulations in the simulator: data/raw/."""

import shutil
from pathlib import Path

from clothkit.simulation.generation import generate
from clothkit.stage import stage

RAW = Path("data/raw")
PARTS = ("states", "manipulations.parquet", "attempts.parquet", "topologies.parquet")


def main() -> None:
    """Simulate, and publish the four raw artifacts."""
    with stage("simulate") as s:
        work = s.work(inputs=[])
        raw = work / "raw"
        shutil.rmtree(raw, ignore_errors=True)
        made_with = s.attributes
        for indifferent in ("block", "workers"):
            del made_with["params"][indifferent]
        print(generate(raw, s.params, work=work, attributes=made_with))
        for part in PARTS:
            s.publish(raw / part, RAW / part)


if __name__ == "__main__":
    main()
