"""The card as one Markdown page: the dataset's contents, how to read it, its quality, and pictures."""

import re
from dataclasses import dataclass

import pandas as pd

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.report.card.columns import described
from clothkit.report.card.inputs import PARTS, Inputs
from clothkit.report.card.meanings import flatten
from clothkit.report.card.measures import highest, limits
from clothkit.report.card.tables import TOLERANCE, WITHIN
from clothkit.report.markdown import tables as markdown


@dataclass(frozen=True)
class Contents:
    """The content of the page."""

    inputs: Inputs
    settings: pd.DataFrame
    outcomes: pd.DataFrame
    hands: pd.DataFrame
    quality: pd.DataFrame
    quality_tried: pd.DataFrame
    against_tried: pd.DataFrame
    viewport: pd.DataFrame
    worst: pd.DataFrame
    pictured: int
    """Number of sequences in the picture, drawn at random."""
    seed: int
    """Seed of that draw."""


TABLES = ("settings", "outcomes", "hands", "quality", "quality_tried", "against_tried", "viewport", "worst")
"""Names of the tables that are also written as CSV."""

# A sentence is printed only if the artifacts' settings contain all values that it mentions.
_SENTENCES = (
    "The states come from {source}, of the runs listed in `{runs}/runs.csv`.",
    "Hands move at {simulation.hand_speed} m/s on average, along arcs that rise {simulation.highest_lift} (normalised) "
    "at the most above the point that was grasped.",
    "Where layers lie on each other, hands grasp: {simulation.grasp}.",
    "A hand works alone with probability {sampling.single_share}.",
    "The simulator's time step is {simulation.time_step} s.",
    "A state is recorded when no vertex has moved faster than {simulation.settling.rest_speed} m/s for "
    "{simulation.settling.rest_time} s.",
    "A state is kept when it stands no higher than {limits.height} (normalised), at most {limits.intersections} edges "
    "pierce a triangle, the strain's 99th percentile is at most {limits.strain_p99} and its largest at most "
    "{limits.strain_worst}, and layers lie no closer than {limits.gap} of the distance at which they touch; a "
    "sequence is kept when all its states are.",
    "The seed of all random numbers is {seed}.",
)

_ONE_CLOTH = (
    "The cloth is a square of {simulation.cloth_side} m with {simulation.side} x {simulation.side} vertices, on a "
    "table.",
    "Layers lie {simulation.material.thickness} m apart where they touch.",
    "Friction coefficients are {simulation.material.cloth_friction} between layers and "
    "{simulation.material.table_friction} on the table.",
)
_DRAWN_CLOTHS = (
    "Cloths are drawn for each sequence and stored in `cloths.parquet`: squares and rectangles of {simulation.side} x "
    "{simulation.side} vertices whose longer side is {simulation.cloth_side} m.",
    "Layers lie {variation.thickness} m apart where they touch.",
    "Friction coefficients are {variation.cloth_friction} between layers and {variation.table_friction} on the table.",
)

_FILES = {
    "states": "`states/*.parquet`: a row per state, of hundreds of sequences a file",
    "manipulations.parquet": "`manipulations.parquet`: a row per manipulation",
    "attempts.parquet": "`attempts.parquet`: a row per tried sequence, accepted or not",
    "topologies.parquet": "`topologies.parquet`: a row per triangulation of the cloth",
    "cloths.parquet": "`cloths.parquet`: a row per sequence, its cloth",
}


def page(contents: Contents) -> str:
    """The page as a Markdown string, with links to the files that `build` writes beside it."""
    inputs = contents.inputs
    parts = [
        "# The dataset\n",
        _summary(inputs),
        "## Read it\n",
        "The files are Parquet, which pandas reads (pyarrow beneath). From the repository's root:\n",
        f"```python\n{reading(inputs)}```\n",
        "## Words and frames\n",
        _words(inputs),
        "## Files\n",
        "All lie in `data/raw`. Each carries the settings that it was made with, as JSON under the key `clothkit` of "
        "its schema's metadata.\n",
        *(f"{_FILES[part]}\n\n{markdown.plain(described(part, inputs.columns[part]))}" for part in PARTS),
        "`croissant.json` beside this page tells the same to machines, with the files' checksums.\n",
        "To open states elsewhere, export them to OBJ, PLY or GLB (metres, texture coordinates = material):\n",
        f"    ./run python -m clothkit.app.export data/raw --sequence {_first(inputs)} --format glb --to exported/\n",
        "## How it was made\n",
        in_words(inputs),
        _all_settings(contents.settings),
        "## Yield\n",
        _csv("outcomes"),
        markdown.plain(contents.outcomes),
        "Hands:\n",
        markdown.plain(contents.hands),
        "## Quality\n",
        "States of accepted sequences after each manipulation. The worst is the largest, of gaps the smallest.\n",
        _gap_of_each(inputs),
        _csv("quality"),
        markdown.plain(contents.quality),
        _tried(contents),
        "![Histograms](figures/histograms.png)\n",
        "*Shares of the accepted states after each manipulation; dashed red: limits of acceptance, and the "
        "displacement below which a manipulation would be null.*\n",
        f"## {contents.pictured} sequences\n",
        f"Drawn at random (seed {contents.seed}) from all accepted sequences, not chosen.\n",
        "![Sequences](figures/sequences.png)\n",
        "*From above, centred; blue and orange are the cloth's two sides. Dotted: the hands' ways from where they "
        "grasp (circle) to where they let go (cross), red the first, green the other. The number is the height "
        "[normalised] of the state as it is drawn, interpolated to 32 x 32 vertices.*\n",
        _worst(contents),
    ]
    return "\n".join(part for part in parts if part)


def reading(inputs: Inputs) -> str:
    """Python code that reads the dataset, to be run from the repository's root."""
    q = _first(inputs)
    return f"""import pandas as pd
states = pd.read_parquet("data/raw/states").set_index(["sequence", "state"])
manipulations = pd.read_parquet("data/raw/manipulations.parquet").set_index(["sequence", "step"])
after_one = states.loc[({q}, 1), "vertices"].reshape(-1, 3)  # metres: x, y, z of each vertex
how = manipulations.loc[({q}, 0), ["u1", "v1", "u2", "v2", "dx", "dy"]]  # what led there
"""


def in_words(inputs: Inputs) -> str:
    """Sentences on how the artifacts were made, from their settings; sentences with missing settings are left out."""
    attributes, stated = inputs.attributes, flatten(inputs.params)
    cloths = _DRAWN_CLOTHS if _are_drawn(inputs) else _ONE_CLOTH
    told = (*_SENTENCES[:1], *cloths, *_SENTENCES[1:])
    keys = {sentence: re.findall(r"{([^}]*)}", sentence) for sentence in told}
    sentences = [
        re.sub(r"{([^}]*)}", lambda match: _value(stated[match[1]]), sentence)
        for sentence in told
        if all(key in stated for key in keys[sentence])
    ]
    origin = ", ".join(f"{key} *{attributes[key]}*" for key in ("stage", "scale") if key in attributes)
    return " ".join([f"Made by {origin}.", *sentences] if origin else sentences or ["The files do not say."]) + "\n"


def _are_drawn(inputs: Inputs) -> bool:
    """Whether each sequence has another cloth."""
    return "variation.thickness" in flatten(inputs.params)


def _gap_of_each(inputs: Inputs) -> str:
    """The sentence on the limit of gaps where it is another for each cloth; "" where it is one, or unknown."""
    share = flatten(inputs.params).get("limits.gap")
    if not _are_drawn(inputs) or share is None:
        return ""
    return f"The limit of the gap is {_value(share)} of each cloth's own thickness, so it is no one length.\n"


def _value(value: object) -> str:
    if isinstance(value, list | tuple):
        return " to ".join(_value(part) for part in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _first(inputs: Inputs) -> int:
    return int(inputs.states["sequence"].iloc[0])


def _summary(inputs: Inputs) -> str:
    moves, sequences = len(inputs.manipulations), inputs.states["sequence"].nunique()
    lengths = inputs.manipulations.groupby("sequence").size()
    long = f"{lengths.min()}" if lengths.min() == lengths.max() else f"{lengths.min()} to {lengths.max()}"
    vertices = sorted(set(inputs.vertices.values()))
    counts = f"{vertices[0]}" if len(vertices) == 1 else f"{vertices[0]} to {vertices[-1]}"
    kept = inputs.attempts["accepted"].astype(bool)
    topologies = "one triangulation" if len(inputs.vertices) == 1 else f"{len(inputs.vertices)} triangulations"
    many = "manipulation" if long == "1" else "manipulations"
    cloth = "a cloth, another one in each," if _are_drawn(inputs) else "a square cloth"
    return (
        f"Sequences of {cloth} that lies on a table and is folded by a robot with one or two hands, "
        "simulated: every state at rest as a triangle mesh, and between states what the hands did. For learning what a "
        f"manipulation does to a cloth.\n\n**{sequences} sequences** of {long} {many}: **{len(inputs.states)} "
        f"states**, {moves} manipulations, {counts} vertices a state in {topologies}. Of {len(kept)} tried sequences "
        f"{int(kept.sum())} were accepted ({_percent(kept.mean())}); "
        f"{_percent((inputs.manipulations['hands'] == 1).mean())} of the manipulations are single-handed.\n"
    )


def _words(inputs: Inputs) -> str:
    smallest, largest = (f"{side / CLOTH_LENGTH:.4g}" for side in inputs.sides)
    metres = f", so 1 is {smallest} m here" if smallest == largest else f": 1 is {smallest} to {largest} m here"
    side = "longer side" if _are_drawn(inputs) else "side"
    return (
        "- *World frame*: metres, z up, the table is z = 0. The flat cloth's sides lie along x and y.\n"
        f"- *Normalised* lengths: the flat cloth's {side} is {CLOTH_LENGTH}{metres}.\n"
        "- *Geodesic* coordinates (u, v): a point on the cloth, -1 to 1 from edge to edge; u runs along x on the flat "
        "cloth, v along y.\n"
        "- A *manipulation*: one or two hands grasp the cloth at (u1, v1) and (u2, v2), move on arcs, let go, and the "
        "cloth comes to rest. The displacement (dx, dy) is that of the point midway between the hands. Each hand ends "
        "at the mirror image of its start, over the line that halves the displacement and stands across it: both move "
        "along (dx, dy), but not always equally far. A *step* is one manipulation of a sequence.\n"
        "- *Folds* are connected creases: places across which the cloth's facing turns by more than 90 degrees.\n"
    )


def _all_settings(settings: pd.DataFrame) -> str:
    if settings.empty:
        return ""
    return (
        f"<details><summary>Every setting ({len(settings)})</summary>\n\n{_csv('settings')}\n"
        f"{markdown.plain(settings)}\n</details>\n"
    )


def _tried(contents: Contents) -> str:
    """The section on tried states and their comparison with accepted ones, if the attempts were recorded."""
    parts = []
    if contents.quality_tried["states"].any():
        share = contents.viewport["higher"].sum() / max(contents.viewport["tried states"].sum(), 1)
        bounds = limits(contents.inputs.params)
        meaning = "the limit of acceptance" if "height" in bounds else "the paper's viewport"
        parts += [
            "### Tried states\n",
            "The same for all tried states, those of rejected sequences among them.\n",
            _csv("quality_tried"),
            markdown.plain(contents.quality_tried),
            f"**{_percent(share)} of the tried states** stand higher than {highest(bounds):g} (normalised), "
            f"{meaning}:\n",
            markdown.plain(contents.viewport),
        ]
    if (contents.against_tried[WITHIN] != "–").any():
        parts += [
            "### Accepted against tried\n",
            "Limits reject some folds more than others. So that the data are as hard as the folds that were tried, the "
            f"medians of fold count and silhouette area may differ by {100 * TOLERANCE:.0f} % at the most: "
            f"{_verdict(contents)}\n",
            _csv("against_tried"),
            markdown.plain(contents.against_tried),
        ]
    return "\n".join(parts)


def _verdict(contents: Contents) -> str:
    table = contents.against_tried
    broken = table[table[WITHIN] == "no"]
    largest = table["difference [%]"].abs().max()
    if broken.empty:
        return f"**they do**, the largest difference is {largest:.1f} %."
    names = ", ".join(f"{row['measure']} after step {row['step']}" for _, row in broken.iterrows())
    return f"**they differ by more**: {names}."


def _worst(contents: Contents) -> str:
    if contents.worst.empty:
        return ""
    each = int(contents.worst.groupby("measure").size().max())
    return "\n".join(
        [
            f"## The {len(contents.worst)} worst states\n",
            f"The {each} worst of all accepted states by each of the measures. *No.* is the place in the measure's "
            "ranking: a state that is already shown for another measure gives way to the next.\n",
            "![Worst states](figures/worst.png)\n",
            "*From above, each filling its frame, and below coloured by height [normalised].*\n",
            _csv("worst"),
        ]
    )


def _csv(name: str) -> str:
    return f"[CSV](tables/{name}.csv)\n"
