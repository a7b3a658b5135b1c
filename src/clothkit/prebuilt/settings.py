"""Settings of the prebuild stage."""

from typing import Annotated

from annotated_types import Ge, Gt

from clothkit.runtime.config import config


@config
class PrebuildConfig:
    """How nets are packed, and on how much it is measured what that costs."""

    half: tuple[str, ...] = ("pemd/M", "pemd/D/layer")
    """Weights that are kept in 16 bits instead of 8: those whose names begin with one of these. By default M, whose
    layers are applied one after another, manipulation after manipulation, and D's hidden layers: a fifth more bytes of
    a forward model, and at `laptop` predictions of two manipulations that deviate by 0.0009 cloth lengths in place of
    0.0031."""
    sequences: Annotated[int, Gt(0)] = 10
    """Validation sequences whose states are estimated, and whose tasks are predicted and planned, with both nets."""
    executed: Annotated[int, Ge(0)] = 5
    """Of these, the sequences whose sessions are executed."""
    within: Annotated[float, Gt(0)] = 0.02
    """Largest accepted share by which mean errors of packed nets, less a standard error, are above those of the full
    ones."""
    megabytes: Annotated[float, Gt(0)] = 30.0
    """Largest accepted size of all packed files."""
