"""Settings of the way from point clouds to voxels."""

from typing import Annotated

from annotated_types import Ge, Gt, Le

from clothkit.cloth.voxels import HEIGHT
from clothkit.config import config
from clothkit.observation.plane import PlaneConfig

Triple = tuple[float, float, float]
Colour = tuple[int, int, int]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]


@config
class CloudConfig:
    """How a point cloud becomes voxels."""

    box: tuple[Triple, Triple] | None = None
    """Low and high corner of what is looked at [m], in the cloud's own frame; None: everything."""
    table_colour: tuple[Colour, Colour] | None = None
    """Least and greatest red, green, blue (0..255) of the table; all else is cloth. For clouds without a mask."""
    plane: PlaneConfig = PlaneConfig()
    highest: Annotated[float, Gt(0)] = 0.1
    """What is further above the table is not the cloth [m]."""
    most: Annotated[int, Ge(1000)] = 60_000
    """Points of the cloth that are looked at; of more, every second, third, ...: they cost time and add nothing."""
    neighbours: Annotated[int, Ge(0)] = 8
    """Nearest neighbours by whose distance outliers are told; 0: none are dropped."""
    deviations: Annotated[float, Gt(0)] = 4.0
    """Standard deviations above the mean of that distance from which a point is an outlier."""
    second: Annotated[float, Gt(0), Le(1)] = 0.1
    """Share of the cloth's area from which another piece is another object, and below which it is dropped."""
    smoothing: NotNegative = 0.009
    """Radius [m] around a point over which it takes the median height: less noise, while layers keep their edges."""
    covered: Share = 0.04
    """Share of a voxel's area that points must cover for it to be occupied: at less, a mesh has no vertex there."""
    closed: Annotated[int, Ge(0)] = 4
    """Most voxels in xy of a gap within the cloth, where no table is seen, that is filled."""
    surface: NotNegative = 0.0
    """From a mesh's vertices up to the surface that the camera sees, half a real cloth's thickness [m]."""
    height: Annotated[float, Gt(0)] = HEIGHT
    """Upper end of the viewport [normalised]."""
