"""A data folder of tiny nets that have learned nothing, and cloths in files."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from clothkit.app.cli import cli
from tests.tiny import AT, ROOT, write_files, write_nets, write_params

__all__ = ["AT", "ROOT", "run", "succeed"]


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
    write_nets(folder)
    return folder


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloth as mesh, voxels and cloud, goals, and what tells the cloth from the table."""
    folder = tmp_path_factory.mktemp("files")
    write_files(folder)
    return folder


@pytest.fixture
def here(tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current directory with params of the smallest scale, and data."""
    write_params(tmp_path / "params.yaml")
    (tmp_path / "data").symlink_to(data)
    monkeypatch.chdir(tmp_path)
    return tmp_path
