"""What pictures show: sides, layers, spread, voxels; and that equal figures are equal bytes."""

from pathlib import Path

import numpy as np
import pytest

from clothkit.cloth import voxels
from clothkit.cloth.symmetry import relabel
from clothkit.cloth.topology import SQUARE, Topology, rectangle
from clothkit.report import panels
from clothkit.report.draw import EXTENT, Texture, draw, draw_heights, draw_silhouette
from clothkit.report.figures.equivalents import equivalents

PIXELS = 84

TEXTURES: tuple[Texture, ...] = ("plain", "grid", "geodesic")


def pixel(x: float, y: float) -> tuple[int, int]:
    """Row and column of a point [normalised]."""
    return int((EXTENT - y) / (2 * EXTENT) * PIXELS), int((x + EXTENT) / (2 * EXTENT) * PIXELS)


def is_front(colour: np.ndarray) -> bool:
    return bool(colour[2] > colour[0])


def half_folded() -> np.ndarray:
    """The flat cloth with the half x > 0 folded over onto the other."""
    mesh = SQUARE.flat()
    right = mesh[..., 0] > 0
    mesh[..., 2] = np.where(right, 0.02, 0)
    mesh[..., 0] = -np.abs(mesh[..., 0])
    return mesh


def test_a_flat_cloth_fills_its_square_and_shows_its_front() -> None:
    picture = draw(SQUARE.flat(), pixels=PIXELS)
    assert picture.shape == (PIXELS, PIXELS, 3)
    assert is_front(picture[pixel(0.6, 0.6)])
    assert is_front(picture[pixel(-0.6, 0.6)])
    assert (picture[pixel(0.95, 0.95)] > 240).all()


def test_mirrored_labels_show_the_other_side() -> None:
    picture = draw(np.asarray(relabel(SQUARE.flat(), 1)), pixels=PIXELS)
    assert not is_front(picture[pixel(0, 0)])


def test_the_upper_layer_hides_the_lower() -> None:
    picture = draw(half_folded(), pixels=PIXELS)
    assert not is_front(picture[pixel(-0.4, 0.1)])
    assert (picture[pixel(0.5, 0.1)] > 240).all()


def test_spread_is_lilac_around_the_cloth() -> None:
    mesh = SQUARE.flat()
    plain = draw(mesh, pixels=PIXELS).astype(int)
    spread = draw(mesh, std=np.full_like(mesh, 0.1), pixels=PIXELS).astype(int)
    beside = pixel(0.8, 0)
    assert spread[beside][1] < plain[beside][1] - 20
    assert spread[beside][2] > spread[beside][1]
    inside = pixel(0, 0)
    assert spread[inside][0] > plain[inside][0]


def test_the_spread_does_not_depend_on_how_a_rectangle_is_divided_into_quads() -> None:
    fine, coarse = rectangle(1.75), rectangle(1.75, shape=(32, 16))
    one, other = (draw(t.flat(), std=np.full_like(t.flat(), 0.1), pixels=PIXELS, topology=t) for t in (fine, coarse))
    beside = pixel(0.8, 0)
    np.testing.assert_allclose(one[beside].astype(int), other[beside].astype(int), atol=6)
    # A vertex of a square represents more cloth.
    denser = draw(fine.flat(), std=np.full_like(fine.flat(), 0.1), pixels=PIXELS)
    assert denser[beside][1] < one[beside][1] - 10


@pytest.mark.parametrize(("topology", "panels_drawn"), [(SQUARE, (2, 4)), (rectangle(1.5), (2, 2))])
def test_a_sheet_has_a_panel_for_each_equivalent(
    topology: Topology, panels_drawn: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheets = []
    monkeypatch.setattr(panels, "save", lambda figure, path: sheets.append(figure))
    equivalents(topology.flat(), tmp_path / "equivalents.png", topology)
    rows, columns = panels_drawn
    assert len(sheets[0].axes) == rows * columns
    assert len([axis for axis in sheets[0].axes if axis.images]) == topology.count


def test_the_table_may_be_coloured() -> None:
    picture = draw(SQUARE.flat(), table=panels.GOAL, pixels=PIXELS)
    np.testing.assert_allclose(picture[2, 2] / 255, panels.GOAL, atol=0.01)


def test_height_map_is_darker_where_it_is_higher() -> None:
    picture = draw_heights(np.asarray(voxels.observe(half_folded())), pixels=PIXELS)
    flat = draw_heights(np.asarray(voxels.observe(SQUARE.flat())), pixels=PIXELS)
    spot = pixel(-0.4, 0.1)
    assert picture[spot][0] < flat[spot][0] < 255
    assert picture[pixel(0.5, 0.1)][0] == 255


@pytest.mark.parametrize("displacement", [(0.7, 0.1), (0.1, 0.0)])
def test_equal_figures_are_equal_bytes(tmp_path: Path, displacement: tuple[float, float]) -> None:
    mesh = half_folded()
    for name in ("one.png", "two.png"):
        figure, axes = panels.sheet([1.0], [1.0, 1.0], title="Test", left=0.3)
        panels.show(axes[0, 0], draw(mesh), mark="R", note="0.031")
        panels.manipulate(axes[0, 0], mesh, np.array([-1, -1, 1, -0.5, *displacement], np.float32))
        panels.candidates(axes[0, 0], mesh[::31, ::31, :2].reshape(-1, 2))
        panels.centre_shift(axes[0, 0], np.array([0.2, 0.1], np.float32), mesh)
        panels.row_label(axes[0, 0], "row")
        panels.save(figure, tmp_path / name)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()


@pytest.mark.parametrize(
    ("start", "stop", "inside"),
    [
        ((0, 0), (0.5, 0.5), [(0, 0), (0.5, 0.5)]),
        ((0.05, 0), (2.05, 0), [(0.05, 0), (1.05, 0)]),
        ((0, -0.55), (0, -1.55), [(0, -0.55), (0, -1.05)]),
        # Out through a corner's side: the way rises as fast as it runs, the top is reached first.
        ((0.0, 0.55), (1.0, 1.55), [(0.0, 0.55), (0.5, 1.05)]),
        # It may begin outside, cross the panel, or pass it by.
        ((1.55, 0), (-1.55, 0), [(1.05, 0), (-1.05, 0)]),
        ((1.2, 0), (1.2, 1), []),
        ((0, 1.5), (1.5, 0.9), []),
    ],
)
def test_paths_are_cut_at_the_border(
    start: tuple[float, float], stop: tuple[float, float], inside: list[tuple]
) -> None:
    found = panels.clipped(np.array(start, float), np.array(stop, float))
    np.testing.assert_allclose(found, np.reshape(inside, (-1, 2)), atol=1e-9)


@pytest.mark.parametrize(("along", "leaves"), [(0.9, False), (1.9, True)])
def test_a_hand_that_leaves_the_panel_ends_in_an_arrow_at_its_border(along: float, leaves: bool) -> None:
    _, axes = panels.sheet([1.0], [1.0])
    axis = axes[0, 0]
    panels.manipulate(axis, SQUARE.flat(), np.array([-1, 0, -1, 0, along, 0.0], np.float32))
    assert all((np.abs(np.asarray(line.get_xydata())) <= EXTENT + 1e-6).all() for line in axis.lines)
    crosses = [line.get_xydata()[0] for line in axis.lines if line.get_marker() == "x"]
    tips = [text.xy for text in axis.texts if getattr(text, "arrow_patch", None) is not None]
    assert (len(crosses), len(tips)) == ((0, 1) if leaves else (1, 0))
    np.testing.assert_allclose((tips or crosses)[0], [EXTENT if leaves else -0.7 + along, 0], atol=0.03)


@pytest.mark.parametrize("shift", [(0.3, 0.1), (-0.2, 0.4), (0.0, -0.5)])
def test_the_centre_shift_stands_beside_the_cloth_and_to_scale(shift: tuple[float, float]) -> None:
    _, axes = panels.sheet([1.0], [1.0])
    axis = axes[0, 0]
    # A cloth that leaves room at the upper right alone.
    mesh = SQUARE.flat() + np.array([-0.3, -0.3, 0], np.float32)
    panels.centre_shift(axis, np.array(shift), mesh)
    (arrow,) = axis.texts
    tip, tail = np.array(arrow.xy), np.array(arrow.xyann)
    np.testing.assert_allclose(tip - tail, shift, atol=1e-6)
    assert (np.maximum(tip, tail) > 0.4).all()
    assert (np.abs([tip, tail]) < EXTENT).all()
    line = np.linspace(tail, tip, 50)
    assert ((line > 0.4).any(axis=1)).all()  # the cloth ends at 0.4 in x and in y


def test_a_shift_too_short_for_an_arrow_is_a_dot() -> None:
    _, axes = panels.sheet([1.0], [1.0])
    panels.centre_shift(axes[0, 0], np.array([0.01, 0.0]), SQUARE.flat())
    assert not axes[0, 0].texts
    assert len(axes[0, 0].lines) == 1


def test_textures_tell_places_on_the_cloth() -> None:
    plain, lined, hues = (draw(SQUARE.flat(), texture=texture, pixels=420).astype(int) for texture in TEXTURES)
    # A line of the grid runs through the middle, none midway to the next; it is the same colour, darker.
    centre, beside = (210, 210), (210 - 18, 210 + 18)
    assert lined[centre].sum() < 0.8 * plain[centre].sum()
    assert (lined[beside] == plain[beside]).all()
    corners = [hues[210 + down * 120, 210 + right * 120] for down in (-1, 1) for right in (-1, 1)]
    apart = [np.abs(a - b).max() for i, a in enumerate(corners) for b in corners[:i]]
    assert min(apart) > 40
    # Under other labels the same shape has its colours elsewhere.
    mirrored = draw(np.asarray(relabel(SQUARE.flat(), 2)), texture="geodesic", pixels=420).astype(int)
    assert np.abs(mirrored[90, 90] - hues[90, 330]).max() < 60 < np.abs(mirrored[90, 90] - hues[90, 90]).max()


def test_a_silhouette_is_grey_where_the_cloth_is() -> None:
    picture = draw_silhouette(half_folded(), pixels=PIXELS)
    assert picture[pixel(-0.4, 0.1)][0] < 230
    assert (picture[pixel(0.5, 0.1)] == 255).all()
