"""How wavy a fold line is, of creases that are made up."""

import importlib
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

SPACING, COUNT = 0.0125, 16
BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def likeness(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("likeness")


def cubic(count: int) -> np.ndarray:
    """The polynomial of degree three that is orthogonal to all parabolas on so many equal steps; its rms is 1."""
    x = np.arange(count) - (count - 1) / 2
    values = x**3 - x * (3 * count**2 - 7) / 20
    return values / np.sqrt((values**2).mean())


def scene_and_cloth(across: float, height: float) -> tuple[SimpleNamespace, np.ndarray]:
    """A cloth folded over the line x = 0, with a crease that leaves a parabola by these rms distances [m].

    The ends of the crease, which do not count, are far off.
    """
    y, x = np.meshgrid(SPACING * np.arange(COUNT), SPACING * (np.arange(COUNT) - COUNT / 2 + 0.5))
    flat = np.stack([x, y, 0 * x], axis=-1)
    # Two hands lift the edge at x < 0 and move along x to the other one.
    path = np.stack([[flat[0, 0], flat[-1, 0]], [flat[0, -1], flat[-1, -1]]])[None]
    held = np.array([[[0, COUNT - 1]]]).transpose(0, 2, 1)
    motion = SimpleNamespace(held=held, path=path)
    crease = np.full((2, COUNT), 0.03)
    along = np.arange(COUNT - 2.0)
    for values, rms in zip(crease, (across, height), strict=True):
        values[1:-1] = rms * cubic(COUNT - 2) + 0.002 + 0.0004 * along - 0.00003 * along**2
    cloth = flat.copy()
    cloth[..., 0] = crease[0] + 0.1 + SPACING * np.arange(COUNT)[:, None]
    cloth[0, :, 0], cloth[0, :, 2] = crease
    return SimpleNamespace(motion=motion, start=flat), cloth


@pytest.mark.parametrize(("across", "height"), [(0.0, 0.0), (0.0017, 0.001), (0.0008, 0.0046)])
def test_waves_are_the_distances_of_the_crease_from_a_parabola(
    likeness: ModuleType, across: float, height: float
) -> None:
    found = likeness.waves(*scene_and_cloth(across, height))
    assert found == {
        "crease xy": pytest.approx(1e3 * across, abs=0.01),
        "crease z": pytest.approx(1e3 * height, abs=0.01),
    }
