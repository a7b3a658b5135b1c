"""Plan how a two-handed robot folds a cloth into any given shape (Arnold, Tanaka and Yamazaki, 2023)."""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from clothkit.app.agent import Agent, ObservedCloth
    from clothkit.app.plan_file import Plan
    from clothkit.planning.reach import Ball, Box, Limits
    from clothkit.runtime.errors import InputError

__all__ = ["Agent", "Ball", "Box", "InputError", "Limits", "ObservedCloth", "Plan"]

_MODULES = {
    "Agent": "clothkit.app.agent",
    "Ball": "clothkit.planning.reach",
    "Box": "clothkit.planning.reach",
    "InputError": "clothkit.runtime.errors",
    "Limits": "clothkit.planning.reach",
    "ObservedCloth": "clothkit.app.agent",
    "Plan": "clothkit.app.plan_file",
}


def __getattr__(name: str) -> Any:
    """What is exported is imported when it is asked for: `import clothkit` alone takes no time."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
