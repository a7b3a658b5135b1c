"""The tab for live sessions: choose a test task or your own files, plan, execute, plan again."""

import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import viser

from clothkit.app.inputs import Input, Settings, keep_compiled_programs, read_input
from clothkit.app.lengths import AUTO
from clothkit.app.named_goals import TURNS, goal_like, goal_name
from clothkit.app.options import ObservationOptions
from clothkit.app.planner import load_planner
from clothkit.app.viewer.live import Live, begin, notices_of, perform, plan, with_progress
from clothkit.app.viewer.player import Player, assign, by_hand
from clothkit.app.viewer.search_progress import Progress
from clothkit.app.viewer.tasks import SessionFiles
from clothkit.dataset.store import STEPS
from clothkit.goals.variants import Turn
from clothkit.planning.systems import SYSTEMS, system
from clothkit.runtime.errors import InputError, system_error

OWN = "own files"
AS_IT_COMES = "as it comes"
"""No turn is chosen, as for a goal that is a file."""


class LivePanel:
    """Runs a live session, with one search or simulation at a time."""

    def __init__(
        self,
        server: viser.ViserServer,
        player: Player,
        tasks: Mapping[str, SessionFiles],
        own: SessionFiles | None,
        *,
        chosen: str,
        data: Path,
        settings: Settings,
        options: ObservationOptions,
        uploads: Path,
    ) -> None:
        self._player, self._data, self._settings, self._options, self._uploads = (
            player,
            data,
            settings,
            options,
            uploads,
        )
        self._tasks = dict(tasks)
        self._masked = (own.state, own.mask) if own and own.mask else None
        self._live: Live | None = None
        self._running, self._stopped = threading.Lock(), threading.Event()
        gui = server.gui
        self._system = gui.add_dropdown("system", tuple(SYSTEMS), initial_value=chosen, hint="Which system plans")
        first = [] if own is None else [OWN]
        self._task = gui.add_dropdown("task", tuple(dict.fromkeys([*first, *self._tasks, OWN])))
        with gui.add_folder("Own files", expand_by_default=own is not None or not tasks):
            self._state = gui.add_text("state", own.state if own else "", hint="A file of this machine, or upload one")
            self._goal = gui.add_text("goal", own.goal if own else "", hint="Likewise, or a name of clothkit goals")
            self._turn = gui.add_dropdown(
                "turn",
                (AS_IT_COMES, *TURNS),
                hint="Of a named goal: degrees by which its folds are turned",
            )
            self._mirror = gui.add_checkbox("mirror", False, hint="Of a named goal: its folds are mirrored before that")
            steps = own.steps if own else 1
            self._steps = gui.add_slider("steps", 1, STEPS, 1, 1 if steps == AUTO else steps)
            self._auto = gui.add_checkbox("as many as are worth it", steps == AUTO)
            upload_state = gui.add_upload_button("upload state")
            upload_goal = gui.add_upload_button("upload goal")
        self._seed = gui.add_number("seed", 0, min=0, step=1, hint="Another seed, another search")
        self._load = gui.add_button("load", color="gray", hint="Observe the cloth; nothing is planned yet")
        self._plan = gui.add_button("plan", color="violet", disabled=True)
        self._stop = gui.add_button("stop the search", visible=False, color="gray")
        self._execute = gui.add_button("execute", color="green", disabled=True)
        self._bar = gui.add_progress_bar(0.0, visible=False)
        self._message = gui.add_markdown("Pick a task or your own files and *load* them.")
        upload_state.on_upload(lambda event: self._uploaded("state", self._state, event.target.value))
        upload_goal.on_upload(lambda event: self._uploaded("goal", self._goal, event.target.value))
        self._load.on_click(lambda _: self._work("observing the cloth", self._begin))
        self._plan.on_click(lambda _: self._work("searching", self._search))
        self._execute.on_click(lambda _: self._work("simulating", self._perform))
        self._stop.on_click(lambda _: self._stopped.set())
        for control in (self._system, self._task):
            control.on_update(by_hand(self._reload))

    def begin(self) -> None:
        """Load the selected task."""
        self._work("observing the cloth", self._begin)

    def _reload(self) -> None:
        if self._task.value != OWN or self._state.value:
            self.begin()

    def _uploaded(self, what: str, field: viser.GuiInputHandle[str], file: viser.UploadedFile) -> None:
        try:
            path = keep_upload(self._uploads, what, file.name, file.content)
        except InputError as error:
            self._message.content = f"⚠ {error}"
            return
        assign(field, str(path))
        assign(self._task, OWN)
        self._message.content = f"{path.name} is here; *load* when state and goal are."

    def _work(self, what: str, job: Callable[[], str]) -> None:
        """Run a job, unless another one is running; errors are shown on the page."""
        if not self._running.acquire(blocking=False):
            return
        try:
            for control in (self._load, self._plan, self._execute, self._system, self._task):
                control.disabled = True
            self._message.content = f"{what} .."
            self._message.content = job()
        except InputError as error:
            self._message.content = f"⚠ {error}"
        except Exception as error:
            self._message.content = f"⚠ {what} failed: {type(error).__name__}: {error}"
            raise
        finally:
            for control in (self._load, self._system, self._task):
                control.disabled = False
            self._plan.disabled = self._live is None or not self._live.left
            self._execute.disabled = self._live is None or self._live.plan is None or not self._live.left
            self._running.release()

    def _begin(self) -> str:
        self._live = None
        # A mask is that of the cloud that it was given with.
        mask = self._masked[1] if self._masked and self._masked[0] == self._state.value else None
        steps = AUTO if self._auto.value else self._steps.value
        own = SessionFiles(self._state.value, self._goal.value, steps, mask)
        name, files = self._task.value, self._tasks.get(self._task.value, own)
        if not files.state or not files.goal:
            raise InputError("own files: state or goal is missing, expected a file for each")
        keep_compiled_programs()
        planner = load_planner(system(self._system.value), self._data, self._settings)
        start = read_input(files.state, self._options, mask=files.mask)
        # The form of a named goal; what was chosen for one is not for a task's goal, which is a file.
        form: tuple[Turn | None, bool | None] = (None, None)
        if files is own:
            form = TURNS.get(self._turn.value), self._mirror.value or None
        goal = goal_of_form(start, files.goal, *form, self._options, self._settings._replace(data=self._data))
        title = f"{Path(files.state).name} to {Path(files.goal).name}" if files is own else name
        title = f"{planner.system.name}, {title}"
        self._live = begin(planner, start, goal, files.steps, title=title, data=self._data, settings=self._settings)
        self._player.show(self._live.session)
        return "\n\n".join(
            [
                f"{'at most ' if files.steps == AUTO else ''}{_count(self._live.left)} to plan.",
                *(f"⚠ {n}" for n in dict.fromkeys((*start.notices, *goal.notices, *notices_of(self._live)))),
            ]
        )

    def _search(self) -> str:
        assert self._live is not None
        live = self._live
        self._stopped.clear()
        self._stop.visible = self._bar.visible = True
        self._player.show(live.session, at=live.at, shown="estimate")

        def show(progress: Progress) -> bool:
            self._bar.value = 100.0 * progress.done / progress.strains  # type: ignore[misc]
            self._message.content = (
                f"searching: {progress.done} of {progress.strains} strains .."
                if progress.done
                else "searching; the first search of its kind is compiled first, which takes its time .."
            )
            if progress.best is not None:
                self._player.show(with_progress(live, progress).session, at=live.at, shown=None)
            return not self._stopped.is_set()

        try:
            self._live = plan(live, seed=int(self._seed.value), on_progress=show)
        except InputError:
            # What the search tried is not what *execute* would do.
            self._player.show(live.session, at=live.at)
            raise
        finally:
            self._stop.visible = self._bar.visible = False
        session = self._live.session
        self._player.show(session, at=live.at)
        if self._live.plan is None:
            return "stopped before anything was found."
        if self._live.agent.over:
            return "nothing more is worth doing: the session is over."
        planned = session.steps[live.at].plan
        helps = planned is None or planned.improves
        said = "look at it, then *execute* its first manipulation." if helps else "it is not expected to help."
        return "\n\n".join([f"planned: {said}", *(f"⚠ {notice}" for notice in notices_of(self._live))])

    def _perform(self) -> str:
        assert self._live is not None
        self._live = perform(self._live)
        self._player.show(self._live.session, at=self._live.at, shown="state")
        if not self._live.left:
            return "executed; the session is over."
        most = "" if self._live.agent.choosing is None else "at most "
        return f"executed; {most}{_count(self._live.left)} left: plan again from what is seen now."


def goal_of_form(
    start: Input, goal: str, turn: Turn | None, mirror: bool | None, options: ObservationOptions, settings: Settings
) -> Input:
    """Return a goal that is a file or a name; one with a name is made of the cloth, in that form. Raises InputError."""
    name = goal_name(goal, turn, mirror)
    return goal_like(start, name, turn, mirror, options, settings) if name else read_input(goal, options)


def keep_upload(folder: Path, what: str, name: str, content: bytes) -> Path:
    """Save an uploaded file and return its path. Raises InputError.

    State and goal have a folder each, because their files may have the same name.
    """
    # A browser may send a whole path, or anything else, as the name.
    path = folder / what / (Path(name.replace("\\", "/").replace("\0", "")).name or what)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        raise system_error(error, path, action="written") from error
    return path


def _count(left: int) -> str:
    return f"{left} manipulation{'' if left == 1 else 's'}"
