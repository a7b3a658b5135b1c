"""Optional libraries, imported when they are used."""

import importlib
from typing import Any

from clothkit.runtime.errors import InputError


def optional(module: str, extra: str) -> Any:
    """Return a module of an optional library. Raises InputError that tells which extra of clothkit it comes with."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.split(".")[0]
        raise InputError(f"{library}: is not installed, pip install 'clothkit[{extra}]' installs it") from error
