"""The time loop: motion, hands, elasticity, contacts, table, and the check for rest, for a launch's substeps."""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change; `in` and `and` are its own.
# ruff: noqa: SIM102, UP018
import warp as wp

from clothkit.simulation.kernels.edges import list_pairs, solve_pairs
from clothkit.simulation.kernels.elasticity import solve_bending, solve_stretch
from clothkit.simulation.kernels.faces import list_contacts, solve_contacts
from clothkit.simulation.kernels.state import Solver, State, synchronise


@wp.func
def neighbours_difference(state: State, w: int, i: int, n: int, v: wp.vec3):
    """Return the sum of the velocities of a vertex's neighbours relative to its own."""
    row = i / n
    column = i % n
    total = wp.vec3(0.0, 0.0, 0.0)
    if row > 0:
        total = total + state.velocity[w, i - n] - v
    if row < n - 1:
        total = total + state.velocity[w, i + n] - v
    if column > 0:
        total = total + state.velocity[w, i - 1] - v
    if column < n - 1:
        total = total + state.velocity[w, i + 1] - v
    return total


@wp.func
def move(solver: Solver, state: State, w: int, lane: int, lanes: int, since: float, top_speed: float):
    """Move the vertices freely for a substep, and note how far they are from where the lists were made for.

    `since` is the time since release, negative before. After release what stands high is pulled down harder: this
    pressing is no physics, but the states are equilibria under it.
    """
    dt = solver.time_step
    drag = wp.where(since <= 0.0, solver.drag_moving, solver.drag_settling * (1.0 + solver.drag_growth * since))
    damping = 1.0 / (1.0 + drag * dt)
    age = state.list_age[w] + dt
    deviation = float(0.0)
    motion = float(0.0)
    for i in range(lane, solver.side * solver.side, lanes):
        x = state.position[w, i]
        state.previous[w, i] = x
        v = state.velocity[w, i]
        v = v + neighbours_difference(state, w, i, solver.side, v) * (0.25 * solver.viscosity)
        pull = float(1.0)
        if since > 0.0:
            pull = solver.settle_gravity + wp.min(
                solver.press_gain * wp.max(x[2] - solver.press_height, 0.0), solver.press_limit
            )
        v = (v - wp.vec3(0.0, 0.0, solver.gravity * pull * dt)) * damping
        speed = wp.length(v)
        if speed > top_speed:
            v = v * (top_speed / speed)
        x = x + v * (dt * state.free[w, i])
        state.position[w, i] = x
        d = x - state.list_position[w, i]
        motion = wp.max(motion, wp.dot(d, d))
        d = d - state.list_velocity[w, i] * age
        deviation = wp.max(deviation, wp.dot(d, d))
    if lane == 0:
        state.deviation[w] = 0.0
        state.motion[w] = 0.0
    synchronise()
    wp.atomic_max(state.deviation, w, deviation)
    wp.atomic_max(state.motion, w, motion)


@wp.func
def move_hands(state: State, w: int, lane: int, lanes: int, t: float):
    """Put the grasped vertices where the hands are on their arcs (section 4.2.2), or release them."""
    for k in range(lane, 2, lanes):
        i = state.hand_vertex[w, k]
        if i >= 0:
            tau = t / state.move_time[w]
            if tau <= 1.0:
                angle = state.hand_angle[w, k] * tau * tau * (3.0 - 2.0 * tau)
                radius = state.hand_radius[w, k]
                state.free[w, i] = 0.0
                state.position[w, i] = (
                    state.hand_start[w, k]
                    + state.hand_direction[w, k] * (radius * (1.0 - wp.cos(angle)))
                    + wp.vec3(0.0, 0.0, radius * wp.sin(angle))
                )
            else:
                state.free[w, i] = 1.0
                state.hand_vertex[w, k] = -1
                state.velocity[w, i] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def refresh_lists(solver: Solver, state: State, w: int, lane: int, lanes: int):
    """Make new contact lists when a vertex has left its predicted path or the prediction has run out.

    They last longer when no vertex has gone further than the allowed deviation, as in a cloth that creeps to rest.
    """
    synchronise()
    limit = solver.prediction_error * solver.prediction_error
    age = state.list_age[w] + solver.time_step
    unpredicted = state.deviation[w] > limit or age >= solver.prediction_time
    stale = unpredicted and state.motion[w] > limit
    synchronise()
    if stale:
        list_contacts(solver, state, w, lane, lanes)
        if lane == 0:
            list_pairs(solver, state, w)
        age = float(0.0)
    if lane == 0:
        state.list_age[w] = age
    synchronise()


@wp.func
def finish(solver: Solver, state: State, w: int, lane: int, lanes: int, since: float, top_speed: float):
    """Keep the vertices on the table and under the speed limits, and set their velocities."""
    dt = solver.time_step
    damping = float(1.0)
    if since > 0.0:
        damping = 1.0 / (1.0 + solver.contact_damping * (1.0 + 10.0 * wp.max(since - solver.calm_after, 0.0)))
    largest_step = wp.min(solver.largest_step, top_speed * dt)
    floor = 0.5 * solver.thickness
    for i in range(lane, solver.side * solver.side, lanes):
        x = state.position[w, i]
        if lanes > 1:
            x = x + state.correction[w, i]
            state.correction[w, i] = wp.vec3(0.0, 0.0, 0.0)
        before = state.previous[w, i]
        touches = state.touching[w, i] == 1
        state.touching[w, i] = 0
        if state.free[w, i] > 0.0:
            d = x - before
            length = wp.length(d)
            if length > largest_step:
                x = before + d * (largest_step / length)
            penetration = floor - x[2]
            if penetration > 0.0:
                dx = x[0] - before[0]
                dy = x[1] - before[1]
                slip = wp.sqrt(dx * dx + dy * dy) + 1.0e-12
                friction = wp.min(1.0, solver.table_friction * penetration / slip)
                x = wp.vec3(x[0] - friction * dx, x[1] - friction * dy, floor)
                touches = True
        v = (x - before) / dt
        if touches:
            v = v * damping
        state.velocity[w, i] = v
        state.position[w, i] = x
    synchronise()


@wp.func
def check_rest(solver: Solver, state: State, w: int, lane: int, lanes: int, since: float):
    """Return whether the world is done: at rest for some checks in a row, out of time, or no longer finite."""
    limit = solver.rest_step * solver.rest_step
    count = float(0.0)
    largest = float(0.0)
    for i in range(lane, solver.side * solver.side, lanes):
        x = state.position[w, i]
        d = x - state.checked[w, i]
        state.checked[w, i] = x
        squared = wp.dot(d, d)
        largest = wp.max(largest, squared)
        if not squared < limit:
            count += 1.0
        if not squared < 1.0e4:
            count += 1.0e7
    if lane == 0:
        state.moving[w] = 0.0
        state.fastest[w] = 0.0
    synchronise()
    wp.atomic_add(state.moving, w, count)
    wp.atomic_max(state.fastest, w, wp.sqrt(largest))
    synchronise()
    if lane == 0:
        state.calm[w] = wp.where(state.moving[w] == 0.0, state.calm[w] + 1, 0)
    synchronise()
    rested = state.calm[w] >= solver.checks
    if rested or since > solver.longest_settling or state.moving[w] > 1.0e6:
        if lane == 0:
            state.done[w] = wp.where(rested, 1, 2)
        return True
    return False


@wp.kernel
def advance(solver: Solver, state: State, lanes: int):
    """Advance every world that is not done by a launch's substeps."""
    w, lane = wp.tid()
    if state.done[w] != 0:
        return
    t = state.time[w]
    move_time = state.move_time[w]
    for substep in range(solver.substeps):
        t = t + solver.time_step
        since = t - move_time
        late = wp.max(since - solver.calm_after, 0.0)
        top_speed = wp.max(solver.top_speed * wp.exp(-solver.speed_decay * late), solver.last_speed)
        move(solver, state, w, lane, lanes, since, top_speed)
        move_hands(state, w, lane, lanes, t)
        refresh_lists(solver, state, w, lane, lanes)
        solve_bending(solver, state, w, lane, lanes)
        solve_stretch(solver, state, w, lane, lanes)
        solve_contacts(solver, state, w, lane, lanes)
        solve_pairs(solver, state, w, lane, lanes)
        synchronise()
        finish(solver, state, w, lane, lanes, since, top_speed)
        if since > 0.0 and (substep + 1) % solver.check_every == 0:
            if check_rest(solver, state, w, lane, lanes, since):
                if lane == 0:
                    state.time[w] = t
                return
    if lane == 0:
        state.time[w] = t
