"""The systems of section 6.3 by name: the representation, the number of nets and the variations of each."""

from dataclasses import dataclass

from clothkit.models.store import Kind
from clothkit.runtime.errors import InputError


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
    single: bool = False
    """Whether only the net with the best validation score is used: the loss is its accuracy term alone then."""
    alpha: float | None = None
    """Weight of the uncertainty term; None means the value of params.yaml."""

    @property
    def kind(self) -> Kind:
        """The kind of the forward models' nets."""
        return "emd_voxel" if self.voxels else "pemd"

    @property
    def doubts(self) -> bool:
        """Whether its loss has an uncertainty term (`uncertainty_terms`)."""
        return not (self.single or self.alpha == 0)

    @property
    def estimates(self) -> bool:
        """Whether the system estimates meshes from voxels."""
        return not (self.voxels or self.true_meshes)


SYSTEMS = {
    system.name: system
    for system in (
        System("main"),
        System("b1", true_meshes=True),
        System("b2", single=True),
        System("b3", alpha=0.0),
        System("b4", voxels=True),
        System("b5", voxels=True, single=True),
        System("unrefined", refine=False),
    )
}


def system(name: str) -> System:
    """The system of that name. Raises InputError if there is none."""
    if name not in SYSTEMS:
        raise InputError(f"system: expected one of {', '.join(SYSTEMS)}, found {name!r}")
    return SYSTEMS[name]
