"""Export of cloth states to common mesh files: OBJ, PLY and GLB, written by trimesh.

All are in metres. OBJ and PLY keep the world frame of the raw artifacts (z up, the table at z = 0). GLB is rotated to y
up, as its standard requires: (x, y, z) becomes (x, z, -y). Material coordinates are stored as texture coordinates,
0..1 from one edge of the cloth to the other.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from jaxtyping import Float, Int
from tqdm import tqdm
from trimesh.exchange.gltf import export_glb
from trimesh.exchange.obj import export_obj
from trimesh.exchange.ply import export_ply
from trimesh.visual.material import PBRMaterial

from clothkit.cloth.topology import CLOTH_LENGTH, SQUARE
from clothkit.dataset import store
from clothkit.dataset.raw import STATE_COLUMNS, Topologies, read_states
from clothkit.runtime.errors import InputError
from clothkit.runtime.publish import unfinished_files

FORMATS = ("obj", "ply", "glb")
LARGEST_SIDE = 100.0
_COLOUR = (0.33, 0.53, 0.74, 1.0)
_Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)


class Surface(NamedTuple):
    """One state as a triangle mesh."""

    sequence: int
    state: int
    vertices: Float[np.ndarray, "vertices 3"]
    """Metres, world frame, z up."""
    triangles: Int[np.ndarray, "triangles 3"]
    uv: Float[np.ndarray, "vertices 2"]
    """Material coordinates, 0..1."""
    title: str = ""
    """Name of a surface that is not a state of a sequence; empty otherwise."""

    @property
    def name(self) -> str:
        """The name of its file, without extension."""
        return self.title or f"sequence_{self.sequence:04d}_state_{self.state}"


def export(
    source: Path, target: Path, *, file_format: str, sequences: Sequence[int] | None = None, cloth_side: float
) -> list[Path]:
    """Write the states of some or all sequences to one file each in the folder `target`; returns the files' paths.

    `source` is a folder of raw artifacts or a store of meshes, whose sequences are counted from 0, and whose meshes are
    put back where they lay, `cloth_side` [m] wide. The files appear once all of them are written. Raises InputError
    when the source or a sequence isn't there, the side is no cloth's, or a file can't be written.
    """
    check_side(cloth_side)
    if is_raw(source):
        count, found = raw_surfaces(source, sequences)
    else:
        count, found = stored_surfaces(source, sequences, cloth_side=cloth_side)
    names = []
    with unfinished_files(target) as part:
        for surface in tqdm(found, total=count, desc="export", unit="state", mininterval=1):
            names.append(f"{surface.name}.{file_format}")
            (part / names[-1]).write_bytes(encode(surface, file_format))
    return [target / name for name in names]


def check_side(cloth_side: float) -> None:
    """Raises InputError if this is no cloth's side [m]."""
    if not 0 < cloth_side <= LARGEST_SIDE:
        raise InputError(f"cloth side {cloth_side:g}: expected metres, above 0 and up to {LARGEST_SIDE:g}")


def raw_surfaces(folder: Path, sequences: Sequence[int] | None) -> tuple[int, Iterator[Surface]]:
    """The number of states of some or all sequences of raw artifacts, and an iterator over them.

    Each state keeps its own triangulation. Raises InputError if a sequence or a state's topology is missing.
    """
    numbers = read_states(folder / "states", ("sequence", "state"))["sequence"].to_numpy()
    chosen = chosen_sequences(folder, sequences, np.unique(numbers).tolist())
    count = int(np.isin(numbers, chosen).sum())
    topologies = Topologies(folder)

    def surfaces() -> Iterator[Surface]:
        # Sequences are read in batches, because thousands of them may not fit into memory.
        for batch in (chosen[first : first + 100] for first in range(0, len(chosen), 100)):
            states = read_states(folder / "states", sequences=batch)
            for sequence, state, number, flat in zip(*(states[name] for name in STATE_COLUMNS), strict=True):
                topology, vertices = topologies(f"{folder}: sequence {sequence}, state {state}", number, flat)
                low, high = topology.material.min(0), topology.material.max(0)
                uv = ((topology.material - low) / (high - low)).astype(np.float32)
                yield Surface(sequence, state, vertices, topology.triangles, uv)

    return count, surfaces()


def stored_surfaces(path: Path, sequences: Sequence[int] | None, *, cloth_side: float) -> tuple[int, Iterator[Surface]]:
    """The number of states of some or all sequences of a store of meshes, and an iterator over them.

    States are scaled to a cloth of width `cloth_side` [m]. Raises InputError if a sequence is missing.
    """
    _, length = store.load_splits(path)
    chosen = np.array(chosen_sequences(path, sequences, list(range(len(length)))))
    scale = np.float32(cloth_side / CLOTH_LENGTH)
    uv, faces = (SQUARE.geodesic().reshape(-1, 2) + 1) / 2, SQUARE.triangles()

    def surfaces() -> Iterator[Surface]:
        numbers = iter(chosen.tolist())
        for part in store.load_parts(path, chosen):
            for row in range(len(part)):
                sequence = next(numbers)
                for state in range(int(part.length[row]) + 1):
                    centre = np.append(part.centre[row, state], np.float32(0))
                    vertices = (part.vertices[row, state] + centre).reshape(-1, 3) * scale
                    yield Surface(sequence, state, vertices.astype(np.float32), faces, uv)

    return int((length[chosen].astype(int) + 1).sum()), surfaces()


def to_trimesh(surface: Surface) -> trimesh.Trimesh:
    """The state as a trimesh object: metres, z up, with texture coordinates and a two-sided material."""
    material = PBRMaterial(name="cloth", baseColorFactor=_COLOUR, metallicFactor=0.0, roughnessFactor=1.0)
    material.doubleSided = True
    visual = trimesh.visual.TextureVisuals(uv=surface.uv, material=material)
    # Without `process=False`, trimesh may merge or reorder vertices.
    return trimesh.Trimesh(surface.vertices, surface.triangles, visual=visual, process=False)


def encode(surface: Surface, file_format: str) -> bytes:
    """The contents of a state's file in that format; equal states give equal bytes."""
    mesh = to_trimesh(surface)
    if file_format == "obj":
        text = export_obj(mesh, header=f"clothkit: {surface.name}, metres, z up", include_normals=False)
        # A reference to a material file that isn't written makes some readers complain.
        kept = [line for line in text.splitlines() if not line.startswith(("mtllib", "usemtl"))]
        return "\n".join([*kept, ""]).encode()
    if file_format == "ply":
        return export_ply(mesh, vertex_normal=False)
    mesh.apply_transform(_Y_UP)
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name=surface.name, geom_name=surface.name)
    return export_glb(scene, include_normals=True)


def is_raw(source: Path) -> bool:
    """Whether a source is a folder of raw artifacts; if not, it is a store of meshes.

    Raises InputError if it is neither, or not there.
    """
    if not source.exists():
        raise InputError(f"{source}: not found; expected a folder of raw artifacts or a store of meshes")
    if not (source / "states").is_dir() and not (source / "zarr.json").is_file():
        raise InputError(f"{source}: holds neither states/*.parquet nor a zarr store of meshes")
    return (source / "states").is_dir()


def chosen_sequences(source: Path, sequences: Sequence[int] | None, present: Sequence[int]) -> list[int]:
    """The requested sequences, sorted, or all if `sequences` is None. Raises InputError if one is missing."""
    if not present:
        raise InputError(f"{source}: holds no sequence")
    if sequences is None:
        return list(present)
    known = set(present)
    missing = [sequence for sequence in sequences if sequence not in known]
    if missing:
        raise InputError(
            f"{source}: has no sequence {missing[0]}; it holds {len(known)}, from {min(known)} to {max(known)}"
        )
    return sorted(set(sequences))
