"""Probes: manipulations that are executed to learn where the nets are wrong, and what tells it.

They start from true states of the validation split. Kinds:

recorded    the recorded manipulations, one to three: on the data's support
displaced   hands at detected corners, any displacement
grasped     any grasp points, any displacement
random      plans of three manipulations as searches start from: the first on the support, then any
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float
from tqdm import tqdm

from clothkit.cloth.mesh import ProbabilisticMesh, distance
from clothkit.cloth.silhouette import centred
from clothkit.dataset.store import STEPS, Dataset
from clothkit.episodes.sessions import Execute
from clothkit.evaluation.settings import ProbeConfig
from clothkit.evaluation.tidy import PROBE_KINDS as KINDS
from clothkit.manipulation.candidates import CandidateConfig
from clothkit.manipulation.draws import REACH, SINGLE_SHARE, random_manipulations
from clothkit.manipulation.geometry import release_points
from clothkit.manipulation.vector import is_null, is_single
from clothkit.models.ensemble import Ensemble
from clothkit.models.forward import predict
from clothkit.models.support_model import SupportModel, inputs, surprise
from clothkit.planning.batches import in_batches, take
from clothkit.planning.conditional import Conditional, deviations
from clothkit.planning.error_map import ErrorMap, expected_by_others, fit
from clothkit.planning.initial import random_plans
from clothkit.planning.measures import Measures, measure
from clothkit.planning.mesh_representation import MESH
from clothkit.planning.model_error import LEAST, SIGNS
from clothkit.planning.objective import Distance, Objective
from clothkit.planning.search import posed_objective
from clothkit.planning.types import Candidates, Problem
from clothkit.planning.uncertainty import Spread
from clothkit.runtime.resumable import array_storage, resumable_map

BATCH = 24

POSED = 4
"""States for which plans on their support are predicted in one call."""

TOGETHER = 5
"""Sequences whose probes are executed together; an interrupted run loses those of so many at most."""


class Probes(NamedTuple):
    """Plans of up to three manipulations and what came of them, a row per plan; steps after a plan's end are NaN."""

    sequence: np.ndarray
    start: np.ndarray
    kind: np.ndarray
    """Index into KINDS."""
    manipulation: Float[np.ndarray, "probe planned 6"]
    state: Float[np.ndarray, "probe u v 3"]
    outcome: Float[np.ndarray, "probe planned u v 3"]
    """True states after each manipulation, centred."""


def drawn(
    dataset: Dataset, sequence: int, settings: ProbeConfig, grasping: CandidateConfig
) -> Iterator[tuple[str, int, Float[np.ndarray, "n 6"]]]:
    """Yield kind, start and manipulations [n 6] of a sequence's probes that have to be executed."""
    key = jax.random.fold_in(jax.random.key(settings.seed), sequence)
    length = int(dataset.length[sequence])
    for start in range(length):
        own = jax.random.fold_in(key, start)
        state = dataset.vertices[sequence, start]
        candidates = MESH.candidates(state, grasping)
        rng = np.random.default_rng([settings.seed, sequence, start])
        for _ in range(settings.displaced):
            yield "displaced", start, displaced(rng, state, candidates)[None]
        for k in range(settings.grasped):
            manipulation = np.asarray(random_manipulations((16,), key=jax.random.fold_in(own, k)))
            yield "grasped", start, manipulation[~np.asarray(is_null(manipulation))][:1]
    for k in range(settings.random):
        start = (sequence + k) % length
        state = dataset.vertices[sequence, start]
        found = MESH.candidates(state, grasping)
        offers = Candidates(np.resize(found, (grasping.most, 2)), len(found))
        xy = MESH.points(state, jnp.asarray(offers.grasps))
        own = jax.random.fold_in(key, STEPS + k)
        plans = random_plans(16, STEPS, offers, xy, covered=MESH.covered(state), edge=settings.edge, key=own)
        valid = ~np.asarray(is_null(plans)).any(axis=1)
        yield "random", start, np.asarray(plans)[valid][0]


def displaced(
    rng: np.random.Generator, state: Float[np.ndarray, "u v 3"], candidates: Float[np.ndarray, "candidates 2"]
) -> Float[np.ndarray, "6"]:
    """Draw a manipulation with hands at candidates and any displacement that is not null."""
    while True:
        hands = 1 if rng.random() < SINGLE_SHARE or len(candidates) < 2 else 2
        chosen = candidates[rng.choice(len(candidates), hands, replace=False)]
        pair = np.stack([chosen[0], chosen[-1]])
        displacement = rng.uniform(-REACH, REACH, 2)
        manipulation = np.concatenate([pair.ravel(), displacement]).astype(np.float32)
        same_side = release_points(np.asarray(MESH.points(state, jnp.asarray(pair))), displacement).same_side
        if bool(same_side) and not bool(is_null(manipulation)):
            return manipulation


def execute_probes(
    dataset: Dataset, settings: ProbeConfig, grasping: CandidateConfig, execute: Execute, *, work: Path
) -> Probes:
    """Draw the probes of the first validation sequences, and execute them; grasp points lie on the true states.

    Recorded manipulations are among the probes, with their recorded outcomes. `work` stores finished parts, from which
    an interrupted run resumes.
    """
    sequences = dataset.indices("validation")[: settings.sequences].tolist()
    parts = [sequences[i : i + TOGETHER] for i in range(0, len(sequences), TOGETHER)]
    with tqdm(total=len(sequences), desc="probe", unit="sequence") as bar:
        finished = resumable_map(
            lambda part: executed(dataset, part, settings, grasping, execute),
            parts,
            folder=work,
            name="probes",
            storage=array_storage(Probes),
            bar=bar,
            count=lambda piece: len(np.unique(piece.sequence)),
        )
        done = [piece.value for piece in finished]
    return Probes(*(np.concatenate(parts) for parts in zip(*done, recorded(dataset, sequences), strict=True)))


def executed(
    dataset: Dataset, sequences: list[int], settings: ProbeConfig, grasping: CandidateConfig, execute: Execute
) -> Probes:
    """Return the probes of these sequences, without the recorded ones."""
    rows = [(s, *probe) for s in sequences for probe in drawn(dataset, s, settings, grasping)]
    sequence, start = (np.array([row[i] for row in rows], np.int64) for i in (0, 2))
    kind = np.array([KINDS.index(str(row[1])) for row in rows], np.int64)
    manipulation = np.full((len(rows), STEPS, 6), np.nan, np.float32)
    for place, (*_, own) in enumerate(rows):
        manipulation[place, : len(own)] = own
    state = dataset.vertices[sequence, start]
    outcome = np.full((len(rows), STEPS, *state.shape[1:]), np.nan, np.float32)
    cloths, now, centre = dataset.cloths(sequence), state.copy(), dataset.centre[sequence, start].copy()
    for step in range(STEPS):
        acting = np.flatnonzero(np.isfinite(manipulation[:, step]).all(axis=1))
        if not len(acting):
            break
        own = manipulation[acting, step]
        place = MESH.positions(now[acting], own[:, :4].reshape(-1, 2, 2)) + centre[acting, None]
        meshes = now[acting] + np.pad(centre[acting], ((0, 0), (0, 1)))[:, None, None]
        after = execute(meshes, place, own[:, 4:], np.asarray(is_single(own)), take(cloths, acting))
        for row, mesh in zip(acting, after, strict=True):
            now[row], centre[row] = centred(mesh)
        outcome[acting, step] = now[acting]
    return Probes(sequence, start, kind, manipulation, state, outcome)


def recorded(dataset: Dataset, sequences: list[int]) -> Probes:
    """Return the recorded manipulations from every state of the sequences to the last one."""
    pairs = np.array([(s, i) for s in sequences for i in range(int(dataset.length[s]))])
    manipulation = np.full((len(pairs), STEPS, 6), np.nan, np.float32)
    outcome = np.full((len(pairs), STEPS, *dataset.vertices.shape[2:]), np.nan, np.float32)
    for place, (s, i) in enumerate(pairs):
        left = int(dataset.length[s]) - i
        manipulation[place, :left] = dataset.manipulation[s, i : i + left]
        outcome[place, :left] = dataset.vertices[s, i + 1 : i + left + 1]
    kind = np.zeros(len(pairs), int)
    return Probes(pairs[:, 0], pairs[:, 1], kind, manipulation, dataset.vertices[pairs[:, 0], pairs[:, 1]], outcome)


class Predicted(NamedTuple):
    """What the nets predict of probes: steps after a plan's end mean nothing."""

    errors: Float[np.ndarray, "net probe planned"]
    """Of each net's mean [cloth length]."""
    error: Float[np.ndarray, "probe planned"]
    """Of the mean of all nets' means."""
    measures: Measures
    """[probe planned] each"""
    surprise: Float[np.ndarray, "probe planned"]
    """Of the manipulations so far, summed."""
    conditional: Float[np.ndarray, "probe planned"]
    """z of the measure `conditional`; NaN for a single net."""


def predicted(
    ensemble: Ensemble,
    support: SupportModel,
    probes: Probes,
    cloth: Float[np.ndarray, "probe 3"],
    grasping: CandidateConfig,
    *,
    seed: int = 0,
) -> Predicted:
    """Predict the probes from their true start states, and compare with what came of them.

    `support` is the support model of the ensemble's best net. The measure `conditional` draws plans on the support of
    each start state, whose first hands are at its candidates (`grasping`), with `seed`.
    """
    model = ensemble.model

    @jax.jit
    def own(state: Array, manipulation: Array, outcome: Array, cloth: Array) -> tuple[Array, Array, Measures, Array]:
        found = [predict(model, net, state, manipulation, cloth=cloth) for net in ensemble.params]
        states = [ProbabilisticMesh(*(jnp.swapaxes(part, 0, 1) for part in each)) for each, _ in found]
        means = jnp.stack([jnp.asarray(each.mean) for each in states])
        first = model.encode(ensemble.params[ensemble.best], state, cloth)
        before = jnp.concatenate([first[None], found[ensemble.best][1].latents[:-1]])
        surprises = surprise(support, inputs(model, before, jnp.swapaxes(manipulation, 0, 1)))
        errors = jnp.moveaxis(distance(means, outcome), 0, -1)
        return errors, distance(means.mean(0), outcome), measure(states), jnp.cumsum(surprises, axis=0).T

    plans = np.nan_to_num(probes.manipulation)
    errors, error, measures, surprises = in_batches(own, BATCH, probes.state, plans, probes.outcome, cloth)
    measures = Measures(*measures)
    conditional = np.full_like(measures.difference, np.nan)
    if len(ensemble.params) > 1:
        conditional = np.asarray(deviations(measures.difference, *usual(ensemble, probes, cloth, grasping, seed=seed)))
    return Predicted(np.moveaxis(errors, -1, 0), error, measures, surprises, conditional)


def usual(
    ensemble: Ensemble,
    probes: Probes,
    cloth: Float[np.ndarray, "probe 3"],
    grasping: CandidateConfig,
    *,
    seed: int,
) -> tuple[Float[np.ndarray, "probe planned"], Float[np.ndarray, "probe planned"]]:
    """Return median and spread of the logarithm of the nets' difference for plans on the support of each start state.

    They are those of the term with which a planner's problem from that state is posed (`conditional.Conditional`).
    """
    model, nets = ensemble.model, ensemble.params
    of_start = np.stack([probes.sequence, probes.start], axis=1)
    starts, first, place = np.unique(of_start.astype(np.uint32), axis=0, return_index=True, return_inverse=True)
    states, count = probes.state[first], len(first)
    found = [MESH.candidates(state, grasping) for state in states]
    grasps = np.stack([np.resize(points, (grasping.most, 2)) for points in found])
    widths = [jax.eval_shape(model.encode, net, jnp.asarray(states[0])).shape[-1] for net in nets]
    problems = Problem(
        state=states,
        goal=states,
        candidates=Candidates(grasps, np.array([len(points) for points in found])),
        traces=tuple(np.zeros((count, MESH.labels, width), np.float32) for width in widths),
        relative=np.zeros(count, np.int32),
        later=np.zeros(count, bool),
        carried=np.zeros((count, STEPS, 6), np.float32),
        cloth=cloth[first],
        covered=np.stack([MESH.covered(state) for state in states]),
    )
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), starts[:, 0])
    keys = jax.vmap(jax.random.fold_in)(keys, starts[:, 1])
    objective = Objective(Distance(), {"uncertainty": Conditional(1.0, 0.0)})

    @jax.jit
    def own(problems: Problem, keys: Array) -> Any:
        def one(problem: Problem, key: Array) -> Any:
            term: Any = posed_objective(objective, model, MESH, nets, problem, STEPS, key).terms["uncertainty"]
            return term.median, term.spread

        return jax.vmap(one)(problems, keys)

    median, spread = in_batches(own, POSED, problems, keys)
    return median[place.ravel()], spread[place.ravel()]


def table(probes: Probes, found: Predicted, spread: Spread) -> pd.DataFrame:
    """Return a row per probe and manipulation, with the columns

    sequence, start, kind, step (1..3), error and error_<net> (of the mean of all nets' means, and of each net's mean,
    labelled [cloth length]), difference (diff of eq. 15), deviations (the same in deviations of eq. 15: u_i),
    conditional (its logarithm in deviations of plans on the start's support: z_i), distance, sigma, surprise, and
    expected: the error that a map expects which was fitted to the other sequences' probes.
    """
    row, step = np.nonzero(np.isfinite(probes.manipulation).all(axis=2))
    measures = Measures(*(values[row, step] for values in found.measures))
    # A single net differs from no other.
    pooled = np.full(len(row), np.nan)
    if len(spread.mean):
        # Where no validation sequence is so long, there is nothing to compare with.
        known = step < len(spread.mean)
        mean, std = (np.asarray(values)[step[known]] for values in spread)
        pooled[known] = (np.asarray(measures.difference)[known] - mean) / std
    told = (measures.distance, measures.sigma, found.surprise[row, step])
    signs = {name: np.asarray(values) for name, values in zip(SIGNS, told, strict=True)}
    error, sequence = found.error[row, step], probes.sequence[row]
    columns = {
        "sequence": sequence,
        "start": probes.start[row],
        "kind": np.array(KINDS)[probes.kind[row]],
        "step": step + 1,
        "error": error,
        **{f"error_{k}": errors[row, step] for k, errors in enumerate(found.errors)},
        "difference": measures.difference,
        "deviations": pooled,
        "conditional": found.conditional[row, step],
        **signs,
        "expected": expected_by_others(signs, LEAST, step, error, sequence),
    }
    return pd.DataFrame(columns)


def fitted_to(rows: pd.DataFrame) -> ErrorMap:
    """Return the map fitted to all probes."""
    signs = {name: rows[name].to_numpy() for name in SIGNS}
    return fit(signs, LEAST, rows["step"].to_numpy() - 1, rows["error"].to_numpy())
