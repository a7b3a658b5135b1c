"""`clothkit view`: a local page that plays recorded sessions and runs new ones."""

import contextlib
import errno
import io
import os
import signal
import socket
import sys
import tempfile
import threading
import webbrowser
from pathlib import Path
from typing import Any, Literal

import click
import jax
import viser

from clothkit.app.extras import optional
from clothkit.app.inputs import Settings, read_input
from clothkit.app.lengths import Steps
from clothkit.app.named_goals import goal_name, manipulations_of
from clothkit.app.options import observation_options, with_observation_options
from clothkit.app.output import check_target
from clothkit.app.prebuilt import load_nets
from clothkit.app.viewer.page import build
from clothkit.app.viewer.recorded import systems_in
from clothkit.app.viewer.recording import ENDING
from clothkit.app.viewer.tasks import SessionFiles
from clothkit.planning.planner import artifacts
from clothkit.planning.systems import SYSTEMS
from clothkit.runtime.errors import InputError


@click.command(short_help="A local page on which sessions are played.")
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    metavar="FOLDER",
    help="Where meshes.zarr, nets/, normalisation/ and evaluation/planning/ are, as dvc repro makes them.",
)
@click.option(
    "--system",
    "name",
    type=click.Choice(list(SYSTEMS)),
    default="main",
    show_default=True,
    help="What plans when you press plan; as in clothkit plan.",
)
@click.option("--state", metavar="FILE", help="Your own cloth; needs --goal.")
@click.option("--goal", metavar="FILE|NAME", help="The shape that it shall have: a file, or a name of clothkit goals.")
@click.option(
    "--steps",
    type=Steps(),
    metavar="N|auto",
    help="Manipulations on the way there, 1 to 3; auto: as many as are worth it. [default: what a named goal needs, "
    "else 1]",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Who may open the page: 0.0.0.0 lets others.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8080, show_default=True, help="The next free one from here on."
)
@click.option("--no-browser", is_flag=True, help="Only tell the page's address.")
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="A recording of Rerun (.rrd) of the session that the page shows, written anew whenever it changes.",
)
@with_observation_options
def command(
    *,
    data: Path,
    name: str,
    state: str | None,
    goal: str | None,
    steps: int | Literal["auto"] | None,
    host: str,
    port: int,
    no_browser: bool,
    record: Path | None,
    mask: str | None,
    **values: Any,
) -> None:
    """Open a page on which sessions are played: the cloth in 3D, plans as arcs, grasp candidates as points.

    On the tab Recorded are the sessions that the pipeline has planned and executed, worst first if you like. On the tab
    Live a session is made: of a test task, or of your own files, which the page takes as uploads, too. "plan" searches,
    and shows the best plan while it does; "execute" simulates the plan's first manipulation, after which the next can
    be planned. Files are what clothkit plan takes.

    Nothing leaves this machine. Ctrl-C ends it.

    \b
    clothkit view
    clothkit view --state start.obj --goal goal.obj --steps 2
    clothkit view --state cloud.ply --goal half --table 0 0 -1 -0.8
    """
    data, settings = load_nets(data, values)
    if record is not None:
        optional("rerun", "rerun")
        check_target(record, (ENDING[1:],))
    if (state is None) != (goal is None):
        raise InputError(
            f"--{'goal' if goal is None else 'state'}: missing, expected both or neither of state and goal"
        )
    named = goal_name(goal, None, None) if goal else None
    own = (
        SessionFiles(state, goal, steps or (manipulations_of(named) if named else 1), mask) if state and goal else None
    )
    if not data.is_dir():
        raise InputError(f"{data}: not found, expected the folder that dvc repro fills")
    _check_there_is_something(data, name, settings, own)
    _check_address(host, port)
    # Fails here, not first on the page, if JAX was asked for a device that is not there.
    jax.devices()
    options = observation_options(settings.app, **values)
    if own is not None:
        # A bad file must be reported here, and not on a page that nobody has opened yet.
        read_input(own.state, options, mask=mask)
        if named is None:
            read_input(own.goal, options)
    with contextlib.redirect_stdout(io.StringIO()):  # viser prints its address even if verbose is False
        server = viser.ViserServer(host=host, port=port, verbose=False)
    # `kill` must end the command as Ctrl-C does, because a shell's background jobs do not receive Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with tempfile.TemporaryDirectory(prefix="clothkit-view-") as uploads:
            name_of_host = "localhost" if host in ("127.0.0.1", "0.0.0.0") else f"[{host}]" if ":" in host else host
            address = f"http://{name_of_host}:{server.get_port()}"
            build(
                server,
                data=data,
                chosen=name,
                own=own,
                settings=settings,
                options=options,
                uploads=Path(uploads),
                record=record,
            )
            # Not before the page is there: an interrupt while stores are read would leave tracebacks of zarr's threads.
            click.echo(f"{address} (Ctrl-C ends it)")
            if not no_browser and _has_screen():
                webbrowser.open(address)
            threading.Event().wait()
    except KeyboardInterrupt:
        click.echo("")
    finally:
        server.stop()


def _check_there_is_something(data: Path, name: str, settings: Settings, own: SessionFiles | None) -> None:
    """Check that there are recorded sessions to play, or nets to run a new one. Raises InputError."""
    needed = artifacts(SYSTEMS[name], data, settings.members, settings.plan.uncertainty.measure)
    missing = [path for path in needed.values() if not path.exists()]
    if missing and own is not None:
        raise InputError(f"{missing[0]}: not found, system {name} plans with it; dvc repro makes it")
    if missing and not systems_in(data):
        raise InputError(
            f"{data}: holds nothing to show, expected recorded sessions (evaluation/planning) or what system {name} "
            f"plans with ({missing[0].relative_to(data)}); dvc repro makes them"
        )


def _check_address(host: str, port: int) -> None:
    """Check that the page can be served there; viser would try one port after another instead. Raises InputError."""
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError) as error:
        raise InputError(f"--host: {host!r} is unknown, expected an address of this machine, or 0.0.0.0") from error
    family, kind, protocol, _, address = found[0]
    try:
        with socket.socket(family, kind, protocol) as trial:
            trial.bind(address)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(
                f"--host: {host} is no address of this machine, expected one of its own, or 0.0.0.0 for all of them"
            ) from error
        raise InputError(f"--host {host}, --port {port}: no page can be served there ({error.strerror})") from error


def _has_screen() -> bool:
    """Return whether there is a display; without one, a text browser could take over the terminal."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
