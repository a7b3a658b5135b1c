"""Nets on disk: the same bytes for the same net, one sentence for a damaged file."""

import json

import jax
import numpy as np
import pandas as pd
import pytest
from flax import serialization

from clothkit.models import store
from clothkit.models.net import Net
from clothkit.models.pemd import initial
from clothkit.models.settings import PEMDConfig, VtMConfig
from clothkit.runtime.errors import InputError

TINY = PEMDConfig(latent=3, encoder=(7, 6), manipulation=5, decoder=(4, 8))
HISTORY = pd.DataFrame({"iteration": [1, 2], "score": [0.3, 0.2]})


@pytest.fixture
def folder(tmp_path):
    store.save(tmp_path / "net", Net(TINY, initial(TINY, key=jax.random.key(0))), HISTORY, {"validation_score": 0.2})
    return tmp_path / "net"


def test_a_net_comes_back_as_it_was_and_is_written_alike(folder, tmp_path):
    net = store.load(folder)
    assert net.config == TINY
    jax.tree.map(np.testing.assert_array_equal, net.params, initial(TINY, key=jax.random.key(0)))
    store.save(tmp_path / "again", net, HISTORY, {"validation_score": 0.2})
    for file in folder.iterdir():
        assert file.read_bytes() == (tmp_path / "again" / file.name).read_bytes()


def test_a_net_is_a_pytree_that_jit_takes(folder):
    net = store.load(folder)
    assert jax.jit(lambda n: n.params["M"]["layer_1"]["bias"] + n.config.latent)(net).shape == (5,)


def test_damaged_files_are_named(folder):
    weights = folder / store.WEIGHTS
    whole = weights.read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 1):
        weights.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"net\.msgpack"):
            store.load(folder)
    weights.unlink()
    with pytest.raises(InputError, match=r"net\.msgpack: not found, expected a net's weights"):
        store.load(folder)


def test_weights_of_other_widths_or_not_finite_are_refused(folder, tmp_path):
    described = json.loads((folder / store.ATTRIBUTES).read_text())
    described["net"]["manipulation"] = 9
    (folder / store.ATTRIBUTES).write_text(json.dumps(described))
    with pytest.raises(InputError, match="expected shape"):
        store.load(folder)
    config = VtMConfig(hidden=2)
    params = jax.tree.map(lambda w: np.full(w.shape, np.nan, np.float32), store.shapes(config))
    store.save(tmp_path / "nan", Net(config, params), HISTORY, {})
    with pytest.raises(InputError, match="NaN"):
        store.load(tmp_path / "nan")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda w: w.astype(np.int32), "expected float32, found int32"),
        (lambda w: w.astype(np.float64), "expected float32, found float64"),
        (lambda w: np.full_like(w, 1e30), "expected weights up to 1e+06, found 1e+30"),
        (lambda w: np.full_like(w, -1e30), "expected weights up to 1e+06, found 1e+30"),
        (lambda w: np.full_like(w, np.inf), "expected finite weights"),
        (lambda w: "weights", "expected shape"),
    ],
)
def test_weights_that_are_no_nets_are_refused_by_name(folder, change, says):
    params = serialization.msgpack_restore((folder / store.WEIGHTS).read_bytes())
    params["M"]["layer_1"]["bias"] = change(params["M"]["layer_1"]["bias"])
    (folder / store.WEIGHTS).write_bytes(serialization.msgpack_serialize(params))
    with pytest.raises(InputError, match=r"net\.msgpack, weight M/layer_1/bias") as told:
        store.load(folder)
    assert says in str(told.value)


def test_a_net_of_another_kind_is_refused(folder):
    assert store.load(folder, "pemd").config == TINY
    for kind in ("vtm", "emd_voxel"):
        with pytest.raises(InputError, match=rf"net\.json: kind: expected '{kind}', found 'pemd'"):
            store.load(folder, kind)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"validation_score": 0.1', "truncated or damaged"),
        ("[0.1]", "found no JSON object"),
        ("[" * 5000, "truncated or damaged"),
        ('{"validation_score": "0.1"}', "validation_score: expected a finite number"),
        ('{"validation_score": NaN}', "validation_score: expected a finite number"),
        ("{}", "validation_score: expected a finite number, found null"),
    ],
)
def test_a_score_that_is_none_is_told(folder, text, says):
    assert store.validation_score(folder) == 0.2
    (folder / store.ATTRIBUTES).write_text(text)
    with pytest.raises(InputError, match=r"net\.json") as told:
        store.validation_score(folder)
    assert says in str(told.value)


def test_what_the_system_says_is_told(folder):
    (folder / store.ATTRIBUTES).unlink()
    with pytest.raises(InputError, match=r"net\.json: not found, expected a net's description"):
        store.load(folder)
    (folder / store.ATTRIBUTES).mkdir()
    with pytest.raises(InputError, match=r"net\.json: can't be read.*: it is a folder"):
        store.load(folder)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        '{"kind": "pemd", "net": {"latent": -1}}',
        '{"kind": "x", "net": {}}',
        '{"kind": ["pemd"], "net": {}}',
        '{"kind": "vtm", "net": {"hidden": 1e400}}',
        f'{{"kind": "vtm", "net": {{"hidden": {10**30}}}}}',
        "\xff",
    ],
)
def test_a_description_that_is_none_is_refused(folder, text):
    (folder / store.ATTRIBUTES).write_text(text)
    with pytest.raises(InputError, match=r"net/net\."):
        store.load(folder)
