"""Cases of mutated inputs: what comes of each, and whether that is right.

A case is told by a seed and a number. Its target, one of TARGETS in turn, runs in a fresh folder on tiny inputs of
which one was changed. Right are two outcomes: one sentence that names what was changed, with nothing written; and a
result, written at the asked place alone, that is what it is without the mutation where the mutation leaves the meaning,
and else finite wherever that is. Everything else is a fault.
"""

import contextlib
import faulthandler
import resource
import shutil
import signal
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clothkit.runtime.errors import InputError
from tests.fuzzing import of_shapes, of_tables  # noqa: F401
from tests.fuzzing.mutations import ANY, REFUSED, SAME, mutations
from tests.fuzzing.results import digest, tree, wildest
from tests.fuzzing.targets import TARGETS, Input, Target, Told

SECONDS, ELAPSED = 60, 300
"""Of a case: CPU time and elapsed time after which it counts as a hang."""

MEMORY = 4 * 2**30
"""Bytes that a case may ask for."""

SAME_RESULT, TAKEN, TOLD = "same result", "another result", "one sentence"
RIGHT = (SAME_RESULT, TAKEN, TOLD)


class Hang(BaseException):
    """A case that does not end. No handler of Exception may take it."""


class Case(NamedTuple):
    """What came of a mutation."""

    number: int
    target: str
    mutation: str
    outcome: str
    """One of RIGHT, or a fault in a few words."""
    detail: str = ""

    @property
    def right(self) -> bool:
        """Whether that is as it should be."""
        return self.outcome in RIGHT


class Fuzzer:
    """Runs cases on inputs that were made once."""

    def __init__(self, base: Path, work: Path, *, seed: int) -> None:
        self.base, self.work, self.seed = base, work, seed
        self._expected: dict[int, str] = {}

    def run(self, number: int, *, keep: bool = False) -> Case:
        """The case of a number, in a folder that is deleted when it was right, unless it is to be kept."""
        place, random = number % len(TARGETS), np.random.default_rng((self.seed, number))
        target = TARGETS[place]
        if place not in self._expected:
            with self._folder(target, f"right_{place}") as folder, _limits():
                self._expected[place] = digest(target.call({}))
            shutil.rmtree(folder)
        chosen = target.inputs[int(random.integers(len(target.inputs)))]
        with self._folder(target, f"case_{number}") as folder:
            changed, said, expected = self._mutated(chosen, random)
            before = tree(folder)
            outcome, detail = self._outcome(target, chosen, changed, expected, place)
            if outcome in RIGHT and (wrong := _written(before, tree(folder), target, changed, outcome)):
                outcome, detail = "other files changed", wrong
        case = Case(number, f"{target.name}: {chosen.path}", said, outcome, detail)
        if case.right and not keep:
            shutil.rmtree(folder)
        return case

    @contextlib.contextmanager
    def _folder(self, target: Target, name: str) -> Iterator[Path]:
        folder = self.work / name
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for path in (*(given.path for given in target.inputs if given.kind != "words"), *target.needs):
            source, copy = self.base / path, folder / path
            if not path or not source.exists():
                continue
            copy.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, copy, dirs_exist_ok=True)
            elif not copy.exists():
                shutil.copyfile(source, copy)
        (folder / "circle").symlink_to("circle")
        with contextlib.chdir(folder):
            yield folder

    def _mutated(self, chosen: Input, random: np.random.Generator) -> tuple[dict[str, str], str, str]:
        while True:
            known = mutations(chosen.kind)
            mutation = known[int(random.integers(len(known)))]
            said = mutation.apply(Path(chosen.path), random)
            if said is not None:
                break
        if chosen.kind == "words":
            return {chosen.path: said}, repr(said), ANY
        expected = ANY if chosen.optional and mutation.outcome == REFUSED else mutation.outcome
        return {}, f"{mutation.name}: {said}", expected

    def _outcome(
        self, target: Target, chosen: Input, changed: dict[str, str], expected: str, place: int
    ) -> tuple[str, str]:
        try:
            with _limits():
                found = target.call(changed)
        except (InputError, Told) as error:
            if expected == SAME:
                return "refused, though nothing is wrong with it", str(error)
            return (
                (TOLD, str(error))
                if _is_sentence(str(error), target, chosen)
                else ("no sentence that names it", str(error))
            )
        except Hang as error:
            return "hang", f"{error}: {_place(error)}"
        except Exception as error:
            return "traceback", f"{type(error).__name__}: {str(error)[:200]} {_place(error)}"
        result = digest(found)
        if result == self._expected[place]:
            return SAME_RESULT, ""
        if expected != ANY:
            return f"taken, expected {expected}", ""
        wild = wildest(found)
        return ("a result that is not finite", wild) if wild else (TAKEN, "")


def _place(error: BaseException) -> str:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "clothkit" in frame.filename]
    return " < ".join(f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(frames[-4:]))


def _is_sentence(said: str, target: Target, chosen: Input) -> bool:
    """Whether it is one line, of no traceback, that names what was changed: the file, a store or folder of it; of
    settings the field; or another input, which it no longer agrees with."""
    parts = Path(chosen.path).parts
    names = [part for part in parts if part != "data"] + [given.path for given in target.inputs]
    if chosen.kind == "words":
        return len(said.splitlines()) == 1 and "Traceback" not in said
    if chosen.path == "params.yaml":
        names.append("app.")
    return len(said.splitlines()) == 1 and any(name in said for name in names)


def _written(
    before: dict[str, str], after: dict[str, str], target: Target, changed: dict[str, str], outcome: str
) -> str:
    """What was changed that should not have been."""
    allowed = () if outcome == TOLD else (*target.outputs, *(word for word in changed.values() if word))
    differ = {path for path in before.keys() | after.keys() if before.get(path) != after.get(path)}
    own = {path for path in differ if any(path == name or path.startswith(f"{name}/") for name in allowed)}
    # A word in an output's place may also change the names of what stands beside it.
    if changed and outcome != TOLD:
        own |= {path for path in differ if path not in before}
    return ", ".join(sorted(differ - own))


@contextlib.contextmanager
def _limits() -> Iterator[None]:
    """Ends what hangs, or asks for more memory than the machine may have."""

    def stop(number: int, _: Any) -> None:
        raise Hang(signal.Signals(number).name)

    before = [(number, signal.signal(number, stop)) for number in (signal.SIGPROF, signal.SIGALRM)]
    old = resource.getrlimit(resource.RLIMIT_DATA)
    with open("/proc/self/statm") as file:
        used = int(file.read().split()[5]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_DATA, (used + MEMORY, old[1]))
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    signal.setitimer(signal.ITIMER_REAL, ELAPSED)
    # What never comes back to Python hears no signal.
    faulthandler.dump_traceback_later(2 * ELAPSED, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_DATA, old)
        for number, handler in before:
            signal.signal(number, handler)
