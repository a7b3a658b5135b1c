"""Export of sequences as a LeRobotDataset of version 3.0: one episode per sequence, one frame per state.

Frames and episodes are parquet files; `meta/` describes them. A frame's `observation.state` is the vertices of a state,
its `action` the manipulation that leads to the next one. The last frame of an episode has the manipulation of zeros,
which does nothing. Frames follow each other at one per second: their timestamps count manipulations.

Source: the documentation "LeRobotDataset v3.0" of lerobot; the reader of lerobot 0.4.4 opens what is written here.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import UInt8
from tqdm import tqdm

from clothkit.dataset.recorded import Recorded, Sequences
from clothkit.dataset.statistics import OfPictures, OfValues, Statistics
from clothkit.dataset.store import LABELS, SPLITS

VERSION = "v3.0"
FRAMES_PER_SECOND = 1
TASK = "Fold the cloth with one or two hands."
EPISODES_PER_FILE = 500
"""Episodes in one file of frames and in one of episodes, so that files are some tens of megabytes."""

_FILES_PER_CHUNK = 1000
SAMPLED = 4096
"""Episodes of which quantiles are computed exactly; of more episodes, every second, third .. is sampled."""

_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_STATE, _CLOTH, _ACTION = "observation.state", "observation.environment_state", "action"
_PICTURE = "observation.images.top"
_PNG = pa.struct({"bytes": pa.binary(), "path": pa.string()})

Draw = Callable[[Recorded], Iterable[UInt8[np.ndarray, "row column 3"]]]
"""Makes a picture of each state of a sequence."""


class Feature(NamedTuple):
    """A column of the frames, as `meta/info.json` describes it."""

    dtype: str
    shape: tuple[int, ...]
    names: list[str] | None = None
    units: str | None = None
    """Not of the format, whose readers leave it alone."""

    @property
    def arrow(self) -> pa.DataType:
        """The type of the column in parquet."""
        kind = _PNG if self.dtype == "image" else pa.bool_() if self.dtype == "bool" else pa.type_for_alias(self.dtype)
        return pa.list_(kind, self.shape[0]) if len(self.shape) == 1 and self.shape != (1,) else kind

    def description(self) -> dict[str, Any]:
        """Its entry in `meta/info.json`."""
        found = {"dtype": self.dtype, "shape": list(self.shape), "names": self.names}
        return found if self.units is None else {**found, "units": self.units}


def write_lerobot(folder: Path, sequences: Sequences, *, draw: Draw | None = None) -> None:
    """Write the dataset into an empty folder; equal sequences and pictures give equal bytes.

    With `draw`, frames have pictures, as PNG. The cloth's sides and thickness are a feature where all are known.
    """
    bar = tqdm(sequences.each, total=len(sequences), desc="export", unit="sequence", mininterval=1)
    first, whole = _peek(iter(bar))
    pictures = None if draw is None else next(iter(draw(first))).shape
    features = _features(first, pictures)
    statistics = {name: _statistics(feature) for name, feature in features.items()}
    every = math.ceil(len(sequences) / SAMPLED)
    frames = 0
    for number, shard in enumerate(_shards(whole)):
        place = {"chunk_index": number // _FILES_PER_CHUNK, "file_index": number % _FILES_PER_CHUNK}
        from_episode = number * EPISODES_PER_FILE
        tables = [
            _frames(episode, from_episode + k, frames + sum(len(e.vertices) for e in shard[:k]), features, draw)
            for k, episode in enumerate(shard)
        ]
        _write(folder / "data" / _PATH.format(**place), tables)
        rows = [_episode(table, episode, place, features) for table, episode in zip(tables, shard, strict=True)]
        _write(folder / "meta/episodes" / _PATH.format(**place), [pa.Table.from_pylist(rows)])
        frames += sum(len(episode.vertices) for episode in shard)
        sampled = [table for k, table in enumerate(tables) if (from_episode + k) % every == 0]
        for name, own in statistics.items():
            own.add([table[name] for table in tables], [table[name] for table in sampled])
    tasks = pd.DataFrame({"task_index": [0]}, index=pd.Index([TASK], name="task"))
    tasks.to_parquet(folder / "meta/tasks.parquet")
    triangles = pa.table(dict(zip("abc", first.triangles.T, strict=True)))
    pq.write_table(triangles, folder / "meta/triangles.parquet")
    found = {name: {key: value.tolist() for key, value in own.found().items()} for name, own in statistics.items()}
    _write_json(folder / "meta/stats.json", found)
    _write_json(folder / "meta/info.json", _info(features, sequences, frames))
    (folder / "README.md").write_text(_readme(features, sequences, frames))


def _statistics(feature: Feature) -> Statistics:
    return OfPictures() if feature.dtype == "image" else OfValues(feature.shape[0])


def _peek(episodes: Iterator[Recorded]) -> tuple[Recorded, Iterator[Recorded]]:
    first = next(episodes)

    def whole() -> Iterator[Recorded]:
        yield first
        yield from episodes

    return first, whole()


def _shards(episodes: Iterator[Recorded]) -> Iterator[list[Recorded]]:
    while shard := list(islice(episodes, EPISODES_PER_FILE)):
        yield shard


def _features(first: Recorded, pictures: tuple[int, ...] | None) -> dict[str, Feature]:
    count = first.vertices.shape[1]
    names = [f"vertex_{vertex}_{axis}" for vertex in range(count) for axis in LABELS["xyz"]]
    found = {_STATE: Feature("float32", (3 * count,), names, "m")}
    if np.isfinite(first.cloth).all():
        found[_CLOTH] = Feature("float32", (3,), list(LABELS["measure"]), "m")
    if pictures is not None:
        found[_PICTURE] = Feature("image", pictures, ["height", "width", "channels"])
    units = "u1 v1 u2 v2 geodesic, dx dy normalised"
    found[_ACTION] = Feature("float32", (6,), list(LABELS["component"]), units)
    found["next.done"] = Feature("bool", (1,))
    found["timestamp"] = Feature("float32", (1,))
    return found | {name: Feature("int64", (1,)) for name in ("frame_index", "episode_index", "index", "task_index")}


def _frames(episode: Recorded, number: int, start: int, features: Mapping[str, Feature], draw: Draw | None) -> pa.Table:
    """The frames of one episode, the first of which is the dataset's frame `start`."""
    count = len(episode.vertices)
    place = np.arange(count)
    columns: dict[str, Any] = {
        _STATE: episode.vertices.reshape(count, -1),
        _CLOTH: np.tile(episode.cloth, (count, 1)),
        _ACTION: np.concatenate([episode.manipulation, np.zeros((1, 6), np.float32)]),
        "next.done": place == count - 1,
        "timestamp": (place / FRAMES_PER_SECOND).astype(np.float32),
        "frame_index": place,
        "episode_index": np.full(count, number),
        "index": start + place,
        "task_index": np.zeros(count, np.int64),
    }
    if draw is not None:
        columns[_PICTURE] = [{"bytes": _png(picture), "path": None} for picture in draw(episode)]
    arrays = {name: _column(columns[name], feature.arrow) for name, feature in features.items()}
    return pa.table(arrays)


def _column(values: Any, kind: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel(), kind.value_type), type=kind)
    return pa.array(values, kind)


def _png(picture: UInt8[np.ndarray, "row column 3"]) -> bytes:
    return bytes(cv2.imencode(".png", picture[..., ::-1])[1])


def _write(path: Path, tables: list[pa.Table]) -> None:
    """Write tables of one schema as parquet, each as a row group, so that an episode's frames can be read alone."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with pq.ParquetWriter(path, tables[0].schema) as writer:
        for table in tables:
            writer.write_table(table)


def _episode(frames: pa.Table, episode: Recorded, place: Mapping[str, int], features: Mapping[str, Feature]) -> dict:
    """The row of an episode: where its frames are, and their statistics."""
    first = frames["index"][0].as_py()
    row: dict[str, Any] = {
        "episode_index": frames["episode_index"][0].as_py(),
        "tasks": [TASK],
        "length": len(frames),
        **{f"data/{name}": number for name, number in place.items()},
        "dataset_from_index": first,
        "dataset_to_index": first + len(frames),
        **{f"meta/episodes/{name}": number for name, number in place.items()},
        # Not of the format: which sequence of the source it is.
        "sequence": episode.sequence,
    }
    for name, feature in features.items():
        own = _statistics(feature)
        own.add([frames[name]])
        for statistic, value in own.found().items():
            row[f"stats/{name}/{statistic}"] = value.tolist()
    return row


def _info(features: Mapping[str, Feature], sequences: Sequences, frames: int) -> dict[str, Any]:
    starts = {name: sequences.split.index(name) for name in SPLITS if name in sequences.split}
    splits = {name: f"{start}:{start + sequences.split.count(name)}" for name, start in starts.items()}
    return {
        "codebase_version": VERSION,
        "robot_type": None,
        "total_episodes": len(sequences),
        "total_frames": frames,
        "total_tasks": 1,
        "chunks_size": _FILES_PER_CHUNK,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FRAMES_PER_SECOND,
        "splits": splits,
        "data_path": f"data/{_PATH}",
        "video_path": None,
        "features": {name: feature.description() for name, feature in features.items()},
    }


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")


def _readme(features: Mapping[str, Feature], sequences: Sequences, frames: int) -> str:
    rows = [f"| `{name}` | {f.dtype} {list(f.shape)} | {f.units or ''} |" for name, f in features.items()]
    return "\n".join(
        [
            "---",
            "license: apache-2.0",
            "task_categories:\n- robotics",
            "tags:\n- LeRobot\n- cloth",
            "configs:\n- config_name: default\n  data_files: data/*/*.parquet",
            "---\n",
            "# Folded cloths\n",
            f"{len(sequences)} sequences of a cloth on a table that one or two hands fold, {frames} states, simulated "
            "by clothkit, as a LeRobotDataset of version 3.0.\n",
            "An episode is a sequence, a frame a state at rest. `observation.state` has x y z of each vertex in turn, "
            "`meta/triangles.parquet` the vertices of each triangle. `action` leads to the next frame: where the "
            "hands grasp (u1 v1 u2 v2, -1 to 1 over the cloth) and how far the point midway between them moves (dx dy; "
            "the flat cloth's longer side is 1.4). The last action of an episode is zero. Timestamps count "
            "manipulations; the cloth takes no part in time between them.\n",
            "| feature | type | unit |\n|---|---|---|\n" + "\n".join(rows) + "\n",
        ]
    )
