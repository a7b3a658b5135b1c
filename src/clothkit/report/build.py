"""Writes the tables, figures, plots and metrics that the report's pages show."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.cloth.symmetry import relabel
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.evaluation.occupancy import TALL_MEASURE
from clothkit.report import camera_tables, cloth_tables, doubt_tables, goal_tables, metrics, planning_tables, tables
from clothkit.report.captions import CAPTIONS_FILE
from clothkit.report.figures.calibration import calibration
from clothkit.report.figures.camera import camera
from clothkit.report.figures.curves import curves
from clothkit.report.figures.doubt import measures, trust
from clothkit.report.figures.equivalents import equivalents
from clothkit.report.figures.estimates import estimates
from clothkit.report.figures.goals import goal_outcomes
from clothkit.report.figures.largest import Failure, largest
from clothkit.report.figures.meshes import meshes
from clothkit.report.figures.predictions import predictions
from clothkit.report.figures.scatter import scatter
from clothkit.report.figures.sequences import sequences
from clothkit.report.figures.sessions import Session, median, of_record, sessions
from clothkit.report.figures.trajectories import Example, trajectories
from clothkit.report.figures.voxels import voxels
from clothkit.report.inputs import Inputs
from clothkit.report.paper import without_paper
from clothkit.report.plots import plots
from clothkit.report.sections import CAPTIONS
from clothkit.report.settings import ReportConfig

PREDICTOR_OF = {"main": "main", "b1": "a1"}
"""For a planner, the predictor with the same input: estimates or true meshes."""

VOXEL_TABLES = ("table_4", "table_4_025", "table_7", "table_7_025")
"""Tables that stand beside the paper's alone: their voxels are those of its viewport, whatever the nets' own is."""

SESSIONS_PER_ROW = {1: 2, 2: 2, 3: 1}
"""Number of sessions side by side in a picture, by length."""


def build(folder: Path, inputs: Inputs, settings: ReportConfig) -> dict[str, pd.DataFrame]:
    """Writes tables, figures, plots and metrics into a new folder. Returns the tables by name.

    Equal inputs give equal bytes.
    """
    (folder / "tables").mkdir(parents=True)
    (folder / "figures").mkdir()
    planned, found = inputs.planning, inputs.prediction
    built = {
        "table_2": tables.estimation(inputs.estimation),
        "table_3": tables.prediction(found, settings.predictors),
        "table_4": tables.prediction_voxels(found, settings.voxel_predictors),
        "table_4_025": tables.prediction_voxels(found, settings.voxel_predictors, measure=TALL_MEASURE),
        "comparisons": tables.comparisons(inputs.comparisons),
        "table_5": tables.position(found, settings.predictors),
        "table_6": planning_tables.planning(planned, inputs.intervals, settings.planners),
        "table_7": planning_tables.planning_voxels(planned, inputs.intervals, settings.planners),
        "table_7_025": planning_tables.planning_voxels(
            planned, inputs.intervals, settings.planners, measure=TALL_MEASURE
        ),
        "planned": planning_tables.planned(planned),
        "planning_comparisons": planning_tables.comparisons(inputs.planning_comparisons, settings.planners),
        "failures": planning_tables.failures(inputs.failures, settings.planners),
        "largest": planning_tables.largest(planned, settings.planners[0], settings.largest),
        "camera_estimation": camera_tables.estimation(inputs.camera_estimation),
        "camera_planning": camera_tables.planning(inputs.camera_planning),
        "camera_comparisons": camera_tables.comparisons(inputs.camera_comparisons),
        "by_cloth": cloth_tables.by_cloth(inputs.dataset, inputs.estimation, planned),
        "doubt": doubt_tables.doubt(inputs.doubt),
        "doubt_intervals": inputs.doubt,
        "trust": doubt_tables.trust(inputs.trust),
        "hypotheses": tables.hypotheses(inputs.estimation),
        "sigma_ratio": tables.sigma_ratio(inputs.estimation, found),
        "splits": tables.splits(inputs.dataset),
        "attempts": tables.attempts(inputs.attempts),
    }
    if inputs.goals is not None:
        for measure, name in (("error", "goals"), ("softgym", "goals_softgym"), ("iou", "goals_iou")):
            built[name] = goal_tables.goals(inputs.goals, measure)
    if not settings.paper:
        built = {name: without_paper(table) for name, table in built.items() if name not in VOXEL_TABLES}
        compared = built["planning_comparisons"]
        built["planning_comparisons"] = compared[compared["measure"] != "voxel_error"]
    for name in ("by_cloth", "comparisons", "hypotheses"):
        if built[name].empty:
            del built[name]
    drawn = draw_figures(folder / "figures", inputs, built["largest"], settings)
    # The pages of an old report can be written again, but not its pictures, so their captions are stored beside them.
    captions = {name: CAPTIONS[name] for name in sorted(drawn)}
    (folder / "figures" / CAPTIONS_FILE).write_text(json.dumps(captions, indent=1, ensure_ascii=False) + "\n")
    for name, table in built.items():
        table.to_csv(folder / "tables" / f"{name}.csv", index=False, float_format="%.5g", lineterminator="\n")
    means = metrics.means(
        estimation=built["table_2"],
        prediction=built["table_3"],
        prediction_voxels=built.get("table_4"),
        position=built["table_5"],
        planning=built["table_6"],
        planning_voxels=built.get("table_7"),
        sigma_ratio=built["sigma_ratio"],
    )
    means.to_csv(folder / "metrics.csv", index=False, float_format="%.5g", lineterminator="\n")
    headline = metrics.headline(means, settings.planners)
    (folder / "metrics.json").write_text(json.dumps(headline, indent=1) + "\n")
    (folder / "plots").mkdir()
    histories = {
        **{f"pemd_{member}": rows for member, rows in inputs.forward_histories.items()},
        "vtm": inputs.vtm_history,
    }
    for name, rows in plots(histories, inputs.calibration, built["table_3"], built["table_6"]).items():
        rows.to_csv(folder / "plots" / f"{name}.csv", index=False, float_format="%.5g", lineterminator="\n")
    return built


def draw_figures(folder: Path, inputs: Inputs, errors: pd.DataFrame, settings: ReportConfig) -> list[str]:
    """Draws every figure as `<name>.png`. Returns the names. Figures of sessions are left out if there is no session.

    `errors` is the table of the largest planning errors.
    """
    dataset, planner = inputs.dataset, settings.planners[0]
    sequences(dataset, folder / "sequences.png", count=settings.sequences)
    seen = inputs.viewport
    found, count = inputs.estimates, settings.estimates
    estimates(dataset, found, inputs.estimation, folder / "estimates.png", count=count, viewport=seen)
    predictions(dataset, inputs.predictions, inputs.prediction, folder / "predictions.png", count=settings.predictions)
    calibration(inputs.calibration, folder / "calibration.png")
    curves(inputs.forward_histories, inputs.vtm_history, folder / "curves.png")
    measures(inputs.doubt, folder / "doubt.png")
    trust(inputs.probes, inputs.trust, folder / "trust.png")
    conditions = list(dict.fromkeys(inputs.camera_comparisons["system"]))
    camera(dataset, inputs.pictures, found, conditions, folder / "camera.png", viewport=seen)
    names = [
        "camera",
        "sequences",
        "estimates",
        "predictions",
        "calibration",
        "curves",
        "doubt",
        "trust",
        *representations(folder, inputs),
    ]
    if inputs.goal_pictures is not None:
        goal_outcomes(inputs.goal_pictures, folder / "goals.png")
        names.append("goals")
    if not PREDICTOR_OF.keys().isdisjoint(settings.planners):
        scatter(inputs.planning, inputs.prediction, PREDICTOR_OF, settings.planners, folder / "scatter.png")
        names.append("scatter")
    rows = inputs.planning[inputs.planning["system"] == planner]
    main_rows = inputs.prediction[inputs.prediction["better"] & (inputs.prediction["system"] == "main")]
    best = list(inputs.forward_histories).index(str(main_rows["net"].iloc[0]))
    failed = []
    for row in errors.to_dict("records"):
        task = Task(row["sequence"], row["start"], row["length"])
        session = of_record(inputs.sessions, dataset, rows, task, net=best)
        if session is not None:
            failed.append(Failure(session, row["estimate_error"], row["expected"], row["diagnosis"]))
    if failed:
        largest(failed, folder / "largest.png")
        names.append("largest")
    test = np.unique(rows.loc[rows["split"] == "test", "sequence"]).tolist()
    for length, per_row in SESSIONS_PER_ROW.items():
        chosen: list[Session] = []
        for task in example_tasks(test, dataset.length[test].tolist(), length):
            session = of_record(inputs.sessions, dataset, rows, task, net=best)
            if session is not None and len(chosen) < settings.sessions:
                chosen.append(session)
        middle = median(rows, length)
        session = of_record(inputs.sessions, dataset, rows, middle, net=best) if middle else None
        if session is not None:
            chosen.append(session._replace(remark="the median case"))
        if chosen:
            sessions(chosen, folder / f"sessions_{length}.png", per_row=per_row)
            names.append(f"sessions_{length}")
    return names


def representations(folder: Path, inputs: Inputs) -> list[str]:
    """Draws the figures that explain representations, from the first suitable test sequences. Returns their names."""
    dataset, found = inputs.dataset, inputs.estimates
    test = dataset.indices("test").tolist()
    place = next(place for place, sequence in enumerate(found["sequence"]) if int(sequence) in test)
    sequence = int(found["sequence"][place])
    state = min(2, int(dataset.length[sequence]))
    label = int(found["label"][place, state])
    mean, std = (np.asarray(relabel(found[name][place, state], label)) for name in ("mean", "std"))
    meshes(dataset.vertices[sequence, state], mean, std, folder / "meshes.png")
    voxels(dataset.vertices[sequence, state], folder / "voxels.png", viewport=inputs.viewport)
    equivalents(dataset.vertices[sequence, 1], folder / "equivalents.png")
    # Folded states are tried first, because the silhouette of the flat cloth shows little.
    steps = [(sequence, step) for step in (1, 2, 0) for sequence in test if step < dataset.length[sequence]]
    examples = []
    for hands in (2, 1):
        chosen = next(((sequence, step) for sequence, step in steps if dataset.hands[sequence, step] == hands), None)
        if chosen is not None:
            examples.append(Example(dataset.vertices[chosen], dataset.manipulation[chosen]))
    trajectories(examples, folder / "trajectories.png")
    return ["meshes", "voxels", "trajectories", "equivalents"]


def example_tasks(sequences: list[int], manipulations: list[int], length: int) -> list[Task]:
    """One task of that length from each sequence that has one, with the starts in rotation.

    The rule makes the examples independent of their results.
    """
    found = []
    for place, (sequence, longest) in enumerate(zip(sequences, manipulations, strict=True)):
        tasks = [task for task in tasks_of(sequence, longest) if task.length == length]
        found += tasks[place % len(tasks) :][:1] if tasks else []
    return found
