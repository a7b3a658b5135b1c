"""Storage of a net: a folder with its weights, its configuration and params, and its training history."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pydantic
from flax import serialization
from flax.traverse_util import flatten_dict

from clothkit.models import emd_voxel, pemd, vtm
from clothkit.models.net import Net
from clothkit.models.settings import EMDVoxelConfig, PEMDConfig, VtMConfig
from clothkit.runtime.errors import InputError, system_error
from clothkit.runtime.json_file import read_json

WEIGHTS, ATTRIBUTES, HISTORY = "net.msgpack", "net.json", "history.parquet"
Kind = Literal["pemd", "emd_voxel", "vtm"]
KINDS = {"pemd": PEMDConfig, "emd_voxel": EMDVoxelConfig, "vtm": VtMConfig}
LARGEST = 1e6
"""Largest accepted absolute weight. Trained weights are of the order of 1, so a larger one indicates damage."""


def save(folder: Path, net: Net, history: pd.DataFrame, attributes: Mapping[str, Any]) -> None:
    """Write a net's three files. Equal nets give equal bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    kind = next(name for name, config in KINDS.items() if isinstance(net.config, config))
    weights = jax.tree.map(np.asarray, net.params)
    (folder / WEIGHTS).write_bytes(serialization.msgpack_serialize(weights))
    described = {"kind": kind, "net": asdict(net.config), **attributes}
    (folder / ATTRIBUTES).write_text(json.dumps(described, indent=1, sort_keys=True) + "\n")
    history.to_parquet(folder / HISTORY, index=False)


def load(folder: Path, kind: Kind | None = None) -> Net:
    """Read the net in a folder.

    Raises InputError for a file that is missing or damaged, for a net of another kind than `kind`, and for weights with
    unexpected names, shapes or types, or with values that are not finite or above LARGEST.
    """
    config = configuration(folder, kind)
    try:
        expected = {name: weight.shape for name, weight in flatten_dict(shapes(config), sep="/").items()}
    except (ValueError, TypeError, OverflowError) as error:
        raise InputError(f"{folder / ATTRIBUTES}: expected a net's kind and widths, found something else") from error
    path = folder / WEIGHTS
    try:
        params = serialization.msgpack_restore(path.read_bytes())
        found = {name: np.asarray(weight) for name, weight in flatten_dict(params, sep="/").items()}
    except OSError as error:
        raise system_error(error, path, expected="a net's weights") from error
    except Exception as error:  # msgpack raises many types of exceptions for damaged data
        raise InputError(f"{path}: expected a net's weights, found a truncated or damaged file") from error
    for name in sorted(expected.keys() | found.keys()):
        weight = found.get(name)
        if weight is None or expected.get(name) != weight.shape:
            shape = None if weight is None else weight.shape
            raise InputError(f"{path}, weight {name}: expected shape {expected.get(name)}, found {shape}")
        if weight.dtype != np.float32:
            raise InputError(f"{path}, weight {name}: expected float32, found {weight.dtype}")
        if not np.isfinite(weight).all():
            raise InputError(f"{path}, weight {name}: expected finite weights, found NaN or infinity")
        if np.abs(weight).max(initial=0) > LARGEST:
            largest = float(np.abs(weight).max())
            raise InputError(f"{path}, weight {name}: expected weights up to {LARGEST:g}, found {largest:g}")
    return Net(config, jax.tree.map(jnp.asarray, params))


def configuration(folder: Path, kind: Kind | None = None) -> Any:
    """Read a net's configuration. Raises InputError if it is damaged, or for a net of another kind than `kind`."""
    about = description(folder)
    try:
        found, widths = about["kind"], dict(about["net"])
        if "height" in widths:  # as nets of older versions call it
            widths["viewport"] = {"height": widths.pop("height")}
        config: Any = pydantic.TypeAdapter(KINDS[found]).validate_json(json.dumps(widths), strict=True)
    except (ValueError, KeyError, AttributeError, TypeError, OverflowError) as error:
        raise InputError(f"{folder / ATTRIBUTES}: expected a net's kind and widths, found something else") from error
    if kind is not None and found != kind:
        raise InputError(f"{folder / ATTRIBUTES}: kind: expected {kind!r}, found {found!r}, a net for other inputs")
    return config


def description(folder: Path) -> dict[str, Any]:
    """What a net's folder says of the net: its kind, its widths and what it was made with. Raises InputError."""
    return read_json(folder / ATTRIBUTES, expected="a net's description")


def validation_score(folder: Path) -> float:
    """Read the validation score of the net in a folder. Raises InputError if its description has no finite score."""
    score = description(folder).get("validation_score")
    if not isinstance(score, float) or not math.isfinite(score):
        found = json.dumps(score)[:60]
        raise InputError(f"{folder / ATTRIBUTES}: validation_score: expected a finite number, found {found}")
    return score


def shapes(config: PEMDConfig | EMDVoxelConfig | VtMConfig) -> Any:
    """The shapes of the weights of a net with this configuration, in the pytree structure of the weights."""
    key = jax.random.key(0)
    if isinstance(config, PEMDConfig):
        return jax.eval_shape(lambda: pemd.initial(config, key=key))
    if isinstance(config, EMDVoxelConfig):
        return jax.eval_shape(lambda: emd_voxel.initial(config, key=key))
    return jax.eval_shape(lambda: vtm.initial(config, key=key))
