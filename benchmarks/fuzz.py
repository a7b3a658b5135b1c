"""Does every loader and every command end with a sentence or a right result, whatever is wrong with its input?

python benchmarks/fuzz.py [--cases N] [--seed S] [--case K ..] [--target WORDS] [--quick]

Runs N cases (500 if not said), each a loader or a command with one input mutated (tests/fuzzing): bytes, values of
JSON and YAML, columns and rows of tables, chunks and metadata of stores, arrays, headers and positions of clouds and
meshes, links and folders in place of files, strange arguments. Right are one sentence that names what was changed, with
no file written, and a result that agrees with that of the sound input, or is finite where the mutation changed what the
input says. Tracebacks, hangs, other files that changed and damage that is taken in silence are faults: these are
printed as they come, and at the end a table of targets and outcomes. Exits with 1 if there was a fault.

`--case K` runs the cases of these numbers, and keeps the folders in which they ran; `--target` only those cases whose
target contains these words. `--quick` leaves out searches and simulations, as the test in the suite does. `--taken`
also prints the cases in which a mutated input was taken and gave another result: no rule tells whether these should
have been refused.
"""

import argparse
import contextlib
import sys
import tempfile
import warnings
from collections import Counter
from pathlib import Path

from tables import show
from tqdm import tqdm

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.fuzzing.cases import RIGHT, TAKEN, TARGETS, Fuzzer
from tests.fuzzing.inputs import write_inputs
from tests.fuzzing.targets import quick, serving


def main() -> None:
    """Run the cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, nargs="+")
    parser.add_argument("--target", default="")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--taken", action="store_true")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    work = Path(tempfile.mkdtemp(prefix="clothkit-fuzz-"))
    (work / "base").mkdir()
    write_inputs(work / "base")
    fuzzer = Fuzzer(work / "base", work, seed=asked.seed)
    numbers = asked.case or [k for k in range(asked.cases) if asked.target in TARGETS[k % len(TARGETS)].name]
    found: dict[str, Counter[str]] = {}
    with quick() if asked.quick else serving(), contextlib.redirect_stdout(sys.stderr):
        for number in tqdm(numbers, desc="fuzz", unit="case", mininterval=1):
            case = fuzzer.run(number, keep=bool(asked.case))
            name = TARGETS[number % len(TARGETS)].name
            found.setdefault(name, Counter())[case.outcome if case.right else "fault"] += 1
            if asked.case or not case.right or (asked.taken and case.outcome == TAKEN):
                tqdm.write(f"{case}\n  in {work}/case_{number}")
    columns = (*RIGHT, "fault")
    total = sum(found.values(), Counter())
    rows = [
        {"target": name, **{column: counts[column] for column in columns}}
        for name, counts in [*sorted(found.items()), ("all", total)]
    ]
    show(f"{total.total()} cases of seed {asked.seed}", rows)
    sys.exit(1 if total["fault"] else 0)


if __name__ == "__main__":
    main()
