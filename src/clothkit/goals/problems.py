"""What is evaluated: named goals of cloths that lie flat, dragged or crumpled, all at some angle."""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from clothkit.cloth.silhouette import centre
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import Topology
from clothkit.dataset.store import STEPS
from clothkit.evaluation.errors import labels_of_truth
from clothkit.goals.making import Made
from clothkit.goals.settings import EvaluateGoalsConfig, StartName
from clothkit.goals.starts import Laid, cloth_of, cloths_of, start_of
from clothkit.goals.store import made_all
from clothkit.goals.variants import Variant, angle_of, lay, placed
from clothkit.manipulation.named_folds import GOALS
from clothkit.runtime.errors import InputError
from clothkit.runtime.resumable import array_storage, resumable_map
from clothkit.simulation.cloths import Cloths
from clothkit.simulation.settings import SimulateConfig

LAID = array_storage(Laid)


class Problem(NamedTuple):
    """A named goal of a cloth that lies in some way."""

    name: str
    start: StartName
    repeat: int
    mesh: Float[np.ndarray, "u v 3"]
    """The cloth as it lies at first, at its place on the table [normalised]."""
    angle: float
    """By how much it lies turned, and its goal with it [rad]."""
    made: Made
    topology: Topology
    cloths: Cloths
    """Its cloth, a single row."""

    @property
    def length(self) -> int:
        """How many manipulations there are: as many as the goal needs, from a crumpled cloth at least STEPS."""
        needed = GOALS[self.name].manipulations
        return max(needed, STEPS) if self.start == "crumpled" else needed

    @property
    def goal(self) -> Float[np.ndarray, "u v 3"]:
        """The goal's mesh, turned as the cloth lies; normalised and centred."""
        return placed(self.made, Variant(angle=self.angle))

    @property
    def flat(self) -> Float[np.ndarray, "u v 3"]:
        """The flat cloth, in the goal's labels, turned as the cloth lies and with its centre where that of the cloth is
        [normalised]."""
        return lay(self.made.states[0], self.angle) + np.append(centre(self.mesh), np.float32(0))

    @property
    def flattened(self) -> Float[np.ndarray, "u v 3"]:
        """The same in the labels of the cloth that lies there: each of its points as near as it can be."""
        flat = self.flat
        k = labels_of_truth(flat[None], self.mesh[None], topology=self.topology)[0]
        return np.asarray(relabel(flat, int(k), self.topology))


def problems(settings: EvaluateGoalsConfig, simulate: SimulateConfig, *, work: Path, goals: Path) -> list[Problem]:
    """All problems, repeat by repeat.

    Starts are kept in `work`, from which an interrupted run resumes, and goals in `goals`. A goal that can't be made of
    a cloth that was drawn is left out; a notice on stderr says so.
    """
    repeats = range(settings.repeats)
    keys = [(repeat, start) for repeat in repeats for start in settings.starts]
    with tqdm(total=len(keys), desc="starts", unit="cloth") as bar:
        pieces = resumable_map(
            lambda key: start_of(*key, settings, simulate),
            keys,
            folder=work,
            name="start",
            storage=LAID,
            bar=bar,
            count=lambda _: 1,
        )
        laid = {key: piece.value.mesh for key, piece in zip(keys, pieces, strict=True)}
    drawn = [cloth_of(repeat, settings, simulate) for repeat in repeats]
    chosen = [(repeat, name) for repeat in repeats for name in settings.goals]
    wanted = [(name, drawn[repeat].topology, drawn[repeat].simulation) for repeat, name in chosen]
    found = []
    who: Any = {"workers": simulate.workers, "executor": simulate.executor, "scheduler": simulate.scheduler}
    for (repeat, name), made in zip(chosen, made_all(wanted, folder=goals, **who), strict=True):
        if isinstance(made, InputError):
            print(f"notice: repeat {repeat}: {made}; left out", file=sys.stderr)
            continue
        for start in settings.starts:
            mesh, topology = laid[repeat, start], drawn[repeat].topology
            angle = angle_of(mesh, topology)
            found.append(Problem(name, start, repeat, mesh, angle, made, topology, cloths_of(drawn[repeat], 1)))
    return found


def joined(cloths: list[Cloths]) -> Cloths:
    """The rows of all cloths."""
    return Cloths(*(np.concatenate(parts) for parts in zip(*cloths, strict=True)))
