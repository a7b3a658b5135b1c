"""Whether estimates explain what was seen, in numbers and in words."""

from typing import NamedTuple

import click
import numpy as np

from clothkit.app.given import Seen, Settings
from clothkit.app.planner import Believed, mesh_of
from clothkit.estimation.agreement import agreement
from clothkit.planning.systems import System


class Explained(NamedTuple):
    """How far an estimate agrees with what was seen, and what to say of it."""

    silhouette_iou: float
    """Of the columns of voxels that hold cloth."""
    height_iou: float
    """Of all that lies below the surface."""
    explains: bool
    """Whether both are as high as is usual for estimates that can be relied on (`app.agreement`)."""
    words: str


def explained(seen: Seen, mesh: Believed, settings: Settings) -> Explained:
    """How far a mesh that was estimated [normalised, centred] explains the voxels that it was estimated from."""
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


def of_state(system: System, seen: Seen, believed: Believed, settings: Settings) -> Explained | None:
    """The same for what a system takes a state for; None where it takes it as it is, and estimates nothing."""
    return None if system.voxels or system.true_meshes else explained(seen, believed, settings)


def of_goal(system: System, seen: Seen, believed: Believed, settings: Settings) -> Explained | None:
    """The same for a goal: it is estimated where the file holds no mesh."""
    return None if system.voxels or mesh_of(seen) is not None else explained(seen, believed, settings)


def warn(found: Explained | None) -> None:
    """Say on stderr that an estimate does not explain what was seen, if it doesn't."""
    if found is not None and not found.explains:
        click.echo(f"warning: {found.words}", err=True)
