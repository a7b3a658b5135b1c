"""The part of the page that plays a session: step slider, view options, legend, and facts about the state."""

import threading
from collections.abc import Callable
from typing import Any, TypeVar, get_args

import numpy as np
import viser
import viser.uplot

from clothkit.app.viewer.canvas import Canvas
from clothkit.app.viewer.colours import MODES, legend
from clothkit.app.viewer.scene import Ghost, View, scale_of, scene_of, to_show
from clothkit.app.viewer.session import Session, facts

_STATE = "state"

T = TypeVar("T")


def by_hand(callback: Callable[[], None]) -> Callable[[viser.GuiEvent[Any]], None]:
    """Wrap a control's callback, so that it is called for a person's changes and not for those by the page itself."""

    def called(event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:
            callback()

    return called


def assign(control: viser.GuiInputHandle[T], value: T) -> None:
    """Set a control's value. In one place, because type checkers take viser's property for a read-only one."""
    control.value = value  # type: ignore[misc]


class Player:
    """Shows one session, at one of its states."""

    def __init__(self, server: viser.ViserServer, *, keep: Callable[[Session], None] | None = None) -> None:
        """`keep` is called with every session that is shown, and whenever a plan or a state has come to it."""
        self._canvas, self._keep = Canvas(server), keep
        self._session: Session | None = None
        self._middles: object = None
        # Callbacks run in several threads, and a search shows its progress while others run.
        self._lock = threading.RLock()
        gui = server.gui
        self._at = gui.add_slider("step", 0, 1, 1, 0, disabled=True)
        self._facts = gui.add_markdown("Choose a session.")
        self._curve = gui.add_uplot(
            (np.zeros(2), np.zeros(2)),
            (
                viser.uplot.Series(label="plans tried"),
                viser.uplot.Series(label="lowest loss", stroke="#8e5bd0", width=2),
            ),
            title="lowest loss against plans tried",
            # The loss may be huge at first and negative in the end. distr=4 is arcsinh, logarithmic for either sign.
            scales={"x": viser.uplot.Scale(time=False), "y": viser.uplot.Scale(distr=4)},
            axes=(viser.uplot.Axis(), viser.uplot.Axis(size=70)),
            legend=viser.uplot.Legend(show=False),
            height=150,
            visible=False,
        )
        with gui.add_folder("View"):
            self._shown = gui.add_dropdown("cloth", (_STATE,), hint="Which cloth is shown")
            self._abreast = gui.add_checkbox("side by side", False)
            self._mode = gui.add_dropdown("colour", MODES, hint="What the cloth's colours tell")
            self._legend = gui.add_html("")
            self._ghost = gui.add_dropdown("goal", get_args(Ghost))
            self._paths = gui.add_checkbox("paths", True, hint="Of the hands")
            self._candidates = gui.add_checkbox("candidates", True, hint="Grasp points that a plan may start with")
        self._at.on_update(by_hand(self._moved))
        for control in (self._shown, self._abreast, self._mode, self._ghost, self._paths, self._candidates):
            control.on_update(by_hand(self._draw))

    def show(self, session: Session, *, at: int | None = None, shown: str | None = None) -> None:
        """Show a session at state `at` (default: the first); `shown` names the cloth to show."""
        with self._lock:
            if self._keep is not None:
                self._keep(session)
            self._session = session
            last = len(session.states) - 1
            self._at.max = max(last, 1)
            self._at.disabled = last == 0
            assign(self._at, min(at or 0, last))
            if shown is not None:
                self._shown.options = (*dict.fromkeys((*self._shown.options, shown)),)
                assign(self._shown, shown)
            self._moved()

    def _moved(self) -> None:
        with self._lock:
            if self._session is None:
                return
            names = tuple(shown.name for shown in to_show(self._session, self._place))
            self._shown.options = names
            self._draw()

    @property
    def _place(self) -> int:
        assert self._session is not None
        return min(int(self._at.value), len(self._session.states) - 1)

    def _draw(self) -> None:
        with self._lock:
            session = self._session
            if session is None:
                return
            abreast = self._abreast.value
            self._shown.disabled = self._ghost.disabled = abreast
            view = View(
                self._shown.value,
                self._mode.value,
                self._ghost.value,
                candidates=self._candidates.value,
                paths=self._paths.value,
                abreast=abreast,
            )
            scene = scene_of(session, self._place, view)
            self._canvas.draw(scene)
            if scene.middles != self._middles:
                self._middles = scene.middles
                self._canvas.look_from(scene)
            self._legend.content = legend(scale_of(session, view.mode))
            self._facts.content = facts(session, self._place)
            self._draw_curve()

    def _draw_curve(self) -> None:
        assert self._session is not None
        steps = self._session.steps
        plan = steps[self._place].plan if self._place < len(steps) else None
        there = plan is not None and len(plan.progress) > 1
        self._curve.visible = there
        if plan is not None and there:
            tried = plan.tried * np.arange(1.0, len(plan.progress) + 1)
            self._curve.data = (tried, plan.progress.astype(float))
