"""Figure 4: a state in voxels, seen along each axis."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from clothkit.cloth import voxels as cloth_voxels
from clothkit.cloth.voxels import Viewport
from clothkit.report import panels

VIEWS = (("from above (x, y)", 2), ("from the front (x, z)", 1), ("from the side (y, z)", 0))
"""Title and viewing axis of each view."""


def voxels(mesh: Float[np.ndarray, "u v 3"], path: Path, *, viewport: Viewport) -> None:
    """Writes a figure of a mesh's voxels in a viewport, without noise and occlusion, seen along each axis.

    A pixel shows the share of occupied voxels in its column: from none (white) to the fullest column of the view
    (black). z is upwards in the views from front and side.
    """
    occupied = np.asarray(cloth_voxels.of_mesh(mesh, viewport=viewport))
    figure, axes = panels.sheet([1.6], [1.6] * len(VIEWS), above=0.2)
    for axis, (title, along) in zip(axes[0], VIEWS, strict=True):
        share = occupied.mean(axis=along)
        axis.set_axis_on()
        axis.imshow(share.T, origin="lower", cmap="gray_r", vmin=0, vmax=share.max(), interpolation="none")
        axis.set(xticks=[], yticks=[])
        for spine in axis.spines.values():
            spine.set(color="#999999", linewidth=0.6)
        panels.heading(axis, title)
    panels.save(figure, path)
