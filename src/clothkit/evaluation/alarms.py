"""Thresholds of alarms, set on the validation split: how often may a state that the nets know raise one?"""

import numpy as np
from tqdm import tqdm

from clothkit.dataset.store import STATES, Dataset
from clothkit.estimation.alarms import Alarms, chosen, signs
from clothkit.estimation.refine import RefineConfig
from clothkit.estimation.support import Support
from clothkit.evaluation.camera import NO_CAMERA, observe
from clothkit.evaluation.camera_settings import EvaluateCameraConfig, SetAlarmsConfig
from clothkit.models.net import Net


def set_alarms(
    net: Net,
    dataset: Dataset,
    settings: SetAlarmsConfig,
    *,
    support: Support,
    camera: EvaluateCameraConfig,
    refinement: RefineConfig,
) -> Alarms:
    """The strictest alarms that at most `settings.share` of the validation states raise under every condition."""
    training = dataset.of_split("train")
    validation = dataset.of_split("validation").take(slice(settings.sequences))
    row, state = np.nonzero(np.arange(STATES) <= validation.length[:, None])
    truth, cloth = validation.vertices[row, state], validation.cloth[row]
    known = []
    for condition in tqdm((NO_CAMERA, *settings.conditions), desc="conditions"):
        found = observe(truth, cloth, net, condition, camera, refinement, stored=[])
        seen = found.voxels.any((1, 2, 3))
        known.append(signs(net, support, found.voxels[seen], found.mesh[seen], cloth[seen]))
    cloths = np.stack([training.cloth.min(axis=0), training.cloth.max(axis=0)])
    return chosen(known, support, cloths, share=settings.share)
