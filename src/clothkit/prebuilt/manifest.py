"""The manifest of prebuilt nets: what they come from, what each file must be, and what packing costs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from annotated_types import Ge, MinLen

from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.json_file import read_json

MANIFEST = "manifest.json"
Digest = Annotated[str, pydantic.StringConstraints(pattern="^[0-9a-f]{64}$")]


class Part(pydantic.BaseModel):
    """A part of the manifest: nothing may be missing, nothing unknown."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


class File(Part):
    """What a file must be."""

    bytes: Annotated[int, Ge(0)]
    sha256: Digest


class Deviation(Part):
    """A mean error with full and with packed nets [cloth length], over the same examples of the validation split."""

    full: float
    packed: float
    standard_error: float | None
    """Of packed - full, over the examples; null: there is one."""
    count: int


class Manifest(Part):
    """What lies beside it."""

    format: Literal["clothkit prebuilt nets"] = "clothkit prebuilt nets"
    version: Literal[1] = 1
    scale: str
    """The scale of params.yaml that the nets were trained at, and whose settings they are used with."""
    members: Annotated[tuple[int, ...], MinLen(1)]
    """The members of the ensemble."""
    files: dict[str, File]
    """By path, from the manifest's folder."""
    sources: dict[str, Digest]
    """SHA-256 of what the files were made from, by path; of folders, see `digest`."""
    params: Digest
    """SHA-256 of the params that the sources were made with, as JSON with sorted keys."""
    deviations: dict[str, Deviation]
    """What packing costs, by measure (`deviation.MEASURES`)."""


def digest(path: Path) -> str:
    """SHA-256 of a file; of a folder, that of its files' names and digests, in order."""
    total = hashlib.sha256()
    if path.is_file():
        with path.open("rb") as file:
            while block := file.read(1 << 20):
                total.update(block)
        return total.hexdigest()
    for one in sorted(inside for inside in path.rglob("*") if inside.is_file()):
        total.update(f"{one.relative_to(path).as_posix()} {digest(one)}\n".encode())
    return total.hexdigest()


def files_in(folder: Path) -> dict[str, File]:
    """What the files in a folder are, but for the manifest."""
    found = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    return {
        name: File(bytes=path.stat().st_size, sha256=digest(path)) for name, path in found.items() if name != MANIFEST
    }


def manifest_of(
    folder: Path,
    *,
    scale: str,
    members: Sequence[int],
    sources: Mapping[str, Path],
    params: Any,
    deviations: Mapping[str, Deviation],
) -> Manifest:
    """The manifest of the files in a folder, which were made from `sources` (by name) and these params (JSON types)."""
    return Manifest(
        scale=scale,
        members=tuple(members),
        files=files_in(folder),
        sources={name: digest(path) for name, path in sources.items()},
        params=hashlib.sha256(json.dumps(params, sort_keys=True).encode()).hexdigest(),
        deviations=dict(deviations),
    )


def write(folder: Path, manifest: Manifest) -> None:
    """Write the manifest into its folder. Equal manifests give equal bytes."""
    (folder / MANIFEST).write_text(json.dumps(manifest.model_dump(mode="json"), indent=1, sort_keys=True) + "\n")


def read(folder: Path) -> Manifest:
    """Read a folder's manifest. Raises InputError if it is missing or damaged."""
    path = folder / MANIFEST
    content = read_json(path, expected="the manifest of prebuilt nets")
    try:
        return Manifest.model_validate_json(json.dumps(content), strict=True)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {place}: {first['msg'][0].lower()}{first['msg'][1:]}") from error


def check_files(folder: Path, manifest: Manifest) -> None:
    """Check that a folder's files are those that its manifest names. Raises InputError for the first that isn't."""
    for name, expected in manifest.files.items():
        path = folder / name
        try:
            size = path.stat().st_size
        except OSError as error:
            raise system_error(error, path, expected=f"a file that {folder / MANIFEST} names") from error
        if size != expected.bytes:
            raise InputError(
                f"{path}: expected {expected.bytes} bytes, as {MANIFEST} says, found {size}; git checkout {folder} "
                "restores it"
            )
        if digest(path) != expected.sha256:
            raise InputError(
                f"{path}: is not the file that {MANIFEST} names (its SHA-256 is another); git checkout {folder} "
                "restores it"
            )
