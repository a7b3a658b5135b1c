"""Draw scenes with viser."""

import numpy as np
import trimesh
import viser
from jaxtyping import Float
from scipy.interpolate import make_interp_spline
from trimesh.exchange.gltf import export_glb
from trimesh.visual.material import PBRMaterial

from clothkit.app.viewer.colours import rgb
from clothkit.app.viewer.scene import Caption, Cloth, Dots, Path, Scene
from clothkit.cloth.topology import triangles

_TABLE = (236, 234, 230)
_FIELD = np.deg2rad(32)  # vertical field of view [rad]
_FROM = np.array([0.0, -0.68, 0.73])  # from the target to the camera


class Canvas:
    """The 3D part of the page."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._drawn: list[viser.SceneNodeHandle] = []
        scene = server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(enabled=False)
        # An environment map would tint the colours, which encode values.
        scene.configure_environment_map(None)
        scene.add_light_ambient("/lights/all_around", intensity=1.2)
        # Light from the upper left, as in the report's pictures.
        scene.add_light_directional("/lights/sun", intensity=1.6, position=(-3.0, 3.0, 5.0))
        scene.add_grid(
            "/table",
            width=11.2,
            height=11.2,
            cell_size=0.2,
            section_size=1.4,
            cell_color=(222, 220, 216),
            section_color=(205, 203, 198),
            plane_color=_TABLE,
            plane_opacity=1.0,
            position=(0, 0, -0.012),
        )

    def look_from(self, scene: Scene) -> None:
        """Place the camera so that the whole scene is in view."""
        low, high = np.min(scene.middles, axis=0), np.max(scene.middles, axis=0)
        target = np.append((low + high) / 2, 0.0)
        # At this distance, a length of `across` fills the height of the page.
        across = 1.2 * float((high - low).max()) + 1.9
        position = target + across / (2 * np.tan(_FIELD / 2)) * _FROM
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = position, target, _FIELD
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = position, target

    def draw(self, scene: Scene) -> None:
        """Draw a scene, and remove the last one."""
        with self._server.atomic():
            for handle in self._drawn:
                handle.remove()
            self._drawn = [
                *(self._cloth(f"/cloth/{i}", cloth) for i, cloth in enumerate(scene.cloths)),
                *(handle for i, path in enumerate(scene.paths) for handle in self._path(f"/paths/{i}", path)),
                *(self._dots(f"/points/{i}", dots) for i, dots in enumerate(scene.dots)),
                *(self._caption(f"/captions/{i}", caption) for i, caption in enumerate(scene.captions)),
            ]

    def _cloth(self, name: str, cloth: Cloth) -> viser.SceneNodeHandle:
        return self._server.scene.add_glb(name, two_sided(cloth), cast_shadow=False, receive_shadow=False)

    def _path(self, name: str, path: Path) -> list[viser.SceneNodeHandle]:
        scene, colour = self._server.scene, rgb(path.colour)
        segments = np.stack([path.points[:-2], path.points[1:-1]], axis=1)
        return [
            scene.add_line_segments(f"{name}/way", segments, colour, thickness=0.012),
            scene.add_icosphere(f"{name}/grasp", 0.026, colour, position=path.points[0], cast_shadow=False),
            scene.add_arrows(
                f"{name}/release",
                path.points[None, [-4, -1]],
                colour,
                shaft_radius=0.006,
                head_radius=0.028,
                head_length=0.07,
            ),
        ]

    def _dots(self, name: str, dots: Dots) -> viser.SceneNodeHandle:
        if dots.cubes:
            one = trimesh.creation.box((dots.size, dots.size, dots.size / 8))
        else:
            one = trimesh.creation.icosphere(subdivisions=2, radius=dots.size)
        return self._server.scene.add_batched_meshes_simple(
            name,
            one.vertices,
            one.faces,
            batched_wxyzs=np.tile([1.0, 0, 0, 0], (len(dots.points), 1)),
            batched_positions=dots.points,
            batched_colors=np.rint(dots.colours * 255).astype(np.uint8),
            cast_shadow=False,
        )

    def _caption(self, name: str, caption: Caption) -> viser.SceneNodeHandle:
        return self._server.scene.add_label(name, caption.text, position=caption.place, anchor="center-center")


def two_sided(cloth: Cloth) -> bytes:
    """Return the cloth as GLB with each face twice, once per side: visible from that side only, in its colours."""
    mesh = finer(cloth.mesh, degree=3)
    faces, vertices = triangles(mesh.shape[:2]), mesh.reshape(-1, 3)
    scene = trimesh.Scene()
    for name, wound, side in (("front", faces, cloth.front), ("back", faces[:, ::-1], cloth.back)):
        painted = finer(side, degree=1)
        blended = cloth.opacity < 1
        material = PBRMaterial(
            name=name,
            baseColorFactor=np.array([255, 255, 255, round(255 * cloth.opacity)], np.uint8),
            metallicFactor=0.0,
            roughnessFactor=1.0,
            alphaMode="BLEND" if blended else "OPAQUE",
            doubleSided=False,
        )
        visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(vertices), 2)), material=material)
        visual.vertex_attributes["color"] = _linear(painted.reshape(-1, 3))
        surface = trimesh.Trimesh(vertices, wound, visual=visual, process=False)
        scene.add_geometry(surface, node_name=name, geom_name=name)
    return export_glb(scene, include_normals=True)


def finer(values: Float[np.ndarray, "u v 3"], *, degree: int) -> Float[np.ndarray, "fu fv 3"]:
    """Interpolate an array over vertices to about twice the resolution, by splines of that degree.

    Without that, folds that are diagonal to the grid look like stairs.
    """
    for axis in (0, 1):
        knots = np.arange(values.shape[axis])
        between = np.linspace(0, knots[-1], 2 * knots[-1] + 1)
        values = make_interp_spline(knots, values, k=degree, axis=axis)(between)
    return values.astype(np.float32)


def _linear(colours: np.ndarray) -> np.ndarray:
    """Convert sRGB colours 0..1 to RGBA bytes of linear light, as GLB stores vertex colours."""
    light = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    return np.column_stack([np.rint(light * 255), np.full(len(light), 255)]).astype(np.uint8)
