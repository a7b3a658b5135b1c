"""What a killed training goes on from: as it was, or told of in one sentence."""

from pathlib import Path

import numpy as np
import pytest

from clothkit.runtime.errors import InputError
from clothkit.training import checkpoint


def test_arrays_and_notes_come_back(tmp_path: Path) -> None:
    arrays = ({"weight": np.arange(6.0).reshape(2, 3)}, [np.array(3, np.int32)])
    checkpoint.write(tmp_path / "last", arrays, {"iteration": 3})
    found, notes = checkpoint.read(tmp_path / "last", arrays)
    np.testing.assert_array_equal(found[0]["weight"], arrays[0]["weight"])
    np.testing.assert_array_equal(found[1][0], 3)
    assert notes == {"iteration": 3}


@pytest.mark.parametrize("left", [0, 1, 30, -1])
def test_a_damaged_one_is_told(tmp_path: Path, left: int) -> None:
    path, arrays = tmp_path / "last", [np.arange(6.0)]
    checkpoint.write(path, arrays, {"iteration": 3})
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(InputError, match=r"last: what an earlier run left is damaged .*; delete this file"):
        checkpoint.read(path, arrays)
