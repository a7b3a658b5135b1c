"""Every loader and every command, with the inputs that can be mutated."""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import trimesh
from click.testing import CliRunner

from clothkit.app import agent_state
from clothkit.app import simulate as simulate_command
from clothkit.app import view as view_command
from clothkit.app.cli import cli
from clothkit.app.plan_file import read_plan
from clothkit.app.planner import Planned, predict_plan
from clothkit.app.viewer import recorded
from clothkit.app.viewer.tasks import test_tasks as tasks_in
from clothkit.dataset import raw, store, tables
from clothkit.episodes import record
from clothkit.evaluation import arrays, tidy
from clothkit.models import store as nets
from clothkit.observation.files import read
from clothkit.observation.observe import observe
from clothkit.observation.plane import Plane
from clothkit.observation.silhouettes import points_of
from clothkit.observation.states import PointCloud, SilhouetteState
from clothkit.params import load_params
from clothkit.planning import agent, normalisation
from clothkit.planning.batches import take
from clothkit.planning.lengths import LengthConfig
from clothkit.planning.planner import Planner
from clothkit.planning.types import Memory, Observation
from clothkit.report import run_settings
from clothkit.report.timings import table_8
from clothkit.runtime.resumable import load_piece
from clothkit.simulation import arcsim_obj, arcsim_runs, arcsim_scene, generation
from clothkit.training import checkpoint
from tests.app.plans import BOTH, ONE
from tests.observation.scenes import CLOTH, SMALL
from tests.planning import toy


class Input(NamedTuple):
    """A file, a folder that is a store, or the value of an option, that can be mutated."""

    path: str
    kind: str
    optional: bool = False
    """Whether it may be missing."""


class Target(NamedTuple):
    """A loader or a command."""

    name: str
    inputs: tuple[Input, ...]
    call: Callable[[Mapping[str, str]], Any]
    """Runs in a folder that holds the inputs; takes the mutated words by option; returns what can be compared."""
    needs: tuple[str, ...] = ()
    """What else has to be there."""
    outputs: tuple[str, ...] = ()
    """What it writes."""


class Told(Exception):
    """A command's sentence."""


def loader(name: str, path: str, kind: str, load: Callable[[Path], Any], **more: Any) -> Target:
    """A function that reads one file."""
    return Target(name, (Input(path, kind, **more),), lambda _: load(Path(path)))


def command(*words: str, reads: tuple[Input, ...], writes: tuple[str, ...], searches: bool = True) -> Target:
    """A command. Of `reads`, those that are `words` stand for the value behind the option of their name.

    One that reads mutated settings `searches` for nothing: these may ask for a search of hours.
    """

    def call(changed: Mapping[str, str]) -> Any:
        given = [changed.get(before, word) for before, word in zip(("", *words), words, strict=False)]
        with contextlib.nullcontext() if searches else mock.patch.object(agent_state, "decide", _decided):
            ended = CliRunner().invoke(cli, given)
        if ended.exit_code == 0:
            moved = dict(zip(words, given, strict=True))
            return {name: _output(Path(moved.get(name, name))) for name in writes if name in words or not changed}
        if not isinstance(ended.exception, SystemExit):
            assert ended.exception is not None
            raise ended.exception
        *before, sentence = ended.stderr.strip().splitlines() or [""]
        # How long parts of the work took, bars of progress, notices, warnings; of usage, how it is.
        known = all(_beside(line) for line in before)
        if ended.exit_code not in (1, 2) or (ended.exit_code == 1 and not known):
            raise AssertionError(f"exit status {ended.exit_code}, {ended.stderr!r}")
        raise Told(sentence)

    return Target(words[0], reads, call, ("params.yaml", "data/nets", "data/normalisation", *words), writes)


def _beside(line: str) -> bool:
    """Whether a line on stderr is no part of what went wrong."""
    return line.endswith(" s") or "/s]" in line or line.startswith(("notice: ", "warning: ")) or not line.strip()


@contextlib.contextmanager
def quick() -> Iterator[None]:
    """Without search and simulation, which take long to compile: all around them is run."""
    with (
        mock.patch.object(agent_state, "decide", _decided),
        mock.patch.object(simulate_command, "execute", _executed),
        serving(),
    ):
        yield


@contextlib.contextmanager
def serving() -> Iterator[None]:
    """`view` ends where it would serve a page."""
    with mock.patch.object(view_command.viser, "ViserServer", side_effect=SystemExit(0)):
        yield


def _decided(
    planner: Planner,
    observation: Observation,
    memory: Memory,
    *,
    seed: int,
    length: LengthConfig | None = None,
    **_: object,
) -> tuple[Planned, Memory]:
    """A plan that nobody searched for, from the state that the planner perceives."""
    state, plan = agent.perceive(planner, observation, memory)[0][0], np.stack([BOTH, ONE])[: int(memory.left[0])]
    found = predict_plan(planner, state, plan, common=0, traces=take(memory.traces, 0))
    outcome, distance = found.means[:, -1].mean(0), planner.representation.distance
    expected, no_action = (float(distance(end[None], memory.goal)[0]) for end in (outcome, state))
    useless = expected > no_action
    return found._replace(loss=0.0, expected=expected, expected_no_action=no_action, useless=useless), memory


def _executed(
    meshes: np.ndarray, grasps: np.ndarray, displacement: np.ndarray, single: np.ndarray, *_: object, **__: object
) -> np.ndarray:
    return toy.execute(meshes, grasps, displacement, single)


def _output(path: Path) -> Any:
    """What a command has written."""
    if path.is_dir():
        # The folder may have been there, with other files.
        endings = (".obj", ".glb", ".npz")
        return {file.name: _output(file) for file in sorted(path.iterdir()) if file.suffix in endings}
    if path.suffix == ".json":
        return read_plan(path)
    if path.suffix == ".npz":
        with np.load(path) as stored:
            return dict(stored)
    return np.asarray(trimesh.load_mesh(path, process=False).vertices)


def _observed(path: Path | str) -> Any:
    """A state, and its voxels and pose: what cameras did not see may be NaN or infinite in its file."""
    state = read(path)
    table: Plane | None = SMALL.table()
    if isinstance(state, SilhouetteState):
        # Its points know their table.
        state = points_of(state, area=CLOTH**2, thickness=0.002, table=table, name=str(path))
        table = None
    seen = observe(state, cloth_side=CLOTH, table=table, name=str(path))
    return [seen, None if isinstance(state, PointCloud) else state]


def _raw(folder: Path) -> Any:
    states = raw.read_states(folder / "states")
    topologies = raw.Topologies(folder)
    keys = zip(states["topology"], states["vertices"], strict=True)
    surfaces = [topologies(f"{folder}: row {row}", number, flat) for row, (number, flat) in enumerate(keys)]
    moves, tried = raw.read_manipulations(folder, states), tables.read(folder / "attempts.parquet", raw.ATTEMPTS)
    return [states, moves, tried[[name for name in tried if name in raw.ATTEMPTS.columns]], surfaces]


def _table(declared: tables.Table) -> Callable[[Path], Any]:
    def load(path: Path) -> Any:
        rows = tables.read(path, declared)
        return rows[[name for name in rows if name in declared.of_file(list(rows.columns)).columns]]

    return load


def _settings(path: Path) -> Any:
    """What a report says that it was made with, less the text of its file."""
    return dataclasses.replace(run_settings.read(path), text="")


def _imported(runs: Path) -> Any:
    """What ARCSim's runs are imported as, without writing it."""
    sequences = arcsim_runs.read_runs(str(runs), 10)
    return [
        [
            (arcsim_obj.read_frame(run.path), run.state and arcsim_scene.read_scene(run.scene), run.state)
            for run in sequence
        ]
        for sequence in sequences
    ]


def _viewed(data: Path) -> Any:
    """All that the viewer loads."""
    listed = {name: recorded.entries(data, name) for name in recorded.systems_in(data)}
    shown = [recorded.session_of(data, name, entries[-1]) for name, entries in listed.items()]
    return [listed, shown, tasks_in(data / "meshes.zarr")]


TABLE = tuple(map(str, (*SMALL.table().normal.tolist(), SMALL.table().offset)))
RAW = tuple(
    Input(f"data/raw/{name}.parquet", "parquet") for name in ("states/0000", "manipulations", "attempts", "topologies")
)
PARAMS = Input("params.yaml", "yaml", optional=True)
CLOUD, MESH, GOAL, VOXELS = (
    Input("cloud.npz", "npz"),
    Input("bent.obj", "text"),
    Input("goal.glb", "bytes"),
    Input("voxels.npy", "npy"),
)
NETS = tuple(Input(f"data/nets/pemd/{net}/net.{kind}", f"{kind}") for net in (0, 1) for kind in ("json", "msgpack"))
VTM = (Input("data/nets/vtm/net.msgpack", "bytes"), Input("data/nets/vtm/net.json", "json"))
VOXEL_NETS = tuple(Input(f"data/nets/emd_voxel/{net}/net.json", "json") for net in (0, 1))
REFERENCE = Input("data/normalisation/mesh.json", "json")
SESSIONS = Input("data/evaluation/planning/sessions_main.zarr", "zarr")

LOADERS = (
    loader("meshes", "data/meshes.zarr", "zarr", store.load),
    loader("splits", "data/meshes.zarr", "zarr", store.load_splits),
    Target("raw tables", RAW, lambda _: _raw(Path("data/raw"))),
    loader("estimation rows", "data/evaluation/estimation.parquet", "parquet", _table(tidy.ESTIMATION)),
    loader("planning rows", "data/evaluation/planning/main.parquet", "parquet", _table(tidy.PLANNING)),
    loader("prediction rows", "data/evaluation/prediction.parquet", "parquet", _table(tidy.PREDICTION)),
    loader("estimates", "data/evaluation/estimates.zarr", "zarr", lambda path: arrays.load(path, arrays.ESTIMATES)),
    loader("sessions", SESSIONS.path, "zarr", record.load),
    loader("reference values", REFERENCE.path, "json", normalisation.load),
    Target("net", (*NETS[:2], *VTM), lambda _: [nets.load(Path(f"data/nets/{name}")) for name in ("pemd/0", "vtm")]),
    loader("piece of sessions", "work/sessions_000.npz", "npz", record.load_piece),
    loader("block of attempts", "work/block.npz", "bytes", partial(load_piece, storage=generation.BLOCKS)),
    loader("checkpoint", "work/checkpoint", "bytes", lambda path: checkpoint.read(path, [0, 0])),
    loader(
        "note of a stage's cost",
        "work/plan@main.json",
        "json",
        lambda path: table_8(path.parent, ["main"]),
        optional=True,
    ),
    Target(
        "runs of ARCSim",
        (
            Input("runs/half/conf.json", "json"),
            *(Input(f"runs/half/{frame}_00.obj", "text") for frame in ("0000", "0075")),
            Input("runs/runs.csv", "text"),
        ),
        lambda _: _imported(Path("runs")),
    ),
    loader("settings of a report", "report.yaml", "yaml", _settings),
    loader("training history", "data/nets/vtm/history.parquet", "parquet", _table(tidy.HISTORY)),
    loader("params", "params.yaml", "yaml", load_params),
    loader("plan file", "plan.json", "json", read_plan),
    loader("mesh as OBJ", "bent.obj", "text", _observed),
    loader("mesh as GLB", "goal.glb", "bytes", _observed),
    loader("mesh as PLY", "bent.ply", "text", _observed),
    loader("mesh as NPY", "mesh.npy", "npy", _observed),
    loader("voxels", "voxels.npy", "npy", _observed),
    loader("cloud as NPZ", "cloud.npz", "npz", _observed),
    loader("silhouette as NPZ", "silhouette.npz", "npz", _observed),
    loader("cloud as PLY", "cloud.ply", "text", _observed),
    loader("cloud as PCD", "cloud.pcd", "text", _observed),
    loader("cloud as binary PCD", "binary.pcd", "text", _observed),
    loader("cloud as compressed PCD", "compressed.pcd", "text", _observed),
    loader("array in zarr", "own.zarr", "zarr", _observed),
    Target("state in a store", (Input("data/meshes.zarr", "zarr"),), lambda _: _observed("data/meshes.zarr:1/1")),
    Target(
        "view",
        (SESSIONS, Input("data/evaluation/planning/main.parquet", "parquet", True), Input("data/meshes.zarr", "zarr")),
        lambda _: _viewed(Path("data")),
        ("data/evaluation/planning",),
    ),
)
COMMANDS = (
    command(
        *("plan", "--state", MESH.path, "--goal", GOAL.path, "--steps", "1", "--out", "new.json"),
        reads=(MESH, GOAL, *NETS, REFERENCE, Input("--out", "words"), Input("--state", "words")),
        writes=("new.json",),
    ),
    command(
        *("plan", "--state", CLOUD.path, "--goal", "goal.npy", "--steps", "1", "--out", "new.json", "--side", "0.4"),
        reads=(CLOUD, Input("goal.npy", "npy"), *VTM, REFERENCE, Input("--side", "words")),
        writes=("new.json",),
    ),
    command(
        *("plan", "--state", "bent.ply", "--goal", MESH.path, "--after", "plan.json", "--out", "new.json"),
        reads=(Input("plan.json", "json"), Input("bent.ply", "text"), MESH, Input("--after", "words")),
        writes=("new.json",),
    ),
    command(
        *("plan", "--state", VOXELS.path, "--goal", MESH.path, "--steps", "1", "--system", "b4", "--out", "new.json"),
        reads=(VOXELS, MESH, *VOXEL_NETS, Input("data/normalisation/voxel.json", "json")),
        writes=("new.json",),
    ),
    command(
        *("plan", "--state", CLOUD.path, "--goal", MESH.path, "--steps", "2", "--seed", "0", "--out", "new.json"),
        reads=(PARAMS, Input("--seed", "words"), Input("--steps", "words")),
        writes=("new.json",),
        searches=False,
    ),
    command(
        *("estimate", CLOUD.path, "--mask", "mask.npy", "--out", "estimate.obj"),
        reads=(CLOUD, Input("mask.npy", "npy"), PARAMS, *VTM, Input("--out", "words"), Input("--mask", "words")),
        writes=("estimate.obj", "estimate.sigma.npz"),
    ),
    command(
        *("estimate", "cloud.pcd", "--table", *TABLE, "--out", "estimate.glb"),
        reads=(Input("cloud.pcd", "text"), PARAMS, *VTM, Input("--table", "words")),
        writes=("estimate.glb", "estimate.sigma.npz"),
    ),
    command(
        *("predict", "--state", "start.obj", "--plan", "plan.json", "--out", "predicted"),
        reads=(Input("start.obj", "text"), Input("plan.json", "json"), PARAMS, *NETS, Input("--out", "words")),
        writes=("predicted",),
    ),
    command(
        *("simulate", "--state", "start.obj", "--plan", "plan.json", "--goal", GOAL.path, "--out", "outcome.glb"),
        reads=(Input("start.obj", "text"), Input("plan.json", "json"), GOAL, PARAMS, Input("--plan", "words")),
        writes=("outcome.glb",),
    ),
    command(
        *("export", "data/raw", "--sequence", "1", "--format", "obj", "--to", "exported"),
        reads=(RAW[0], RAW[3], Input("--sequence", "words"), Input("--to", "words"), Input("export", "words")),
        writes=("exported",),
    ),
    command(
        *(
            "export",
            "data/meshes.zarr",
            "--sequence",
            "1",
            "--format",
            "glb",
            "--to",
            "exported",
            "--cloth-side",
            "0.4",
        ),
        reads=(Input("data/meshes.zarr", "zarr"), Input("--cloth-side", "words"), Input("--format", "words")),
        writes=("exported",),
    ),
    command(
        *("view", "--state", "bent.obj", "--goal", GOAL.path, "--port", "0", "--host", "127.0.0.1", "--no-browser"),
        reads=(MESH, GOAL, PARAMS, Input("--host", "words"), Input("--port", "words"), Input("--state", "words")),
        writes=(),
    ),
)
TARGETS = (*LOADERS, *COMMANDS)
