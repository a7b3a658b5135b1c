"""A world that a forward model can know exactly: each hand drags the vertices near its grasp point along.

It treats all equivalents alike, and serves both as a net and as what the net predicts. A net's memory trace counts the
manipulations that were executed: the more there were, the farther it expects vertices to follow a hand.
"""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from clothkit.cloth.mesh import ProbabilisticMesh
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE, thinned
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.geometry import to_geodesic
from clothkit.models.ensemble import Ensemble
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.normalisation import Normalisation
from clothkit.planning.objective import Weights
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.perception import KnownMeshes
from clothkit.planning.planner import Planner
from clothkit.planning.search import SearchConfig
from clothkit.planning.settings import PlanConfig
from clothkit.planning.systems import system

NETS = (jnp.float32(1.0), jnp.float32(1.03))
"""A toy net is how far vertices follow the hand."""

REMEMBERED = 0.02
"""The share by which every manipulation before makes them follow farther: little, as the world itself forgets."""

WEIGHTS = Weights(0.25, 5.0, 1.25)
"""Another alpha than the one that may as well be left out."""


def dragged(mesh: Array, manipulation: Array, strength: Array | float = 1.0) -> Array:
    """The meshes [*b u v 3] after a manipulation [*b 6] each."""
    uv = jnp.asarray(SQUARE.geodesic())
    grasps = manipulation[..., :4].reshape(*manipulation.shape[:-1], 1, 1, 2, 2)
    near = jnp.exp(-jnp.sum((uv[:, :, None] - grasps) ** 2, axis=-1) / 0.5).max(-1)
    d = manipulation[..., None, None, 4:]
    lift = 0.05 * jnp.sum(d**2, axis=-1, keepdims=True)
    return mesh + strength * near[..., None] * jnp.concatenate([d, lift], axis=-1)


def encode(net: Array, mesh: Array, cloth: Any = None) -> Array:
    mesh = jnp.asarray(mesh)
    return mesh.reshape(*mesh.shape[:-3], -1)


def step(net: Array, latent: Array, trace: Array, manipulation: Array) -> tuple[Array, Array, Array]:
    strength = net * (1 + REMEMBERED * trace[..., 0])
    mesh = dragged(latent.reshape(*latent.shape[:-1], *SQUARE.shape, 3), manipulation, strength[..., None, None, None])
    return mesh.reshape(latent.shape), trace + 1, manipulation[..., :2]


def decode(net: Array, latent: Array, stride: int = 1) -> ProbabilisticMesh:
    mesh = thinned(latent.reshape(*latent.shape[:-1], *SQUARE.shape, 3), stride)
    return ProbabilisticMesh(mesh, jnp.full_like(mesh, 0.015))


class Model(NamedTuple):
    """The toy's forward model; tests replace its parts."""

    encode: Callable[..., Any] = encode
    step: Callable[..., Any] = step
    decode: Callable[..., Any] = decode


MODEL = Model()


def bent(k: int = 0) -> np.ndarray:
    """A start whose eight equivalents all differ, centred near enough."""
    mesh = dragged(jnp.asarray(SQUARE.flat()), jnp.array([1.0, 0.3, 1.0, 0.3, -0.35, 0.1]))
    return np.asarray(relabel(mesh, k))


def execute(
    meshes: np.ndarray, grasps: np.ndarray, displacement: np.ndarray, single: np.ndarray, cloths: Any = None
) -> np.ndarray:
    """The toy world as a simulator: hands take the nearest vertices."""
    uv = np.stack([to_geodesic(mesh, pair) for mesh, pair in zip(meshes, grasps, strict=True)])
    manipulation = np.concatenate([uv.reshape(-1, 4), displacement], axis=-1)
    return np.asarray(dragged(jnp.asarray(meshes), jnp.asarray(manipulation, jnp.float32)))


def normalisation(nets: int) -> Normalisation:
    """Reference values of that number of nets; a single one differs from no other."""
    spread = (0.01,) * 3 if nets > 1 else ()
    return Normalisation(((-1.0,) * 3,) * nets, ((1.0,) * 3,) * nets, spread, spread)


NORMALISATION = normalisation(2)


GRADIENT = GradientConfig(strains=64, iterations_per_step=10)
SEARCH = SearchConfig(optimiser=GRADIENT, stride=4)
BATCH, CANDIDATES = 2, CandidateConfig()
"""All tests share these sizes, so that the search is compiled once per plan length."""


def planner(name: str) -> Planner:
    """A planner of the toy world."""
    plan = PlanConfig(test=2, train=0, search=SEARCH, together=1, batch=BATCH)
    chosen = system(name)
    return Planner(
        chosen,
        representation=MESH,
        model=MODEL,
        members=(0, 1)[: 1 if chosen.single else 2],
        nets=NETS[: 1 if chosen.single else 2],
        best=0,
        perception=KnownMeshes(),
        normalisation=NORMALISATION,
        weights=WEIGHTS,
        settings=plan,
        grasping=CANDIDATES,
        labelled=True,
    )


class Nets(Ensemble):
    """The toy's two nets as an ensemble."""

    def __init__(self) -> None:
        self.__dict__.update(members=(0, 1), nets=(), best=0)

    @property
    def model(self) -> Any:
        return MODEL

    @property
    def params(self) -> tuple[Any, ...]:
        return NETS


def searching(**changes: Any) -> SearchConfig:
    """The usual search of the tests with other settings, of the search or of its optimiser."""
    own = {name: value for name, value in changes.items() if name in {f.name for f in fields(GradientConfig)}}
    rest = {name: value for name, value in changes.items() if name not in own}
    return replace(SEARCH, optimiser=replace(GRADIENT, **own), **rest)
