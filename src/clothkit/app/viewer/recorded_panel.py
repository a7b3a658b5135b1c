"""The tab for choosing a recorded session."""

from collections.abc import Sequence
from pathlib import Path

import viser

from clothkit.app.viewer.player import Player, by_hand
from clothkit.app.viewer.recorded import Entry, entries, session_of
from clothkit.runtime.errors import InputError

_ORDERS = ("by sequence", "worst first", "best first")


class RecordedPanel:
    """Lists the sessions that the pipeline has recorded, and plays the selected one."""

    def __init__(self, server: viser.ViserServer, player: Player, data: Path, systems: Sequence[str]) -> None:
        self._player, self._data = player, data
        gui = server.gui
        self._system = gui.add_dropdown("system", tuple(systems), hint="Which planner's sessions")
        self._split = gui.add_dropdown("split", ("test", "train"))
        self._steps = gui.add_dropdown("steps", ("all", "1", "2", "3"), hint="How many manipulations a session has")
        self._order = gui.add_dropdown("order", _ORDERS)
        self._task = gui.add_dropdown("task", ("none",), hint="From which state of which sequence to which")
        self._message = gui.add_markdown("")
        self._listed: dict[str, Entry] = {}
        for control in (self._system, self._split, self._steps, self._order):
            control.on_update(by_hand(self.list_tasks))
        self._task.on_update(by_hand(self.play))

    def list_tasks(self) -> None:
        """List the sessions that match the filters, in the chosen order, and play the selected one."""
        try:
            found = entries(self._data, self._system.value)
        except InputError as error:
            self._message.content = str(error)
            return
        found = [entry for entry in found if entry.split == self._split.value]
        if self._steps.value != "all":
            found = [entry for entry in found if entry.length == int(self._steps.value)]
        if self._order.value != "by sequence":
            sign = -1 if self._order.value == "worst first" else 1
            found.sort(key=lambda entry: sign * (entry.error or 0.0))
        self._listed = {entry.label: entry for entry in found}
        self._task.options = tuple(self._listed) or ("none",)
        self.play()

    def play(self) -> None:
        """Play the selected session."""
        entry = self._listed.get(self._task.value)
        if entry is None:
            self._message.content = "No such session is recorded."
            return
        try:
            self._player.show(session_of(self._data, self._system.value, entry))
        except InputError as error:
            self._message.content = str(error)
            return
        self._message.content = ""
