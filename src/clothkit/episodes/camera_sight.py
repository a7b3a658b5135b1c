"""Observation by a simulated depth camera, for systems that plan with meshes (section 6.5)."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from clothkit.cloth.grid import flat
from clothkit.errors import InputError
from clothkit.models.net import Net
from clothkit.models.vtm import seen_by
from clothkit.observation.picture import PictureConfig, take
from clothkit.planning.planner import Planner
from clothkit.planning.sight import Meshes, MeshSight, States, View


@dataclass(frozen=True)
class CameraSight(MeshSight):
    """States are meshes, estimated from depth images of the cloth instead of voxels of the true mesh."""

    picture: PictureConfig = field(default_factory=PictureConfig)

    def see(self, truth: Meshes, expected: States | None) -> View:
        """The estimated meshes and the observed shifts of their centres; arguments as in `Sight.see`.

        If no picture shows the cloth, the voxels of the expected mesh are used instead, or those of the flat cloth if
        `expected` is None, with a shift of zero.
        """
        assert self.vtm is not None, "a sight that estimates has a net for it"
        picture_of = for_net(self.picture, self.vtm)
        seen, shift = [], np.zeros((len(truth), 2), np.float32)
        for number, mesh in enumerate(truth):
            try:
                picture = take(mesh, picture_of)
            except InputError:
                seen.append(np.asarray(seen_by(self.vtm, flat() if expected is None else expected[number])))
                continue
            seen.append(picture.observation.voxels)
            shift[number] = picture.shift
        return View(self.estimates(np.stack(seen), expected), shift)


def for_net(picture: PictureConfig, vtm: Net) -> PictureConfig:
    """The camera's settings with the voxel grid's height set to the height that the VtM net was trained with."""
    return dataclasses.replace(picture, cloud=dataclasses.replace(picture.cloud, height=vtm.config.height))


def through_camera(planner: Planner, picture: PictureConfig) -> Planner:
    """The planner with its observations replaced by those of a depth camera. Goals are still given as meshes."""
    sight = planner.sight
    assert isinstance(sight, MeshSight), "a system that sees meshes"
    assert sight.vtm is not None, "a system that estimates them"
    return dataclasses.replace(planner, sight=CameraSight(sight.vtm, sight.refinement, sight.refine, picture=picture))
