"""A system that plans on what a depth camera sees (section 6.5)."""

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from clothkit.cloth.grid import flat
from clothkit.errors import InputError
from clothkit.networks.net import Net
from clothkit.networks.vtm import seen_by
from clothkit.observation.picture import PictureConfig, take
from clothkit.planning.planner import Planner
from clothkit.planning.sight import Meshes, MeshSight, States, View


@dataclass(frozen=True)
class CameraSight(MeshSight):
    """Meshes, estimated from pictures of the cloth instead of its own voxels."""

    picture: PictureConfig = field(default_factory=PictureConfig)

    def see(self, truth: Meshes, expected: States | None) -> View:
        """The estimates, and where the cloths were seen; `expected` as elsewhere.

        A cloth that no picture shows is taken for what was expected, or else for the flat one, in its true place.
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
    """Pictures whose clouds become voxels up to the height that the net knows."""
    return dataclasses.replace(picture, cloud=dataclasses.replace(picture.cloud, height=vtm.config.height))


def through_camera(planner: Planner, picture: PictureConfig) -> Planner:
    """The planner with a camera for eyes. Its goals stay what they are: meshes."""
    sight = planner.sight
    assert isinstance(sight, MeshSight), "a system that sees meshes"
    assert sight.vtm is not None, "a system that estimates them"
    return dataclasses.replace(planner, sight=CameraSight(sight.vtm, sight.refinement, sight.refine, picture=picture))
