"""The viewer's page in a real browser: it is drawn, its slider moves, a session is planned and executed on it."""

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import viser
from playwright.sync_api import ConsoleMessage, FileChooser, Page, expect, sync_playwright
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from clothkit.app.inputs import load_settings
from clothkit.app.options import observation_options
from clothkit.app.viewer.page import build
from clothkit.cloth.topology import SQUARE
from tests.app import played

CHROMIUM = shutil.which("chromium")

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser: chromium is not installed (Debian: chromium)")

ARGUMENTS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
PATIENCE = 120_000
"""Milliseconds that a search or a simulation may take, compiled first on a machine that does other things, too."""


@pytest.fixture
def address(here: Path, data: Path, tmp_path: Path) -> Iterator[str]:
    """Where the page of a small data folder is served."""
    uploads = tmp_path / "uploads"
    uploads.mkdir()
    folder = played.fill(tmp_path / "played", data)
    settings = load_settings(Path("data"))
    options = observation_options(settings.app, side=None, table=None, table_colour=None, box=None)
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        build(server, data=folder, chosen="main", own=None, settings=settings, options=options, uploads=uploads)
        yield f"http://127.0.0.1:{server.get_port()}"
    finally:
        server.stop()


@pytest.fixture
def page(address: str) -> Iterator[Page]:
    """The page, opened; what went wrong on it is told in the end."""
    wrong: list[str] = []

    def note(message: ConsoleMessage) -> None:
        if message.type == "error":
            wrong.append(message.text)

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        page = browser.new_page(viewport={"width": 1300, "height": 900})
        page.set_default_timeout(PATIENCE)
        expect.set_options(timeout=PATIENCE)
        page.on("console", note)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(address)
        page.locator("canvas").first.wait_for()
        yield page
        browser.close()
    assert wrong == []


def picture(page: Page) -> np.ndarray:
    """What the page looks like without its panel."""
    seen = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return seen[:, :850]


def until(page: Page, seen: Callable[[np.ndarray], bool]) -> np.ndarray:
    """The picture, once it is as it should be: frames are drawn when the browser finds the time."""
    for _ in range(60):
        found = picture(page)
        if seen(found):
            return found
        page.wait_for_timeout(500)
    raise AssertionError("the picture never came to be as it should")


def share_of(found: np.ndarray, blue: int, green: int, red: int) -> float:
    """The share of pixels that are nearly of a colour."""
    return float((np.abs(found.astype(int) - [blue, green, red]).max(-1) < 30).mean())


def blue(found: np.ndarray) -> bool:
    """Whether there is much of the cloth's front."""
    return share_of(found, 180, 128, 74) > 0.02


def chooser(page: Page, button: str) -> FileChooser:
    """What a button opens to choose a file with: a click is lost while the panel that holds it is unfolding."""
    for _ in range(10):
        with contextlib.suppress(PlaywrightTimeout):
            with page.expect_file_chooser(timeout=PATIENCE / 10) as opened:
                page.get_by_role("button", name=button).click()
            return opened.value
    raise AssertionError(f"{button} opens nothing")


def test_sessions_are_played_planned_and_executed(page: Page, tmp_path: Path) -> None:
    # A recorded session, from its start to its outcome.
    expect(page.get_by_text("main, test sequence 0, state 0 to 2")).to_be_visible()
    expect(page.get_by_text("before manipulation 1 of 2")).to_be_visible()
    start = until(page, blue)
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 500
    slider = page.get_by_role("slider").first
    slider.focus()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_text("before manipulation 2 of 2")).to_be_visible()
    page.keyboard.press("ArrowRight")
    expect(page.get_by_text("outcome after 2 manipulations")).to_be_visible()
    until(page, lambda found: bool((np.abs(found.astype(int) - start).max(-1) > 40).mean() > 0.01))
    page.keyboard.press("Home")

    # Another colour, and everything side by side.
    page.get_by_label("colour").click()
    page.get_by_role("option", name="disagreement").click()
    expect(page.get_by_text("distance between the nets' predictions")).to_be_visible()
    until(page, lambda found: not blue(found))
    page.get_by_label("side by side").click()
    page.get_by_label("colour").click()
    page.get_by_role("option", name="side").click()
    until(page, blue)

    # A session of a test task is made: one manipulation, planned by nets that have learned nothing.
    page.get_by_role("tab", name="Live").click()
    page.get_by_label("task").last.click()
    page.get_by_role("option", name="sequence 1, state 1 to 2").click()
    expect(page.get_by_text("1 manipulation to plan.")).to_be_visible(timeout=PATIENCE)
    expect(page.get_by_text("no plan yet")).to_be_visible()
    plan, execute = (page.get_by_role("button", name=name, exact=True) for name in ("plan", "execute"))
    expect(execute).to_be_disabled()
    plan.click()
    expect(execute).to_be_enabled(timeout=PATIENCE)
    expect(page.get_by_text("the nets differ by")).to_be_visible()
    expect(page.get_by_text("lowest loss against plans tried")).to_be_visible()
    execute.click()
    expect(page.get_by_text("the session is over")).to_be_visible(timeout=PATIENCE)
    expect(page.get_by_text("outcome after 1 manipulation")).to_be_visible()
    expect(plan).to_be_disabled()

    # Own files are uploaded; what is wrong with them is told.
    page.get_by_text("Own files", exact=True).click()
    for name, content in (("state", np.zeros((5, 5))), ("goal", SQUARE.flat())):
        np.save(tmp_path / f"my_{name}.npy", content)
        chooser(page, f"upload {name}").set_files(tmp_path / f"my_{name}.npy")
        expect(page.get_by_text(f"my_{name}.npy is here")).to_be_visible()
    page.get_by_role("button", name="load", exact=True).click()
    expect(page.get_by_text("my_state.npy: has shape [5, 5]")).to_be_visible()

    # As many manipulations as are worth it, from a file that is right.
    np.save(tmp_path / "flat.npy", SQUARE.flat())
    chooser(page, "upload state").set_files(tmp_path / "flat.npy")
    expect(page.get_by_text("flat.npy is here")).to_be_visible()
    page.get_by_label("as many as are worth it").click()
    page.get_by_role("button", name="load", exact=True).click()
    expect(page.get_by_text("at most 3 manipulations to plan.")).to_be_visible()
