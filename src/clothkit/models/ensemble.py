"""Ensembles: K nets of one kind and configuration, trained alike from different random keys (section 5.1)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import TypeVar

from jaxtyping import PyTree

from clothkit.models import store
from clothkit.models.forward import ForwardModel, forward_model
from clothkit.models.net import Net
from clothkit.models.store import ATTRIBUTES, Kind, validation_score
from clothkit.runtime.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Ensemble:
    """K forward nets by member. Raises InputError unless members differ and their nets have one configuration."""

    members: tuple[int, ...]
    nets: tuple[Net, ...]
    """The net of each member, in the same order."""
    best: int = 0
    """Index of the net with the lowest validation score."""

    def __post_init__(self) -> None:
        if not self.members or len(set(self.members)) != len(self.members) or len(self.members) != len(self.nets):
            raise InputError(
                f"ensemble: expected at least one member and a net for each, no member twice, found members "
                f"{self.members} and {len(self.nets)} nets"
            )
        if any(net.config != self.nets[0].config for net in self.nets):
            raise InputError("ensemble: expected nets of one configuration, found several")

    @property
    def model(self) -> ForwardModel:
        """The forward model that all the nets' weights belong to."""
        return forward_model(self.nets[0].config)

    @property
    def best_net(self) -> Net:
        """The net with the lowest validation score."""
        return self.nets[self.best]

    @property
    def params(self) -> tuple[PyTree, ...]:
        """The weights of each net, as the model takes them."""
        return tuple(net.params for net in self.nets)


def folder(nets: Path, kind: Kind, member: int) -> Path:
    """The folder of a member's net of that kind, under the folder of all nets."""
    return nets / kind / str(member)


def folders(nets: Path, kind: Kind, members: Sequence[int]) -> dict[int, Path]:
    """The folder of each member's net of that kind, under the folder of all nets."""
    return {member: folder(nets, kind, member) for member in members}


def member_named(name: str, members: Sequence[int]) -> int:
    """The member whose number a stage's argument is. Raises InputError if there is none."""
    if name not in map(str, members):
        raise InputError(f"expected a member of the ensemble, {' or '.join(map(str, members))}, found {name}")
    return int(name)


def load(nets: Path, kind: Kind, members: Sequence[int]) -> Ensemble:
    """Read the nets of the members. Raises InputError for one that is missing, damaged or unlike the others."""
    found = folders(nets, kind, members)
    loaded = {member: store.load(folder, kind) for member, folder in found.items()}
    for member, net in loaded.items():
        if net.config != loaded[members[0]].config:
            raise InputError(
                f"{found[member] / ATTRIBUTES}: net: expected the configuration of {found[members[0]]}, with which it "
                "makes an ensemble, found another"
            )
    return Ensemble(tuple(members), tuple(loaded.values()), tuple(members).index(best_member(found)))


def best_member(folders: Mapping[int, Path]) -> int:
    """The member whose net has the lowest validation score; of equal ones, the first.

    Raises InputError if a net's description can't be read or has no score.
    """
    scores = {member: validation_score(folder) for member, folder in folders.items()}
    return min(scores, key=scores.__getitem__)


def pairs(items: Sequence[T]) -> list[tuple[T, T]]:
    """All pairs of different items, each once: K (K - 1) / 2 of them, none for a single item."""
    return list(combinations(items, 2))
