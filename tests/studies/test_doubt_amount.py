"""The study of doubt against the amount of data and the number of nets."""

from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from clothkit.dataset.store import SPLITS, Dataset
from clothkit.dataset.tasks import TASKS
from clothkit.report.figures.doubt_study import amounts as draw
from tests import tiny, toy_dataset


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    monkeypatch.chdir(tmp_path)
    return import_module("doubt_amount")


def test_less_data_has_two_nets_and_all_of_it_each_number(study: ModuleType) -> None:
    found = study.settings_of(800, [400, 100, 100, 800, 3000], [5, 3])
    assert found == [(100, 2), (400, 2), (800, 2), (800, 3), (800, 5)]
    assert study.settings_of(80, [100], []) == [(80, 2)]


def test_nets_are_shared(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of the data: the chain's nets come first. Less: own nets, of the first sequences."""
    calls: list[tuple[str, int, int]] = []

    def train(nets: Path, member: int, params: Any, training: Any, validation: Dataset, current: str) -> None:
        calls.append((nets.name, member, len(training())))
        assert len(validation) == 1

    monkeypatch.setattr(study.trained, "train", train)
    monkeypatch.setattr(study, "augment", lambda part, settings: part)
    monkeypatch.setattr(study, "fingerprint", lambda *_: "")
    params: Any = SimpleNamespace(
        stages=SimpleNamespace(train_pemd=None, augment=None), ensemble=SimpleNamespace(members=(0, 1))
    )
    dataset = toy_dataset.dataset(6)
    train_split, validation = SPLITS.index("train"), SPLITS.index("validation")
    split = np.array([train_split] * 5 + [validation], np.int8)
    dataset = study.store.Dataset(**{**vars(dataset), "split": split})
    for setting in study.settings_of(5, [2], [3]):
        study.train(setting, params, dataset)
    assert calls == [("nets_2", 0, 2), ("nets_2", 1, 2), ("nets_5", 2, 5)]
    links = {place.name: place.resolve() for place in (study.OWN / "5_3/nets/pemd").iterdir()}
    assert links == {
        "0": Path("data/nets/pemd/0").resolve(),
        "1": Path("data/nets/pemd/1").resolve(),
        "2": (study.OWN / "nets_5/pemd/2").resolve(),
    }
    assert (study.OWN / "2_2/nets/pemd/1").resolve() == (study.OWN / "nets_2/pemd/1").resolve()
    assert (study.OWN / "2_2/nets/vtm").resolve() == Path("data/nets/vtm").resolve()


def test_what_is_computed_first_leaves_the_rows_of_later_ensembles(study: ModuleType, tmp_path: Path) -> None:
    """All rows are stored but some of the first ensemble's, which are computed and written first."""
    settings, path = study.settings_of(200, [100], [3]), tmp_path / "doubt_amount.csv"
    current = {setting: f"{place}e1234567890" for place, setting in enumerate(settings)}
    variant = study.Variant("main", *study.VARIANTS[1], False)
    stored = [
        {**setting._asdict(), **variant._asdict(), "sequence": sequence, "start": 0, "length": 1, "error": 0.1}
        | {study.COLUMN: current[setting]}
        for setting in settings
        for sequence in ((7, 8) if setting == settings[0] else (7, 8, 9))
    ]
    # Other nets were used for this one, so that it does not count.
    stored.append({**stored[-1], "sequence": 10, study.COLUMN: "0"})
    study.write(pd.DataFrame(stored), path)
    asked = [7, 8, 9, 10]
    table = study.kept(path, current)
    assert [study.missing_of(table, setting, variant, asked) for setting in settings] == [[9, 10], [10], [10]]
    assert study.missing_of(table, settings[0], variant._replace(fold=True), asked) == asked
    found = pd.DataFrame([{**stored[0], "sequence": 9}])
    study.write(study.append(table, found), path)
    again = study.kept(path, current)
    assert [study.missing_of(again, setting, variant, asked) for setting in settings] == [[10], [10], [10]]
    assert study.missing_of(study.kept(tmp_path / "none.csv", current), settings[0], variant, asked) == asked


def test_the_summary_compares_with_no_doubt_of_the_same_nets(study: ModuleType, tmp_path: Path) -> None:
    rng, rows = np.random.default_rng(0), []
    for amount, nets in ((100, 2), (400, 2), (400, 3)):
        for measure, alpha in study.VARIANTS:
            for fold in (True, False):
                for sequence in range(15):
                    for start, length in TASKS:
                        # Doubt is worth 0.02 with little data, and nothing with much.
                        gain = 0.02 * (alpha > 0) * (amount == 100)
                        error = 0.1 + 0.001 * sequence - gain + 0.001 * rng.normal()
                        rows.append(
                            {"amount": amount, "nets": nets, "measure": measure, "alpha": alpha, "fold": fold}
                            | {
                                "system": "main",
                                "split": "validation",
                                "sequence": sequence,
                                "start": start,
                                "length": length,
                            }
                            | {"error": error, "search_failure": 0, "rank": 0.8, "auroc": 0.9 + 0.01 * nets}
                        )
    found = study.summary(pd.DataFrame(rows))
    indexed = found.set_index([*study.SETTING, *study.VARIANT, "column"])
    little = indexed.loc[(100, 2, "main", "expected", 1.0, False, "2/all")]
    assert little["difference"] == pytest.approx(-0.02, abs=0.002)
    assert little["difference_p"] < 0.01
    much = indexed.loc[(400, 3, "main", "expected", 1.0, True, "2/all")]
    assert abs(much["difference"]) < 0.002
    assert much["auroc"] == pytest.approx(0.93)
    draw(found[found["column"].str.endswith("/all")], tmp_path / "doubt_amount.png")
    assert (tmp_path / "doubt_amount.png").stat().st_size > 10_000
