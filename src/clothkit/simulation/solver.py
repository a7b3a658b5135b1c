"""The solver's settings and state on the device, made from the configuration."""

import numpy as np
import warp as wp
from jaxtyping import Float

from clothkit.simulation.kernels.state import CONTACTS, EDGE_PAIRS, TABLE_SIZE, VIOLATED, Solver, State
from clothkit.simulation.settings import SimulationConfig

GRAVITY = 9.81  # m/s^2
LANES_ON_CUDA = 256
LAUNCH_SECONDS = 0.1  # simulated in a launch


def make_solver(settings: SimulationConfig) -> Solver:
    """The kernels' settings, SI units. Bending stiffness is weight times the bending length cubed."""
    material, settling, dt, h = settings.material, settings.settling, settings.time_step, settings.spacing
    bending = 1 / (GRAVITY * material.bending_length**3 / h**4 * dt**2)
    check_every = round(settling.check_interval / dt)
    solver = Solver()
    values = {
        "side": settings.side,
        "substeps": check_every * max(1, round(LAUNCH_SECONDS / settling.check_interval)),
        "spacing": h,
        "time_step": dt,
        "stretch_compliance": 0.0,
        "shear_compliance": material.shear_compliance,
        "diagonal_shortest": material.diagonal_shortest * h * 2**0.5,
        "diagonal_longest": material.diagonal_longest * h * 2**0.5,
        "bending_compliance": bending,
        "bending_saturation": material.bending_saturation * h,
        "crease_compliance": bending / material.crease_stiffness,
        "crease_length": material.crease_length * h,
        "gravity": GRAVITY,
        "settle_gravity": settling.gravity,
        "press_height": settling.press_height,
        "press_gain": settling.press_gain,
        "press_limit": settling.press_limit,
        "viscosity": material.viscosity,
        "drag_moving": settings.drag,
        "drag_settling": settling.drag,
        "drag_growth": settling.drag_growth,
        "top_speed": settings.top_speed,
        "calm_after": settling.calm_after,
        "speed_decay": settling.speed_decay,
        "last_speed": settling.last_speed,
        "largest_step": settings.largest_step,
        "thickness": material.thickness,
        "edge_thickness": material.edge_thickness,
        "margin": 0.2 * h,
        "prediction_time": 0.015,
        "prediction_error": 0.33 * 0.2 * h,
        "memory_gap": 0.6 * material.thickness,
        "bend_feature": 0.3 * h,
        "push_step": settings.push_speed * dt,
        "cloth_friction": material.cloth_friction,
        "table_friction": material.table_friction,
        "contact_damping": settling.contact_damping * dt,
        "check_every": check_every,
        "checks": settling.checks,
        "rest_step": settling.rest_speed * settling.check_interval,
        "longest_settling": settling.longest,
    }
    for name, value in values.items():
        setattr(solver, name, value)
    return solver


def make_state(worlds: int, side: int, device: str) -> State:
    """Empty state of so many worlds on the device."""
    n = side * side
    one, each, edges = (worlds,), (worlds, n), (worlds, 3 * n)
    vectors: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("position", "velocity", "previous", "correction", "checked"), each),
        **dict.fromkeys(("list_position", "list_velocity", "quad_centre", "quad_normal", "quad_velocity"), each),
        **dict.fromkeys(("hand_start", "hand_direction"), (worlds, 2)),
        "feature_middle": edges,
    }
    floats: dict[str, tuple[int, ...]] = {
        "free": each,
        **dict.fromkeys(("hand_radius", "hand_angle"), (worlds, 2)),
        **dict.fromkeys(("move_time", "time", "moving", "fastest", "list_age", "deviation", "motion"), one),
    }
    integers: dict[str, tuple[int, ...]] = {
        **dict.fromkeys(("touching", "quad_next", "quad_cell", "contacts", "in_bend"), each),
        **dict.fromkeys(("feature", "feature_next", "feature_cell"), edges),
        **dict.fromkeys(("quad_head", "feature_head"), (worlds, int(TABLE_SIZE))),
        **dict.fromkeys(("contact", "contact_before"), (worlds, n, int(CONTACTS))),
        **dict.fromkeys(("hand_vertex", "pierced"), (worlds, 2)),
        **dict.fromkeys(("done", "calm", "features", "pairs"), one),
        "pair": (worlds, int(EDGE_PAIRS), 3),
        "violated": (worlds, int(VIOLATED), 3),
    }
    state = State()
    for shapes, dtype in ((vectors, wp.vec3), (floats, wp.float32), (integers, wp.int32)):
        for name, shape in shapes.items():
            setattr(state, name, wp.zeros(shape, dtype=dtype, device=device))
    return state


def flat_state(settings: SimulationConfig) -> Float[np.ndarray, "u v 3"]:
    """The flat cloth on the table [m]; the middle of its thickness is stored, so it lies half of that high."""
    half = settings.cloth_side / 2
    axis = np.linspace(-half, half, settings.side)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return np.stack([x, y, np.full_like(x, settings.material.thickness / 2)], axis=-1).astype(np.float32)
