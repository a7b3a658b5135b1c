"""Weights in 8 bits are near the full ones, files are the same each time, and damaged ones are told."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from clothkit.prebuilt import packing
from clothkit.runtime.errors import InputError

weights = arrays.arrays(
    np.float32, st.tuples(st.integers(1, 9), st.integers(1, 5)), elements=st.floats(-1e3, 1e3, width=32)
)


@given(weights)
def test_a_weight_is_at_most_half_a_step_off(weight: np.ndarray) -> None:
    numbers, scale = packing.quantised(weight)
    assert numbers.dtype == np.int8
    assert scale.shape == weight.shape[-1:]
    for channel in range(weight.shape[1]):
        step = np.abs(weight[:, channel]).max() / 127
        # A step of subnormal size is rounded itself.
        assert np.abs(numbers[:, channel] * scale[channel] - weight[:, channel]).max() <= 0.5001 * step + 1e-40
        assert np.abs(numbers[:, channel].astype(int)).max() <= 127


def net(seed: int = 0) -> dict:
    rng = np.random.default_rng(seed)
    kernel = rng.normal(size=(64, 96)).astype(np.float32)
    kernel[:, 3] = 0
    return {
        "E": {"layer_1": {"kernel": kernel, "bias": rng.normal(size=96).astype(np.float32)}},
        "D": {"mesh": {"kernel": rng.normal(size=(96, 64)).astype(np.float32)}},
    }


def test_what_is_kept_and_how() -> None:
    params = net()
    found = packing.packed(params, "pemd", ("pemd/D",))
    assert {name: array.dtype for name, array in found.items()} == {
        "D/mesh/kernel": np.float16,
        "E/layer_1/bias": np.float32,
        "E/layer_1/kernel": np.int8,
        "E/layer_1/kernel.scale": np.float32,
    }
    # The same names of another net are another net's.
    assert packing.packed(params, "vtm", ("pemd/D",))["D/mesh/kernel"].dtype == np.int8
    back = packing.unpacked(found)
    np.testing.assert_array_equal(back["E"]["layer_1"]["bias"], params["E"]["layer_1"]["bias"])
    np.testing.assert_allclose(back["D"]["mesh"]["kernel"], params["D"]["mesh"]["kernel"], rtol=1e-3, atol=1e-6)
    kernel = back["E"]["layer_1"]["kernel"]
    assert kernel.dtype == np.float32
    assert (kernel[:, 3] == 0).all()
    assert 0 < np.abs(kernel - params["E"]["layer_1"]["kernel"]).max() < 0.02


def test_packing_again_changes_nothing_more() -> None:
    """What was packed once is in 8 bits exactly."""
    once = packing.unpacked(packing.packed(net(), "pemd"))
    twice = packing.unpacked(packing.packed(once, "pemd"))
    np.testing.assert_allclose(once["D"]["mesh"]["kernel"], twice["D"]["mesh"]["kernel"], rtol=1e-6)


def test_equal_nets_give_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        packing.write(tmp_path / name, packing.packed(net(), "pemd"))
    packing.write(tmp_path / "c.npz", packing.packed(net(1), "pemd"))
    a, b, c = ((tmp_path / f"{name}.npz").read_bytes() for name in "abc")
    assert a == b
    assert a != c
    assert len(a) < 14_000


@pytest.mark.parametrize("damage", ["truncated", "empty", "other", "missing", "changed"])
def test_a_damaged_file_is_told_in_one_sentence(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "net.npz"
    packing.write(path, packing.packed(net(), "pemd"))
    content = path.read_bytes()
    if damage == "missing":
        path.unlink()
    else:
        middle = len(content) // 2
        changed = (
            content[:middle] + bytes(255 - value for value in content[middle : middle + 9]) + content[middle + 9 :]
        )
        path.write_bytes({"truncated": content[:-100], "empty": b"", "other": b"text", "changed": changed}[damage])
    with pytest.raises(InputError, match=r"net\.npz: (not found, )?expected a net's packed weights") as raised:
        packing.read(path)
    assert "\n" not in str(raised.value)
