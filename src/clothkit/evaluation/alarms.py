"""Thresholds of alarms, set on the validation split: how often may a state that the nets know raise one?"""

import jax
import numpy as np
from jaxtyping import Bool, Float
from tqdm import tqdm

from clothkit.dataset.store import STATES, Dataset
from clothkit.estimation.agreement import agreement
from clothkit.estimation.alarms import Alarms, Signs, chosen
from clothkit.estimation.refine import RefineConfig
from clothkit.estimation.support import Support, fit, strangeness
from clothkit.evaluation.camera import NO_CAMERA, observe
from clothkit.evaluation.camera_settings import EvaluateCameraConfig, SetAlarmsConfig
from clothkit.models.net import Net
from clothkit.models.vtm import hidden_units
from clothkit.planning.batches import in_batches
from clothkit.training.settings import TrainVtMConfig
from clothkit.training.vtm import drawn, states

BATCH = 64


def support_of(net: Net, training: Dataset, trained: TrainVtMConfig, *, examples: int, seed: int) -> Support:
    """The support of a net: its hidden units for examples like those that it was trained on."""
    data = states(training)

    @jax.jit
    def units(key: jax.Array) -> jax.Array:
        _, seen, cloth = drawn(data, trained, key=key)
        return hidden_units(net, seen, cloth)

    keys = jax.random.split(jax.random.key(seed), -(-examples // trained.training.batch))
    return fit(np.concatenate([np.asarray(units(key)) for key in keys])[:examples])


def signs(
    net: Net,
    support: Support,
    voxels: Bool[np.ndarray, "states x y z"],
    mesh: Float[np.ndarray, "states u v 3"],
    cloth: Float[np.ndarray, "states 3"],
) -> Signs:
    """The signs of observed voxels and the refined meshes that are estimated from them."""

    def units(voxels: np.ndarray, cloth: np.ndarray) -> jax.Array:
        return hidden_units(net, voxels, cloth)

    agrees = agreement(mesh, voxels, viewport=net.config.viewport)
    return Signs(agrees, strangeness(in_batches(units, BATCH, voxels, cloth), support))


def set_alarms(
    net: Net,
    dataset: Dataset,
    settings: SetAlarmsConfig,
    *,
    trained: TrainVtMConfig,
    camera: EvaluateCameraConfig,
    refinement: RefineConfig,
) -> Alarms:
    """The strictest alarms that at most `settings.share` of the validation states raise under every condition."""
    training = dataset.of_split("train")
    support = support_of(net, training, trained, examples=settings.examples, seed=settings.seed)
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
