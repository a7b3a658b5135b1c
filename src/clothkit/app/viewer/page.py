"""The whole page: two tabs for choosing a session, and the player below them."""

from functools import partial
from pathlib import Path

import viser

from clothkit.app.inputs import Settings
from clothkit.app.options import ObservationOptions
from clothkit.app.viewer.live_panel import LivePanel
from clothkit.app.viewer.player import Player
from clothkit.app.viewer.recorded import systems_in
from clothkit.app.viewer.recorded_panel import RecordedPanel
from clothkit.app.viewer.recording import write_recording
from clothkit.app.viewer.tasks import SessionFiles, test_tasks


def build(
    server: viser.ViserServer,
    *,
    data: Path,
    chosen: str,
    own: SessionFiles | None,
    settings: Settings,
    options: ObservationOptions,
    uploads: Path,
    record: Path | None = None,
) -> None:
    """Build the page, and show the first session on it. Raises InputError for artifacts that can't be read.

    The session that the page shows is kept in the recording `record`, if that is given.
    """
    systems, tasks = systems_in(data), test_tasks(data / "meshes.zarr")
    gui = server.gui
    # The share button would send the page through an external server.
    gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(111, 66, 193))
    gui.set_panel_label("clothkit")
    gui.main_panel.dock_right()
    tabs = gui.add_tab_group()
    keep = None
    if record is not None:
        keep = partial(write_recording, record, side=options.side, motion=settings.app.motion)
    player = Player(server, keep=keep)
    recorded = None
    if systems and own is None:
        with tabs.add_tab("Recorded"):
            recorded = RecordedPanel(server, player, data, systems)
    with tabs.add_tab("Live"):
        live = LivePanel(
            server, player, tasks, own, chosen=chosen, data=data, settings=settings, options=options, uploads=uploads
        )
    if systems and own is not None:
        with tabs.add_tab("Recorded"):
            RecordedPanel(server, player, data, systems)
    if recorded is not None:
        recorded.list_tasks()
    elif own is not None:
        live.begin()
