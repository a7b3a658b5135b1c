"""How many faults would the tests notice? Mutation testing: small changes of a module, run against its tests.

python benchmarks/mutants.py [PACKAGE|PACKAGE/MODULE ..] [--each N] [--seed N] [--limit SECONDS] [--list]

Cosmic Ray finds the places where a module can be changed and makes the changes: an operator, a sign, a comparison, a
condition, a number, a loop that is never entered. For each PACKAGE (default: all that pyproject.toml names under
[tool.clothkit.mutants]) or single MODULE, the script draws a sample of `--each` places with the seed `--seed` and makes
one change at each place. Each changed module is a mutant. It is run with its mirror tests,
tests/<package>/test_<module>.py, and the tests that pyproject.toml adds. A mutant is killed if a test fails or if the
run takes longer than `--limit`. The script prints every mutant with its change, and the fraction of killed mutants per
package. A mutant that survives is either equivalent to the original or shows that a test is missing. `--list` prints
the sample without running tests.

Annotations and the `strict` argument of `zip` are not changed. Comparisons are negated, but `<` is not replaced by `<=`
or the reverse: nearly all compare floats, which are hardly ever equal. The tests run one after the other in a copy of
the checkout, including uncommitted changes, so that no mutant is left in the checkout. If JAX_COMPILATION_CACHE_DIR is
set, compiled programs are kept for the next run.
"""

import argparse
import ast
import difflib
import importlib
import os
import random
import re
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]
COPIED = ("src", "tests", "docs", "stages", "params.yaml", "pyproject.toml")
"""The parts of the checkout that tests need."""

IMPORTED = ("jax", "flax", "optax", "scipy.stats", "pandas", "cv2")
"""Modules imported once before the tests run in forks of this process, since imports take longer than most tests.

pytest's plugins are not included, because pytest imports them itself."""

_PAUSE = 0.2  # s, between two checks whether a test run has ended
_NO_FAILURE, _FAILURES, _INTERRUPTED, _INTERNAL = range(4)
"""pytest's exit statuses; a failing import gives _INTERRUPTED, since it interrupts the collection."""


class Mutant(NamedTuple):
    """A module with one change."""

    module: str
    """<package>/<module>; a package within another one is <package>/<package>."""
    line: int
    operator: str
    code: str

    @property
    def path(self) -> Path:
        """The module's path in a checkout."""
        return Path("src/clothkit") / f"{self.module}.py"


class Outcome(NamedTuple):
    """The result of the tests of a mutant."""

    killed: bool
    late: bool
    """Whether it was killed by the time limit."""
    seconds: float
    text: str
    """pytest's output."""


def settings() -> dict[str, Any]:
    """Return the table [tool.clothkit.mutants] of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["clothkit"]["mutants"]


Change = tuple[str, int]
"""An operator's name, and the index of a place among those where it can change the module."""


def places(module: str, operators: Iterable[str]) -> list[tuple[str, tuple[int, int], list[Change]]]:
    """Return (module, (line, column), changes) for every place where a module can be changed."""
    nodes = list(ast_nodes(get_ast(source_of(module))))
    found: dict[tuple[int, int], list[Change]] = {}
    for name in operators:
        positions = [start for node in nodes for start, _ in get_operator(name)().mutation_positions(node)]
        for occurrence, place in enumerate(positions):
            found.setdefault(place, []).append((name, occurrence))
    return [(module, place, changes) for place, changes in found.items()]


def source_of(module: str) -> str:
    """Return the source of a module, <package>/<module>."""
    return (ROOT / "src/clothkit" / f"{module}.py").read_text()


def meant(code: str) -> str | None:
    """Return the syntax tree as text without differences that correct callers can't notice, or None if it isn't Python.

    Left out are annotations, which arguments are keyword-only or positional-only, and the `strict` argument of `zip`.
    """
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arguments):
            node.args = [*node.posonlyargs, *node.args, *node.kwonlyargs]
            node.defaults += [default for default in node.kw_defaults if default]
            node.posonlyargs, node.kwonlyargs, node.kw_defaults = [], [], []
        elif isinstance(node, ast.Call):
            node.keywords = [keyword for keyword in node.keywords if keyword.arg != "strict"]
    return ast.dump(tree)


def sample(package: str, modules: Iterable[str], operators: list[str], each: int, seed: int) -> list[Mutant]:
    """Return up to `each` mutants of a package, each at a different place, sorted by module and line."""
    chance = random.Random(f"{seed} {package}")
    every = [place for module in modules for place in places(f"{package}/{module}", operators)]
    found: list[Mutant] = []
    for module, (line, _), changes in chance.sample(every, len(every)):
        if len(found) == each:
            break
        name, occurrence = chance.choice(changes)
        code = source_of(module)
        changed = mutate_code(code, get_operator(name)(), occurrence)
        # The check is needed because Cosmic Ray may read the star of keyword-only arguments as a product.
        if changed and meant(changed) not in (None, meant(code)):
            found.append(Mutant(module, line, name.removeprefix("core/"), changed))
    return sorted(found, key=lambda mutant: (mutant.module, mutant.line))


def mirrors(module: str, beside: dict[str, list[str]]) -> list[str]:
    """Return the paths of a module's tests: the mirror test, if there is one, and those in `beside`."""
    package, name = module.rsplit("/", 1)
    own = f"tests/{package}/test_{name}.py"
    return [*([own] if (ROOT / own).exists() else []), *beside.get(module, [])]


def run_tests(copy: Path, tests: list[str], limit: float) -> Outcome:
    """Run tests in a copy of the checkout until one fails. Raises SystemExit if pytest can't run."""
    started = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = os.fork()
        if process == 0:
            status = _INTERNAL
            try:
                status = _run_here(copy, tests, output.fileno())
            except Exception:
                os.write(output.fileno(), traceback.format_exc().encode())
            finally:
                # Exit without cleaning up: the parent removes the temporary copy.
                os._exit(status)
        late = False
        while not (ended := os.waitpid(process, os.WNOHANG))[0]:
            time.sleep(_PAUSE)
            if time.perf_counter() - started > limit and not late:
                # The whole process group, since tests may have started processes.
                late = True
                os.killpg(process, signal.SIGKILL)
        output.seek(0)
        text = output.read().decode(errors="replace")
    status = os.waitstatus_to_exitcode(ended[1])
    if not late and status not in (_NO_FAILURE, _FAILURES, _INTERRUPTED, _INTERNAL):
        raise SystemExit(f"pytest could not run {' '.join(tests)}:\n{text}")
    return Outcome(status != _NO_FAILURE, late, time.perf_counter() - started, text)


def _run_here(copy: Path, tests: list[str], output: int) -> int:
    """Run pytest in this process, in a new session, on the tests of the copy; return its exit status."""
    os.setsid()
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(copy)
    os.environ["PYTHONPATH"] = f"{copy / 'src'}{os.pathsep}{copy}"
    sys.path[:0] = [str(copy / "src"), str(copy)]
    sys.dont_write_bytecode = True
    return int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]))


def change(original: str, mutant: Mutant) -> Iterator[str]:
    """Yield the lines that a mutant removes and adds, for printing."""
    for line in difflib.unified_diff(original.splitlines(), mutant.code.splitlines(), lineterm="", n=0):
        if not line.startswith(("---", "+++", "@@")):
            yield f"      {line[0]} {line[1:].strip()}"


def main() -> None:
    table = settings()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = {package: (package, names) for package, names in table["modules"].items()}
    parts |= {f"{package}/{name}": (package, [name]) for package, names in table["modules"].items() for name in names}
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", choices=[[], *parts])
    parser.add_argument("--each", type=int, default=table["each"])
    parser.add_argument("--seed", type=int, default=table["seed"])
    parser.add_argument("--limit", type=float, default=table["limit"])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    wanted = re.compile(f"core/({'|'.join(table['operators'])})")
    operators = [name for name in operator_names() if wanted.fullmatch(name)]
    # JAX warns of forks because of its threads, but here it has not started any.
    warnings.filterwarnings("ignore", message="os.fork")
    shares = []
    with tempfile.TemporaryDirectory(prefix="clothkit-mutants-") as folder:
        copy = Path(folder) / "checkout"
        copy.mkdir()
        # Set before the imports below, since JAX reads its environment when it is imported.
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", f"{folder}/compiled")
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        for name in () if options.list else IMPORTED:
            importlib.import_module(name)
        for name in COPIED:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
        sound: set[tuple[str, ...]] = set()
        for part in options.packages or table["modules"]:
            package, names = parts[part]
            mutants = sample(package, names, operators, options.each, options.seed)
            killed, late = 0, 0
            for mutant in mutants:
                original, tests = source_of(mutant.module), mirrors(mutant.module, table["beside"])
                print(f"{mutant.module}.py:{mutant.line} {mutant.operator}", *change(original, mutant), sep="\n")
                if options.list:
                    continue
                if tuple(tests) not in sound:
                    # Tests that fail without a mutant would kill every mutant.
                    plain = run_tests(copy, tests, 10 * options.limit)
                    if plain.killed:
                        raise SystemExit(f"{plain.text}\n{' '.join(tests)}: fails without a mutant")
                    sound.add(tuple(tests))
                (copy / mutant.path).write_text(mutant.code)
                outcome = run_tests(copy, tests, options.limit)
                (copy / mutant.path).write_text(original)
                killed, late = killed + outcome.killed, late + outcome.late
                word = "killed by the time limit" if outcome.late else "killed" if outcome.killed else "SURVIVED"
                print(f"    {word} in {outcome.seconds:.0f} s", flush=True)
            share = f"{killed} of {len(mutants)} killed ({killed / len(mutants):.0%})"
            shares.append(f"{part}: {share}, {late} by time")
    if not options.list:
        print(*shares, sep="\n")


if __name__ == "__main__":
    main()
