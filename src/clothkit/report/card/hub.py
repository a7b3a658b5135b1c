"""A dataset as a repository of the Hugging Face Hub: parquet files, the card with the Hub's header, a description.

The repository's configurations are what `datasets.load_dataset(folder, name)` takes. Meshes of a store are one, with
the store's splits; the raw artifacts are one per kind of file, and lie at `data/raw`, where the card looks for them.

Source: the Hub's documentation of dataset cards and of repositories with parquet files.
"""

import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from clothkit.dataset import store
from clothkit.dataset.export import chosen_sequences, is_raw
from clothkit.dataset.raw import read_states, state_files
from clothkit.dataset.store import SPLITS, Dataset
from clothkit.report.card.build import build
from clothkit.report.card.inputs import PARTS
from clothkit.report.card.settings import CardConfig
from clothkit.simulation.settings import STARTS

ROWS_PER_FILE = 500
"""Sequences in one file of meshes, of some tens of megabytes."""

RAW = "data/raw"
_OF_SEQUENCES = ("states", "manipulations.parquet", "cloths.parquet")
"""Raw artifacts whose rows belong to sequences; the others are kept whole."""

_UNITS = {
    "vertices": ("[state, u, v, xyz]", "normalised", "meshes, each centred by its silhouette"),
    "centre": ("[state, xy]", "normalised", "where the centre lay on the table"),
    "manipulation": ("[step, component]", store.MANIPULATION_UNITS, "u1 v1 u2 v2 dx dy; one hand: its point twice"),
    "hands": ("[step]", "", "1 or 2"),
    "length": ("", "", "number of manipulations, 1 to 3; what lies past it is NaN"),
    "evaluated": ("", "", "whether clothkit's evaluations use the sequence"),
    "cloth": ("[measure]", "normalised", "sides along u and v, thickness"),
    "start": ("", "", "how the cloth came to lie as it did at first"),
    "material": ("[property]", ", ".join(store.PROPERTY_UNITS), ", ".join(store.LABELS["property"])),
}


class Configuration(NamedTuple):
    """One table of the repository."""

    name: str
    files: dict[str, str]
    """Pattern of its files by split."""


def write_hub(folder: Path, source: Path, sequences: Sequence[int] | None) -> None:
    """Write the repository into an empty folder; equal artifacts give equal bytes.

    `source` is a folder of raw artifacts, or a store of meshes; with a store of all sequences, the raw artifacts beside
    it come along. Raises InputError if the source or a sequence isn't there.
    """
    parts, text, count = list[Configuration](), "", 0
    raw: Path | None = source
    if not is_raw(source):
        raw = source.parent / "raw" if sequences is None and (source.parent / "raw/states").is_dir() else None
        split, _ = store.load_splits(source)
        chosen = np.array(chosen_sequences(source, sequences, list(range(len(split)))))
        parts.append(_write_meshes(folder, source, [chosen[split[chosen] == code] for code in range(len(SPLITS))]))
        text, count = _about_meshes(parts[0]), len(chosen)
    if raw is not None:
        count = max(count, _copy_raw(raw, folder / RAW, sequences if is_raw(source) else None))
        build(folder, folder / RAW, CardConfig(), located=RAW)
        parts += [_of_raw(part) for part in PARTS]
    readme = folder / "README.md"
    card = readme.read_text() if readme.exists() else ""
    readme.write_text("\n".join(part for part in (_header(parts, count), text, card) if part))


def _write_meshes(folder: Path, source: Path, of_splits: Sequence[np.ndarray]) -> Configuration:
    """Write the sequences of each split of a store of meshes, a file of them in memory at a time."""
    files = {}
    for split, own in zip(SPLITS, of_splits, strict=True):
        shards = [own[k : k + ROWS_PER_FILE] for k in range(0, len(own), ROWS_PER_FILE)]
        for number, shard in enumerate(shards):
            path = folder / f"data/meshes/{split}-{number:05d}-of-{len(shards):05d}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            dataset = store.join(store.Parts(len(shard), store.load_parts(source, shard)))
            pq.write_table(_meshes(dataset, shard), path, row_group_size=50)
        if shards:
            files[split] = f"data/meshes/{split}-*.parquet"
    return Configuration("meshes", files)


def _meshes(dataset: Dataset, sequence: np.ndarray) -> pa.Table:
    """A row per sequence, with the arrays of the store as nested lists of fixed lengths."""
    columns = {"sequence": pa.array(sequence, pa.int32())}
    for name in _UNITS:
        values = getattr(dataset, name)
        columns[name] = pa.array([STARTS[code] for code in values]) if name == "start" else _nested(values)
    return pa.table(columns)


def _nested(values: np.ndarray) -> pa.Array:
    array = pa.array(values.ravel())
    for length in reversed(values.shape[1:]):
        array = pa.FixedSizeListArray.from_arrays(array, length)
    return array


def _copy_raw(raw: Path, target: Path, sequences: Sequence[int] | None) -> int:
    """Copy the raw artifacts, or the rows of some sequences; returns the number of sequences."""
    numbers = read_states(raw / "states", ("sequence", "state"))["sequence"].unique().tolist()
    chosen = chosen_sequences(raw, sequences, numbers)
    for part in PARTS:
        for path in state_files(raw / part) if part == "states" else [raw / part]:
            copy = target / path.relative_to(raw)
            copy.parent.mkdir(parents=True, exist_ok=True)
            if sequences is None or part not in _OF_SEQUENCES:
                shutil.copyfile(path, copy)
                continue
            rows = pq.read_table(path, filters=[("sequence", "in", chosen)])
            if len(rows):
                pq.write_table(rows, copy)
    return len(chosen)


def _of_raw(part: str) -> Configuration:
    pattern = f"{RAW}/states/*.parquet" if part == "states" else f"{RAW}/{part}"
    return Configuration(part.removesuffix(".parquet"), {"train": pattern})


def _header(parts: Sequence[Configuration], count: int) -> str:
    """The Hub's YAML at the top of a card."""
    return "\n".join(["---", *_header_lines(parts, count), "---\n"])


def _header_lines(parts: Sequence[Configuration], count: int) -> Iterator[str]:
    yield "license: apache-2.0"
    yield "pretty_name: Folded cloths"
    yield "task_categories:\n- robotics"
    yield "tags:\n- cloth\n- deformable-objects\n- simulation"
    low = 10 ** max(3, len(str(count)) - 1)
    size = "n<1K" if count < low else f"{_short(low)}<n<{_short(10 * low)}"
    yield f"size_categories:\n- {size}"
    yield "configs:"
    for number, (name, files) in enumerate(parts):
        yield f"- config_name: {name}"
        if number == 0:
            yield "  default: true"
        yield "  data_files:"
        for split, pattern in files.items():
            yield f"  - split: {split}\n    path: {pattern}"


def _short(count: int) -> str:
    return f"{count // 1000}K" if count < 10**6 else f"{count // 10**6}M"


def _about_meshes(meshes: Configuration) -> str:
    rows = [f"| `{name}` | {shape} | {unit} | {holds} |" for name, (shape, unit, holds) in _UNITS.items()]
    return "\n".join(
        [
            "# Folded cloths as meshes\n",
            "Each row is a sequence: a cloth on a table, up to three manipulations by one or two hands, and the state "
            "at rest after each, as a mesh of 32 x 32 vertices. *Normalised*: the flat cloth's longer side is 1.4. "
            "*Geodesic*: -1 to 1 over the cloth.\n",
            "```python\nfrom datasets import load_dataset\n",
            'dataset = load_dataset(".", "meshes")  # in this folder; or the name of the repository on the Hub',
            f'first = dataset["{next(iter(meshes.files))}"].with_format("numpy")[0]',
            'first["vertices"].shape, first["manipulation"].shape  # (4, 32, 32, 3), (3, 6)\n```\n',
            "| column | dimensions | unit | holds |\n|---|---|---|---|\n" + "\n".join(rows) + "\n",
        ]
    )
