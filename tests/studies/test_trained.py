"""Nets that studies train: another seed is another net, and a net that is there is not trained again."""

from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import jax
import numpy as np
import pandas as pd
import pytest

from clothkit.models import store, vtm
from clothkit.models.settings import VtMConfig
from tests import tiny, toy_dataset


@pytest.fixture
def study(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    monkeypatch.syspath_prepend(tiny.ROOT / "studies")
    monkeypatch.chdir(tmp_path)
    return import_module("trained")


def test_another_seed_is_another_net(study: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    net, calls = VtMConfig(hidden=4), []

    def train(settings: Any, training: Any, validation: Any, *, work: Path, key: jax.Array) -> Any:
        calls.append(work)
        assert work.is_dir()
        return SimpleNamespace(params=vtm.initial(net, key=key), history=pd.DataFrame({"iteration": [1]}), score=0.5)

    monkeypatch.setattr(study, "train_vtm", train)
    settings = SimpleNamespace(net=net, recalibrate=False)
    params: Any = SimpleNamespace(
        scale="toy", stages=SimpleNamespace(train_vtm=settings), section=lambda _: {"net": {"hidden": 4}}
    )
    folder = Path("data/nets/real_cloths")
    data = toy_dataset.dataset()
    sets = data.of_split("train"), data.of_split("validation")
    nets = [study.train_estimator(folder / str(k), k, params, *sets, "abc") for k in (1, 2, 1)]
    assert [work.as_posix() for work in calls] == [f".work/studies/real_cloths/{k}_abc" for k in (1, 2)]
    first, other, again = (np.concatenate([np.ravel(w) for w in jax.tree.leaves(net.params)]) for net in nets)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01
    told = store.description(folder / "2")
    assert (told["stage"], told["seed"], told["validation_score"]) == ("studies/real_cloths", 2, 0.5)
