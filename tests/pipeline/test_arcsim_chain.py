"""From ARCSim's runs to the report, in one process and with nets that learn nothing: short sequences break no stage."""

from functools import partial
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest

from clothkit.dataset import store
from clothkit.dataset.augment import AugmentConfig, augment
from clothkit.dataset.regularise import RegulariseConfig, assign_splits, regularise
from clothkit.episodes import record
from clothkit.episodes.evaluate import evaluate
from clothkit.estimation.refine import RefineConfig
from clothkit.estimation.support import fit
from clothkit.evaluation import (
    arrays,
    calibration,
    camera,
    camera_planning,
    doubt,
    estimation,
    planning,
    prediction,
    viewport,
    voxel_prediction,
)
from clothkit.evaluation.alarms import set_alarms
from clothkit.evaluation.camera_settings import Condition, EvaluateCameraConfig, SetAlarmsConfig
from clothkit.evaluation.comparisons import of_predictions
from clothkit.evaluation.diagnosis import diagnosed
from clothkit.evaluation.session_rows import rows
from clothkit.evaluation.settings import EvaluateEstimationConfig, EvaluatePredictionConfig
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.models.ensemble import Ensemble
from clothkit.models.net import Net
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, VtMConfig
from clothkit.observation.picture import PictureConfig
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import normalise
from clothkit.planning.objective import Weights
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.perception import Estimation
from clothkit.planning.planner import Planner
from clothkit.planning.search import SearchConfig
from clothkit.planning.settings import NormaliseConfig, PlanConfig
from clothkit.planning.systems import system
from clothkit.report.build import build
from clothkit.report.inputs import Inputs
from clothkit.report.settings import ReportConfig
from clothkit.simulation.arcsim import import_runs
from clothkit.simulation.arcsim_runs import read_runs
from clothkit.training.emd_voxel import train_emd_voxel
from clothkit.training.pemd import train_pemd
from clothkit.training.settings import TrainEMDVoxelConfig, TrainingConfig, TrainPEMDConfig, TrainVtMConfig
from clothkit.training.vtm import example_units, train_vtm
from tests.evaluation.doubt_rows import probe_rows, trust_rows
from tests.observation.scenes import SMALL
from tests.planning import toy
from tests.simulation import arcsim_runs as runs

pytestmark = pytest.mark.slow

SPLITS = RegulariseConfig(train=5, validation=2, test=3, evaluated=3)
TRAINING = TrainingConfig(recipe="fast", iterations=4, batch=4, validate_every=2, steps_per_call=2)
VOXEL = TrainEMDVoxelConfig(
    net=EMDVoxelConfig(latent=4, manipulation=6, dense=True, encoder=(8,), decoder=(8,)), training=TRAINING
)
PEMD = TrainPEMDConfig(net=PEMDConfig(latent=4, encoder=(8,), manipulation=6, decoder=(8,)), training=TRAINING)
VTM = TrainVtMConfig(net=VtMConfig(hidden=4), training=TRAINING, noise=0.0)
REFINE = RefineConfig(iterations=3)
PLAN = PlanConfig(
    test=3,
    train=1,
    search=SearchConfig(optimiser=GradientConfig(strains=8, base_iterations=2, iterations_per_step=1)),
    refine=REFINE,
    together=1,
    batch=1,
)
CAMERA = EvaluateCameraConfig(
    conditions=(Condition(name="tilted", tilt=0.3, noise=1.0),),
    picture=PictureConfig(camera=SMALL),
    estimated=3,
    planned=1,
    stored=2,
)
REPORT = ReportConfig(sequences=3, estimates=3, predictions=3, sessions=2, planners=("main",))


def write_runs(folder: Path) -> Path:
    """Ten sequences of one manipulation, but for one in each split, which has two."""
    if runs.REFERENCE.is_dir():
        for name in ("half_04m_fix32", "half_04m_adapt", "corner_04m_fix32"):
            runs.copy_reference(folder / name, name)
        fixed, adapted, corner = "half_04m_fix32", "half_04m_adapt", "corner_04m_fix32"
    else:
        fixed, adapted, corner = "a", "b", "c"
        for seed, name in enumerate((fixed, adapted)):
            runs.write_run(folder / name, {0: (0.4, 0.0), 1: (0.4, 0.0)}, seed=seed)
        runs.write_run(folder / corner, {0: (0.2, 0.2)}, seed=2)
    split = assign_splits(SPLITS)[0]
    sequences = [[(name, 0), (name, runs.FRAME)] for name in (fixed, adapted, corner, corner, adapted) * 2]
    for code in range(3):
        sequences[int(np.flatnonzero(split == code)[0])] = [(fixed, 0), (adapted, runs.FRAME), (corner, runs.FRAME)]
    return runs.write_table(folder, sequences)


def test_the_chain_runs_on_from_arcsims_runs(tmp_path: Path) -> None:
    folder = write_runs(tmp_path / "runs")
    import_runs(tmp_path / "raw", read_runs(str(folder), 10), work=tmp_path / "import", attributes={})
    store.save(tmp_path / "meshes.zarr", regularise(tmp_path / "raw", SPLITS), {})
    dataset = store.load(tmp_path / "meshes.zarr")
    assert sorted(dataset.length.tolist()) == [1] * 7 + [2] * 3
    store.save(tmp_path / "augmented.zarr", augment(dataset.of_split("train"), AugmentConfig()), {})
    training, validation = store.load(tmp_path / "augmented.zarr"), dataset.of_split("validation")

    nets, histories = [], {}
    for member in range(2):
        work = tmp_path / f"pemd_{member}"
        work.mkdir()
        trained = train_pemd(PEMD, training, validation, work=work, key=jax.random.key(member))
        nets.append(Net(PEMD.net, trained.params))
        histories[str(member)] = trained.history
    ensemble = Ensemble((0, 1), tuple(nets))
    (tmp_path / "voxel").mkdir()
    trained = train_emd_voxel(VOXEL, training, validation, work=tmp_path / "voxel", key=jax.random.key(3))
    voxel_net = Net(VOXEL.net, trained.params)
    (tmp_path / "vtm").mkdir()
    trained = train_vtm(VTM, dataset.of_split("train"), validation, work=tmp_path / "vtm", key=jax.random.key(2))
    vtm, vtm_history = Net(VTM.net, trained.params), trained.history

    found = estimation.estimates(dataset, vtm, EvaluateEstimationConfig(batch=4), REFINE)
    arrays.save(tmp_path / "estimates.zarr", found._asdict(), arrays.ESTIMATES, {})
    estimates = arrays.load(tmp_path / "estimates.zarr", arrays.ESTIMATES)
    settings = EvaluatePredictionConfig(batch=4, stored=3)
    given = prediction.starts(dataset, estimates)
    stored = prediction.stored(dataset, given, nets[0], settings)
    arrays.save(tmp_path / "predictions.zarr", stored, arrays.PREDICTIONS, {})
    planner = Planner(
        system("main"),
        representation=MESH,
        model=ensemble.model,
        members=ensemble.members,
        nets=ensemble.params,
        best=0,
        perception=Estimation(vtm, PLAN.refine),
        normalisation=normalise(ensemble.model, MESH, ensemble.params, validation, NormaliseConfig(draws=1)),
        weights=Weights(1.0, 5.0, 1.25),
        settings=PLAN,
        grasping=CandidateConfig(),
    )
    annotate = partial(diagnosed, planner=planner)
    pieces, _ = evaluate(dataset, planner, toy.execute, work=tmp_path / "plan", annotate=annotate)
    sessions = pieces.whole()

    support = fit(example_units(vtm, dataset.of_split("train"), VTM, examples=32, seed=0))
    raised = set_alarms(vtm, dataset, SetAlarmsConfig(), support=support, camera=CAMERA, refinement=REFINE)
    seen = camera.estimation(dataset, vtm, CAMERA, REFINE, raised, work=tmp_path / "states")
    arrays.save(tmp_path / "pictures.zarr", seen.arrays, arrays.PICTURES, {})
    before = camera_planning.planning(dataset, planner, toy.execute, sessions, CAMERA, work=tmp_path / "camera")

    of_meshes = prediction.rows(dataset, given, ensemble, settings)
    of_voxels = voxel_prediction.rows(dataset, given.sequence, Ensemble((0,), (voxel_net,)), settings)
    predicted = pd.concat([of_meshes, of_voxels], ignore_index=True)
    planned = rows(sessions, "main").merge(viewport.rows(sessions, "main"), validate="one_to_one")
    inputs = Inputs(
        dataset=dataset,
        attempts=pd.read_parquet(tmp_path / "raw/attempts.parquet"),
        forward_histories=histories,
        vtm_history=vtm_history,
        viewport=vtm.config.viewport,
        estimation=estimation.rows(dataset, found),
        prediction=predicted,
        calibration=calibration.rows(dataset, given, nets[0], estimates, settings),
        comparisons=of_predictions(predicted),
        planning=planned,
        planning_comparisons=planning.comparisons(planned),
        intervals=planning.intervals(planned),
        failures=planning.failures(planned),
        estimates=estimates,
        predictions=arrays.load(tmp_path / "predictions.zarr", arrays.PREDICTIONS),
        sessions=sessions,
        camera_estimation=seen.rows,
        camera_planning=before,
        camera_comparisons=camera_planning.comparisons(before),
        pictures=arrays.load(tmp_path / "pictures.zarr", arrays.PICTURES),
        # These are made up: they come from our own simulator, whatever the dataset comes from.
        probes=probe_rows(),
        doubt=doubt.summary(probe_rows()),
        trust=trust_rows(),
    )
    unoccluded = of_meshes[of_meshes["system"] != prediction.OCCLUDED]
    for tidy in (inputs.estimation, unoccluded, inputs.planning):
        assert np.isfinite(tidy[["error", "error_no_action"]]).all().all()
    assert np.isfinite(predicted[["voxel_error", "voxel_error_no_action", "position_error"]]).all().all()
    for tidy in (inputs.prediction, inputs.planning):
        ends = tidy["start"] + tidy["length"]
        assert (ends.to_numpy() <= dataset.length[tidy["sequence"]]).all()
    # Three test sequences and one to three of training: a task each, and two more where there are two manipulations.
    tasks = inputs.planning.groupby("sequence").size()
    assert {s: int(n) for s, n in tasks.items()} == {s: 1 if dataset.length[s] == 1 else 3 for s in tasks.index}
    record.save(tmp_path / "sessions.zarr", pieces, {})
    build(tmp_path / "report", inputs, REPORT)
    pictures = {path.stem for path in (tmp_path / "report/figures").iterdir()}
    assert {"sequences", "estimates", "predictions", "scatter", "sessions_1", "sessions_2"} <= pictures
    assert "sessions_3" not in pictures
