"""Recognises triangles that form our grid of 32 x 32 vertices, and finds the order of its vertices.

Other programs change the order of a grid's vertices, and write a vertex once for each of its texture coordinates or
normals. The grid can still be found from positions and triangles: its border is one loop of 124 edges, and the
triangles lead from three corners of a quad to the fourth. They don't decide between the eight symmetric orders.
"""

from collections import defaultdict

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from clothkit.cloth.grid import SIDE

_QUADS = (SIDE - 1) ** 2
_BORDER = 4 * (SIDE - 1)
Faces = Int[np.ndarray, "faces 3"]


def is_grid(vertices: int, faces: Faces) -> bool:
    """Whether the triangles form our grid with its vertices row by row: two in each quad, cut along either diagonal."""
    if vertices != SIDE**2 or len(faces) != 2 * _QUADS:
        return False
    u, v = np.divmod(faces, SIDE)
    within = (np.ptp(u, axis=1) == 1) & (np.ptp(v, axis=1) == 1)
    if not within.all() or (np.diff(np.sort(faces, axis=1), axis=1) == 0).any():
        return False
    quad, corner = u.min(1) * SIDE + v.min(1), 2 * (u - u.min(1, keepdims=True)) + v - v.min(1, keepdims=True)
    # Corners of a quad are 0 to 3. Each triangle lacks one of them; the two triangles of a quad lack opposite ones,
    # whose sum is 3.
    counts, missing = np.bincount(quad), np.bincount(quad, 6 - corner.sum(1))
    return bool((counts <= 2).all() and (missing == 1.5 * counts).all() and (counts == 2).sum() == _QUADS)


def grid_order(
    vertices: Float[np.ndarray, "vertices 3"], faces: Faces, *, tolerance: float
) -> Int[np.ndarray, "1024"] | None:
    """The indices of a mesh's vertices in our order, row by row [1024]; None if the mesh is not our grid.

    Vertices nearer to one another than `tolerance` are merged if the mesh is no grid without that. Triangles that occur
    twice, as on both sides of a sheet, count once. Of the eight symmetric orders, the result is the one that is most
    similar to the file's order.
    """
    if is_grid(len(vertices), faces):
        return np.arange(SIDE**2)
    # Vertices of layers that touch may have equal positions, so the mesh is first tried without merging.
    own = np.arange(len(vertices))
    for place in (own, welded(vertices, tolerance)):
        order = _layout(place[faces])
        if order is not None:
            return order
    return None


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


def _layout(faces: Faces) -> np.ndarray | None:
    """The vertices of the triangles in the order of our grid, row by row; None if they form no such grid."""
    faces = np.sort(faces, axis=1)
    faces = np.unique(faces[(np.diff(faces, axis=1) > 0).all(1)], axis=0)
    names, compact = np.unique(faces, return_inverse=True)
    if len(faces) != 2 * _QUADS or len(names) != SIDE**2:
        return None
    faces = compact.reshape(-1, 3)
    apexes: dict[tuple[int, int], set[int]] = defaultdict(set)
    for a, b, c in faces.tolist():
        for x, y, apex in ((a, b, c), (a, c, b), (b, c, a)):
            apexes[x, y].add(apex)
            apexes[y, x].add(apex)
    loop = _border(apexes)
    if loop is None:
        return None
    for corner in range(SIDE - 1):
        grid = _filled(loop[corner:] + loop[:corner], apexes)
        if grid is not None and is_grid(SIDE**2, np.argsort(grid.ravel())[faces]):
            return names[_most_alike(grid)]
    return None


def _border(apexes: dict[tuple[int, int], set[int]]) -> list[int] | None:
    """The vertices along the border, in order; None if the border is not one loop of the right length."""
    beside: dict[int, list[int]] = defaultdict(list)
    for (x, y), across in apexes.items():
        if len(across) == 1:
            beside[x].append(y)
    if len(beside) != _BORDER or any(len(others) != 2 for others in beside.values()):
        return None
    loop = [min(beside)]
    before = -1
    while True:
        one, other = beside[loop[-1]]
        before, after = loop[-1], other if one == before else one
        if after == loop[0]:
            return loop if len(loop) == _BORDER else None
        loop.append(after)


def _filled(loop: list[int], apexes: dict[tuple[int, int], set[int]]) -> np.ndarray | None:
    """The grid of vertices [32, 32] whose first row and column follow from the border; None if it can't be completed.

    `loop` must begin at a corner of the grid.
    """
    grid = np.full((SIDE, SIDE), -1)
    grid[0] = loop[:SIDE]
    grid[1:, 0] = loop[:-SIDE:-1]
    placed = set(grid[0].tolist()) | set(grid[:, 0].tolist())
    for i in range(1, SIDE):
        for j in range(1, SIDE):
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


def _most_alike(grid: np.ndarray) -> np.ndarray:
    """The one of the eight symmetric orders of the grid in which the vertex numbers are nearest to 0, 1, 2, ..."""
    orders = [np.rot90(side, turns).ravel() for side in (grid, grid.T) for turns in range(4)]
    return min(orders, key=lambda order: int(np.abs(order - np.arange(SIDE**2)).sum()))
