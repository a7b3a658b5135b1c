"""What hands can reach, as terms of the objective (section 4.2.1 names it), in metres in the table's frame.

A term is zero for plans whose hands keep a limit, with a margin, at every waypoint: at the grasp, along the arc
(section 4.2.2) and at the release. Else it is how far the hands are beyond the limit where they are farthest, summed
over hands and averaged over manipulations [m]; so its gradient is bounded. In the first manipulation hands grasp the
state that is planned from; in later ones they grasp one net's prediction of it, where that net expects its centre.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from clothkit.cloth.topology import SQUARE, geodesic, thinned
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null, is_single
from clothkit.planning.objective import Outlook, Term
from clothkit.planning.types import Scalar

MARGIN = 0.005
"""What a search keeps from every limit [m], so that a plan is within it when it is rounded."""

WEIGHT = 300.0
"""Weight of a term per cloth length, for losses whose range is 1 (eq. 14): a hundredth of the cloth's side costs 3."""

Numbers = Sequence[float | int] | Float[np.ndarray, "3"] | Float[Array, "3"]
Points = Float[np.ndarray, "*points 3"] | Float[Array, "*points 3"]


class Box(NamedTuple):
    """The points between two corners [m]."""

    low: Numbers
    high: Numbers

    def outside(self, points: Points) -> Any:
        """The signed distance of points from the surface [m], `[*points]`: negative inside."""
        xp = _module(points)
        beyond = xp.maximum(xp.asarray(self.low) - points, points - xp.asarray(self.high))
        return xp.where((beyond <= 0).all(-1), beyond.max(-1), _length(xp.maximum(beyond, 0)))

    def __str__(self) -> str:
        return f"the box {_told(self.low)}..{_told(self.high)}"


class Ball(NamedTuple):
    """The points within a radius of a centre [m]."""

    centre: Numbers
    radius: Scalar

    def outside(self, points: Points) -> Any:
        """The signed distance of points from the surface [m], `[*points]`: negative inside."""
        return _length(points - _module(points).asarray(self.centre)) - self.radius

    def __str__(self) -> str:
        return f"the ball of radius {float(self.radius):g} around {_told(self.centre)}"


Region = Box | Ball


class Limits(NamedTuple):
    """What a robot's hands have to keep to [m], in the table's frame (z up, the table at 0)."""

    hands: tuple[Region, ...] = ()
    """Where hands can be: one region for both, or one for each; empty: anywhere. Either hand may take a grasp point."""
    keep_out: tuple[Region, ...] = ()
    """Where no hand may be."""
    apart: Scalar = 0.0
    """Least distance between the two hands of a manipulation."""

    def __bool__(self) -> bool:
        """Whether there is any limit."""
        return bool(self.hands or self.keep_out or self.apart > 0)


def out_of_reach(regions: tuple[Region, ...], points: Points, single: Any, margin: Scalar = 0.0) -> tuple[Any, Any]:
    """How far each hand is outside its region where it is farthest [m], and whether the hands change places.

    `points` are the waypoints of two hands `[*batch 2 waypoints 3]`; `single` `[*batch]` marks manipulations of which
    only the first counts. With two regions, manipulations are assigned to the robot's hands in the order, or the other
    one, in which they are less far outside in total. Distances are `[*batch 2]`, 0 for a hand that does not count.
    """
    xp = _module(points)
    first, last = (xp.maximum(region.outside(points).max(-1) + margin, 0) for region in (regions[0], regions[-1]))
    counts = xp.stack([xp.ones_like(single), ~single], axis=-1)
    straight = xp.stack([first[..., 0], last[..., 1]], axis=-1) * counts
    crossed = xp.stack([last[..., 0], first[..., 1]], axis=-1) * counts
    change = crossed.sum(-1) < straight.sum(-1)
    return xp.where(change[..., None], crossed, straight), change


def in_zone(zone: Region, points: Points, single: Any, margin: Scalar = 0.0) -> Any:
    """How deep each hand is inside a zone where it is deepest [m], `[*batch 2]`; arguments as in `out_of_reach`."""
    xp = _module(points)
    counts = xp.stack([xp.ones_like(single), ~single], axis=-1)
    return xp.maximum(margin - zone.outside(points).min(-1), 0) * counts


def too_close(least: Scalar, points: Points, single: Any, margin: Scalar = 0.0) -> Any:
    """By how much two hands come closer to one another than `least` [m], `[*batch]`; arguments as in `out_of_reach`."""
    xp = _module(points)
    nearest = _length(points[..., 0, :, :] - points[..., 1, :, :]).min(-1)
    return xp.where(single, 0.0, xp.maximum(least + margin - nearest, 0))


class Situation(NamedTuple):
    """Where the cloth is that is planned for, and how hands move."""

    states: Float[Array, "labels *state"] | Float[np.ndarray, "labels *state"]
    """The equivalents of the state that is planned from."""
    centre: Float[Array, "2"] | Float[np.ndarray, "2"]
    """The cloth's centre on the table [m]."""
    scale: Scalar
    """Metres per normalised unit."""
    progress: Float[Array, " waypoints"] | Float[np.ndarray, " waypoints"]
    """The shares of an arc's length at which hands are looked at, 0 and 1 among them."""
    lift: Scalar
    """Hands end min(lift, k / 2) above the grasp point, where k is the distance that they move [normalised]."""


def waypoints(situation: Situation, outlook: Outlook, net: int) -> Float[Array, "n strains 2 waypoints 3"]:
    """The positions of both hands in each manipulation of each plan [m], in the table's frame."""
    assert outlook.common is not None, "an outlook of `objective.evaluate`"
    grasps = _grasp_points(situation, outlook, net)
    displacement = jnp.moveaxis(outlook.plan[..., 4:], 1, 0)
    releases = jnp.asarray(release_points(grasps[..., :2], displacement).points)
    shifts = outlook.shifts[net]
    moved = jnp.cumsum(jnp.concatenate([jnp.zeros_like(shifts[:1]), shifts[:-1]]), axis=0)
    centre = jnp.asarray(situation.centre) + situation.scale * moved
    points = _arcs(grasps, releases, jnp.asarray(situation.progress), situation.lift) * situation.scale
    return points.at[..., :2].add(centre[:, :, None, None])


def _grasp_points(situation: Situation, outlook: Outlook, net: int) -> Float[Array, "n strains 2 3"]:
    """Where hands grasp, normalised and relative to the cloth's centre; for voxels, on the table."""
    uv = jnp.moveaxis(outlook.plan[..., :4].reshape(*outlook.plan.shape[:2], 2, 2), 1, 0)
    if not outlook.representation.probabilistic:
        return jnp.concatenate([uv, jnp.zeros((*uv.shape[:-1], 1))], axis=-1)
    first = on_cloth(jnp.asarray(situation.states)[outlook.common], uv[0])
    if len(uv) == 1:
        return first[None]
    return jnp.concatenate([first[None], on_cloth(outlook.predictions[net].mean[:-1], uv[1:])])


def on_cloth(
    mesh: Float[Array, "*batch thin_u thin_v 3"], uv: Float[Array, "*batch 2 2"]
) -> Float[Array, "*batch 2 3"]:
    """The points at geodesic coordinates on meshes of 32 x 32 vertices, thinned or not, by bilinear interpolation.

    Beyond the outermost vertices that a thinned mesh has kept, the surface goes on as it is there.
    """
    (low_u, share_u), (low_v, share_v) = (
        _cell(_kept(mesh.shape[axis]), jnp.clip(uv[..., k], -1, 1)) for k, axis in enumerate((-3, -2))
    )
    columns = mesh.shape[-2]
    flat = mesh.reshape(*mesh.shape[:-3], -1, 3)

    def corner(du: int, dv: int) -> Array:
        return jnp.take_along_axis(flat, ((low_u + du) * columns + low_v + dv)[..., None], axis=-2)

    share_u, share_v = share_u[..., None], share_v[..., None]
    near = corner(0, 0) * (1 - share_v) + corner(0, 1) * share_v
    far = corner(1, 0) * (1 - share_v) + corner(1, 1) * share_v
    return near * (1 - share_u) + far * share_u


def _kept(count: int) -> Float[np.ndarray, " kept"]:
    """The geodesic coordinates along one side of the vertices that a mesh with so many has kept."""
    whole = geodesic(SQUARE.shape)
    kept: np.ndarray = thinned(whole, SQUARE.shape[0] // count)[:, 0, 0]
    return kept


def _cell(knots: Float[np.ndarray, " kept"], x: Float[Array, "*batch"]) -> tuple[Array, Array]:
    """The index of the knot before each coordinate, and the coordinate as a share of the way to the next."""
    low = jnp.clip(jnp.searchsorted(jnp.asarray(knots), x, side="right") - 1, 0, len(knots) - 2)
    before, after = jnp.asarray(knots)[low], jnp.asarray(knots)[low + 1]
    return low, (x - before) / (after - before)


def _arcs(
    grasps: Float[Array, "*batch 3"],
    releases: Float[Array, "*batch 2"],
    progress: Float[Array, " waypoints"],
    lift: Scalar,
) -> Float[Array, "*batch waypoints 3"]:
    """Points on the arcs from grasp to release points, as `manipulation.geometry.arc` has them."""
    offset = releases - grasps[..., :2]
    k = jnp.maximum(_length(offset), 1e-9)
    h = jnp.minimum(lift, k / 2)
    radius = (k**2 + h**2) / (2 * k)
    phi = jnp.arctan2(h, radius - k)[..., None] * progress
    forward = (radius / k)[..., None] * (1 - jnp.cos(phi))
    path = jnp.concatenate(
        [forward[..., None] * offset[..., None, :], (radius[..., None] * jnp.sin(phi))[..., None]], axis=-1
    )
    return grasps[..., None, :] + path


@dataclass(frozen=True)
class _OfHands:
    """What the terms have in common."""

    weight: Scalar
    situation: Situation
    margin: Scalar
    """[m]"""
    net: int = field(metadata={"static": True})
    """The net whose predictions tell where later manipulations grasp."""
    every_step: ClassVar[bool] = True

    def _paths(self, outlook: Outlook) -> tuple[Array, Array]:
        """The hands' waypoints in each manipulation, and whether it is one-handed, `[n strains]`."""
        return waypoints(self.situation, outlook, self.net), jnp.moveaxis(jnp.asarray(is_single(outlook.plan)), 1, 0)

    def _mean(self, outlook: Outlook, values: Float[Array, "n strains"]) -> Float[Array, " strains"]:
        """The mean over manipulations, of which null ones move no hands."""
        null = jnp.moveaxis(jnp.asarray(is_null(outlook.plan)), 1, 0)
        return outlook.mean(jnp.where(null, 0.0, values))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OutOfReach(_OfHands):
    """How far hands are outside the regions that they can be in [m]."""

    regions: tuple[Region, ...]

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        away, _ = out_of_reach(self.regions, *self._paths(outlook), self.margin)
        return self._mean(outlook, away.sum(-1))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InZones(_OfHands):
    """How deep hands are inside zones that they have to keep out of [m]."""

    zones: tuple[Region, ...]

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        deep = [in_zone(zone, *self._paths(outlook), self.margin).sum(-1) for zone in self.zones]
        return self._mean(outlook, sum(deep[1:], deep[0]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TooClose(_OfHands):
    """By how much two hands come closer to one another than they may [m]."""

    least: Scalar

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        return self._mean(outlook, too_close(self.least, *self._paths(outlook), self.margin))


def terms_of(
    limits: Limits, situation: Situation, *, weight: Scalar, net: int, margin: Scalar = MARGIN
) -> dict[str, Term]:
    """The terms of an objective, by name, that keep hands within limits. `weight` is that of a metre."""
    common = (weight, situation, margin, net)
    hands, zones = (tuple(_of_arrays(region) for region in regions) for regions in (limits.hands, limits.keep_out))
    terms: dict[str, Term] = {}
    if limits.hands:
        terms["out_of_reach"] = OutOfReach(*common, hands)
    if limits.keep_out:
        terms["in_zones"] = InZones(*common, zones)
    if limits.apart > 0:
        terms["too_close"] = TooClose(*common, limits.apart)
    return terms


class Breach(NamedTuple):
    """A limit that a manipulation does not keep."""

    step: int
    """The manipulation, counted from 1."""
    distance: float
    """How far the hand that is farthest beyond the limit is [m]."""
    limit: str
    """In words: a hand is `distance` .."""


def breaches(limits: Limits, paths: Sequence[np.ndarray]) -> list[Breach]:
    """All limits that hands do not keep, without any margin; `paths` are those of each manipulation.

    A manipulation's are `[hands waypoints 3]` [m], of no hand, one or two.
    """
    found = []
    for step, points in enumerate(paths, start=1):
        if not len(points):
            continue
        both, single = np.concatenate([points, points])[:2], np.array(len(points) == 1)
        if limits.hands:
            outside = " and ".join(dict.fromkeys(str(region) for region in limits.hands))
            found.append(Breach(step, float(out_of_reach(limits.hands, both, single)[0].max()), f"outside {outside}"))
        for zone in limits.keep_out:
            found.append(Breach(step, float(in_zone(zone, both, single).max()), f"inside {zone}"))
        close = float(too_close(limits.apart, both, single))
        found.append(Breach(step, close, f"nearer to the other one than the {float(limits.apart):g} m between them"))
    return [breach for breach in found if breach.distance > 0]


def hands_of(limits: Limits, points: Float[np.ndarray, "hands waypoints 3"]) -> tuple[int, ...] | None:
    """Which of the robot's hands, 0 or 1, follows each path; None if it doesn't matter, as both reach the same."""
    if len(limits.hands) < 2 or not len(points):
        return None
    both, single = np.concatenate([points, points])[:2], np.array(len(points) == 1)
    change = bool(out_of_reach(limits.hands, both, single)[1])
    return ((1, 0) if change else (0, 1))[: len(points)]


def graspable(limits: Limits, points: Float[np.ndarray, "points 3"]) -> np.ndarray:
    """Mask of the points that some hand can be at [m], `[points]`."""
    inside = [region.outside(points) <= 0 for region in limits.hands]
    free = [zone.outside(points) >= 0 for zone in limits.keep_out]
    able = np.any(inside, axis=0) if inside else np.ones(len(points), bool)
    return able & np.all(free, axis=0) if free else able


def _of_arrays(region: Region) -> Region:
    return type(region)(*(jnp.asarray(part, jnp.float32) for part in region))  # type: ignore[arg-type]


def _module(points: Any) -> Any:
    return jnp if isinstance(points, Array) else np


def _length(vectors: Any) -> Any:
    """The lengths of vectors, whose gradients are zero where the length is."""
    xp = _module(vectors)
    squared = (vectors**2).sum(-1)
    some = squared > 0
    return xp.where(some, xp.sqrt(xp.where(some, squared, 1.0)), 0.0)


def _told(numbers: Numbers) -> str:
    return "(" + ", ".join(f"{float(number):g}" for number in numbers) + ")"
