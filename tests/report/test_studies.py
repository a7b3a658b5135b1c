"""Figures of the studies: what is drawn is what the rows say."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from clothkit.dataset.tasks import TASKS
from clothkit.report import panels
from clothkit.report.figures import studies


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Figures as they were saved."""
    found: list[Figure] = []
    original = panels.save

    def keep(figure: Figure, path: Path) -> None:
        found.append(figure)
        original(figure, path)

    monkeypatch.setattr(panels, "save", keep)
    return found


def test_recipes_name_the_best_by_their_mean_over_seeds(tmp_path: Path, drawn: list[Figure]) -> None:
    runs = {("good", 0): 0.05, ("good", 1): 0.07, ("base", 0): 0.2, **{(f"v{k}", 0): 0.1 + 0.01 * k for k in range(8)}}
    table = pd.DataFrame(
        [
            {"variant": variant, "seed": seed, "minutes": check + 1.0, "score": score + 0.1 * (2 - check)}
            for (variant, seed), score in runs.items()
            for check in range(3)
        ]
    )
    studies.recipes(table, tmp_path / "recipes.png")
    axis = drawn[0].axes[0]
    texts = {text.get_text() for text in axis.texts}
    assert "good: 0.0600" in texts
    assert "base: 0.2000" in texts
    assert "v7: 0.1700" not in texts
    assert len(axis.lines) == 10
    ends = [line.get_ydata()[-1] for line in axis.lines]
    assert min(ends) == pytest.approx(0.06)


def test_weights_and_search(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = []
    for alpha, beta, gamma in [(0, 5, 1.25), (1, 5, 1.25), (1, 10, 1.25), (1, 5, 2.5)]:
        for start, length in TASKS:
            for sequence in range(4):
                error = 0.1 * length - 0.05 * alpha + 0.01 * sequence
                rows.append(
                    {
                        "alpha": alpha,
                        "beta": beta,
                        "gamma": gamma,
                        "sequence": sequence,
                        "start": start,
                        "length": length,
                        "error": error + 0.03 * start,
                    }
                )
    usual = {"alpha": 1.0, "beta": 5.0, "gamma": 1.25}
    studies.weights(pd.DataFrame(rows), usual, tmp_path / "alpha.png")
    by_start = drawn[0].axes[:3]
    # A panel for each start, with a line for each length that is left, and one at the weight in force, the second.
    assert [len(axis.lines) for axis in by_start] == [4, 3, 2]
    np.testing.assert_allclose(by_start[0].lines[1].get_ydata(), [0.215, 0.165])
    np.testing.assert_allclose(by_start[1].lines[1].get_ydata(), [0.245, 0.195])
    assert [axis.lines[-1].get_xdata()[0] for axis in by_start] == [1, 1, 1]
    assert [len(axis.lines[0].get_xdata()) for axis in drawn[0].axes] == [2] * 9
    sizes = [(16, 15, 2, True), (64, 15, 2, True), (64, 30, 2, True), (64, 15, 4, True), (64, 15, 2, False)]
    table = pd.DataFrame(
        [
            {
                "fold": fold,
                "stride": stride,
                "near": 0.5,
                "strains": strains,
                "base_iterations": more,
                "iterations_per_step": more,
                "length": length,
                "seconds": strains * more / stride,
                "error": 1 / strains,
                "loss": 1.0,
                "loss_recorded": 0.5 if strains == 16 else 2.0,
                "evaluations": strains * more * (1 + length),
            }
            for strains, more, stride, fold in sizes
            for length in (1, 2, 3)
        ]
    )
    names = ["strains", "base_iterations", "iterations_per_step", "stride", "near", "fold"]
    usual = dict(zip(names, (64, 15, 15, 2, 0.5, True), strict=True))
    studies.search(table, usual, tmp_path / "search.png")
    failures = drawn[1].axes[1]
    np.testing.assert_allclose(failures.lines[0].get_ydata(), [1, 0])
    # One manipulation: 64 x 60 evaluations with other iterations, 64 x 30 with other vertices.
    assert [line.get_xdata().tolist() for line in failures.lines[:5]] == [[480, 1920], [3840], [1920], [], [1920]]


def test_ensembles(tmp_path: Path, drawn: list[Figure]) -> None:
    measures = ("error", "prediction_error", "failure", "seconds")
    rows = [
        {"nets": nets, "measure": measure, "column": f"{length}/{start}", "mean": length / nets + place}
        for place, measure in enumerate(measures)
        for nets in (5, 1, 2)
        for length in (1, 2, 3)
        for start in ("all", "0")
    ]
    table = pd.DataFrame(rows).assign(low=lambda found: found["mean"] - 0.1, high=lambda found: found["mean"] + 0.2)
    minutes = pd.DataFrame({"nets": [1, 2, 5], "measure": "training_minutes", "column": "all", "mean": [9.0, 18, 45]})
    studies.ensemble(pd.concat([table, minutes]), tmp_path / "ensemble.png")
    axes = {axis.get_ylabel().split(" [")[0]: axis for axis in drawn[0].axes}
    seconds = axes["search per plan"]
    assert [line.get_xdata().tolist() for line in seconds.lines[:3]] == [[1, 2, 5]] * 3
    np.testing.assert_allclose(seconds.lines[1].get_ydata(), [3 + 2, 3 + 1, 3 + 2 / 5])
    # The band of one manipulation, at one net and at five.
    band = axes["planning error"].collections[0].get_paths()[0].vertices
    assert {tuple(np.round(corner, 6)) for corner in band} >= {(1, 0.9), (1, 1.2), (5, 0.1), (5, 0.4)}
    assert axes["training"].lines[3].get_ydata().tolist() == [9, 18, 45]
    assert all(not len(line.get_xdata()) for line in axes["u of the first plan"].lines)


def test_optimisers_by_budget(tmp_path: Path, drawn: list[Figure]) -> None:
    rows = [
        {
            "contestant": name,
            "budget": budget,
            "length": length,
            "error": error * length,
            "error_low": error * length - 0.01,
            "error_high": error * length + 0.02,
            "search_failures": share,
            "search_failures_low": np.nan,
            "search_failures_high": np.nan,
        }
        for name, budget, error, share in [
            ("gradient", "both", 0.1, 0.2),
            ("cem", "evaluations", 0.2, 0.4),
            ("cem", "seconds", 0.05, 0.1),
            ("mppi", "seconds", 0.3, 0.6),
        ]
        for length in (1, 2, 3)
    ]
    studies.optimisers(pd.DataFrame(rows), tmp_path / "optimisers.png")
    by_label = [
        {bars.get_label(): bars.lines[0].get_ydata().tolist() for bars in axis.containers} for axis in drawn[0].axes
    ]
    reference = "gradient (reference)"
    assert [set(names) for names in by_label] == 2 * [{reference, "CEM"}] + 2 * [{reference, "CEM", "MPPI"}]
    assert by_label[0][reference] == by_label[2][reference] == pytest.approx([0.1, 0.2, 0.3])
    assert by_label[0]["CEM"] == pytest.approx([0.2, 0.4, 0.6])
    assert by_label[2]["CEM"] == pytest.approx([0.05, 0.1, 0.15])
    assert by_label[3]["MPPI"] == pytest.approx([60] * 3)
    (bars,) = drawn[0].axes[0].containers[0].lines[2]
    np.testing.assert_allclose(bars.get_segments()[1][:, 1], [0.19, 0.22])
    assert not drawn[0].axes[0].texts
    studies.optimisers(pd.DataFrame(rows).assign(error=np.nan), tmp_path / "optimisers.png")
    assert [text.get_text() for text in drawn[1].axes[0].texts] == ["not executed"]
