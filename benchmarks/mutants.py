"""How many faults would the tests notice? Small changes of the code, one at a time, against the tests of its module.

python benchmarks/mutants.py [PACKAGE|PACKAGE/MODULE ..] [--each N] [--seed N] [--limit SECONDS] [--list]

Cosmic Ray finds the places where a module can be changed and makes the changes: an operator, a sign, a comparison, a
condition, a number, a loop that is never entered. Of every PACKAGE, all that pyproject.toml names under
[tool.clothkit.mutants] unless some are given, or of a single MODULE of it, a sample of `--each` places that is drawn
with `--seed` is changed, each in one way. Each changed module, a mutant, is tried with its mirror tests,
tests/<package>/test_<module>.py and what pyproject.toml names beside them. A test that fails kills the mutant, and so
does a run that takes longer than `--limit`. Printed are every mutant, with the change, and per package the share of
killed ones. A mutant that survives either means the same as the original, or shows that a test is missing. `--list`
prints the sample without running a test.

Annotations and the strictness of `zip` are no places to change. Comparisons are negated, and never made strict or lax:
nearly all of them compare floats, which are hardly ever equal. Tests run one after the other, in a copy of the checkout
with what is not committed, so that no mutant is left behind. With JAX_COMPILATION_CACHE_DIR set, compiled programs are
kept for the next run.
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
"""What tests need of the checkout."""

IMPORTED = ("jax", "flax", "optax", "scipy.stats", "pandas", "cv2")
"""What is imported once, before tests run in forks of this process: imports take longer than most tests. Plugins of
pytest are not among them: these it imports itself."""

_PAUSE = 0.2  # seconds between looks at a running test
_NO_FAILURE, _FAILURES, _INTERRUPTED, _INTERNAL = range(4)
"""pytest's exit statuses; an import that fails interrupts the collection."""


class Mutant(NamedTuple):
    """A module with one change."""

    module: str
    """<package>/<module>"""
    line: int
    operator: str
    code: str

    @property
    def path(self) -> Path:
        """Where the module is in a checkout."""
        return Path("src/clothkit") / f"{self.module}.py"


class Outcome(NamedTuple):
    """What the tests make of a mutant."""

    killed: bool
    late: bool
    """Whether it was killed by the time limit."""
    seconds: float
    said: str
    """pytest's output."""


def settings() -> dict[str, Any]:
    """The table of pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["clothkit"]["mutants"]


Change = tuple[str, int]
"""An operator's name, and which of the places where it could change a module."""


def places(module: str, operators: Iterable[str]) -> list[tuple[str, tuple[int, int], list[Change]]]:
    """The places of a module, line and column, where it could be changed, and how."""
    nodes = list(ast_nodes(get_ast(source_of(module))))
    found: dict[tuple[int, int], list[Change]] = {}
    for name in operators:
        positions = [start for node in nodes for start, _ in get_operator(name)().mutation_positions(node)]
        for occurrence, place in enumerate(positions):
            found.setdefault(place, []).append((name, occurrence))
    return [(module, place, changes) for place, changes in found.items()]


def source_of(module: str) -> str:
    """The code of a module, <package>/<module>."""
    return (ROOT / "src/clothkit" / f"{module}.py").read_text()


def meant(code: str) -> str | None:
    """The syntax tree as text, without what no caller that is right can notice: annotations, which arguments have to be
    named, whether `zip` is strict. None if it isn't Python."""
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
    """So many mutants of a package, each at another place, in the order of modules and lines."""
    chance = random.Random(f"{seed} {package}")
    every = [place for module in modules for place in places(f"{package}/{module}", operators)]
    found: list[Mutant] = []
    for module, (line, _), changes in chance.sample(every, len(every)):
        if len(found) == each:
            break
        name, occurrence = chance.choice(changes)
        code = source_of(module)
        changed = mutate_code(code, get_operator(name)(), occurrence)
        # What Cosmic Ray takes for a product may be the star of keyword arguments.
        if changed and meant(changed) not in (None, meant(code)):
            found.append(Mutant(module, line, name.removeprefix("core/"), changed))
    return sorted(found, key=lambda mutant: (mutant.module, mutant.line))


def mirrors(module: str, beside: dict[str, list[str]]) -> list[str]:
    """The tests of a module."""
    package, name = module.split("/")
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
                # The copy is the parent's to clear away.
                os._exit(status)
        late = False
        while not (ended := os.waitpid(process, os.WNOHANG))[0]:
            time.sleep(_PAUSE)
            if time.perf_counter() - started > limit and not late:
                # Tests may have started processes of their own.
                late = True
                os.killpg(process, signal.SIGKILL)
        output.seek(0)
        said = output.read().decode(errors="replace")
    status = os.waitstatus_to_exitcode(ended[1])
    if not late and status not in (_NO_FAILURE, _FAILURES, _INTERRUPTED, _INTERNAL):
        raise SystemExit(f"pytest could not run {' '.join(tests)}:\n{said}")
    return Outcome(status != _NO_FAILURE, late, time.perf_counter() - started, said)


def _run_here(copy: Path, tests: list[str], output: int) -> int:
    """pytest in this process: in a group of its own, for tests of the copy."""
    os.setsid()
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.chdir(copy)
    os.environ["PYTHONPATH"] = f"{copy / 'src'}{os.pathsep}{copy}"
    sys.path[:0] = [str(copy / "src"), str(copy)]
    sys.dont_write_bytecode = True
    return int(pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *tests]))


def change(original: str, mutant: Mutant) -> Iterator[str]:
    """The lines that a mutant takes away and brings."""
    for line in difflib.unified_diff(original.splitlines(), mutant.code.splitlines(), lineterm="", n=0):
        if not line.startswith(("---", "+++", "@@")):
            yield f"      {line[0]} {line[1:].strip()}"


def main() -> None:
    table = settings()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    modules = {f"{package}/{name}": (name,) for package, names in table["modules"].items() for name in names}
    parser.add_argument("packages", nargs="*", metavar="PACKAGE", choices=[[], *table["modules"], *modules])
    parser.add_argument("--each", type=int, default=table["each"])
    parser.add_argument("--seed", type=int, default=table["seed"])
    parser.add_argument("--limit", type=float, default=table["limit"])
    parser.add_argument("--list", action="store_true")
    options = parser.parse_args()
    wanted = re.compile(f"core/({'|'.join(table['operators'])})")
    operators = [name for name in operator_names() if wanted.fullmatch(name)]
    # JAX minds forks once it has threads; here it has none.
    warnings.filterwarnings("ignore", message="os.fork")
    shares = []
    with tempfile.TemporaryDirectory(prefix="clothkit-mutants-") as folder:
        copy = Path(folder) / "checkout"
        copy.mkdir()
        # JAX reads its environment when it is imported.
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", f"{folder}/compiled")
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        for name in () if options.list else IMPORTED:
            importlib.import_module(name)
        for name in COPIED:
            source = ROOT / name
            (shutil.copytree if source.is_dir() else shutil.copy)(source, copy / name)
        sound: set[tuple[str, ...]] = set()
        for package in options.packages or table["modules"]:
            names = modules.get(package) or table["modules"][package]
            chosen = sample(package.split("/")[0], names, operators, options.each, options.seed)
            killed, late = 0, 0
            for mutant in chosen:
                original, tests = source_of(mutant.module), mirrors(mutant.module, table["beside"])
                print(f"{mutant.module}.py:{mutant.line} {mutant.operator}", *change(original, mutant), sep="\n")
                if options.list:
                    continue
                if tuple(tests) not in sound:
                    # What fails anyway would kill every mutant.
                    plain = run_tests(copy, tests, 10 * options.limit)
                    if plain.killed:
                        raise SystemExit(f"{plain.said}\n{' '.join(tests)}: fails without a mutant")
                    sound.add(tuple(tests))
                (copy / mutant.path).write_text(mutant.code)
                outcome = run_tests(copy, tests, options.limit)
                (copy / mutant.path).write_text(original)
                killed, late = killed + outcome.killed, late + outcome.late
                word = "killed by the time limit" if outcome.late else "killed" if outcome.killed else "SURVIVED"
                print(f"    {word} in {outcome.seconds:.0f} s", flush=True)
            shares.append(f"{package}: {killed} of {len(chosen)} killed ({killed / len(chosen):.0%}), {late} by time")
    if not options.list:
        print(*shares, sep="\n")


if __name__ == "__main__":
    main()
