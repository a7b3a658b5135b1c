"""Executes probes of the forward models, and learns what tells their errors: `python stages/probe.py`."""

from pathlib import Path

from clothkit.dataset import store
from clothkit.dataset.rows import write_rows
from clothkit.evaluation.probes import execute_probes, fitted_to, predicted, table
from clothkit.models import support_model
from clothkit.models.ensemble import folders, load
from clothkit.planning import error_map, normalisation
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT
from clothkit.runtime.stage import stage
from clothkit.simulation.executor import end_workers, make_simulator

DATA = Path("data")
MESHES, REFERENCE = DATA / "meshes.zarr", DATA / "normalisation/mesh.json"


def main() -> None:
    """Write data/evaluation/probe.parquet and data/normalisation/expected_error.json."""
    with stage("probe") as s:
        members, simulate = s.shared.ensemble.members, s.shared.stages.simulate
        nets = folders(DATA / "nets", "pemd", members).values()
        work = s.work(inputs=[MESHES, DATA / SUPPORT, REFERENCE, *nets])
        dataset, ensemble = store.load(MESHES), load(DATA / "nets", "pemd", members)
        width = support_model.width_of(ensemble.model, ensemble.best_net.params, dataset.vertices[0, 0])
        support = support_model.load(DATA / SUPPORT, width=width)
        pieces = s.pieces(work, simulate.decisive)
        probes = execute_probes(dataset, s.params, simulate.candidates, make_simulator(simulate), work=pieces)
        end_workers()
        reference = normalisation.load(REFERENCE)
        spread = reference.reference(reference.longest).spread
        cloth, seed = dataset.cloth[probes.sequence], s.params.seed
        rows = table(probes, predicted(ensemble, support, probes, cloth, simulate.candidates, seed=seed), spread)
        write_rows(work / "probe.parquet", rows, s.attributes)
        error_map.save(work / "expected_error.json", fitted_to(rows), s.attributes)
        s.publish(work / "probe.parquet", DATA / "evaluation/probe.parquet")
        s.publish(work / "expected_error.json", DATA / EXPECTED_ERROR)


if __name__ == "__main__":
    main()
