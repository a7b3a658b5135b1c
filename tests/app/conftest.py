"""A data folder of tiny nets that have learned nothing, and cloths in files."""

import json
from pathlib import Path

import jax
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result
from ruamel.yaml import YAML

from clothkit.app.cli import cli
from clothkit.app.output import write_mesh
from clothkit.cloth import voxels
from clothkit.cloth.grid import flat, triangles
from clothkit.networks import emd_voxel, pemd, store, vtm
from clothkit.networks.net import Net
from clothkit.networks.settings import EMDVoxelConfig, PEMDConfig, VtMConfig
from clothkit.observation.camera import back_project
from clothkit.planning import normalisation
from tests.observation.scenes import SCALE, SMALL, folded, image_of
from tests.planning import toy

ROOT = Path(__file__).parents[2]
AT = (0.05, -0.03)
"""Where the cloth lies on the table [m]."""


def run(*arguments: object) -> Result:
    """A call of the command line."""
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def succeed(*arguments: object) -> str:
    """What a call says on stdout, after checking that it went well."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Nets and reference values."""
    folder = tmp_path_factory.mktemp("app") / "data"
    history = pd.DataFrame({"iteration": [1], "score": [0.1]})
    small = PEMDConfig(latent=8, encoder=(16,), manipulation=8, decoder=(16,))
    coarse = EMDVoxelConfig(latent=8, manipulation=8, width=0.05)
    for k, name in enumerate("ab"):
        score = {"validation_score": 0.1 + 0.01 * k}
        net = Net(small, pemd.initial(small, key=jax.random.key(k)))
        store.save(folder / f"nets/pemd_{name}", net, history, score)
        net = Net(coarse, emd_voxel.initial(coarse, key=jax.random.key(k)))
        store.save(folder / f"nets/emd_voxel_{name}", net, history, score)
    seer = VtMConfig(hidden=16)
    store.save(folder / "nets/vtm", Net(seer, vtm.initial(seer, key=jax.random.key(2))), history, {})
    (folder / "normalisation").mkdir()
    for kind in ("mesh", "voxel"):
        normalisation.save(folder / f"normalisation/{kind}.json", toy.NORMALISATION, {})
    return folder


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloth as mesh, voxels and cloud, goals, and what tells the cloth from the table."""
    folder = tmp_path_factory.mktemp("files")
    bent = folded(angle=0.3)
    write_mesh(folder / "start.obj", flat().astype(float) * SCALE + [*AT, 0])
    write_mesh(folder / "bent.obj", bent.astype(float) * SCALE + [*AT, 0])
    write_mesh(folder / "goal.glb", folded(along=0.0).astype(float) * SCALE)
    np.save(folder / "voxels.npy", np.asarray(voxels.observe(bent)))
    cloud = back_project(image_of(bent, SMALL, at=AT))
    assert cloud.cloth is not None
    np.savez(folder / "cloud.npz", points=cloud.points, cloth=cloud.cloth)
    np.savez(folder / "cloth_alone.npz", points=cloud.points[cloud.cloth])
    np.save(folder / "points.npy", cloud.points)
    np.save(folder / "mask.npy", cloud.cloth)
    other = np.random.default_rng(0).permutation(1024)
    faces = np.argsort(other)[triangles()]
    rows = (flat().astype(float) * SCALE).reshape(-1, 3)[other]
    text = [f"v {x} {y} {z}" for x, y, z in rows.tolist()]
    text += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    (folder / "surface.obj").write_text("\n".join(text) + "\n")
    return folder


@pytest.fixture
def here(tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current directory with params of the smallest scale, and data."""
    params = YAML(typ="safe").load(ROOT / "params.yaml")
    params["scale"] = "smoke"
    params["scales"]["smoke"]["plan"]["voxel_search"] = {"strains": 8, "base_iterations": 2, "iterations_per_step": 0}
    (tmp_path / "params.yaml").write_text(json.dumps(params))
    (tmp_path / "data").symlink_to(data)
    monkeypatch.chdir(tmp_path)
    return tmp_path
