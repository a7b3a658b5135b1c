"""The search grid: quads and edges sorted by grid cell in x and y, remade with the contact lists.

The grid needs no cells in z, since a folded cloth is flat. Neighbouring cells of a row are contiguous in the sorted
arrays.
"""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp

from clothkit.simulation.kernels.state import CELLS, Solver, State

HEIGHTS = wp.constant(128)  # bins of the sort by height


@wp.func
def cell_row(solver: Solver, low: wp.vec3, p: wp.vec3):
    """Return the row of cells of a point, clamped to the grid."""
    return wp.clamp(int((p[0] - low[0]) / solver.cell), 1, CELLS - 2)


@wp.func
def cell_column(solver: Solver, low: wp.vec3, p: wp.vec3):
    """Return the column of cells of a point, clamped to the grid."""
    return wp.clamp(int((p[1] - low[1]) / solver.cell), 1, CELLS - 2)


@wp.func
def cell_of(solver: Solver, low: wp.vec3, p: wp.vec3):
    """Return the index of a point's cell."""
    return cell_row(solver, low, p) * CELLS + cell_column(solver, low, p)


@wp.func
def place_grid(solver: Solver, state: State, w: int):
    """Place the search grid's corner one cell below the smallest x and y of the cloth."""
    low = state.position[w, 0]
    for i in range(solver.rows * solver.columns):
        low = wp.min(low, state.position[w, i])
    state.low[w] = low - wp.vec3(solver.cell, solver.cell, 0.0)


@wp.func
def sort_quads(solver: Solver, state: State, w: int):
    """Sort the quads by cell and store the geometry that the searches use (counting sort)."""
    n = solver.columns
    quads = solver.rows * n - n
    place_grid(solver, state, w)
    low = state.low[w]
    for cell in range(CELLS * CELLS + 1):
        state.quad_first[w, cell] = 0
    for quad in range(quads):
        if quad % n < n - 1:
            centre = (state.position[w, quad] + state.position[w, quad + n + 1]) * 0.5
            cell = cell_of(solver, low, centre)
            state.cell[w, quad] = cell
            state.quad_first[w, cell] += 1
    for cell in range(CELLS * CELLS):
        state.quad_first[w, cell + 1] += state.quad_first[w, cell]
    for back in range(quads):
        quad = quads - 1 - back
        if quad % n < n - 1:
            # Each cell is filled from its end backwards, so that `quad_first` ends up at the cell's start.
            place = state.quad_first[w, state.cell[w, quad]] - 1
            state.quad_first[w, state.cell[w, quad]] = place
            p00 = state.position[w, quad]
            p01 = state.position[w, quad + 1]
            p10 = state.position[w, quad + n]
            p11 = state.position[w, quad + n + 1]
            normal = wp.normalize(wp.cross(p11 - p00 + p10 - p01, p11 - p00 + p01 - p10))
            velocity = (state.velocity[w, quad] + state.velocity[w, quad + n + 1]) * 0.5
            state.quad[w, place] = quad
            state.quad_centre[w, place] = (p00 + p01 + p10 + p11) * 0.25
            state.quad_normal[w, place] = normal
            state.quad_twist[w, place] = wp.abs(wp.dot(p00 - p01 - p10 + p11, normal)) * 0.25
            state.quad_velocity[w, place] = velocity
            state.quad_speed[w, place] = wp.length(velocity)


@wp.func
def sort_features(solver: Solver, state: State, w: int):
    """Sort the feature edges by the cells of their middles (counting sort)."""
    low = state.low[w]
    for cell in range(CELLS * CELLS + 1):
        state.edge_first[w, cell] = 0
    for k in range(state.features[w]):
        cell = cell_of(solver, low, state.feature_middle[w, k])
        state.cell[w, k] = cell
        state.edge_first[w, cell] += 1
    for cell in range(CELLS * CELLS):
        state.edge_first[w, cell + 1] += state.edge_first[w, cell]
    for back in range(state.features[w]):
        k = state.features[w] - 1 - back
        place = state.edge_first[w, state.cell[w, k]] - 1
        state.edge_first[w, state.cell[w, k]] = place
        state.edge[w, place] = state.feature[w, k]
        state.edge_middle[w, place] = state.feature_middle[w, k]
        state.edge_half[w, place] = state.feature_half[w, k]
        state.edge_velocity[w, place] = state.feature_velocity[w, k]
        state.edge_speed[w, place] = wp.length(state.feature_velocity[w, k])


@wp.func
def sort_heights(solver: Solver, state: State, w: int):
    """Sort the vertices by height (counting sort with bins of a quarter of the thickness)."""
    count = solver.rows * solver.columns
    per_bin = 4.0 / solver.thickness
    for k in range(HEIGHTS):
        state.cell[w, k] = 0
    for i in range(count):
        k = wp.clamp(int(state.position[w, i][2] * per_bin), 0, HEIGHTS - 1)
        state.cell[w, k] += 1
    start = int(0)
    for k in range(HEIGHTS):
        start += state.cell[w, k]
        state.cell[w, k] = start - state.cell[w, k]
    for i in range(count):
        k = wp.clamp(int(state.position[w, i][2] * per_bin), 0, HEIGHTS - 1)
        state.upwards[w, state.cell[w, k]] = i
        state.cell[w, k] += 1
