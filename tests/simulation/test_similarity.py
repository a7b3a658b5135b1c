"""Materials of other sizes: by hand, and that ratios of forces to weight stay the same."""

import pytest

from clothkit.simulation.material import FABRICS, Material
from clothkit.simulation.similarity import resized


def test_a_towel_of_half_a_metre_on_a_grid_of_40_cm() -> None:
    found = resized(FABRICS["towel"], 0.5 / 0.4)
    # (2.9e-5 N m) (0.4 / 0.5)^3, (20 N/m) (0.4 / 0.5), (4e-4 N) (0.4 / 0.5)^2; a limit of 1e4 1/m is the largest.
    assert found.bending_stiffness == pytest.approx(1.4848e-5)
    assert found.shear_stiffness == pytest.approx(16.0)
    assert found.bending_friction == pytest.approx(2.56e-4)
    assert found.bending_limit == 1e4
    assert (found.thickness, found.density, found.stretch_stiffness) == (4e-3, 0.4, 2000.0)


def test_lengths_of_the_material_scale_with_the_cloth() -> None:
    """A cloth bends under its own weight within (B / (rho g))^(1/3), wherever its limit is not reached."""
    own, size = Material(), 1.6
    found = resized(own, size)
    bends = [(each.bending_stiffness / (each.density * 9.81)) ** (1 / 3) for each in (own, found)]
    assert bends[1] == pytest.approx(bends[0] / size)
    # The curvature at which the moment stops to grow, in radii of that length, is the same.
    assert found.bending_limit * bends[1] == pytest.approx(own.bending_limit * bends[0])
    assert resized(own, 1.0) == own


def test_values_stay_where_the_solver_was_tried() -> None:
    small, large = resized(Material(), 0.05), resized(Material(), 20.0)
    assert (small.bending_stiffness, small.bending_limit) == (1e-3, 5.0)
    assert (large.bending_stiffness, large.shear_stiffness) == (1e-6, pytest.approx(0.15))
