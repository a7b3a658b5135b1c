"""The study of real cloths: what images are read as, measures by hand, nets that are trained in other ways."""

import json
import shutil
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from clothkit.cloth.symmetry import equivalents
from clothkit.cloth.topology import SQUARE
from tests import tiny

HEIGHT = 0.005
"""Of the upper side of the cloth in the images [m]."""


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    monkeypatch.chdir(tmp_path)
    return import_module("real_cloths")


@pytest.fixture
def images(tmp_path: Path) -> Path:
    """A flat towel as a real image with two markers, and a flat cloth as a simulated one with its mesh."""
    folder = tmp_path / "images"
    for part, size, half, value in (("real", 720, 240, 193 - 2000 * HEIGHT), ("simulated", 552, 186, 200.95 - 5.0)):
        (folder / part).mkdir(parents=True)
        picture = np.full((size, size, 3), 255, np.uint8)
        middle = size // 2
        picture[middle - half : middle + half, middle - half : middle + half] = round(value)
        name = "larger_square_0" if part == "real" else "00"
        cv2.imwrite(str(folder / part / f"{name}.png"), picture)
    markers = {"corner_markers_m": [[0.11, 0.11], [-0.11, 0.11]]}
    (folder / "real/larger_square_0.json").write_text(json.dumps(markers))
    u, v = np.meshgrid(*[np.linspace(-1, 1, 21)] * 2, indexing="ij")
    np.savetxt(folder / "simulated/00.txt", np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3))
    return folder


def test_images_are_read_in_metres(study: ModuleType, images: Path) -> None:
    real, simulated = study.pictures(images)
    np.testing.assert_allclose(
        [real.points.min(0), real.points.max(0)], [[-0.125, -0.125, HEIGHT], [0.125, 0.125, HEIGHT]], atol=1e-3
    )
    assert real.markers.shape == (2, 2)
    np.testing.assert_allclose(np.ptp(simulated.points[:, :2], axis=0), 0.25, atol=2e-3)
    np.testing.assert_allclose(np.ptp(simulated.mesh.reshape(-1, 3), axis=0), [0.25, 0.25, 0], atol=1e-9)


def test_clouds_are_read_with_what_is_known_of_them(study: ModuleType, tmp_path: Path) -> None:
    folder = tmp_path / "clouds"
    folder.mkdir()
    mesh = SQUARE.flat().astype(float) * (0.5 / 1.4) * [1, 0.6, 1] + [0.2, 0, 0.004]
    points = np.concatenate([mesh.reshape(-1, 3), [[1.0, 1.0, 0.0]]])
    np.savez(folder / "towel.npz", points=points, cloth=np.arange(len(points)) < 1024)
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.reshape(-1, 3)]
    faces = SQUARE.triangles() + 1
    (tmp_path / "truth.obj").write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in faces)]))
    told = {"sides": [0.5, 0.3], "thickness": 0.004, "corner_markers_m": [[0.44, 0.14]], "mesh": "../truth.obj"}
    notes = folder / "towel.json"
    notes.write_text(json.dumps(told))
    (cloth,) = study.pictures(tmp_path)
    assert (cloth.name, cloth.sides, cloth.thickness) == ("towel", (0.5, 0.3), 0.004)
    np.testing.assert_allclose(cloth.points, points[:-1])
    np.testing.assert_allclose(cloth.markers, [[0.44, 0.14]])
    np.testing.assert_allclose(study.vertex_error(cloth.mesh, mesh), 0, atol=1e-6)
    notes.write_text(json.dumps({"sides": [0.5, 0.3]}))
    with pytest.raises(study.InputError, match=r"towel\.json: expected one file of points"):
        list(study.pictures(tmp_path))


def test_an_image_of_an_unknown_cloth_is_named(study: ModuleType, images: Path) -> None:
    (images / "real/larger_square_0.png").rename(images / "real/napkin_0.png")
    with pytest.raises(study.InputError, match=r"napkin_0\.png: expected a name that begins with one of larger_square"):
        list(study.pictures(images))


def test_measures_by_hand(study: ModuleType) -> None:
    placed = SQUARE.flat().astype(float) * (0.25 / 1.4)
    markers = np.array([[0.11, 0.11], [-0.11, 0.11]])
    assert study.corner_error(placed, markers) == pytest.approx(np.hypot(0.015, 0.015), abs=1e-6)
    axis = np.linspace(-0.125, 0.125, 21)
    truth = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((21, 21))], axis=-1)
    for labelled in np.asarray(equivalents(truth)):
        found = study.vertex_error(placed + np.array([0.03, 0, -placed[0, 0, 2]]), labelled)
        assert found == pytest.approx(0.03, abs=1e-6)


def test_nets_are_trained_in_other_ways(
    study: ModuleType, images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny.write_params(tmp_path / "params.yaml")
    (tmp_path / "data").mkdir()
    tiny.write_data(tmp_path / "data", tmp_path / "params.yaml")
    trained: list[Any] = []

    def train(folder: Path, seed: int, params: Any, training: Any, validation: Any, current: str) -> Any:
        trained.append((folder.name, seed, params.stages.train_vtm, len(training), len(validation), current))
        shutil.copytree("data/nets/vtm", folder, dirs_exist_ok=True)
        return study.store.load(folder)

    monkeypatch.setattr(study, "train_estimator", train)
    for extra in (
        ["--seeds", "1", "--pictures", "drawn"],
        ["--ways", "longer", "more data", "--also", "data"],
        ["--seeds", "1"],
    ):
        monkeypatch.setattr(sys, "argv", ["real_cloths", str(images), *extra])
        study.main()
    assert len(list(Path("drawn").glob("*_chain_*.png"))) == 4
    (seed, longer, more, again) = trained
    own = study.load_params(Path("params.yaml")).stages.train_vtm
    assert seed == again
    assert (seed[:3], longer[0], more[0]) == (("1", 1, own), "longer", "more_data")
    assert longer[2].training.iterations == 3 * own.training.iterations
    assert (more[2], more[3], more[4]) == (own, 2 * seed[3], seed[4])
    assert len({each[5] for each in (seed, longer, more)}) == 3
    rows = pd.read_csv("reports/smoke/studies/real_cloths.csv")
    found = rows.groupby(["way", "seed"], sort=False).size().to_dict()
    assert found == {("longer", 0): 2, ("more data", 0): 2, ("chain", 0): 2, ("chain", 1): 2}
    assert rows.loc[rows["image"] == "simulated_00", "vertices_cm"].notna().all()
    assert rows["fingerprint"].notna().all()
    means = pd.read_csv("reports/smoke/studies/real_cloths_summary.csv")
    assert means.groupby("kind").size().to_dict() == {"larger_square": 4, "simulated": 4}
    monkeypatch.setattr(sys, "argv", ["real_cloths", str(images), "--ways", "more data"])
    with pytest.raises(SystemExit):
        study.main()
