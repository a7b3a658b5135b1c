"""What can be wrong with a file: mutations of every kind of file that clothkit reads, each drawn with a generator.

A mutation changes a file, or a folder that is a store, and tells what it did. It also tells what has to come of it:
REFUSED, where no reader may take what is left; SAME, where the file still says what it said; ANY, where both a sentence
and another valid result are right. Here are those of the operating system, of bytes, of arguments, and of JSON and
YAML; tables and stores are in `of_tables`, arrays, clouds and meshes in `of_shapes`.
"""

import json
import re
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

REFUSED, SAME, ANY = "refused", "same", "any"
Random = np.random.Generator


class Mutation(NamedTuple):
    """A way of changing a file."""

    name: str
    apply: Callable[[Path, Random], str | None]
    """Changes the file and tells what it did; None where the file has nothing of the kind."""
    outcome: str = ANY


KINDS: dict[str, list[Mutation]] = {}


def mutation(*kinds: str, outcome: str = ANY) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    def register(apply: Callable[..., Any]) -> Callable[..., Any]:
        for kind in kinds:
            KINDS.setdefault(kind, []).append(Mutation(apply.__name__.strip("_"), apply, outcome))
        return apply

    return register


def mutations(kind: str) -> list[Mutation]:
    """Those of a kind of file: json, yaml, parquet, zarr, npy, npz, text, bytes (any other), words (an argument)."""
    if kind == "words":
        return KINDS[kind]
    own = KINDS.get(kind, [])
    system = KINDS["system"]
    return [*own, *own, *system] if kind == "zarr" else [*own, *own, *KINDS["bytes"], *system]


# The operating system's.


def _gone(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


@mutation("system", outcome=REFUSED)
def _folder_instead(path: Path, random: Random) -> str:
    _gone(path)
    path.mkdir()
    return "an empty folder in its place"


@mutation("system", outcome=REFUSED)
def missing(path: Path, random: Random) -> str:
    """Nothing in its place."""
    _gone(path)
    return "not there"


@mutation("system", outcome=REFUSED)
def _broken_link(path: Path, random: Random) -> str:
    _gone(path)
    path.symlink_to("nowhere")
    return "a symbolic link that leads nowhere"


@mutation("system", outcome=REFUSED)
def _circular_link(path: Path, random: Random) -> str:
    _gone(path)
    path.symlink_to(path.name)
    return "a symbolic link to itself"


@mutation("system", outcome=SAME)
def _linked(path: Path, random: Random) -> str:
    moved = path.with_name(f"moved_{path.stem}")
    path.rename(moved)
    path.symlink_to(moved.name)
    return "a symbolic link to the moved original"


# Bytes.


@mutation("bytes", outcome=REFUSED)
def _empty(path: Path, random: Random) -> str:
    path.write_bytes(b"")
    return "empty"


@mutation("bytes", outcome=REFUSED)
def _noise(path: Path, random: Random) -> str:
    path.write_bytes(random.bytes(int(random.integers(1, 4096))))
    return "random bytes instead"


@mutation("bytes")
def _flipped(path: Path, random: Random) -> str:
    content = bytearray(path.read_bytes())
    # Half of them where headers are.
    end = len(content) if random.random() < 0.5 else min(len(content), 512)
    places = random.integers(0, end, int(random.integers(1, 6)))
    for place in places:
        content[place] ^= 1 << int(random.integers(8))
    path.write_bytes(content)
    return f"bits flipped in bytes {places.tolist()} of {len(content)}"


@mutation("bytes")
def truncated(path: Path, random: Random) -> str:
    """Only the first so many bytes."""
    content = path.read_bytes()
    left = int(random.integers(1, len(content)))
    path.write_bytes(content[:left])
    return f"cut after {left} of {len(content)} bytes"


@mutation("bytes")
def _extended(path: Path, random: Random) -> str:
    more = random.bytes(int(random.integers(1, 200)))
    path.write_bytes(path.read_bytes() + more)
    return f"{len(more)} random bytes behind it"


@mutation("bytes")
def _zeroed(path: Path, random: Random) -> str:
    content = bytearray(path.read_bytes())
    first, count = int(random.integers(len(content))), int(random.integers(1, 512))
    content[first : first + count] = bytes(len(content[first : first + count]))
    path.write_bytes(content)
    return f"zeros from byte {first} on, up to {count}"


# JSON and YAML.

_LITERALS = (
    *("null", "true", "0", "-1", "1", "0.5", "-0.0", "3", "1000", "-1e9", "1e300", "1e-300", "1e999"),
    *("NaN", "Infinity", "-Infinity", "123456789012345678901234567890", '""', '"word"', '"1"', "[]", "{}"),
    *("[1]", '{"a": 1}', "[[[[]]]]", '"\\u0000"', '"\\ud800"', "[null]"),
)
_OF_YAML = (
    ".nan",
    ".inf",
    "-.inf",
    "2024-01-01",
    "!!set {a, b}",
    "!!binary aGVsbG8=",
    "*nowhere",
    "&a [*a]",
    "~",
    "0x10",
)
_MARK = "@@mutated@@"


def _places(value: Any, random: Random) -> tuple[Any, Any] | None:
    """A container in nested JSON, and one of its keys or places; None where there is none."""
    if not isinstance(value, dict | list) or not value:
        return None
    keys = list(value) if isinstance(value, dict) else list(range(len(value)))
    key = keys[int(random.integers(len(keys)))]
    deeper = _places(value[key], random) if random.random() < 0.85 else None
    return deeper or (value, key)


def _edited(path: Path, random: Random, edit: Callable[[Any, Any], str]) -> str | None:
    try:
        content = json.loads(path.read_text())
    except ValueError:
        return None
    place = _places(content, random)
    if place is None:
        return None
    said = edit(*place)
    path.write_text(json.dumps(content).replace(f'"{_MARK}"', said))
    return f"{place[1]}: {said}"


def _replace(literals: Sequence[str]) -> Callable[[Path, Random], str | None]:
    def apply(path: Path, random: Random) -> str | None:
        def edit(where: Any, key: Any) -> str:
            where[key] = _MARK
            return literals[int(random.integers(len(literals)))]

        return _edited(path, random, edit)

    return apply


KINDS["json"] = [Mutation("value", _replace(_LITERALS))] * 4
KINDS["yaml"] = [Mutation("value", _replace((*_LITERALS, *_OF_YAML)))] * 4


@mutation("json", "yaml")
def _deleted(path: Path, random: Random) -> str | None:
    def edit(where: Any, key: Any) -> str:
        del where[key]
        return "deleted"

    return _edited(path, random, edit)


@mutation("json", "yaml")
def _unknown_key(path: Path, random: Random) -> str | None:
    def edit(where: Any, key: Any) -> str:
        if isinstance(where, dict):
            where["unknown"] = 1
            return "an unknown key beside it"
        where.append(where[key])
        return "twice"

    return _edited(path, random, edit)


@mutation("json", "yaml")
def _key_twice(path: Path, random: Random) -> str | None:
    text = path.read_text()
    keys = list(re.finditer(r'"(\w+)": ', text))
    if not keys:
        return None
    found = keys[int(random.integers(len(keys)))]
    value = _LITERALS[int(random.integers(len(_LITERALS)))]
    path.write_text(f"{text[: found.start()]}{found[0]}{value}, {text[found.start() :]}")
    return f"{found[1]} twice, {value} first"


@mutation("json", "yaml", outcome=REFUSED)
def _deep(path: Path, random: Random) -> str:
    path.write_text("[" * 100_000)
    return "nested 100,000 deep"


@mutation("json", "yaml", outcome=SAME)
def _spaced(path: Path, random: Random) -> str:
    path.write_text(f"\n{path.read_text()}\n\n")
    return "blank lines around it"


# Arguments.

_WORDS = (
    *("", "nan", "inf", "-1", "0", "1e308", "-1e-300", "99999999999999999999", "x" * 300, "nowhere/none.obj", "."),
    *("circle", "params.yaml", "params.yaml/none", "data", "\udcff.obj", "a\nb", "-", "--", "start.obj:0/1"),
)


@mutation("words")
def _word(path: Path, random: Random) -> str:
    """Only tells it: arguments are no file."""
    return _WORDS[int(random.integers(len(_WORDS)))]
