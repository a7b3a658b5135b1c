"""The systems of section 6.3 by name: the representation, the number of nets and the variations of each."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from clothkit.errors import InputError
from clothkit.models.store import validation_score


@dataclass(frozen=True)
class System:
    """A variant of the planner, shown as one group of rows in table 6. All systems share the planner's code."""

    name: str
    true_meshes: bool = False
    """Whether the true mesh is used instead of an estimate. The goal's labels are then known too."""
    voxels: bool = False
    """Whether states are voxels, for the voxel EM*D."""
    refine: bool = True
    """Whether estimates are refined. In the paper leaving that out "was observed to significantly harm planning
    performance" (section 4.7); in the `laptop` report no difference was found in mean errors by plan length."""
    nets: int = 2
    """With two nets the loss is eq. (13); with one it is the NLL of the net with the better validation score."""
    alpha: float | None = None
    """Weight of the uncertainty term; None means the value of params.yaml."""

    @property
    def estimates(self) -> bool:
        """Whether the system estimates meshes from voxels."""
        return not (self.voxels or self.true_meshes)


SYSTEMS = {
    system.name: system
    for system in (
        System("main"),
        System("b1", true_meshes=True),
        System("b2", nets=1),
        System("b3", alpha=0.0),
        System("b4", voxels=True),
        System("b5", voxels=True, nets=1),
        System("unrefined", refine=False),
    )
}


def system(name: str) -> System:
    """The system of that name. Raises InputError if there is none."""
    if name not in SYSTEMS:
        raise InputError(f"system: expected one of {', '.join(SYSTEMS)}, found {name!r}")
    return SYSTEMS[name]


def better_net(folders: Mapping[str, Path]) -> str:
    """The name of the net with the lowest validation score; of equal ones, the first in alphabetical order.

    Raises InputError if a net's description can't be read or has no score.
    """
    scores = {name: validation_score(folder) for name, folder in sorted(folders.items())}
    return min(scores, key=scores.__getitem__)
