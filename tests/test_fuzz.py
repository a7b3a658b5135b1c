"""Mutated inputs of every loader and command: a sentence or the right result, and no other file changed.

`python benchmarks/fuzz.py --seed 0 --quick --case N` tells what a case is about; without --quick it searches and
simulates, too.
"""

from collections.abc import Iterator

import pytest

from tests.fuzzing.cases import TARGETS, Fuzzer
from tests.fuzzing.inputs import write_inputs
from tests.fuzzing.targets import quick

EACH = 2
"""Cases of a target."""


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fuzzer]:
    base = tmp_path_factory.mktemp("fuzz")
    write_inputs(base)
    with quick():
        yield Fuzzer(base, tmp_path_factory.mktemp("cases"), seed=0)


@pytest.mark.parametrize("number", range(EACH * len(TARGETS)), ids=lambda k: f"{TARGETS[k % len(TARGETS)].name}-{k}")
def test_a_mutated_input_is_told_or_rightly_taken(fuzzer: Fuzzer, number: int) -> None:
    case = fuzzer.run(number)
    assert case.right, case
