"""What can be told of a goal from its silhouette alone?  python studies/silhouettes.py [--data FOLDER]

Each named goal of the chain's cloth lies turned by ANGLE. Its voxels are those that a camera straight above sees, and
those that are made of its silhouette (`observation.silhouettes`); a mesh is estimated from both as `clothkit estimate`
does. A row per goal goes to reports/<scale>/studies/silhouettes.csv: the layers that the silhouette tells, and of
either estimate the error [cloth length] and the intersection over union of its silhouette and the goal's.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
from fingerprint import write

from clothkit.cloth.silhouette import iou, silhouette
from clothkit.cloth.topology import CLOTH_LENGTH
from clothkit.estimation.estimate import alternatives
from clothkit.evaluation.errors import errors
from clothkit.goals.store import WORK
from clothkit.goals.variants import Variant, goal_mesh
from clothkit.manipulation.named_folds import GOALS
from clothkit.models import store
from clothkit.observation.observe import observe
from clothkit.observation.silhouettes import points_of
from clothkit.observation.states import MeshState, SilhouetteState
from clothkit.params import load_params

ANGLE = 0.3
"""By how much the cloth lies turned [rad]."""
EXTENT, RESOLUTION = 1.1, 512
"""Half of the picture's width [normalised], and its pixels a side."""


def main() -> None:
    """Run the study and print the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("data"))
    asked = parser.parse_args()
    params = load_params(Path("params.yaml"))
    net, refine = store.load(asked.data / "nets/vtm"), params.stages.plan.refine
    simulation = params.stages.simulate.simulation
    settings = dataclasses.replace(params.app.cloud, viewport=net.config.viewport)
    side, scale = simulation.cloth_side, simulation.cloth_side / CLOTH_LENGTH
    cloth = np.array([CLOTH_LENGTH, CLOTH_LENGTH, simulation.material.thickness / scale], np.float32)[None]
    rows = []
    for name in GOALS:
        goal = goal_mesh(name, simulation.topology, simulation, Variant(angle=ANGLE), folder=WORK)
        covered = silhouette(goal, resolution=RESOLUTION, extent=EXTENT)
        pixel = 2 * EXTENT / RESOLUTION * scale
        picture = SilhouetteState(covered.T[::-1], pixel=pixel)
        points = points_of(picture, area=side**2, thickness=simulation.material.thickness, table=None, name=name)
        row: dict[str, str | float] = {"goal": name, "layers": side**2 / (covered.sum() * pixel**2)}
        for source, state in (("heights", MeshState(goal, np.zeros(2, np.float32), scale)), ("silhouette", points)):
            voxels = observe(state, cloth_side=side, settings=settings, name=name).voxels
            mesh = np.asarray(alternatives(net, voxels[None], refine, cloth=cloth).mesh[:, 0])
            row[source] = float(errors(mesh, goal[None], aligned=True, cloth=cloth)[0])
            row[f"{source}_iou"] = iou(silhouette(mesh[0]), silhouette(goal))
        rows.append(row)
    found = pd.DataFrame(rows)
    print(found.round(3).to_string(index=False))
    folder = Path("reports") / params.scale / "studies"
    folder.mkdir(parents=True, exist_ok=True)
    write(found, folder / "silhouettes.csv")


if __name__ == "__main__":
    main()
