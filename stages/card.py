"""Writes the dataset card of the raw artifacts, reports/<scale>/dataset/: `python stages/card.py`."""

import shutil
from pathlib import Path

from clothkit.report.card.build import build
from clothkit.report.card.inputs import PARTS
from clothkit.runtime.stage import stage

RAW = Path("data/raw")
OUTS = ("tables", "figures", "README.md", "croissant.json")


def main() -> None:
    """Write the card and publish each of its parts as a DVC out."""
    with stage("card") as s:
        card = s.work(inputs=[RAW / part for part in PARTS]) / "card"
        shutil.rmtree(card, ignore_errors=True)
        contents = build(card, RAW, s.params)
        print(contents.against_tried.to_string(index=False))
        for out in OUTS:
            s.publish(card / out, f"reports/{s.shared.scale}/dataset/{out}")


if __name__ == "__main__":
    main()
