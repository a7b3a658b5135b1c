"""The systems of section 6.3 by name: what each sees, and how many nets it plans with."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from clothkit.errors import InputError
from clothkit.networks.store import validation_score


@dataclass(frozen=True)
class System:
    """One row group of table 6. All share one planner."""

    name: str
    true_meshes: bool = False
    """Whether the true mesh takes the place of the estimate; then the goal's labels are known too."""
    voxels: bool = False
    """Whether states are voxels, for the voxel EM*D."""
    refine: bool = True
    """Whether estimates are refined. In the paper leaving that out "was observed to significantly harm planning
    performance" (section 4.7); in the `laptop` report no difference was found in mean errors by plan length."""
    nets: int = 2
    """Two: eq. (13). One: the NLL of the net with the better validation score."""
    alpha: float | None = None
    """A weight of the uncertainty term that this system is about; None takes that of params.yaml."""

    @property
    def estimates(self) -> bool:
        """Whether it makes meshes of voxels."""
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
    """The name of the net of the lowest validation score, the first of equals.

    Raises InputError if a net's description can't be read or holds no score.
    """
    scores = {name: validation_score(folder) for name, folder in sorted(folders.items())}
    return min(scores, key=scores.__getitem__)
