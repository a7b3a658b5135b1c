"""How settings are declared: frozen dataclasses, checked when they are built, hashable so that jit can take them."""

from typing import TypeVar, dataclass_transform

import pydantic
from pydantic.dataclasses import dataclass

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def config(cls: type[T]) -> type[T]:
    """The class as a frozen, keyword-only dataclass that refuses unknown keys, wrong types and impossible values."""
    settings = pydantic.ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    return dataclass(cls, frozen=True, kw_only=True, config=settings)  # type: ignore[return-value]
