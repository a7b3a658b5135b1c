"""How a net is stored: a folder with its weights, what it was made with, and what its training went through."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from flax import serialization
from flax.traverse_util import flatten_dict
from pydantic import ValidationError

from clothkit.errors import InputError
from clothkit.networks import emd_voxel, pemd, vtm
from clothkit.networks.net import Net
from clothkit.networks.settings import EMDVoxelConfig, PEMDConfig, VtMConfig

WEIGHTS, ATTRIBUTES, HISTORY = "net.msgpack", "net.json", "history.parquet"
KINDS = {"pemd": PEMDConfig, "emd_voxel": EMDVoxelConfig, "vtm": VtMConfig}


def save(folder: Path, net: Net, history: pd.DataFrame, attributes: Mapping[str, Any]) -> None:
    """Writes a net's three files. The same net gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    kind = next(name for name, config in KINDS.items() if isinstance(net.config, config))
    weights = jax.tree.map(np.asarray, net.params)
    (folder / WEIGHTS).write_bytes(serialization.msgpack_serialize(weights))
    described = {"kind": kind, "net": asdict(net.config), **attributes}
    (folder / ATTRIBUTES).write_text(json.dumps(described, indent=1, sort_keys=True) + "\n")
    history.to_parquet(folder / HISTORY, index=False)


def load(folder: Path) -> Net:
    """The net that a folder holds. Raises InputError for a file that is missing, truncated or of another net."""
    try:
        described = json.loads((folder / ATTRIBUTES).read_text())
        widths = {name: tuple(v) if isinstance(v, list) else v for name, v in described["net"].items()}
        config = KINDS[described["kind"]](**widths)
    except OSError as error:
        raise InputError(f"{folder / ATTRIBUTES}: expected a net's description, found no such file") from error
    except (ValueError, KeyError, AttributeError, TypeError, ValidationError) as error:
        raise InputError(f"{folder / ATTRIBUTES}: expected a net's kind and widths, found something else") from error
    try:
        params = serialization.msgpack_restore((folder / WEIGHTS).read_bytes())
        found = {name: np.asarray(weight).shape for name, weight in flatten_dict(params, sep="/").items()}
    except OSError as error:
        raise InputError(f"{folder / WEIGHTS}: expected a net's weights, found no such file") from error
    except Exception as error:  # msgpack has a dozen ways to say that bytes are missing
        raise InputError(f"{folder / WEIGHTS}: expected a net's weights, found a truncated or damaged file") from error
    expected = {name: weight.shape for name, weight in flatten_dict(shapes(config), sep="/").items()}
    for name in sorted(expected.keys() | found.keys()):
        if expected.get(name) != found.get(name):
            raise InputError(
                f"{folder / WEIGHTS}, weight {name}: expected shape {expected.get(name)}, found {found.get(name)}"
            )
    if not all(np.isfinite(weight).all() for weight in jax.tree.leaves(params)):
        raise InputError(f"{folder / WEIGHTS}: expected finite weights, found NaN or infinity")
    return Net(config, jax.tree.map(jnp.asarray, params))


def shapes(config: PEMDConfig | EMDVoxelConfig | VtMConfig) -> Any:
    """The shapes that a net's weights have, nested like the weights themselves."""
    key = jax.random.key(0)
    if isinstance(config, PEMDConfig):
        return jax.eval_shape(lambda: pemd.initial(config, key=key))
    if isinstance(config, EMDVoxelConfig):
        return jax.eval_shape(lambda: emd_voxel.initial(config, key=key))
    return jax.eval_shape(lambda: vtm.initial(config, key=key))
