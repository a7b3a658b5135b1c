"""Whether an estimate agrees with the observation that it was made from, in numbers and in words."""

from typing import NamedTuple

import click
import numpy as np

from clothkit.app.inputs import Input, Settings
from clothkit.app.planner import State, mesh_of
from clothkit.estimation.agreement import agreement
from clothkit.planning.systems import System


class EstimateAgreement(NamedTuple):
    """Agreement of an estimate with its observation, and a sentence that states it."""

    silhouette_iou: float
    """Intersection over union of the voxel columns that hold cloth."""
    height_iou: float
    """Intersection over union of the occluded voxels, which fill the columns up to the surface."""
    explains: bool
    """Whether both reach the thresholds of `app.agreement`."""
    sentence: str


def compare_estimate(source: Input, mesh: State, settings: Settings) -> EstimateAgreement:
    """Compare an estimated mesh [normalised, centred] with the voxels that it was estimated from."""
    found = agreement(mesh.astype(np.float32), source.observation.voxels, viewport=settings.app.cloud.viewport)
    least = settings.app.agreement
    silhouette, heights = float(found.silhouette), float(found.heights)
    figures = f"silhouette IoU {silhouette:.2f}, height IoU {heights:.2f}"
    if found.explains(least):
        sentence = f"{source.file}: the estimate explains what was seen ({figures})"
        return EstimateAgreement(silhouette, heights, True, sentence)
    sentence = (
        f"{source.file}: the estimate does not explain what was seen ({figures}, expected at least "
        f"{least.silhouette:.2f} and {least.heights:.2f}): the net doesn't know such a state, and what follows from it "
        "can't be relied on"
    )
    return EstimateAgreement(silhouette, heights, False, sentence)


def compare_state(system: System, source: Input, estimate: State, settings: Settings) -> EstimateAgreement | None:
    """Compare a system's estimate of a state with the observation; None if the system does not estimate states."""
    return None if system.voxels or system.true_meshes else compare_estimate(source, estimate, settings)


def compare_goal(system: System, source: Input, estimate: State, settings: Settings) -> EstimateAgreement | None:
    """Compare a system's estimate of a goal with the observation; None if the goal was not estimated.

    Goals are estimated if the file holds no mesh and the system plans with meshes.
    """
    return None if system.voxels or mesh_of(source) is not None else compare_estimate(source, estimate, settings)


def warn(found: EstimateAgreement | None) -> None:
    """Print a warning on stderr if an estimate does not explain its observation."""
    if found is not None and not found.explains:
        click.echo(f"warning: {found.sentence}", err=True)
