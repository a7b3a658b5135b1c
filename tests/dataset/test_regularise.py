from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.regularise import RegulariseConfig, assign_splits, interpolation, regularise
from clothkit.runtime.errors import InputError

SETTINGS = RegulariseConfig(train=2, validation=1, test=1, evaluated=1)


def write_raw(folder: Path, count: int = 4) -> Path:
    """Raw artifacts of cloths that lie flat, each state 0.1 m further along x, on a grid of 32 x 32 of 0.4 m."""
    (folder / "states").mkdir(parents=True)
    material = (SQUARE.geodesic().reshape(-1, 2) + 1) * 0.2
    rows, steps = [], []
    for sequence in range(count):
        for state in range(4):
            position = np.concatenate([material + np.array([0.1 * state, 0]), np.full((1024, 1), 0.001)], -1)
            rows.append((sequence, state, 0, position.astype(np.float32).ravel()))
        steps += [(sequence, step, 1 + step % 2, -1, -1, 1, 1, 0.5, sequence) for step in range(3)]
    pd.DataFrame(rows, columns=["sequence", "state", "topology", "vertices"]).to_parquet(folder / "states/0.parquet")
    names = ["sequence", "step", "hands", "u1", "v1", "u2", "v2", "dx", "dy"]
    pd.DataFrame(steps, columns=names).to_parquet(folder / "manipulations.parquet")
    topology = {"topology": [0], "material": [material.ravel()], "triangles": [SQUARE.triangles().ravel()]}
    pd.DataFrame(topology).to_parquet(folder / "topologies.parquet")
    cloths = {"sequence": range(count), "start": "flat", "side_u": 0.4, "side_v": 0.4, "thickness": 0.002}
    pd.DataFrame(cloths).to_parquet(folder / "cloths.parquet")
    return folder


def test_flat_cloths_become_the_flat_mesh_and_its_centre(tmp_path: Path) -> None:
    dataset = regularise(write_raw(tmp_path), SETTINGS)
    expected = SQUARE.flat() + np.float32([0, 0, 0.0035])
    np.testing.assert_allclose(dataset.vertices, np.broadcast_to(expected, (4, 4, 32, 32, 3)), atol=1e-3)
    np.testing.assert_allclose(
        dataset.centre[:, :, 0] - dataset.centre[:, :1, 0], [[0, 0.35, 0.7, 1.05]] * 4, atol=1e-3
    )
    np.testing.assert_allclose(dataset.manipulation[3, 1], [-1, -1, 1, 1, 0.5, 3])
    assert dataset.length.tolist() == [3] * 4


@given(st.integers(0, 5))
def test_interpolation_is_exact_for_linear_maps_on_any_topology(seed: int) -> None:
    scipy_spatial = pytest.importorskip("scipy.spatial")
    rng = np.random.default_rng(seed)
    corners = np.array([[0, 0], [0, 0.4], [0.4, 0], [0.4, 0.4]])
    material = np.concatenate([corners, rng.uniform(0, 0.4, (60, 2))])
    faces = scipy_spatial.Delaunay(material).simplices.astype(np.int32)
    matrix, shift = rng.normal(size=(2, 3)), rng.normal(size=3)
    mesh = interpolation(material, faces)(material @ matrix + shift)
    target = (SQUARE.geodesic().reshape(-1, 2) + 1) * 0.2
    np.testing.assert_allclose(mesh.reshape(-1, 3), target @ matrix + shift, atol=1e-6)


def test_an_uncovered_square_is_refused() -> None:
    material = np.array([[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4]])
    with pytest.raises(InputError, match="uncovered"):
        interpolation(material, np.array([[0, 1, 2]], np.int32))


def test_too_few_sequences_and_bad_rows_are_refused_by_name(tmp_path: Path) -> None:
    raw = write_raw(tmp_path / "raw", 3)
    with pytest.raises(InputError, match="holds 3 sequences, params ask for 4"):
        regularise(raw, SETTINGS)
    raw = write_raw(tmp_path / "enough")
    states = pd.read_parquet(raw / "states/0.parquet")
    states.at[5, "vertices"] = np.full(3072, np.nan, np.float32)
    states.to_parquet(raw / "states/0.parquet")
    with pytest.raises(InputError, match=r"0\.parquet: column vertices: .* found nan \(sequence 1, state 1\)"):
        regularise(raw, SETTINGS)
    file = raw / "manipulations.parquet"
    write_raw(tmp_path / "other")
    file = tmp_path / "other" / "manipulations.parquet"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InputError, match=r"manipulations\.parquet: can't be read as parquet"):
        regularise(tmp_path / "other", SETTINGS)


@pytest.mark.parametrize(
    ("row", "column", "value", "sentence"),
    [
        (2, "sequence", 7, "has no row for sequence 2, expected one for each"),
        (1, "side_u", 400.0, "side_u"),
        (1, "side_v", np.nan, "side_v"),
        (3, "thickness", -0.002, "thickness"),
        (0, "start", "thrown", r"expected text \(flat, dragged, dropped\) or nothing, found .thrown."),
    ],
)
def test_faulty_cloths_are_refused_by_name(tmp_path: Path, row: int, column: str, value: object, sentence: str) -> None:
    raw = write_raw(tmp_path / "raw")
    cloths = pd.read_parquet(raw / "cloths.parquet")
    cloths.loc[row, column] = value
    cloths.to_parquet(raw / "cloths.parquet")
    with pytest.raises(InputError, match=rf"cloths\.parquet.*{sentence}"):
        regularise(raw, SETTINGS)


def test_splits_have_their_sizes_and_come_from_the_seed() -> None:
    settings = RegulariseConfig(train=8, validation=3, test=4, evaluated=2, seed=1)
    split, evaluated = assign_splits(settings)
    assert np.bincount(split).tolist() == [8, 3, 4]
    assert np.bincount(split[evaluated], minlength=3).tolist() == [2, 0, 2]
    np.testing.assert_array_equal(split, assign_splits(settings)[0])
