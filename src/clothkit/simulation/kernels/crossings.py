"""The search for crossings (edges that pierce triangles), with which the guard in `advance.py` prevents tangles.

The guard runs it at intervals. A world that has more crossings than before is reset to the last saved state and then
runs in careful mode for a while.
"""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp

from clothkit.simulation.kernels.search import cell_column, cell_row
from clothkit.simulation.kernels.state import CELLS, Solver, State, Vectors, edge_end


@wp.func
def crosses(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Return whether the segment p-q passes through a triangle."""
    normal = wp.cross(b - a, c - a)
    dp = wp.dot(p - a, normal)
    dq = wp.dot(q - a, normal)
    if dp * dq >= 0.0:
        return False
    d = q - p
    ab = wp.dot(wp.cross(a - p, b - p), d)
    bc = wp.dot(wp.cross(b - p, c - p), d)
    ca = wp.dot(wp.cross(c - p, a - p), d)
    return (ab > 0.0 and bc > 0.0 and ca > 0.0) or (ab < 0.0 and bc < 0.0 and ca < 0.0)


@wp.func
def crossings_with(x: Vectors, i: int, j: int, a: int, n: int):
    """Return how many of a quad's two triangles an edge pierces, 0 where it shares a vertex with them."""
    b = a + 1
    c = a + n
    d = c + 1
    if i == a or i == d or j == a or j == d:
        return 0
    p = x[i]
    q = x[j]
    xa = x[a]
    normal = wp.cross(x[d] - xa, x[b] - x[c])
    # The plane through corner a is parallel to both diagonals; `twist` is how far the other corners lie off it.
    twist = wp.abs(wp.dot(x[b] - xa, normal))
    above_p = wp.dot(p - xa, normal)
    above_q = wp.dot(q - xa, normal)
    found = int(0)
    if wp.max(above_p, above_q) > -twist and wp.min(above_p, above_q) < twist:
        if i != b and j != b:
            if crosses(p, q, xa, x[d], x[b]):
                found += 1
        if i != c and j != c:
            if crosses(p, q, xa, x[c], x[d]):
                found += 1
    return found


@wp.func
def crossings_of(solver: Solver, state: State, w: int, x: Vectors, i: int, j: int):
    """Return how many triangles the edge i-j pierces, leaving out those that share a vertex with it."""
    n = solver.columns
    p = x[i]
    q = x[j]
    middle = (p + q) * 0.5
    low = state.low[w]
    row = cell_row(solver, low, middle)
    column = cell_column(solver, low, middle)
    largest = solver.cell * solver.cell
    # Quads have moved since they were sorted: an edge further than this from the stored plane can't reach the quad.
    slack = 3.0 * solver.prediction_error
    half = (q - p) * 0.5
    found = int(0)
    for near in range(row - 1, row + 2):
        cell = near * CELLS + column
        for place in range(state.quad_first[w, cell - 1], state.quad_first[w, cell + 2]):
            r = middle - state.quad_centre[w, place]
            if wp.dot(r, r) < largest:
                normal = state.quad_normal[w, place]
                beyond = wp.abs(wp.dot(r, normal)) - wp.abs(wp.dot(half, normal)) - state.quad_twist[w, place]
                if beyond < slack:
                    found += crossings_with(x, i, j, state.quad[w, place], n)
    return found


@wp.func
def count_crossings(solver: Solver, state: State, w: int):
    """Return the number of pierced triangles over all edges.

    Only edges on the border, in a bend or with a contact at an end are searched, by the last contact lists.
    """
    x = state.position[w]
    n = solver.columns
    last = solver.rows - 1
    found = int(0)
    for edge in range(3 * solver.rows * n):
        i = edge / 3
        kind = edge % 3
        row = i / n
        column = i % n
        if (kind == 1 or row < last) and (kind == 0 or column < n - 1):
            j = edge_end(edge, n)
            touched = state.contacts[w, i] + state.contacts[w, j]
            bent = state.in_bend[w, i] + state.in_bend[w, j]
            border = row == 0 or column == 0 or row == last or column == n - 1
            if touched > 0 or bent > 0 or border:
                found += crossings_of(solver, state, w, x, i, j)
    return found
