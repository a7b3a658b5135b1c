"""How similar are our folds to ARCSim's?  python benchmarks/likeness.py FOLDER [--picture PNG] [--vary] [--csv FOLDER]

FOLDER holds scenes NAME.conf.json with NAME.start.obj (frame 0) and NAME.obj (the last frame). The hand motions are
replayed on a 32 x 32 grid with a material like ARCSim's gray-interlock and with the default material. Distances are
between equal material points; `aligned` distances are computed after subtracting the mean translation. `crease xy` and
`crease z` tell how wavy the fold line is: the rms distances of its outermost vertices from a parabola. --vary changes
the material one setting at a time. The CPU seconds of ARCSim, MuJoCo and Newton were measured once, on another day, so
only their ratios are meaningful.
"""

import argparse
import dataclasses
from pathlib import Path

import matplotlib
import numpy as np
from arcsim_replay import Replay, Scene, read_scene, replay
from tables import show

from clothkit.runtime.errors import InputError
from clothkit.simulation.material import FABRICS
from clothkit.simulation.settings import Settling, SimulationConfig

matplotlib.use("Agg")
import matplotlib.pyplot as plt

GRAY_INTERLOCK = FABRICS["jersey"]
LIKE_ARCSIM = SimulationConfig(material=GRAY_INTERLOCK, top_speed=5.0)
"""Settings like ARCSim's; no vertex in the scenes is faster than this top speed."""

PEERS = {  # mean distance [mm], CPU seconds of one core
    "half_04m_fix32": {"ARCSim 0.2.1": (0.0, 26.0), "MuJoCo 4.0": (11.0, 82.0), "Newton 1.8 VBD": (15.0, 260.0)},
    "corner_04m_fix32": {"ARCSim 0.2.1": (0.0, 22.0)},
    "half_04m_adapt": {"ARCSim 0.2.1": (0.0, 18.0)},
}
VARIED: dict[str, tuple[float, ...]] = {
    "table_friction": (0.2, 0.5, 0.7),
    "cloth_friction": (0.3,),
    "shear_stiffness": (0.1, 1.0, 5.0, 100.0),
    "stretch_stiffness": (500.0, 20000.0),
    "bending_stiffness": (1e-5, 5e-5),
    "bending_limit": (20.0,),
    "bending_friction": (0.0, 8e-4),
    "viscosity": (0.0, 6e-3),
    "drag": (0.0, 2.0),
}


def until_the_end(settings: SimulationConfig, scene: Scene) -> SimulationConfig:
    """Return the settings with a simulated time equal to that of ARCSim's scene, whether the cloth rests or not."""
    rest = scene.end - float(scene.motion.seconds[0])
    return dataclasses.replace(settings, settling=Settling(longest=rest, rest_time=2 * rest))


def compare(ours: str, scene: Scene, got: Replay) -> dict:
    """Return a row with the distances of our final shape to ARCSim's and the positions of the edges."""
    away = (got.final - scene.final) * 1e3
    distance = np.linalg.norm(away, axis=-1)
    aligned = np.linalg.norm(away - away.mean((0, 1)), axis=-1)
    release = int(np.searchsorted(got.times, scene.motion.seconds[0] + 1e-6)) - 1
    return {
        "solver": ours,
        "mean mm": round(float(distance.mean()), 1),
        "aligned": round(float(aligned.mean()), 1),
        "p95": round(float(np.percentile(distance, 95)), 1),
        "crest": round(float(got.final[..., 2].max()) * 1e3, 1),
        **waves(scene, got.final),
        **_edges("let go", got.states[release], scene),
        **_edges("end", got.final, scene),
        "CPU s": round(got.cpu_seconds, 2),
    }


def waves(scene: Scene, cloth: np.ndarray) -> dict:
    """Return the rms distances [mm], across the fold line and in height, of the crease from the parabola along it.

    The crease has a vertex per strip along the fold: the outermost one. The fold line is that of the hands' mean
    motion, and only strips that it folds count, up to the distance of one vertex from its ends.
    """
    motion = scene.motion
    hands = np.flatnonzero(motion.held[0, :, 0] >= 0)
    start, end = (motion.path[0, hands, time, :2].mean(0) for time in (0, -1))
    normal = (end - start) / np.linalg.norm(end - start)
    along = np.array([-normal[1], normal[0]])
    spacing = np.linalg.norm(scene.start[1, 0] - scene.start[0, 0])
    folded = (scene.start[..., :2] - (start + end) / 2) @ normal < -spacing
    strip = np.rint(cloth[..., :2] @ along / spacing).astype(int)
    wanted = np.unique(np.rint(scene.start[folded][:, :2] @ along / spacing).astype(int))[1:-1]
    crease = []
    for number in wanted:
        vertices = cloth[strip == number]
        if len(vertices):
            crease.append(vertices[np.argmin(vertices[:, :2] @ normal)])
    x, y, z = (np.array(crease) @ axis for axis in (np.append(along, 0), np.append(normal, 0), [0, 0, 1]))
    left = [values - np.polyval(np.polyfit(x, values, 2), x) for values in (y, z)]
    across, height = (round(float(np.sqrt((part**2).mean())) * 1e3, 2) for part in left)
    return {"crease xy": across, "crease z": height}


def _edges(when: str, state: np.ndarray, scene: Scene) -> dict:
    """Return the mean x [mm] of the held edge (u = -1) and of the opposite edge."""
    return {
        f"held x {when}": round(float(state[0, :, 0].mean()) * 1e3),
        f"other x {when}": round(float(state[-1, :, 0].mean()) * 1e3),
    }


def peers(scene: Scene) -> list[dict]:
    """Return the rows of the other simulators for a scene."""
    rows = []
    for name, (distance, seconds) in PEERS.get(scene.name, {}).items():
        row: dict = {"solver": name, "mean mm": distance, "CPU s": seconds}
        if name.startswith("ARCSim"):
            crest = round(float(scene.final[..., 2].max()) * 1e3, 1)
            row |= {"crest": crest, **waves(scene, scene.final), **_edges("end", scene.final, scene)}
        rows.append(row)
    return rows


def with_ratios(rows: list[dict]) -> list[dict]:
    """Return the rows with their speed as a multiple of ARCSim's, if that was measured."""
    arcsim = next((row["CPU s"] for row in rows if row["solver"].startswith("ARCSim")), None)
    return [row | ({"ARCSim / CPU s": round(arcsim / row["CPU s"], 1)} if arcsim else {}) for row in rows]


def draw(path: Path, pairs: list[tuple[Scene, Replay]]) -> None:
    """Draw, per scene, profiles through the middle and ARCSim's and our cloth from above, in mm."""
    figure, axes = plt.subplots(len(pairs), 3, figsize=(13, 3.6 * len(pairs)), squeeze=False, layout="constrained")
    for row, (scene, got) in zip(axes, pairs, strict=True):
        clothes = {"ARCSim": scene.final * 1e3, "clothkit": got.final * 1e3}
        for (name, cloth), colour in zip(clothes.items(), ("tab:blue", "tab:orange"), strict=True):
            line = cloth[:, cloth.shape[1] // 2] if scene.motion.held[0, 1, 0] >= 0 else np.diagonal(cloth).T
            along = line[:, 0] if scene.motion.held[0, 1, 0] >= 0 else (line[:, 0] + line[:, 1]) / 2**0.5
            row[0].plot(along, line[:, 2], ".-", color=colour, label=name, linewidth=1)
        row[0].set(title=f"{scene.name}: profile, mm", ylim=(0, 40))
        row[0].legend()
        for axis, (name, cloth) in zip(row[1:], clothes.items(), strict=True):
            shown = axis.scatter(cloth[..., 0], cloth[..., 1], c=cloth[..., 2], s=9, vmin=0, vmax=12, cmap="viridis")
            for line in (*cloth, *cloth.transpose(1, 0, 2)):
                axis.plot(line[:, 0], line[:, 1], color="grey", linewidth=0.4, zorder=0)
            axis.set(title=f"{name} from above, mm", aspect="equal", xlim=(-260, 260), ylim=(-220, 220))
        figure.colorbar(shown, ax=row[2], label="z, mm")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print a table per scene, and write the picture and the CSV files if asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--vary", action="store_true")
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    try:
        scenes = [read_scene(conf) for conf in sorted(options.folder.glob("*.conf.json"))]
    except InputError as error:
        raise SystemExit(str(error)) from error
    runs = {
        "clothkit, gray-interlock": LIKE_ARCSIM,
        "clothkit, half the time step": dataclasses.replace(LIKE_ARCSIM, time_step=5e-4),
        "clothkit, default material": SimulationConfig(),
    }
    if options.vary:
        for name, values in VARIED.items():
            for value in values:
                if value or name != "viscosity":
                    material = dataclasses.replace(GRAY_INTERLOCK, **{name: value})
                    runs[f"{name} {value:g}"] = dataclasses.replace(LIKE_ARCSIM, material=material)
    pictured = []
    for scene in scenes:
        got = {name: replay(scene, until_the_end(settings, scene)) for name, settings in runs.items()}
        rows = peers(scene) + [compare(name, scene, one) for name, one in got.items()]
        show(f"likeness {scene.name}: distance to ARCSim's final shape", with_ratios(rows), csv=options.csv)
        pictured.append((scene, got["clothkit, gray-interlock"]))
    if options.picture:
        draw(options.picture, pictured)


if __name__ == "__main__":
    main()
