"""Exported files hold the same cloth when another program reads them: vertices, triangles, uv, units and frame."""

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import trimesh

from clothkit.app.export import main
from clothkit.cloth.topology import geodesic
from clothkit.dataset.regularise import RegulariseConfig, regularise
from clothkit.dataset.store import save

# Two topologies: the square as two triangles, and with a vertex in its middle. Material in metres, not from zero on.
SQUARE = np.array([[0, 0], [0.4, 0], [0.4, 0.4], [0, 0.4]]) + 0.1
MATERIALS = [SQUARE, np.concatenate([SQUARE, [[0.3, 0.3]]])]
TRIANGLES = [np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])]


def position(sequence: int, state: int) -> np.ndarray:
    """Slanted cloths, each further along x, each state steeper."""
    material = MATERIALS[state % 2] - 0.1
    slope = 0.1 * state
    height = 0.001 + material[:, :1] * np.sin(slope)
    return np.concatenate([material[:, :1] * np.cos(slope) + 0.05 * sequence, material[:, 1:], height], axis=1)


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Raw artifacts: sequences 3, 5 and 8, of one to three manipulations."""
    folder = tmp_path_factory.mktemp("export") / "raw"
    (folder / "states").mkdir(parents=True)
    states, steps = [], []
    for sequence, length in ((3, 1), (5, 2), (8, 3)):
        for state in range(length + 1):
            vertices = position(sequence, state).astype(np.float32).ravel()
            states.append({"sequence": sequence, "state": state, "topology": state % 2, "vertices": vertices})
        steps += [(sequence, step, 1, -1, -1, -1, -1, 0.5, 0.0) for step in range(length)]
    pd.DataFrame(states).to_parquet(folder / "states/0000.parquet")
    names = ["sequence", "step", "hands", "u1", "v1", "u2", "v2", "dx", "dy"]
    pd.DataFrame(steps, columns=names).to_parquet(folder / "manipulations.parquet")
    lists = {"material": [m.ravel() for m in MATERIALS], "triangles": [t.ravel() for t in TRIANGLES]}
    pd.DataFrame({"topology": [0, 1], **lists}).to_parquet(folder / "topologies.parquet")
    cloths = {"sequence": [3, 5, 8], "start": "flat", "side_u": 0.4, "side_v": 0.4, "thickness": 0.002}
    pd.DataFrame(cloths).to_parquet(folder / "cloths.parquet")
    return folder


def read(path: Path) -> Any:
    """The mesh as trimesh reads it, vertices as they stand in the file."""
    return trimesh.load_mesh(path, process=False)


def z_up(path: Path, mesh: Any) -> np.ndarray:
    """Vertices in the frame of the raw artifacts: GLB's y is our z, GLB's z is our -y."""
    x, y, z = np.asarray(mesh.vertices).T
    return np.stack([x, -z, y] if path.suffix == ".glb" else [x, y, z], axis=1)


@pytest.mark.parametrize("file_format", ["obj", "ply", "glb"])
def test_raw_states_come_back_as_they_were(raw: Path, tmp_path: Path, file_format: str) -> None:
    main([str(raw), "--sequence", "5", "--format", file_format, "--to", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == [f"sequence_0005_state_{k}.{file_format}" for k in range(3)]
    for state in range(3):
        path = tmp_path / f"sequence_0005_state_{state}.{file_format}"
        mesh = read(path)
        np.testing.assert_allclose(z_up(path, mesh), position(5, state), atol=1e-6)
        np.testing.assert_array_equal(mesh.faces, TRIANGLES[state % 2])
        expected = (MATERIALS[state % 2] - 0.1) / 0.4
        np.testing.assert_allclose(mesh.visual.uv, expected, atol=1e-6)
    once = path.read_bytes()
    main([str(raw), "--sequence", "5", "--format", file_format, "--to", str(tmp_path)])
    assert path.read_bytes() == once


def test_an_obj_refers_to_no_other_file(raw: Path, tmp_path: Path) -> None:
    main([str(raw), "--all", "--format", "obj", "--to", str(tmp_path)])
    assert len(list(tmp_path.iterdir())) == 2 + 3 + 4
    text = (tmp_path / "sequence_0003_state_1.obj").read_text()
    assert text.startswith("# clothkit: sequence_0003_state_1, metres, z up\n")
    assert "mtl" not in text


def test_meshes_of_a_store_lie_where_they_lay_in_metres(raw: Path, tmp_path: Path) -> None:
    settings = RegulariseConfig(train=1, validation=1, test=1, evaluated=1)
    save(tmp_path / "meshes.zarr", regularise(raw, settings), {})
    main([str(tmp_path / "meshes.zarr"), "--sequence", "1", "--format", "ply", "--to", str(tmp_path / "new/folder")])
    mesh = read(tmp_path / "new/folder/sequence_0001_state_1.ply")
    corners = np.asarray(mesh.vertices)[[0, 31 * 32, 32 * 32 - 1, 31]]
    np.testing.assert_allclose(corners, position(5, 1)[:4], atol=1e-6)
    np.testing.assert_allclose(mesh.visual.uv, (geodesic((32, 32)).reshape(-1, 2) + 1) / 2, atol=1e-6)
    assert (mesh.face_normals[:, 2] > 0.9).all()


def test_a_file_where_the_folder_should_be_is_told(raw: Path, tmp_path: Path) -> None:
    (tmp_path / "taken").write_bytes(b"mine")
    with pytest.raises(SystemExit) as ended:
        main([str(raw), "--all", "--to", str(tmp_path / "taken")])
    assert str(ended.value.code).startswith(f"export: {tmp_path / 'taken'}: can't be written: something of that name")
    assert (tmp_path / "taken").read_bytes() == b"mine"


def test_a_full_disk_leaves_what_was_exported_before(
    raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    main([str(raw), "--sequence", "3", "--format", "ply", "--to", str(tmp_path)])
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def half(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", half)
        with pytest.raises(SystemExit) as ended:
            main([str(raw), "--sequence", "3", "--format", "ply", "--to", str(tmp_path)])
    assert str(ended.value.code).startswith(f"export: {tmp_path}: can't be written: no space is left")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["{raw}", "--sequence", "4"], "{raw}: has no sequence 4; it holds 3, from 3 to 8"),
        (
            ["{raw}", "--all", "--format", "stl"],
            "format 'stl' is not known; known are obj, ply, glb, lerobot, huggingface",
        ),
        (["{raw}/none", "--all"], "{raw}/none: not found; expected a folder of raw artifacts or a store of meshes"),
        (["{raw}/states", "--all"], "{raw}/states: holds neither states/*.parquet nor a zarr store of meshes"),
    ],
)
def test_bad_input_ends_with_one_sentence(raw: Path, tmp_path: Path, arguments: list[str], sentence: str) -> None:
    with pytest.raises(SystemExit) as ended:
        main([argument.format(raw=raw) for argument in [*arguments, "--to", str(tmp_path / "none")]])
    assert ended.value.code == f"export: {sentence.format(raw=raw)}"
    assert not (tmp_path / "none").exists()
