"""What is told of a plan's uncertainty: the measure that its search weighed, and the value of it."""

import jax.numpy as jnp

from clothkit.app.planner import Planned
from clothkit.planning.planner import Planner
from clothkit.planning.uncertainty import uncertainty
from clothkit.planning.uncertainty_terms import Measure


def measure_of(planner: Planner) -> Measure | None:
    """Return the measure of uncertainty that a planner's searches weigh; None: they weigh none."""
    weighs = planner.system.doubts and float(planner.weights.alpha) != 0
    return planner.settings.uncertainty.measure if weighs else None


def epistemic_uncertainty(planner: Planner, planned: Planned) -> float | None:
    """Return u of eq. (15) for a plan; None if there is only one net, or searches weigh something else."""
    if planned.differences is None or measure_of(planner) != "paper":
        return None
    spread = planner.normalisation.reference(len(planned.plan)).spread
    apart = jnp.asarray(planned.differences)
    return float(uncertainty(apart, spread, beta=planner.weights.beta, gamma=planner.weights.gamma))
