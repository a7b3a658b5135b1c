"""Unit and meaning of every column of the raw artifacts, for the card's lists of columns."""

from collections.abc import Mapping, Sequence

import pandas as pd

_QUALITY = {
    "height": ("normalised", "of the highest vertex"),
    "strain_p99": (
        "1",
        "99th percentile of strains. Of an edge along the grid's rows or columns, with l its length over that at rest: "
        "l - 1 if it is longer than at rest; if it is shorter, only what it lacks of the chord, max(c - l, 0), because "
        "an edge that is bent over a fold is shorter than its arc. c = sqrt((1 + t) / 2), from 0.3 to 1, where t is "
        "the scalar product of the edges before and after it, over their lengths at rest: the cosine of the angle by "
        "which the cloth turns. At the border, c = 1. Over all edges of an irregular triangulation: abs(l - 1)",
    ),
    "strain_worst": ("1", "the largest of these"),
    "intersections": ("count", "pairs of an edge and a triangle that pierce each other"),
    "gap": (
        "m",
        "smallest distance of a vertex to another part of the cloth: to triangles that touch no vertex within two "
        "rows and columns of it; at most three grid spacings",
    ),
    "residual_speed": ("m/s", "of the fastest vertex, the largest over the last moments before the state was recorded"),
}
_SEQUENCE = ("", "number of the sequence")

MEANINGS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "states": {
        "sequence": _SEQUENCE,
        "state": ("", "0 is the first one, k the cloth at rest after k manipulations"),
        "topology": ("", "which row of `topologies.parquet` the vertices belong to"),
        "vertices": ("m", "x y z of each vertex in turn, world frame: `reshape(-1, 3)`"),
        **_QUALITY,
    },
    "manipulations.parquet": {
        "sequence": _SEQUENCE,
        "step": ("", "k leads from state k to state k + 1"),
        "hands": ("", "1 or 2"),
        "u1": ("geodesic", "where the first hand grasps: u on the cloth"),
        "v1": ("geodesic", "and v"),
        "u2": ("geodesic", "where the second hand grasps; the same point again for one hand"),
        "v2": ("geodesic", "and v"),
        "dx": ("normalised", "displacement along x of the point midway between the hands"),
        "dy": ("normalised", "and along y"),
        "release_x1": ("m", "where the first hand lets go: x"),
        "release_y1": ("m", "and y"),
        "release_x2": ("m", "where the second hand lets go: x"),
        "release_y2": ("m", "and y"),
        "seed": ("", "of the whole run's random numbers"),
        "attempt": ("", "which row of `attempts.parquet` the sequence is"),
        "settle_time": ("s", "simulated, from release to rest"),
    },
    "attempts.parquet": {
        "attempt": ("", "number of the tried sequence"),
        "seed": ("", "of the whole run's random numbers"),
        "accepted": ("", "whether it became a sequence of the dataset"),
        "reason": ("", "the first check that it failed; empty when accepted"),
        "states": ("count", "states that it reached, with the first one and the one that was rejected"),
        "area": ("flat cloth's", "of the silhouette, per state; 0 where there is none"),
        "folds": ("count", "connected creases, per state; 0 where there is none"),
        **{name: (unit, f"per state: {meaning}; NaN if not reached") for name, (unit, meaning) in _QUALITY.items()},
        "settle_time": ("s", "per step, simulated, from release to rest; NaN if not reached"),
    },
    "topologies.parquet": {
        "topology": ("", "number"),
        "material": ("m", "x y of each vertex in turn, on the flat cloth"),
        "triangles": (
            "",
            "three vertex numbers of each triangle in turn, counter-clockwise on the flat cloth: `reshape(-1, 3)`",
        ),
    },
    "cloths.parquet": {
        "sequence": _SEQUENCE,
        "start": ("", "how the cloth came to lie as it did at first: flat, dragged or dropped"),
        "side_u": ("m", "of the flat cloth, along u"),
        "side_v": ("m", "and along v"),
        "thickness": ("m", "distance of touching layers"),
        "density": ("kg/m^2", "mass per area"),
        "stretch_stiffness": ("N/m", "tension per strain along the threads"),
        "shear_stiffness": ("N/m", "shear force per length and angle"),
        "bending_stiffness": ("N m", "moment per width and curvature"),
        "bending_limit": ("1/m", "curvature beyond which the moment no longer grows"),
        "cloth_friction": ("", "coefficient, of the cloth on itself"),
        "table_friction": ("", "coefficient, on the table"),
        "goal": ("", "named goal whose folds the first manipulations nearly are; none if all are random"),
    },
}


def described(part: str, columns: Sequence[tuple[str, str]]) -> pd.DataFrame:
    """A row per column of a file: column, type, unit, holds (meaning); the last two are empty if not in MEANINGS."""
    known = MEANINGS[part]
    rows = [(f"`{name}`", f"`{kind}`", *known.get(name, ("", ""))) for name, kind in columns]
    return pd.DataFrame(rows, columns=["column", "type", "unit", "holds"])
