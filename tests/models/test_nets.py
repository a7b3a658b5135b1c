"""The nets against counts and forward passes made by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax.traverse_util import flatten_dict

from clothkit.cloth.mesh import ProbabilisticMesh, distance
from clothkit.cloth.symmetry import equivalents, relabel_batch
from clothkit.cloth.topology import SQUARE
from clothkit.models import pemd, store, vtm
from clothkit.models.forward import forward_model
from clothkit.models.hypotheses import Hypotheses
from clothkit.models.net import Net
from clothkit.models.settings import PEMDConfig, Start, VtMConfig
from tests.models.predicted import predicted_by

TINY = PEMDConfig(latent=3, encoder=(7, 6), manipulation=5, decoder=(4, 8))
MODEL = forward_model(TINY)


def sizes(config):
    return {name: int(np.prod(w.shape)) for name, w in flatten_dict(store.shapes(config), sep="/").items()}


def test_table_1_has_as_many_weights_as_counted_by_hand():
    weights = {name: size for name, size in sizes(PEMDConfig()).items() if name.endswith("kernel")}
    encoder = 3072 * 2048 + 2048 * 1024 + 1024 * 512
    manipulator = 14 * 1030 * 1024 + 1030 * 1026
    decoder = 512 * 1024 + 1024 * 2048 + 2048 * 6144
    skips = 6 * 1030 * 512
    plain = sum(size for name, size in weights.items() if "skip" not in name)
    assert plain == encoder + manipulator + decoder
    assert round(plain / 1e6, 1) == 39.9
    assert sum(weights.values()) == plain + skips
    assert round((plain + skips) / 1e6, 1) == 43.1


def test_vtm_has_seven_neuron_layers():
    weights = {name: size for name, size in sizes(VtMConfig()).items() if name.endswith("kernel")}
    assert sorted(weights.values()) == sorted([16384 * 4096, *[4096 * 4096] * 4, 4096 * 6144])


def random_net(config, seed):
    rng = np.random.default_rng(seed)
    return Net(config, jax.tree.map(lambda w: rng.normal(0, 0.4, w.shape).astype(np.float32), store.shapes(config)))


def by_hand(params, mesh, manipulations, channel, trace=None):
    """pEM*D as design 6.3 words it, one example, layer by layer; the first trace is zero."""

    def dense(layer, units):
        return units @ layer["kernel"] + layer.get("bias", 0)

    encoder, manipulator, decoder = params["E"], params["M"], params["D"]
    hidden = np.tanh(dense(encoder["layer_2"], np.tanh(dense(encoder["layer_1"], mesh.ravel()))))
    latent, trace = dense(encoder["latent"], hidden), np.zeros(channel) if trace is None else trace
    outcomes = []
    for manipulation in manipulations:
        layers = [np.concatenate([latent, trace, manipulation])]
        for i in range(1, 15):
            incoming = dense(manipulator[f"layer_{i}"], layers[i - 1])
            if i in (4, 6, 8, 10, 12, 14):
                incoming[:channel] += layers[i - 2] @ manipulator[f"skip_{i - 2}_{i}"]["kernel"]
            units = np.tanh(incoming)
            units[:channel] += layers[i - 1][:channel]
            layers.append(np.concatenate([units, manipulation]))
        output = dense(manipulator["layer_15"], layers[14])
        latent = np.tanh(output[:channel]) + layers[14][:channel]
        trace, shift = np.tanh(output[channel : 2 * channel]), output[2 * channel :]
        hidden = np.tanh(dense(decoder["layer_2"], np.tanh(dense(decoder["layer_1"], latent))))
        units = dense(decoder["mesh"], hidden).reshape(*SQUARE.shape, 6)
        outcomes.append((units[..., :3], np.exp(units[..., 3:]) + 0.01, trace, shift))
    return [np.stack(values) for values in zip(*outcomes, strict=True)]


def test_rollout_is_the_forward_pass_by_hand():
    net, rng = random_net(TINY, 0), np.random.default_rng(1)
    mesh = rng.uniform(-0.05, 0.05, (2, *SQUARE.shape, 3)).astype(np.float32)
    manipulations = rng.uniform(-1, 1, (2, 3, 6)).astype(np.float32)
    predicted, found = predicted_by(net, mesh, manipulations)
    for example in range(2):
        mean, std, trace, shift = by_hand(net.params, mesh[example], manipulations[example], TINY.latent)
        np.testing.assert_allclose(predicted.mean[:, example], mean, atol=2e-4)
        np.testing.assert_allclose(predicted.std[:, example], std, rtol=2e-4)
        np.testing.assert_allclose(found.traces[:, example], trace, atol=2e-4)
        np.testing.assert_allclose(found.shifts[:, example], shift, atol=2e-4)


def test_steps_chain_to_a_rollout_and_a_rollout_goes_on_from_its_trace():
    net, rng = random_net(TINY, 2), np.random.default_rng(3)
    mesh = rng.uniform(-0.05, 0.05, (*SQUARE.shape, 3)).astype(np.float32)
    manipulations = rng.uniform(-1, 1, (2, 6)).astype(np.float32)
    predicted, found = predicted_by(net, mesh, manipulations)
    latent, trace = MODEL.encode(net.params, mesh), np.zeros(TINY.latent, np.float32)
    for i in range(2):
        latent, trace, shift = MODEL.step(net.params, latent, trace, manipulations[i])
        np.testing.assert_allclose(latent, found.latents[i], atol=1e-5)
        np.testing.assert_allclose(MODEL.decode(net.params, latent).mean, predicted.mean[i], atol=1e-5)
        np.testing.assert_allclose(shift, found.shifts[i], atol=1e-5)
    resumed, again = predicted_by(net, mesh, manipulations[1:], found.traces[0])
    mean, std, trace, moved = by_hand(net.params, mesh, manipulations[1:], TINY.latent, np.asarray(found.traces[0]))
    np.testing.assert_allclose(resumed.mean, mean, atol=2e-4)
    np.testing.assert_allclose(resumed.std, std, rtol=2e-4)
    np.testing.assert_allclose(again.traces, trace, atol=2e-4)
    np.testing.assert_allclose(again.shifts, moved, atol=2e-4)
    forgetful, _, _, _ = by_hand(net.params, mesh, manipulations[1:], TINY.latent)
    assert np.abs(mean - forgetful).max() > 0.01


def test_vtm_is_the_forward_pass_by_hand():
    config = VtMConfig(hidden=6)
    net, rng = random_net(config, 4), np.random.default_rng(5)
    voxels = rng.uniform(size=(32, 32, 16)) < 0.05
    units = voxels.astype(np.float32).ravel()
    for i in range(1, 6):
        units = np.tanh(units @ net.params[f"layer_{i}"]["kernel"] + net.params[f"layer_{i}"]["bias"])
    units = (units @ net.params["mesh"]["kernel"] + net.params["mesh"]["bias"]).reshape(*SQUARE.shape, 6)
    estimate = vtm.estimate(net, voxels)
    np.testing.assert_allclose(estimate.mean, units[..., :3], atol=1e-4)
    np.testing.assert_allclose(estimate.std, np.exp(units[..., 3:]) + 0.01, rtol=1e-4)


def nearly_flat(views):
    """A net that says of everything that it is nearly flat."""
    net = random_net(VtMConfig(hidden=6, views=views), 4)
    bias = np.concatenate([SQUARE.flat(), np.full((*SQUARE.shape, 3), -3.0, np.float32)], axis=-1)
    return replace(
        net, params={**net.params, "mesh": {"kernel": 0.02 * net.params["mesh"]["kernel"], "bias": bias.ravel()}}
    )


def test_what_eight_views_show_turns_with_the_voxels():
    net, seen = nearly_flat(8), np.random.default_rng(5).uniform(size=(2, 32, 32, 16)) < 0.05
    plain = vtm.estimate(net, seen)
    for k in range(8):
        turned = vtm.estimate(net, equivalents(seen)[k])
        back = [vtm.turned_back(part, k) for part in turned]
        labels = jnp.argmin(distance(equivalents(back[0]), plain.mean), axis=0)
        np.testing.assert_allclose(relabel_batch(back[0], labels), plain.mean, atol=1e-5)
        np.testing.assert_allclose(jnp.abs(relabel_batch(back[1], labels)), plain.std, atol=1e-5)


def test_eight_views_are_a_mixture_of_what_each_shows():
    seen = np.random.default_rng(5).uniform(size=(32, 32, 16)) < 0.05
    mixed, one = vtm.estimate(nearly_flat(8), seen), nearly_flat(1)
    means, squares, weights = [], [], []
    for quarters in range(4):
        for mirrored in (False, True):
            view = np.rot90(np.flip(seen, 0) if mirrored else seen, quarters)
            mean, std = (np.array(part) for part in vtm.estimate(one, view))
            # A quarter turn takes the first axis to the second, x to y.
            for _ in range(quarters):
                mean = np.stack([mean[..., 1], -mean[..., 0], mean[..., 2]], -1)
                std = std[..., [1, 0, 2]]
            mean = mean * [-1, 1, 1] if mirrored else mean
            candidates = [np.rot90(np.flip(mean, 0) if f else mean, q) for q in range(4) for f in (False, True)]
            stds = [np.rot90(np.flip(std, 0) if f else std, q) for q in range(4) for f in (False, True)]
            best = int(np.argmin([np.linalg.norm(c - SQUARE.flat(), axis=-1).mean() for c in candidates]))
            means.append(candidates[best])
            squares.append(stds[best] ** 2 + candidates[best] ** 2)
            weights.append(np.exp(np.log(std.astype(float)).mean()) ** -vtm.SURENESS)
    mean = np.average(means, axis=0, weights=weights)
    np.testing.assert_allclose(mixed.mean, mean, atol=1e-5)
    variance = np.average(squares, axis=0, weights=weights) - mean**2
    np.testing.assert_allclose(mixed.std, np.sqrt(variance), atol=1e-4)


def test_of_views_that_disagree_the_surest_counts():
    apart = [SQUARE.flat(), 0.5 * SQUARE.flat()]
    views = [
        Hypotheses(ProbabilisticMesh(mean[None], np.full_like(mean, std)[None]), np.ones(1))
        for mean, std in zip(apart, (0.1, 0.02), strict=True)
    ]
    found = vtm.averaged(views).mesh
    np.testing.assert_allclose(found.mean[0], apart[1], atol=1e-3)
    np.testing.assert_allclose(found.std[0], 0.02, rtol=0.05)
    assert np.asarray(vtm.averaged([views[0], views[0]]).mesh.std) == pytest.approx(0.1)


def test_start_scales_what_writes_into_the_channel_and_sets_sigma():
    glorot, fast = (
        pemd.initial(TINY, start, key=jax.random.key(0))
        for start in (Start(), Start(residual=0.3, output=0.1, sigma=-3.0))
    )
    layer = [np.asarray(weights["M"]["layer_5"]["kernel"]) for weights in (glorot, fast)]
    np.testing.assert_allclose(layer[1][:, :3], 0.3 * layer[0][:, :3], rtol=1e-6)
    np.testing.assert_array_equal(layer[1][:, 3:], layer[0][:, 3:])
    skip = [np.asarray(weights["M"]["skip_2_4"]["kernel"]) for weights in (glorot, fast)]
    np.testing.assert_allclose(skip[1], 0.3 * skip[0], rtol=1e-5)
    assert np.all(np.asarray(glorot["D"]["mesh"]["bias"]) == 0)
    np.testing.assert_array_equal(np.asarray(fast["D"]["mesh"]["bias"]).reshape(-1, 6)[0], [0, 0, 0, -3, -3, -3])


def test_a_hidden_layer_narrower_than_the_channel_is_refused():
    with pytest.raises(ValueError, match="manipulation"):
        PEMDConfig(latent=8, manipulation=4)
