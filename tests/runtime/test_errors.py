"""The operating system's errors become sentences that name the file and what to do."""

import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from clothkit.runtime.errors import InputError, system_error, untold_error


@pytest.mark.parametrize(
    ("number", "action", "sentence"),
    [
        (errno.ENOENT, "read", "a/b: not found, expected a net"),
        (errno.ENOENT, "written", "a/b: can't be written: its folder is not there; make it first"),
        (errno.EACCES, "read", "a/b: can't be read, expected a net: no permission; change the file's or its folder's"),
        (errno.ENOSPC, "written", "a/b: can't be written, expected a net: no space is left; free some and run again"),
        (errno.EPIPE, "written", "a/b: can't be written, expected a net: Broken pipe"),
    ],
)
def test_names_the_file_the_reason_and_the_remedy(number: int, action: str, sentence: str) -> None:
    error = system_error(OSError(number, os.strerror(number)), "a/b", action=action, expected="a net")  # type: ignore[arg-type]
    assert isinstance(error, InputError)
    assert str(error).startswith(sentence)


def test_takes_what_the_system_raises(tmp_path: Path) -> None:
    with pytest.raises(IsADirectoryError) as raised:
        tmp_path.read_bytes()
    assert str(system_error(raised.value, tmp_path)) == f"{tmp_path}: can't be read: it is a folder, expected a file"


def test_a_library_s_error_without_a_number_keeps_its_words() -> None:
    assert str(system_error(OSError("Parquet magic bytes\nnot found"), "x.parquet")).endswith(
        "x.parquet: can't be read: Parquet magic bytes not found"
    )


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (FileNotFoundError(errno.ENOENT, "", "a/b"), "a/b: not found"),
        (PermissionError(errno.EACCES, "", b"a/b"), "a/b: can't be opened: no permission; change the file's or its"),
        (OSError(errno.ENOTEMPTY, "", "a", None, "b"), "b: can't be opened: the folder in its place is not empty"),
        (OSError(errno.EBUSY, "", "a"), "a: can't be opened: it is in use, or another file system is mounted there"),
        (
            OSError(errno.EDQUOT, ""),
            "a file can't be written: the disk quota is used up; free some space and run again",
        ),
        (OSError(errno.EIO, "", 7), "a file can't be written: the disk reports an error"),
    ],
)
def test_an_error_that_nobody_told_is_told_by_the_file_that_it_names(error: OSError, sentence: str) -> None:
    assert str(untold_error(error)).startswith(sentence)


@pytest.mark.parametrize(
    "error",
    [
        BrokenPipeError(errno.EPIPE, "", "a pipe"),
        OSError("a library's"),
        OSError(errno.EINVAL, ""),
        ZeroDivisionError(),
        RuntimeError("x"),
        AssertionError(),
    ],
)
def test_faults_of_the_program_are_not_told(error: Exception) -> None:
    assert untold_error(error) is None


@pytest.mark.parametrize(
    ("refusal", "reason"),
    [
        (AssertionError(), "what JAX needs for it is not installed"),
        (RuntimeError("Unable to initialize\nbackend"), "Unable to initialize backend"),
    ],
)
def test_a_device_that_jax_lacks_is_told(monkeypatch: pytest.MonkeyPatch, refusal: Exception, reason: str) -> None:
    def refuse() -> None:
        raise refusal

    fake = SimpleNamespace(config=SimpleNamespace(jax_platforms="cuda"), devices=refuse)
    monkeypatch.setitem(sys.modules, "jax", fake)  # type: ignore[arg-type]
    told = untold_error(refusal)
    assert str(told) == f"JAX_PLATFORMS: JAX can't use cuda here; unset it, or set it to cpu ({reason})"
    # A fault of the program on a device that is there is none of these.
    monkeypatch.setattr(fake, "devices", list)
    assert untold_error(refusal) is None
