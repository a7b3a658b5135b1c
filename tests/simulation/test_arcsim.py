"""ARCSim's runs as raw artifacts: on runs that are made up here, and on ARCSim's own folds."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.regularise import RegulariseConfig, interpolation, regularise
from clothkit.runtime.errors import InputError
from clothkit.simulation import arcsim
from clothkit.simulation.arcsim import import_runs
from clothkit.simulation.arcsim_obj import read_frame
from clothkit.simulation.arcsim_runs import files, read_runs
from clothkit.simulation.records import SCHEMAS
from tests.simulation import arcsim_runs as runs

HALF = {0: (0.4, 0.0), 1: (0.4, 0.0)}
LAST = runs.FRAME
SCALE = 1.4 / runs.SIDE


def record(runs_folder: Path, out: Path, most: int = 1000) -> Path:
    import_runs(out / "raw", read_runs(str(runs_folder), most), work=out / "work", attributes={"stage": "simulate"})
    return out / "raw"


def manipulations(raw: Path) -> pd.DataFrame:
    return pd.read_parquet(raw / "manipulations.parquet")


@pytest.fixture
def two(tmp_path: Path) -> Path:
    """Two runs; sequence 0 has one manipulation, sequence 1 has two."""
    runs.write_run(tmp_path / "runs/half", HALF)
    runs.write_run(tmp_path / "runs/corner", {0: (0.2, 0.2)}, seed=1)
    return runs.write_table(
        tmp_path / "runs", [[("half", 0), ("half", LAST)], [("half", 0), ("half", LAST), ("corner", LAST)]]
    )


def test_the_artifacts_have_our_own_solvers_columns(two: Path, tmp_path: Path) -> None:
    raw = record(two, tmp_path / "out")
    for name, schema in SCHEMAS.items():
        path = raw / ("states/0000.parquet" if name == "states" else f"{name}.parquet")
        found = pq.read_schema(path)
        assert found.equals(schema)
        assert json.loads(found.metadata[b"clothkit"]) == {"stage": "simulate"}
    states = pd.read_parquet(raw / "states")
    assert states["sequence"].tolist() == [0, 0, 1, 1, 1]
    assert states["state"].tolist() == [0, 1, 0, 1, 2]
    assert states["topology"].tolist() == [0, 1, 2, 3, 4]
    topologies = pd.read_parquet(raw / "topologies.parquet")
    counts = [len(material) // 2 for material in topologies["material"]]
    assert counts == [len(vertices) // 3 for vertices in states["vertices"]]
    assert len(set(counts)) == 2
    attempts = pd.read_parquet(raw / "attempts.parquet")
    assert attempts["accepted"].all()
    assert attempts["reason"].tolist() == ["", ""]
    assert attempts["states"].tolist() == [2, 3]


def test_a_linear_map_comes_through_to_the_last_digit(two: Path, tmp_path: Path) -> None:
    raw = record(two, tmp_path / "out")
    states, topologies = pd.read_parquet(raw / "states"), pd.read_parquet(raw / "topologies.parquet")
    row = topologies.iloc[1]
    mesh = interpolation(row["material"].reshape(-1, 2), row["triangles"].reshape(-1, 3))(
        states["vertices"][1].reshape(-1, 3)
    )
    expected = runs.sheared((SQUARE.geodesic().astype(float).reshape(-1, 2) + 1) / 2 * runs.SIDE)
    np.testing.assert_allclose(mesh.reshape(-1, 3), expected, atol=2e-7)


def test_what_is_measured_on_a_state(two: Path, tmp_path: Path) -> None:
    states = pd.read_parquet(record(two, tmp_path / "out") / "states")
    flat, sheared = states.iloc[0], states.iloc[1]
    assert flat["height"] == pytest.approx(0.002 * SCALE)
    assert flat["strain_worst"] < 1e-6
    assert np.isnan(flat["residual_speed"])
    assert sheared["residual_speed"] == pytest.approx(0.003)
    assert sheared["height"] == pytest.approx((0.002 + 0.02 * 0.4 + 0.03 * 0.4) * SCALE, rel=1e-5)
    # Along u a length becomes |(0.8, 0.1, 0.02)| of it: what strains most lies nearly so.
    assert 0.1 < sheared["strain_p99"] <= sheared["strain_worst"] < 0.25
    assert (states["intersections"] == 0).all()


def test_a_cloth_through_itself_is_counted(tmp_path: Path) -> None:
    folder = runs.write_run(tmp_path / "runs/a", HALF)
    uv = runs.material()
    u, v = uv.T
    # Two halves that lie across each other at x = 0.1 m.
    folded = np.stack([np.abs(u - 0.2), v, 0.1 * np.where(u < 0.2, u, u - 0.2)], axis=1)
    runs.write_frame(folder / f"{LAST:04d}_00.obj", uv, folded)
    raw = record(runs.write_table(tmp_path / "runs", [[("a", 0), ("a", LAST)]]), tmp_path / "out")
    assert pd.read_parquet(raw / "states")["intersections"].tolist()[1] > 0


def test_manipulations_of_one_and_two_hands(two: Path, tmp_path: Path) -> None:
    found = manipulations(record(two, tmp_path / "out"))
    assert found["hands"].tolist() == [2, 2, 1]
    assert found["step"].tolist() == [0, 0, 1]
    vectors = found[["u1", "v1", "u2", "v2", "dx", "dy"]].to_numpy()
    np.testing.assert_allclose(vectors[:2], [[-1, -1, -1, 1, 1.4, 0]] * 2, atol=1e-6)
    np.testing.assert_allclose(vectors[2], [-1, -1, -1, -1, 0.7, 0.7], atol=1e-6)
    releases = found[["release_x1", "release_y1", "release_x2", "release_y2"]].to_numpy()
    np.testing.assert_allclose(releases, [[0.2, -0.2, 0.2, 0.2]] * 2 + [[0, 0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(found["settle_time"], 1.5, atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.5, 2.0, 4.0])
def test_the_displacement_is_that_of_equation_1(tmp_path: Path, angle: float) -> None:
    # By reflection: corners (0, 0) and (0, L), the line m through p with unit normal n.
    normal = np.array([np.cos(angle), np.sin(angle)])
    d = 0.3 * normal
    grasps = np.array([[-0.2, -0.2], [-0.2, 0.2]])
    p = (grasps.sum(0) + d) / 2
    mirrored = grasps - 2 * ((grasps - p) @ normal)[:, None] * normal
    runs.write_run(tmp_path / "runs/a", dict(enumerate((mirrored - grasps).tolist())))
    runs.write_table(tmp_path / "runs", [[("a", 0), ("a", LAST)]])
    found = manipulations(record(tmp_path / "runs", tmp_path / "out")).iloc[0]
    np.testing.assert_allclose(found[["dx", "dy"]].astype(float), d * SCALE, atol=1e-6)
    np.testing.assert_allclose(found[["release_x2", "release_y2"]].astype(float), mirrored[1], atol=1e-6)


def test_a_run_may_hold_several_manipulations(tmp_path: Path) -> None:
    folder = runs.write_run(tmp_path / "runs/a", HALF)
    uv = runs.material(5)[::-1]
    runs.write_frame(folder / "0150_00.obj", uv, runs.sheared(uv))
    handles = [runs.handle(0, 0), runs.handle(1, 0), runs.handle(3, 1, start=3.0, end=4.2)]
    motions = [runs.motion(HALF[0]), runs.motion((-0.1, -0.3), start=3.0, end=4.2)]
    runs.write_scene(folder / "conf.json", handles, motions)
    runs.write_table(tmp_path / "runs", [[("a", 0), ("a", LAST), ("a", 150)]])
    found = manipulations(record(tmp_path / "runs", tmp_path / "out"))
    np.testing.assert_allclose(found[["u1", "v1", "dx", "dy"]].iloc[1].astype(float), [1, 1, -0.35, -1.05], atol=1e-6)
    # The second hand takes the corner where the first manipulation has left it.
    left = runs.sheared(np.array([[0.4, 0.4]]))[0, :2] + [-0.1, -0.3]
    np.testing.assert_allclose(found[["release_x1", "release_y1"]].iloc[1].astype(float), left, atol=1e-6)
    np.testing.assert_allclose(found["settle_time"], [1.5, 1.8], atol=1e-6)


def test_short_sequences_end_in_missing_states(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        runs.write_run(tmp_path / "runs" / name, HALF)
    states = [("a", 0), ("a", LAST), ("b", LAST), ("c", LAST)]
    runs.write_table(tmp_path / "runs", [states[:2], states[:3], states])
    raw = record(tmp_path / "runs", tmp_path / "out")
    dataset = regularise(raw, RegulariseConfig(train=1, validation=1, test=1))
    assert dataset.length.tolist() == [1, 2, 3]
    present = np.arange(4) <= dataset.length[:, None]
    np.testing.assert_array_equal(np.isfinite(dataset.vertices).all((2, 3, 4)), present)
    np.testing.assert_array_equal(np.isnan(dataset.vertices).all((2, 3, 4)), ~present)
    np.testing.assert_array_equal(np.isfinite(dataset.centre).all(2), present)
    np.testing.assert_array_equal(np.isnan(dataset.manipulation).all(2), ~present[:, 1:])
    assert (dataset.hands == 2 * present[:, 1:]).all()
    # Every state but the flat one is the same linear map of the material, normalised and centred.
    expected = SCALE * runs.sheared((SQUARE.geodesic().astype(float) + 1) / 2 * runs.SIDE)
    for sequence, state in ((0, 1), (1, 2), (2, 3)):
        moved = dataset.vertices[sequence, state] + np.append(dataset.centre[sequence, state], 0)
        np.testing.assert_allclose(moved, expected, atol=1e-6)


def test_an_interrupted_import_goes_on_to_the_same_bytes(
    two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = record(two, tmp_path / "whole")
    monkeypatch.setattr(arcsim, "BLOCK", 1)
    read: list[Path] = []

    def interrupted(path: Path) -> Any:
        read.append(path)
        if path.name == f"{LAST:04d}_00.obj" and path.parent.name == "corner" and not (tmp_path / "again").exists():
            raise KeyboardInterrupt
        return read_frame(path)

    monkeypatch.setattr(arcsim, "read_frame", interrupted)
    with pytest.raises(KeyboardInterrupt):
        record(two, tmp_path / "out")
    (tmp_path / "again").touch()
    read.clear()
    raw = record(two, tmp_path / "out")
    assert len(read) == 5  # those of sequence 1: three states, two starts
    for path in sorted(whole.rglob("*.parquet")):
        assert path.read_bytes() == (raw / path.relative_to(whole)).read_bytes()


def test_the_first_sequences_of_the_table_are_taken(two: Path) -> None:
    assert [len(sequence) for sequence in read_runs(str(two), 1)] == [2]
    names = [str(path.relative_to(two)) for path in files(read_runs(str(two), 5))]
    assert names == ["corner/0000_00.obj", "corner/0075_00.obj", "corner/conf.json", "half/0000_00.obj",
                     "half/0075_00.obj", "half/conf.json"]  # fmt: skip


def replaced(path: Path, *pairs: tuple[str, str]) -> None:
    text = path.read_text()
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)


TABLES = {
    "no file": (None, "runs.csv: not found, expected a table with the columns sequence,state,folder,frame"),
    "no column": ("sequence,state,folder\n0,0,half\n", "runs.csv: has no column 'frame'"),
    "no rows": ("sequence,state,folder,frame\n", "runs.csv: holds no rows"),
    "no number": ("sequence,state,folder,frame\n0,0,half,\n", "runs.csv: line 2: frame is '', expected a whole number"),
    "twice": ("sequence,state,folder,frame\n0,0,half,0\n0,0,half,0\n", "line 3: state 0 of sequence 0 is there alr"),
    "hole": ("sequence,state,folder,frame\n0,0,half,0\n0,2,half,75\n", "sequence 0: state 1 is missing"),
    "no start": ("sequence,state,folder,frame\n3,1,half,75\n", "sequence 3: state 0 is missing"),
    "no end": ("sequence,state,folder,frame\n0,0,half,0\n", "sequence 0: its last state is 0, expected 1 to 3"),
    "no folder": ("sequence,state,folder,frame\n0,0,half,0\n0,1,fold,75\n", "the folder .*fold is not there"),
    "no frame": ("sequence,state,folder,frame\n0,0,half,0\n0,1,half,74\n", "0074_00.obj is not there, expected frame"),
    "binary": (b"\xff\xfe\x00\x01", "runs.csv: can't be read as CSV"),
}


def test_a_folder_in_place_of_a_table_is_told(tmp_path: Path) -> None:
    (tmp_path / "runs.csv").mkdir()
    with pytest.raises(InputError, match=r"runs\.csv: can't be read, expected a table .*: it is a folder"):
        read_runs(str(tmp_path), 10)


@pytest.mark.parametrize("case", list(TABLES))
def test_bad_tables_end_in_one_sentence(tmp_path: Path, case: str) -> None:
    runs.write_run(tmp_path / "half", HALF)
    content, sentence = TABLES[case]
    if content is not None:
        (tmp_path / "runs.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=sentence) as error:
        read_runs(str(tmp_path), 10)
    assert "\n" not in str(error.value)


def test_no_folder_of_runs_is_told_by_its_key() -> None:
    with pytest.raises(InputError, match=r"simulate\.runs is empty"):
        read_runs("", 1)


def test_another_cloths_files_are_refused(tmp_path: Path) -> None:
    folder = runs.write_run(tmp_path / "half", HALF)
    runs.write_table(tmp_path, [[("half", 0), ("half", LAST)]])
    (folder / f"{LAST:04d}_01.obj").write_text("")
    with pytest.raises(InputError, match=r"0075_01\.obj is a second cloth"):
        read_runs(str(tmp_path), 10)
    (folder / f"{LAST:04d}_00.obj").unlink()
    with pytest.raises(InputError, match=r"0075_00\.obj is not there, expected frame 75 of cloth 0"):
        read_runs(str(tmp_path), 10)


FRAMES = {
    "number": (r"^v (\S+) \S+", r"v \1 much", "line {line}: expected 'v x y z', found"),
    "nan": (r"^v (\S+) \S+", r"v \1 nan", "line {line}: expected 'v x y z', found"),
    "short line": (r"^vt (\S+) \S+", r"vt \1", "line {line}: expected 'vt u v', found"),
    "no vt": (r"^f (\d+)/\d+", r"f \1", "line {line}: expected 'f n/vt n/vt n/vt', found"),
    "quad": (r"^f (.*)$", r"f \1 1/1", "line {line}: expected 'f n/vt n/vt n/vt', found"),
    "far node": (r"^f \d+/", "f 9999/", "a face refers to v number 9999, the file holds"),
    "seam": (r"^f (\d+)/\d+", r"f \1/1", "node .* has several material coordinates, so the cloth has seams"),
    "hole": (r"^f .*\n", "", "its triangles cover .*% of the material square"),
}


@pytest.mark.parametrize("case", list(FRAMES))
def test_bad_frames_end_in_one_sentence(two: Path, tmp_path: Path, case: str) -> None:
    path = two / "half" / f"{LAST:04d}_00.obj"
    old, new, sentence = FRAMES[case]
    text = path.read_text()
    # The second of its kind: the first vt may well be the one that a corner is given.
    place = list(re.finditer(old, text, flags=re.MULTILINE))[1]
    path.write_text(text[: place.start()] + place.expand(new) + text[place.end() :])
    line = text[: place.start()].count("\n") + 1
    with pytest.raises(InputError, match=r"0075_00\.obj: " + sentence.format(line=line)):
        record(two, tmp_path / "out")


def test_files_that_are_cut_short_or_no_obj_are_refused(two: Path, tmp_path: Path) -> None:
    path = two / "half" / f"{LAST:04d}_00.obj"
    content = path.read_bytes()
    for share in (0.1, 0.5, 0.9, 0.99):
        path.write_bytes(content[: int(len(content) * share)])
        with pytest.raises(InputError, match=r"0075_00\.obj: "):
            record(two, tmp_path / "out")
    path.write_bytes(b"\x00\xff" * 100)
    with pytest.raises(InputError, match="can't be read as an OBJ file"):
        record(two, tmp_path / "out")
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match=r"0075_00\.obj(: can't be read, expected an OBJ file| is not there)"):
        record(two, tmp_path / "out")
    path.rmdir()
    path.write_text("# nothing\n")
    with pytest.raises(InputError, match="holds 0 vertices and 0 faces"):
        record(two, tmp_path / "out")


def test_a_material_that_is_no_square_is_refused(two: Path, tmp_path: Path) -> None:
    uv = runs.material()
    wide = uv * [1.5, 1]
    runs.write_frame(two / "half/0000_00.obj", wide, runs.flat(uv))
    with pytest.raises(InputError, match=r"span 0\.6 x 0\.4 m, expected a square"):
        record(two, tmp_path / "out")


SCENES: dict[str, tuple[dict[str, Any] | str, str]] = {
    "cut": ('{"frame_time": 0.04, "handles": [', "the whole file: invalid JSON"),
    "no frame time": ({"handles": []}, "frame_time: field required"),
    "no handles": ({"frame_time": 0.04}, "handles: expected one or two grasped nodes, found none"),
    "nodes": ({"handles": [{"nodes": ["a"]}]}, "handles.0.nodes.0: input should be a valid integer"),
    "label": ({"handles": [{"label": 3}]}, "expected a handle of listed nodes, found label 3"),
    "glue": ({"handles": [{"type": "glue", "nodes": [0, 1]}]}, "found one of type 'glue'"),
    "motion": ({"handles": [{"nodes": [0], "motion": 1}]}, "handles.0.motion: is 1, but there are 1 motions"),
    "far node": ({"handles": [{"nodes": [999], "motion": 0}]}, "node 999 is none of the"),
    "three": ({"handles": [{"nodes": [0, 1, 2], "motion": 0}]}, r"grasp the nodes \[0, 1, 2\] at once"),
    "late": ({"handles": [{"nodes": [0], "motion": 0, "start_time": 3.0}]}, "starts before frame 75, found none"),
    "infinite": ('{"frame_time": 1e999, "handles": []}', "frame_time: input should be a finite number"),
    "far away": (
        {"motions": [runs.motion((float("inf"), 0))], "handles": [{"nodes": [0], "motion": 0}]},
        "motions.0.1.transform.translate.0: input should be a finite number",
    ),
    "turned": (
        {"motions": [[{"time": 0, "transform": {"rotate": [90, 0, 0, 1]}}]], "handles": [{"nodes": [0], "motion": 0}]},
        "motions.0.0.transform: expected a translation only",
    ),
    "apart": (
        {
            "motions": [runs.motion((0.2, 0.2)), runs.motion((0.2, -0.2))],
            "handles": [{"nodes": [0], "motion": 0}, {"nodes": [1], "motion": 1}],
        },
        r"a hand lets go 0\.\d+ cloth sides from where a manipulation's would",
    ),
}


@pytest.mark.parametrize("case", list(SCENES))
def test_bad_scenes_end_in_one_sentence(two: Path, tmp_path: Path, case: str) -> None:
    content, sentence = SCENES[case]
    if isinstance(content, dict):
        common: dict[str, Any] = {} if case == "no frame time" else {"frame_time": runs.FRAME_TIME}
        content = json.dumps({"motions": [runs.motion((0.4, 0))], **common, **content})
    (two / "half/conf.json").write_text(content)
    with pytest.raises(InputError, match=r"half/conf\.json: .*" + sentence) as error:
        record(two, tmp_path / "out")
    assert "\n" not in str(error.value)


def test_scenes_may_have_comments(two: Path, tmp_path: Path) -> None:
    replaced(two / "half/conf.json", ("{", '{ // "a" comment\n "name": "http://b", /* and\n another */'))
    assert len(manipulations(record(two, tmp_path / "out"))) == 3


@runs.needs_reference
def test_arcsims_own_folds(tmp_path: Path) -> None:
    names = ["half_04m_fix32", "half_04m_adapt", "corner_04m_fix32"]
    for name in names:
        runs.copy_reference(tmp_path / "runs" / name, name)
    runs.write_table(tmp_path / "runs", [[(name, 0), (name, LAST)] for name in names])
    raw = record(tmp_path / "runs", tmp_path / "out")
    states = pd.read_parquet(raw / "states")
    assert [len(vertices) // 3 for vertices in states["vertices"]] == [1024, 1024, 85, 646, 1024, 1024]
    assert (states["intersections"] == 0).all()
    assert states["strain_worst"].max() < 0.03
    vectors = manipulations(raw)[["hands", "u1", "v1", "u2", "v2", "dx", "dy"]].to_numpy()
    expected = [[2, -1, -1, -1, 1, 1.4, 0]] * 2 + [[1, -1, -1, -1, -1, 0.7, 0.7]]
    np.testing.assert_allclose(vectors, expected, atol=1e-5)
    meshes = []
    for number in (1, 3):
        topology = pd.read_parquet(raw / "topologies.parquet").iloc[number]
        interpolate = interpolation(topology["material"].reshape(-1, 2), topology["triangles"].reshape(-1, 3))
        meshes.append(interpolate(states["vertices"][number].reshape(-1, 3)))
    # ARCSim's fixed grid is ours: its nodes come back, by their material coordinates, up to its six digits.
    frame = read_frame(tmp_path / "runs/half_04m_fix32" / f"{LAST:04d}_00.obj")
    place = np.rint(frame.material / runs.SIDE * 31).astype(int)
    np.testing.assert_allclose(meshes[0][place[:, 0], place[:, 1]], frame.positions, atol=2e-6)
    # The same fold with other nodes: 3.7 mm apart in the mean, 10 mm at most.
    apart = np.linalg.norm(meshes[0] - meshes[1], axis=-1)
    assert apart.mean() < 0.005
    assert apart.max() < 0.015
