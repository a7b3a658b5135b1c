"""Which nets a command uses: trained ones, or where there are none, those that come with the repository."""

from pathlib import Path

import click

from clothkit.app.inputs import Settings, load_settings, settings_of_params
from clothkit.models import store
from clothkit.planning.planner import artifacts
from clothkit.planning.systems import SYSTEMS
from clothkit.prebuilt.files import VTM, unpacked, user_folder
from clothkit.prebuilt.manifest import MANIFEST
from clothkit.prebuilt.manifest import read as read_manifest

DATA, PREBUILT = Path("data"), Path("prebuilt")
FIRST = "household"
"""The scale whose prebuilt nets are taken if there are several: it has cloths as people have them."""


def load_nets(data: Path) -> tuple[Path, Settings]:
    """Return the folder that a command takes its nets from, and its settings.

    The folder is `data`, unless that holds prebuilt nets, or is the default and holds no trained ones: then it is where
    prebuilt nets are unpacked, if there are any, and the settings are those of their scale and ensemble. Notices on
    stderr say when prebuilt nets are taken that were not asked for, and when there are some for more cloths than the
    trained ones know. Raises InputError if a file is invalid.
    """
    found = data if (data / MANIFEST).exists() else None
    missing: list[str] = []
    if found is None and data == DATA:
        missing = _missing(data)
        if missing:
            found = prebuilt(PREBUILT)
        else:
            _tell_of_others(data)
    if found is None:
        return data, load_settings(data)
    manifest = read_manifest(found)
    folder = unpacked(found, keep=user_folder())
    if found != data:
        lacking = f"no trained nets in {data}/nets"
        if _has_some(data):
            lacking = f"the nets in {data} lack {', '.join(missing)}"
        click.echo(f"notice: {lacking}: those of {found} are used", err=True)
    return folder, load_settings(folder, scale=manifest.scale)._replace(members=manifest.members)


def _missing(data: Path) -> list[str]:
    """What system main plans with and a chain that was interrupted does not have yet, as paths under `data`."""
    settings = settings_of_params()
    needed = artifacts(SYSTEMS["main"], data, settings.members, settings.plan.uncertainty.measure)
    return [path.relative_to(data).as_posix() for path in needed.values() if not path.exists()]


def _has_some(data: Path) -> bool:
    return any((data / "nets" / name).exists() for name in ("pemd", "vtm"))


def _tell_of_others(data: Path) -> None:
    scale = store.description(data / VTM).get("scale")
    if scale not in (None, FIRST) and (PREBUILT / FIRST / MANIFEST).exists():
        click.echo(
            f"notice: the nets in {data}/nets are used, of scale {scale}; --data {PREBUILT / FIRST} takes prebuilt "
            "ones, which know cloths of many sides and thicknesses",
            err=True,
        )


def prebuilt(root: Path) -> Path | None:
    """Return the folder of prebuilt nets under `root`; None if there are none."""
    scales = sorted(path.parent for path in root.glob(f"*/{MANIFEST}"))
    return next((folder for folder in scales if folder.name == FIRST), scales[0] if scales else None)
