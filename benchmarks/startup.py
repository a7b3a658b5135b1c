"""How long does it take until the first work is done, and how much of that is compilation?

python benchmarks/startup.py [--csv FOLDER]

Each row is a command in a process of its own, with its wall seconds and the CPU seconds of it and its children: the
imports of clothkit, JAX and Warp; stage `simulate` at scale smoke for a single sequence; and README's first command,
`clothkit plan` with the prebuilt nets. All but the imports run with several contents of the folder of caches: `empty`,
as on a new machine, `full`, as left by the row before, and `full` without one of its parts: JAX's compiled programs,
Warp's compiled kernels, the named goals that were made, or the prebuilt nets that were unpacked. The folder is a new
one, so yours is neither used nor changed.
"""

import argparse
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tables import show, write

ROOT = Path(__file__).resolve().parents[1]
TITLE = "start-up: from the command to its end"
LINKED = ("src", "stages", "examples", "prebuilt")
IMPORTS = ("pass", "import clothkit", "import jax", "import warp", "import clothkit.app.plan")
STAGE = "stages/simulate.py"
PLAN = shlex.split(
    "-m clothkit plan --state examples/towel.ply --goal half --sides 0.5 0.3 --thickness 0.005 --table 0 0 -1 -0.8"
)
PARTS = {
    "JAX's programs": "clothkit/compiled",
    "Warp's kernels": "warp",
    "named goals": "clothkit/goals",
    "unpacked nets": "clothkit/prebuilt",
}
"""Parts of the folder of caches, as commands fill it."""


def copied(folder: Path) -> Path:
    """Make a working directory with this checkout's code and prebuilt nets, at scale smoke with a single sequence."""
    place = folder / "checkout"
    place.mkdir()
    for name in LINKED:
        (place / name).symlink_to(ROOT / name)
    (place / "params.yaml").write_text(single(ROOT.joinpath("params.yaml").read_text()))
    return place


def single(params: str) -> str:
    """Return the text of params.yaml with scale smoke, which records one sequence."""
    params = re.sub(r"^scale: .*", "scale: smoke", params, flags=re.MULTILINE)
    return re.sub(r"(^  smoke:.*?^ +sequences: )\d+", r"\g<1>1", params, count=1, flags=re.MULTILINE | re.DOTALL)


def spent(arguments: list[str], place: Path, caches: Path) -> dict:
    """Run Python with these arguments in a process of its own, and return its wall and CPU seconds.

    Ends this program with the process's message if it fails.
    """
    environment = {**os.environ, "PYTHONPATH": "src", "XDG_CACHE_HOME": str(caches)}
    for name in ("WARP_CACHE_PATH", "JAX_COMPILATION_CACHE_DIR"):
        environment.pop(name, None)
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    ended = subprocess.run(
        [sys.executable, *arguments], cwd=place, env=environment, capture_output=True, text=True, check=False
    )
    wall, after = time.perf_counter() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode:
        sys.exit(f"{' '.join(arguments)}\n{ended.stderr}")
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall s": round(wall, 2), "CPU s": round(cpu, 2)}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    rows: list[dict] = []

    def measure(what: str, held: str, arguments: list[str]) -> None:
        rows.append({"what": what, "caches": held} | spent(arguments, place, caches))
        write(TITLE, rows, asked.csv)

    with tempfile.TemporaryDirectory() as name:
        place, caches = copied(Path(name)), Path(name) / "caches"
        for statement in IMPORTS:
            measure(f'python -c "{statement}"', "not used", ["-c", statement])
        for held in ("empty", "full"):
            measure("stage simulate, smoke, one sequence", held, [STAGE])
        shutil.rmtree(caches)
        for held in ("empty", "full"):
            measure("clothkit plan (README)", held, PLAN)
        for part, folder in PARTS.items():
            shutil.rmtree(caches / folder)
            measure("clothkit plan (README)", f"without {part}", PLAN)
    show(TITLE, rows, csv=asked.csv)


if __name__ == "__main__":
    main()
