"""Kernels are compiled into a temporary folder where Warp's own can't be made, and that is said."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
MEASURES = """
import os
import numpy as np
import warp
from clothkit.cloth.topology import SQUARE
from clothkit.simulation.quality import gaps
print(warp.config.kernel_cache_dir, os.environ["WARP_CACHE_PATH"], gaps(SQUARE.flat()[None], reach=0.01))
"""


def test_a_folder_that_can_not_be_made_is_replaced_with_a_notice(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "WARP_CACHE_PATH": str(tmp_path / "file/cache")}
    command = [sys.executable, "-c", MEASURES]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    kernels, for_workers, measured = ended.stdout.split()
    assert kernels.startswith(for_workers)
    assert str(tmp_path) not in for_workers
    assert measured == "[0.01]"
    (notice,) = ended.stderr.splitlines()
    assert notice.startswith(f"{tmp_path / 'file/cache'}")
    assert "can't be written (Not a directory); Warp's compiled kernels are kept in" in notice
    # They are gone with the process.
    assert not Path(for_workers).exists()
