"""Pictures inside the page: as WebP in a data URI, in a frame that scrolls where the screen is narrow."""

import base64
from pathlib import Path

import cv2

from clothkit.report.html.elements import Html, element, inline, joined, unmarked

TITLES = {
    "sessions_1": "Figure 12, one step",
    "sessions_2": "Figure 12, two steps",
    "sessions_3": "Figure 12, three steps",
    "scatter": "Figure 11",
    "largest": "Largest errors",
    "predictions": "Figure 10",
    "estimates": "Figure 9",
    "calibration": "Calibration",
    "camera": "Before depth cameras",
    "sequences": "Simulated sequences",
    "curves": "Learning curves",
    "meshes": "Figures 2 and 3",
    "voxels": "Figure 4",
    "trajectories": "Figure 5",
    "equivalents": "Figure 7",
}
"""The paper's numbers where the figure is the paper's."""

QUALITY = 85
"""Of WebP, of 100."""

LEAST = (0.55, 860)
"""What a picture is shrunk to at the most: a share of its width, and pixels of the page if that is less."""


def picture(name: str, caption: str, file: Path) -> Html:
    """A figure with its title and its caption, which is Markdown.

    `file` is the PNG, which lies as `figures/<name>.png` beside the page.
    """
    image = cv2.imread(str(file))
    assert image is not None, f"{file} is a picture"
    # A quarter of the PNG's bytes, which the page is kept beside.
    _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    height, width = image.shape[:2]
    shown = element(
        "img",
        src=f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode()}",
        alt=unmarked(caption),
        width=width,
        height=height,
        style=f"min-width:{min(round(LEAST[0] * width), LEAST[1])}px",
    )
    title = element("strong", f"{TITLES[name]}.")
    link = element("a", "PNG", href=f"figures/{name}.png")
    below = element("figcaption", title, " ", inline(caption), " ", link)
    frame = element(
        "div", shown, class_="frame scroll", tabindex=0, role="region", aria_label=f"{TITLES[name]}, picture"
    )
    return element("figure", joined(frame, below), id=f"figure-{name}")
