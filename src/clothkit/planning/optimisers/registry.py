"""Optimisers by name: how params.yaml and the command line choose one, and how another one is added."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import pydantic
from jaxtyping import PRNGKeyArray

from clothkit.planning.optimisers.space import Evaluate, Initial, Outcome, Result, Settings, Space, choose
from clothkit.runtime.errors import InputError

DEFAULT = "gradient"
"""The optimiser of settings that name none."""


@dataclass(frozen=True)
class Optimiser:
    """A way to search for plans."""

    name: str
    settings: type
    """The class of its settings (see `runtime.config`), with what `space.Settings` asks for; all have defaults."""
    search: Callable[..., Outcome]
    """evaluate, space, settings, initial, key -> Outcome"""


OPTIMISERS: dict[str, Optimiser] = {}
"""The optimisers that there are, by name."""


def register(name: str, settings: type, search: Callable[..., Outcome]) -> Optimiser:
    """Add an optimiser, so that settings may name it. Raises ValueError if the name or the class is in use."""
    if name in OPTIMISERS or any(settings is other.settings for other in OPTIMISERS.values()):
        raise ValueError(f"optimiser {name}: its name and its class of settings must be its own")
    OPTIMISERS[name] = Optimiser(name, settings, search)
    return OPTIMISERS[name]


def optimiser(name: str) -> Optimiser:
    """The optimiser of that name. Raises InputError if there is none."""
    if name not in OPTIMISERS:
        raise InputError(f"optimiser: expected one of {', '.join(OPTIMISERS)}, found {name!r}")
    return OPTIMISERS[name]


def optimiser_of(settings: Settings) -> Optimiser:
    """The optimiser that such settings are for. Raises InputError if there is none."""
    for each in OPTIMISERS.values():
        if type(settings) is each.settings:
            return each
    raise InputError(f"optimiser: none is registered whose settings are of the class {type(settings).__name__}")


def optimise(
    evaluate: Evaluate, space: Space, settings: Settings, *, initial: Initial | None = None, key: PRNGKeyArray
) -> Result:
    """Search for a plan with the optimiser that the settings are for."""
    return choose(evaluate, optimiser_of(settings).search(evaluate, space, settings, initial=initial, key=key))


def evaluations(settings: Settings, length: int) -> int:
    """Number of plans of this length that `optimise` evaluates, including the finalists' exact evaluations."""
    return settings.evaluations(length) + settings.finalists


def _validated(value: Any) -> Any:
    """Settings from a mapping with the optimiser's name under `name`, or settings as they are."""
    if any(type(value) is each.settings for each in OPTIMISERS.values()):
        return value
    if not isinstance(value, Mapping):
        raise ValueError("expected the settings of an optimiser")
    rest = dict(value)
    chosen = optimiser(str(rest.pop("name", DEFAULT)))
    # As JSON, in which a list may stand for a tuple; phases may be settings already.
    return pydantic.TypeAdapter(chosen.settings).validate_json(json.dumps(rest, default=_serialised))


def _serialised(settings: Any) -> dict[str, Any]:
    chosen = optimiser_of(settings)
    return {"name": chosen.name, **pydantic.TypeAdapter(chosen.settings).dump_python(settings, mode="json")}


AnySettings = Annotated[
    Settings,
    pydantic.PlainValidator(_validated),
    pydantic.PlainSerializer(_serialised, return_type=dict[str, Any]),
]
"""The type of a field that holds the settings of any registered optimiser.

In params.yaml they are the keys of a mapping, beside `name`, the optimiser, which is `gradient` if left out.
"""
