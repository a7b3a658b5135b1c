"""How long does `clothkit plan` take on a point cloud, and how good are its plans?

python benchmarks/plan_on_clouds.py [--sequences N] [--length L]

For one task of each of the first test sequences (default: 5 sequences, plans of one manipulation, with the starts in
turn), the script gives the start to `clothkit plan` in three forms: as the point cloud of a tilted, noisy depth camera
with a mask of the cloth, as noise-free voxels, and as the true mesh. Each plan is executed by `clothkit simulate` from
the true start, without replanning. The script prints, for each form, the seconds from command to plan (of the first
plan, which may compile programs, and the mean of the others) and the mean error of the outcomes, beside the expected
error and the error without any action. Needs data/ (`dvc repro`).
"""

import argparse
import dataclasses
import json
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from tables import show

from clothkit.app.output import write_mesh
from clothkit.cloth import voxels
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.dataset import store
from clothkit.observation.camera import CameraConfig, back_project
from clothkit.observation.picture import PictureConfig, take

PICTURE = PictureConfig(camera=CameraConfig(tilt=0.35), off=0.0)
SCALE = PICTURE.side / CLOTH_LENGTH


def clothkit(*arguments: object) -> str:
    """Run a command and return what it prints; if it fails, exit with its message."""
    ended = subprocess.run(
        [sys.executable, "-m", "clothkit", *map(str, arguments)], capture_output=True, text=True, check=False
    )
    if ended.returncode:
        sys.exit(f"clothkit {' '.join(map(str, arguments))}\n{ended.stderr}")
    return ended.stdout


def give(folder: Path, start: np.ndarray, goal: np.ndarray) -> dict[str, Path]:
    """Write the start in three forms, and the goal; return the paths of the start's files by form.

    Clouds and meshes are in metres.
    """
    files = {name: folder / file for name, file in (("cloud", "cloud.npz"), ("voxels", "voxels.npy"))}
    cloud = back_project(take(start, PICTURE).image)
    np.savez(files["cloud"], points=cloud.points, cloth=np.asarray(cloud.cloth))
    np.save(files["voxels"], np.asarray(voxels.observe(start)))
    files["mesh"] = folder / "start.obj"
    write_mesh(files["mesh"], start.astype(float) * SCALE)
    write_mesh(folder / "goal.obj", goal.astype(float) * SCALE)
    # For a camera's cloud, the origin of the table's frame is below the camera.
    below = np.append(PICTURE.camera.position()[:2], 0)
    write_mesh(folder / "start_below_camera.obj", start.astype(float) * SCALE - below)
    return files


def main() -> None:
    """Plan, execute and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequences", type=int, default=5)
    parser.add_argument("--length", type=int, default=1, choices=(1, 2, 3))
    asked = parser.parse_args()
    dataset = store.load(Path("data/meshes.zarr"))
    found: dict[str, list[dict[str, float]]] = {"cloud": [], "voxels": [], "mesh": []}
    for number, sequence in enumerate(dataset.indices("test", evaluated=True)[: asked.sequences].tolist()):
        start = number % (int(dataset.length[sequence]) - asked.length + 1)
        states = dataset.vertices[sequence, [start, start + asked.length]]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            plan, goal = folder / "plan.json", folder / "goal.obj"
            for form, file in give(folder, *states).items():
                began = time.perf_counter()
                clothkit("plan", "--state", file, "--goal", goal, "--steps", asked.length, "--out", plan)
                seconds = time.perf_counter() - began
                true = folder / ("start_below_camera.obj" if form == "cloud" else "start.obj")
                printed = clothkit(
                    "simulate", "--state", true, "--plan", plan, "--goal", goal, "--out", folder / "outcome.glb"
                )
                expected = json.loads(plan.read_text())["expected"]
                error = re.search(r"\(([\d.]+) cloth lengths\)", printed)
                assert error, printed
                found[form].append(
                    {
                        "seconds": seconds,
                        "error": float(error[1]),
                        "expected": expected["error_cloth_lengths"],
                        "no action": expected["error_no_action_cloth_lengths"],
                    }
                )
    table = []
    for form, rows in found.items():
        means = {name: np.mean([row[name] for row in rows]).round(4) for name in ("error", "expected", "no action")}
        spent = [row["seconds"] for row in rows]
        later = {"first, s": round(spent[0], 1), "others, s": round(float(np.mean(spent[1:] or spent)), 1)}
        table.append({"state given as": form, "plans": len(rows), **later, **means})
    show(f"clothkit plan --steps {asked.length}: seconds from command to plan; cloth lengths", table)
    print(f"camera: {json.dumps(dataclasses.asdict(PICTURE.camera))}")


if __name__ == "__main__":
    main()
