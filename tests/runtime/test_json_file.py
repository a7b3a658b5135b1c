"""JSON files are read whole or told of in one sentence."""

import json
from pathlib import Path

import pytest

from clothkit.runtime.errors import InputError
from clothkit.runtime.json_file import read_json


def test_an_object_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text('\n{"a": [{"b": 1}, {"b": 2}], "c": {"a": null}}\n')
    assert read_json(path, expected="a note") == {"a": [{"b": 1}, {"b": 2}], "c": {"a": None}}


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b'{"a": 1', "found a truncated or damaged file (Expecting"),
        (b"", "found a truncated or damaged file"),
        (b"\xff\xfe\x00", "found a truncated or damaged file"),
        (b"[" * 100_000, "found a truncated or damaged file (nested too deeply)"),
        (b'{"a": ' * 100_000, "found a truncated or damaged file (nested too deeply)"),
        (b"9" * 5000, "found a truncated or damaged file"),
        (b"[1]", "found no JSON object but [1]"),
        (b"null", "found no JSON object but null"),
        (b'{"a": 1, "b": 2, "a": 3}', 'found key "a" twice'),
        (b'{"x": [{"a": 1, "a": 1}]}', 'found key "a" twice'),
    ],
)
def test_what_is_none_is_told(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.json"
    path.write_bytes(content)
    with pytest.raises(InputError) as told:
        read_json(path, expected="a note")
    assert str(told.value).startswith(f"{path}: expected a note, {says}")
    assert len(str(told.value).splitlines()) == 1


def test_what_the_system_says_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not found, expected a note"):
        read_json(tmp_path / "none.json", expected="a note")
    with pytest.raises(InputError, match="expected a note: it is a folder"):
        read_json(tmp_path, expected="a note")


def test_words_that_are_no_unicode_are_kept(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"\ud800": 1}))
    assert read_json(tmp_path / "a.json", expected="a note") == {"\ud800": 1}
