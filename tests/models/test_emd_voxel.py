"""The voxel EM*D: table maps, a forward pass by hand, the manipulations that it takes, what it is taught."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax.traverse_util import flatten_dict

from clothkit.cloth import voxels
from clothkit.cloth.symmetry import equivalent_cloths, equivalents, equivalents_of_manipulation
from clothkit.cloth.topology import SQUARE
from clothkit.manipulation.turns import planar
from clothkit.models import emd_voxel, pemd, store
from clothkit.models.emd_voxel import EMDVoxel, cartesian, initial
from clothkit.models.net import Net
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, Start
from clothkit.training.augment import Examples, turned
from clothkit.training.emd_voxel import (
    augment,
    cross_entropy,
    direction,
    losses,
    problem,
    task_differences,
    voxelised,
)
from clothkit.training.pemd import draw, sequences
from clothkit.training.settings import TrainEMDVoxelConfig, TrainingConfig
from tests.crumpled import crumpled
from tests.models import predicted

TINY = EMDVoxelConfig(latent=3, manipulation=5, width=0.04, encoder=(7, 6), decoder=(4, 8))
DENSE = replace(TINY, dense=True)
SEQUENCES = sequences(crumpled(6, 0))


predicted_by = jax.jit(predicted.predicted_by)


def shapes(config):
    return {name: w.shape for name, w in flatten_dict(store.shapes(config), sep="/").items()}


def test_the_papers_maps_and_resolutions():
    assert emd_voxel.resolutions() == [(32, 32, 16), (16, 16, 16), (8, 8, 8), (4, 4, 4), (2, 2, 2), (1,) * 3, (1,) * 3]
    found = shapes(EMDVoxelConfig())
    encoder = [found[f"E/layer_{i}/kernel"] for i in range(1, 6)] + [found["E/latent/kernel"]]
    assert [shape[-1] for shape in encoder] == [32, 32, 64, 128, 256, 512]
    assert [shape[:3] for shape in encoder] == [(3, 3, 3)] * 4 + [(2, 2, 2), (1, 1, 1)]
    decoder = [found[f"D/layer_{i}/kernel"] for i in range(1, 6)] + [found["D/voxels/kernel"]]
    assert decoder == encoder[::-1]
    # M is the mesh version's.
    mesh = shapes(PEMDConfig())
    assert {n: s for n, s in found.items() if n[0] == "M"} == {n: s for n, s in mesh.items() if n[0] == "M"}


def test_widths_are_rounded_and_at_least_one():
    assert emd_voxel.maps(replace(TINY, width=0.01)) == [1, 1, 1, 1, 1, 3, 3]
    assert emd_voxel.maps(replace(TINY, width=0.25)) == [1, 8, 8, 16, 32, 64, 3]


def random_net(config, seed):
    rng = np.random.default_rng(seed)
    return Net(config, jax.tree.map(lambda w: rng.normal(0, 0.4, w.shape).astype(np.float32), store.shapes(config)))


@pytest.mark.parametrize("config", [TINY, DENSE])
def test_steps_chain_to_a_rollout(config):
    net, rng = random_net(config, 2), np.random.default_rng(3)
    seen = rng.random((2, 32, 32, 16)) < 0.1
    manipulations = rng.uniform(-1, 1, (2, 2, 6)).astype(np.float32)
    made, found = predicted_by(net, seen, manipulations)
    assert made.shape == (2, 2, 32, 32, 16)
    model = EMDVoxel(config)
    step, encode, decode = (jax.jit(partial(part, net.params)) for part in (model.step, model.encode, model.decode))
    latent, trace = encode(seen.astype(np.float32)), np.zeros((2, 3), np.float32)
    for i in range(2):
        latent, trace, shift = step(latent, trace, manipulations[:, i])
        np.testing.assert_allclose(jax.nn.sigmoid(decode(latent)), jax.nn.sigmoid(made[i]), atol=1e-5)
        np.testing.assert_allclose(shift, found.shifts[i], atol=1e-4)
    # It goes on from the trace that it is given.
    resumed, again = predicted_by(net, seen, manipulations[:, 1:], found.traces[0])
    latent, trace, moved = step(encode(seen), found.traces[0], manipulations[:, 1])
    np.testing.assert_allclose(jax.nn.sigmoid(resumed[0]), jax.nn.sigmoid(decode(latent)), atol=1e-5)
    np.testing.assert_allclose(again.traces[0], trace, atol=1e-5)
    np.testing.assert_allclose(again.shifts[0], moved, atol=1e-4)
    _, forgetful = predicted_by(net, seen, manipulations[:, 1:])
    assert np.abs(forgetful.traces - again.traces).max() > 0.01


def test_the_dense_variant_is_the_forward_pass_by_hand():
    net = random_net(DENSE, 4)
    seen = np.random.default_rng(5).random((32, 32, 16)) < 0.1
    units = seen.ravel().astype(np.float32)
    for name in ("layer_1", "layer_2", "latent"):
        layer = net.params["E"][name]
        units = units @ layer["kernel"] + layer["bias"]
        units = np.tanh(units) if name != "latent" else units
    model = EMDVoxel(DENSE)
    latent = model.encode(net.params, seen)
    np.testing.assert_allclose(latent, units, rtol=1e-4, atol=1e-5)
    for name in ("layer_1", "layer_2", "voxels"):
        layer = net.params["D"][name]
        units = units @ layer["kernel"] + layer["bias"]
        units = np.tanh(units) if name != "voxels" else units
    np.testing.assert_allclose(model.decode(net.params, latent).ravel(), units, atol=1e-4)


@pytest.mark.parametrize("config", [TINY, DENSE])
def test_logits_start_at_their_bias_and_a_loaded_net_keeps_it(config, tmp_path):
    start = Start(output=1e-6, logit=-3.0)
    net = Net(config, initial(config, start, key=jax.random.key(0)))
    store.save(tmp_path / "net", net, store.pd.DataFrame({"score": [0.1]}), {"validation_score": 0.1})
    loaded = store.load(tmp_path / "net")
    assert loaded.config == config
    model, params = EMDVoxel(config), loaded.params
    found = jax.jit(lambda seen: model.decode(params, model.encode(params, seen)))(np.zeros((32, 32, 16), bool))
    np.testing.assert_allclose(found, -3.0, atol=1e-3)


def test_grasp_points_are_cartesian_about_the_centre_of_each_state():
    """On flat cloths, which lie centred, a geodesic point is 0.7 times itself, wherever the cloth was on the table."""
    manipulations = np.random.default_rng(0).uniform(-1, 1, (4, 3, 6)).astype(np.float32)
    found = cartesian(np.broadcast_to(SQUARE.flat(), (4, 3, 32, 32, 3)), manipulations)
    np.testing.assert_allclose(found[..., :4], 0.7 * manipulations[..., :4], atol=1e-6)
    np.testing.assert_array_equal(found[..., 4:], manipulations[..., 4:])


def test_later_grasp_points_are_clipped_to_the_viewport():
    wide = np.broadcast_to(2 * SQUARE.flat(), (3, 32, 32, 3))
    found = cartesian(wide, np.broadcast_to(np.array([1, -1, 0.5, 0, 1, 2], np.float32), (3, 6)))
    np.testing.assert_allclose(found[0], [1.4, -1.4, 0.7, 0, 1, 2], atol=1e-6)
    np.testing.assert_allclose(found[1:], [[1, -1, 0.7, 0, 1, 2]] * 2, atol=1e-6)


def test_cartesian_manipulations_do_not_depend_on_labels():
    mesh, manipulation = SEQUENCES.vertices[0, 2], SEQUENCES.manipulation[0, 2]
    found = cartesian(equivalents(mesh)[:, None], equivalents_of_manipulation(manipulation)[:, None])
    np.testing.assert_allclose(found, np.broadcast_to(found[:1], found.shape), atol=1e-5)


def examples(n=2, batch=3):
    return draw(SEQUENCES, n, batch, key=jax.random.key(0))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_voxels_and_grasp_points_turn_with_the_cloth(quarters, mirrored):
    """By right angles voxels map onto voxels: turned meshes give turned input, targets and grasp points."""
    before = examples()
    matrix = planar(jnp.full(3, quarters * jnp.pi / 2), jnp.full(3, mirrored))
    plain, after = (
        voxelised(e, noise=0.0, noise_z=0.0, key=jax.random.key(0)) for e in (before, turned(before, matrix))
    )

    def rotated(seen):
        seen = np.asarray(seen)
        return np.rot90(seen[..., ::-1, :, :] if mirrored else seen, quarters, axes=(-3, -2))

    # A few points lie on the border of two voxels, where rounding decides.
    assert np.mean(rotated(plain.state) != after.state) < 1e-4
    assert np.mean(rotated(plain.outcomes) != after.outcomes) < 1e-4
    whole = np.asarray(matrix[0])
    for i in (0, 2, 4):
        expected = np.asarray(plain.manipulations[..., i : i + 2]) @ whole.T
        # The clip does not bind here, and would not turn.
        np.testing.assert_allclose(after.manipulations[..., i : i + 2], expected, atol=1e-5)


def test_targets_are_occluded_voxels_of_the_states_and_noise_is_on_the_input_alone():
    before = examples()
    clean, noisy = (augment(before, noise=noise, noise_z=0.2 * noise, key=jax.random.key(1)) for noise in (0.0, 0.025))
    np.testing.assert_array_equal(clean.outcomes, noisy.outcomes)
    np.testing.assert_array_equal(clean.manipulations, noisy.manipulations)
    assert (clean.state != noisy.state).any()
    for seen in (clean.state, clean.outcomes, noisy.state):
        np.testing.assert_array_equal(voxels.occlude(seen), seen)
    plain = voxelised(before, noise=0.0, noise_z=0.0, key=jax.random.key(0))
    np.testing.assert_array_equal(plain.outcomes[1, 0], voxels.observe(before.outcomes[1, 0]))
    np.testing.assert_array_equal(plain.state, voxels.observe(before.state))


def test_both_orders_of_the_grasp_points_occur():
    same = Examples(*(jnp.repeat(a[:1], 32, axis=0) for a in examples()))
    found = np.asarray(augment(same, noise=0.0, noise_z=0.0, key=jax.random.key(3)).manipulations)
    # The distance from the centre does not turn: it tells which grasp point comes first.
    reach = np.round(np.linalg.norm(found[:, 0, :2], axis=-1), 3)
    assert len(np.unique(reach)) == 2


def test_cross_entropy_by_hand():
    logits = jnp.array([0.0, 2.0, -1.0, 80.0]).reshape(2, 2, 1)
    truth = jnp.array([True, True, False, False]).reshape(2, 2, 1)
    p = 1 / (1 + np.exp([-2.0, 1.0]))
    expected = (np.log(2) - np.log(p[0]) - np.log(1 - p[1]) + 80) / 4
    assert float(cross_entropy(logits, truth)) == pytest.approx(expected, rel=1e-6)


def voxel_examples(n=2):
    return voxelised(examples(n), noise=0.0, noise_z=0.0, key=jax.random.key(0))


def test_losses_sum_over_steps_and_average_over_the_batch():
    batch, net = voxel_examples(), random_net(DENSE, 0)
    made, steps = predicted_by(net, batch.state, batch.manipulations)
    p = np.clip(np.asarray(jnp.moveaxis(jax.nn.sigmoid(made), 0, 1), np.float64), 1e-12, 1 - 1e-7)
    likelihood = np.where(batch.outcomes, np.log(p), np.log(1 - p))
    expected = -likelihood.mean((2, 3, 4)).sum(1).mean()
    loss_s, loss_p = jax.jit(losses, static_argnums=0)(EMDVoxel(DENSE), net.params, batch)
    assert float(loss_s) == pytest.approx(expected, rel=1e-3)
    misses = np.asarray(jnp.moveaxis(steps.shifts, 0, 1) - batch.shifts)
    assert float(loss_p) == pytest.approx(np.mean(misses**2), rel=1e-5)


def test_paper_recipe_gives_the_decoder_loss_s_alone():
    batch, params = voxel_examples(1), initial(DENSE, key=jax.random.key(0))
    settings = TrainEMDVoxelConfig(net=DENSE, training=TrainingConfig(recipe="paper"))
    found, by_name = jax.jit(direction, static_argnums=(0, 1))(EMDVoxel(DENSE), settings, params, batch)
    assert set(by_name) == {"loss_s", "loss_p"}
    shape, position = (jax.grad(lambda p, i=i: losses(EMDVoxel(DENSE), p, batch)[i])(params) for i in range(2))
    jax.tree.map(lambda d, g: np.testing.assert_array_equal(d, np.sign(g)), found["D"], shape["D"])
    expected = np.sign(np.sign(shape["M"]["layer_1"]["kernel"]) + np.sign(position["M"]["layer_1"]["kernel"]))
    np.testing.assert_array_equal(found["M"]["layer_1"]["kernel"], expected)


def test_the_score_is_the_mean_voxel_difference_over_the_tasks():
    net = random_net(DENSE, 1)
    found = jax.jit(task_differences, static_argnums=0)(EMDVoxel(DENSE), net.params, SEQUENCES)
    assert found.shape == (6, 6)
    # One of them by hand: from state 1, two manipulations (task 4 of TASKS).
    seen, truth = (voxels.observe(SEQUENCES.vertices[2, i]) for i in (1, 3))
    manipulations = cartesian(SEQUENCES.vertices[2, 1:3], SEQUENCES.manipulation[2, 1:3])
    made, _ = predicted_by(net, seen, manipulations)
    occupancy = np.asarray(jax.nn.sigmoid(made[-1]))
    assert float(found[4, 2]) == pytest.approx(float(np.abs(occupancy - truth).mean()), rel=1e-4)
    settings = TrainEMDVoxelConfig(net=DENSE, training=TrainingConfig(recipe="paper"))
    scores = problem(settings, SEQUENCES).validate(net.params)
    assert scores["score"] == pytest.approx(float(found.mean()), rel=1e-5)
    assert scores["1/2"] == pytest.approx(float(found[2].mean()), rel=1e-5)


def test_voxel_examples_have_no_labels():
    """All eight labellings of a stretch are one example."""
    one = draw(SEQUENCES, 1, 1, key=jax.random.key(4))
    all_eight = Examples(
        state=equivalents(one.state)[:, 0],
        manipulations=equivalents_of_manipulation(one.manipulations)[:, 0],
        outcomes=equivalents(one.outcomes)[:, 0],
        shifts=jnp.repeat(one.shifts, 8, axis=0),
        cloth=equivalent_cloths(one.cloth)[:, 0],
    )
    found = voxelised(all_eight, noise=0.0, noise_z=0.0, key=jax.random.key(0))
    np.testing.assert_allclose(found.manipulations, jnp.repeat(found.manipulations[:1], 8, axis=0), atol=1e-5)
    assert np.mean(np.asarray(found.state) != found.state[:1]) < 1e-4
    assert np.mean(np.asarray(found.outcomes) != found.outcomes[:1]) < 1e-4


def test_manipulators_refuse_less_width_than_the_channel():
    with pytest.raises(ValueError, match="at least latent"):
        EMDVoxelConfig(latent=8, manipulation=4)
    assert pemd.Manipulator is emd_voxel.Manipulator
