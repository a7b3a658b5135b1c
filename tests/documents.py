"""Pages as tests read them: their blocks of code, and what can be said of a command without running it."""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mkdocs.__main__
from click import Context
from dvc.cli.parser import get_main_parser
from dvc.utils.hydra import apply_overrides
from ruamel.yaml import YAML

from clothkit.app.cli import cli
from clothkit.params import load_params
from tests.tiny import ROOT

PIPELINE = YAML(typ="safe").load(ROOT / "dvc.yaml")["stages"]

_FENCE = re.compile(r'^```(?P<language>\w+)(?: title="(?P<title>[^"]*)")?$')
_NO_RUN = re.compile(r"^<!-- no-run: (.+) -->$")
_NEEDS = re.compile(r"^<!-- needs: (\w+) -->$")


class Block(NamedTuple):
    """A block of code."""

    page: Path
    line: int
    """Of the first line of code, counted from 1."""
    language: str
    title: str
    code: str
    why_not: str | None
    """Why it is not run, if it isn't."""
    needs: str | None = None
    """The optional library without which it can't be run."""


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page. Raises ValueError for a fence that tests could not read."""
    lines, found, start = page.read_text().splitlines(), list[Block](), None
    for number, line in enumerate(lines):
        if not line.startswith("```"):
            continue
        if start is not None and line == "```":
            fence = _FENCE.match(lines[start])
            if fence is None:
                raise ValueError(f"{page.name}, line {start + 1}: a block of what? {lines[start]!r}")
            marks = [mark.match(lines[start - 1]) if start else None for mark in (_NO_RUN, _NEEDS)]
            code = "\n".join(lines[start + 1 : number])
            reason, needs = (mark[1] if mark else None for mark in marks)
            found.append(Block(page, start + 2, fence["language"], fence["title"] or "", code, reason, needs))
            start = None
        elif start is None:
            start = number
    return found


def indented(page: Path) -> list[str]:
    """Lines of the blocks that stand four spaces in, as README.md has them."""
    return [line[4:] for line in page.read_text().splitlines() if line.startswith("    ")]


def commands(code: str) -> list[list[str]]:
    """The words of each line of a block for a shell."""
    lines = code.replace("\\\n", " ").splitlines()
    return [words for words in (shlex.split(line, comments=True) for line in lines) if words]


def variants(definition: Mapping[str, Any]) -> list[str]:
    """What stands behind the `@` of each variant of a stage: the items of `foreach`, or of the param that it names."""
    items = definition.get("foreach", ())
    if isinstance(items, str):
        reference = re.fullmatch(r"\$\{([\w.]+)\}", items)
        if reference is None:
            raise ValueError(f"foreach: expected the name of a param, found {items!r}")
        items = YAML(typ="safe").load(ROOT / "params.yaml")
        for key in reference[1].split("."):
            items = items[key]
    return [str(item) for item in items]


def stage_names() -> list[str]:
    """Every stage as `dvc repro` takes it."""
    names = []
    for name, definition in PIPELINE.items():
        names += [f"{name}@{variant}" for variant in variants(definition)] if "foreach" in definition else [name]
    return names


def check(words: list[str], scratch: Path) -> None:
    """That a command names what there is: programs, options, stages, settings and files.

    `scratch` is a folder for what settings are tried on.
    """
    while re.match(r"[A-Z]+=", words[0]):
        name, value = words[0].split("=", 1)
        assert (ROOT / value).exists(), f"{name}: no {value}"
        words = words[1:]
    if words[0] == "git":
        assert words[1] == "checkout"
        assert (ROOT / words[2]).exists()
        return
    assert words[0] == "./run", f"{words[0]} is not run by ./run"
    program, *arguments = words[1:]
    {"dvc": _check_dvc, "clothkit": _check_clothkit, "python": _check_script}.get(program, _check_other)(
        program, arguments, scratch
    )


def _check_dvc(_: str, arguments: list[str], scratch: Path) -> None:
    given = get_main_parser().parse_args(arguments)
    if arguments[0] in ("repro", "commit"):
        unknown = set(given.targets) - {*PIPELINE, *stage_names()}
        assert not unknown, f"no stage {unknown}"
    if overrides := getattr(given, "set_param", None):
        overrides = [override.removeprefix("params.yaml:") for override in overrides]
        path = scratch / "overridden.yaml"
        path.write_text((ROOT / "params.yaml").read_text())
        apply_overrides(path, overrides)
        load_params(path)


def _check_clothkit(_: str, arguments: list[str], scratch: Path) -> None:
    name, *rest = arguments
    command = cli.get_command(Context(cli), name)
    assert command is not None, f"no command {name}"
    if "--help" not in rest:
        command.make_context(name, rest)


def _check_script(_: str, arguments: list[str], scratch: Path) -> None:
    script = ROOT / arguments[0]
    assert script.is_file(), f"no {script}"
    for option in (word for word in arguments[1:] if word.startswith("--")):
        assert option in script.read_text(), f"{script} has no {option}"


def _check_other(program: str, arguments: list[str], scratch: Path) -> None:
    if program == "mkdocs":
        mkdocs.__main__.cli.commands[arguments[0]].make_context(arguments[0], arguments[1:])
        return
    if program.endswith(".sh"):
        _check_script("", [program, *arguments], scratch)
        return
    assert program == "pytest", f"{program}: unknown"
    for path in (word for word in arguments if not word.startswith("-")):
        assert (ROOT / path).exists(), f"no {path}"


def check_settings(text: str, title: str, scratch: Path) -> None:
    """That a block of YAML is one of settings, or a stage of the kind that there is."""
    told = YAML(typ="safe").load(text)
    if title == "dvc.yaml":
        for name, definition in told["stages"].items():
            like = next(iter(PIPELINE[name]["foreach"].values()))
            assert all(item.keys() == like.keys() for item in definition["foreach"].values())
        return
    params = YAML(typ="safe").load(ROOT / "params.yaml")
    _merge(params, told)
    path = scratch / "told.yaml"
    YAML(typ="safe").dump(params, path)
    load_params(path)


def _merge(into: dict[str, Any], told: Mapping[str, Any]) -> None:
    for key, value in told.items():
        if isinstance(value, Mapping) and isinstance(into.get(key), dict):
            _merge(into[key], value)
        else:
            into[key] = value
