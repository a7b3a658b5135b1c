"""The uncertainty term of a planner's objective, by name: what the planner minimises beside the distance to its goal.

paper        u of eq. (15): the nets' difference, in deviations over all states, with the accuracy term of eq. (13)
conditional  the same relative to plans on the support of the very state (`conditional.py`)
support      how surprising the manipulations are (`model_error.Surprise`)
expected     the expected error of the predicted outcome [cloth length], with the accuracy term in the same unit:
             with alpha = 1, which needs no tuning, the objective is an upper bound (by the triangle inequality) of the
             expected distance of the real outcome from the goal, if the expected error is right in the mean
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, get_args

from annotated_types import Ge, Gt

from clothkit.cloth.topology import SQUARE
from clothkit.models import support_model
from clothkit.models.ensemble import Ensemble
from clothkit.planning import error_map
from clothkit.planning.conditional import Conditional
from clothkit.planning.model_error import SIGNS, ModelError, Surprise
from clothkit.planning.objective import Accuracy, Distance, Term
from clothkit.planning.types import Scalar
from clothkit.runtime.config import config

Measure = Literal["paper", "conditional", "support", "expected"]
MEASURES: tuple[Measure, ...] = get_args(Measure)

SUPPORT, EXPECTED_ERROR = "nets/support.npz", "normalisation/expected_error.json"
"""Places of the support model and of the map of `model_error`, under the folder of all artifacts."""


@config
class UncertaintyConfig:
    """Which measure of uncertainty plans are judged by. Systems that plan in voxels always have that of the paper."""

    measure: Measure = "paper"
    u_weight: Annotated[float, Ge(0)] = 0.01
    """paper: alpha of eq. (13) where alpha in params.yaml is 1. The paper gives none, and u has no unit."""
    draws: Annotated[int, Gt(0)] = 64
    """conditional: plans on the support with which a problem is posed."""
    deviations: float = 2.0
    """conditional: from how many deviations above their median on a plan is doubted."""


def needed(measure: Measure) -> dict[str, str]:
    """Places of the artifacts that a measure needs, by name, under the folder of all artifacts."""
    places = {"support": SUPPORT, "expected_error": EXPECTED_ERROR}
    names = {"support": ["support"], "expected": ["support", "expected_error"]}
    return {name: places[name] for name in names.get(measure, [])}


def terms_of(
    settings: UncertaintyConfig, alpha: Scalar, ensemble: Ensemble, data: Path
) -> tuple[Accuracy | None, Mapping[str, Term]]:
    """Return the accuracy term and the uncertainty term that are not the paper's, for nets that predict meshes.

    Both are empty where the paper's are asked for; without alpha, or where one net can't be doubted by the measure,
    there is no uncertainty term. Raises InputError if an artifact is missing or damaged.
    """
    measure, accuracy = settings.measure, Distance() if settings.measure == "expected" else None
    nets, alone = ensemble.params, len(ensemble.params) == 1
    if measure == "paper" or float(alpha) == 0 or (alone and measure != "support"):
        return accuracy, {}
    if measure == "conditional":
        return accuracy, {"uncertainty": Conditional(alpha, settings.deviations, draws=settings.draws)}
    width = support_model.width_of(ensemble.model, nets[ensemble.best], SQUARE.flat())
    support = support_model.load(data / SUPPORT, width=width)
    surprise = Surprise(alpha, support, ensemble.model, ensemble.best)
    if measure == "support":
        return accuracy, {"uncertainty": surprise}
    error = error_map.load(data / EXPECTED_ERROR, SIGNS)
    return accuracy, {"uncertainty": ModelError(alpha, error, surprise)}
