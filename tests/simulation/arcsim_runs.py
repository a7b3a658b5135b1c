"""Run folders as ARCSim writes them: made up, or from its own reference folds."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import Delaunay

REFERENCE = Path(__file__).parents[2].parent / "shared" / "arcsim"
needs_reference = pytest.mark.skipif(not REFERENCE.is_dir(), reason=f"{REFERENCE} with ARCSim's folds is not there")

SIDE = 0.4  # m
FRAME = 75  # the last, at 3 s
FRAME_TIME = 0.04  # s


def material(seed: int = 0, inner: int = 60) -> np.ndarray:
    """Material coordinates [m] of the four corners, (0, 0) (0, L) (L, 0) (L, L), and of random inner nodes."""
    corners = np.array([[0, 0], [0, SIDE], [SIDE, 0], [SIDE, SIDE]])
    rng = np.random.default_rng(seed)
    edges = np.concatenate([[[x, 0], [x, SIDE], [0, x], [SIDE, x]] for x in rng.uniform(0.1, 0.9, 4) * SIDE])
    return np.concatenate([corners, edges, rng.uniform(0.02, 0.98, (inner, 2)) * SIDE])


def flat(uv: np.ndarray) -> np.ndarray:
    """The cloth on the table, its middle at the origin [m]."""
    return np.concatenate([uv - SIDE / 2, np.full((len(uv), 1), 0.002)], axis=1)


def write_frame(path: Path, uv: np.ndarray, positions: np.ndarray, *, speed: float | None = None) -> None:
    """A frame on a Delaunay triangulation; vt in another order than v, as ARCSim may have it."""
    triangles = Delaunay(uv).simplices
    order = np.random.default_rng(len(uv)).permutation(len(uv))
    place = np.argsort(order)
    lines = [f"vt {u:.9g} {v:.9g}" for u, v in uv[order]]
    for (x, y, z), (u, v) in zip(positions, uv, strict=True):
        lines += [f"v {x:.8e} {y:.9g} {z:+.9f}", f"ny {u:g} {v:g} 0"]
        lines += [] if speed is None else [f"nv {speed:g} 0 0"]
    for number, (a, b) in enumerate(triangles[:, :2]):
        lines += [f"e {a + 1} {b + 1}", "ea 0"] if number < 3 else []
    for corners in triangles:
        lines += ["f " + " ".join(f"{node + 1}/{place[node] + 1}" for node in corners), "tl 0"]
    path.write_text("\n".join(lines) + "\n")


def handle(node: int, motion: int, *, start: float = 0.0, end: float = 1.5) -> dict[str, Any]:
    return {"nodes": [node], "motion": motion, "start_time": start, "end_time": end}


def motion(move: Sequence[float], *, start: float = 0.0, end: float = 1.5) -> list[dict[str, Any]]:
    """Up and over in three keys."""
    x, y = move
    places: list[list[float]] = [[0, 0, 0], [x / 2, y / 2, 0.1], [x, y, 0.003]]
    times = (start, (start + end) / 2, end)
    return [{"time": t, "transform": {"translate": p}} for t, p in zip(times, places, strict=True)]


def write_scene(path: Path, handles: list[dict[str, Any]], motions: list[list[dict[str, Any]]]) -> None:
    path.write_text(json.dumps({"frame_time": FRAME_TIME, "motions": motions, "handles": handles}))


def write_run(folder: Path, moves: dict[int, Sequence[float]], *, seed: int = 0) -> Path:
    """A run in which corners move by so many metres [node: xy] and the whole cloth is sheared and shrunk."""
    folder.mkdir(parents=True)
    uv = material(seed)
    write_frame(folder / "0000_00.obj", uv, flat(uv))
    # Another set of nodes in another order: the cloth was remeshed.
    uv = material(seed + 100, inner=90)
    write_frame(folder / f"{FRAME:04d}_00.obj", uv, sheared(uv), speed=0.003)
    handles = [handle(node, number) for number, node in enumerate(moves)]
    write_scene(folder / "conf.json", handles, [motion(move) for move in moves.values()])
    return folder


def sheared(uv: np.ndarray) -> np.ndarray:
    """A linear map of the material [m]."""
    return uv @ np.array([[0.8, 0.1, 0.02], [0.0, 0.9, 0.03]]) + np.array([0.1, -0.2, 0.002])


def write_table(folder: Path, sequences: list[list[tuple[str, int]]]) -> Path:
    """runs.csv: for each sequence, (folder, frame) of each state."""
    rows = [f"{s},{k},{name},{frame}" for s, states in enumerate(sequences) for k, (name, frame) in enumerate(states)]
    (folder / "runs.csv").write_text("\n".join(["sequence,state,folder,frame", *rows]) + "\n")
    return folder


def copy_reference(folder: Path, name: str) -> Path:
    """The run folder of one of ARCSim's reference folds."""
    folder.mkdir(parents=True)
    shutil.copy(REFERENCE / f"{name}.start.obj", folder / "0000_00.obj")
    shutil.copy(REFERENCE / f"{name}.obj", folder / f"{FRAME:04d}_00.obj")
    shutil.copy(REFERENCE / f"{name}.conf.json", folder / "conf.json")
    return folder
