"""Untangling at the end of a manipulation: where an edge pierces a triangle, the two are pushed the shortest way out.

It clears pokes of a few pairs and fails on tangles of dozens. Serial per world: launch it with one lane.
"""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change; `in` and `and` are its own.
# ruff: noqa: RUF046, SIM109, UP018
import warp as wp

from clothkit.simulation.kernels.edges import inside, nearest_on_lines
from clothkit.simulation.kernels.elasticity import solve_stretch
from clothkit.simulation.kernels.faces import insert_quads
from clothkit.simulation.kernels.state import Solver, State, Vectors, cell_of, edge_end


@wp.func
def part(x: Vectors, i: int, j: int, t: float, a: int, b: int, c: int, weights: wp.vec3, d: wp.vec3):
    """Move the point t of the edge i-j by d relative to the triangle's point of these weights."""
    s = 1.0 - t
    step = d / (s * s + t * t + wp.dot(weights, weights))
    x[i] = x[i] + step * s
    x[j] = x[j] + step * t
    x[a] = x[a] - step * weights[0]
    x[b] = x[b] - step * weights[1]
    x[c] = x[c] - step * weights[2]


@wp.func
def way_past(x: Vectors, i: int, j: int, a: int, b: int):
    """Return the distance between the lines of an edge and a triangle's side, large where it lies outside of them."""
    near = nearest_on_lines(x, i, j, a, b)
    if near[3] > 0.0 or not inside(near[0], near[1], 0.02):
        return 1.0e3
    return wp.abs(near[2])


@wp.func
def part_edges(x: Vectors, i: int, j: int, a: int, b: int, slack: float):
    """Move an edge past a side of the triangle."""
    near = nearest_on_lines(x, i, j, a, b)
    d1 = x[j] - x[i]
    d2 = x[b] - x[a]
    normal = wp.normalize(wp.cross(d1, d2))
    d = normal * (-near[2] - wp.where(near[2] >= 0.0, slack, -slack))
    part(x, i, j, near[0], a, b, b, wp.vec3(1.0 - near[1], near[1], 0.0), d)


@wp.func
def untangle_pair(x: Vectors, i: int, j: int, a: int, b: int, c: int, slack: float):
    """Return 1 when the edge i-j pierces the triangle a-b-c; then part them the shortest way."""
    if i == a or i == b or i == c or j == a or j == b or j == c:
        return 0
    p = x[i]
    q = x[j]
    origin = x[a]
    e1 = x[b] - origin
    e2 = x[c] - origin
    normal = wp.cross(e1, e2)
    dp = wp.dot(p - origin, normal)
    dq = wp.dot(q - origin, normal)
    if dp * dq > 0.0:
        return 0
    r = p + (q - p) * (dp / (dp - dq + 1.0e-30)) - origin
    squared = wp.dot(normal, normal) + 1.0e-30
    fb = wp.dot(wp.cross(r, e2), normal) / squared
    fc = wp.dot(wp.cross(e1, r), normal) / squared
    fa = 1.0 - fb - fc
    if fa < 0.0 or fb < 0.0 or fc < 0.0:
        return 0
    length = wp.sqrt(squared)
    over_p = wp.abs(dp) / length
    over_q = wp.abs(dq) / length
    past_ab = way_past(x, i, j, a, b)
    past_bc = way_past(x, i, j, b, c)
    past_ca = way_past(x, i, j, c, a)
    past = wp.min(past_ab, wp.min(past_bc, past_ca))
    weights = wp.vec3(fa, fb, fc)
    if past < wp.min(over_p, over_q):
        if past_ab == past:
            part_edges(x, i, j, a, b, slack)
        elif past_bc == past:
            part_edges(x, i, j, b, c, slack)
        else:
            part_edges(x, i, j, c, a, slack)
    elif over_p < over_q:
        d = normal * (wp.where(dp > 0.0, -1.0, 1.0) * (over_p + slack) / length)
        part(x, i, j, 0.0, a, b, c, weights, d)
    else:
        d = normal * (wp.where(dq > 0.0, -1.0, 1.0) * (over_q + slack) / length)
        part(x, i, j, 1.0, a, b, c, weights, d)
    return 1


@wp.func
def untangle_edge(solver: Solver, state: State, w: int, i: int, j: int, per_metre: float, slack: float):
    """Return how many triangles the edge i-j pierced; they are parted."""
    n = solver.side
    x = state.position[w]
    middle = (x[i] + x[j]) * 0.5
    cx = int(wp.floor(middle[0] * per_metre))
    cy = int(wp.floor(middle[1] * per_metre))
    cz = int(wp.floor(middle[2] * per_metre))
    found = int(0)
    for ox in range(-1, 2):
        for oy in range(-1, 2):
            for oz in range(-1, 2):
                quad = state.quad_head[w, cell_of(cx + ox, cy + oy, cz + oz)]
                while quad >= 0:
                    r = middle - state.quad_centre[w, quad]
                    if wp.dot(r, r) < 2.1 * solver.spacing * solver.spacing:
                        found += untangle_pair(x, i, j, quad, quad + 1, quad + n + 1, slack)
                        found += untangle_pair(x, i, j, quad, quad + n + 1, quad + n, slack)
                    quad = state.quad_next[w, quad]
    return found


@wp.kernel
def untangle(solver: Solver, state: State, sweeps: int, slack: float):
    """Part what is pierced, sweep after sweep; after the first, only around what the last sweep found.

    `state.pierced` gets the number of pierced triangles found by the first sweep and by the last.
    """
    w = wp.tid()
    n = solver.side
    per_metre = 1.0 / (1.45 * solver.spacing)
    far = wp.vec3(1.0e3, 1.0e3, 1.0e3)
    low = -far
    high = far
    everywhere = bool(True)
    state.pierced[w, 0] = 0
    state.pierced[w, 1] = 0
    for sweep in range(sweeps):
        insert_quads(solver, state, w, 0, 1, per_metre)
        found = int(0)
        new_low = far
        new_high = -far
        for i in range(n * n):
            row = i / n
            column = i % n
            for kind in range(3):
                if (kind == 1 or row < n - 1) and (kind == 0 or column < n - 1):
                    j = edge_end(3 * i + kind, n)
                    m = (state.position[w, i] + state.position[w, j]) * 0.5
                    if wp.min(m, low) == low and wp.max(m, high) == high:
                        here = untangle_edge(solver, state, w, i, j, per_metre, slack)
                        if here > 0:
                            found += here
                            new_low = wp.min(new_low, m)
                            new_high = wp.max(new_high, m)
        if sweep == 0:
            state.pierced[w, 0] = found
        state.pierced[w, 1] = found
        if found == 0 and everywhere:
            break
        everywhere = found == 0
        low = -far
        high = far
        if found > 0:
            pad = 1.6 * solver.spacing
            low = new_low - wp.vec3(pad, pad, pad)
            high = new_high + wp.vec3(pad, pad, pad)
        for i in range(n * n):
            x = state.position[w, i]
            state.position[w, i] = wp.vec3(x[0], x[1], wp.max(x[2], 0.5 * solver.thickness))
        if sweep < sweeps - 6 and sweep % 3 == 2:
            solve_stretch(solver, state, w, 0, 1)
