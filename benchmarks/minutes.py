"""What did each stage of the chain take before, and what does it take now?  python benchmarks/minutes.py COMMIT [..]

Compares timings.csv of a report at COMMIT of this repository with the one in this checkout, or at `--now COMMIT`.
Variants of a stage (plan@main, plan@b1, ..) are added up. A stage that one side does not have, or that was restored
from the cache, is empty there. Wall minutes count what else the machine did; CPU minutes do so less.

`--report FOLDER` (default: reports/laptop) is the report, `--csv FOLDER` writes the table.
"""

import argparse
import io
import subprocess
import sys
from pathlib import Path

import pandas as pd
from tables import show


def timings(report: Path, commit: str | None) -> pd.DataFrame:
    """Return the wall and CPU minutes of a report by stage, at a commit or as they lie here."""
    path = report / "timings.csv"
    if commit is None:
        text = path.read_text()
    else:
        ended = subprocess.run(["git", "show", f"{commit}:{path}"], capture_output=True, text=True, check=False)
        if ended.returncode:
            sys.exit(ended.stderr.strip())
        text = ended.stdout
    return by_stage(pd.read_csv(io.StringIO(text)))


def by_stage(rows: pd.DataFrame) -> pd.DataFrame:
    """Return wall and CPU minutes by stage, the sum over its variants."""
    stages = rows["stage"].str.split("@").str[0]
    return (rows[["seconds", "cpu_seconds"]] / 60).groupby(stages).sum()


def compared(before: pd.DataFrame, now: pd.DataFrame) -> list[dict]:
    """Return a row per stage and one for all of them."""
    both = pd.concat([before.add_suffix(" before"), now.add_suffix(" now")], axis=1).sort_index()
    both.loc["all"] = both.sum()
    return [
        {
            "stage": stage,
            "wall min before": minutes["seconds before"],
            "wall min now": minutes["seconds now"],
            "CPU min before": minutes["cpu_seconds before"],
            "CPU min now": minutes["cpu_seconds now"],
        }
        for stage, minutes in both.round(1).iterrows()
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", metavar="COMMIT")
    parser.add_argument("--now", metavar="COMMIT")
    parser.add_argument("--report", type=Path, default=Path("reports/laptop"))
    parser.add_argument("--csv", type=Path)
    asked = parser.parse_args()
    rows = compared(*(timings(asked.report, commit) for commit in (asked.before, asked.now)))
    show(f"minutes: {asked.report.name}, {asked.before} and {asked.now or 'this checkout'}", rows, csv=asked.csv)


if __name__ == "__main__":
    main()
