"""The objective of a search: a sum of named terms over one prediction of each plan, eq. (13).

The accuracy term is always there; it also decides which labelling of the goal a plan leads to. Any pytree with a
`weight` and a `__call__` can be a further term (see `Term`), so that terms come from outside this package, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from clothkit.cloth.mesh import smooth_distance
from clothkit.cloth.symmetry import equal_labellings, equivalent_cloths
from clothkit.cloth.topology import SQUARE
from clothkit.models.ensemble import pairs
from clothkit.models.forward import ForwardModel, rollout
from clothkit.planning.representation import Representation
from clothkit.planning.types import UNKNOWN, Problem, Scalar
from clothkit.planning.uncertainty import Spread, uncertainty_of_steps


class Weights(NamedTuple):
    """The weights of the paper's objective: alpha of eq. (13), beta and gamma of eq. (15)."""

    alpha: Scalar
    beta: Scalar
    gamma: Scalar


class Range(NamedTuple):
    """The reference values low and high of eq. (14) for one net, for plans of one to n manipulations."""

    low: Float[Array | np.ndarray, " n"]
    high: Float[Array | np.ndarray, " n"]


class Reference(NamedTuple):
    """Reference values of the loss for plans of n manipulations: ranges of eq. (14) per net, moments of eq. (15)."""

    spans: tuple[Range, ...]
    spread: Spread


@dataclass(frozen=True)
class Outlook:
    """What the terms of an objective are computed from, for a batch of plans ("strains")."""

    representation: Representation
    plan: Float[Array, "strains n 6"]
    """The plans, in the labels of each one's common equivalent."""
    predictions: tuple[Any, ...]
    """Each net's predicted states [n strains ..]; [1 strains ..], the outcomes alone, if no term needs the others."""
    latents: tuple[Float[Array, "n strains latent"], ...] = ()
    """Each net's latents before each manipulation."""
    shifts: tuple[Float[Array, "n strains 2"], ...] = ()
    """Each net's predicted shift of the cloth's centre by each manipulation [normalised]."""
    common: Int[Array, " strains"] | None = None
    """Each plan's common equivalent."""
    steps: Int[Array, ""] | None = None
    """Number of manipulations after which the plans end, if not after all n: then every state is predicted."""

    @property
    def last(self) -> int | Int[Array, ""]:
        """Index of the plans' last state."""
        return -1 if self.steps is None else self.steps - 1

    @property
    def outcomes(self) -> tuple[Any, ...]:
        """Each net's prediction of the state after the last manipulation, [strains ..]."""
        return tuple(jax.tree.map(lambda part: part[self.last], states) for states in self.predictions)

    def mean(self, values: Float[Array, "n strains"]) -> Float[Array, " strains"]:
        """The mean over the plans' manipulations."""
        if self.steps is None:
            return jnp.mean(values, axis=0)
        return jnp.sum(values, axis=0, where=(jnp.arange(len(values)) < self.steps)[:, None]) / self.steps


@runtime_checkable
class Term(Protocol):
    """A further term of an objective: a pytree whose leaves are its parameters, such as a registered dataclass."""

    every_step: ClassVar[bool]
    """Whether the term needs the predicted states after each manipulation, and not the outcomes alone."""

    @property
    def weight(self) -> Scalar:
        """The factor of this term in the sum."""
        ...

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        """The term's value for each plan, without its weight."""
        ...


@runtime_checkable
class PosedTerm(Protocol):
    """A term that depends on the problem: it is told of plans on the support of the problem's state first."""

    draws: int
    """Number of these plans."""

    def posed(self, drawn: Outlook) -> Term:
        """The term for the problem of which `drawn` are plans on the support."""
        ...


@runtime_checkable
class Accuracy(Protocol):
    """What the accuracy term compares and how: a pytree whose leaves are its parameters."""

    def targets(self, representation: Representation, goals: Shaped[Array, "..."]) -> Float[Array, "..."]:
        """Goals, thinned or not, in the form in which they are compared with outcomes."""
        ...

    def of_each(
        self, representation: Representation, targets: Float[Array, "goals *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, "strains goals"]:
        """How unlike each plan's outcome, as that net predicts it, is to each of several targets."""
        ...

    def of(
        self, representation: Representation, target: Float[Array, "strains *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, " strains"]:
        """How unlike each plan's outcome is to its own target; `last` is the index of the last manipulation."""
        ...

    def total(self, of_nets: list[Float[Array, "..."]]) -> Float[Array, "..."]:
        """The term's value from those of all nets."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Likelihood:
    """The accuracy terms of eq. (13): how unlike each net's outcome is to the goal, in its range of eq. (14).

    With K nets their sum is multiplied by 2 / K, so that it weighs as much as the paper's two. With one net (B2) the
    term is that net's plain loss; `spans` is empty then.
    """

    spans: tuple[Range, ...]

    def targets(self, representation: Representation, goals: Shaped[Array, "..."]) -> Float[Array, "..."]:
        return representation.target(goals)

    def of_each(
        self, representation: Representation, targets: Float[Array, "goals *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, "strains goals"]:
        return self.in_range(representation.accuracy_of_each(targets, outcome), net, last)

    def of(
        self, representation: Representation, target: Float[Array, "strains *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, " strains"]:
        return self.in_range(representation.accuracy(target, outcome), net, last)

    def in_range(self, loss: Float[Array, "..."], net: int, last: int | Int[Array, ""] = -1) -> Float[Array, "..."]:
        """A net's loss in its range: 0 for recorded manipulations, 1 for random ones, in the median.

        `last` is the index of the plans' last manipulation.
        """
        if not self.spans:
            return loss
        low, high = (jnp.asarray(values)[last] for values in self.spans[net])
        return (loss - low) / (high - low)

    def total(self, of_nets: list[Float[Array, "..."]]) -> Float[Array, "..."]:
        return sum(of_nets[1:], of_nets[0]) * (2 / len(of_nets) if len(of_nets) > 2 else 1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Distance:
    """The accuracy term in cloth lengths: the distance of each net's mean outcome from the goal, aligned; their mean.

    For meshes only.
    """

    def targets(self, representation: Representation, goals: Shaped[Array, "..."]) -> Float[Array, "..."]:
        return jnp.asarray(goals)

    def of_each(
        self, representation: Representation, targets: Float[Array, "goals *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, "strains goals"]:
        return smooth_distance(jnp.asarray(outcome.mean)[:, None], targets)

    def of(
        self, representation: Representation, target: Float[Array, "strains *state"], outcome: Any, net: int, last: Any
    ) -> Float[Array, " strains"]:
        return smooth_distance(outcome.mean, target)

    def total(self, of_nets: list[Float[Array, "..."]]) -> Float[Array, "..."]:
        return sum(of_nets[1:], of_nets[0]) / len(of_nets)


def mean_difference(representation: Representation, predictions: Sequence[Any]) -> Float[Array, "n *batch"] | None:
    """diff of eq. (15) between nets' predictions, in the mean over all pairs of nets; None for a single net."""
    apart = [representation.difference(a, b) for a, b in pairs(predictions)]
    return sum(apart[1:], apart[0]) / len(apart) if apart else None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Uncertainty:
    """The uncertainty term of eq. (13): u of eq. (15), from the mean difference over all pairs of nets."""

    weight: Scalar
    """alpha"""
    spread: Spread
    beta: Scalar
    gamma: Scalar
    every_step: ClassVar[bool] = True

    def __call__(self, outlook: Outlook) -> Float[Array, " strains"]:
        apart = mean_difference(outlook.representation, outlook.predictions)
        assert apart is not None, "an ensemble of at least two nets"
        return outlook.mean(uncertainty_of_steps(apart, self.spread, beta=self.beta, gamma=self.gamma))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Objective:
    """The sum of the accuracy term and of further ones by name, each with its weight."""

    accuracy: Accuracy
    terms: Mapping[str, Term]

    @property
    def draws(self) -> int:
        """Number of plans on the support that terms need when a problem is posed."""
        return max((term.draws for term in self.terms.values() if isinstance(term, PosedTerm)), default=0)

    def posed(self, drawn: Outlook) -> "Objective":
        """The objective for one problem, of which `drawn` are plans on the support."""
        terms = {n: term.posed(drawn) if isinstance(term, PosedTerm) else term for n, term in self.terms.items()}
        return replace(self, terms=terms)

    def with_term(self, name: str, term: Term) -> "Objective":
        """The objective with one more term, instead of one of that name if there is one."""
        return replace(self, terms={**self.terms, name: term})


def objective_of(nets: int, reference: Reference, weights: Weights) -> Objective:
    """The paper's objective for that number of nets, for plans of the length that `reference` is for.

    Without alpha, or with one net, there is no uncertainty term.
    """
    accuracy = Likelihood(reference.spans if nets > 1 else ())
    if nets == 1 or float(weights.alpha) == 0:
        return Objective(accuracy, {})
    return Objective(
        accuracy, {"uncertainty": Uncertainty(weights.alpha, reference.spread, weights.beta, weights.gamma)}
    )


class Fixed(NamedTuple):
    """Constants of a search: for each net, latents of the state's equivalents and traces; the goal's equivalents."""

    latents: tuple[Float[Array, "labels latent"], ...]
    traces: tuple[Float[Array, "labels latent"], ...]
    goals: Float[Array, "labels *state"]
    same: Bool[Array, "labels"]
    """Which relabellings leave the cloth's sides as they are."""


def fix(model: ForwardModel, representation: Representation, nets: tuple[Any, ...], problem: Problem) -> Fixed:
    """Compute the quantities that are constant during the search for one problem."""
    states = representation.equivalents(jnp.asarray(problem.state))
    cloths = equivalent_cloths(problem.cloth)[: representation.labels]
    return Fixed(
        tuple(model.encode(net, states, cloths) for net in nets),
        tuple(jnp.asarray(trace) for trace in problem.traces),
        representation.equivalents(jnp.asarray(problem.goal)),
        equal_labellings(problem.cloth)[: representation.labels],
    )


class Evaluation(NamedTuple):
    """The objective's value for each plan, its terms by name, and the goal's relative labelling."""

    loss: Float[Array, " strains"]
    terms: dict[str, Shaped[Array, "strains *net"]]
    relative: Int[Array, " strains"]


def evaluate(
    objective: Objective,
    model: ForwardModel,
    representation: Representation,
    nets: tuple[Any, ...],
    fixed: Fixed,
    plan: Float[Array, "strains n 6"],
    common: Int[Array, " strains"],
    relative: Int[Array, " strains"],
    *,
    stride: int = 1,
    steps: Int[Array, ""] | None = None,
) -> Evaluation:
    """Evaluate plans, each in the labels of its common equivalent.

    Where `relative` is `UNKNOWN`, the labelling of the goal that minimises the accuracy term is used, as in eq. (12).
    Predictions and goals are compared at every `stride`-th vertex along u and v. With `steps`, plans are evaluated as
    if they ended after so many manipulations.
    """
    every_step = steps is not None or any(term.every_step for term in objective.terms.values())
    decoded = slice(None) if every_step else slice(-1, None)
    rolled = [
        rollout(model, net, latent[common], plan, trace[common])
        for net, latent, trace in zip(nets, fixed.latents, fixed.traces, strict=True)
    ]
    outlook = Outlook(
        representation,
        plan,
        tuple(model.decode(net, found.latents[decoded], stride) for net, found in zip(nets, rolled, strict=True)),
        tuple(
            jnp.concatenate([first[common][None], found.latents[:-1]])
            for first, found in zip(fixed.latents, rolled, strict=True)
        ),
        tuple(found.shifts for found in rolled),
        common,
        steps,
    )
    # Goals are thinned before they are whitened, because predictions are whitened by the moments of their own vertices.
    accuracy = objective.accuracy
    goals = accuracy.targets(representation, representation.thinned(fixed.goals, stride))
    of_each = [
        accuracy.of_each(representation, goals, outcome, net, outlook.last)
        for net, outcome in enumerate(outlook.outcomes)
    ]
    # Row by row, the relabelling of the goal that each of its equivalents is for a plan in that common equivalent.
    relabellings = jnp.asarray(SQUARE.composed)[: len(fixed.same), jnp.asarray(SQUARE.inverses)[common]].T
    unlike = jnp.where(fixed.same[relabellings], jax.lax.stop_gradient(sum(of_each)), jnp.inf)
    nearest = jnp.argmin(unlike, axis=1)
    found = jnp.take_along_axis(relabellings, nearest[:, None], axis=1)[:, 0]
    relative = jnp.where(relative == UNKNOWN, found, relative)
    goal = goals[jnp.asarray(SQUARE.composed)[relative, common]]
    accuracies = [
        accuracy.of(representation, goal, outcome, net, outlook.last) for net, outcome in enumerate(outlook.outcomes)
    ]
    loss = accuracy.total(accuracies)
    terms: dict[str, Array] = {"accuracy": jnp.stack(accuracies, axis=-1)}
    for name, term in objective.terms.items():
        terms[name] = term(outlook)
        loss = loss + term.weight * terms[name]
    return Evaluation(loss, terms, relative)
