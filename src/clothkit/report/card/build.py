"""Writes the card: tables, figures and the page that shows them."""

import json
from pathlib import Path

from clothkit.report.card import croissant, figures, page, tables
from clothkit.report.card.inputs import examples, read
from clothkit.report.card.meanings import settings_table
from clothkit.report.card.measures import highest, limits
from clothkit.report.card.settings import CardConfig
from clothkit.simulation.settings import SimulateConfig


def build(folder: Path, raw: Path, settings: CardConfig, *, located: str = croissant.LOCATED) -> page.Contents:
    """Writes `tables/`, `figures/`, `README.md` and `croissant.json` into a folder; equal artifacts give equal bytes.

    `located` is where the raw artifacts are to be found from the card's place, as a relative path. Returns the contents
    of the page. Raises InputError when artifacts in the folder `raw` are missing or malformed.
    """
    (folder / "tables").mkdir(parents=True)
    (folder / "figures").mkdir()
    inputs = read(raw)
    bounds = limits(inputs.params)
    drawn = tables.drawn(inputs.states, count=settings.sequences, seed=settings.seed)
    worst = tables.worst(inputs.states, count=settings.worst)
    contents = page.Contents(
        inputs=inputs,
        settings=settings_table(inputs.params, SimulateConfig),
        outcomes=tables.outcomes(inputs.attempts),
        hands=tables.hands(inputs.manipulations),
        quality=tables.quality(inputs.states, bounds),
        quality_tried=tables.quality(inputs.tried, bounds),
        against_tried=tables.against_tried(inputs),
        viewport=tables.viewport(inputs.tried, highest(bounds)),
        worst=worst,
        pictured=len(drawn),
        seed=settings.seed,
    )
    for name in page.TABLES:
        table = getattr(contents, name)
        table.to_csv(folder / "tables" / f"{name}.csv", index=False, float_format="%.5g", lineterminator="\n")
    figures.histograms(inputs.states, bounds, folder / "figures/histograms.png")
    figures.sequences(examples(raw, drawn, inputs.manipulations), folder / "figures/sequences.png")
    shown = examples(raw, sorted(set(worst["sequence"].tolist())), inputs.manipulations)
    by_sequence = {example.sequence: example for example in shown}
    figures.worst(worst, by_sequence, folder / "figures/worst.png", highest=highest(bounds))
    (folder / "README.md").write_text(page.page(contents))
    described = croissant.describe(inputs, raw, located=located)
    (folder / "croissant.json").write_text(json.dumps(described, indent=1) + "\n")
    return contents
