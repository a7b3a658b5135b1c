"""Settings of the conversion from point clouds to voxels."""

from typing import Annotated

from annotated_types import Ge, Gt, Le

from clothkit.cloth.voxels import VIEWPORT, Viewport
from clothkit.observation.plane import PlaneConfig
from clothkit.runtime.config import config

Triple = tuple[float, float, float]
Colour = tuple[int, int, int]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]


@config
class CloudConfig:
    """How a point cloud becomes voxels."""

    box: tuple[Triple, Triple] | None = None
    """Low and high corner of the box to which points are cropped [m], in the cloud's own frame; None: no cropping."""
    table_colour: tuple[Colour, Colour] | None = None
    """Least and greatest red, green, blue (0..255) of the table; other points are cloth. For clouds without a mask."""
    plane: PlaneConfig = PlaneConfig()
    highest: Annotated[float, Gt(0)] = 0.1
    """Largest height above the table at which points are taken for cloth [m]."""
    most: Annotated[int, Ge(1000)] = 60_000
    """Largest number of cloth points that are used; of more points, every second, third, ... one, to save time."""
    neighbours: Annotated[int, Ge(0)] = 8
    """Number of nearest neighbours whose mean distance identifies outliers; 0: no outliers are dropped."""
    deviations: Annotated[float, Gt(0)] = 4.0
    """A point is an outlier if that distance is more than this many standard deviations above its mean."""
    second: Annotated[float, Gt(0), Le(1)] = 0.1
    """Share of the cloth's area from which a further piece is a second object; smaller pieces are dropped."""
    smoothing: NotNegative = 0.009
    """Radius of the median filter of heights [m]. It reduces noise, while layers keep their edges."""
    covered: Share = 0.04
    """Least number of points in an occupied column of voxels, as a share of the median number.

    In a column that the cloth covers less, a mesh has no vertex.
    """
    closed: Annotated[int, Ge(0)] = 4
    """Largest gap within the cloth that is filled, in columns of voxels. Gaps that show the table are not filled."""
    surface: NotNegative = 0.0
    """Height of the surface that the camera sees above a mesh's vertices: half the thickness of a real cloth [m]."""
    viewport: Viewport = VIEWPORT
    """The voxels that nets take."""
