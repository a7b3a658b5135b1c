"""The cloth's material, and some fabrics, in SI units.

Sources of FABRICS:

[1] H. Wang, J. F. O'Brien, R. Ramamoorthi, "Data-driven elastic models for cloth: modeling and measurement", ACM
    Transactions on Graphics 30(4), 2011, in the coefficients that come with ARCSim (materials/*.json).
[2] X. Feng, W. Huang, W. Xu, H. Wang, "Learning-based bending stiffness parameter estimation by a drape tester", ACM
    Transactions on Graphics 41(6), 2022, with its data set of 618 measured fabrics.
"""

from dataclasses import replace
from typing import Annotated

from annotated_types import Ge, Gt, Le

from clothkit.runtime.config import config

Positive = Annotated[float, Gt(0.0)]
NotNegative = Annotated[float, Ge(0.0)]


THINNEST, THICKEST = 1e-3, 8e-3
"""Range of `Material.thickness` [m]."""


@config
class Material:
    """The cloth and the table, in SI units, so that folds stay alike when the time step or the grid is refined.

    The default shear is softer than that of a fabric (ARCSim's gray-interlock: about 20 N/m), with which a few more
    folds take too long to rest; below 1 N/m fold lines become wavy. FABRICS have the stiffness that was measured.

    The ranges are those in which the solver was tried: if one setting is at either end of its range and the others have
    their defaults, folds come to rest.
    """

    density: Annotated[float, Ge(0.03), Le(1.5)] = 0.187  # kg/m^2
    stretch_stiffness: Annotated[float, Ge(200), Le(5e4)] = 2000.0  # N/m, tension per strain along the threads
    shear_stiffness: Annotated[float, Ge(0.01), Le(200)] = 3.0  # N/m, shear force per length and angle
    shear_limit: Annotated[float, Ge(0.2), Le(1.4)] = 0.76  # rad, the angle at which shearing locks
    bending_stiffness: Annotated[float, Ge(1e-6), Le(1e-3)] = 2e-5  # N m, moment per width and curvature
    bending_friction: Annotated[float, Ge(0), Le(5e-3)] = 0.0  # N, moment per width against any change of curvature
    bending_limit: Annotated[float, Ge(5), Le(1e4)] = 31.0  # 1/m, curvature beyond which the moment no longer grows
    thickness: Annotated[float, Ge(THINNEST), Le(THICKEST)] = 2e-3  # m, distance of touching layers
    cloth_friction: Annotated[float, Ge(0), Le(0.8)] = 0.3
    table_friction: Annotated[float, Ge(0), Le(2)] = 0.7
    stiction: Annotated[float, Ge(0), Le(10)] = 2.0  # m/s^2, a smaller acceleration does not move a resting vertex
    viscosity: Annotated[float, Ge(0), Le(0.2)] = 0.02  # m^2/s, of velocity differences within the cloth
    drag: Annotated[float, Ge(0), Le(20)] = 2.0  # 1/s, of the air


_JERSEY = Material(
    density=0.187,
    bending_stiffness=2e-5,
    bending_limit=1e4,
    bending_friction=4e-4,
    shear_stiffness=20.0,
    cloth_friction=0.6,
    table_friction=0.3,
    viscosity=1e-3,
    drag=0.5,
)

FABRICS = {
    # A T-shirt's knit: gray-interlock [1], density, the mean of the bending stiffnesses along warp, weft and bias at
    # small curvature (23, 25 and 14 uN m) and the shear modulus at small strain (37 N/m; 20 N/m is more like ARCSim's
    # folds). Friction is that of ARCSim's scenes. Viscosity, drag and bending friction are fitted to ARCSim's folds.
    "jersey": _JERSEY,
    # 11 oz black denim [1], by the same rules: bending 64, 73 and 97 uN m, shear 53 N/m. The rest is the jersey's.
    "stiff_cotton": replace(_JERSEY, density=0.324, bending_stiffness=7.8e-5, shear_stiffness=53.0),
    # A terry towel of 400 g/m^2. Its bending stiffness is the median of the fabrics from 350 to 450 g/m^2 [2] (26
    # of them: 41, 19 and 27 uN m along warp, weft and bias). Thickness and friction are larger because of its pile, but
    # their values have no source. Shear and the fitted values are the jersey's.
    "towel": replace(
        _JERSEY, density=0.4, bending_stiffness=2.9e-5, thickness=4e-3, cloth_friction=0.8, table_friction=0.5
    ),
}
"""Measured fabrics by name. Their stretch stiffness is the default material's: they stretch less than real fabrics."""


def of_fabric(material: object) -> object:
    """Return the fabric of that name if `material` is a string, else `material` unchanged.

    Raises ValueError for an unknown name.
    """
    if not isinstance(material, str):
        return material
    if material not in FABRICS:
        raise ValueError(f"no fabric {material!r}; there are {', '.join(FABRICS)}")
    return FABRICS[material]
