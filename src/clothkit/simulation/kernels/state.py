"""What every kernel shares: the solver's settings, the state of the worlds, and how lanes divide the work.

The launch is (worlds, lanes). On the CPU a world has one lane, and loops run serially, so that constraints are solved
Gauss-Seidel. On CUDA a block is a world and its lanes stride the loops, with a barrier between colours.

Vertices are numbered row by row: vertex = row * side + column. A quad carries the number of its lowest vertex (so the
last row and column have none). An edge is 3 * vertex + kind: kind 0 runs to the next row, 1 to the next column, 2 to
the vertex diagonally across. The quad's diagonal splits it into its two triangles.
"""

import warp as wp

from clothkit.simulation.kernel_cache import start_warp

wp.config.enable_backward = False
wp.config.log_level = wp.LOG_ERROR
wp.config.max_unroll = 1

start_warp()

CELLS = wp.constant(64)  # of the search grid, along x and along y
CONTACTS = wp.constant(32)  # quads that a vertex can touch at a time
EDGE_PAIRS = wp.constant(40000)  # pairs of edges that can be watched at a time
MEMORY = wp.constant(65536)  # places for the pairs that are remembered through a rebuild, a power of two
HELD = wp.constant(32)  # vertices that the hands can hold, over all layers
PATH = wp.constant(257)  # points of a hand's path, at equal times

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
    diagonal_shortest: float  # m, diagonals are limited to this range
    diagonal_longest: float  # m
    bending_compliance: float  # 1
    bending_friction: float  # m, largest multiplier that keeps a second difference as it was
    bending_saturation: float  # m, the second difference beyond which the bending moment no longer grows
    crease_compliance: float  # 1
    crease_length: float  # m, vertices two apart come no closer

    gravity: float  # m/s^2
    viscosity: float  # 1, share of a neighbour's velocity difference taken over in a substep
    drag: float  # 1/s
    top_speed: float  # m/s

    thickness: float  # m, distance of touching layers
    cell: float  # m, of the search grid; a search looks one cell around
    margin: float  # m, contact lists hold what is this much further apart than touching
    prediction_time: float  # s, contact lists hold for the motion predicted over this time
    prediction_error: float  # m, a vertex this far from its predicted place makes the lists stale
    memory_gap: float  # m, closer layers stay on the side on which they were
    bend_feature: float  # m, the second difference above which a vertex lies in a bend
    stretch_passes: int  # over the edges' lengths in a substep
    push_step: float  # m, penetration removed in a substep
    gap_growth: float  # m, by which the gap that a new pair of edges keeps grows in a substep
    cloth_friction: float  # 1
    table_friction: float  # 1
    stiction: float  # m, a vertex that would move less in a substep stays

    check_interval: float  # s, between two checks for rest
    rest_speed: float  # m/s
    rest_time: float  # s, a world is at rest when every vertex was slower for so long
    longest_settling: float  # s
    guard_interval: float  # s, between two searches for crossings
    care_time: float  # s, how long care is taken after a crossing was undone
    care_tries: int  # to avoid a crossing, before it is let be
    careful_passes: int  # over the contacts in a substep while care is taken


@wp.struct
class State:
    """State of all worlds; the first axis of every array is the world."""

    position: wp.array2d(dtype=wp.vec3)  # m
    velocity: wp.array2d(dtype=wp.vec3)  # m/s
    previous: wp.array2d(dtype=wp.vec3)  # m, at the start of the substep
    correction: wp.array2d(dtype=wp.vec3)  # m, sum over contacts (several lanes only)
    pressed: wp.array2d(dtype=float)  # m, into the table, in the last substep
    free: wp.array2d(dtype=float)  # inverse mass: 1, or 0 where grasped

    held: wp.array2d(dtype=int)  # [world, slot], vertex, -1 for none
    held_by: wp.array2d(dtype=int)  # [world, slot], hand
    held_offset: wp.array2d(dtype=wp.vec3)  # m, from the hand
    path: wp.array3d(dtype=wp.vec3)  # [world, hand, point], m, at equal times
    move_time: wp.array(dtype=float)  # s, until release
    time: wp.array(dtype=float)  # s, since the grasp
    done: wp.array(dtype=int)  # 0 running, 1 at rest, 2 gave up
    checked: wp.array2d(dtype=wp.vec3)  # m, at the last check for rest
    checked_time: wp.array(dtype=float)  # s
    fastest: wp.array(dtype=float)  # m/s, of the vertex that was fastest between the last two checks
    calm: wp.array(dtype=float)  # s, since a vertex was last faster than at rest
    residual: wp.array(dtype=float)  # m/s, of the fastest vertex while calm

    saved_position: wp.array2d(dtype=wp.vec3)  # m, when the last search found no new crossing
    saved_velocity: wp.array2d(dtype=wp.vec3)  # m/s
    saved_time: wp.array(dtype=float)  # s
    saved_crossings: wp.array(dtype=int)
    crossings: wp.array(dtype=int)
    searched: wp.array(dtype=int)  # whether the contact lists are those of the last search
    careful_until: wp.array(dtype=float)  # s, care is taken until then
    tries: wp.array(dtype=int)  # to avoid the crossing because of which care is taken
    returns: wp.array(dtype=int)  # how often the world went back to what was saved
    lost: wp.array(dtype=int)  # crossings that care could not avoid

    list_age: wp.array(dtype=float)  # s, of the contact lists
    deviation: wp.array(dtype=float)  # m^2, largest from the predicted motion
    motion: wp.array(dtype=float)  # m^2, largest since the contact lists were made
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
    upwards: wp.array2d(dtype=int)  # [world, place], vertices from the table up
    contacts: wp.array2d(dtype=int)  # [world, vertex], number of quads near it
    contact: wp.array3d(dtype=int)  # [world, vertex, contact], quad + 1, negative below
    contact_before: wp.array3d(dtype=int)

    in_bend: wp.array2d(dtype=int)
    features: wp.array(dtype=int)  # number of edges on the border or in a bend
    feature: wp.array2d(dtype=int)  # [world, feature], edge
    feature_middle: wp.array2d(dtype=wp.vec3)
    feature_half: wp.array2d(dtype=wp.vec3)  # m, from the middle to the end, without signs
    feature_velocity: wp.array2d(dtype=wp.vec3)
    edge_first: wp.array2d(dtype=int)  # [world, cell], its first place among the sorted features
    edge: wp.array2d(dtype=int)  # [world, place], edges sorted by cell
    edge_middle: wp.array2d(dtype=wp.vec3)  # [world, place], m
    edge_half: wp.array2d(dtype=wp.vec3)
    edge_velocity: wp.array2d(dtype=wp.vec3)
    edge_speed: wp.array2d(dtype=float)  # m/s
    pairs: wp.array(dtype=int)  # number of pairs of edges near each other
    pair: wp.array3d(dtype=int)  # [world, pair, (edge, edge, side or 0)]
    pair_gap: wp.array2d(dtype=float)  # [world, pair], m, what is kept between the two now
    found: wp.array3d(dtype=int)  # pairs that are being listed, in any order
    found_gap: wp.array2d(dtype=float)
    pair_before: wp.array3d(dtype=int)
    pair_gap_before: wp.array2d(dtype=float)
    memory: wp.array2d(dtype=int)  # [world, place], number of the earlier pair + 1, 0 where empty
    twisted: wp.array2d(dtype=int)  # [world, quad]


@wp.func_native("""
#if defined(__CUDA_ARCH__)
__syncthreads();
#endif
""")
def synchronise():
    """Wait for the block's other lanes; nothing on the CPU."""


@wp.func
def edge_end(edge: int, side: int):
    """Return the vertex at which an edge ends; it starts at edge / 3."""
    kind = edge % 3
    vertex = edge / 3
    return wp.where(kind == 0, vertex + side, wp.where(kind == 1, vertex + 1, vertex + side + 1))
