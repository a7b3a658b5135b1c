"""Checks that the arrays of recorded sessions hold possible values and are consistent with one another."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from clothkit.cloth.topology import SQUARE
from clothkit.dataset.store import SPLITS, STATES, STEPS
from clothkit.runtime.errors import InputError

KEYS = ("split", "sequence", "start", "length")


def check_keys(path: Path, arrays: Mapping[str, np.ndarray], attributes: Mapping[str, Any]) -> list[str]:
    """The list of split names, from the attribute `splits`; the array `split` holds indices into it.

    Raises InputError unless the KEYS of each row name a valid task and all rows name different tasks.
    """
    splits = attributes.get("splits")
    if not isinstance(splits, list) or not set(map(str, splits)) <= set(SPLITS):
        raise InputError(f"{path}: attribute splits: expected names of {', '.join(SPLITS)}, found {splits}")
    start, length = (arrays[name].astype(int) for name in ("start", "length"))
    for name, least, most in (
        ("split", 0, len(splits) - 1),
        ("sequence", 0, np.iinfo(np.int64).max),
        ("start", 0, STEPS - 1),
        ("length", 1, STEPS),
    ):
        _refuse(path, name, (arrays[name] < least) | (arrays[name] > most), f"expected {least} to {most}")
    _refuse(path, "length", start + length > STEPS, f"expected sessions that end at state {STEPS} or before")
    keys = np.stack([arrays[name].astype(np.int64) for name in KEYS], axis=1)
    if len(keys):
        _, first = np.unique(keys, axis=0, return_index=True)
        again = np.ones(len(keys), bool)
        again[first] = False
        _refuse(path, "sequence", again, "expected each task once, by split, sequence, start and length")
    return splits


def check_members(path: Path, attributes: Mapping[str, Any], nets: int) -> tuple[int, ...]:
    """The attribute `members`, which names the member of each net; 0, 1, .. if there is none.

    Raises InputError unless it is a list of as many different whole numbers as there are nets.
    """
    members = attributes.get("members", list(range(nets)))
    whole = isinstance(members, list) and all(type(member) is int and member >= 0 for member in members)
    if not whole or len(members) != nets or len(set(members)) != nets:
        raise InputError(f"{path}: attribute members: expected a number for each of {nets} nets, found {members}")
    return tuple(members)


def terms_of_nets(path: Path, terms: Float[np.ndarray, "task step found"], nets: int) -> np.ndarray:
    """The terms of the loss [task step nets + 1]: the accuracy term of each net, then u.

    Stores of a single net had a column of NaN for a second one. Raises InputError for another number of terms.
    """
    if nets == 1 and terms.shape[-1] == 3 and np.isnan(terms[..., 1]).all():
        return np.delete(terms, 1, axis=-1)
    if terms.shape[-1] != nets + 1:
        raise InputError(f"{path}: terms: expected {nets + 1}, one of each net and u, found {terms.shape[-1]}")
    return terms


def check_values(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Raises InputError unless each session has valid values up to its length and only fill values after it."""
    length = arrays["length"][:, None]
    reached, acted = np.arange(STATES) <= length, np.arange(STEPS) < length
    left = np.arange(STEPS) < (length - np.arange(STEPS))[..., None]
    _refuse(path, "goal", ~_finite(arrays["goal"], 1), "expected finite values")
    for name, present in (
        *(("state", reached), ("centre", reached)),
        *(("estimate", acted), ("loss", acted), ("plan", left & acted[..., None])),
    ):
        values = arrays[name]
        wrong = np.where(present, ~_finite(values, present.ndim), ~_missing(values, present.ndim))
        _refuse(path, name, wrong, "expected finite values up to the session's end, NaN past it")
    for name in ("common", "relative"):
        labels = arrays[name]
        wrong = np.where(acted, (labels < -1) | (labels >= SQUARE.count), labels != -1)
        _refuse(path, name, wrong, f"expected labels 0 to {SQUARE.count - 1} up to the session's end, -1 past it")
    null, cancelled = arrays["null"], arrays["cancelled"]
    _refuse(path, "null", null & ~acted, "expected none past the session's end")
    _refuse(path, "null", cancelled & ~null, "expected every cancelled manipulation to be one that was not executed")
    tried = np.isfinite(arrays["error_otherwise"])
    _refuse(path, "cancelled", cancelled != tried, "expected those of which error_otherwise is known")


def _finite(values: np.ndarray, dimensions: int) -> Bool[np.ndarray, "..."]:
    return np.asarray(np.isfinite(values).reshape(*values.shape[:dimensions], -1).all(-1))


def _missing(values: np.ndarray, dimensions: int) -> Bool[np.ndarray, "..."]:
    return np.asarray(np.isnan(values).reshape(*values.shape[:dimensions], -1).all(-1))


def _refuse(path: Path, name: str, wrong: np.ndarray, expected: str) -> None:
    if wrong.any():
        place, *rest = np.argwhere(wrong)[0].tolist()
        step = f", step {rest[0]}" if rest else ""
        raise InputError(f"{path}: {name} of session {place}{step}: {expected}")
