"""Random manipulations that satisfy the paper's three restrictions (section 4.4)."""

from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Float

from clothkit.cloth.silhouette import pixel_centres, silhouette
from clothkit.cloth.topology import SQUARE, Topology
from clothkit.manipulation.candidates import CandidateConfig, candidates
from clothkit.manipulation.geometry import release_points, topmost_vertex
from clothkit.manipulation.vector import SHORTEST
from clothkit.runtime.config import config


@config
class SamplingConfig:
    """Settings of random manipulations. Lengths are in normalised units."""

    tries: Annotated[int, Ge(1), Le(10**5)] = 400
    """Largest number of draws for one manipulation."""
    single_share: Annotated[float, Ge(0), Le(1)] = 1 / 3
    """Probability of a one-handed manipulation."""
    fold_point: Annotated[float, Ge(0.1), Le(1)] = 0.8
    """The reference point q lies at this share of the displacement."""
    least_grasp_distance: Annotated[float, Ge(0), Le(2)] = 0.15
    """Least distance between the grasp points of two hands."""
    least_travel: Annotated[float, Ge(0), Le(2)] = 0.1
    """Least horizontal distance that each hand moves."""
    reach: Annotated[float, Gt(0), Le(10)] = 1.0
    """Grasp and release points are within -reach..reach in x and y, relative to the initial flat cloth's centre."""


class Drawn(NamedTuple):
    """A random manipulation: indices of the grasped vertices (equal for one hand), and displacement [normalised]."""

    vertices: tuple[int, int]
    displacement: Float[np.ndarray, "2"]

    @property
    def single(self) -> bool:
        """Whether the manipulation is one-handed."""
        return self.vertices[0] == self.vertices[1]


def draw_hands(rng: np.random.Generator, settings: SamplingConfig) -> int:
    """A random number of hands, 1 or 2."""
    return 1 if rng.random() < settings.single_share else 2


def sample(
    rng: np.random.Generator,
    mesh: Float[np.ndarray, "u v 3"],
    hands: int,
    settings: SamplingConfig,
    grasping: CandidateConfig,
    topology: Topology = SQUARE,
) -> Drawn | None:
    """A random manipulation of a mesh at its place on the table [normalised], or None if no draw was valid.

    The three restrictions of section 4.4 hold: hands grasp detected corners, q lies on the silhouette, and the
    manipulation is not null. Draws with the hands on different sides of m are rejected (design 6.2), as are those that
    violate the limits in `settings`.
    """
    points = candidates(mesh, grasping)
    vertices = list(dict.fromkeys(topmost_vertex(mesh, point, within=max(topology.spacing) / 2) for point in points))
    if len(vertices) < hands:
        return None
    positions = mesh.reshape(-1, 3)[:, :2].astype(float)
    covered = _covered_pixels(mesh, grasping)
    pixel = 2 * grasping.extent / grasping.resolution
    for _ in range(settings.tries):
        chosen = [int(vertices[i]) for i in rng.choice(len(vertices), hands, replace=False)]
        pair = (chosen[0], chosen[-1])
        grasps = positions[list(pair)]
        q = covered[rng.integers(len(covered))] + (rng.random(2) - 0.5) * pixel
        displacement = (q - grasps.mean(0)) / settings.fold_point
        if hands == 2 and np.linalg.norm(grasps[0] - grasps[1]) < settings.least_grasp_distance:
            continue
        if _allowed(grasps, displacement, settings):
            return Drawn(pair, displacement)
    return None


def _allowed(grasps: np.ndarray, displacement: np.ndarray, settings: SamplingConfig) -> bool:
    if np.linalg.norm(displacement) < SHORTEST:
        return False
    release = release_points(grasps, displacement)
    travel = np.linalg.norm(release.points - grasps, axis=-1)
    within = np.abs(np.concatenate([grasps, release.points])).max() <= settings.reach
    return bool(release.same_side and travel.min() >= settings.least_travel and within)


def _covered_pixels(mesh: np.ndarray, grasping: CandidateConfig) -> np.ndarray:
    """The centres of the pixels that the cloth covers, xy [normalised]."""
    middle = (mesh[..., :2].max((0, 1)) + mesh[..., :2].min((0, 1))) / 2
    image = silhouette(mesh - np.append(middle, 0), resolution=grasping.resolution, extent=grasping.extent)
    axis = pixel_centres(grasping.resolution, grasping.extent)
    x, y = np.nonzero(image)
    return np.stack([axis[x], axis[y]], axis=-1) + middle
