"""Pose of an observed cloth: converts between normalised coordinates, the table's frame and the camera's frame."""

import dataclasses

import numpy as np
from jaxtyping import Float

Points = Float[np.ndarray, "*points 3"]


@dataclasses.dataclass(frozen=True)
class Pose:
    """Three frames: *normalised* (centred, as nets and plans use it), *table* [m, z up from z = 0], *camera* [m]."""

    rotation: Float[np.ndarray, "3 3"]
    """The table's axes as rows, in the camera's frame."""
    origin: Float[np.ndarray, "3"]
    """The origin of the table's frame in the camera's frame [m]."""
    centre: Float[np.ndarray, "2"]
    """The cloth's centre on the table [m]."""
    scale: float
    """Metres per normalised unit: the cloth's side / 1.4."""

    def normalised_to_table(self, points: Points) -> Points:
        """Metres in the table's frame."""
        return points * self.scale + self._offset

    def table_to_normalised(self, points: Points) -> Points:
        """Normalised and centred, from metres in the table's frame."""
        return (points - self._offset) / self.scale

    def table_to_camera(self, points: Points) -> Points:
        """Metres in the camera's frame, from metres in the table's."""
        return points @ self.rotation + self.origin

    def camera_to_table(self, points: Points) -> Points:
        """Metres in the table's frame, from metres in the camera's."""
        return (points - self.origin) @ self.rotation.T

    def normalised_to_camera(self, points: Points) -> Points:
        """Metres in the camera's frame."""
        return self.table_to_camera(self.normalised_to_table(points))

    def camera_to_normalised(self, points: Points) -> Points:
        """Normalised and centred, from metres in the camera's frame."""
        return self.table_to_normalised(self.camera_to_table(points))

    def moved(self, shift: Float[np.ndarray, "2"]) -> "Pose":
        """The pose after the cloth's centre has moved by a shift [normalised], such as a predicted one."""
        return dataclasses.replace(self, centre=self.centre + np.asarray(shift, float) * self.scale)

    @property
    def _offset(self) -> np.ndarray:
        return np.append(self.centre, 0.0)
