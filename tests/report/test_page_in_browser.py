"""The HTML page as a browser shows it: wide and narrow, light and dark, without a network."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from clothkit.report.sections import CAPTIONS, DRAWN
from tests.report.web import made_up_page

CHROMIUM = shutil.which("chromium")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser: chromium is not installed (Debian: chromium)")

HEIGHT = 1800

# Tells the frame around it what the page looks like from inside; the page itself has no script.
PROBE = """<script>addEventListener("load", () => {
  const root = document.documentElement, frames = [...document.querySelectorAll(".scroll")];
  const background = getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number);
  const shown = node => { const box = node.getBoundingClientRect(); return box.width > 0 && box.height > 0; };
  parent.postMessage(JSON.stringify({
    inner: innerWidth, scroll: root.scrollWidth, client: root.clientWidth,
    images: [...document.images].filter(image => image.complete && image.naturalWidth > 0 && shown(image)).length,
    tables: [...document.querySelectorAll("table")].filter(shown).length,
    cards: [...document.querySelectorAll(".card")].filter(shown).length,
    scrolling: frames.filter(frame => frame.scrollWidth > frame.clientWidth).length,
    light: background.reduce((sum, part) => sum + part) / 3,
    contents: getComputedStyle(document.querySelector("nav")).position,
  }), "*");
});</script>"""

# A headless window is never narrower than 500 pixels, so that a phone is a frame in it.
FRAME = """<!doctype html><html><head><meta name="color-scheme" content="light dark">
<style>body {{ margin: 0 }} iframe {{ border: 0 }}</style></head><body>
<script>addEventListener("message", event => document.documentElement.dataset.seen = event.data);</script>
<iframe src="page.html" width="{width}" height="{height}"></iframe></body></html>"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("browser")
    (folder / "page.html").write_text(made_up_page(folder / "report").replace("</body>", f"{PROBE}</body>"))
    return folder


def look(folder: Path, width: int, *, dark: bool) -> tuple[dict[str, Any], np.ndarray, list[str]]:
    """What the page says of itself in a frame of that width, a screenshot of the frame, and the console's lines."""
    (folder / "frame.html").write_text(FRAME.format(width=width, height=HEIGHT))
    screenshot = folder / "screenshot.png"
    screenshot.unlink(missing_ok=True)
    ended = subprocess.run(
        [
            str(CHROMIUM),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--host-resolver-rules=MAP * ~NOTFOUND",
            f"--user-data-dir={folder / 'profile'}",
            f"--window-size={max(width, 500)},{HEIGHT}",
            *(["--force-dark-mode"] if dark else []),
            "--virtual-time-budget=10000",
            f"--screenshot={screenshot}",
            "--dump-dom",
            "--enable-logging=stderr",
            (folder / "frame.html").as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=180,
        check=True,
    )
    seen = re.search(r'data-seen="([^"]*)"', ended.stdout)
    assert seen, ended.stderr
    console = [line for line in ended.stderr.splitlines() if "CONSOLE" in line]
    return json.loads(html.unescape(seen[1])), cv2.imread(str(screenshot))[:, :width], console


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390], ids=["desktop", "phone"])
def test_the_page_is_shown(folder: Path, width: int, dark: bool) -> None:
    seen, picture, console = look(folder, width, dark=dark)
    assert console == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["client"], "the page itself scrolls sideways"
    assert seen["images"] == len(CAPTIONS) + len(DRAWN)
    assert seen["cards"] == 4
    # Those of the test set: the training set's are folded away.
    assert seen["tables"] >= 13
    assert seen["contents"] == "sticky"
    assert (seen["light"] < 60) == dark
    if width < 500:
        assert seen["scrolling"] > 10, "pictures and tables scroll in their frames"
    # Not blank: the page's background prevails and is what it should be, and there is much upon it.
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    background = int(np.bincount(grey.ravel()).argmax())
    assert (background < 60) == dark
    apart = np.abs(grey.astype(int) - background) > 40
    assert 0.01 < apart.mean() < 0.7
    assert (apart.any(axis=1)).mean() > 0.3
    colours = picture.reshape(-1, 3).astype(int)
    assert (np.ptp(colours, axis=1) > 60).any(), "nothing is in colour"
