"""Whether an estimate agrees with the observation that it was made from, in numbers and in words."""

from typing import NamedTuple

import click
import numpy as np

from clothkit.app.given import Seen, Settings
from clothkit.app.planner import State, mesh_of
from clothkit.estimation.agreement import agreement
from clothkit.planning.systems import System


class Explained(NamedTuple):
    """Agreement of an estimate with its observation, and a sentence that states it."""

    silhouette_iou: float
    """Intersection over union of the voxel columns that hold cloth."""
    height_iou: float
    """Intersection over union of the occluded voxels, which fill the columns up to the surface."""
    explains: bool
    """Whether both reach the thresholds of `app.agreement`."""
    words: str


def explained(seen: Seen, mesh: State, settings: Settings) -> Explained:
    """Compare an estimated mesh [normalised, centred] with the voxels that it was estimated from."""
    found = agreement(mesh.astype(np.float32), seen.observation.voxels, height=settings.app.cloud.height)
    least = settings.app.agreement
    silhouette, heights = float(found.silhouette), float(found.heights)
    figures = f"silhouette IoU {silhouette:.2f}, height IoU {heights:.2f}"
    if found.explains(least):
        words = f"{seen.file}: the estimate explains what was seen ({figures})"
        return Explained(silhouette, heights, True, words)
    words = (
        f"{seen.file}: the estimate does not explain what was seen ({figures}, expected at least "
        f"{least.silhouette:.2f} and {least.heights:.2f}): the net doesn't know such a state, and what follows from it "
        "can't be relied on"
    )
    return Explained(silhouette, heights, False, words)


def of_state(system: System, seen: Seen, estimate: State, settings: Settings) -> Explained | None:
    """Compare a system's estimate of a state with the observation; None if the system does not estimate states."""
    return None if system.voxels or system.true_meshes else explained(seen, estimate, settings)


def of_goal(system: System, seen: Seen, estimate: State, settings: Settings) -> Explained | None:
    """Compare a system's estimate of a goal with the observation; None if the goal was not estimated.

    Goals are estimated if the file holds no mesh and the system plans with meshes.
    """
    return None if system.voxels or mesh_of(seen) is not None else explained(seen, estimate, settings)


def warn(found: Explained | None) -> None:
    """Print a warning on stderr if an estimate does not explain its observation."""
    if found is not None and not found.explains:
        click.echo(f"warning: {found.words}", err=True)
