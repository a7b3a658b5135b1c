"""The evaluations on tiny nets and made-up sequences: rows, labels, and that a perfect net has no error."""

from pathlib import Path

import jax
import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import Dataset, papers_cloths
from clothkit.dataset.tasks import TASKS
from clothkit.estimation.estimate import Alternatives
from clothkit.estimation.refine import RefineConfig
from clothkit.evaluation import arrays, estimation, prediction
from clothkit.evaluation.occupancy import TALL, occluded_occupancy, occupancy
from clothkit.evaluation.settings import EvaluateEstimationConfig, EvaluatePredictionConfig
from clothkit.models import pemd, vtm
from clothkit.models.ensemble import Ensemble
from clothkit.models.hypotheses import Hypotheses
from clothkit.models.net import Net
from clothkit.models.settings import PEMDConfig, VtMConfig
from clothkit.runtime.errors import InputError
from tests.models.predicted import predicted_by

SEQUENCES = 5


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Four evaluated sequences, the last of them, 3, with two manipulations only."""
    rng = np.random.default_rng(0)
    shape = (SEQUENCES, 4, 32, 32, 3)
    vertices = np.broadcast_to(SQUARE.flat(), shape) * np.array([0.9, 0.7, 1]) + 0.01 * rng.normal(size=shape)
    centre, manipulation = rng.normal(size=(SEQUENCES, 4, 2)), rng.uniform(-1, 1, (SEQUENCES, 3, 6))
    vertices[3, 3] = centre[3, 3] = manipulation[3, 2] = np.nan
    return Dataset(
        vertices.astype(np.float32),
        centre.astype(np.float32),
        manipulation.astype(np.float32),
        np.full((SEQUENCES, 3), 2, np.int8),
        np.array([3, 3, 3, 2, 3], np.int8),
        np.array([0, 2, 2, 2, 1], np.int8),
        np.array([True, True, True, True, False]),
        *papers_cloths(SEQUENCES),
    )


@pytest.fixture(scope="module")
def forward() -> Ensemble:
    config = PEMDConfig(latent=4, encoder=(8,), manipulation=6, decoder=(8,))
    return Ensemble((0, 1), tuple(Net(config, pemd.initial(config, key=jax.random.key(k))) for k in range(2)), best=1)


@pytest.fixture(scope="module")
def estimates(dataset: Dataset) -> estimation.Estimates:
    config = VtMConfig(hidden=4)
    settings = EvaluateEstimationConfig(batch=5)
    net = Net(config, vtm.initial(config, key=jax.random.key(0)))
    return estimation.estimates(dataset, net, settings, RefineConfig(iterations=3))


def test_estimates_are_of_the_states_of_evaluated_sequences(dataset: Dataset, estimates: estimation.Estimates) -> None:
    assert estimates.sequence.tolist() == [0, 1, 2, 3]
    assert estimates.mesh.shape == (4, 4, 32, 32, 3)
    missing = np.isnan(estimates.mesh).any((2, 3, 4))
    assert np.argwhere(missing).tolist() == [[3, 3]]
    np.testing.assert_array_equal(estimates.label < 0, missing)
    tidy = estimation.rows(dataset, estimates)
    assert len(tidy) == (3 * 3 + 2) * 2
    assert not tidy.isna().any().any()
    assert tidy.groupby("split")["sequence"].unique().map(list).to_dict() == {"test": [1, 2, 3], "train": [0]}
    assert sorted(tidy["state"].unique()) == [1, 2, 3]
    assert (tidy["error"] <= tidy["error_labelled"] + 1e-6).all()


def test_estimation_rows_of_known_estimates(dataset: Dataset, estimates: estimation.Estimates) -> None:
    offset = np.array([0, 0.014, 0], np.float32)
    truth = dataset.vertices[estimates.sequence]
    known = estimates._replace(
        mean=np.asarray(relabel(truth, 3)), std=np.ones_like(truth), mesh=np.asarray(relabel(truth + offset, 3))
    )
    tidy = estimation.rows(dataset, known)
    by_kind = tidy.groupby("kind")["error"].max()
    assert by_kind["pmr"] == pytest.approx(0, abs=1e-6)
    assert by_kind["dmr"] == pytest.approx(0.01, abs=1e-6)
    assert (tidy["error_labelled"] > 0.1).all()


def test_the_best_of_several_hypotheses_is_told(dataset: Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = dataset.vertices[[1, 1, 1], [1, 2, 3]]
    offsets = np.array([[0.14, 0.014, 0.0], [0.014, 0.028, 0.28], [0.28, 0.14, 0.014]], np.float32)
    mean = truth[:, None] + offsets[..., None, None, None] * np.float32([0, 1, 0])
    # Of the first cloth all differ, but the right one can't be; of the second, the right one is the chosen one; of the
    # third the last one is the best.
    probability = np.array([[0.6, 0.39, 0.01], [0.5, 0.3, 0.2], [0.4, 0.3, 0.3]], np.float32)
    found = Alternatives(Hypotheses(ProbabilisticMesh(mean, np.ones_like(mean)), probability), mean + np.float32(0))
    hypotheses, chosen, best_mean, best_mesh = estimation._compared(found, truth, dataset.cloth[[1, 1, 1]])
    assert hypotheses.tolist() == [2, 2, 3]
    np.testing.assert_array_equal(chosen, probability[:, 0])
    np.testing.assert_allclose(best_mean, [0.01, 0.01, 0.01], atol=1e-6)
    np.testing.assert_allclose(best_mesh, best_mean, atol=1e-6)


def test_prediction_rows(dataset: Dataset, forward: Ensemble, estimates: estimation.Estimates) -> None:
    given = prediction.starts(dataset, estimates._asdict())
    tidy = prediction.rows(dataset, given, forward, EvaluatePredictionConfig(batch=2))
    # Three sequences have six tasks, the short one three.
    occluded = tidy["system"] == prediction.OCCLUDED
    tidy, seen = tidy[~occluded], tidy[occluded]
    assert len(tidy) == 2 * 2 * (3 * 6 + 3)
    assert not tidy.isna().any().any()
    # What a camera sees of main's best net, against what it sees of the truth.
    of_main = tidy.query("system == 'main' and net == '1' and sequence == 2 and start == 1 and length == 2").iloc[0]
    row = seen.query("sequence == 2 and start == 1 and length == 2").iloc[0]
    assert len(seen) == 3 * 6 + 3
    assert row["error_no_action"] == of_main["error_no_action"]
    assert row["position_error"] == of_main["position_error"]
    views = [np.asarray(voxels.observe(dataset.vertices[2, i])) for i in (1, 3)]
    assert row["voxel_error_no_action"] == pytest.approx(np.mean(views[0] != views[1]), rel=1e-4)
    made, _ = predicted_by(
        forward.nets[1], given.meshes["main"][given.sequence == 2, 1], dataset.manipulation[2:3, 1:3]
    )
    expected = occluded_occupancy(
        ProbabilisticMesh(*(np.asarray(part)[1] for part in made)), draws=256, key=jax.random.key(9)
    )
    assert row["voxel_error"] == pytest.approx(np.abs(np.asarray(expected)[0] - views[1]).mean(), rel=0.05)
    tall = [np.asarray(voxels.observe(dataset.vertices[2, i], viewport=TALL)) for i in (1, 3)]
    assert row["voxel_error_025_no_action"] == pytest.approx(np.mean(tall[0] != tall[1]), rel=1e-4)
    expected = occluded_occupancy(
        ProbabilisticMesh(*(np.asarray(part)[1] for part in made)), draws=32, viewport=TALL, key=jax.random.key(9)
    )
    assert row["voxel_error_025"] == pytest.approx(np.abs(np.asarray(expected)[0] - tall[1]).mean(), rel=0.05)
    assert (tidy.loc[tidy["sequence"] == 3, ["start", "length"]].sum(axis=1) <= 2).all()
    assert set(tidy.loc[tidy["better"], "net"]) == {"1"}
    assert set(zip(tidy["start"], tidy["length"], strict=True)) == set(TASKS)
    # One of them by hand: NumPy's centre shift and error of net 0, from the true mesh.
    mean, found = predicted_by(forward.nets[0], dataset.vertices[2:3, 1], dataset.manipulation[2:3, 1:3])
    row = tidy.query("system == 'a1' and net == '0' and sequence == 2 and start == 1 and length == 2").iloc[0]
    moved = dataset.centre[2, 3] - dataset.centre[2, 1]
    assert row["position_error"] == pytest.approx(
        np.linalg.norm(np.asarray(found.shifts).sum(0)[0] - moved) / 1.4, rel=1e-4
    )
    assert row["position_no_action"] == pytest.approx(np.hypot(*moved) / 1.4, rel=1e-5)
    candidates = [np.asarray(relabel(dataset.vertices[2, 3], k)) for k in range(8)]
    by_hand = min(np.linalg.norm(np.asarray(mean.mean)[1, 0] - c, axis=-1).mean() / 1.4 for c in candidates)
    assert row["error"] == pytest.approx(by_hand, rel=1e-4)
    truth = np.asarray(voxels.of_mesh(dataset.vertices[2, 3]))
    last = ProbabilisticMesh(*(np.asarray(part)[1] for part in mean))
    expected = np.abs(np.asarray(occupancy(last))[0] - truth).mean()
    assert row["voxel_error"] == pytest.approx(expected, rel=1e-4)
    start = np.asarray(voxels.of_mesh(dataset.vertices[2, 1]))
    assert row["voxel_error_no_action"] == pytest.approx(np.mean(start != truth), rel=1e-4)
    truth, start = (np.asarray(voxels.of_mesh(dataset.vertices[2, i], viewport=TALL)) for i in (3, 1))
    expected = np.abs(np.asarray(occupancy(last, viewport=TALL))[0] - truth).mean()
    assert row["voxel_error_025"] == pytest.approx(expected, rel=1e-4)
    assert row["voxel_error_025_no_action"] == pytest.approx(np.mean(start != truth), rel=1e-4)


def test_starts_carry_the_labels_of_the_truth(dataset: Dataset, estimates: estimation.Estimates) -> None:
    turned = np.asarray(relabel(dataset.vertices[estimates.sequence], 1))
    given = prediction.starts(
        dataset, {"sequence": estimates.sequence, "mesh": turned, "label": np.full((4, 4), 1, np.int32)}
    )
    np.testing.assert_array_equal(given.meshes["main"], given.meshes["a1"])


def test_a_state_without_an_estimate_is_told(dataset: Dataset, estimates: estimation.Estimates) -> None:
    label = estimates.label.copy()
    label[1, 2] = -1
    with pytest.raises(InputError, match="expected one of state 2 of sequence 1, found none"):
        prediction.starts(dataset, estimates._replace(label=label)._asdict())


def test_stored_predictions_come_back(
    dataset: Dataset, forward: Ensemble, estimates: estimation.Estimates, tmp_path: Path
) -> None:
    given = prediction.starts(dataset, estimates._asdict())
    stored = prediction.stored(dataset, given, forward.nets[0], EvaluatePredictionConfig(stored=1))
    contents = []
    for name in ("one.zarr", "two.zarr"):
        arrays.save(tmp_path / name, stored, arrays.PREDICTIONS, {"scale": "smoke"})
        files = sorted(path for path in (tmp_path / name).rglob("*") if path.is_file())
        contents.append([(path.relative_to(tmp_path / name), path.read_bytes()) for path in files])
    assert contents[0] == contents[1]
    found = arrays.load(tmp_path / "one.zarr", arrays.PREDICTIONS, ("sequence", "mean", "shift"))
    assert found["sequence"].tolist() == [0, 1]
    assert found["mean"].shape == (2, 3, 32, 32, 3)
    np.testing.assert_array_equal(found["shift"], stored["shift"])
    with pytest.raises(InputError, match="has no array label"):
        arrays.load(tmp_path / "one.zarr", arrays.ESTIMATES, ("label",))
    with pytest.raises(InputError, match=r"three\.zarr"):
        arrays.load(tmp_path / "three.zarr", arrays.PREDICTIONS)


def test_what_lies_past_a_sequences_end_may_be_missing(
    dataset: Dataset, forward: Ensemble, estimates: estimation.Estimates, tmp_path: Path
) -> None:
    given = prediction.starts(dataset, estimates._asdict())
    stored = prediction.stored(dataset, given, forward.nets[0], EvaluatePredictionConfig(stored=3))
    assert np.argwhere(np.isnan(stored["mean"]).all((2, 3, 4))).tolist() == [[3, 2]]
    arrays.save(tmp_path / "whole.zarr", stored, arrays.PREDICTIONS, {})
    found = arrays.load(tmp_path / "whole.zarr", arrays.PREDICTIONS)
    np.testing.assert_array_equal(np.isnan(found["shift"]).any(-1), np.isnan(found["mean"]).any((2, 3, 4)))
    for place in ((3, 1), (3, 0), (0, 0, 5, 6, 1)):
        mean = stored["mean"].copy()
        mean[place] = np.nan
        if place == (3, 1):
            mean[3, 2] = 0
        arrays.save(tmp_path / "holes.zarr", {"mean": mean}, arrays.PREDICTIONS, {})
        with pytest.raises(InputError, match="array mean: expected finite values"):
            arrays.load(tmp_path / "holes.zarr", arrays.PREDICTIONS, ("mean",))
