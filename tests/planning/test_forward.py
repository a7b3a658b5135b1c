"""Which manipulations of predicted states fold them, against polygons and columns."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clothkit.cloth import voxels
from clothkit.cloth.grid import CLOTH_SIDE, SIDE, flat
from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.silhouette import silhouette
from clothkit.manipulation.vector import SHORTEST
from clothkit.planning import voxel_forward
from clothkit.planning.draw import FOLD_POINT
from clothkit.planning.forward import ON_CLOTH, folds, thinned
from tests.observation.scenes import folded

HALF = CLOTH_SIDE / 2
uv = st.floats(-1, 1)
length = st.floats(-1.4, 1.4)


def predicted(mesh: np.ndarray, every: int) -> ProbabilisticMesh:
    mean = thinned(jnp.asarray(mesh, jnp.float32)[None], every)
    return ProbabilisticMesh(mean, jnp.full_like(mean, 0.02))


@settings(max_examples=60)
@given(st.sampled_from([1, 2, 4]), st.tuples(uv, uv, uv, uv), st.tuples(length, length))
def test_q_on_the_flat_cloth(every: int, grasps: tuple[float, ...], d: tuple[float, ...]) -> None:
    manipulation = np.array([*grasps, *d], np.float32)
    q = HALF * manipulation[:4].reshape(2, 2).mean(0) + FOLD_POINT * manipulation[4:]
    outside = np.linalg.norm(np.maximum(np.abs(q) - HALF, 0))
    told = bool(folds(predicted(flat(), every), jnp.asarray(manipulation)[None])[0])
    if np.hypot(*d) < 0.999 * SHORTEST:
        assert told
    elif np.hypot(*d) > 1.001 * SHORTEST:
        # A thinned mesh ends up to `every` - 1 vertices before the border.
        short = (every - 1) * CLOTH_SIDE / (SIDE - 1)
        if (q >= -HALF).all() and (q <= HALF - short).all():
            assert told
        if outside > every * ON_CLOTH + 0.01:
            assert not told


def test_q_on_a_folded_cloth() -> None:
    """A half fold: what lies where the cloth was, and is no more, is off it."""
    mesh = flat().copy()
    mesh[..., 0] = -np.abs(mesh[..., 0])
    random = np.random.default_rng(0)
    manipulations = random.uniform(-1.4, 1.4, (400, 6)).astype(np.float32).clip([-1] * 4 + [-9] * 2, [1] * 4 + [9] * 2)
    places = HALF * manipulations[:, :4].reshape(-1, 2, 2)
    places[..., 0] = -np.abs(places[..., 0])
    q = places.mean(1) + FOLD_POINT * manipulations[:, 4:]
    inside = (q[:, 0] > -HALF) & (q[:, 0] < 0) & (np.abs(q[:, 1]) < HALF)
    meshes = ProbabilisticMesh(*(jnp.repeat(part, 400, axis=0) for part in predicted(mesh, 1)))
    told = np.asarray(folds(meshes, jnp.asarray(manipulations)))
    beyond = np.maximum(np.maximum(-HALF - q[:, 0], q[:, 0]), np.abs(q[:, 1]) - HALF) > ON_CLOTH
    long = np.hypot(*manipulations[:, 4:].T) > SHORTEST
    assert inside.sum() > 50
    assert (beyond & long).sum() > 50
    assert told[inside].all()
    assert not told[beyond & long].any()


def test_q_in_predicted_voxels() -> None:
    mesh = folded()
    seen = np.asarray(voxels.observe(mesh))
    logits = jnp.where(seen, 3.0, -3.0)
    covered = silhouette(mesh, resolution=voxels.RESOLUTION[0], extent=1.0)
    random = np.random.default_rng(1)
    manipulations = random.uniform(-1, 1, (500, 6)).astype(np.float32)
    told = np.asarray(voxel_forward.folds(jnp.repeat(logits[None], 500, axis=0), jnp.asarray(manipulations)))
    q = manipulations[:, :4].reshape(-1, 2, 2).mean(1) + FOLD_POINT * manipulations[:, 4:]
    pixel = np.floor((q + 1) * 16).astype(int)
    inside = ((pixel >= 0) & (pixel < 32)).all(-1)
    x, y = pixel.clip(0, 31).T
    wanted = inside & covered[x, y] | (np.hypot(*manipulations[:, 4:].T) < SHORTEST)
    # Silhouette and voxels may differ along the outline.
    assert np.mean(told == wanted) > 0.93
    assert wanted.mean() > 0.1
    assert (seen.any(-1)[x, y] & inside | (np.hypot(*manipulations[:, 4:].T) < SHORTEST) == told).all()
