"""The decorator of settings classes: frozen dataclasses, validated when built, hashable as static arguments of jit."""

from typing import TypeVar, dataclass_transform

import pydantic
from pydantic.dataclasses import dataclass

T = TypeVar("T")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def config(cls: type[T]) -> type[T]:
    """Make a class a frozen, keyword-only dataclass that refuses unknown keys, wrong types and values out of range."""
    settings = pydantic.ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    return dataclass(cls, frozen=True, kw_only=True, config=settings)  # type: ignore[return-value]
