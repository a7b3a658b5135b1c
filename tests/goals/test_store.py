"""Goals are kept by what they depend on, and made once."""

import dataclasses
import threading
from pathlib import Path

import numpy as np
import pytest

from clothkit.cloth.topology import SQUARE, rectangle
from clothkit.goals import store
from clothkit.goals.making import Made
from clothkit.goals.store import key, made, made_all, named, user_folder
from clothkit.manipulation.named_folds import GOALS, Goal
from clothkit.runtime.errors import InputError
from clothkit.simulation.material import Material
from clothkit.simulation.settings import SimulationConfig

SIMULATION = SimulationConfig()


# Closed clusters leave sockets and tasks of their event loops to the garbage collector.
pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The goals that were made, which takes no time here."""
    names: list[str] = []

    def make(goal: Goal, topology: object, simulation: object) -> Made:
        names.append(goal.name)
        if goal.name == "eighth":
            raise InputError("goal eighth, fold 3: no try left this cloth clean")
        return Made(np.full((2, 4, 4, 3), len(names), np.float32), np.zeros((1, 6), np.float32))

    monkeypatch.setattr(store, "make", make)
    return names


def test_a_goal_is_made_once(tmp_path: Path, calls: list[str]) -> None:
    first = made("half", SQUARE, SIMULATION, folder=tmp_path / "goals")
    again = made("half", SQUARE, SIMULATION, folder=tmp_path / "goals")
    assert calls == ["half"]
    np.testing.assert_array_equal(first.states, again.states)
    assert [path.suffix for path in (tmp_path / "goals").iterdir()] == [".npz"]


def test_other_cloths_and_worlds_are_other_goals() -> None:
    thick = dataclasses.replace(SIMULATION, material=Material(thickness=4e-3))
    slower = dataclasses.replace(SIMULATION, time_step=5e-4)
    half = GOALS["half"]
    keys = {
        key(half, SQUARE, SIMULATION),
        key(half, SQUARE, thick),
        key(half, SQUARE, slower),
        key(half, rectangle(1.6), SIMULATION),
        key(half, rectangle(1 / 1.6), SIMULATION),
        key(GOALS["thirds"], SQUARE, SIMULATION),
    }
    assert len(keys) == 6
    # Its hands grasp all layers in any case.
    assert key(half, SQUARE, dataclasses.replace(SIMULATION, grasp="all")) in keys


def test_several_are_made_and_what_can_not_be_is_told(tmp_path: Path, calls: list[str]) -> None:
    wanted = [(name, SQUARE, SIMULATION) for name in ("half", "eighth", "thirds")]
    found = made_all(wanted, folder=tmp_path, workers=1)
    assert calls == ["half", "eighth", "thirds"]
    assert [isinstance(one, InputError) for one in found] == [False, True, False]
    again = made_all(wanted, folder=tmp_path, workers=1)
    assert calls == ["half", "eighth", "thirds", "eighth"]
    np.testing.assert_array_equal(again[2].states, found[2].states)


def test_a_cluster_makes_goals_that_are_stored_here(
    tmp_path: Path, calls: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What can't be made is told as it is on this machine."""
    distributed = pytest.importorskip("distributed")
    threads, make, unfinished = [], store.make, store.unfinished
    monkeypatch.setattr(store, "make", lambda *given: (threads.append(threading.current_thread()), make(*given))[1])
    writers = []
    monkeypatch.setattr(
        store, "unfinished", lambda path: (writers.append(threading.current_thread()), unfinished(path))[1]
    )
    wanted = [(name, SQUARE, SIMULATION) for name in ("half", "eighth", "thirds")]
    with distributed.LocalCluster(
        n_workers=1, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as made_cluster:
        found = made_all(wanted, folder=tmp_path, executor="dask", scheduler=made_cluster.scheduler_address)
    assert sorted(calls) == ["eighth", "half", "thirds"]
    assert [isinstance(one, InputError) for one in found] == [False, True, False]
    assert threading.current_thread() not in threads
    assert set(writers) == {threading.current_thread()}
    assert len(list(tmp_path.glob("*.npz"))) == 2


def test_a_damaged_file_is_told(tmp_path: Path, calls: list[str]) -> None:
    made("half", SQUARE, SIMULATION, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(InputError, match=rf"{file.name}: what an earlier run left is damaged"):
        made("half", SQUARE, SIMULATION, folder=tmp_path)


def test_an_unknown_name_is_told() -> None:
    with pytest.raises(InputError, match=r"goal: expected one of half, triangle, .*, found 'halve'"):
        named("halve")


def test_a_folder_that_can_not_be_written_is_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert user_folder() == tmp_path / "clothkit/goals"
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert user_folder().is_dir()
    assert "named goals are kept in" in capsys.readouterr().err
