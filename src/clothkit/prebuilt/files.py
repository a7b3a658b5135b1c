"""Prebuilt nets as files: packed from a data folder, and unpacked into one."""

import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from clothkit.estimation import alarms
from clothkit.models import ensemble, store
from clothkit.models.net import Net
from clothkit.planning import trust
from clothkit.planning.uncertainty_terms import EXPECTED_ERROR, SUPPORT
from clothkit.prebuilt import manifest as manifests
from clothkit.prebuilt import packing
from clothkit.runtime.cache import writable
from clothkit.runtime.errors import InputError

WEIGHTS = "net.npz"
"""A net's packed weights; `store.ATTRIBUTES`, beside them, is the net's own."""

ALARMS, REFERENCE, VTM = "nets/alarms.npz", "normalisation/mesh.json", "nets/vtm"

WHOLE = (REFERENCE, SUPPORT, EXPECTED_ERROR, trust.PLACE)
"""Small files that are prebuilt as they are."""

SECTIONS = (
    "simulate",
    "regularise",
    "augment",
    "train_pemd",
    "train_vtm",
    "set_alarms",
    "train_support",
    "normalise",
    "probe",
    "calibrate",
)
"""The params of what prebuilt nets come from."""


def nets(members: Sequence[int]) -> Iterator[tuple[str, store.Kind]]:
    """The folders, under that of all data, and the kinds of the nets that are prebuilt: those of system main."""
    for folder in ensemble.folders(Path("nets"), "pemd", members).values():
        yield folder.as_posix(), "pemd"
    yield VTM, "vtm"


def sources(members: Sequence[int]) -> list[str]:
    """What prebuilt nets are made from, under the folder of all data."""
    return ["meshes.zarr", *(name for name, _ in nets(members)), ALARMS, *WHOLE]


def pack(data: Path, target: Path, members: Sequence[int], *, half: Sequence[str] = ()) -> None:
    """Pack the nets of system main and what belongs to them from `data` into a folder, without a manifest.

    `half` as in `PrebuildConfig`. Raises InputError for nets that are missing or damaged.
    """
    for name, kind in nets(members):
        net = store.load(data / name, kind)
        folder = target / name
        folder.mkdir(parents=True, exist_ok=True)
        packing.write(folder / WEIGHTS, packing.packed(net.params, _known_as(name), half))
        shutil.copyfile(data / name / store.ATTRIBUTES, folder / store.ATTRIBUTES)
    known = alarms.load(data / ALARMS, units=store.configuration(data / VTM, "vtm").hidden)
    half_precise = known._replace(support=type(known.support)(*(_in_half(part) for part in known.support)))
    alarms.save(target / ALARMS, half_precise)
    _copy(data, target, WHOLE)


def _known_as(name: str) -> str:
    """A net's name in settings: pemd, for all members, or vtm."""
    return name.split("/")[1]


def _in_half(values: np.ndarray) -> np.ndarray:
    """The values in 16 bits, or as they are if one is too large for that."""
    found = values.astype(np.float16)
    return found if np.isfinite(found).all() else values


def unpack(folder: Path, target: Path, members: Sequence[int]) -> None:
    """Unpack the files that `pack` makes into a folder, as the stages leave it under data/.

    Raises InputError for a file that is missing, truncated or something else.
    """
    for name, kind in nets(members):
        path, config = folder / name / WEIGHTS, store.configuration(folder / name, kind)
        try:
            params = packing.unpacked(packing.read(path))
        except (KeyError, ValueError) as error:
            raise InputError(f"{path}: expected a net's packed weights, found others ({error})") from error
        about = store.description(folder / name)
        about = {key: value for key, value in about.items() if key not in ("kind", "net")}
        store.save(target / name, Net(config, params), pd.DataFrame(), about)
        store.load(target / name, kind)
    _copy(folder, target, (ALARMS, *WHOLE))


def _copy(source: Path, target: Path, names: Sequence[str]) -> None:
    for name in names:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)


def check_size(folder: Path, *, megabytes: float) -> None:
    """Check that the files in a folder are not too large for a repository. Raises InputError."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6
    if size > megabytes:
        raise InputError(
            f"prebuild: packed nets take {size:.1f} MB, expected at most {megabytes:g} (prebuild.megabytes)"
        )


def user_folder() -> Path:
    """Where commands keep unpacked nets: in the user's cache, or if that can't be written, in a folder for this run."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clothkit/prebuilt"
    return writable(home, "unpacked nets") or Path(tempfile.mkdtemp(prefix="clothkit-prebuilt-"))


def unpacked(folder: Path, *, keep: Path) -> Path:
    """The folder under `keep` into which prebuilt nets are unpacked, which is done if it was not before.

    Raises InputError for a file that is missing, truncated or not what the manifest names.
    """
    manifest, target = manifests.read(folder), keep / manifests.digest(folder / manifests.MANIFEST)[:16]
    manifests.check_files(folder, manifest)
    if target.is_dir():
        return target
    part = Path(tempfile.mkdtemp(prefix=".part", dir=keep))
    try:
        unpack(folder, part / "data", manifest.members)
        try:
            os.rename(part / "data", target)
        except OSError:
            # Another call has unpacked them meanwhile.
            if not target.is_dir():
                raise
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return target
