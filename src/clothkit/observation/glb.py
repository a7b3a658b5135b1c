"""Reads GLB files by trimesh, after checks that trimesh lacks: compressed geometry, arrays larger than the file."""

import io
import json
import struct
from pathlib import Path
from typing import Any

import trimesh

from clothkit.runtime.errors import InputError

_COMPRESSED = {"KHR_draco_mesh_compression": "Draco", "EXT_meshopt_compression": "meshopt"}
_JSON = 0x4E4F534A


def load_glb(path: Path, content: bytes) -> trimesh.Scene:
    """The scene in a GLB file, read by trimesh.

    Raises InputError when its meshes are compressed, or when an array has more elements than the file has bytes. Other
    errors are those of trimesh.
    """
    description = _description(content)
    required = description.get("extensionsRequired", [])
    for extension, name in _COMPRESSED.items():
        if extension in required:
            raise InputError(
                f"{path}: its mesh is compressed by {name} ({extension}), expected plain triangles; export it without "
                "compression"
            )
    for accessor in description.get("accessors", []):
        # The elements of compressed and sparse accessors need not be in the file, but no cloth needs that many.
        if accessor.get("count", 0) > len(content):
            raise InputError(f"{path}: an array of {accessor['count']} numbers is more than the file's bytes hold")
    return trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False, skip_materials=True)


def _description(content: bytes) -> dict[str, Any]:
    """The file's JSON chunk; empty if there is none, for which trimesh raises an error."""
    if len(content) < 20:
        return {}
    size, kind = struct.unpack_from("<II", content, 12)
    if kind != _JSON:
        return {}
    description = json.loads(content[20 : 20 + size])
    return description if isinstance(description, dict) else {}
