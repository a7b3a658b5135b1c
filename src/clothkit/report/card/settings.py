"""Settings of the dataset card."""

from typing import Annotated

from annotated_types import Ge

from clothkit.config import config


@config
class CardConfig:
    """How many examples the pictures show."""

    sequences: Annotated[int, Ge(1)] = 12
    """Drawn at random among all."""
    worst: Annotated[int, Ge(1)] = 2
    """States that are shown for each of the measures by which one can be the worst."""
    seed: Annotated[int, Ge(0)] = 0
    """Of the draw."""
