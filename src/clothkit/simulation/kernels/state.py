"""Data that all kernels share: the solver's settings and the state of the worlds.

A launch has a thread for each world, on the CPU: constraints are solved one after the other (Gauss-Seidel).

Rows of the grid follow one another along u, columns along v. Vertices are numbered row by row: vertex = row * columns +
column. A quad has the number of its lowest vertex (so the last row and column have none). An edge is 3 * vertex + kind:
kind 0 leads to the next row, 1 to the next column, 2 to the vertex diagonally across. This diagonal splits the quad
into its two triangles.
"""

import warp as wp

from clothkit.simulation.kernel_cache import start_warp

wp.config.enable_backward = False
wp.config.log_level = wp.LOG_ERROR
wp.config.max_unroll = 1

start_warp()

CELLS = wp.constant(64)  # of the search grid, along x and along y
CONTACTS = wp.constant(32)  # quads that a vertex can touch at a time
EDGE_PAIRS = wp.constant(40000)  # pairs of edges that can be listed at a time
MEMORY = wp.constant(65536)  # places of the hash table of the previous pairs, a power of two
HELD = wp.constant(32)  # vertices that the hands can hold in total
PATH = wp.constant(257)  # points of a hand's path, at equal times

Vectors = wp.array(dtype=wp.vec3)  # of one world; the functions that run most often take these, not a whole State
Floats = wp.array(dtype=float)


@wp.struct
class Bend:
    """Settings of the bends of grid lines along one direction; for units see Solver."""

    compliance: float  # 1
    friction: float  # m, limit of the multiplier by which dry friction resists changes of the bend
    saturation: float  # m, the second difference beyond which the bending moment no longer grows
    crease_compliance: float  # 1
    crease_length: float  # m, least distance of vertices that are two apart on the grid line
    feature: float  # m, the second difference above which a vertex lies in a bend


@wp.struct
class Solver:
    """Settings of the solver in SI units.

    Particles have unit mass; compliances are multiplied by the mass and divided by the squared time step.
    """

    rows: int  # vertices along u
    columns: int  # vertices along v
    substeps: int  # per launch
    spacing_u: float  # m, rest length of a grid edge along u
    spacing_v: float  # m
    spacing: float  # m, the smaller of the two
    diagonal: float  # 1, rest length of a quad's diagonals in spacings along u
    time_step: float  # s

    stretch_u: float  # 1, compliances of edges along u and along v
    stretch_v: float  # 1
    chord_u: float  # 1, the same for edges that are shorter than the least chord of a bent thread
    chord_v: float  # 1
    shortest_chord: float  # 1, of an edge's length
    shear_compliance: float  # 1
    diagonal_shortest: float  # m, diagonals are limited to this range
    diagonal_longest: float  # m
    bend_u: Bend  # of grid lines along u
    bend_v: Bend

    gravity: float  # m/s^2
    viscosity: float  # 1, fraction of the velocity difference to each neighbour along u that is added in a substep
    viscosity_ratio: float  # 1, the fraction along v, as a multiple of that along u
    drag: float  # 1/s
    top_speed: float  # m/s

    thickness: float  # m, distance of touching layers
    cell: float  # m, cell size of the search grid; a search visits a cell and its neighbours
    margin: float  # m, by which the distance in contact lists may exceed the thickness
    prediction_time: float  # s, contact lists are valid for the motion predicted over this time
    prediction_error: float  # m, a vertex further than this from its predicted position makes the lists stale
    memory_gap: float  # m, below this distance a vertex keeps its stored side of a quad
    twist_feature: float  # m, the twist above which a quad's diagonal is a feature edge
    stretch_passes: int  # passes over the stretch constraints in a substep
    push_step: float  # m, penetration removed in a substep, beside twice the approach
    gap_growth: float  # m, by which the stored gap of a pair of edges grows in a substep
    cloth_friction: float  # 1
    table_friction: float  # 1
    stiction: float  # m, a vertex that would move less than this in a substep does not move

    check_interval: float  # s, between two checks for rest
    rest_speed: float  # m/s
    rest_time: float  # s, a world is at rest when every vertex was slower than `rest_speed` for this time
    longest_settling: float  # s, after the release; then the world is given up
    guard_interval: float  # s, between two searches for crossings
    care_time: float  # s, duration of the careful mode after a crossing was undone
    care_tries: int  # attempts to avoid a crossing before it is accepted
    careful_passes: int  # passes over the contacts in a substep in careful mode


@wp.struct
class State:
    """State of all worlds; the first axis of every array is the world."""

    position: wp.array2d(dtype=wp.vec3)  # m
    velocity: wp.array2d(dtype=wp.vec3)  # m/s
    previous: wp.array2d(dtype=wp.vec3)  # m, at the start of the substep
    pressed: wp.array2d(dtype=float)  # m, penetration of the table in the last substep
    free: wp.array2d(dtype=float)  # inverse mass: 1, or 0 where grasped

    held: wp.array2d(dtype=int)  # [world, slot], vertex, -1 for none
    held_by: wp.array2d(dtype=int)  # [world, slot], hand
    held_offset: wp.array2d(dtype=wp.vec3)  # m, from the hand to the vertex
    path: wp.array3d(dtype=wp.vec3)  # [world, hand, point], m, at equal times
    move_time: wp.array(dtype=float)  # s, until release
    time: wp.array(dtype=float)  # s, since the grasp
    done: wp.array(dtype=int)  # 0 running, 1 at rest, 2 given up
    checked: wp.array2d(dtype=wp.vec3)  # m, at the last check for rest
    checked_time: wp.array(dtype=float)  # s
    calm: wp.array(dtype=float)  # s, since a vertex was last faster than `rest_speed`
    residual: wp.array(dtype=float)  # m/s, speed of the fastest vertex over that time

    saved_position: wp.array2d(dtype=wp.vec3)  # m, when the last search found no new crossing
    saved_velocity: wp.array2d(dtype=wp.vec3)  # m/s
    saved_time: wp.array(dtype=float)  # s
    saved_crossings: wp.array(dtype=int)
    searched: wp.array(dtype=int)  # whether the contact lists are those of the last search
    careful_until: wp.array(dtype=float)  # s, end of the careful mode
    tries: wp.array(dtype=int)  # attempts so far to avoid the present crossing
    returns: wp.array(dtype=int)  # how often the world was reset to the saved state
    lost: wp.array(dtype=int)  # crossings that were accepted after all attempts

    list_age: wp.array(dtype=float)  # s, of the contact lists
    deviation: wp.array(dtype=float)  # m^2, largest squared distance of a vertex from its predicted position
    motion: wp.array(dtype=float)  # m^2, largest squared displacement since the contact lists were made
    list_position: wp.array2d(dtype=wp.vec3)  # m, when the lists were made
    list_velocity: wp.array2d(dtype=wp.vec3)  # m/s
    low: wp.array(dtype=wp.vec3)  # m, corner of the search grid
    cell: wp.array2d(dtype=int)  # of each quad or edge that is being sorted
    quad_first: wp.array2d(dtype=int)  # [world, cell], its first place among the sorted quads
    quad: wp.array2d(dtype=int)  # [world, place], quads sorted by cell
    quad_centre: wp.array2d(dtype=wp.vec3)  # [world, place], m
    quad_normal: wp.array2d(dtype=wp.vec3)  # [world, place], unit
    quad_velocity: wp.array2d(dtype=wp.vec3)  # [world, place], m/s
    quad_speed: wp.array2d(dtype=float)  # [world, place], m/s
    quad_twist: wp.array2d(dtype=float)  # [world, place], m, how far its corners lie from its plane
    upwards: wp.array2d(dtype=int)  # [world, place], vertices sorted by height
    contacts: wp.array2d(dtype=int)  # [world, vertex], number of listed quads
    contact: wp.array3d(dtype=int)  # [world, vertex, contact], quad + 1, negative where the vertex is below the quad
    contact_before: wp.array3d(dtype=int)

    in_bend: wp.array2d(dtype=int)
    features: wp.array(dtype=int)  # number of edges on the border or in a bend
    feature: wp.array2d(dtype=int)  # [world, feature], edge
    feature_middle: wp.array2d(dtype=wp.vec3)
    feature_half: wp.array2d(dtype=wp.vec3)  # m, absolute values of the vector from the middle to the end
    feature_velocity: wp.array2d(dtype=wp.vec3)
    edge_first: wp.array2d(dtype=int)  # [world, cell], its first place among the sorted features
    edge: wp.array2d(dtype=int)  # [world, place], edges sorted by cell
    edge_middle: wp.array2d(dtype=wp.vec3)  # [world, place], m
    edge_half: wp.array2d(dtype=wp.vec3)
    edge_velocity: wp.array2d(dtype=wp.vec3)
    edge_speed: wp.array2d(dtype=float)  # m/s
    pairs: wp.array(dtype=int)  # number of pairs of edges near each other
    pair: wp.array3d(dtype=int)  # [world, pair, (edge, edge, side or 0)]
    pair_gap: wp.array2d(dtype=float)  # [world, pair], m, distance to which the two edges are pushed apart now
    found: wp.array3d(dtype=int)  # pairs that are being listed, unsorted
    found_gap: wp.array2d(dtype=float)
    pair_before: wp.array3d(dtype=int)
    pair_gap_before: wp.array2d(dtype=float)
    memory: wp.array2d(dtype=int)  # [world, place], index of the previous pair + 1, 0 where empty
    twisted: wp.array2d(dtype=int)  # [world, quad]


@wp.func
def edge_end(edge: int, columns: int):
    """Return the vertex at which an edge ends; it starts at edge / 3."""
    kind = edge % 3
    vertex = edge / 3
    return wp.where(kind == 0, vertex + columns, wp.where(kind == 1, vertex + 1, vertex + columns + 1))
