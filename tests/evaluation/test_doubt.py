"""How well measures of uncertainty rank errors, against counting all pairs."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.evaluation import doubt

VALUES = st.lists(st.tuples(st.integers(0, 5), st.booleans()), min_size=1, max_size=30)


@given(VALUES)
def test_auroc_is_the_share_of_pairs_in_the_right_order(values: list[tuple[int, bool]]) -> None:
    measure, positive = (np.array(part) for part in zip(*values, strict=True))
    pairs = [(a > b) + 0.5 * (a == b) for a in measure[positive] for b in measure[~positive]]
    found = doubt.auroc(measure.astype(float), positive)
    assert found == pytest.approx(np.mean(pairs)) if pairs else np.isnan(found)


def probes(seed: int = 0, sequences: int = 12) -> pd.DataFrame:
    """Probes whose error the distance tells exactly, and sigma not at all."""
    rng = np.random.default_rng(seed)
    count = 8 * sequences
    error = rng.uniform(0, 0.2, count)
    return pd.DataFrame(
        {
            "sequence": np.repeat(np.arange(sequences), 8),
            "start": np.tile([0, 0, 0, 0, 1, 1, 2, 2], sequences),
            "step": np.tile([1, 1, 2, 3, 1, 1, 1, 1], sequences),
            "kind": np.tile(["recorded", "displaced", "random", "random", "recorded", "grasped"] * 2, sequences)[
                :count
            ],
            "error": error,
            **dict.fromkeys(("deviations", "conditional"), np.nan),
            "distance": error**2,
            "sigma": rng.uniform(size=count),
            "surprise": rng.uniform(size=count),
            "expected": -error,
        }
    )


def test_the_summary_ranks_measures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doubt, "DRAWS", 50)
    found = doubt.summary(probes()).set_index(["measure", "group", "statistic"]).sort_index()
    assert set(found.index.get_level_values("measure")) == {"distance", "sigma", "surprise", "expected"}
    assert set(found.index.get_level_values("group")) == {
        "all", "start 0", "start 1", "start 2", "step 1", "step 2", "step 3"
    }  # fmt: skip
    best, worst = found.loc[("distance", "all")], found.loc[("expected", "all")]
    assert best.loc["wrong", "value"] == best.loc["rank", "value"] == 1
    assert worst.loc["wrong", "value"] == 0
    assert worst.loc["rank", "value"] == -1
    chance = found.loc[("sigma", "all", "wrong")]
    assert chance["low"] < 0.5 < chance["high"]
    assert (found["low"].fillna(0) <= found["high"].fillna(0)).all()
