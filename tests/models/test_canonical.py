"""Canonical descriptions: one for all that turns, mirrors and labels make of a cloth, and nets that are shown them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth import mesh as meshes
from clothkit.cloth import voxels
from clothkit.cloth.symmetry import equivalents, relabel, relabel_cloth, relabel_manipulation
from clothkit.cloth.topology import SQUARE, thinned
from clothkit.dataset.tasks import TASKS
from clothkit.manipulation.turns import planar, turn, turn_manipulation, turn_mesh
from clothkit.models import emd_voxel, pemd, vtm
from clothkit.models.canonical import axes, described, fit, frame, lies_along_y, voxel_frame, voxels_described
from clothkit.models.forward import forward_model, predict
from clothkit.models.net import Net
from clothkit.models.pemd import PEMD
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, Start, VtMConfig
from clothkit.training.augment import as_shown, augment
from clothkit.training.emd_voxel import task_differences
from clothkit.training.pemd import draw, sequences, task_errors
from tests.crumpled import crumpled
from tests.models.predicted import predicted_by
from tests.models.test_nets import nearly_flat


def lopsided(mesh):
    """The mesh, longer on one side: nearly symmetric ones have two nearly canonical descriptions."""
    bent = mesh + np.array([0.3, 0.2, 0.0], np.float32) * SQUARE.flat() ** 2
    return bent - [1, 1, 0] * bent.mean((-3, -2), keepdims=True)


MESHES = lopsided(crumpled(8, 1).vertices[:, 3]).astype(np.float32)
CONFIG = PEMDConfig(latent=5, encoder=(8,), manipulation=6, decoder=(8, 12), canonical=True)
NET = Net(CONFIG, pemd.initial(CONFIG, Start(), key=jax.random.key(0)))
MODEL = forward_model(CONFIG)
PLAN = np.random.default_rng(2).uniform(-1, 1, (8, 2, 6)).astype(np.float32)
ISOMETRIES = st.tuples(st.floats(0, 6.28), st.booleans(), st.integers(0, 7))


def other(angle, mirrored, k):
    """An isometry of the plane and other labels, as functions of meshes and of manipulations."""
    matrix = planar(jnp.float32(angle), jnp.array(mirrored))
    return (
        matrix,
        lambda mesh: relabel(turn_mesh(jnp.asarray(mesh), jnp.broadcast_to(matrix, (*mesh.shape[:-3], 2, 2))), k),
        lambda m: relabel_manipulation(
            turn_manipulation(jnp.asarray(m), jnp.broadcast_to(matrix, (*m.shape[:-1], 2, 2))), k
        ),
    )


@given(ISOMETRIES)
@settings(deadline=None, max_examples=30)
def test_turns_mirrors_and_labels_change_no_canonical_description(isometry):
    _, changed, _ = other(*isometry)
    one, same = (np.asarray(described(m, frame(m))) for m in (jnp.asarray(MESHES), changed(MESHES)))
    np.testing.assert_allclose(one, same, atol=2e-5)


def test_no_turn_or_mirror_brings_a_mesh_nearer_to_the_flat_cloth():
    def far(matrix):
        return ((turn_mesh(jnp.asarray(MESHES), matrix) - SQUARE.flat())[..., :2] ** 2).mean((1, 2, 3))

    swept = [
        far(jnp.broadcast_to(planar(jnp.float32(angle), jnp.array(mirrored)), (8, 2, 2)))
        for angle in np.linspace(0, 2 * np.pi, 360, endpoint=False)
        for mirrored in (False, True)
    ]
    best = far(fit(jnp.asarray(MESHES)))
    assert (best <= np.min(swept, axis=0) + 1e-6).all()
    assert (best < np.median(swept, axis=0)).all()


def test_a_canonical_mesh_lies_widest_along_x_with_its_heavier_tails_at_positive_x_and_y():
    x, y = np.moveaxis(np.asarray(described(MESHES, frame(jnp.asarray(MESHES))))[..., :2], -1, 0)
    assert ((x**2).sum((1, 2)) >= (y**2).sum((1, 2))).all()
    assert ((x**3).sum((1, 2)) >= -1e-4).all()
    assert ((y**3).sum((1, 2)) >= -1e-4).all()


def test_the_flat_cloth_is_described_as_it_is():
    mesh = jnp.asarray(SQUARE.flat())
    np.testing.assert_allclose(described(mesh, frame(mesh)), mesh, atol=1e-6)


def test_labels_and_axes_of_an_equivalent_cancel_out_on_the_flat_cloth():
    for k in range(8):
        matrix = axes(jnp.array(k))
        np.testing.assert_allclose(relabel(turn_mesh(jnp.asarray(SQUARE.flat()), matrix), k), SQUARE.flat(), atol=1e-6)


@given(ISOMETRIES)
@settings(deadline=None, max_examples=10)
def test_predictions_turn_with_the_cloth(isometry):
    matrix, changed, planned = other(*isometry)
    predicted, found = predicted_by(NET, MESHES, PLAN)
    again, turned = predicted_by(NET, changed(MESHES), planned(PLAN))
    np.testing.assert_allclose(again.mean, changed(predicted.mean), atol=1e-4)
    np.testing.assert_allclose(turned.shifts, turn(found.shifts, matrix), atol=1e-4)


TOLD = Net(replace(CONFIG, told=True), pemd.initial(replace(CONFIG, told=True), Start(), key=jax.random.key(4)))
RECTANGLE = np.array([1.4, 0.9, 0.02], np.float32)


@given(ISOMETRIES)
@settings(deadline=None, max_examples=10)
def test_predictions_for_a_rectangle_turn_with_it_and_its_sides(isometry):
    matrix, changed, planned = other(*isometry)
    model, longish = forward_model(TOLD.config), MESHES * np.array([1, 0.9 / 1.4, 1], np.float32)

    def of(meshes, plan, cloth):
        found, rolled = predict(model, TOLD.params, meshes, plan, cloth=np.tile(cloth, (len(meshes), 1)))
        return found.mean, rolled.shifts

    mean, shifts = of(longish, PLAN, RECTANGLE)
    again, turned = of(changed(longish), planned(PLAN), relabel_cloth(RECTANGLE, isometry[2]))
    np.testing.assert_allclose(again, changed(mean), atol=1e-4)
    np.testing.assert_allclose(turned, turn(shifts, matrix), atol=1e-4)


def test_a_net_that_is_told_of_a_cloth_knows_its_thickness_and_sides_and_another_does_not():
    for net, told in ((TOLD, True), (NET, False)):
        model = forward_model(net.config)
        first, *others = (
            model.encode(net.params, MESHES[0], np.array(cloth, np.float32))[:5]
            for cloth in ((1.4, 1.4, 0.007), (1.4, 1.4, 0.03), (1.4, 1.2, 0.007))
        )
        assert [bool(np.abs(first - one).max() > 1e-3) for one in others] == [told, told]


@pytest.mark.parametrize("ratio", [1.3, 1.8])
def test_a_flat_rectangle_is_described_as_it_is(ratio):
    cloth = np.array([1.4, 1.4 / ratio, 0.01], np.float32)
    flat = SQUARE.flat() * np.array([1, 1 / ratio, 1], np.float32)
    found = frame(flat, cloth)
    np.testing.assert_allclose(described(flat, found), flat, atol=1e-5)
    matrix = planar(jnp.float32(0.7), jnp.array(False))
    turned = turn_mesh(jnp.asarray(flat), matrix)
    np.testing.assert_allclose(described(turned, frame(turned, cloth)), flat, atol=1e-5)


def test_a_net_that_is_not_canonical_does_not_know_direction():
    plain = Net(replace(CONFIG, canonical=False), NET.params)
    _, changed, planned = other(1.0, False, 0)
    predicted, again = (
        predicted_by(plain, m, p)[0].mean for m, p in ((MESHES, PLAN), (changed(MESHES), planned(PLAN)))
    )
    assert np.abs(again - changed(predicted)).max() > 0.05


def test_standard_deviations_are_those_along_the_axes():
    """Of samples: drawn in the canonical description, taken back, and measured."""
    mesh = jnp.asarray(MESHES[0])
    predicted = MODEL.decode(NET.params, MODEL.encode(NET.params, mesh))
    found, bare = frame(mesh), PEMD(CONFIG)
    inner = bare.decode(NET.params, bare.encode(NET.params, described(mesh, found)))
    samples = inner.mean + inner.std * jax.random.normal(jax.random.key(3), (4000, *SQUARE.shape, 3))
    back = jnp.broadcast_to(found.matrix.T, (4000, 2, 2))
    samples = turn_mesh(samples, back)
    samples = next(relabel(samples, k) for k in range(8) if (relabel(relabel(mesh, int(found.k)), k) == mesh).all())
    np.testing.assert_allclose(samples.std(0), predicted.std, rtol=0.1)
    np.testing.assert_allclose(samples.mean(0), predicted.mean, atol=0.15)


def test_a_memory_trace_counts_in_its_own_frame_alone():
    mesh, m = jnp.asarray(MESHES[0]), jnp.asarray(PLAN[0, 0])
    latent = MODEL.encode(NET.params, mesh)
    after, trace, _ = MODEL.step(NET.params, latent, jnp.zeros_like(latent), m)
    first = MODEL.step(NET.params, after, jnp.zeros_like(latent), m)[0]
    assert np.abs(MODEL.step(NET.params, after, trace, m)[0] - first).max() > 1e-3
    elsewhere = MODEL.encode(NET.params, jnp.asarray(MESHES[1]))
    without = MODEL.step(NET.params, elsewhere, jnp.zeros_like(latent), m)[0]
    np.testing.assert_array_equal(MODEL.step(NET.params, elsewhere, trace, m)[0], without)


@pytest.mark.parametrize("stride", [1, 2, 4, 8])
def test_thinned_decoding_is_the_decoder_at_these_vertices(stride):
    for model in (MODEL, PEMD(CONFIG)):
        latent = model.encode(NET.params, MESHES)
        full, thin = model.decode(NET.params, latent), model.decode(NET.params, latent, stride)
        assert thin.mean.shape == (8, 32 // stride, 32 // stride, 3)
        np.testing.assert_allclose(thin.mean, thinned(full.mean, stride), rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(thin.std, thinned(full.std, stride), rtol=1e-4)


@pytest.mark.parametrize("stride", [2, 4, 8])
def test_thinning_leaves_the_same_vertices_under_all_labels(stride):
    mesh = MESHES[0]
    for k in range(8):
        np.testing.assert_array_equal(thinned(relabel(mesh, k), stride), relabel(thinned(mesh, stride), k))


def test_training_and_evaluation_see_the_same_errors():
    data = sequences(crumpled(5, 2))
    data = data._replace(vertices=jnp.asarray(lopsided(np.asarray(data.vertices)), jnp.float32))
    errors = task_errors(MODEL, NET.params, data)
    predicted, _ = predicted_by(NET, data.vertices[:, 1], data.manipulation[:, 1:])
    np.testing.assert_allclose(
        errors[jnp.array([TASKS.index((1, 1)), TASKS.index((1, 2))])],
        meshes.error(predicted.mean, np.moveaxis(data.vertices[:, 2:], 1, 0)),
        atol=1e-5,
    )


def test_augmentation_does_not_show_once_examples_are_described():
    examples = draw(sequences(crumpled(5, 2)), 2, 16, key=jax.random.key(0))
    examples = examples._replace(state=jnp.asarray(lopsided(np.asarray(examples.state)), jnp.float32))
    augmented = augment(examples, noise=0.0, key=jax.random.key(1))
    (learner, one), (_, other) = (as_shown(MODEL, e) for e in (examples, augmented))
    assert learner == PEMD(CONFIG)
    for name in ("state", "outcomes", "shifts"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=1e-4)


def test_what_a_canonical_vtm_says_of_one_view_turns_with_the_voxels_when_x_and_y_are_swapped():
    config = VtMConfig(hidden=6, canonical=True)
    net = Net(config, vtm.initial(config, key=jax.random.key(4)))
    seen = np.zeros((2, 32, 32, 16), bool)
    seen[:, 4:28, 10:20, 0] = np.random.default_rng(5).uniform(size=(2, 24, 10)) < 0.5
    assert not lies_along_y(jnp.asarray(seen)).any()
    assert lies_along_y(jnp.asarray(seen).swapaxes(1, 2)).all()
    plain, swapped = vtm.estimate(net, seen), vtm.estimate(net, seen.swapaxes(1, 2))
    for a, b in zip(plain, swapped, strict=True):
        np.testing.assert_array_equal(a[..., [1, 0, 2]], b)


def test_eight_views_of_a_canonical_vtm_are_four():
    net, one = (replace(n, config=replace(n.config, canonical=True)) for n in (nearly_flat(8), nearly_flat(1)))
    seen = np.random.default_rng(5).uniform(size=(32, 32, 16)) < 0.05
    found = [vtm.estimate(one, equivalents(seen)[k]) for k in range(8)]
    views = [vtm.turned_back(mean, k) for k, (mean, _) in enumerate(found)]
    weights = [np.exp(-vtm.SURENESS * float(jnp.mean(jnp.log(std)))) for _, std in found]
    for k, swapped in ((0, 1), (2, 5), (4, 3), (6, 7)):
        np.testing.assert_array_equal(views[k], views[swapped])
    first = views[0]
    errors = [[float(jnp.sum((relabel(view, k) - first) ** 2)) for k in range(8)] for view in views]
    nearest = [relabel(view, int(np.argmin(of))) for view, of in zip(views, errors, strict=True)]
    np.testing.assert_allclose(vtm.estimate(net, seen).mean, np.average(nearest, axis=0, weights=weights), atol=1e-5)


VOXELS = np.asarray(voxels.observe(jnp.asarray(MESHES)))
VOXEL_CONFIG = EMDVoxelConfig(latent=6, manipulation=8, width=0.1, canonical=True)
VOXEL_NET = Net(VOXEL_CONFIG, emd_voxel.initial(VOXEL_CONFIG, key=jax.random.key(6)))


@pytest.mark.parametrize("k", range(8))
def test_voxels_have_one_description_and_predictions_turn_with_them(k):
    found = voxel_frame(jnp.asarray(VOXELS))
    shown, matrix = relabel(VOXELS, k), axes(jnp.array(k))
    same = voxels_described(shown, voxel_frame(shown))
    np.testing.assert_array_equal(same, voxels_described(jnp.asarray(VOXELS), found))
    turned_plan = turn(jnp.asarray(PLAN).reshape(8, 2, 3, 2), jnp.broadcast_to(matrix, (8, 2, 3, 2, 2))).reshape(
        8, 2, 6
    )
    predicted, steps = predicted_by(VOXEL_NET, VOXELS, PLAN)
    again, turned = predicted_by(VOXEL_NET, shown, turned_plan)
    np.testing.assert_allclose(again, relabel(predicted, k), atol=1e-5)
    np.testing.assert_allclose(turned.shifts, turn(steps.shifts, jnp.broadcast_to(matrix, (2, 8, 2, 2))), atol=1e-5)


def test_training_and_evaluation_see_the_same_voxels():
    data = sequences(crumpled(5, 2))
    data = data._replace(vertices=jnp.asarray(lopsided(np.asarray(data.vertices)), jnp.float32))
    differences = task_differences(forward_model(VOXEL_CONFIG), VOXEL_NET.params, data)
    plan = emd_voxel.cartesian(data.vertices[:, 1:3], data.manipulation[:, 1:])
    seen = voxels.observe(data.vertices)
    logits, _ = predicted_by(VOXEL_NET, seen[:, 1], plan)
    expected = np.abs(jax.nn.sigmoid(logits) - np.moveaxis(seen[:, 2:], 1, 0)).mean((-3, -2, -1))
    chosen = jnp.array([TASKS.index((1, 1)), TASKS.index((1, 2))])
    np.testing.assert_allclose(differences[chosen], expected, atol=1e-5)
