"""Colours of vertices by mode, and the legend that explains them."""

from typing import Literal, NamedTuple, get_args

import numpy as np
from jaxtyping import Float

from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.report.draw import BACK, FRONT, relief_colours

Colour = tuple[float, float, float] | Float[np.ndarray, "3"]
"""Red, green and blue, 0..1."""

Mode = Literal["side", "height", "sigma", "disagreement"]
MODES: tuple[Mode, ...] = get_args(Mode)

UNKNOWN = (0.72, 0.72, 0.72)
"""Colour of vertices whose value is not known in the mode."""
GHOST = (0.25, 0.25, 0.33)
HANDS = ((0.776, 0.157, 0.157), (0.180, 0.490, 0.196))
"""Colours of the paths of the first and the second hand, as in the report."""
CANDIDATE = (0.557, 0.357, 0.816)

# Luminance falls steadily from pale to dark, so that the scale can be read by colour-blind people and in grey prints.
_SIGMA = ((0.96, 0.95, 0.98), (0.66, 0.47, 0.85), (0.24, 0.08, 0.42))
_DISAGREEMENT = ((0.98, 0.96, 0.93), (0.95, 0.55, 0.24), (0.50, 0.06, 0.10))

_SAYS = {
    "height": "height above the table",
    "sigma": "standard deviation of a vertex's place (root mean square of x, y, z)",
    "disagreement": "distance between the nets' predictions of a vertex (mean over all pairs of nets)",
}


class Scale(NamedTuple):
    """A mode, and the value [normalised] at the upper end of its colour scale."""

    mode: Mode
    highest: float


def colours(values: Float[np.ndarray, "*shape"], scale: Scale) -> Float[np.ndarray, "*shape 3"]:
    """Map values [normalised] to colours 0..1, from 0 to the scale's highest value; not for mode side."""
    share = np.clip(values / scale.highest, 0, 1)
    if scale.mode == "height":
        return relief_colours(share)
    stops = np.array(_SIGMA if scale.mode == "sigma" else _DISAGREEMENT)
    along = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(share, along, channel) for channel in stops.T], axis=-1).astype(np.float32)


def sigma_of(sigma: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape"]:
    """Return one standard deviation per vertex: the root mean square over its coordinates."""
    return np.sqrt(np.mean(np.square(sigma, dtype=np.float32), axis=-1))


def round_up(value: float) -> float:
    """Round up to 1, 2 or 5 times a power of ten, for the end of a scale; 0.001 if not positive or not finite."""
    if not np.isfinite(value) or value <= 0:
        return 0.001
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-6)))


def legend(scale: Scale) -> str:
    """Return the legend of a colour scale as HTML."""
    if scale.mode == "side":
        return _LEGEND.format(body=_swatch(FRONT, "front") + _swatch(BACK, "back"), says="sides of the cloth")
    shown = colours(np.linspace(0, scale.highest, 9), scale)
    ramp = f"linear-gradient(90deg,{','.join(map(css, shown))})"
    bar = f'<div style="height:10px;border-radius:3px;background:{ramp}"></div>'
    ends = (
        '<div style="display:flex;justify-content:space-between"><span>0</span>'
        f"<span>{scale.highest / CLOTH_LENGTH:g} cloth lengths</span></div>"
    )
    grey = _swatch(UNKNOWN, "not known") if scale.mode != "height" else ""
    return _LEGEND.format(body=bar + ends + grey, says=_SAYS[scale.mode])


_LEGEND = '<div style="font-size:12px;padding:2px 12px 8px">{body}<div style="opacity:.7">{says}</div></div>'


def _swatch(colour: Colour, name: str) -> str:
    square = (
        f'<span style="display:inline-block;width:11px;height:11px;border-radius:2px;background:{css(colour)}"></span>'
    )
    return f'<span style="margin-right:12px">{square} {name}</span>'


def css(colour: Colour) -> str:
    """Return a colour in CSS notation."""
    return "rgb({},{},{})".format(*rgb(colour))


def rgb(colour: Colour) -> tuple[int, int, int]:
    """Return a colour 0..1 as three bytes."""
    red, green, blue = (round(255 * float(channel)) for channel in colour)
    return red, green, blue
