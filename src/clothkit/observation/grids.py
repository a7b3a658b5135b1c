"""Recognises triangles that form a topology's grid of vertices, and finds the order of its vertices.

Other programs change the order of a grid's vertices, and write a vertex once for each of its texture coordinates or
normals. The grid can still be found from positions and triangles: its border is one loop of edges, 124 for the square,
and the triangles lead from three corners of a quad to the fourth. They don't decide between orders that turn or mirror
the flat cloth onto itself: eight for a square, four for a rectangle.
"""

from collections import defaultdict

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from clothkit.cloth.topology import SQUARE, Shape, Topology

Faces = Int[np.ndarray, "faces 3"]


def is_grid(vertices: int, faces: Faces, shape: Shape = SQUARE.shape) -> bool:
    """Whether the triangles form a grid with its vertices row by row: two in each quad, cut along either diagonal."""
    rows, columns = shape
    quads = _quads(shape)
    if vertices != rows * columns or len(faces) != 2 * quads:
        return False
    u, v = np.divmod(faces, columns)
    within = (np.ptp(u, axis=1) == 1) & (np.ptp(v, axis=1) == 1)
    if not within.all() or (np.diff(np.sort(faces, axis=1), axis=1) == 0).any():
        return False
    quad, corner = u.min(1) * columns + v.min(1), 2 * (u - u.min(1, keepdims=True)) + v - v.min(1, keepdims=True)
    # Corners of a quad are 0 to 3. Each triangle lacks one of them; the two triangles of a quad lack opposite ones,
    # whose sum is 3.
    counts, missing = np.bincount(quad), np.bincount(quad, 6 - corner.sum(1))
    return bool((counts <= 2).all() and (missing == 1.5 * counts).all() and (counts == 2).sum() == quads)


def grid_order(
    vertices: Float[np.ndarray, "vertices 3"], faces: Faces, topology: Topology = SQUARE, *, tolerance: float
) -> Int[np.ndarray, " grid"] | None:
    """The indices of a mesh's vertices in the topology's order, row by row; None if the mesh is no such grid.

    Vertices nearer to one another than `tolerance` are merged if the mesh is no grid without that. Triangles that occur
    twice, as on both sides of a sheet, count once. Of the orders that turn or mirror the flat cloth onto itself, the
    result is the one that is most similar to the file's order.
    """
    own = np.arange(len(vertices))
    if is_grid(len(vertices), faces, topology.shape) and _fits(own.reshape(topology.shape), vertices, topology):
        return own
    # Vertices of layers that touch may have equal positions, so the mesh is first tried without merging.
    for place in (own, welded(vertices, tolerance)):
        grid = _layout(place[faces], topology.shape)
        if grid is not None:
            return _most_alike(grid, vertices, topology)
    return None


def widths(mesh: Float[np.ndarray, "u v 3"]) -> tuple[float, float]:
    """The widths of a grid along u and along v, folded or not: its median edges times their number [unit of mesh]."""
    along_u, along_v = (
        float(np.median(np.linalg.norm(np.diff(mesh.astype(float), axis=axis), axis=-1))) * (mesh.shape[axis] - 1)
        for axis in (0, 1)
    )
    return along_u, along_v


def welded(vertices: Float[np.ndarray, "vertices 3"], tolerance: float) -> Int[np.ndarray, " vertices"]:
    """For each vertex, the index of the first vertex that lies within `tolerance` of it, directly or by a chain."""
    cells = np.floor(vertices / tolerance)
    _, first, cell = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    cell = cell.reshape(-1)
    # One vertex per cell, so that many vertices in one place do not make many pairs.
    pairs = cKDTree(vertices[first]).query_pairs(tolerance, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(first), len(first)))
    count, place = connected_components(graph, directed=False)
    earliest = np.full(count, len(vertices))
    np.minimum.at(earliest, place, first)
    return earliest[place[cell]]


def _quads(shape: Shape) -> int:
    return (shape[0] - 1) * (shape[1] - 1)


def _layout(faces: Faces, shape: Shape) -> np.ndarray | None:
    """The vertices of the triangles as a grid of that shape, in any of its orders; None if they form no such grid."""
    rows, columns = shape
    faces = np.sort(faces, axis=1)
    faces = np.unique(faces[(np.diff(faces, axis=1) > 0).all(1)], axis=0)
    names, compact = np.unique(faces, return_inverse=True)
    if len(faces) != 2 * _quads(shape) or len(names) != rows * columns:
        return None
    faces = compact.reshape(-1, 3)
    apexes: dict[tuple[int, int], set[int]] = defaultdict(set)
    for a, b, c in faces.tolist():
        for x, y, apex in ((a, b, c), (a, c, b), (b, c, a)):
            apexes[x, y].add(apex)
            apexes[y, x].add(apex)
    loop = _border(apexes, 2 * (rows + columns - 2))
    if loop is None:
        return None
    # Half of the border holds a corner at which a row of the grid begins.
    for corner in range(len(loop) // 2):
        grid = _filled(loop[corner:] + loop[:corner], apexes, shape)
        if grid is not None and is_grid(rows * columns, np.argsort(grid.ravel())[faces], shape):
            return names[grid]
    return None


def _border(apexes: dict[tuple[int, int], set[int]], length: int) -> list[int] | None:
    """The vertices along the border, in order; None if the border is not one loop of that length."""
    beside: dict[int, list[int]] = defaultdict(list)
    for (x, y), across in apexes.items():
        if len(across) == 1:
            beside[x].append(y)
    if len(beside) != length or any(len(others) != 2 for others in beside.values()):
        return None
    loop = [min(beside)]
    before = -1
    while True:
        one, other = beside[loop[-1]]
        before, after = loop[-1], other if one == before else one
        if after == loop[0]:
            return loop if len(loop) == length else None
        loop.append(after)


def _filled(loop: list[int], apexes: dict[tuple[int, int], set[int]], shape: Shape) -> np.ndarray | None:
    """The grid of vertices whose first row and column follow from the border; None if it can't be completed.

    `loop` must begin at a corner of the grid.
    """
    rows, columns = shape
    grid = np.full(shape, -1)
    grid[0] = loop[:columns]
    grid[1:, 0] = loop[:-rows:-1]
    placed = set(grid[0].tolist()) | set(grid[:, 0].tolist())
    for i in range(1, rows):
        for j in range(1, columns):
            a, b, c = int(grid[i - 1, j - 1]), int(grid[i - 1, j]), int(grid[i, j - 1])
            # The quad's diagonal runs either from b to c, or from a to the fourth corner.
            if c in apexes.get((a, b), ()):
                found = apexes.get((b, c), set()) - {a}
            else:
                found = apexes.get((a, b), set()) & apexes.get((a, c), set())
            found = found - placed
            if len(found) != 1:
                return None
            grid[i, j] = found.pop()
            placed.add(int(grid[i, j]))
    return grid


def _most_alike(grid: np.ndarray, vertices: np.ndarray, topology: Topology) -> np.ndarray:
    """The order of the grid in which the vertex numbers are nearest to 0, 1, 2, ..., of those that fit the topology."""
    turned = (np.rot90(side, turns) for side in (grid, grid.T) for turns in range(4))
    orders = [order.ravel() for order in turned if _fits(order, vertices, topology)]
    return min(orders, key=lambda order: int(np.abs(order - np.arange(grid.size)).sum()))


def _fits(grid: np.ndarray, vertices: np.ndarray, topology: Topology) -> bool:
    """Whether the topology's u runs along the grid's rows, by the numbers of vertices and the lengths of edges."""
    if grid.shape != topology.shape:
        return False
    if topology.shape[0] != topology.shape[1] or topology.sides[0] == topology.sides[1]:
        return True
    along_u, along_v = widths(vertices[grid])
    return (along_u >= along_v) == (topology.sides[0] > topology.sides[1])
