"""Embeds pictures in the page as WebP in a data URI, in a frame that scrolls on narrow screens."""

import base64
from pathlib import Path

import cv2

from clothkit.report.blocks import Picture
from clothkit.report.html.elements import Html, element, inline, joined, unmarked

QUALITY = 85
"""WebP quality, 0 to 100."""

LEAST = (0.55, 860)
"""Least width of a picture on the page: a share of the picture's width, but at most this many pixels."""


def picture(block: Picture, file: Path) -> Html:
    """A figure element with title and caption.

    `file` is the PNG to read. The element links to it as it lies beside the page.
    """
    image = cv2.imread(str(file))
    assert image is not None, f"{file} is a picture"
    # WebP takes a quarter of the PNG's bytes; the PNG itself is beside the page.
    _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    height, width = image.shape[:2]
    shown = element(
        "img",
        src=f"data:image/webp;base64,{base64.b64encode(data.tobytes()).decode()}",
        alt=unmarked(block.caption),
        width=width,
        height=height,
        style=f"min-width:{min(round(LEAST[0] * width), LEAST[1])}px",
    )
    title = element("strong", f"{block.title}.")
    link = element("a", "PNG", href=block.png)
    below = element("figcaption", title, " ", inline(block.caption), " ", link)
    frame = element(
        "div", shown, class_="frame scroll", tabindex=0, role="region", aria_label=f"{block.title}, picture"
    )
    return element("figure", joined(frame, below), id=f"figure-{block.name}")
