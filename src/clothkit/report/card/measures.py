"""Measures of states: names, units for display, which end of the range is worse, and the limits of acceptance."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from clothkit.cloth.voxels import HEIGHT
from clothkit.manipulation.vector import SHORTEST
from clothkit.report.card.meanings import flatten


@dataclass(frozen=True)
class Measure:
    """A column of the tidy rows, as the card shows it: multiplied by `factor` to be in `unit`."""

    name: str
    label: str
    unit: str = ""
    factor: float = 1.0
    worst: str = "max"
    """The end of the distribution that is worse: max or min."""

    @property
    def title(self) -> str:
        """Label and unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


QUALITY = (
    Measure("height", "height", "normalised"),
    Measure("strain_p99", "strain, 99th percentile", "%", 100.0),
    Measure("strain_worst", "strain, worst edge", "%", 100.0),
    Measure("gap", "gap between layers", "mm", 1000.0, worst="min"),
    Measure("residual_speed", "residual speed", "mm/s", 1000.0),
    Measure("intersections", "intersections"),
    Measure("settle_time", "settle time", "s"),
)
"""Measures of the quality of every state after the first."""

SHAPE = (Measure("folds", "folds"), Measure("area", "silhouette area", "flat cloth's"))
"""Measures of how much a cloth is folded; neither end is worse."""

MOVE = Measure("length", "displacement", "normalised", worst="min")

HISTOGRAMS = (*(m for m in QUALITY if m.name != "intersections"), *SHAPE, MOVE)

WORST = {
    "strain_worst": "strain: worst edge",
    "strain_p99": "strain: 99th percentile",
    "gap": "smallest gap",
    "height": "highest",
    "residual_speed": "fastest at rest",
}
"""Measures by which the worst states are chosen, with their titles in the picture."""


def of_name(name: str) -> Measure:
    """The measure of a column."""
    return next(m for m in (*QUALITY, *SHAPE, MOVE) if m.name == name)


def limits(params: Mapping[str, Any]) -> dict[str, float]:
    """Limits of acceptance by column, in the files' units: those in the artifacts' settings, and the null length.

    The limit of gaps is a share of the thickness: where each sequence draws its own, it is no one length and left out.
    """
    stated = params.get("limits")
    stated = stated if isinstance(stated, Mapping) else {}
    found = {m.name: float(stated[m.name]) for m in QUALITY if isinstance(stated.get(m.name), int | float)}
    told = flatten(params)
    share, thickness = found.pop("gap", None), told.get("simulation.material.thickness")
    if share is not None and thickness is not None and told.get("variation.thickness") is None:
        found["gap"] = share * thickness
    return {**found, MOVE.name: SHORTEST}


def highest(limits: Mapping[str, float]) -> float:
    """The greatest height that a state may have [normalised]; that of the paper's viewport where no limit is known."""
    return limits.get("height", HEIGHT)
