"""The solver's settings and state on the device, built from the configuration."""

import numpy as np
import warp as wp
from jaxtyping import Float

from clothkit.simulation.kernels.state import CELLS, CONTACTS, EDGE_PAIRS, HELD, MEMORY, PATH, Solver, State
from clothkit.simulation.settings import SimulationConfig

GRAVITY = 9.81  # m/s^2
LANES_ON_CUDA = 256
LAUNCH_SECONDS = 0.1  # simulated time per launch
STRETCH_PASSES = 2  # per substep
LARGEST_SHARE = 0.2  # limit of `Solver.viscosity`: explicit viscosity is stable below 1 / 4


def make_solver(settings: SimulationConfig) -> Solver:
    """Return the kernels' settings, in SI units."""
    material, settling = settings.material, settings.settling
    dt, h = settings.time_step, settings.spacing
    mass = material.density * h**2  # of a vertex

    def compliance(stiffness: float) -> float:
        """Return the kernels' compliance of a spring with a stiffness in N/m: a vertex's mass / (stiffness * dt^2)."""
        return mass / (stiffness * dt**2)

    # The energies per area are the stiffness times e^2 / 2 (stretch e), g^2 / 2 (shear g) and k^2 / 2 (curvature k). A
    # grid edge of length l represents the area h^2 with the strain (l - h) / h; a diagonal's strain is half the shear
    # angle; a second difference c corresponds to the curvature |c| / h^2.
    bending = compliance(material.bending_stiffness / h**2)
    solver = Solver()
    values = {
        "side": settings.side,
        "substeps": round(LAUNCH_SECONDS / settings.time_step),
        "spacing": h,
        "time_step": dt,
        "stretch_compliance": compliance(material.stretch_stiffness),
        "shear_compliance": compliance(2 * material.shear_stiffness),  # one of the two diagonals resists
        "diagonal_shortest": 0.3 * 2**0.5 * h,
        "diagonal_longest": (1 + np.sin(material.shear_limit)) ** 0.5 * 2**0.5 * h,
        "bending_compliance": bending,
        "bending_friction": material.bending_friction * dt**2 / mass,
        "bending_saturation": material.bending_limit * h**2,
        "crease_compliance": bending / 4,
        "crease_length": 0.4 * h,
        "gravity": GRAVITY,
        "viscosity": min(material.viscosity * dt / h**2, LARGEST_SHARE),
        "drag": material.drag,
        "top_speed": settings.top_speed,
        "thickness": material.thickness,
        # Half a quad's diagonal, plus the distance to which contact lists extend at the speed of the hands.
        "cell": 0.7 * h + 4.5 * material.thickness,
        "margin": 0.9 * material.thickness,
        "prediction_time": 0.02,
        "prediction_error": 0.4 * material.thickness,
        "memory_gap": 0.6 * material.thickness,
        "bend_feature": 0.25 * h,
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


def make_state(worlds: int, side: int, device: str) -> State:
    """Return the zero-initialised state of `worlds` worlds on the device."""
    n, cells = side * side, int(CELLS) ** 2 + 1
    one, each, edges, held = (worlds,), (worlds, n), (worlds, 3 * n), (worlds, int(HELD))
    vectors: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(
            ("position", "velocity", "previous", "correction", "checked", "saved_position", "saved_velocity"), each
        ),
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
        **dict.fromkeys(
            ("move_time", "time", "fastest", "checked_time", "calm", "residual", "saved_time", "careful_until"), one
        ),
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
        **dict.fromkeys(
            ("done", "features", "pairs", "saved_crossings", "crossings", "searched", "tries", "returns", "lost"), one
        ),
        **dict.fromkeys(("pair", "pair_before", "found"), (worlds, int(EDGE_PAIRS), 3)),
        "memory": (worlds, int(MEMORY)),
    }
    state = State()
    for shapes, dtype in ((vectors, wp.vec3), (floats, wp.float32), (integers, wp.int32)):
        for name, shape in shapes.items():
            setattr(state, name, wp.zeros(shape, dtype=dtype, device=device))
    return state


def flat_state(settings: SimulationConfig) -> Float[np.ndarray, "u v 3"]:
    """Return the flat cloth on the table, in metres; z is half the thickness, as vertices lie in the middle of it."""
    half = settings.cloth_side / 2
    axis = np.linspace(-half, half, settings.side)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return np.stack([x, y, np.full_like(x, settings.material.thickness / 2)], axis=-1).astype(np.float32)
