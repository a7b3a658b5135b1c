"""Prebuilt nets are unpacked as the stages leave nets, once, and only if they are what the manifest names."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest

from clothkit.estimation import alarms
from clothkit.models import store
from clothkit.planning import normalisation
from clothkit.prebuilt import manifest as manifests
from clothkit.prebuilt.deviation import Deviation
from clothkit.prebuilt.files import WHOLE, check_size, pack, unpack, unpacked
from clothkit.prebuilt.manifest import manifest_of
from clothkit.runtime.errors import InputError
from tests.tiny import MEMBERS, alarms_of, write_nets


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prebuilt") / "data"
    write_nets(folder)
    alarms.save(folder / "nets/alarms.npz", alarms_of(strangest=3.0))
    return folder


@pytest.fixture(scope="module")
def made(data: Path) -> Path:
    """A folder of prebuilt nets with its manifest."""
    folder = data.parent / "made"
    pack(data, folder, MEMBERS)
    described(folder, data)
    return folder


def described(folder: Path, data: Path) -> None:
    found = Deviation(full=0.1, packed=0.101, standard_error=None, count=1)
    sources = {"data/nets/vtm": data / "nets/vtm"}
    manifests.write(
        folder,
        manifest_of(
            folder, scale="smoke", members=MEMBERS, sources=sources, params={"a": 1}, deviations={"plan": found}
        ),
    )


def test_unpacked_nets_are_nearly_the_full_ones(data: Path, made: Path, tmp_path: Path) -> None:
    unpack(made, tmp_path / "data", MEMBERS)
    for name in ("nets/pemd/0", "nets/pemd/1", "nets/vtm"):
        full, back = store.load(data / name), store.load(tmp_path / "data" / name)
        assert full.config == back.config
        assert store.description(data / name) == store.description(tmp_path / "data" / name)
        for one, other in zip(jax.tree.leaves(full.params), jax.tree.leaves(back.params), strict=True):
            np.testing.assert_allclose(one, other, atol=0.5001 * float(np.abs(one).max()) / 127)
    assert store.validation_score(tmp_path / "data/nets/pemd/1") == store.validation_score(data / "nets/pemd/1")
    reference = "normalisation/mesh.json"
    assert normalisation.load(tmp_path / "data" / reference) == normalisation.load(data / reference)
    known, full_known = (alarms.load(folder / "nets/alarms.npz", units=16) for folder in (tmp_path / "data", data))
    assert known.least == full_known.least
    assert known.strangest == full_known.strangest
    np.testing.assert_allclose(known.support.whitening, full_known.support.whitening, rtol=2e-3, atol=1e-4)


def test_equal_nets_give_equal_files(data: Path, made: Path, tmp_path: Path) -> None:
    pack(data, tmp_path / "again", MEMBERS)
    described(tmp_path / "again", data)
    names = sorted(path.relative_to(made) for path in made.rglob("*") if path.is_file())
    assert len(names) == 3 * 2 + len(WHOLE) + 2
    for name in names:
        assert (made / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def test_they_are_unpacked_once(made: Path, tmp_path: Path) -> None:
    first = unpacked(made, keep=tmp_path)
    before = (first / "nets/vtm/net.msgpack").stat().st_mtime_ns
    assert unpacked(made, keep=tmp_path) == first
    assert (first / "nets/vtm/net.msgpack").stat().st_mtime_ns == before
    assert list(tmp_path.iterdir()) == [first]


def truncate(folder: Path) -> None:
    path = folder / "nets/vtm/net.npz"
    path.write_bytes(path.read_bytes()[:-7])


def exchange(folder: Path) -> None:
    """Another file of the same size."""
    path = folder / "nets/pemd/0/net.json"
    path.write_text(path.read_text().replace("0.1", "0.2"))


def remove(folder: Path) -> None:
    (folder / "nets/alarms.npz").unlink()


def unknown_field(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "more": 1}))


def cut_manifest(folder: Path) -> None:
    path = folder / "manifest.json"
    path.write_text(path.read_text()[:50])


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (truncate, r"nets/vtm/net\.npz: expected \d+ bytes, as manifest\.json says, found \d+; git checkout"),
        (exchange, r"nets/pemd/0/net\.json: is not the file that manifest\.json names"),
        (remove, r"nets/alarms\.npz: not found, expected a file that .*manifest\.json names"),
        (unknown_field, r"manifest\.json: more: extra inputs are not permitted"),
        (cut_manifest, r"manifest\.json: expected the manifest of prebuilt nets, found a truncated"),
    ],
)
def test_wrong_files_are_told_and_nothing_is_left(
    made: Path, tmp_path: Path, damage: Callable[[Path], None], sentence: str
) -> None:
    folder, keep = tmp_path / "made", tmp_path / "keep"
    shutil.copytree(made, folder)
    keep.mkdir()
    damage(folder)
    with pytest.raises(InputError, match=sentence) as raised:
        unpacked(folder, keep=keep)
    assert "\n" not in str(raised.value)
    assert not list(keep.iterdir())


def test_files_that_are_too_large_for_a_repository(made: Path) -> None:
    check_size(made, megabytes=1.0)
    with pytest.raises(InputError, match=r"packed nets take 0\.\d MB, expected at most 0\.01"):
        check_size(made, megabytes=0.01)


def test_the_digest_of_a_folder_is_that_of_its_files_and_their_names(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "one").write_text("1")
    assert manifests.digest(tmp_path / "a") == manifests.digest(tmp_path / "b")
    (tmp_path / "b/one").rename(tmp_path / "b/two")
    assert manifests.digest(tmp_path / "a") != manifests.digest(tmp_path / "b")
    assert manifests.digest(tmp_path / "a/one") == "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b"
