"""Settings of the dataset card."""

from typing import Annotated

from annotated_types import Ge

from clothkit.runtime.config import config


@config
class CardConfig:
    """Numbers of examples in the pictures."""

    sequences: Annotated[int, Ge(1)] = 12
    """Number of sequences that are drawn at random from all."""
    worst: Annotated[int, Ge(1)] = 2
    """Number of worst states that are shown for each measure."""
    seed: Annotated[int, Ge(0)] = 0
    """Seed of the random draw of sequences."""
