"""Rows of the voxel baseline on a tiny net and made-up sequences."""

import jax
import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.dataset.store import Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.evaluation import voxel_prediction
from clothkit.evaluation.occupancy import TALL
from clothkit.evaluation.settings import EvaluatePredictionConfig
from clothkit.models import emd_voxel
from clothkit.models.ensemble import Ensemble
from clothkit.models.net import Net
from clothkit.models.settings import EMDVoxelConfig
from tests.crumpled import crumpled
from tests.models.predicted import predicted_by

CONFIG = EMDVoxelConfig(latent=4, manipulation=6, dense=True, encoder=(6,), decoder=(6,))


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Three sequences, the last of them, 2, with two manipulations only."""
    made = crumpled(3, 0)
    made.length[2] = 2
    made.vertices[2, 3] = made.centre[2, 3] = made.manipulation[2, 2] = np.nan
    made.split[:] = [0, 2, 2]
    return made


def test_rows_of_the_voxel_baseline(dataset: Dataset) -> None:
    nets = tuple(Net(CONFIG, emd_voxel.initial(CONFIG, key=jax.random.key(k))) for k in range(3))
    tidy = voxel_prediction.rows(
        dataset, np.arange(3), Ensemble((0, 1, 5), nets, best=2), EvaluatePredictionConfig(batch=2)
    )
    assert len(tidy) == 3 * (2 * 6 + 3)
    assert set(tidy["system"]) == {"a2"}
    assert set(tidy.loc[tidy["better"], "net"]) == {"5"}
    assert set(zip(tidy["start"], tidy["length"], strict=True)) == set(TASKS)
    # Voxels have no vertices: no mesh error and no sigma.
    assert tidy[["error", "sigma_ratio"]].isna().all().all()
    assert not tidy.drop(columns=["error", "sigma_ratio"]).isna().any().any()
    # One of them by hand, net 0, from true, noise-free, occluded voxels.
    truth = np.asarray(voxels.observe(dataset.vertices[1, 3]))
    seen = voxels.observe(dataset.vertices[1, 1])
    manipulations = emd_voxel.cartesian(dataset.vertices[1, 1:3], dataset.manipulation[1, 1:3])
    logits, found = jax.jit(predicted_by)(nets[0], seen, manipulations)
    predicted = jax.nn.sigmoid(logits)
    row = tidy.query("net == '0' and sequence == 1 and start == 1 and length == 2").iloc[0]
    assert row["voxel_error"] == pytest.approx(np.abs(np.asarray(predicted[-1]) - truth).mean(), rel=1e-4)
    assert row["voxel_error_no_action"] == pytest.approx(np.mean(np.asarray(seen) != truth), rel=1e-4)
    # In the viewport that is twice as high two voxels are one, the larger of them; above there is nothing.
    tall = np.zeros((32, 32, 16))
    for z in range(8):
        tall[..., z] = np.asarray(predicted[-1])[..., 2 * z : 2 * z + 2].max(-1)
    views = [np.asarray(voxels.observe(dataset.vertices[1, state], viewport=TALL)) for state in (1, 3)]
    assert row["voxel_error_025"] == pytest.approx(np.abs(tall - views[1]).mean(), rel=1e-4)
    assert row["voxel_error_025_no_action"] == pytest.approx(np.mean(views[0] != views[1]), rel=1e-4)
    moved = dataset.centre[1, 3] - dataset.centre[1, 1]
    assert row["position_error"] == pytest.approx(
        np.linalg.norm(np.asarray(found.shifts).sum(0) - moved) / 1.4, rel=1e-4
    )
