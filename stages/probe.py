"""Executes probes of the forward models, and learns what tells their errors: `python stages/probe.py`."""

from functools import partial
from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation.probes import execute_probes, fitted_to, predicted, table
from clothkit.models import support_model
from clothkit.models.ensemble import folders, load
from clothkit.planning import expected_error, normalisation
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, execute

DATA = Path("data")
MESHES, SUPPORT, REFERENCE = DATA / "meshes.zarr", DATA / "nets/support.npz", DATA / "normalisation/mesh.json"


def main() -> None:
    """Write data/evaluation/probe.parquet and data/normalisation/expected_error.json."""
    with stage("probe") as s:
        members, simulate = s.shared.ensemble.members, s.shared.stages.simulate
        nets = folders(DATA / "nets", "pemd", members).values()
        work = s.work(inputs=[MESHES, SUPPORT, REFERENCE, *nets])
        dataset, ensemble = store.load(MESHES), load(DATA / "nets", "pemd", members)
        width = support_model.width_of(ensemble.model, ensemble.best_net.params, dataset.vertices[0, 0])
        support = support_model.load(SUPPORT, width=width)
        simulator = partial(execute, settings=simulate.simulation, workers=simulate.workers)
        probes = execute_probes(dataset, s.params, simulate.candidates, simulator, work=work / "pieces")
        end_workers()
        reference = normalisation.load(REFERENCE)
        spread = reference.reference(reference.longest).spread
        rows = table(probes, predicted(ensemble, support, probes, dataset.cloth[probes.sequence]), spread)
        write_rows(work / "probe.parquet", rows, s.attributes)
        expected_error.save(work / "expected_error.json", fitted_to(rows), s.attributes)
        s.publish(work / "probe.parquet", DATA / "evaluation/probe.parquet")
        s.publish(work / "expected_error.json", DATA / "normalisation/expected_error.json")


if __name__ == "__main__":
    main()
