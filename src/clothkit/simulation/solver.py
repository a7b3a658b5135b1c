"""The solver's settings and state, built from the configuration."""

import numpy as np
import warp as wp
from jaxtyping import Float

from clothkit.cloth.topology import Shape, Topology
from clothkit.simulation.kernels.state import CELLS, CONTACTS, EDGE_PAIRS, HELD, MEMORY, PATH, Bend, Solver, State
from clothkit.simulation.settings import SimulationConfig

GRAVITY = 9.81  # m/s^2
LAUNCH_SECONDS = 0.1  # simulated time per launch
STRETCH_PASSES = 2  # per substep
SHORTEST_CHORD = 0.3  # of an edge's length: the least distance of its ends where the thread folds back within it
CHORD_STIFFNESS = 0.1  # of the stretch stiffness: with all of it, the ends of such edges tremble
LARGEST_SHARES = 0.8  # limit of the shares of `Solver.viscosity` over the four neighbours: stable below 1


def make_solver(settings: SimulationConfig, topology: Topology) -> Solver:
    """Return the kernels' settings for a cloth, in SI units. Raises ValueError for a grid that is too fine or large."""
    settings.check(topology)
    material, settling = settings.material, settings.settling
    dt = settings.time_step
    along_u, along_v = settings.spacing(topology)
    # Terms in this ratio are exactly those of a square where it is 1.
    ratio = along_v / along_u
    diagonal = float(np.hypot(1, ratio))  # in spacings along u
    mass = material.density * (along_u * along_v)  # of a vertex

    def compliance(stiffness: float) -> float:
        """Return the kernels' compliance of a spring with a stiffness in N/m: a vertex's mass / (stiffness * dt^2)."""
        return mass / (stiffness * dt**2)

    # The energies per area are the stiffness times e^2 / 2 (stretch e), g^2 / 2 (shear g) and k^2 / 2 (curvature k). A
    # vertex represents the area u v, where u and v are the spacings. A grid edge of length l along u has the strain
    # (l - u) / u; a diagonal of length d lengthens by the shear angle times u v / d; a second difference c along u
    # corresponds to the curvature |c| / u^2. For v along with u, exchange the two.
    def bend(h: float, across: float) -> Bend:
        """Return the settings of bends of grid lines whose spacing is `h`, and `across` times `h` to the next line."""
        found = Bend()
        found.compliance = compliance(material.bending_stiffness / h**2 * across)
        found.friction = material.bending_friction * dt**2 / mass * across
        found.saturation = material.bending_limit * h**2
        found.crease_compliance = found.compliance / 4
        found.crease_length = 0.4 * h
        found.feature = 0.25 * h
        return found

    sheared = 2 * ratio / (1 + ratio**2)  # of the squared length of a diagonal, per sine of the shear angle
    solver = Solver()
    values = {
        "rows": topology.shape[0],
        "columns": topology.shape[1],
        "substeps": round(LAUNCH_SECONDS / settings.time_step),
        "spacing_u": along_u,
        "spacing_v": along_v,
        "spacing": min(along_u, along_v),
        "diagonal": diagonal,
        "time_step": dt,
        "stretch_u": compliance(material.stretch_stiffness * ratio),
        "stretch_v": compliance(material.stretch_stiffness / ratio),
        "chord_u": compliance(material.stretch_stiffness * ratio * CHORD_STIFFNESS),
        "chord_v": compliance(material.stretch_stiffness / ratio * CHORD_STIFFNESS),
        "shortest_chord": SHORTEST_CHORD,
        "shear_compliance": compliance((ratio + 1 / ratio) * material.shear_stiffness),  # one of the diagonals resists
        "diagonal_shortest": 0.3 * diagonal * along_u,
        "diagonal_longest": (1 + sheared * np.sin(material.shear_limit)) ** 0.5 * diagonal * along_u,
        "bend_u": bend(along_u, ratio),
        "bend_v": bend(along_v, 1 / ratio),
        "gravity": GRAVITY,
        "viscosity": min(material.viscosity * dt / along_u**2, LARGEST_SHARES / (2 + 2 / ratio**2)),
        "viscosity_ratio": 1 / ratio**2,
        "drag": material.drag,
        "top_speed": settings.top_speed,
        "thickness": material.thickness,
        # Half a quad's diagonal, plus the distance to which contact lists extend at the speed of the hands.
        "cell": 0.7 * ((along_u**2 + along_v**2) / 2) ** 0.5 + 4.5 * material.thickness,
        "margin": 0.9 * material.thickness,
        "prediction_time": 0.02,
        "prediction_error": 0.4 * material.thickness,
        "memory_gap": 0.6 * material.thickness,
        "twist_feature": 0.25 * min(along_u, along_v),
        "gap_growth": 0.5 * settling.rest_speed * dt,
        "stretch_passes": STRETCH_PASSES,
        "push_step": settings.push_speed * dt,
        "cloth_friction": material.cloth_friction,
        "table_friction": material.table_friction,
        "stiction": material.stiction * dt**2,
        "check_interval": settling.interval,
        "rest_speed": settling.rest_speed,
        "rest_time": settling.rest_time,
        "longest_settling": settling.longest,
        "guard_interval": settings.guard.interval,
        "care_time": settings.guard.care,
        "care_tries": settings.guard.tries,
        "careful_passes": settings.guard.passes,
    }
    for name, value in values.items():
        setattr(solver, name, value)
    return solver


def make_state(worlds: int, shape: Shape) -> State:
    """Return the zero-initialised state of `worlds` worlds, each with a grid of `shape` vertices."""
    n, cells = shape[0] * shape[1], int(CELLS) ** 2 + 1
    one, each, edges, held = (worlds,), (worlds, n), (worlds, 3 * n), (worlds, int(HELD))
    vectors: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("position", "velocity", "previous", "checked", "saved_position", "saved_velocity"), each),
        **dict.fromkeys(("list_position", "list_velocity", "quad_centre", "quad_normal", "quad_velocity"), each),
        **dict.fromkeys(
            ("feature_middle", "feature_half", "feature_velocity", "edge_middle", "edge_half", "edge_velocity"), edges
        ),
        "held_offset": held,
        "path": (worlds, 2, int(PATH)),
        "low": one,
    }
    floats: dict[str, tuple[int, ...]] = {
        "free": each,
        "pressed": each,
        **dict.fromkeys(("move_time", "time", "checked_time", "calm", "residual", "saved_time", "careful_until"), one),
        **dict.fromkeys(("list_age", "deviation", "motion"), one),
        **dict.fromkeys(("quad_speed", "quad_twist"), each),
        "edge_speed": edges,
        **dict.fromkeys(("pair_gap", "pair_gap_before", "found_gap"), (worlds, int(EDGE_PAIRS))),
    }
    integers: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("quad", "upwards", "contacts", "in_bend", "twisted"), each),
        **dict.fromkeys(("feature", "edge", "cell"), edges),
        **dict.fromkeys(("quad_first", "edge_first"), (worlds, cells)),
        **dict.fromkeys(("contact", "contact_before"), (worlds, n, int(CONTACTS))),
        **dict.fromkeys(("held", "held_by"), held),
        **dict.fromkeys(("done", "features", "pairs", "saved_crossings", "searched", "tries", "returns", "lost"), one),
        **dict.fromkeys(("pair", "pair_before", "found"), (worlds, int(EDGE_PAIRS), 3)),
        "memory": (worlds, int(MEMORY)),
    }
    state = State()
    for shapes, dtype in ((vectors, wp.vec3), (floats, wp.float32), (integers, wp.int32)):
        for name, lengths in shapes.items():
            setattr(state, name, wp.zeros(lengths, dtype=dtype))
    return state


def flat_state(settings: SimulationConfig, topology: Topology | None = None) -> Float[np.ndarray, "u v 3"]:
    """Return the flat cloth on the table, in metres; z is half the thickness, as vertices lie in the middle of it."""
    topology = topology or settings.topology
    xy = flat_grid(topology.shape, settings.sides(topology))
    return np.concatenate([xy, np.full((*topology.shape, 1), settings.material.thickness / 2, np.float32)], axis=-1)


def flat_grid(shape: Shape, sides: tuple[float, float]) -> Float[np.ndarray, "u v 2"]:
    """Return the vertices xy of a centred flat cloth with the given sides, in their unit."""
    along_u, along_v = (np.linspace(-side / 2, side / 2, n) for side, n in zip(sides, shape, strict=True))
    return np.stack(np.meshgrid(along_u, along_v, indexing="ij"), axis=-1).astype(np.float32)
