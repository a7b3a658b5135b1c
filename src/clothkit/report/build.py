"""Writes the report: tables, figures, metrics and the page that shows them."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.cloth.equivalents import relabel
from clothkit.dataset.tasks import Task, tasks_of
from clothkit.report import camera_tables, captions, metrics, page, planning_tables, tables
from clothkit.report.figures.calibration import calibration
from clothkit.report.figures.camera import camera
from clothkit.report.figures.curves import curves
from clothkit.report.figures.equivalents import equivalents
from clothkit.report.figures.estimates import estimates
from clothkit.report.figures.largest import Failure, largest
from clothkit.report.figures.meshes import meshes
from clothkit.report.figures.predictions import predictions
from clothkit.report.figures.scatter import scatter
from clothkit.report.figures.sequences import sequences
from clothkit.report.figures.sessions import Session, of_record, sessions
from clothkit.report.figures.trajectories import Example, trajectories
from clothkit.report.figures.voxels import voxels
from clothkit.report.inputs import NETS, Inputs
from clothkit.report.plots import plots
from clothkit.report.settings import ReportConfig

PREDICTOR_OF = {"main": "main", "b1": "a1"}
"""Which predictions start from what a planner starts from."""

TABLES = (
    "table_2",
    "table_3",
    "table_4",
    "comparisons",
    "table_5",
    "table_6",
    "table_7",
    "planning_comparisons",
    "failures",
    "largest",
    "camera_estimation",
    "camera_planning",
    "camera_comparisons",
    "sigma_ratio",
    "splits",
    "attempts",
)

ABREAST = {1: 2, 2: 2, 3: 1}
"""Sessions side by side in a picture, by length."""


def build(folder: Path, inputs: Inputs, settings: ReportConfig, *, scale: str) -> page.Contents:
    """Write tables, figures, plots, metrics and the page (README.md) into a new folder; what they show.

    Equal inputs give equal bytes.
    """
    (folder / "tables").mkdir(parents=True)
    (folder / "figures").mkdir()
    errors = planning_tables.largest(inputs.planning, settings.planners[0], settings.largest)
    contents = page.Contents(
        scale=scale,
        table_2=tables.estimation(inputs.estimation),
        table_3=tables.prediction(inputs.prediction, settings.predictors),
        table_4=tables.prediction_voxels(inputs.prediction, settings.voxel_predictors),
        comparisons=tables.comparisons(inputs.comparisons),
        table_5=tables.position(inputs.prediction, settings.predictors),
        table_6=planning_tables.planning(inputs.planning, inputs.intervals, settings.planners),
        table_7=planning_tables.planning_voxels(inputs.planning, inputs.intervals, settings.planners),
        planning_comparisons=planning_tables.comparisons(inputs.planning_comparisons, settings.planners),
        failures=planning_tables.failures(inputs.failures, settings.planners),
        largest=errors,
        camera_estimation=camera_tables.estimation(inputs.camera_estimation),
        camera_planning=camera_tables.planning(inputs.camera_planning),
        camera_comparisons=camera_tables.comparisons(inputs.camera_comparisons),
        sigma_ratio=tables.sigma_ratio(inputs.estimation, inputs.prediction),
        splits=tables.splits(inputs.dataset),
        attempts=tables.attempts(inputs.attempts),
        tasks={str(split): rows["sequence"].nunique() for split, rows in inputs.planning.groupby("split")},
        canonical=captions.canonical(inputs.canonical, inputs.voxels_canonical),
        figures=draw_figures(folder / "figures", inputs, errors, settings),
    )
    for name in TABLES:
        table = getattr(contents, name)
        table.to_csv(folder / "tables" / f"{name}.csv", index=False, float_format="%.5g", lineterminator="\n")
        (folder / "tables" / f"{name}.md").write_text(page.table(name, table))
    means = metrics.means(
        estimation=contents.table_2,
        prediction=contents.table_3,
        prediction_voxels=contents.table_4,
        position=contents.table_5,
        planning=contents.table_6,
        planning_voxels=contents.table_7,
        sigma_ratio=contents.sigma_ratio,
    )
    means.to_csv(folder / "metrics.csv", index=False, float_format="%.5g", lineterminator="\n")
    headline = metrics.headline(means, settings.planners)
    (folder / "metrics.json").write_text(json.dumps(headline, indent=1) + "\n")
    (folder / "plots").mkdir()
    for name, rows in plots(inputs.histories, inputs.calibration, contents.table_3, contents.table_6).items():
        rows.to_csv(folder / "plots" / f"{name}.csv", index=False, float_format="%.5g", lineterminator="\n")
    (folder / "README.md").write_text(page.page(contents))
    return contents


def draw_figures(folder: Path, inputs: Inputs, errors: pd.DataFrame, settings: ReportConfig) -> list[str]:
    """Draw every figure as `<name>.png`; the names. What no session is about is left out.

    `errors`: the table of the largest ones.
    """
    dataset, planner = inputs.dataset, settings.planners[0]
    sequences(dataset, folder / "sequences.png", count=settings.sequences)
    estimates(dataset, inputs.estimates, inputs.estimation, folder / "estimates.png", count=settings.estimates)
    predictions(dataset, inputs.predictions, inputs.prediction, folder / "predictions.png", count=settings.predictions)
    calibration(inputs.calibration, folder / "calibration.png")
    curves({net: inputs.histories[net] for net in NETS}, inputs.histories["vtm"], folder / "curves.png")
    conditions = list(dict.fromkeys(inputs.camera_comparisons["system"]))
    camera(dataset, inputs.pictures, inputs.estimates, conditions, folder / "camera.png")
    names = [
        "camera",
        "sequences",
        "estimates",
        "predictions",
        "calibration",
        "curves",
        *representations(folder, inputs),
    ]
    if not PREDICTOR_OF.keys().isdisjoint(settings.planners):
        scatter(inputs.planning, inputs.prediction, PREDICTOR_OF, settings.planners, folder / "scatter.png")
        names.append("scatter")
    rows = inputs.planning[inputs.planning["system"] == planner]
    of_main = inputs.prediction[inputs.prediction["better"] & (inputs.prediction["system"] == "main")]
    better = NETS.index(str(of_main["net"].iloc[0]))
    failed = []
    for row in errors.to_dict("records"):
        task = Task(row["sequence"], row["start"], row["length"])
        session = of_record(inputs.sessions, dataset, rows, task, net=better)
        if session is not None:
            failed.append(Failure(session, row["estimate_error"], row["expected"], row["diagnosis"]))
    if failed:
        largest(failed, folder / "largest.png")
        names.append("largest")
    test = np.unique(rows.loc[rows["split"] == "test", "sequence"]).tolist()
    for length, abreast in ABREAST.items():
        chosen: list[Session] = []
        for task in picked(test, dataset.length[test].tolist(), length):
            session = of_record(inputs.sessions, dataset, rows, task, net=better)
            if session is not None and len(chosen) < settings.sessions:
                chosen.append(session)
        if chosen:
            sessions(chosen, folder / f"sessions_{length}.png", abreast=abreast)
            names.append(f"sessions_{length}")
    return names


def representations(folder: Path, inputs: Inputs) -> list[str]:
    """Draw what states and manipulations are, from the first test sequences that serve; the names."""
    dataset, found = inputs.dataset, inputs.estimates
    test = dataset.indices("test").tolist()
    place = next(place for place, sequence in enumerate(found["sequence"]) if int(sequence) in test)
    sequence = int(found["sequence"][place])
    state = min(2, int(dataset.length[sequence]))
    label = int(found["label"][place, state])
    mean, std = (np.asarray(relabel(found[name][place, state], label)) for name in ("mean", "std"))
    meshes(dataset.vertices[sequence, state], mean, std, folder / "meshes.png")
    voxels(dataset.vertices[sequence, state], folder / "voxels.png")
    equivalents(dataset.vertices[sequence, 1], folder / "equivalents.png")
    # From a folded cloth if there is one: on the flat one, the silhouette says little.
    steps = [(sequence, step) for step in (1, 2, 0) for sequence in test if step < dataset.length[sequence]]
    examples = []
    for hands in (2, 1):
        chosen = next(((sequence, step) for sequence, step in steps if dataset.hands[sequence, step] == hands), None)
        if chosen is not None:
            examples.append(Example(dataset.vertices[chosen], dataset.manipulation[chosen]))
    trajectories(examples, folder / "trajectories.png")
    return ["meshes", "voxels", "trajectories", "equivalents"]


def picked(sequences: list[int], manipulations: list[int], length: int) -> list[Task]:
    """A task of that length of each sequence that has one, the starts in turn: examples that nobody chose."""
    found = []
    for place, (sequence, longest) in enumerate(zip(sequences, manipulations, strict=True)):
        tasks = [task for task in tasks_of(sequence, longest) if task.length == length]
        found += tasks[place % len(tasks) :][:1] if tasks else []
    return found
