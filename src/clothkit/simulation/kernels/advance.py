"""The time loop: the kernel that runs every part of the solver for the substeps of one launch."""

# Warp: int(0), float(0.0) and bool(True) declare variables that loops may change.
import warp as wp

from clothkit.simulation.kernels.crossings import count_crossings
from clothkit.simulation.kernels.edges import list_pairs, solve_pairs
from clothkit.simulation.kernels.elasticity import solve_bending, solve_shear, solve_stretch
from clothkit.simulation.kernels.faces import list_contacts, solve_contacts
from clothkit.simulation.kernels.state import HELD, PATH, Solver, State


@wp.func
def neighbours_difference(solver: Solver, state: State, w: int, i: int, v: wp.vec3):
    """Return the sum over the grid neighbours of vertex i of their velocity minus its velocity v, in m/s.

    The differences along v are multiplied by `viscosity_ratio`.
    """
    n = solver.columns
    row = i / n
    column = i % n
    ratio = solver.viscosity_ratio
    total = wp.vec3(0.0, 0.0, 0.0)
    if row > 0:
        total = total + state.velocity[w, i - n] - v
    if row < solver.rows - 1:
        total = total + state.velocity[w, i + n] - v
    if column > 0:
        total = total + state.velocity[w, i - 1] * ratio - v * ratio
    if column < n - 1:
        total = total + state.velocity[w, i + 1] * ratio - v * ratio
    return total


@wp.func
def move(solver: Solver, state: State, w: int):
    """Integrate the motion of the vertices over a substep, without constraints.

    Also stores two squared maxima over the vertices: the displacement since the contact lists were made (`motion`),
    and the distance from the position that the lists predicted (`deviation`).
    """
    dt = solver.time_step
    damping = 1.0 / (1.0 + solver.drag * dt)
    age = state.list_age[w] + dt
    deviation = float(0.0)
    motion = float(0.0)
    for i in range(solver.rows * solver.columns):
        x = state.position[w, i]
        state.previous[w, i] = x
        v = state.velocity[w, i]
        v = v + neighbours_difference(solver, state, w, i, v) * solver.viscosity
        v = (v - wp.vec3(0.0, 0.0, solver.gravity * dt)) * damping
        x = x + v * (dt * state.free[w, i])
        state.position[w, i] = x
        d = x - state.list_position[w, i]
        motion = wp.max(motion, wp.dot(d, d))
        d = d - state.list_velocity[w, i] * age
        deviation = wp.max(deviation, wp.dot(d, d))
    state.deviation[w] = deviation
    state.motion[w] = motion


@wp.func
def move_hands(state: State, w: int, t: float):
    """Move the held vertices to the positions of the hands on their paths at time t, or release them at the end."""
    place = t / state.move_time[w] * float(PATH - 1)
    held = place <= float(PATH - 1)
    k0 = wp.min(int(place), PATH - 2)
    for slot in range(HELD):
        i = state.held[w, slot]
        if i >= 0:
            if held:
                hand = state.held_by[w, slot]
                at = wp.lerp(state.path[w, hand, k0], state.path[w, hand, k0 + 1], place - float(k0))
                state.free[w, i] = 0.0
                state.position[w, i] = at + state.held_offset[w, slot]
            else:
                state.free[w, i] = 1.0


@wp.func
def refresh_lists(solver: Solver, state: State, w: int, careful: bool):
    """Make new contact lists when a vertex has left its predicted path or the prediction time is over.

    The lists are kept in both cases while no vertex has moved further than the allowed deviation since they were made,
    as in a cloth that creeps to rest.
    """
    limit = solver.prediction_error * solver.prediction_error
    age = state.list_age[w] + solver.time_step
    unpredicted = state.deviation[w] > limit or age >= solver.prediction_time
    stale = unpredicted and state.motion[w] > limit
    if stale:
        list_contacts(solver, state, w)
        list_pairs(solver, state, w, careful)
        state.searched[w] = 0
        age = float(0.0)
    state.list_age[w] = age


@wp.func
def finish(solver: Solver, state: State, w: int):
    """Limit the speeds, keep the vertices above the table, and compute the velocities from the displacements."""
    dt = solver.time_step
    largest_step = solver.top_speed * dt
    floor = 0.5 * solver.thickness
    for i in range(solver.rows * solver.columns):
        x = state.position[w, i]
        before = state.previous[w, i]
        if state.free[w, i] > 0.0:
            d = x - before
            length = wp.length(d)
            if length > largest_step:
                x = before + d * (largest_step / length)
            penetration = floor - x[2]
            spent = state.pressed[w, i]
            state.pressed[w, i] = wp.max(penetration, 0.0)
            if penetration > 0.0:
                dx = x[0] - before[0]
                dy = x[1] - before[1]
                slip = wp.sqrt(dx * dx + dy * dy) + 1.0e-12
                friction = wp.clamp((solver.table_friction * penetration - spent) / slip, 0.0, 1.0)
                x = wp.vec3(x[0] - friction * dx, x[1] - friction * dy, floor)
            d = x - before
            if wp.dot(d, d) < solver.stiction * solver.stiction:
                x = before
        state.velocity[w, i] = (x - before) / dt
        state.position[w, i] = x


@wp.func
def hold(solver: Solver, state: State, w: int):
    """Apply the table's friction to the vertices that were pressed into it, before the contacts between layers.

    Otherwise the lower layer's slip drags the upper layer along before the table's friction undoes that slip, and the
    upper layer creeps.
    """
    for i in range(solver.rows * solver.columns):
        pressed = state.pressed[w, i]
        if pressed > 0.0 and state.free[w, i] > 0.0:
            x = state.position[w, i]
            before = state.previous[w, i]
            dx = x[0] - before[0]
            dy = x[1] - before[1]
            slip = wp.sqrt(dx * dx + dy * dy) + 1.0e-12
            friction = wp.min(1.0, solver.table_friction * pressed / slip)
            state.position[w, i] = wp.vec3(x[0] - friction * dx, x[1] - friction * dy, x[2])
            # `finish` subtracts this share, so that the table's friction is not applied twice in a substep.
            state.pressed[w, i] = friction * slip


@wp.func
def substep(solver: Solver, state: State, w: int, t: float):
    """Advance a world by one time step to the time t.

    While the world is in careful mode (after a crossing was undone), all edges are checked for contacts and the
    contacts are solved in several passes.
    """
    move(solver, state, w)
    move_hands(state, w, t)
    careful = t < state.careful_until[w]
    refresh_lists(solver, state, w, careful)
    solve_bending(solver, state, w)
    solve_shear(solver, state, w)
    for _ in range(solver.stretch_passes):
        solve_stretch(solver, state, w)
    hold(solver, state, w)
    passes = wp.where(careful, solver.careful_passes, 1)
    for _ in range(passes):
        solve_contacts(solver, state, w)
        solve_pairs(solver, state, w)
    finish(solver, state, w)


@wp.func
def guard(solver: Solver, state: State, w: int, t: float, last: bool):
    """Return the time to continue from: t, or the time of the saved state if there are new crossings since then.

    In the second case the saved state is restored and the world runs in careful mode for a while. If new crossings
    come up again in that time, the saved state is restored with zero velocities. After `care_tries` attempts the
    remaining crossings are accepted and counted in `lost`.
    """
    if state.searched[w] == 1 and not last:
        # No new contact lists since the last search: the motion is too small to need another one now.
        return t
    state.searched[w] = 1
    crossings = count_crossings(solver, state, w)
    tries = wp.where(t > state.careful_until[w], 0, state.tries[w])
    back = crossings > state.saved_crossings[w] and tries < solver.care_tries
    speed = wp.where(tries > 0, 0.0, 1.0)
    for i in range(solver.rows * solver.columns):
        if back:
            state.position[w, i] = state.saved_position[w, i]
            state.velocity[w, i] = state.saved_velocity[w, i] * speed
            state.list_position[w, i] = wp.vec3(1.0e3, 1.0e3, 1.0e3)
            state.contacts[w, i] = 0
            state.checked[w, i] = state.saved_position[w, i]
        else:
            state.saved_position[w, i] = state.position[w, i]
            state.saved_velocity[w, i] = state.velocity[w, i]
    if back:
        state.returns[w] += 1
        state.tries[w] = tries + 1
        state.careful_until[w] = t + solver.care_time
        state.calm[w] = 0.0
        state.pairs[w] = 0
        state.checked_time[w] = state.saved_time[w]
    else:
        if crossings > state.saved_crossings[w]:
            state.lost[w] += crossings - state.saved_crossings[w]
        state.saved_crossings[w] = crossings
        state.saved_time[w] = t
    return wp.where(back, state.saved_time[w], t)


@wp.func
def check_rest(solver: Solver, state: State, w: int, t: float):
    """Return 1 if the world was at rest for long enough, 2 if it is out of time or no longer finite, else 0.

    The speeds are means over the time since the last check.
    """
    seconds = t - state.checked_time[w]
    farthest = float(0.0)
    for i in range(solver.rows * solver.columns):
        x = state.position[w, i]
        d = x - state.checked[w, i]
        state.checked[w, i] = x
        # `not <` in place of `>=`, so that NaN is caught, too.
        if not wp.dot(d, d) < 1.0e4:
            farthest = 1.0e2
        farthest = wp.max(farthest, wp.length(d))
    fastest = farthest / seconds
    slow = fastest < solver.rest_speed
    calm = wp.where(slow, state.calm[w] + seconds, 0.0)
    residual = wp.where(slow and state.calm[w] > 0.0, wp.max(state.residual[w], fastest), fastest)
    state.checked_time[w] = t
    state.calm[w] = calm
    state.residual[w] = residual
    # Half a time step of tolerance, because sums of time steps are not exact.
    if calm > solver.rest_time - 0.5 * solver.time_step:
        return 1
    if t - state.move_time[w] > solver.longest_settling or fastest > 1.0e3:
        return 2
    return 0


@wp.kernel
def advance(solver: Solver, state: State):
    """Advance every world that is not done by `solver.substeps` substeps."""
    w = wp.tid()
    if state.done[w] != 0:
        return
    t = state.time[w]
    for _ in range(solver.substeps):
        t = t + solver.time_step
        substep(solver, state, w, t)
        done = int(0)
        if t > state.move_time[w] and t - state.checked_time[w] > solver.check_interval - 0.5 * solver.time_step:
            done = check_rest(solver, state, w, t)
        if done > 0 or t - state.saved_time[w] >= solver.guard_interval:
            now = guard(solver, state, w, t, done > 0)
            if now < t:
                done = 0
            t = now
        if done > 0:
            state.done[w] = done
            break
    state.time[w] = t
