"""Whether an estimate agrees with the observation that it was made from, in numbers and in words."""

from typing import NamedTuple

import click
import numpy as np

from clothkit.app.inputs import Input, Settings
from clothkit.app.planner import State, load_vtm, mesh_of
from clothkit.estimation.agreement import AgreementConfig, agreement
from clothkit.estimation.alarms import MARGIN, Alarms
from clothkit.estimation.support import strangeness
from clothkit.models.vtm import hidden_units
from clothkit.planning.systems import System


class EstimateAgreement(NamedTuple):
    """Agreement of an estimate with its observation, whether the net knows the latter, and a sentence on both."""

    silhouette_iou: float
    """Intersection over union of the voxel columns that hold cloth."""
    height_iou: float
    """Intersection over union of the occluded voxels, which fill the columns up to the surface."""
    explains: bool
    """Whether both reach their thresholds."""
    sentence: str
    strangeness: float | None = None
    """How unlike the training data the voxels are; None if the nets come without alarms."""
    known: bool = True
    """Whether the net knows such voxels, and cloths of these sides and this thickness."""
    cloth_known: bool = True
    """Whether it knows the latter."""

    @property
    def reliable(self) -> bool:
        """Whether nothing speaks against the estimate."""
        return self.explains and self.known


def compare_estimate(source: Input, mesh: State, settings: Settings) -> EstimateAgreement:
    """Compare an estimated mesh [normalised, centred] with the voxels that it was estimated from.

    Thresholds are those of `app.agreement`, else those that came with the nets (`set_alarms`), else the defaults.
    """
    alarms, voxels = settings.alarms, source.observation.voxels
    agrees = agreement(mesh.astype(np.float32), voxels, viewport=settings.app.cloud.viewport)
    least = settings.app.agreement or (alarms.least if alarms else AgreementConfig())
    silhouette, heights, explains = float(agrees.silhouette), float(agrees.heights), bool(agrees.explains(least))
    figures, doubts, strange = f"silhouette IoU {silhouette:.2f}, height IoU {heights:.2f}", [], None
    cloth_known = True
    if not explains:
        named = (("silhouette", silhouette, least.silhouette), ("height", heights, least.heights))
        low = [
            f"{name} IoU {value:.3f}, expected at least {lowest:g}" for name, value, lowest in named if value < lowest
        ]
        doubts.append(f"the estimate does not explain what was seen ({'; '.join(low)})")
    if alarms:
        units = hidden_units(load_vtm(settings.data), voxels[None], source.cloth[None])
        strange = float(strangeness(np.asarray(units), alarms.support)[0])
        if strange > alarms.strangest:
            expected = f"expected at most {alarms.strangest:.1f}"
            doubts.append(f"the net has seen nothing like it (strangeness {strange:.1f}, {expected})")
        if not (cloth_known := bool(alarms.knows(source.cloth))):
            doubts.append(_unknown_cloth(source, alarms))
    sentence = f"the estimate explains what was seen ({figures})"
    if doubts:
        sentence = f"{', and '.join(doubts)}: what follows from it can't be relied on"
    known = len(doubts) == (not explains)
    sentence = f"{source.file}: {sentence}"
    return EstimateAgreement(silhouette, heights, explains, sentence, strange, known, cloth_known)


def _unknown_cloth(source: Input, alarms: Alarms) -> str:
    """What the net does not know of a cloth, and what it knows."""
    thickness, scale = float(source.cloth[2]), source.pose.scale
    low, high = alarms.cloths[0, 2] / MARGIN, float(alarms.thickest(source.cloth))
    longer, shorter = sorted((float(side) * scale for side in source.cloth[:2]), reverse=True)
    if not low <= thickness <= high:
        known = f"{1000 * low * scale:.1f} to {1000 * high * scale:.1f} mm"
        return (
            f"the net has seen no cloth of {longer:.3g} x {shorter:.3g} m that is {1000 * thickness * scale:.1f} "
            f"mm thick, but of {known} (--thickness)"
        )
    return f"the net has seen no cloth with such different sides, {longer:.3g} and {shorter:.3g} m"


def compare_state(system: System, source: Input, estimate: State, settings: Settings) -> EstimateAgreement | None:
    """Compare a system's estimate of a state with the observation; None if the system does not estimate states."""
    return None if system.voxels or system.true_meshes else compare_estimate(source, estimate, settings)


def compare_goal(system: System, source: Input, estimate: State, settings: Settings) -> EstimateAgreement | None:
    """Compare a system's estimate of a goal with the observation; None if the goal was not estimated.

    Goals are estimated if the file holds no mesh and the system plans with meshes.
    """
    return None if system.voxels or mesh_of(source) is not None else compare_estimate(source, estimate, settings)


def warn(found: EstimateAgreement | None) -> None:
    """Print a warning on stderr if something speaks against an estimate."""
    if found is not None and not found.reliable:
        click.echo(f"warning: {found.sentence}", err=True)
