"""Contacts of edges with edges: pairs of feature edges (on the border or in bends), each stored with its side.

Without these contacts every third fold ends in a tangle, because edges cross without any vertex passing through a
triangle.
"""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp

from clothkit.simulation.kernels.faces import parting
from clothkit.simulation.kernels.search import cell_column, cell_row, sort_features
from clothkit.simulation.kernels.state import CELLS, EDGE_PAIRS, MEMORY, Solver, State, Vectors, edge_end

PARALLEL = wp.constant(0.01)  # square of the sine below which edges count as parallel


@wp.func
def nearest_on_lines(x: Vectors, a0: int, a1: int, b0: int, b1: int):
    """Return (s, t, distance, parallel) of the lines through two edges.

    s and t are the positions of the nearest points, 0..1 within each edge; the distance is signed, in metres;
    `parallel` is 1 for parallel edges, else 0.
    """
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
    parallel = wp.where(squared < PARALLEL * wp.dot(d1, d1) * wp.dot(d2, d2), 1.0, 0.0)
    return wp.vec4(s, t, -wp.dot(r, normal) / wp.sqrt(squared + 1.0e-20), parallel)


@wp.func
def bent(feature: float, c: wp.vec3, before: int):
    """Return 1 if the second difference c is above the threshold `feature` for a bend, else 0.

    The threshold is halved where the last result, `before`, was 1 (hysteresis).
    """
    limit = feature * wp.where(before == 1, 0.5, 1.0)
    return wp.where(wp.dot(c, c) > limit * limit, 1, 0)


@wp.func
def mark_bends(solver: Solver, state: State, w: int):
    """Mark the vertices that lie in a bend and the quads that are twisted."""
    n = solver.columns
    last = solver.rows - 1
    x = state.position[w]
    for i in range(solver.rows * n):
        row = i / n
        column = i % n
        before = state.in_bend[w, i]
        found = int(0)
        if row > 0 and row < last:
            found = bent(solver.bend_u.feature, x[i - n] - 2.0 * x[i] + x[i + n], before)
        if found == 0 and column > 0 and column < n - 1:
            found = bent(solver.bend_v.feature, x[i - 1] - 2.0 * x[i] + x[i + 1], before)
        state.in_bend[w, i] = found
        if row < last and column < n - 1:
            twist = x[i] - x[i + 1] - x[i + n] + x[i + n + 1]
            state.twisted[w, i] = bent(solver.twist_feature, twist, state.twisted[w, i])


@wp.func
def list_features(solver: Solver, state: State, w: int, everywhere: bool):
    """List the feature edges: those on the border or in bends and the diagonals of twisted quads.

    With `everywhere`, list all edges.
    """
    n = solver.columns
    last = solver.rows - 1
    x = state.position[w]
    count = int(0)
    for i in range(solver.rows * n):
        row = i / n
        column = i % n
        for kind in range(3):
            if (kind == 1 or row < last) and (kind == 0 or column < n - 1):
                edge = 3 * i + kind
                j = edge_end(edge, n)
                on_border = (kind == 0 and (column == 0 or column == n - 1)) or (
                    kind == 1 and (row == 0 or row == last)
                )
                twisted = kind == 2 and state.twisted[w, i] == 1
                if everywhere or on_border or twisted or state.in_bend[w, i] == 1 or state.in_bend[w, j] == 1:
                    state.feature[w, count] = edge
                    half = (x[j] - x[i]) * 0.5
                    state.feature_middle[w, count] = (x[i] + x[j]) * 0.5
                    state.feature_half[w, count] = wp.vec3(wp.abs(half[0]), wp.abs(half[1]), wp.abs(half[2]))
                    state.feature_velocity[w, count] = (state.velocity[w, i] + state.velocity[w, j]) * 0.5
                    count += 1
    state.features[w] = count


@wp.func
def memory_place(e: int, g: int):
    """Return the hash of a pair of edges: the place in the hash table `memory` where its search begins."""
    return (e * 1031 + g * 17) & (MEMORY - 1)


@wp.func
def remember_pairs(state: State, w: int):
    """Copy the current pairs and index them by their edges in a hash table, for use while new pairs are listed."""
    for place in range(MEMORY):
        state.memory[w, place] = 0
    for k in range(state.pairs[w]):
        e = state.pair[w, k, 0]
        g = state.pair[w, k, 1]
        state.pair_before[w, k, 0] = e
        state.pair_before[w, k, 1] = g
        state.pair_before[w, k, 2] = state.pair[w, k, 2]
        state.pair_gap_before[w, k] = state.pair_gap[w, k]
        place = memory_place(e, g)
        while state.memory[w, place] != 0:
            place = (place + 1) & (MEMORY - 1)
        state.memory[w, place] = k + 1


@wp.func
def remembered_pair(state: State, w: int, e: int, g: int):
    """Return the index of these edges' pair in the previous list, or -1 if they were not in it."""
    place = memory_place(e, g)
    while state.memory[w, place] != 0:
        k = state.memory[w, place] - 1
        if state.pair_before[w, k, 0] == e and state.pair_before[w, k, 1] == g:
            return k
        place = (place + 1) & (MEMORY - 1)
    return -1


@wp.func
def gap_of_pair(x: Vectors, columns: int, spacing: float, thickness: float, e: int, g: int, allowance: float):
    """Return (side, gap) of two edges; the gap is in metres, at most the thickness.

    The side is 1 or -1, 0 if the edges are parallel and within reach, and 2 if they are out of reach or share a vertex.
    """
    a0 = e / 3
    a1 = edge_end(e, columns)
    b0 = g / 3
    b1 = edge_end(g, columns)
    if a0 == b0 or a0 == b1 or a1 == b0 or a1 == b1:
        return wp.vec2(2.0, 0.0)
    reach = thickness + allowance
    d1 = x[a1] - x[a0]
    d2 = x[b1] - x[b0]
    r = x[b0] - x[a0]
    normal = wp.cross(d1, d2)
    squared = wp.dot(normal, normal)
    if squared < PARALLEL * wp.dot(d1, d1) * wp.dot(d2, d2):
        m = r + (d2 - d1) * 0.5
        along = wp.dot(m, d1)
        if wp.dot(m, m) - along * along / wp.dot(d1, d1) < reach * reach:
            return wp.vec2(0.0, thickness)
        return wp.vec2(2.0, 0.0)
    # Most edges are out of reach; these tests reject them without a division.
    height = -wp.dot(r, normal)
    if height * height >= reach * reach * squared:
        return wp.vec2(2.0, 0.0)
    slack = (0.1 + allowance / spacing) * squared
    s = wp.dot(wp.cross(r, d2), normal)
    if s <= -slack or s >= squared + slack:
        return wp.vec2(2.0, 0.0)
    t = wp.dot(wp.cross(r, d1), normal)
    if t <= -slack or t >= squared + slack:
        return wp.vec2(2.0, 0.0)
    above = wp.where(height >= 0.0, 1.0, -1.0)
    if s > 0.0 and s < squared and t > 0.0 and t < squared:
        return wp.vec2(above, wp.min(wp.abs(height) / wp.sqrt(squared), thickness))
    return wp.vec2(above, thickness)


@wp.func
def find_pair(solver: Solver, state: State, w: int, e: int, g: int, allowance: float, count: int):
    """Append the pair of edges e and g to the list if they may touch, and return the new number of pairs."""
    found = gap_of_pair(state.position[w], solver.columns, solver.spacing, solver.thickness, e, g, allowance)
    side = int(found[0])
    kept = found[1]
    if side == 2:
        return count
    if side != 0 and kept < solver.thickness:
        before = remembered_pair(state, w, e, g)
        if before >= 0:
            kept = state.pair_gap_before[w, before]
            if state.pair_before[w, before, 2] != 0:
                side = state.pair_before[w, before, 2]
    state.found[w, count, 0] = e
    state.found[w, count, 1] = g
    state.found[w, count, 2] = side
    state.found_gap[w, count] = kept
    return count + 1


@wp.func
def sort_pairs(solver: Solver, state: State, w: int, count: int):
    """Sort the pairs by their edges, so that a remade list is solved in the same order as the last one."""
    edges = 3 * solver.rows * solver.columns
    for e in range(edges):
        state.cell[w, e] = 0
    for k in range(count):
        state.cell[w, state.found[w, k, 0]] += 1
    start = int(0)
    for e in range(edges):
        start += state.cell[w, e]
        state.cell[w, e] = start - state.cell[w, e]
    for k in range(count):
        e = state.found[w, k, 0]
        place = state.cell[w, e]
        state.cell[w, e] = place + 1
        state.pair[w, place, 0] = e
        state.pair[w, place, 1] = state.found[w, k, 1]
        state.pair[w, place, 2] = state.found[w, k, 2]
        state.pair_gap[w, place] = state.found_gap[w, k]
    # Only now: before all are placed, places of other edges hold pairs of an earlier list.
    first = int(0)
    for e in range(edges):
        end = state.cell[w, e]
        for k in range(first + 1, end):
            g = state.pair[w, k, 1]
            side = state.pair[w, k, 2]
            gap = state.pair_gap[w, k]
            place = int(k)
            while place > first and state.pair[w, wp.max(place - 1, 0), 1] > g:
                state.pair[w, place, 1] = state.pair[w, place - 1, 1]
                state.pair[w, place, 2] = state.pair[w, place - 1, 2]
                state.pair_gap[w, place] = state.pair_gap[w, place - 1]
                place -= 1
            state.pair[w, place, 1] = g
            state.pair[w, place, 2] = side
            state.pair_gap[w, place] = gap
        first = end
    state.pairs[w] = count


@wp.func
def list_pairs(solver: Solver, state: State, w: int, everywhere: bool):
    """List the pairs of feature edges (of all edges with `everywhere`) that may touch within the prediction time.

    If the edges of a new pair are already closer than the thickness, because they have only now
    become feature edges, the pair's stored gap starts at their distance and grows slowly, to avoid an abrupt push.
    """
    remember_pairs(state, w)
    mark_bends(solver, state, w)
    list_features(solver, state, w, everywhere)
    sort_features(solver, state, w)
    low = state.low[w]
    count = int(0)
    for own in range(state.features[w]):
        e = state.edge[w, own]
        middle = state.edge_middle[w, own]
        half = state.edge_half[w, own]
        velocity = state.edge_velocity[w, own]
        speed = state.edge_speed[w, own]
        row = cell_row(solver, low, middle)
        column = cell_column(solver, low, middle)
        for near in range(row - 1, row + 1):
            cell = near * CELLS + column
            # In the same row, only earlier edges are visited, so that every pair is found once.
            end = wp.where(near == row, own, state.edge_first[w, cell + 2])
            for other in range(state.edge_first[w, cell - 1], end):
                d = state.edge_middle[w, other] - middle
                room = half + state.edge_half[w, other]
                apart = wp.max(wp.max(wp.abs(d[0]) - room[0], wp.abs(d[1]) - room[1]), wp.abs(d[2]) - room[2])
                apart = apart - solver.thickness - solver.margin
                if apart < solver.prediction_time * (speed + state.edge_speed[w, other]) and count < EDGE_PAIRS:
                    relative = wp.length(state.edge_velocity[w, other] - velocity)
                    if apart < solver.prediction_time * relative:
                        g = state.edge[w, other]
                        allowance = solver.margin + solver.prediction_time * relative
                        count = find_pair(solver, state, w, wp.min(e, g), wp.max(e, g), allowance, count)
    sort_pairs(solver, state, w, count)


@wp.func
def solve_pair(solver: Solver, state: State, w: int, k: int):
    """Push the two edges of a pair apart, on the pair's stored side; update the side while the edges do not overlap.

    There is no friction here. The friction of nearby vertices holds the layers, and friction that is applied before
    the other contacts are solved makes layers creep.
    """
    e = state.pair[w, k, 0]
    g = state.pair[w, k, 1]
    a0 = e / 3
    a1 = edge_end(e, solver.columns)
    b0 = g / 3
    b1 = edge_end(g, solver.columns)
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
    kept = state.pair_gap[w, k]
    if kept < solver.thickness:
        kept = wp.min(kept + solver.gap_growth, solver.thickness)
        state.pair_gap[w, k] = kept
    if gap >= kept or gap < -2.0 * solver.thickness:
        return
    p0 = x[a0]
    p1 = x[a1]
    q0 = x[b0]
    q1 = x[b1]
    normal = wp.normalize(wp.cross(p1 - p0, q1 - q0)) * side
    moved_a = (p0 - state.previous[w, a0]) * (1.0 - s) + (p1 - state.previous[w, a1]) * s
    moved_b = (q0 - state.previous[w, b0]) * (1.0 - t) + (q1 - state.previous[w, b1]) * t
    approach = wp.dot(moved_a - moved_b, normal)
    push = parting(solver, kept - gap, approach)
    wa0 = state.free[w, a0] * (1.0 - s)
    wa1 = state.free[w, a1] * s
    wb0 = state.free[w, b0] * (1.0 - t)
    wb1 = state.free[w, b1] * t
    scale = 1.0 / ((1.0 - s) * wa0 + s * wa1 + (1.0 - t) * wb0 + t * wb1 + 1.0e-9)
    out = normal * (push * scale)
    x[a0] = p0 + out * wa0
    x[a1] = p1 + out * wa1
    x[b0] = q0 - out * wb0
    x[b1] = q1 - out * wb1


@wp.func
def solve_pairs(solver: Solver, state: State, w: int):
    """Solve all listed contacts of edges with edges."""
    for k in range(state.pairs[w]):
        solve_pair(solver, state, w, k)
