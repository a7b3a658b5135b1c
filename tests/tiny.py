"""Small artifacts of the real formats, for tests that only read them: nets that have learned nothing, cloths in files,
a dozen sequences that nobody simulated."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
from ruamel.yaml import YAML

from clothkit.app.output import write_mesh
from clothkit.cloth import voxels
from clothkit.cloth.topology import PAPERS_CLOTH, SQUARE
from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.dataset import store as meshes
from clothkit.dataset.augment import augment
from clothkit.dataset.regularise import regularise
from clothkit.dataset.rows import write_rows
from clothkit.dataset.tasks import tasks_of
from clothkit.episodes import record
from clothkit.episodes.record import Sessions, Sizes, tasks_of_dataset
from clothkit.estimation import alarms
from clothkit.estimation.agreement import AgreementConfig
from clothkit.estimation.alarms import Alarms
from clothkit.estimation.support import fit
from clothkit.evaluation import arrays, estimation, prediction
from clothkit.evaluation.session_rows import rows
from clothkit.models import emd_voxel, ensemble, pemd, store, support_model, vtm
from clothkit.models.net import Net
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, SupportModelConfig, VtMConfig
from clothkit.observation.camera import back_project
from clothkit.params import Params, load_params
from clothkit.planning import error_map, model_error, normalisation, trust
from clothkit.planning.error_map import ErrorMap
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT
from clothkit.simulation.attempts import Attempts
from clothkit.simulation.material import Material
from clothkit.simulation.records import write_raw
from clothkit.simulation.settings import DRAWN
from tests.observation.scenes import SCALE, SMALL, folded, image_of
from tests.planning import toy

ROOT = Path(__file__).parents[1]
MEMBERS = (0, 1)
AT = (0.05, -0.03)
"""Where the cloth lies on the table [m]."""


def write_params(path: Path) -> None:
    """params.yaml at the smallest scale, with searches in voxels that take no time."""
    params = YAML(typ="safe").load(ROOT / "params.yaml")
    params["scale"] = "smoke"
    small = {"strains": 8, "base_iterations": 2, "iterations_per_step": 0}
    params["scales"]["smoke"]["plan"]["voxel_search"] = {"optimiser": small}
    path.write_text(json.dumps(params))


def write_nets(folder: Path, members: Sequence[int] = MEMBERS, *, viewport: Viewport = VIEWPORT) -> None:
    """Nets of an ensemble's members, of which the one of the lowest number is the best, and reference values.

    `viewport` is that of the net that estimates meshes.
    """
    history = pd.DataFrame({"iteration": [1], "score": [0.1]})
    small = PEMDConfig(latent=8, encoder=(16,), manipulation=8, decoder=(16,))
    coarse = EMDVoxelConfig(latent=8, manipulation=8, width=0.05)
    seer = VtMConfig(hidden=16, viewport=viewport)
    # One program each: op by op takes much longer.
    of_meshes = jax.jit(lambda key: pemd.initial(small, key=key))
    of_voxels = jax.jit(lambda key: emd_voxel.initial(coarse, key=key))
    sees = jax.jit(lambda key: vtm.initial(seer, key=key))
    for member in members:
        key, score = jax.random.key(member), {"validation_score": 0.1 + 0.01 * member}
        store.save(ensemble.folder(folder / "nets", "pemd", member), Net(small, of_meshes(key)), history, score)
        store.save(ensemble.folder(folder / "nets", "emd_voxel", member), Net(coarse, of_voxels(key)), history, score)
    store.save(folder / "nets/vtm", Net(seer, sees(jax.random.key(2))), history, {})
    (folder / "normalisation").mkdir()
    for kind in ("mesh", "voxel"):
        normalisation.save(folder / f"normalisation/{kind}.json", toy.normalisation(len(members)), {})
    slope, scatter = np.array([0.9, 0.0, 0.3]), (np.ones(1), np.linspace(0.5, 2, 21)[None])
    found = ErrorMap(model_error.SIGNS, np.array(model_error.LEAST), np.zeros(3), slope, *scatter)
    error_map.save(folder / EXPECTED_ERROR, found, {})
    # A map that needs nothing of a planner's measure of uncertainty.
    told, slope = trust.names_of("paper"), np.array([0.9, 0.3])
    trusted = ErrorMap(told, np.array(trust.least_of(told)), np.zeros(3), slope, *scatter)
    error_map.save(folder / trust.PLACE, trusted, {})
    shown = np.random.default_rng(0).normal(size=(8, small.latent + 6)).astype(np.float32)
    support = support_model.initial(SupportModelConfig(hidden=(4,)), shown, jax.random.key(3))
    support_model.save(folder / SUPPORT, support)


def alarms_of(*, strangest: float) -> Alarms:
    """Alarms of the nets of `write_nets`, for squares of 2 mm."""
    support = fit(np.random.default_rng(0).normal(size=(40, 16)))
    return Alarms(AgreementConfig(), strangest, support, np.stack([PAPERS_CLOTH, PAPERS_CLOTH]))


def write_files(folder: Path) -> None:
    """A cloth as mesh, voxels and cloud, goals, and what tells the cloth from the table."""
    bent = folded(angle=0.3)
    write_mesh(folder / "start.obj", SQUARE.flat().astype(float) * SCALE + [*AT, 0])
    write_mesh(folder / "bent.obj", bent.astype(float) * SCALE + [*AT, 0])
    write_mesh(folder / "goal.glb", folded(along=0.0).astype(float) * SCALE)
    np.save(folder / "voxels.npy", np.asarray(voxels.observe(bent)))
    cloud = back_project(image_of(bent, SMALL, at=AT))
    assert cloud.cloth is not None
    np.savez(folder / "cloud.npz", points=cloud.points, cloth=cloud.cloth)
    np.savez(folder / "cloth_alone.npz", points=cloud.points[cloud.cloth])
    np.save(folder / "points.npy", cloud.points)
    np.save(folder / "mask.npy", cloud.cloth)
    other = np.random.default_rng(0).permutation(1024)
    faces = np.argsort(other)[SQUARE.triangles()]
    rows = (SQUARE.flat().astype(float) * SCALE).reshape(-1, 3)[other]
    text = [f"v {x} {y} {z}" for x, y, z in rows.tolist()]
    text += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (folder / "surface.obj").write_text("\n".join(text) + "\n")


def write_data(folder: Path, params: Path) -> None:
    """Everything that stages leave under data/, as far as it is told of: nets included."""
    given = load_params(params)
    write_nets(folder)
    alarms.save(folder / "nets/alarms.npz", alarms_of(strangest=10.0))
    tried = attempts()
    write_raw(folder / "raw", tried, [tried.states[tried.accepted]], seed=0, attributes=_about(given, "simulate"))
    dataset = regularise(folder / "raw", given.stages.regularise)
    meshes.save(folder / "meshes.zarr", dataset, _about(given, "regularise"))
    training = augment(dataset.of_split("train"), given.stages.augment)
    meshes.save(folder / "augmented.zarr", training, _about(given, "augment"))
    evaluations = folder / "evaluation"
    (evaluations / "planning").mkdir(parents=True)
    found = estimation.estimates(
        dataset, store.load(folder / "nets/vtm"), given.stages.evaluate_estimation, given.stages.plan.refine
    )
    about = _about(given, "evaluate_estimation")
    arrays.save(evaluations / "estimates.zarr", found._asdict(), arrays.ESTIMATES, about)
    write_rows(evaluations / "estimation.parquet", estimation.rows(dataset, found), about)
    stored = arrays.load(evaluations / "estimates.zarr", arrays.ESTIMATES)
    nets = ensemble.load(folder / "nets", "pemd", MEMBERS)
    starts, settings = prediction.starts(dataset, stored), given.stages.evaluate_prediction
    about = _about(given, "evaluate_prediction")
    write_rows(evaluations / "prediction.parquet", prediction.rows(dataset, starts, nets, settings), about)
    kept = prediction.stored(dataset, starts, nets.nets[0], settings)
    arrays.save(evaluations / "predictions.zarr", kept, arrays.PREDICTIONS, about)
    for system in ("main", "b1"):
        done = sessions(dataset)
        record.save(evaluations / f"planning/sessions_{system}.zarr", [done], _about(given, "plan"))
        write_rows(evaluations / f"planning/{system}.parquet", rows(done, system), _about(given, "plan"))


def _about(params: Params, stage: str) -> dict[str, Any]:
    return {"stage": stage, "scale": params.scale, "params": params.section(stage)}


def attempts(accepted: int = 10) -> Attempts:
    """Tried sequences, of which the last was rejected: the flat cloth, with a strip of it folded over and over."""
    count = accepted + 1
    states = np.zeros((count, 4, 32, 32, 3), np.float32)
    for k in range(count):
        shapes = [SQUARE.flat(), *(folded(along=0.5 - 0.2 * i, angle=0.1 * k) for i in range(3))]
        states[k] = np.stack(shapes) * SCALE + np.array([0.002 * k, 0, 0.001], np.float32)
    measured = np.full((count, 4), 0.001, np.float32)
    manipulation = np.tile(np.array([1, -1, 1, 1, -0.8, 0.1], np.float32), (count, 3, 1))
    manipulation[::3, :, 2:4] = manipulation[::3, :, :2]
    return Attempts(
        attempt=np.arange(count),
        accepted=np.arange(count) < accepted,
        reason=np.array([""] * accepted + ["height"]),
        reached=np.full(count, 4),
        start=np.full(count, "flat"),
        goal=np.full(count, ""),
        sides=np.full((count, 2), 0.4),
        material=np.tile(np.array([getattr(Material(), name) for name in DRAWN], np.float32), (count, 1)),
        states=states,
        manipulation=manipulation,
        hands=np.where(np.arange(count)[:, None] % 3 == 0, 1, 2) * np.ones((1, 3), int),
        releases=np.zeros((count, 3, 2, 2), np.float32),
        settle_time=np.full((count, 3), 0.4, np.float32),
        residual_speed=measured,
        height=measured,
        strain_p99=measured,
        strain_worst=measured,
        intersections=np.zeros((count, 4), int),
        gap=measured,
        area=np.full((count, 4), 0.7, np.float32),
        folds=np.ones((count, 4), int),
    )


def sessions(dataset: meshes.Dataset) -> Sessions:
    """Sessions of a test sequence in which all that is recorded came about, and nothing was searched for."""
    sequence = int(dataset.indices("test", evaluated=True)[0])
    tasks = tasks_of_dataset(dataset, tasks_of(sequence, 3), "test")
    assert tasks.recorded is not None
    sizes = Sizes(state=(32, 32, 3), probabilistic=True, candidate=12, net=2, iteration=10)
    done = record.record(tasks, [], sizes)
    for row, (task, way) in enumerate(zip(tasks.task, tasks.recorded, strict=True)):
        for step in range(task.length):
            left = task.length - step
            done.state[row, step + 1] = way.states[step + 1]
            done.centre[row, step + 1] = dataset.centre[sequence, task.start + step + 1]
            done.estimate[row, step] = way.states[step]
            done.plan[row, step, :left] = way.manipulations[step:]
            done.prediction_mean[row, step, :left] = way.states[step + 1 :][:, None]
            done.prediction_std[row, step, :left] = 0.02
            done.refined[row, step] = way.states[-1]
            done.loss[row, step], done.terms[row, step], done.common[row, step] = 0.5, 0.2, 0
            done.relative[row, step], done.expected[row, step] = 0, 0.05
        done.loss_recorded[row], done.offered[row] = 0.4, True
    return done
