"""Stretch, shear and bending by XPBD, one iteration per substep, in colours: those of one colour share no vertex."""

import warp as wp

from clothkit.simulation.kernels.state import Bend, Floats, Solver, State, Vectors


@wp.func
def keep_distance(x: Vectors, free: Floats, i: int, j: int, rest: float, compliance: float):
    """Move two vertices towards their rest distance `rest`, in metres (one XPBD distance constraint)."""
    wi = free[i]
    wj = free[j]
    xi = x[i]
    xj = x[j]
    d = xj - xi
    length = wp.length(d)
    s = (length - rest) / ((wi + wj + compliance) * length + 1.0e-12)
    x[i] = xi + d * (wi * s)
    x[j] = xj - d * (wj * s)


@wp.func
def keep_edge(
    solver: Solver,
    x: Vectors,
    previous: Vectors,
    free: Floats,
    before: int,
    stride: int,
    rest: float,
    compliance: float,
    chord_compliance: float,
):
    """Keep the ends of a grid edge at its length `rest`, in metres, or let it be the chord of a bent thread.

    `before` is the vertex before the edge on its grid line, whose vertices are `stride` apart. If the line turns by an
    angle from the edge before to the edge after this one, and does so within it, as where a fold runs between two
    vertices, its ends are as near as cos(angle / 2) times its length. If edges could not be so short, those in a fold
    would stand upright or lean to either side: folds would be tall and wavy, and lock at an angle to the grid.
    """
    i = before + stride
    j = i + stride
    wi = free[i]
    wj = free[j]
    xi = x[i]
    xj = x[j]
    d = xj - xi
    length = wp.length(d)
    if length < rest:
        turn = wp.dot(previous[i] - previous[before], previous[j + stride] - previous[j]) / (rest * rest)
        chord = wp.sqrt(wp.clamp(0.5 + 0.5 * turn, solver.shortest_chord * solver.shortest_chord, 1.0))
        rest = wp.max(length, chord * rest)
        compliance = chord_compliance
    s = (length - rest) / ((wi + wj + compliance) * length + 1.0e-12)
    x[i] = xi + d * (wi * s)
    x[j] = xj - d * (wj * s)


@wp.func
def bend(settings: Bend, x: Vectors, previous: Vectors, free: Floats, i: int, j: int, k: int):
    """Apply the bending constraint of three successive vertices i, j, k of a grid line.

    The bending moment saturates, dry friction resists changes of the bend, and the outer vertices are kept at least
    `crease_length` apart.
    """
    wi = free[i]
    wj = free[j]
    wk = free[k]
    xi = x[i]
    xj = x[j]
    xk = x[k]
    weight = wi + 4.0 * wj + wk + 1.0e-9
    c = xi - 2.0 * xj + xk
    squared = wp.dot(c, c)
    compliance = settings.compliance
    if squared > settings.saturation * settings.saturation:
        compliance = compliance * (wp.sqrt(squared) / settings.saturation)
    multiplier = c * (1.0 / (weight + compliance))
    if settings.friction > 0.0:
        change = (c - previous[i] + 2.0 * previous[j] - previous[k]) * (1.0 / weight) - multiplier
        squared = wp.dot(change, change)
        if squared > settings.friction * settings.friction:
            change = change * (settings.friction / wp.sqrt(squared))
        multiplier = multiplier + change
    xi = xi - multiplier * wi
    xk = xk - multiplier * wk
    d = xk - xi
    squared = wp.dot(d, d)
    if squared < settings.crease_length * settings.crease_length:
        length = wp.sqrt(squared) + 1.0e-9
        s = (length - settings.crease_length) / ((wi + wk + settings.crease_compliance) * length)
        xi = xi + d * (wi * s)
        xk = xk - d * (wk * s)
    x[i] = xi
    x[j] = xj + multiplier * (2.0 * wj)
    x[k] = xk


@wp.func
def solve_bending(solver: Solver, state: State, w: int):
    """Solve the bending constraints along both directions of the grid, in three colours each."""
    x = state.position[w]
    previous = state.previous[w]
    free = state.free[w]
    rows = solver.rows
    n = solver.columns
    for colour in range(3):
        for i in range(colour, rows - 2, 3):
            for j in range(n):
                a = i * n + j
                bend(solver.bend_u, x, previous, free, a, a + n, a + 2 * n)
        for i in range(rows):
            for j in range(colour, n - 2, 3):
                a = i * n + j
                bend(solver.bend_v, x, previous, free, a, a + 1, a + 2)


@wp.func
def shear(solver: Solver, x: Vectors, free: Floats, i: int, j: int):
    """Shorten a quad's diagonal that is longer than at rest, and keep its length within the allowed range.

    Shear in either direction lengthens one of the quad's diagonals; a fold across the quad shortens a diagonal. Pulling
    only lengthened diagonals resists shear without resisting folds, which would otherwise stay locked and tall.
    """
    wi = free[i]
    wj = free[j]
    xi = x[i]
    xj = x[j]
    d = xj - xi
    squared = wp.dot(d, d)
    rest = solver.spacing_u * solver.diagonal
    if squared <= rest * rest and squared >= solver.diagonal_shortest * solver.diagonal_shortest:
        return
    length = wp.sqrt(squared) + 1.0e-12
    weight = wi + wj + 1.0e-9
    multiplier = wp.max(length - rest, 0.0) / (weight + solver.shear_compliance)
    after = length - multiplier * weight
    multiplier += (after - wp.clamp(after, solver.diagonal_shortest, solver.diagonal_longest)) / (weight + 1.0)
    s = multiplier / length
    x[i] = xi + d * (wi * s)
    x[j] = xj - d * (wj * s)


@wp.func
def solve_shear(solver: Solver, state: State, w: int):
    """Solve the shear constraints of all quads, both diagonals, in two colours each."""
    x = state.position[w]
    free = state.free[w]
    rows = solver.rows
    n = solver.columns
    for colour in range(2):
        for i in range(colour, rows - 1, 2):
            for j in range(n - 1):
                a = i * n + j
                shear(solver, x, free, a, a + n + 1)
        for i in range(colour, rows - 1, 2):
            for j in range(n - 1):
                a = i * n + j
                shear(solver, x, free, a + 1, a + n)


@wp.func
def solve_stretch(solver: Solver, state: State, w: int):
    """Solve the distance constraints of all grid edges, in two colours per direction."""
    x = state.position[w]
    previous = state.previous[w]
    free = state.free[w]
    rows = solver.rows
    n = solver.columns
    for colour in range(2):
        rest = solver.spacing_u
        for i in range(colour, rows - 1, 2):
            for j in range(n):
                a = i * n + j
                if i > 0 and i < rows - 2:
                    keep_edge(solver, x, previous, free, a - n, n, rest, solver.stretch_u, solver.chord_u)
                else:
                    keep_distance(x, free, a, a + n, rest, solver.stretch_u)
        rest = solver.spacing_v
        for i in range(rows):
            for j in range(colour, n - 1, 2):
                a = i * n + j
                if j > 0 and j < n - 2:
                    keep_edge(solver, x, previous, free, a - 1, 1, rest, solver.stretch_v, solver.chord_v)
                else:
                    keep_distance(x, free, a, a + 1, rest, solver.stretch_v)
