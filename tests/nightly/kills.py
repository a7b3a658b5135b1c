"""The chain at smoke scale, killed many times at random: it must end with the bytes of an unbroken run.

    ./run python -m tests.nightly.kills [KILLS] [--seed 0] [--folder FOLDER]

Runs the chain unbroken, and then in another checkout, where `dvc repro` is killed with all its processes KILLS times
(default: 50), 5 to 60 seconds after its start, and at last left alone. Every kill and every output that differs is
printed. It takes an hour on two cores, so it is no test of the suite. Reports are left out: they tell how long stages
took.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from ruamel.yaml import YAML

from tests.pipeline.test_smoke import Checkout, ran

SOONEST, LATEST = 5.0, 60.0
"""Seconds from a start to its kill."""


def outs(checkout: Checkout) -> dict[str, str]:
    """Return the hash of every out of the chain but reports, by path."""
    stages = YAML(typ="safe").load(checkout.folder / "dvc.lock")["stages"]
    found = {out["path"]: out["md5"] for stage in stages.values() for out in stage["outs"]}
    return {path: md5 for path, md5 in found.items() if not path.startswith("reports/")}


def killed(checkout: Checkout, after: float) -> str | None:
    """Run the chain, and kill it after that many seconds; return what it printed if it ended before."""
    process = checkout.start("dvc", "repro")
    try:
        return process.communicate(timeout=after)[0]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None


def main() -> None:
    """Run both chains, and exit with 1 if an output differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kills", type=int, nargs="?", default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="an empty folder for both checkouts (default: a temporary one)")
    asked = parser.parse_args()
    rng = random.Random(asked.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder = asked.folder or Path(temporary)
        for name in ("unbroken", "broken"):
            (folder / name).mkdir(parents=True)
        unbroken, broken = Checkout(folder / "unbroken"), Checkout(folder / "broken")
        started = time.monotonic()
        unbroken.run("dvc", "repro")
        print(f"unbroken: {time.monotonic() - started:.0f} s", flush=True)
        for number in range(asked.kills):
            after = rng.uniform(SOONEST, LATEST)
            said = killed(broken, after)
            if said is not None and not ran(said) and "up to date" not in said:
                sys.exit(f"start {number + 1} ended by itself:\n{said}")
            print(f"kill {number + 1} after {after:.1f} s: {'' if said is None else 'it had ended'}", flush=True)
        broken.run("dvc", "repro")
        wanted, found = outs(unbroken), outs(broken)
        differing = sorted(path for path in wanted.keys() | found.keys() if wanted.get(path) != found.get(path))
        print(f"{len(wanted)} outputs, {len(differing)} differ {' '.join(differing)}")
        sys.exit(1 if differing else 0)


if __name__ == "__main__":
    main()
