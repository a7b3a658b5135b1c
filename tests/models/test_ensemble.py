"""Ensembles: which folders they are read from, which of them is the best, and which nets make none."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clothkit.models import store
from clothkit.models.ensemble import Ensemble, best_member, folder, folders, load, member_named, pairs
from clothkit.models.net import Net
from clothkit.models.pemd import PEMD, initial
from clothkit.models.settings import PEMDConfig
from clothkit.runtime.errors import InputError

TINY = PEMDConfig(latent=3, encoder=(4,), manipulation=3, decoder=(4,))
SCORES = {0: 0.3, 4: 0.1, 2: 0.1}
"""Members, out of order, two of them equally good."""

HISTORY = pd.DataFrame({"iteration": [1], "score": [0.1]})


def save(nets: Path, member: int, config: PEMDConfig = TINY, **attributes: float) -> None:
    net = Net(config, initial(config, key=jax.random.key(member)))
    store.save(folder(nets, "pemd", member), net, HISTORY, attributes)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    nets = tmp_path_factory.mktemp("nets")
    for member, score in SCORES.items():
        save(nets, member, validation_score=score)
    return nets


@pytest.fixture
def nets(saved: Path, tmp_path: Path) -> Path:
    """A copy that a test may damage."""
    return shutil.copytree(saved, tmp_path / "nets")


def test_members_are_read_in_the_order_asked_for(saved: Path) -> None:
    found = load(saved, "pemd", tuple(SCORES))
    assert found.members == (0, 4, 2)
    assert found.model == PEMD(TINY)
    for member, net, params in zip(SCORES, found.nets, found.params, strict=True):
        assert net.params is params
        jax.tree.map(np.testing.assert_array_equal, params, initial(TINY, key=jax.random.key(member)))
    # Of the two with the lowest score the first.
    assert found.best == 1
    assert found.best_net is found.nets[1]
    assert load(saved, "pemd", (2, 0, 4)).best == 0
    assert best_member(folders(saved, "pemd", (0, 2))) == 2


def test_a_single_net_is_an_ensemble(saved: Path) -> None:
    found = load(saved, "pemd", (4,))
    assert (found.members, found.best, len(found.nets)) == ((4,), 0, 1)


def test_a_missing_member_is_named(nets: Path) -> None:
    with pytest.raises(InputError, match=r"nets/pemd/1/net\.json: not found, expected a net's description"):
        load(nets, "pemd", (0, 1))
    with pytest.raises(InputError, match=r"nets/emd_voxel/0/net\.json: not found"):
        load(nets, "emd_voxel", (0,))


def test_nets_of_another_configuration_are_refused_by_name(nets: Path) -> None:
    save(nets, 4, replace(TINY, canonical=True), validation_score=0.2)
    with pytest.raises(InputError, match=r"pemd/4/net\.json: net: expected the configuration of .*pemd/0.*, found an"):
        load(nets, "pemd", (0, 4))
    with pytest.raises(InputError, match="nets of one configuration"):
        Ensemble((0, 4), tuple(store.load(folder(nets, "pemd", member)) for member in (0, 4)))


def test_a_member_without_a_score_is_told(nets: Path) -> None:
    path = folder(nets, "pemd", 2) / store.ATTRIBUTES
    about = json.loads(path.read_text())
    del about["validation_score"]
    path.write_text(json.dumps(about))
    with pytest.raises(InputError, match=r"pemd/2/net\.json: validation_score: expected a finite number"):
        load(nets, "pemd", (0, 2))


@pytest.mark.parametrize("members", [(), (0,), (0, 0), (0, 1, 2)])
def test_members_differ_and_each_has_a_net(saved: Path, members: tuple[int, ...]) -> None:
    net = store.load(folder(saved, "pemd", 0))
    with pytest.raises(InputError, match="ensemble: expected at least one member and a net for each"):
        Ensemble(members, () if not members else (net, net))


def test_a_stage_is_told_its_members() -> None:
    assert member_named("10", (0, 10)) == 10
    for name in ("1", "a", "00", "+10", ""):
        with pytest.raises(
            InputError, match=f"expected a member of the ensemble, 0 or 10, found {name}".replace("+", r"\+")
        ):
            member_named(name, (0, 10))


@given(st.lists(st.integers(), max_size=7, unique=True))
def test_every_pair_once(items: list[int]) -> None:
    found = pairs(items)
    assert len(found) == len(items) * (len(items) - 1) // 2
    assert {frozenset(pair) for pair in found} == {frozenset((a, b)) for a in items for b in items if a != b}
    assert all(items.index(a) < items.index(b) for a, b in found)
