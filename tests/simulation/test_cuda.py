"""The kernels as CUDA code, compiled by NVRTC, which comes with Warp and needs no device. No test here runs them."""

import sys
from pathlib import Path
from types import ModuleType

import pytest
import warp as wp

from clothkit.simulation.kernels import advance, inspection

ARCHITECTURE = 80  # A100; CUDA's PTX runs on later ones


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler on macOS")
@pytest.mark.parametrize("module", [advance, inspection], ids=["advance", "inspection"])
def test_kernels_compile_for_cuda(module: ModuleType, tmp_path: Path) -> None:
    wp.compile_aot_module(module, arch=ARCHITECTURE, module_dir=tmp_path, use_ptx=True)
    code = next(tmp_path.glob("*.ptx")).read_text()
    entries = [line for line in code.splitlines() if ".entry" in line and "_forward(" in line]
    assert len(entries) == len(wp.get_module(module.__name__).kernels)
    if module is advance:
        assert "bar.sync" in code or "barrier.sync" in code  # a block's lanes wait for each other
