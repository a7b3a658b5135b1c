"""Which nets a command uses: trained ones, or where there are none, those that come with the repository."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from clothkit.app.inputs import Settings, load_settings
from clothkit.app.options import observation_options
from clothkit.models import store
from clothkit.prebuilt.files import VTM, unpacked, user_folder
from clothkit.prebuilt.manifest import MANIFEST
from clothkit.prebuilt.manifest import read as read_manifest

DATA, PREBUILT = Path("data"), Path("prebuilt")
FIRST = "household"
"""The scale whose prebuilt nets are taken if there are several: it has cloths as people have them."""


def load_nets(data: Path, told: Mapping[str, Any] | None = None) -> tuple[Path, Settings]:
    """Return the folder that a command takes its nets from, and its settings.

    The folder is `data`, unless that holds prebuilt nets, or is the default and holds no trained ones: then it is where
    prebuilt nets are unpacked, if there are any, and the settings are those of their scale and ensemble. `told` are
    values of the options side, sides and thickness: if the trained nets in the default do not know that cloth, and
    prebuilt ones do, these are taken, too. Notices on stderr say when prebuilt nets are taken that were not asked for,
    and when there are some for more cloths than the trained ones know. Raises InputError if a file or a value is
    invalid.
    """
    found = data if (data / MANIFEST).exists() else None
    if found is None and data == DATA:
        if _has_nets(data):
            known = None if told is None else _knowing(data, told)
            if known is not None:
                return known
            _tell_of_others(data)
        else:
            found = prebuilt(PREBUILT)
    if found is None:
        return data, load_settings(data)
    made = _unpacked(found)
    if found != data:
        click.echo(f"notice: no trained nets in {data}/nets: those of {found} are used", err=True)
    return made


def _unpacked(prebuilt: Path) -> tuple[Path, Settings]:
    """Where prebuilt nets are unpacked, and the settings of their scale and ensemble."""
    manifest = read_manifest(prebuilt)
    folder = unpacked(prebuilt, keep=user_folder())
    return folder, load_settings(folder, scale=manifest.scale)._replace(members=manifest.members)


def _knowing(data: Path, told: Mapping[str, Any]) -> tuple[Path, Settings] | None:
    """The prebuilt nets of FIRST, if they know the cloth that is told and those in `data` do not; else None."""
    if not (PREBUILT / FIRST / MANIFEST).exists():
        return None
    own = load_settings(data)
    cloth: dict[str, Any] = {name: told.get(name) for name in ("side", "sides", "thickness")}
    options = observation_options(own.app, **cloth)
    if own.alarms is None or own.alarms.knows(options.cloth):
        return None
    folder, settings = _unpacked(PREBUILT / FIRST)
    if settings.alarms is None or not settings.alarms.knows(options.cloth):
        return None
    longer, shorter = options.sides
    click.echo(
        f"notice: the nets in {data}/nets know no cloth of {longer:g} x {shorter:g} m that is "
        f"{1000 * options.thickness:g} mm thick: those of {PREBUILT / FIRST} are used",
        err=True,
    )
    return folder, settings


def _has_nets(data: Path) -> bool:
    """Whether there are all nets of system main, which an interrupted chain does not have yet."""
    return all((data / "nets" / name).exists() for name in ("pemd", "vtm"))


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
