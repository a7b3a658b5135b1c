"""What a net predicts, whatever forward model its weights belong to."""

from typing import Any

from clothkit.models.forward import Rollout, forward_model, predict
from clothkit.models.net import Net


def predicted_by(net: Net, state: Any, manipulations: Any, trace: Any = None) -> tuple[Any, Rollout]:
    """The predictions after each manipulation, and the rollout."""
    return predict(forward_model(net.config), net.params, state, manipulations, trace)
