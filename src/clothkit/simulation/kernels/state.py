"""What every kernel shares: the solver's settings, the state of the worlds, and how lanes divide the work.

The launch is (worlds, lanes). On the CPU a world has one lane, and loops run serially, so that constraints are solved
Gauss-Seidel. On CUDA a block is a world and its lanes stride the loops, with a barrier between colours.

Vertices are numbered row by row: vertex = row * side + column. A quad carries the number of its lowest vertex (so the
last row and column have none). An edge is 3 * vertex + kind: kind 0 runs to the next row, 1 to the next column, 2 to
the vertex diagonally across. The quad's diagonal splits it into its two triangles.
"""

import os

import warp as wp

wp.config.enable_backward = False
wp.config.log_level = wp.LOG_ERROR
wp.config.max_unroll = 1


def _initialise() -> None:
    """Start Warp without its complaint, from C, that there is no CUDA driver."""
    stderr = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        wp.init()
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(nowhere)


_initialise()

TABLE_SIZE = wp.constant(32 * 32 * 16)  # cells of a hash grid
CONTACTS = wp.constant(24)  # quads that a vertex can touch at a time
EDGE_PAIRS = wp.constant(12000)  # pairs of edges that can be watched at a time
VIOLATED = wp.constant(64)  # violated pairs whose side is remembered through a rebuild

Vectors = wp.array(dtype=wp.vec3)  # of one world: the functions that run most take these, not a whole State
Floats = wp.array(dtype=float)


@wp.struct
class Solver:
    """Settings of the solver in SI units. Particles have unit mass, so compliances are per mass, over dt squared."""

    side: int  # vertices along a side
    substeps: int  # per launch
    spacing: float  # m, rest length of a grid edge
    time_step: float  # s

    stretch_compliance: float  # 1
    shear_compliance: float  # 1
    diagonal_shortest: float  # m, the free diagonal is limited to this range
    diagonal_longest: float  # m
    bending_compliance: float  # 1
    bending_saturation: float  # m, the second difference beyond which the bending moment no longer grows
    crease_compliance: float  # 1
    crease_length: float  # m, vertices two apart come no closer

    gravity: float  # m/s^2
    settle_gravity: float  # 1, factor on gravity after release
    press_height: float  # m, what stands above is pulled down after release
    press_gain: float  # 1/m, added to the factor on gravity per height above
    press_limit: float  # 1, largest addition
    viscosity: float  # 1, share of the neighbours' velocity difference taken over in a substep
    drag_moving: float  # 1/s
    drag_settling: float  # 1/s, at release
    drag_growth: float  # 1/s, of the drag, relative, after release

    top_speed: float  # m/s
    calm_after: float  # s after release; then the top speed decays and the contacts are damped
    speed_decay: float  # 1/s
    last_speed: float  # m/s, the top speed decays to this
    largest_step: float  # m, no vertex moves further in a substep

    thickness: float  # m, distance of touching layers
    edge_thickness: float  # m, distance of touching edges
    margin: float  # m, contact lists hold what is this much further apart than touching
    prediction_time: float  # s, contact lists hold for the motion predicted over this time
    prediction_error: float  # m, a vertex this far from its predicted place makes the lists stale
    memory_gap: float  # m, closer layers stay on the side on which they were
    bend_feature: float  # m, the second difference above which a vertex lies in a bend
    push_step: float  # m, penetration removed in a substep
    cloth_friction: float  # 1
    table_friction: float  # 1
    contact_damping: float  # 1, per substep, after release

    check_every: int  # substeps between two checks for rest
    checks: int  # successive checks to be passed
    rest_step: float  # m, a vertex at rest moves less between two checks
    longest_settling: float  # s


@wp.struct
class State:
    """State of all worlds; the first axis of every array is the world."""

    position: wp.array2d(dtype=wp.vec3)  # m
    velocity: wp.array2d(dtype=wp.vec3)  # m/s
    previous: wp.array2d(dtype=wp.vec3)  # m, at the start of the substep
    correction: wp.array2d(dtype=wp.vec3)  # m, sum over contacts (several lanes only)
    checked: wp.array2d(dtype=wp.vec3)  # m, at the last check for rest
    free: wp.array2d(dtype=float)  # inverse mass: 1, or 0 where grasped
    touching: wp.array2d(dtype=int)  # 1 where the cloth touches itself

    hand_vertex: wp.array2d(dtype=int)  # [world, hand], -1 for none
    hand_start: wp.array2d(dtype=wp.vec3)  # m
    hand_direction: wp.array2d(dtype=wp.vec3)  # unit, horizontal
    hand_radius: wp.array2d(dtype=float)  # m, of the arc
    hand_angle: wp.array2d(dtype=float)  # rad, of the whole arc
    move_time: wp.array(dtype=float)  # s, until release
    time: wp.array(dtype=float)  # s, since the grasp
    done: wp.array(dtype=int)  # 0 running, 1 at rest, 2 gave up
    calm: wp.array(dtype=int)  # checks for rest passed in a row
    moving: wp.array(dtype=float)  # vertices that failed the last check for rest
    fastest: wp.array(dtype=float)  # m, largest motion of a vertex between the last two checks

    list_age: wp.array(dtype=float)  # s, of the contact lists
    deviation: wp.array(dtype=float)  # m^2, largest from the predicted motion
    motion: wp.array(dtype=float)  # m^2, largest since the contact lists were made
    list_position: wp.array2d(dtype=wp.vec3)  # m, when the lists were made
    list_velocity: wp.array2d(dtype=wp.vec3)  # m/s
    quad_head: wp.array2d(dtype=int)  # [world, cell], first quad of the cell
    quad_next: wp.array2d(dtype=int)
    quad_cell: wp.array2d(dtype=int)
    quad_centre: wp.array2d(dtype=wp.vec3)
    quad_normal: wp.array2d(dtype=wp.vec3)  # unit
    quad_velocity: wp.array2d(dtype=wp.vec3)
    contacts: wp.array2d(dtype=int)  # [world, vertex], number of quads near it
    contact: wp.array3d(dtype=int)  # [world, vertex, contact], quad + 1, negative below
    contact_before: wp.array3d(dtype=int)

    in_bend: wp.array2d(dtype=int)
    features: wp.array(dtype=int)  # number of edges on the border or in a bend
    feature: wp.array2d(dtype=int)  # [world, feature], edge
    feature_middle: wp.array2d(dtype=wp.vec3)
    feature_head: wp.array2d(dtype=int)
    feature_next: wp.array2d(dtype=int)
    feature_cell: wp.array2d(dtype=int)
    pairs: wp.array(dtype=int)  # number of pairs of edges near each other
    pair: wp.array3d(dtype=int)  # [world, pair, (edge, edge, side or 0)]
    violated: wp.array3d(dtype=int)

    pierced: wp.array2d(dtype=int)  # [world, (found at first, left at last)]


@wp.func_native("""
#if defined(__CUDA_ARCH__)
__syncthreads();
#endif
""")
def synchronise():
    """Wait for the block's other lanes; nothing on the CPU."""


@wp.func
def cell_of(x: int, y: int, z: int):
    """Return the hash cell of integer coordinates."""
    return ((x & 31) * 32 + (y & 31)) * 16 + (z & 15)


@wp.func
def cell_at(p: wp.vec3, per_metre: float):
    """Return the hash cell of a point, for cells of side 1 / per_metre."""
    return cell_of(int(wp.floor(p[0] * per_metre)), int(wp.floor(p[1] * per_metre)), int(wp.floor(p[2] * per_metre)))


@wp.func
def edge_end(edge: int, side: int):
    """Return the vertex at which an edge ends; it starts at edge / 3."""
    kind = edge % 3
    vertex = edge / 3
    return wp.where(kind == 0, vertex + side, wp.where(kind == 1, vertex + 1, vertex + side + 1))
