"""One rollout for all models, as a loop or written out, and one place that decides what a net's model is."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.models import emd_voxel, pemd
from clothkit.models.canonical import MESHES, VOXELS, Canonicalised
from clothkit.models.emd_voxel import EMDVoxel
from clothkit.models.forward import ForwardModel, forward_model, predict, rollout
from clothkit.models.pemd import PEMD
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig
from tests.crumpled import crumpled

DATA = crumpled(4, 3)
PLAN = np.random.default_rng(1).uniform(-1, 1, (4, 3, 6)).astype(np.float32)
KINDS = [(kind, canonical) for kind in ("pemd", "emd_voxel") for canonical in (False, True)]


def model_of(kind: str, canonical: bool) -> tuple[ForwardModel, Any, Any]:
    """A model, weights and states."""
    if kind == "pemd":
        config = PEMDConfig(latent=3, encoder=(5,), manipulation=4, decoder=(5,), canonical=canonical)
        return forward_model(config), pemd.initial(config, key=jax.random.key(0)), jnp.asarray(DATA.vertices[:, 1])
    voxel = EMDVoxelConfig(latent=3, manipulation=4, dense=True, encoder=(5,), decoder=(5,), canonical=canonical)
    return forward_model(voxel), emd_voxel.initial(voxel, key=jax.random.key(0)), voxels.observe(DATA.vertices[:, 1])


class Adding:
    """A model whose states are numbers: a manipulation adds its first component, and the trace counts."""

    def encode(self, params: Any, state: Any, cloth: Any = None) -> Any:
        return jnp.asarray(state)[..., None] * params

    def step(self, params: Any, latent: Any, trace: Any, manipulation: Any) -> tuple[Any, Any, Any]:
        return latent + manipulation[..., :1] * (1 + trace), trace + 1, manipulation[..., 4:6]

    def decode(self, params: Any, latent: Any, stride: int = 1) -> Any:
        return latent[..., 0] / params


@pytest.mark.parametrize("unroll", [False, True])
def test_a_rollout_chains_steps_whatever_the_model(unroll: bool) -> None:
    """1 x 2 + m0 + 2 m1 + 3 m2 by hand, in two batch axes; a trace that is given counts on."""
    state, plan = np.array([[1.0, 2.0]], np.float32), np.zeros((1, 2, 3, 6), np.float32)
    plan[0, 0, :, 0], plan[0, 1, :, 0] = (1, 10, 100), (2, 20, 200)
    plan[..., 4:] = np.arange(12).reshape(1, 2, 3, 2)
    predicted, found = predict(Adding(), 2.0, state, plan, unroll=unroll)
    np.testing.assert_array_equal(found.latents[..., 0], [[[3, 6]], [[23, 46]], [[323, 646]]])
    np.testing.assert_array_equal(predicted, found.latents[..., 0] / 2)
    np.testing.assert_array_equal(found.traces[..., 0], [[[1, 1]], [[2, 2]], [[3, 3]]])
    np.testing.assert_array_equal(found.shifts[:, 0, 1], plan[0, 1, :, 4:])
    later = rollout(Adding(), 2.0, found.latents[0], plan[..., 1:, :], found.traces[0], unroll=unroll)
    np.testing.assert_array_equal(later.latents, found.latents[1:])


@pytest.mark.parametrize(("kind", "canonical"), KINDS)
def test_a_loop_computes_what_written_out_steps_do(kind: str, canonical: bool) -> None:
    model, params, states = model_of(kind, canonical)
    loop, written = (
        jax.jit(lambda p, unroll=unroll: predict(model, p, states, PLAN, unroll=unroll))(params)
        for unroll in (False, True)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6), loop, written)


@pytest.mark.parametrize(("kind", "canonical"), KINDS)
def test_the_configuration_decides_whether_a_model_is_wrapped(kind: str, canonical: bool) -> None:
    model, params, states = model_of(kind, canonical)
    assert isinstance(model, ForwardModel)
    assert isinstance(model, Canonicalised) == canonical
    bare = model.model if isinstance(model, Canonicalised) else model
    assert isinstance(bare, PEMD if kind == "pemd" else EMDVoxel)
    # Equal configurations make equal models: a jitted function that takes one is compiled once.
    again, _, _ = model_of(kind, canonical)
    assert (again, hash(again)) == (model, hash(model))
    assert model.encode(params, states).shape == (4, 3 + 5 * canonical)


@pytest.mark.parametrize(("kind", "description"), [("pemd", MESHES), ("emd_voxel", VOXELS)])
def test_a_wrapped_model_is_the_model_of_described_states(kind: str, description: Any) -> None:
    """What it predicts is what the model within predicts of the described state, undone."""
    model, params, states = model_of(kind, True)
    assert isinstance(model, Canonicalised)
    predicted, found = predict(model, params, states, PLAN)
    frame = description.frame(states)
    per_step = jax.tree.map(lambda part: jnp.repeat(part[:, None], 3, axis=1), frame)
    within, inner = predict(
        model.model, params, description.state(states, frame), description.manipulation(jnp.asarray(PLAN), per_step)
    )
    after_each = jax.tree.map(lambda part: jnp.stack([part] * 3), frame)
    expected = description.undone(within, after_each)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-5), predicted, expected)
    np.testing.assert_array_equal(found.traces[..., :3], inner.traces)
    np.testing.assert_allclose(np.einsum("snji,snj->sni", after_each.matrix, inner.shifts), found.shifts, atol=1e-6)
