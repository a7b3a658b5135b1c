"""Figure 11: planning error against prediction error, a dot per task."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd

from clothkit.report import panels
from clothkit.report.figures.curves import COLOURS


def scatter(
    planning: pd.DataFrame,
    prediction: pd.DataFrame,
    predictor_of: Mapping[str, str],
    planners: Sequence[str],
    path: Path,
) -> None:
    """Writes a chart per planner: planning error against prediction error of the test tasks, coloured by length.

    `predictor_of` names, for a planner, the predictor with the same input: main for main, which start from estimates,
    and a1 for b1, which start from true meshes. Errors are in cloth lengths.
    """
    shown = [system for system in planners if system in predictor_of]
    figure, axes = panels.chart(len(shown), width=3.4, height=3.4)
    keys = ["split", "sequence", "start", "length"]
    foreseen = prediction[prediction["better"]]
    pairs = {}
    for system in shown:
        own = foreseen.loc[foreseen["system"] == predictor_of[system], [*keys, "error"]]
        planned = planning.loc[(planning["system"] == system) & (planning["split"] == "test"), [*keys, "error"]]
        pairs[system] = planned.merge(own, on=keys, suffixes=("_planning", "_prediction"))
    limit = 1.05 * max(
        [pair[["error_planning", "error_prediction"]].to_numpy().max() for pair in pairs.values() if len(pair)] or [0.1]
    )
    for axis, (system, pair) in zip(axes, pairs.items(), strict=True):
        for length, colour in zip((3, 2, 1), COLOURS[::-1], strict=True):
            dots = pair[pair["length"] == length]
            axis.plot(
                dots["error_prediction"],
                dots["error_planning"],
                "o",
                color=colour,
                markersize=4,
                alpha=0.75,
                markeredgewidth=0,
                label=f"{length} step{'s' if length > 1 else ''}",
            )
        axis.plot([0, limit], [0, limit], color="#bbbbbb", linewidth=0.8, zorder=0)
        # The limits are below 0, so that dots at the origin are not cut.
        axis.set(xlim=(-0.025 * limit, limit), ylim=(-0.025 * limit, limit), aspect="equal")
        axis.set_title(system, fontsize=9)
        axis.set_xlabel("prediction error [cloth length]", fontsize=8)
    axes[0].set_ylabel("planning error [cloth length]", fontsize=8)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles[::-1], labels[::-1], fontsize=8, frameon=False, loc="outside upper center", ncols=3)
    panels.save(figure, path)
