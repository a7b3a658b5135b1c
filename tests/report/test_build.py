"""A whole report from made-up artifacts: its files, its figures, equal bytes when it is built again."""

import dataclasses
import shutil
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from clothkit.cloth import voxels
from clothkit.cloth.topology import SQUARE
from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.dataset.store import Dataset, papers_cloths
from clothkit.dataset.tasks import TASKS, Task
from clothkit.episodes.record import Sessions, Sizes, record, tasks_of_dataset
from clothkit.evaluation import calibration, camera_planning, doubt, planning
from clothkit.evaluation.comparisons import of_predictions
from clothkit.report import build as build_module
from clothkit.report import pages, panels, timings
from clothkit.report.build import build, draw_figures, example_tasks
from clothkit.report.figures import camera as camera_figure
from clothkit.report.figures import estimates as estimates_figure
from clothkit.report.figures import voxels as voxels_figure
from clothkit.report.figures.curves import curves
from clothkit.report.figures.largest import Failure, largest
from clothkit.report.figures.sessions import median, of_record, sessions
from clothkit.report.inputs import Inputs
from clothkit.report.rows import VOXEL_SYSTEMS
from clothkit.report.sections import CAPTIONS, TABLES
from clothkit.report.settings import ReportConfig
from tests.evaluation import camera_rows
from tests.evaluation.doubt_rows import probe_rows, trust_rows
from tests.evaluation.planning_rows import planning_rows
from tests.goals.goal_rows import goal_rows
from tests.report.contents import LAPTOP
from tests.report.web import tree

SETTINGS = ReportConfig(sequences=1, estimates=1, predictions=1, sessions=1, largest=3)
EMPTY = np.zeros(voxels.RESOLUTION, bool)


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Two test sequences of ever smaller cloths."""
    shrink = np.array([1, 0.9, 0.8, 0.7], np.float32)[:, None, None, None]
    manipulation = np.array([-1, -1, 1, -1, 0.1, 0.8], np.float32)
    return Dataset(
        np.stack([SQUARE.flat() * shrink] * 2),
        np.zeros((2, 4, 2), np.float32),
        np.broadcast_to(manipulation, (2, 3, 6)).copy(),
        np.full((2, 3), 2, np.int8),
        np.full(2, 3, np.int8),
        np.full(2, 2, np.int8),
        np.ones(2, bool),
        *papers_cloths(2),
    )


def recorded_sessions(dataset: Dataset) -> Sessions:
    """Sessions in which everything happened as recorded."""
    tasks = [Task(sequence, start, length) for sequence in (0, 1) for start, length in TASKS]
    sessions = record(tasks_of_dataset(dataset, tasks, "test"), [], Sizes((32, 32, 3), True, 4, 2, 5))
    for place, (sequence, start, length) in enumerate(tasks):
        for step in range(length):
            state, left = dataset.vertices[sequence, start + step], length - step
            sessions.state[place, step + 1] = dataset.vertices[sequence, start + step + 1]
            sessions.estimate[place, step] = state
            sessions.candidates[place, step, :2] = [[-1, -1], [1, -1]]
            sessions.plan[place, step, :left] = dataset.manipulation[sequence, :left]
            after = dataset.vertices[sequence, start + step + 1 : start + length + 1]
            sessions.prediction_mean[place, step, :left] = after[:, None]
            sessions.prediction_std[place, step, :left] = 0.02
            sessions.refined[place, step] = after[-1]
    return sessions


@pytest.fixture(scope="module")
def inputs(dataset: Dataset) -> Inputs:
    common = {"split": "test", "error": 0.03, "error_no_action": 0.2, "sigma_ratio": 0.8}
    several = {"hypotheses": 2, "probability": 0.6, "error_best": 0.02}
    shift = {"position_error": 0.02, "position_no_action": 0.2}
    in_voxels = {"voxel_error": 0.01, "voxel_error_no_action": 0.05}
    in_voxels |= {"voxel_error_025": 0.005, "voxel_error_025_no_action": 0.025}
    tasks = [{"sequence": q, "start": start, "length": length} for q in (0, 1) for start, length in TASKS]
    planned = planning_rows(SETTINGS.planners, sequences=2, splits=("test",))
    prediction = pd.DataFrame(
        [
            {**common, **shift, **in_voxels, **task, "system": system, "net": net, "better": net == "1"}
            for system in ("main", "a1", *VOXEL_SYSTEMS)
            for net in ("0", "1")
            for task in tasks
        ]
    )
    estimation = pd.DataFrame(
        [
            {**common, **several, "sequence": sequence, "state": state, "kind": kind}
            for sequence in (0, 1)
            for state in (1, 2, 3)
            for kind in ("pmr", "dmr")
        ]
    )
    history = pd.DataFrame({"iteration": [10, 20, 30], "score": [0.3, 0.1, 0.2]})
    # Histories name the tasks and states that some validation sequence has.
    by_task = history.assign(**{"1/0": [0.2, 0.1, 0.1], "2/0": [0.4, 0.1, 0.3]})
    by_state = history.assign(step_0=0.01, step_1=[0.2, 0.1, 0.1])
    spread = np.full_like(dataset.vertices, 0.02)
    return Inputs(
        dataset=dataset,
        attempts=pd.DataFrame({"accepted": [True, False], "reason": ["", "height"]}),
        forward_histories={"0": by_task, "1": history},
        vtm_history=by_state,
        viewport=VIEWPORT,
        estimation=estimation,
        calibration=pd.concat(
            [
                calibration.curve(np.full((1, 32, 32, 3), 0.5)).assign(split="test", system=system, length=length)
                for system in ("estimate", "main", "a1")
                for length in (1, 2, 3)
            ]
        ),
        prediction=prediction.assign(error=prediction["error"].mask(prediction["system"].isin(VOXEL_SYSTEMS))),
        comparisons=of_predictions(prediction),
        planning=planned,
        planning_comparisons=planning.comparisons(planned),
        intervals=planning.intervals(planned),
        failures=planning.failures(planned),
        estimates={
            "sequence": np.arange(2),
            "mean": dataset.vertices,
            "std": spread,
            "mesh": dataset.vertices,
            "label": np.zeros((2, 4), np.int32),
        },
        predictions={
            "sequence": np.arange(2),
            "start": dataset.vertices[:, 0],
            "mean": dataset.vertices[:, 1:],
            "std": spread[:, 1:],
            "shift": np.full((2, 3, 2), 0.1, np.float32),
        },
        sessions=recorded_sessions(dataset),
        camera_estimation=camera_rows.estimation(),
        camera_planning=camera_rows.planning(),
        camera_comparisons=camera_planning.comparisons(camera_rows.planning()),
        pictures={
            "sequence": np.array([0, 1]),
            "shown": np.array([1, 2]),
            "height": np.zeros((2, 2, 12, 16), np.float32),
            "voxels": np.zeros((2, 2, 32, 32, 16), bool),
            "mesh": np.repeat(dataset.vertices[:, 1:2], 2, axis=1),
        },
        probes=probe_rows(),
        doubt=doubt.summary(probe_rows()),
        trust=trust_rows(),
        goals=goal_rows(),
        goal_pictures={
            "goal": np.array([0, 0, 3, 3]),
            "begins": np.array([0, 0, 2, 0]),
            "source": np.array([0, 1, 1, 2]),
            **{name: np.repeat(dataset.vertices[0, :1], 4, axis=0) for name in ("target", "start", "outcome")},
        },
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_a_report_is_complete(inputs: Inputs, tmp_path: Path) -> None:
    report = tmp_path / "report"
    made = build(report, inputs, SETTINGS)
    found = set(contents(report))
    tables = {path for path in TABLES if path.startswith("tables/")} | {
        "tables/planned.csv",
        "tables/doubt_intervals.csv",
    }
    tables -= {"tables/by_cloth.csv"}  # All cloths are alike.
    assert {f"tables/{name}.csv" for name in made} == tables
    pictures = {f"figures/{name}.png" for name in CAPTIONS}
    data = {f"plots/{name}.csv" for name in ("learning", "calibration", "prediction", "planning", "table_6")}
    assert found == {"metrics.json", "metrics.csv", "figures/captions.json"} | tables | data | pictures
    assert len((report / "tables/largest.csv").read_text().splitlines()) == 1 + SETTINGS.largest
    # Its pages show all of it.
    shutil.copy(LAPTOP / "params.yaml", report)
    timings.timings(tmp_path).to_csv(report / "timings.csv", index=False)
    timings.table_8(tmp_path, SETTINGS.planners).to_csv(report / "table_8.csv", index=False)
    pages.write(report, report)
    page, markup = ((report / name).read_text() for name in ("README.md", "index.html"))
    assert all(picture in page for picture in pictures)
    missing = {path for path in TABLES if f"({path})" not in page}
    # Studies were not run.
    assert missing - {path for path in missing if path.startswith("studies/")} == {"tables/by_cloth.csv"}
    assert "every task of 2 test sequences" in page
    assert "Too few test sequences were planned for (2)" in page
    assert len(tree(markup).all("img")) == len(pictures)
    assert "No stage has recorded its time." in markup
    assert len(markup) < 8e6


def test_a_report_of_other_cloths_has_no_tables_in_the_papers_voxels(inputs: Inputs, tmp_path: Path) -> None:
    settings = dataclasses.replace(SETTINGS, paper=False)
    made = build(tmp_path / "report", inputs, settings)
    assert not {"table_4", "table_4_025", "table_7", "table_7_025"} & set(made)
    assert set(made["planning_comparisons"]["measure"]) == {"error"}
    measures = set(pd.read_csv(tmp_path / "report/metrics.csv")["measure"])
    assert measures == {"estimation", "prediction", "position", "planning", "sigma_ratio"}


def test_pictures_show_the_voxels_that_the_net_sees(
    inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = []
    for other in ("sequences", "predictions", "calibration", "curves", "measures", "trust", "meshes", "equivalents"):
        monkeypatch.setattr(build_module, other, lambda *given, **how: None)
    for other in ("trajectories", "goal_outcomes", "scatter", "sessions"):
        monkeypatch.setattr(build_module, other, lambda *given, **how: None)
    for module in (estimates_figure, camera_figure):
        monkeypatch.setattr(module, "draw_heights", lambda seen: shown.append(seen) or np.zeros((4, 4, 3), np.uint8))
    monkeypatch.setattr(
        voxels_figure.cloth_voxels, "of_mesh", lambda mesh, *, viewport: shown.append(viewport) or EMPTY
    )
    tall = dataclasses.replace(inputs, viewport=Viewport(height=0.4, curve=2.0))
    raised = dataclasses.replace(inputs.dataset, vertices=inputs.dataset.vertices + np.float32([0, 0, 0.11]))
    draw_figures(tmp_path, dataclasses.replace(tall, dataset=raised), inputs.planning[:0], SETTINGS)
    drawn = [seen for seen in shown if isinstance(seen, np.ndarray) and seen.any()]
    # Heights of 0.11 are in voxel 16 sqrt(0.11 / 0.4) = 8.4, and would be in the 15th of the paper's.
    assert len(drawn) == 1 + len(inputs.pictures["sequence"])
    assert all(seen[..., 8].any() and not seen[..., 9:].any() for seen in drawn)
    assert [seen for seen in shown if isinstance(seen, Viewport)] == [tall.viewport]


def test_a_session_is_drawn_from_its_record(inputs: Inputs, dataset: Dataset, tmp_path: Path) -> None:
    rows = inputs.planning[inputs.planning["system"] == "main"]
    session = of_record(inputs.sessions, dataset, rows, Task(1, 1, 2), net=1)
    assert session is not None
    assert [len(step.plan) for step in session.steps] == [2, 1]
    np.testing.assert_array_equal(session.states, dataset.vertices[1, 1:4])
    np.testing.assert_allclose(session.steps[1].candidates, dataset.vertices[1, 2][[0, 31], 0, :2], atol=1e-6)
    assert of_record(inputs.sessions, dataset, rows, Task(7, 0, 1), net=1) is None
    for name in ("one.png", "two.png"):
        sessions([session], tmp_path / name, per_row=1)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


@pytest.mark.parametrize("nets", [1, 3, 5])
def test_predictions_of_the_asked_net_are_drawn_and_those_of_a_single_one(
    inputs: Inputs, dataset: Dataset, nets: int
) -> None:
    mean = np.arange(nets, dtype=np.float16)[:, None, None, None] + np.zeros((12, 3, 3, nets, 32, 32, 3), np.float16)
    found = dataclasses.replace(
        inputs.sessions, terms=np.zeros((12, 3, nets + 1), np.float32), prediction_mean=mean, prediction_std=mean
    )
    rows = inputs.planning[inputs.planning["system"] == "main"]
    for asked in range(5):
        session = of_record(found, dataset, rows, Task(1, 1, 2), net=asked)
        assert session is not None
        if asked < nets or nets == 1:
            assert (session.steps[0].mean == (asked if nets > 1 else 0)).all()


@pytest.mark.parametrize("nets", [1, 3, 5])
def test_there_are_curves_of_each_net(inputs: Inputs, tmp_path: Path, nets: int) -> None:
    histories = {str(net): inputs.forward_histories["0"] * (1 + 0.1 * net) for net in range(nets)}
    shown: list[Figure] = []
    with mock.patch.object(panels, "save", lambda figure, path: shown.append(figure)):
        curves(histories, inputs.vtm_history, tmp_path / "curves.png")
    (figure,) = shown
    scores, _, *others = figure.axes
    assert len({line.get_color() for line in scores.lines if line.get_linestyle() == "-"}) == nets
    titles = [axis.get_title() for axis in others if axis.get_title()]
    assert titles == [f"net {net} by task: length / start" for net in range(nets)]


def test_the_largest_errors_are_drawn_two_a_row(inputs: Inputs, dataset: Dataset, tmp_path: Path) -> None:
    rows = inputs.planning[inputs.planning["system"] == "main"]
    session = of_record(inputs.sessions, dataset, rows, Task(1, 1, 2), net=1)
    assert session is not None
    failure = Failure(session, 0.02, np.nan, "open")
    for count in (1, 2, 3):
        largest([failure] * count, tmp_path / f"{count}.png")
    sizes = [cv2.imread(str(tmp_path / f"{count}.png")).shape for count in (1, 2, 3)]
    # Two are twice as wide as one and as high, three are as wide as two and twice as high; but for the margins.
    (one, one_wide, _), (two, two_wide, _), (three, three_wide, _) = sizes
    assert one == two < three
    assert one_wide < two_wide == three_wide
    assert three / one == pytest.approx(2, rel=0.3)
    assert two_wide / one_wide == pytest.approx(2, rel=0.1)


def test_every_plan_of_a_session_is_among_the_largest_errors(
    inputs: Inputs, dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = inputs.planning[inputs.planning["system"] == "main"]
    found: list[Figure] = []
    monkeypatch.setattr(panels, "save", lambda figure, path: found.append(figure))
    tasks = [Task(1, 0, 3), Task(1, 1, 2), Task(0, 2, 1)]
    chosen = [of_record(inputs.sessions, dataset, rows, task, net=1) for task in tasks]
    largest([Failure(session, 0.02, 0.04, "open") for session in chosen if session], tmp_path / "none.png")
    texts = [text.get_text() for axis in found[0].axes for text in axis.texts]
    assert [sum(text == f"plan #{number}" for text in texts) for number in (1, 2, 3)] == [3, 2, 1]
    # The estimate's and the expected error stand beside the first plans alone, the outcome's beside the last ones.
    assert texts.count("0.020") == texts.count("0.040") == 3
    assert [texts.count(f"{session.error:.3f}") for session in chosen if session].count(0) == 0


def test_the_median_case_is_shown_and_named(inputs: Inputs) -> None:
    rows = pd.DataFrame(
        {
            "split": ["test"] * 5 + ["train"],
            "length": [2, 2, 2, 2, 1, 2],
            "sequence": [5, 6, 7, 8, 9, 10],
            "start": [0, 1, 0, 1, 0, 0],
            "error": [0.4, 0.1, 0.3, 0.2, 0.25, 0.21],
        }
    )
    # Of 0.1, 0.2, 0.3, 0.4 the lower one of the middle two.
    assert median(rows, 2) == Task(8, 1, 2)
    assert median(rows, 3) is None


def test_pictures_take_the_starts_in_turn() -> None:
    assert example_tasks([5, 6, 7, 8], [3] * 4, 1) == [Task(5, 0, 1), Task(6, 1, 1), Task(7, 2, 1), Task(8, 0, 1)]
    assert example_tasks([5, 6], [3, 3], 3) == [Task(5, 0, 3), Task(6, 0, 3)]
    # Short sequences have fewer starts, or none.
    assert example_tasks([5, 6, 7], [1, 1, 2], 1) == [Task(5, 0, 1), Task(6, 0, 1), Task(7, 0, 1)]
    assert example_tasks([5, 6], [1, 2], 2) == [Task(6, 0, 2)]
