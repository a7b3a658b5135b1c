"""The dataset card for machines: a Croissant description of the raw artifacts, with the meaning of each column.

Source: the Croissant format specification, version 1.0, of MLCommons; its library `mlcroissant` validates what is
written here, and reads the files through it.
"""

import hashlib
import re
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

from clothkit.dataset.raw import state_files
from clothkit.report.card.columns import described
from clothkit.report.card.inputs import PARTS, Inputs

LOCATED = "../../../data/raw"
"""Where the raw artifacts are, from the card's place in a report."""

FORMAT = "http://mlcommons.org/croissant/1.0"
VERSION = "1.0.0"
"""Of the columns; a change of what one holds is another."""

LICENSE = "https://www.apache.org/licenses/LICENSE-2.0"
STATE_FILES = "state-files"
_PARQUET = "application/x-parquet"
_CITATION = (
    "S. Arnold, D. Tanaka, K. Yamazaki: Cloth Manipulation Planning on Basis of Mesh Representations with Incomplete "
    "Domain Knowledge and Voxel-to-Mesh Estimation, 2023"
)
_KINDS = {"int": "sc:Integer", "float": "sc:Float", "double": "sc:Float", "bool": "sc:Boolean", "string": "sc:Text"}
_HOLDS = {
    "states": "A row per state of a sequence, at rest.",
    "manipulations": "A row per manipulation, which leads from one state to the next.",
    "attempts": "A row per tried sequence, accepted or not.",
    "topologies": "A row per triangulation of the cloth.",
    "cloths": "A row per sequence: its cloth.",
}
_KEYS = {
    "states": ("sequence", "state"),
    "manipulations": ("sequence", "step"),
    "attempts": ("attempt",),
    "topologies": ("topology",),
    "cloths": ("sequence",),
}
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def describe(inputs: Inputs, raw: Path, *, located: str) -> dict[str, Any]:
    """The description as JSON types: every file with its checksum, every column with its type, unit and meaning.

    `located` is the path of the folder `raw` from the description's place.
    """
    files = [_file(f"states/{shard.name}", shard, located) for shard in state_files(raw / "states")]
    files += [_file(part, raw / part, located) for part in PARTS if part != "states"]
    sets = {
        "@type": "cr:FileSet",
        "@id": STATE_FILES,
        "name": STATE_FILES,
        "encodingFormat": _PARQUET,
        "includes": f"{located}/states/*.parquet",
    }
    scale = inputs.attributes.get("scale")
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": FORMAT,
        "name": f"clothkit-{scale}" if scale else "clothkit",
        "description": (
            f"{inputs.states['sequence'].nunique()} sequences of a cloth that lies on a table and is folded by a robot "
            "with one or two hands, simulated: every state at rest as a triangle mesh, and between states what the "
            "hands did."
        ),
        "citeAs": _CITATION,
        "license": LICENSE,
        "version": VERSION,
        "keywords": ["cloth", "robotics", "manipulation", "simulation"],
        "distribution": [*files, sets],
        "recordSet": [_records(part, inputs.columns[part]) for part in PARTS],
    }


def _file(name: str, path: Path, located: str) -> dict[str, Any]:
    content = path.read_bytes()
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": f"{located}/{name}",
        "contentSize": f"{len(content)} B",
        "encodingFormat": _PARQUET,
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def _records(part: str, columns: Any) -> dict[str, Any]:
    name = part.removesuffix(".parquet")
    source = {"fileSet": {"@id": STATE_FILES}} if part == "states" else {"fileObject": {"@id": part}}
    rows = described(part, columns).to_dict("records")
    fields = [_field(name, column, kind, row, source) for (column, kind), row in zip(columns, rows, strict=True)]
    present = [column for column, _ in columns]
    keys = [{"@id": f"{name}/{key}"} for key in _KEYS[name] if key in present]
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": _HOLDS[name],
        "key": keys,
        "field": fields,
    }


def _field(
    records: str, column: str, kind: str, row: Mapping[Hashable, Any], source: Mapping[str, Any]
) -> dict[str, Any]:
    item = re.sub(r"^(?:large_)?list<(.*)>$", r"\1", kind)
    unit = f" [{row['unit']}]" if row["unit"] else ""
    return {
        "@type": "cr:Field",
        "@id": f"{records}/{column}",
        "name": column,
        "description": f"{row['holds'] or column}{unit}",
        "dataType": next((name for stem, name in _KINDS.items() if stem in item), "sc:Text"),
        **({"repeated": True} if item != kind else {}),
        "source": {**source, "extract": {"column": column}},
    }
