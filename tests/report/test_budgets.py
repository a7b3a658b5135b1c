"""Budgets against counts by hand, and which systems they set apart."""

import dataclasses
import math
import re
from pathlib import Path

import pandas as pd
import pytest

from clothkit.models.settings import EnsembleConfig, PEMDConfig
from clothkit.planning.optimisers.gradient import GradientConfig
from clothkit.planning.search import SearchConfig
from clothkit.report import run_settings
from clothkit.report.budgets import budgets, differ, difference, difference_of_training
from clothkit.runtime.errors import InputError
from tests.report.contents import LAPTOP

SEARCH = SearchConfig(optimiser=GradientConfig(strains=64, base_iterations=10, iterations_per_step=10, screen=8))
VOXEL_SEARCH = SearchConfig(optimiser=GradientConfig(strains=16, base_iterations=10, iterations_per_step=5, screen=8))
RUN = dataclasses.replace(run_settings.read(LAPTOP / "params.yaml"), search=SEARCH, voxel_search=VOXEL_SEARCH)


def times(**cpu_seconds: float) -> pd.DataFrame:
    rows = [(name.replace("__", "@"), seconds) for name, seconds in cpu_seconds.items()]
    return pd.DataFrame(rows, columns=["stage", "cpu_seconds"])


TIMES = times(train_pemd__0=600, train_pemd__1=660, train_emd_voxel__0=300, train_emd_voxel__1=330, plan__b4=9)
TABLE = budgets(RUN, TIMES, ["main", "b2", "b4", "b5"])


def row(source: str, system: str) -> dict[str, float]:
    return TABLE[(TABLE["source"] == source) & (TABLE["system"] == system)].iloc[0].to_dict()


def test_budgets_by_hand() -> None:
    main, voxels, paper = row("clothkit", "main"), row("clothkit", "b5"), row("paper", "main")
    # 64 strains, each the best of 8, 10 + 10 n iterations; the voxel baseline 16, 8 and 10 + 5 n; the paper 256, which
    # are not chosen among more, and 25 + 25 n.
    assert [main[f"evaluations_{n}"] for n in (1, 2, 3)] == [64 * (8 + 20), 64 * (8 + 30), 64 * (8 + 40)]
    assert [voxels[f"evaluations_{n}"] for n in (1, 2, 3)] == [16 * (8 + 15), 16 * (8 + 20), 16 * (8 + 25)]
    assert [paper[f"evaluations_{n}"] for n in (1, 2, 3)] == [256 * 50, 256 * 75, 256 * 100]
    assert [main[f"iterations_{n}"] for n in (1, 2, 3)] == [20, 30, 40]
    assert [system["strains"] for system in (main, voxels, paper)] == [64, 16, 256]
    assert [paper[f"iterations_{n}"] for n in (1, 2, 3)] == [50, 75, 100]
    assert (main["nets"], row("clothkit", "b2")["nets"], voxels["nets"]) == (2, 1, 1)
    assert (main["training_cpu_minutes"], voxels["training_cpu_minutes"]) == (21, 10.5)
    # Design 6.3: 43.1 million weights at table 1's sizes.
    assert paper["parameters"] == pytest.approx(43.1e6, rel=1e-3)
    assert math.isnan(row("clothkit", "vtm")["training_cpu_minutes"])
    assert pd.isna(row("clothkit", "vtm")["evaluations_1"])


def test_an_ensembles_budget_is_that_of_its_members() -> None:
    """Not of nets that were trained for another ensemble; of older reports it is that of all."""
    of_three = dataclasses.replace(RUN, ensemble=EnsembleConfig(members=(0, 1, 3)))
    notes = times(train_pemd__0=60, train_pemd__1=60, train_pemd__2=6000, train_pemd__3=120)
    of = budgets(of_three, notes, ["main", "b2"]).set_index(["source", "system"])
    assert (of.loc[("clothkit", "main"), "nets"], of.loc[("clothkit", "b2"), "nets"]) == (3, 1)
    assert of.loc[("clothkit", "main"), "training_cpu_minutes"] == 4
    assert of.loc[("paper", "main"), "nets"] == 2
    before = budgets(RUN, times(train_pemd__a=600, train_pemd__b=660), ["main"])
    assert before["training_cpu_minutes"].iloc[0] == 21


def test_parameters_of_a_small_net_by_hand() -> None:
    small = PEMDConfig(latent=2, encoder=(3,), manipulation=2, decoder=(3,))
    made = dataclasses.replace(RUN, pemd=dataclasses.replace(RUN.pemd, net=small))
    found = int(budgets(made, None, ["main"])["parameters"].iloc[0])
    encoder = 3072 * 3 + 3 + 3 * 2 + 2
    decoder = 2 * 3 + 3 + 3 * 6144 + 6144
    # M: 14 hidden layers, each of which gets the manipulation too; skips without biases from 2, 4, .., 12.
    first = (2 + 2 + 6) * 2 + 2
    hidden = 13 * ((2 + 6) * 2 + 2)
    output = (2 + 6) * (2 + 2 + 2) + (2 + 2 + 2)
    skips = 6 * (2 + 6) * 2
    assert abs(found - (encoder + decoder + first + hidden + output + skips)) <= 6 * 6 * 2


def test_unequal_means_are_told_apart() -> None:
    assert differ(TABLE, "main", "b4")
    assert not differ(TABLE, "b4", "b5")
    assert not differ(TABLE, "main", "b2")
    assert not differ(TABLE, "main", "b9")
    # By length: 64 * 28 / (16 * 23) = 4.87, 64 * 38 / (16 * 28) = 5.43, 64 * 48 / (16 * 33) = 5.82.
    assert difference(TABLE) == (
        "*b4* and *b5* search with 4.9 to 5.8 times fewer evaluations of the loss than *main*; their nets were trained "
        "for 10 CPU minutes, those of *main* for 21"
    )
    assert difference(budgets(RUN, TIMES, ["main"])) == ""
    # Equal searches and, as far as is known, equal training: nothing to mark; one more minute in ten: marked.
    same = dataclasses.replace(RUN, voxel_search=RUN.search)
    assert not differ(budgets(same, None, ["main", "b4"]), "main", "b4")
    for minutes, apart in ((10.4, False), (11, True)):
        trained = times(train_pemd__0=600, train_emd_voxel__0=60 * minutes)
        assert differ(budgets(same, trained, ["main", "b4"]), "main", "b4") == apart
    assert "an unknown time" in difference_of_training(budgets(same, None, ["main", "b4"]), "a2's")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ((r"strains: \d+", "strains: 0"), r"params\.yaml: plan\.search.*strains: input should be greater than 0"),
        (("  laptop:", "  others:"), r"params\.yaml: scales\.laptop: expected the report's settings there"),
        (("scale: laptop", "scale: [laptop"), r"params\.yaml: is not valid YAML"),
        (("scale: laptop", "[" * 100_000), r"params\.yaml: is not valid YAML"),
    ],
)
def test_bad_settings_are_named(tmp_path: Path, change: tuple[str, str], sentence: str) -> None:
    text = (LAPTOP / "params.yaml").read_text()
    changed, count = re.subn(*change, text)
    assert count
    (tmp_path / "params.yaml").write_text(changed)
    with pytest.raises(InputError, match=sentence):
        run_settings.read(tmp_path / "params.yaml")


def test_settings_that_are_not_there_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"params\.yaml: not found"):
        run_settings.read(tmp_path / "params.yaml")
