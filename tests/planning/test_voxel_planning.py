"""Planning in voxels: its losses by hand, and a session from voxels to a simulated outcome."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pydantic
import pytest

from clothkit.cloth import voxels
from clothkit.dataset.tasks import Task
from clothkit.episodes.sessions import run_sessions
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models.emd_voxel import EMDVoxelConfig, initial
from clothkit.models.forward import forward_model
from clothkit.planning.normalisation import normalise
from clothkit.planning.objective import Likelihood, Range, Weights
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.perception import ObservedVoxels
from clothkit.planning.planner import Planner
from clothkit.planning.search import SearchConfig
from clothkit.planning.settings import NormaliseConfig, PlanConfig
from clothkit.planning.systems import system
from clothkit.planning.voxel_representation import VOXEL, VoxelRepresentation
from clothkit.runtime.clock import clock
from tests.episodes.test_sessions import MANIPULATIONS, dataset, tasks
from tests.planning import toy

RANDOM = np.random.default_rng(0)


CONFIG = EMDVoxelConfig(latent=8, manipulation=8, width=0.05)
MODEL = forward_model(CONFIG)


def nets() -> tuple[Any, Any]:
    a, b = (initial(CONFIG, key=jax.random.key(seed)) for seed in (0, 1))
    return a, b


def test_losses_by_hand() -> None:
    logits = RANDOM.normal(size=(3, 4, 4, 2)).astype(np.float32)
    goals = (RANDOM.uniform(size=(2, 4, 4, 2)) > 0.5).astype(np.float32)
    p = 1 / (1 + np.exp(-logits.astype(np.float64)))
    expected = -np.stack([(g * np.log(p) + (1 - g) * np.log(1 - p)).mean((1, 2, 3)) for g in goals], axis=-1)
    logits, goals = jnp.asarray(logits), jnp.asarray(goals)
    np.testing.assert_allclose(VOXEL.accuracy_of_each(goals, logits), expected, rtol=1e-5)
    term = Likelihood((Range(np.float32([0.2]), np.float32([0.7])),)).in_range(VOXEL.accuracy(goals[1], logits), 0)
    np.testing.assert_allclose(term, (expected[:, 1] - 0.2) / 0.5, rtol=1e-4)
    np.testing.assert_allclose(VOXEL.difference(logits, -logits), ((2 * p - 1) ** 2).mean((1, 2, 3)), rtol=1e-5)


def test_recorded_manipulations_are_cartesian() -> None:
    data = dataset(1)
    recorded = VOXEL.recorded(data.vertices[:, :2], data.manipulation[:, :1])
    corner = data.vertices[0, 0, 0, 0, :2]
    np.testing.assert_allclose(recorded.plan[0, 0], [*corner, *corner, *MANIPULATIONS[0, 4:]], atol=1e-5)
    np.testing.assert_array_equal(recorded.start[0], voxels.observe(data.vertices[0, 0]))


@pytest.mark.parametrize("name", ["b4", "b5"])
def test_a_session_in_voxels(name: str) -> None:
    chosen = system(name)
    both, count = nets(), 1 if chosen.single else 2
    data = dataset()
    data.length[:] = 2
    reference = normalise(MODEL, VOXEL, both, data, NormaliseConfig(draws=1))
    search = SearchConfig(optimiser=GradientConfig(strains=8, base_iterations=4, iterations_per_step=2))
    settings = PlanConfig(test=2, train=0, search=SearchConfig(), voxel_search=search, together=1).of(chosen)
    planner = Planner(
        chosen,
        representation=VOXEL,
        model=MODEL,
        members=(0, 1)[:count],
        nets=both[:count],
        best=0,
        perception=ObservedVoxels(),
        normalisation=reference,
        weights=Weights(1.0, 5.0, 1.25),
        settings=settings,
        grasping=CandidateConfig(),
        labelled=True,
    )
    grasped = []

    def execute(meshes: np.ndarray, grasps: np.ndarray, *rest: np.ndarray) -> np.ndarray:
        grasped.append((meshes, grasps))
        return toy.execute(meshes, grasps, *rest)

    # Untrained nets hold everything for useless: the check is out of the way.
    def hopeful(self: VoxelRepresentation, states: np.ndarray, goals: np.ndarray) -> np.ndarray:
        return np.full(len(states), float(states.dtype == bool or bool(np.isin(states, (0, 1)).all())))

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(VoxelRepresentation, "distance", hopeful)
        given = tasks(Task(0, 0, 1), Task(1, 1, 2))
        with clock() as times:
            sessions = diagnosed(run_sessions(given, planner, execute), given, planner)
    assert sessions.estimate.shape[2:] == voxels.RESOLUTION
    np.testing.assert_array_equal(sessions.estimate[0, 0], voxels.observe(sessions.state[0, 0]))
    assert sessions.prediction_std.size == sessions.refined.size == 0
    predicted = sessions.prediction_mean[1, 0, :2, :count]
    assert ((predicted >= 0) & (predicted <= 1)).all()
    # Grasp points are relative to the centre, and candidates.
    for task in range(2):
        offers = sessions.candidates[task, 0]
        for grasp in sessions.plan[task, 0, 0, :4].reshape(2, 2):
            assert np.nanmin(np.abs(offers - grasp).sum(-1)) < 1e-6
    moved = np.flatnonzero(~sessions.null[:, 0])
    assert len(moved)
    wanted = sessions.plan[moved, 0, 0, :4].reshape(-1, 2, 2) + sessions.centre[moved, 0][:, None]
    np.testing.assert_allclose(grasped[0][1], wanted, atol=1e-6)
    tidy = rows(sessions, name)
    assert np.isfinite(tidy[["error", "voxel_error", "loss", "loss_recorded"]]).all(axis=None)
    assert tidy[["expected", "estimate_error"]].isna().all(axis=None)
    assert tidy.grasp_offered.all()
    assert sum(count for count, _ in times["2"]) == 1
    assert dataclasses.asdict(settings)["batch"] == 1


def test_settings_for_voxels_are_those_of_voxel_systems_alone() -> None:
    settings = PlanConfig(voxel_search=SearchConfig(optimiser=GradientConfig(strains=8)), voxel_batch=2)
    assert settings.of(system("main")) is settings
    assert (settings.of(system("b4")).search.optimiser.strains, settings.of(system("b4")).batch) == (8, 2)


@pytest.mark.parametrize("setting", [{"edge": 0.5}, {"stride": 4}])
def test_settings_that_concern_meshes_alone_are_refused_for_voxels(setting: dict[str, Any]) -> None:
    assert PlanConfig(search=SearchConfig(**setting)).of(system("b4")).search == SearchConfig()
    with pytest.raises(pydantic.ValidationError, match="voxel_search: expected edge 0 and stride 1"):
        PlanConfig(voxel_search=SearchConfig(**setting))
