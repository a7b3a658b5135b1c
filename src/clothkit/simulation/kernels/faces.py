"""Contacts of vertices with triangles: each vertex's list of nearby quads with its side, and the contact solver."""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp

from clothkit.simulation.kernels.search import cell_column, cell_row, sort_heights, sort_quads
from clothkit.simulation.kernels.state import CELLS, CONTACTS, Solver, State, Vectors


@wp.func
def remembered_side(state: State, w: int, vertex: int, count: int, quad: int):
    """Return the vertex's side (1 or -1) of a quad in the previous contact list, or 0 if the quad was not in it."""
    for k in range(count):
        entry = state.contact_before[w, vertex, k]
        if wp.abs(entry) - 1 == quad:
            return wp.where(entry > 0, 1, -1)
    return 0


@wp.func
def distance_beyond(x: Vectors, quad: int, n: int, r: wp.vec3):
    """Return how far a point lies outside the quad's outline, as a fraction of the quad's side there; negative inside.

    r is the point's offset from the quad's centre, in metres.
    """
    down = x[quad + n + 1] - x[quad]
    right = x[quad + n] - x[quad + 1]
    e1 = (down + right) * 0.5
    e2 = (down - right) * 0.5
    a11 = wp.dot(e1, e1)
    a12 = wp.dot(e1, e2)
    a22 = wp.dot(e2, e2)
    b1 = wp.dot(r, e1)
    b2 = wp.dot(r, e2)
    scale = 1.0 / (a11 * a22 - a12 * a12 + 1.0e-14)
    return wp.max(wp.abs(b1 * a22 - b2 * a12), wp.abs(b2 * a11 - b1 * a12)) * scale - 0.5


@wp.func
def share_along(p: wp.vec3, a: wp.vec3, b: wp.vec3):
    """Return the position on the segment a-b that is nearest to p, as a fraction 0..1 of the segment."""
    d = b - a
    return wp.clamp(wp.dot(p - a, d) / (wp.dot(d, d) + 1.0e-16), 0.0, 1.0)


@wp.func
def nearest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Return the barycentric weights of the triangle's point nearest to p."""
    ab = b - a
    ac = c - a
    ap = p - a
    d00 = wp.dot(ab, ab)
    d01 = wp.dot(ab, ac)
    d11 = wp.dot(ac, ac)
    d20 = wp.dot(ap, ab)
    d21 = wp.dot(ap, ac)
    scale = 1.0 / (d00 * d11 - d01 * d01 + 1.0e-16)
    fb = (d11 * d20 - d01 * d21) * scale
    fc = (d00 * d21 - d01 * d20) * scale
    fa = 1.0 - fb - fc
    if fa >= 0.0 and fb >= 0.0 and fc >= 0.0:
        return wp.vec3(fa, fb, fc)
    best = float(1.0e6)
    weights = wp.vec3(1.0, 0.0, 0.0)
    if fc < 0.0:
        t = share_along(p, a, b)
        d = ap - ab * t
        best = wp.dot(d, d)
        weights = wp.vec3(1.0 - t, t, 0.0)
    if fb < 0.0:
        t = share_along(p, a, c)
        d = ap - ac * t
        if wp.dot(d, d) < best:
            best = wp.dot(d, d)
            weights = wp.vec3(1.0 - t, 0.0, t)
    if fa < 0.0:
        t = share_along(p, b, c)
        d = p - b - (c - b) * t
        if wp.dot(d, d) < best:
            weights = wp.vec3(0.0, 1.0 - t, t)
    return weights


@wp.func
def inside_triangle(weights: wp.vec3):
    """Return whether the point with these barycentric weights is strictly inside its triangle."""
    return weights[0] > 0.0 and weights[1] > 0.0 and weights[2] > 0.0


@wp.func
def lies_above(to_lower: wp.vec3, to_upper: wp.vec3, p00: wp.vec3, p01: wp.vec3, p10: wp.vec3, p11: wp.vec3):
    """Return whether a point is on the side of the quad's normal, by the nearer of the quad's two triangles.

    `to_lower` and `to_upper` are the vectors from the nearest point on each triangle to the point; where the distances
    are almost equal, both normals are summed.
    """
    d_lower = wp.dot(to_lower, to_lower)
    d_upper = wp.dot(to_upper, to_upper)
    diagonal = p11 - p00
    lower = wp.cross(p10 - p00, diagonal)
    upper = wp.cross(diagonal, p01 - p00)
    if wp.abs(d_lower - d_upper) < 1.0e-3 * d_lower:
        return wp.dot(to_lower, lower / wp.length(lower) + upper / wp.length(upper)) >= 0.0
    if d_lower < d_upper:
        return wp.dot(to_lower, lower) >= 0.0
    return wp.dot(to_upper, upper) >= 0.0


@wp.func
def side_of(x: Vectors, i: int, quad: int, n: int):
    """Return the side (1 or -1) of a quad on which vertex i lies now."""
    p00 = x[quad]
    p01 = x[quad + 1]
    p10 = x[quad + n]
    p11 = x[quad + n + 1]
    lower = nearest_on_triangle(x[i], p00, p10, p11)
    upper = nearest_on_triangle(x[i], p00, p11, p01)
    to_lower = x[i] - (p00 * lower[0] + p10 * lower[1] + p11 * lower[2])
    to_upper = x[i] - (p00 * upper[0] + p11 * upper[1] + p01 * upper[2])
    return wp.where(lies_above(to_lower, to_upper, p00, p01, p10, p11), 1, -1)


@wp.func
def list_contacts(solver: Solver, state: State, w: int):
    """List, for every vertex, the quads that it may touch within the prediction time, without its own four quads."""
    n = solver.columns
    sort_quads(solver, state, w)
    sort_heights(solver, state, w)
    low = state.low[w]
    largest = solver.cell * solver.cell
    position = state.position[w]
    for i in range(solver.rows * n):
        x = position[i]
        v = state.velocity[w, i]
        speed = wp.length(v)
        state.list_position[w, i] = x
        state.list_velocity[w, i] = v
        before = state.contacts[w, i]
        for k in range(before):
            state.contact_before[w, i, k] = state.contact[w, i, k]
        count = int(0)
        slot = int(0)
        row = cell_row(solver, low, x)
        column = cell_column(solver, low, x)
        for near in range(row - 1, row + 2):
            cell = near * CELLS + column
            for place in range(state.quad_first[w, cell - 1], state.quad_first[w, cell + 2]):
                r = x - state.quad_centre[w, place]
                if wp.dot(r, r) < largest:
                    gap = wp.dot(r, state.quad_normal[w, place])
                    beyond = wp.abs(gap) - state.quad_twist[w, place] - solver.thickness - solver.margin
                    if beyond < solver.prediction_time * (speed + state.quad_speed[w, place]) and count < CONTACTS:
                        quad = state.quad[w, place]
                        own = i == quad or i == quad + 1 or i == quad + n or i == quad + n + 1
                        relative = wp.length(v - state.quad_velocity[w, place])
                        outside = distance_beyond(position, quad, n, r)
                        if (
                            not own
                            and beyond < solver.prediction_time * relative
                            and outside * solver.spacing
                            < solver.thickness + solver.margin + solver.prediction_time * relative
                        ):
                            side = side_of(position, i, quad, n)
                            if wp.abs(gap) < solver.memory_gap and outside < 0.0:
                                remembered = remembered_side(state, w, i, before, quad)
                                side = wp.where(remembered != 0, remembered, side)
                            # Sorted by quad, so that a remade list is solved in the same order as the last one.
                            slot = count
                            while slot > 0 and wp.abs(state.contact[w, i, slot - 1]) > quad + 1:
                                state.contact[w, i, slot] = state.contact[w, i, slot - 1]
                                slot -= 1
                            state.contact[w, i, slot] = side * (quad + 1)
                            count += 1
        state.contacts[w, i] = count


@wp.func
def parting(solver: Solver, overlap: float, approach: float):
    """Return by how much to push a contact apart, in metres: the overlap, limited so that the push is not abrupt.

    The limit is twice the approach in this substep plus `push_step`.
    """
    return wp.min(overlap, wp.max(0.0, -approach) * 2.0 + solver.push_step)


@wp.func
def part_from_triangle(
    solver: Solver, state: State, w: int, i: int, a: int, b: int, c: int, weights: wp.vec3, side: float
):
    """Push a vertex and the nearest point of a triangle apart to the cloth's thickness, with Coulomb friction.

    If the nearest point is inside the triangle, the push is along its normal, on the given side (1: the side from which
    a, b, c run counter-clockwise). If it is on an edge, the push is along the line between the two points. This keeps
    the push continuous where the vertex slides from one triangle to the next or off the border.
    """
    position = state.position[w]
    previous = state.previous[w]
    free = state.free[w]
    thickness = solver.thickness
    pa = position[a]
    pb = position[b]
    pc = position[c]
    x = position[i]
    fa = weights[0]
    fb = weights[1]
    fc = weights[2]
    out = x - (pa * fa + pb * fb + pc * fc)
    face = wp.normalize(wp.cross(pb - pa, pc - pa)) * side
    gap = wp.dot(out, face)
    if fa > 0.0 and fb > 0.0 and fc > 0.0:
        if gap < -thickness:
            return
    else:
        if gap < 0.0:
            return
        gap = wp.length(out)
        face = out / (gap + 1.0e-12)
    if gap >= thickness:
        return
    before = previous[a] * fa + previous[b] * fb + previous[c] * fc
    slip = (x - previous[i]) - (pa * fa + pb * fb + pc * fc - before)
    approach = wp.dot(slip, face)
    slip = slip - face * approach
    push = parting(solver, thickness - gap, approach)
    friction = wp.min(1.0, solver.cloth_friction * push / (wp.length(slip) + 1.0e-12))
    wa = free[a] * fa
    wb = free[b] * fb
    wc = free[c] * fc
    wi = free[i]
    d = (face * push - slip * friction) / (wi + fa * wa + fb * wb + fc * wc + 1.0e-9)
    position[a] = pa - d * wa
    position[b] = pb - d * wb
    position[c] = pc - d * wc
    position[i] = x + d * wi


@wp.func
def solve_contact(solver: Solver, state: State, w: int, i: int, k: int):
    """Push a vertex away from both triangles of a quad, if it is near the quad.

    While the vertex is close to a triangle and its nearest point is inside it, the stored side is kept; otherwise the
    stored side is updated to the current one.
    """
    position = state.position[w]
    n = solver.columns
    entry = state.contact[w, i, k]
    a = wp.abs(entry) - 1
    p00 = position[a]
    p01 = position[a + 1]
    p10 = position[a + n]
    p11 = position[a + n + 1]
    x = position[i]
    r = x - (p00 + p01 + p10 + p11) * 0.25
    normal = wp.cross(p11 - p00 + p10 - p01, p11 - p00 + p01 - p10)
    squared = wp.dot(normal, normal) + 1.0e-20
    height = wp.dot(r, normal)
    twist = wp.abs(wp.dot(p00 - p01 - p10 + p11, normal)) * 0.25
    far = 1.5 * solver.thickness
    above = wp.max(wp.abs(height) - twist, 0.0)
    if above * above > far * far * squared:
        state.contact[w, i, k] = wp.where(height >= 0.0, a + 1, -a - 1)
        return
    lower = nearest_on_triangle(x, p00, p10, p11)
    upper = nearest_on_triangle(x, p00, p11, p01)
    to_lower = x - (p00 * lower[0] + p10 * lower[1] + p11 * lower[2])
    to_upper = x - (p00 * upper[0] + p11 * upper[1] + p01 * upper[2])
    d_lower = wp.dot(to_lower, to_lower)
    d_upper = wp.dot(to_upper, to_upper)
    nearest = wp.min(d_lower, d_upper)
    held = inside_triangle(wp.where(d_lower < d_upper, lower, upper)) and nearest < far * far
    if not held:
        noted = wp.where(lies_above(to_lower, to_upper, p00, p01, p10, p11), a + 1, -a - 1)
        state.contact[w, i, k] = noted
        entry = noted
    if nearest < solver.thickness * solver.thickness:
        side = wp.where(entry > 0, 1.0, -1.0)
        # One call site for both: Warp passes the state by value, which is cheap only where the call is inlined.
        for half in range(2):
            b = wp.where(half == 0, a + n, a + n + 1)
            c = wp.where(half == 0, a + n + 1, a + 1)
            part_from_triangle(solver, state, w, i, a, b, c, wp.where(half == 0, lower, upper), side)


@wp.func
def solve_contacts(solver: Solver, state: State, w: int):
    """Solve all listed contacts of vertices with triangles, from the lowest vertex to the highest.

    In this order friction holds a lower layer before its slip acts on the layer above. Otherwise layers drag each other
    along.
    """
    for place in range(solver.rows * solver.columns):
        i = state.upwards[w, place]
        for k in range(state.contacts[w, i]):
            solve_contact(solver, state, w, i, k)
