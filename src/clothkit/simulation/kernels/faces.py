"""Contacts of vertices with triangles: lists of nearby quads with a side each, and their solution with friction."""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change; `in` and `and` are its own.
# ruff: noqa: RUF046, UP018
import warp as wp

from clothkit.simulation.kernels.state import CONTACTS, Solver, State, Vectors, cell_at, cell_of, synchronise


@wp.func
def remembered_side(state: State, w: int, vertex: int, count: int, row: int, column: int, side: int):
    """Return the side (1 or -1) on which the vertex was of this quad or a neighbour of it, 0 when unknown."""
    found = int(0)
    for k in range(count):
        entry = state.contact_before[w, vertex, k]
        quad = wp.abs(entry) - 1
        if found == 0 and wp.abs(quad / side - row) <= 1 and wp.abs(quad % side - column) <= 1:
            found = wp.where(entry > 0, 1, -1)
    return found


@wp.func
def insert_quads(solver: Solver, state: State, w: int, lane: int, lanes: int, per_metre: float):
    """Put the quads into the hash grid by their centres."""
    n = solver.side
    for quad in range(lane, n * n, lanes):
        state.quad_head[w, state.quad_cell[w, quad]] = -1
    synchronise()
    for quad in range(lane, n * n - n, lanes):
        if quad % n < n - 1:
            p00 = state.position[w, quad]
            p01 = state.position[w, quad + 1]
            p10 = state.position[w, quad + n]
            p11 = state.position[w, quad + n + 1]
            centre = (p00 + p01 + p10 + p11) * 0.25
            normal = wp.cross(p11 - p00 + p10 - p01, p11 - p00 + p01 - p10)
            cell = cell_at(centre, per_metre)
            state.quad_cell[w, quad] = cell
            state.quad_centre[w, quad] = centre
            state.quad_normal[w, quad] = normal / (wp.length(normal) + 1.0e-12)
            state.quad_velocity[w, quad] = (state.velocity[w, quad] + state.velocity[w, quad + n + 1]) * 0.5
            state.quad_next[w, quad] = wp.atomic_exch(state.quad_head, w, cell, quad)
    synchronise()


@wp.func
def spans(solver: Solver, x: Vectors, quad: int, r: wp.vec3, reach: float):
    """Return whether the point r from the quad's centre lies over the quad, within reach."""
    n = solver.side
    down = x[quad + n + 1] - x[quad]
    right = x[quad + n] - x[quad + 1]
    e1 = (down + right) * 0.5
    e2 = (down - right) * 0.5
    a11 = wp.dot(e1, e1)
    a12 = wp.dot(e1, e2)
    a22 = wp.dot(e2, e2)
    b1 = wp.dot(r, e1)
    b2 = wp.dot(r, e2)
    limit = (0.56 + reach / solver.spacing) * (a11 * a22 - a12 * a12 + 1.0e-14)
    return wp.abs(b1 * a22 - b2 * a12) < limit and wp.abs(b2 * a11 - b1 * a12) < limit


@wp.func
def list_contacts(solver: Solver, state: State, w: int, lane: int, lanes: int):
    """List for every vertex the quads that it may touch within the prediction time; its own four are left out."""
    n = solver.side
    cell_side = 1.4 * solver.spacing
    per_metre = 1.0 / cell_side
    insert_quads(solver, state, w, lane, lanes, per_metre)
    position = state.position[w]
    for i in range(lane, n * n, lanes):
        x = state.position[w, i]
        v = state.velocity[w, i]
        state.list_position[w, i] = x
        state.list_velocity[w, i] = v
        before = state.contacts[w, i]
        for k in range(before):
            state.contact_before[w, i, k] = state.contact[w, i, k]
        count = int(0)
        cx = int(wp.floor(x[0] * per_metre))
        cy = int(wp.floor(x[1] * per_metre))
        cz = int(wp.floor(x[2] * per_metre))
        for ox in range(-1, 2):
            for oy in range(-1, 2):
                for oz in range(-1, 2):
                    quad = state.quad_head[w, cell_of(cx + ox, cy + oy, cz + oz)]
                    while quad >= 0:
                        r = x - state.quad_centre[w, quad]
                        if wp.dot(r, r) < cell_side * cell_side and count < CONTACTS:
                            gap = wp.dot(r, state.quad_normal[w, quad])
                            relative = wp.length(v - state.quad_velocity[w, quad])
                            reach = solver.margin + solver.prediction_time * relative
                            own = i == quad or i == quad + 1 or i == quad + n or i == quad + n + 1
                            if (
                                wp.abs(gap) < solver.thickness + reach
                                and not own
                                and spans(solver, position, quad, r, reach)
                            ):
                                side = wp.where(gap >= 0.0, 1, -1)
                                if wp.abs(gap) < solver.memory_gap:
                                    remembered = remembered_side(state, w, i, before, quad / n, quad % n, n)
                                    side = wp.where(remembered != 0, remembered, side)
                                state.contact[w, i, count] = side * (quad + 1)
                                count += 1
                        quad = state.quad_next[w, quad]
        state.contacts[w, i] = count
    synchronise()


@wp.func
def solve_contact(solver: Solver, state: State, w: int, i: int, entry: int, lanes: int):
    """Push a vertex and the triangle under it apart to the cloth's thickness, with Coulomb friction."""
    position = state.position[w]
    previous = state.previous[w]
    free = state.free[w]
    n = solver.side
    thickness = solver.thickness
    sign = wp.where(entry > 0, 1.0, -1.0)
    a = wp.abs(entry) - 1
    c = a + n + 1
    p00 = position[a]
    p01 = position[a + 1]
    p10 = position[a + n]
    p11 = position[c]
    x = position[i]
    e1 = (p10 - p00 + p11 - p01) * 0.5
    e2 = (p01 - p00 + p11 - p10) * 0.5
    r = x - (p00 + p01 + p10 + p11) * 0.25
    normal = wp.cross(e1, e2)
    height = sign * wp.dot(r, normal)
    if height > 0.0 and height * height > 2.25 * thickness * thickness * (wp.dot(normal, normal) + 1.0e-20):
        return
    a11 = wp.dot(e1, e1)
    a12 = wp.dot(e1, e2)
    a22 = wp.dot(e2, e2)
    scale = 1.0 / (a11 * a22 - a12 * a12 + 1.0e-14)
    b1 = wp.dot(r, e1)
    b2 = wp.dot(r, e2)
    along = (b1 * a22 - b2 * a12) * scale
    across = (b2 * a11 - b1 * a12) * scale
    if wp.abs(along) > 0.56 or wp.abs(across) > 0.56:
        return
    upper = across >= along
    b = wp.where(upper, a + 1, a + n)
    p1 = wp.where(upper, p01, p10)
    side1 = p1 - p00
    side2 = p11 - p00
    face = wp.cross(side1, side2) * wp.where(upper, -sign, sign)
    face = face / (wp.length(face) + 1.0e-12)
    ra = x - p00
    gap = wp.dot(ra, face)
    if gap >= thickness or gap < -2.0 * thickness:
        return
    d00 = wp.dot(side1, side1)
    d01 = wp.dot(side1, side2)
    d11 = wp.dot(side2, side2)
    d20 = wp.dot(ra, side1)
    d21 = wp.dot(ra, side2)
    scale = 1.0 / (d00 * d11 - d01 * d01 + 1.0e-16)
    fb = (d11 * d20 - d01 * d21) * scale
    fc = (d00 * d21 - d01 * d20) * scale
    fa = 1.0 - fb - fc
    if fa < -0.06 or fb < -0.06 or fc < -0.06:
        return
    before = previous[a] * fa + previous[b] * fb + previous[c] * fc
    slip = (x - previous[i]) - (p00 * fa + p1 * fb + p11 * fc - before)
    approach = wp.dot(slip, face)
    slip = slip - face * approach
    push = wp.min(thickness - gap, wp.max(0.0, -approach) * 2.0 + solver.push_step)
    friction = wp.min(1.0, solver.cloth_friction * push / (wp.length(slip) + 1.0e-12))
    wa = free[a] * fa
    wb = free[b] * fb
    wc = free[c] * fc
    wi = free[i]
    out = (face * push - slip * friction) / (wi + fa * wa + fb * wb + fc * wc + 1.0e-9)
    state.touching[w, i] = 1
    state.touching[w, a] = 1
    if lanes == 1:
        position[a] = p00 - out * wa
        position[b] = p1 - out * wb
        position[c] = p11 - out * wc
        position[i] = x + out * wi
    else:
        wp.atomic_sub(state.correction, w, a, out * wa)
        wp.atomic_sub(state.correction, w, b, out * wb)
        wp.atomic_sub(state.correction, w, c, out * wc)
        wp.atomic_add(state.correction, w, i, out * wi)


@wp.func
def solve_contacts(solver: Solver, state: State, w: int, lane: int, lanes: int):
    """Solve the listed contacts of vertices with triangles."""
    for i in range(lane, solver.side * solver.side, lanes):
        for k in range(state.contacts[w, i]):
            solve_contact(solver, state, w, i, state.contact[w, i, k], lanes)
    synchronise()
