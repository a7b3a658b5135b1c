"""Ways to search for plans, one module each, behind one protocol (space.py) and by name (registry.py)."""

from clothkit.planning.optimisers.cem import CEMConfig, cross_entropy
from clothkit.planning.optimisers.gradient import GradientConfig, descend
from clothkit.planning.optimisers.greedy import GreedyConfig, greedy
from clothkit.planning.optimisers.hybrid import HybridConfig, in_turn
from clothkit.planning.optimisers.mppi import MPPIConfig, path_integral
from clothkit.planning.optimisers.random_shooting import RandomShootingConfig, shoot
from clothkit.planning.optimisers.registry import (
    OPTIMISERS,
    AnySettings,
    Optimiser,
    evaluations,
    optimise,
    optimiser,
    register,
)

__all__ = ["OPTIMISERS", "AnySettings", "Optimiser", "evaluations", "optimise", "optimiser", "register"]

register("gradient", GradientConfig, descend)
register("random_shooting", RandomShootingConfig, shoot)
register("cem", CEMConfig, cross_entropy)
register("mppi", MPPIConfig, path_integral)
register("greedy", GreedyConfig, greedy)
register("hybrid", HybridConfig, in_turn)
