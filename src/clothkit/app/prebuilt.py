"""Which nets a command uses: trained ones, or where there are none, those that come with the repository."""

from pathlib import Path

import click

from clothkit.app.inputs import Settings, load_settings
from clothkit.prebuilt.files import unpacked, user_folder
from clothkit.prebuilt.manifest import MANIFEST
from clothkit.prebuilt.manifest import read as read_manifest

DATA, PREBUILT = Path("data"), Path("prebuilt")
FIRST = "household"
"""The scale whose prebuilt nets are taken if there are several: it has cloths as people have them."""


def load_nets(data: Path) -> tuple[Path, Settings]:
    """Return the folder that a command takes its nets from, and its settings.

    The folder is `data`, unless that is the default and holds no trained nets: then it is where prebuilt nets, if there
    are any, are unpacked, which a notice on stderr says, and the settings are those of their scale and ensemble. Raises
    InputError if a file is invalid.
    """
    found = None if data != DATA or _has_nets(data) else prebuilt(PREBUILT)
    if found is None:
        return data, load_settings(data)
    manifest = read_manifest(found)
    folder = unpacked(found, keep=user_folder())
    click.echo(f"notice: no trained nets in {data}/nets: those of {found} are used", err=True)
    return folder, load_settings(folder, scale=manifest.scale)._replace(members=manifest.members)


def _has_nets(data: Path) -> bool:
    return any((data / "nets" / name).exists() for name in ("pemd", "emd_voxel", "vtm"))


def prebuilt(root: Path) -> Path | None:
    """Return the folder of prebuilt nets under `root`; None if there are none."""
    scales = sorted(path.parent for path in root.glob(f"*/{MANIFEST}"))
    return next((folder for folder in scales if folder.name == FIRST), scales[0] if scales else None)
