"""Voxels of the viewport that is twice as high, against NumPy's histogram and by hand."""

import jax.numpy as jnp
import numpy as np

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import papers_cloths
from clothkit.dataset.tasks import Task
from clothkit.episodes.record import Sizes, Tasks, record
from clothkit.evaluation import viewport
from clothkit.evaluation.occupancy import pooled


def occupied(mesh: np.ndarray) -> np.ndarray:
    """Voxels four times finer in z: 1 / 64 high, 1 / 16 wide."""
    edges = (np.linspace(-1, 1, 33), np.linspace(-1, 1, 33), np.linspace(0, 0.25, 17))
    counts, _ = np.histogramdd(mesh.reshape(-1, 3), edges)
    return counts > 0


def test_outcomes_in_the_high_viewport() -> None:
    rng = np.random.default_rng(0)
    # Off the borders between voxels, and above the usual viewport here and there.
    meshes = [SQUARE.flat() * 0.99 + rng.uniform(0, (0.01, 0.01, 0.24), (32, 32, 3)) for _ in range(3)]
    start, goal, outcome = np.array(meshes, np.float32)
    tasks = Tasks(
        [Task(7, 1, 2), Task(8, 0, 1)],
        ["test", "train"],
        np.stack([start] * 2),
        np.zeros((2, 2)),
        np.stack([goal] * 2),
        papers_cloths(2),
    )
    sessions = record(tasks, [], Sizes((32, 32, 3), True, 1, 2, 1))
    sessions.state[0, 2], sessions.state[1, 1] = outcome, goal
    found = viewport.rows(sessions, "b1")
    assert found[["split", "system", "sequence", "start", "length"]].to_numpy().tolist() == [
        ["test", "b1", 7, 1, 2],
        ["train", "b1", 8, 0, 1],
    ]
    np.testing.assert_allclose(found["voxel_error_025"], [(occupied(outcome) != occupied(goal)).mean(), 0], rtol=1e-5)
    none = (occupied(start) != occupied(goal)).mean()
    np.testing.assert_allclose(found["voxel_error_025_no_action"], [none, none], rtol=1e-5)


def test_pooled_columns_by_hand() -> None:
    column = np.array([1, 0.9, 0.6, 0.6, 0.3, 0.5, *np.zeros(10)])
    found = np.asarray(pooled(jnp.broadcast_to(column, (2, 1, 1, 16))))
    assert found.shape == (2, 1, 1, 16)
    np.testing.assert_allclose(found[1, 0, 0], [1, 0.6, 0.5, *np.zeros(13)], rtol=1e-6)
