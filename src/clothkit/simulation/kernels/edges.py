"""Contacts of edges with edges: border edges and edges in bends are paired, and every pair remembers its side.

Without them every third fold ends in a tangle: edges cross where no vertex passes through a triangle.
"""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change; `in` and `and` are its own.
# ruff: noqa: RUF046, SIM102, SIM109, UP018
import warp as wp

from clothkit.simulation.kernels.state import EDGE_PAIRS, VIOLATED, Solver, State, Vectors, cell_at, cell_of, edge_end


@wp.func
def nearest_on_lines(x: Vectors, a0: int, a1: int, b0: int, b1: int):
    """Return where two lines come closest, 0..1 on each edge, their signed distance in metres, and 1 if parallel."""
    pa = x[a0]
    pb = x[b0]
    d1 = x[a1] - pa
    d2 = x[b1] - pb
    normal = wp.cross(d1, d2)
    squared = wp.dot(normal, normal)
    r = pb - pa
    scale = 1.0 / (squared + 1.0e-20)
    s = wp.dot(wp.cross(r, d2), normal) * scale
    t = wp.dot(wp.cross(r, d1), normal) * scale
    parallel = wp.where(squared < 0.01 * wp.dot(d1, d1) * wp.dot(d2, d2), 1.0, 0.0)
    return wp.vec4(s, t, -wp.dot(r, normal) / wp.sqrt(squared + 1.0e-20), parallel)


@wp.func
def inside(s: float, t: float, slack: float):
    """Return whether both places lie on their edges, within a slack."""
    return s > -slack and s < 1.0 + slack and t > -slack and t < 1.0 + slack


@wp.func
def save_violated(solver: Solver, state: State, w: int):
    """Save the pairs that are on the wrong side of each other, and return their number."""
    x = state.position[w]
    count = int(0)
    for k in range(state.pairs[w]):
        side = state.pair[w, k, 2]
        if side != 0 and count < VIOLATED:
            e = state.pair[w, k, 0]
            g = state.pair[w, k, 1]
            near = nearest_on_lines(x, e / 3, edge_end(e, solver.side), g / 3, edge_end(g, solver.side))
            if near[3] == 0.0 and inside(near[0], near[1], 0.0):
                if near[2] * float(side) < 0.0 and wp.abs(near[2]) < solver.thickness:
                    state.violated[w, count, 0] = e
                    state.violated[w, count, 1] = g
                    state.violated[w, count, 2] = side
                    count += 1
    return count


@wp.func
def mark_bends(solver: Solver, state: State, w: int):
    """Mark the vertices that lie in a bend."""
    n = solver.side
    limit = solver.bend_feature * solver.bend_feature
    for i in range(n * n):
        row = i / n
        column = i % n
        bent = int(0)
        if row > 0 and row < n - 1:
            c = state.position[w, i - n] - 2.0 * state.position[w, i] + state.position[w, i + n]
            if wp.dot(c, c) > limit:
                bent = 1
        if column > 0 and column < n - 1:
            c = state.position[w, i - 1] - 2.0 * state.position[w, i] + state.position[w, i + 1]
            if wp.dot(c, c) > limit:
                bent = 1
        state.in_bend[w, i] = bent


@wp.func
def list_features(solver: Solver, state: State, w: int, per_metre: float):
    """List the edges on the border and in bends."""
    n = solver.side
    count = int(0)
    for i in range(n * n):
        row = i / n
        column = i % n
        for kind in range(3):
            if (kind == 1 or row < n - 1) and (kind == 0 or column < n - 1):
                edge = 3 * i + kind
                j = edge_end(edge, n)
                on_border = (kind == 0 and (column == 0 or column == n - 1)) or (
                    kind == 1 and (row == 0 or row == n - 1)
                )
                if on_border or state.in_bend[w, i] == 1 or state.in_bend[w, j] == 1:
                    middle = (state.position[w, i] + state.position[w, j]) * 0.5
                    state.feature[w, count] = edge
                    state.feature_middle[w, count] = middle
                    state.feature_cell[w, count] = cell_at(middle, per_metre)
                    count += 1
    state.features[w] = count


@wp.func
def side_of_pair(solver: Solver, state: State, w: int, e: int, g: int):
    """Return the side (1 or -1) of two edges, 0 when they run parallel, 2 when they are out of reach."""
    a0 = e / 3
    a1 = edge_end(e, solver.side)
    b0 = g / 3
    b1 = edge_end(g, solver.side)
    if a0 == b0 or a0 == b1 or a1 == b0 or a1 == b1:
        return 2
    va = state.velocity[w, a0] + state.velocity[w, a1]
    vb = state.velocity[w, b0] + state.velocity[w, b1]
    allowance = solver.margin + solver.prediction_time * 0.5 * wp.length(va - vb)
    reach = solver.edge_thickness + allowance
    x = state.position[w]
    near = nearest_on_lines(x, a0, a1, b0, b1)
    if near[3] > 0.0:
        d = x[a1] - x[a0]
        m = (x[b0] + x[b1] - x[a0] - x[a1]) * 0.5
        along = wp.dot(m, d)
        if wp.dot(m, m) - along * along / wp.dot(d, d) < reach * reach:
            return 0
        return 2
    if wp.abs(near[2]) < reach and inside(near[0], near[1], 0.1 + allowance / solver.spacing):
        return wp.where(near[2] >= 0.0, 1, -1)
    return 2


@wp.func
def list_pairs(solver: Solver, state: State, w: int):
    """List the pairs of feature edges that may touch within the prediction time (one lane)."""
    wrong = save_violated(solver, state, w)
    cell_side = 1.35 * solver.spacing
    per_metre = 1.0 / cell_side
    for k in range(state.features[w]):
        state.feature_head[w, state.feature_cell[w, k]] = -1
    mark_bends(solver, state, w)
    list_features(solver, state, w, per_metre)
    count = int(0)
    for k in range(state.features[w]):
        e = state.feature[w, k]
        middle = state.feature_middle[w, k]
        cx = int(wp.floor(middle[0] * per_metre))
        cy = int(wp.floor(middle[1] * per_metre))
        cz = int(wp.floor(middle[2] * per_metre))
        for ox in range(-1, 2):
            for oy in range(-1, 2):
                for oz in range(-1, 2):
                    other = state.feature_head[w, cell_of(cx + ox, cy + oy, cz + oz)]
                    while other >= 0:
                        d = state.feature_middle[w, other] - middle
                        if wp.dot(d, d) < cell_side * cell_side and count < EDGE_PAIRS:
                            g = state.feature[w, other]
                            side = side_of_pair(solver, state, w, e, g)
                            if side != 2:
                                for v in range(wrong):
                                    if side != 0 and state.violated[w, v, 0] == e and state.violated[w, v, 1] == g:
                                        side = state.violated[w, v, 2]
                                state.pair[w, count, 0] = e
                                state.pair[w, count, 1] = g
                                state.pair[w, count, 2] = side
                                count += 1
                        other = state.feature_next[w, other]
        cell = state.feature_cell[w, k]
        state.feature_next[w, k] = state.feature_head[w, cell]
        state.feature_head[w, cell] = k
    state.pairs[w] = count


@wp.func
def solve_pair(solver: Solver, state: State, w: int, k: int, lanes: int):
    """Push two edges apart on the side where they were, with Coulomb friction; note the side while they pass by."""
    e = state.pair[w, k, 0]
    g = state.pair[w, k, 1]
    a0 = e / 3
    a1 = edge_end(e, solver.side)
    b0 = g / 3
    b1 = edge_end(g, solver.side)
    x = state.position[w]
    near = nearest_on_lines(x, a0, a1, b0, b1)
    s = near[0]
    t = near[1]
    if near[3] > 0.0:
        state.pair[w, k, 2] = 0
        return
    if state.pair[w, k, 2] == 0 or s < 0.0 or s > 1.0 or t < 0.0 or t > 1.0:
        state.pair[w, k, 2] = wp.where(near[2] >= 0.0, 1, -1)
        return
    side = float(state.pair[w, k, 2])
    gap = near[2] * side
    if gap >= solver.edge_thickness or gap < -2.0 * solver.thickness:
        return
    p0 = x[a0]
    p1 = x[a1]
    q0 = x[b0]
    q1 = x[b1]
    normal = wp.normalize(wp.cross(p1 - p0, q1 - q0)) * side
    moved_a = (p0 - state.previous[w, a0]) * (1.0 - s) + (p1 - state.previous[w, a1]) * s
    moved_b = (q0 - state.previous[w, b0]) * (1.0 - t) + (q1 - state.previous[w, b1]) * t
    slip = moved_a - moved_b
    approach = wp.dot(slip, normal)
    slip = slip - normal * approach
    push = wp.min(solver.edge_thickness - gap, wp.max(0.0, -approach) * 2.0 + solver.push_step)
    friction = wp.min(1.0, solver.cloth_friction * push / (wp.length(slip) + 1.0e-12))
    wa0 = state.free[w, a0] * (1.0 - s)
    wa1 = state.free[w, a1] * s
    wb0 = state.free[w, b0] * (1.0 - t)
    wb1 = state.free[w, b1] * t
    out = (normal * push - slip * friction) / ((1.0 - s) * wa0 + s * wa1 + (1.0 - t) * wb0 + t * wb1 + 1.0e-9)
    if lanes == 1:
        x[a0] = p0 + out * wa0
        x[a1] = p1 + out * wa1
        x[b0] = q0 - out * wb0
        x[b1] = q1 - out * wb1
    else:
        wp.atomic_add(state.correction, w, a0, out * wa0)
        wp.atomic_add(state.correction, w, a1, out * wa1)
        wp.atomic_sub(state.correction, w, b0, out * wb0)
        wp.atomic_sub(state.correction, w, b1, out * wb1)


@wp.func
def solve_pairs(solver: Solver, state: State, w: int, lane: int, lanes: int):
    """Solve the listed contacts of edges with edges."""
    for k in range(lane, state.pairs[w], lanes):
        solve_pair(solver, state, w, k, lanes)
