"""Similar cloths: what a material becomes when the simulator's cloth stands for one of another size."""

from dataclasses import replace
from typing import get_type_hints

from clothkit.simulation.material import Material

POWERS = {"shear_stiffness": -1, "bending_stiffness": -3, "bending_friction": -2, "bending_limit": 1}
"""With which power of the size each property is multiplied.

Shapes at rest are alike where forces keep their ratio to the cloth's weight. At an equal mass per area rho, a strip of
length L weighs rho g L per width. Shear is a force per width and compared with that, a moment per width with rho g L^2,
bending stiffness, a moment per width and curvature, with rho g L^3; the limit is a curvature, which goes with 1 / L.
"""


def resized(material: Material, size: float) -> Material:
    """The material with which a cloth behaves at rest like one that is `size` times as large and has `material`.

    Its thickness is left as it is, since a person tells that of the larger cloth. So is the stretch stiffness: of both
    cloths it only keeps the edges from stretching. Time does not scale alike: a larger cloth falls and swings more
    slowly. Values are limited to the ranges in which the solver was tried.
    """
    hints = get_type_hints(Material, include_extras=True)
    values = {}
    for name, power in POWERS.items():
        least, most = hints[name].__metadata__
        values[name] = min(max(getattr(material, name) * size**power, least.ge), most.le)
    return replace(material, **values)
