"""Sessions that were never planned, of the toy world: what the viewer is given to play."""

import shutil
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd

from clothkit.app.viewer.session import Session, ShownPlan, StateEstimate, Step, error_of
from clothkit.cloth.silhouette import centred
from clothkit.cloth.symmetry import relabel, relabel_manipulation
from clothkit.dataset import store
from clothkit.dataset.tasks import Task
from clothkit.episodes.record import Sessions, join, record, save, sizes_of, tasks_of_dataset
from tests.planning import toy
from tests.toy_dataset import dataset

LABELS = 5
"""The equivalent under which estimates come."""
PLAN = np.array([[-1, -1, 1, -1, 0.1, 0.7], [1, 1, 1, 1, -0.6, -0.4]], np.float32)
CANDIDATES = np.array([[-1, -1], [1, -1], [1, 1]], np.float32)


def after(mesh: np.ndarray, plan: np.ndarray, strength: float = 1.0) -> np.ndarray:
    """The centred states [m u v 3] that a plan leads to in the toy world."""
    states = []
    for manipulation in plan:
        mesh = centred(np.asarray(toy.dragged(jnp.asarray(mesh), jnp.asarray(manipulation), strength)))[0]
        states.append(mesh)
    return np.stack(states).astype(np.float32)


def session() -> Session:
    """Two manipulations; the first plan leads to the goal, net 1 is a bit off, and the second plan leads nowhere."""
    states = [centred(toy.bent())[0]]
    states += list(after(states[0], PLAN))
    steps = []
    for i, end in enumerate((1, 0)):
        plan = PLAN[i:] if end else np.concatenate([CANDIDATES[0], CANDIDATES[0], [0.1, 0.1]])[None].astype(np.float32)
        means = np.stack([after(states[i], plan, strength) for strength in (1.0, 1.05)])
        shown = ShownPlan(
            manipulations=plan,
            members=(0, 1),
            means=means,
            sigmas=np.full_like(means, 0.01),
            uncertainty=0.1,
            loss=1.0,
            progress=np.array([3.0, 1.0], np.float32),
            tried=8,
            improves=bool(end),
            expected=0.02,
            expected_no_action=0.3,
        )
        steps.append(Step(StateEstimate(states[i], None, CANDIDATES), shown))
    return Session("made up", 2, states[2], tuple(states), tuple(steps))


def recorded(task: Task) -> Sessions:
    """A record of `session`'s sort for a task of the toy dataset, estimates under other labels."""
    planner = toy.planner("main")
    found = record(tasks_of_dataset(dataset(), [task], "test"), [], sizes_of(planner))
    n = task.length
    for i in range(n):
        plan = np.concatenate([PLAN, PLAN])[i:n]
        found.estimate[0, i] = relabel(found.state[0, i], LABELS)
        found.candidates[0, i, : len(CANDIDATES)] = _points(CANDIDATES)
        found.plan[0, i, : n - i] = relabel_manipulation(plan, LABELS)
        for net in range(2):
            means = after(found.state[0, i], plan, 1 + 0.05 * net)
            found.prediction_mean[0, i, : n - i, net] = relabel(means, LABELS)
            found.prediction_std[0, i, : n - i, net] = 0.01
        found.state[0, i + 1], found.centre[0, i + 1] = after(found.state[0, i], plan)[0], 0
        found.loss[0, i], found.terms[0, i], found.progress[0, i, :4] = 1.5, (0.5, 0.5, 0.25), (4, 3, 2, 1.5)
        found.null[0, i] = False
        # The goal has the labels of the true states.
        found.relative[0, i], found.expected[0, i] = LABELS, 0.05
    return found


def _points(points: np.ndarray) -> np.ndarray:
    both = np.concatenate([points, points, np.zeros_like(points)], axis=1)
    return np.asarray(relabel_manipulation(both, LABELS))[:, :2]


def fill(folder: Path, nets: Path) -> Path:
    """A data folder with the given nets, meshes of the toy world, and recorded sessions of system main."""
    shutil.copytree(nets, folder)
    data = dataset()
    store.save(folder / "meshes.zarr", data, {})
    every = join([recorded(Task(0, 0, 2)), recorded(Task(1, 1, 1))])
    evaluation = folder / "evaluation/planning"
    evaluation.mkdir(parents=True)
    save(evaluation / "sessions_main.zarr", [every], {"system": "main"})
    outcomes = every.state[np.arange(len(every)), every.length]
    errors = [error_of(outcome, goal) for outcome, goal in zip(outcomes, every.goal, strict=True)]
    columns = {name: getattr(every, name) for name in ("split", "sequence", "start", "length")}
    pd.DataFrame({**columns, "error": errors}).to_parquet(evaluation / "main.parquet")
    return folder


def with_sigma(shown: Session, sigma: np.ndarray) -> Session:
    """The session with a standard deviation of its first estimate."""
    first, *rest = shown.steps
    return shown._replace(steps=(first._replace(estimate=first.estimate._replace(sigma=sigma)), *rest))
