"""dvc.yaml lists, for each stage, exactly the modules that the stage runs: no rerun too few, and none too many."""

import ast
import re
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PIPELINE = YAML(typ="safe").load(ROOT / "dvc.yaml")["stages"]


def imported_modules(file: Path, seen: set[Path]) -> set[Path]:
    """The files of the clothkit modules that a file imports, and of those that they import."""
    for node in ast.walk(ast.parse(file.read_text())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            path = ROOT / "src" / Path(*name.split("."))
            module = path.with_suffix(".py")
            # params.py reads every stage's settings: its dependencies are in the stage's own params.
            if name.startswith("clothkit.") and module.is_file() and module.stem != "params" and module not in seen:
                seen.add(module)
                imported_modules(module, seen)
    return seen


def expected_deps(script: str) -> set[str]:
    """The stage script and its modules, as paths from the root."""
    modules = imported_modules(ROOT / script, set())
    return {script, *(str(module.relative_to(ROOT)) for module in modules)}


@pytest.mark.parametrize("name", list(PIPELINE))
def test_code_deps_are_the_modules_that_the_stage_imports(name: str) -> None:
    definition = PIPELINE[name].get("do", PIPELINE[name])
    script = re.search(r"stages/\w+\.py", definition["cmd"])[0]
    listed = {dep for dep in definition["deps"] if dep.endswith(".py")}
    assert listed == expected_deps(script)


@pytest.mark.parametrize("script", sorted(p.name for p in (ROOT / "stages").glob("*.py")))
def test_every_stage_script_is_short_and_in_the_pipeline(script: str) -> None:
    assert len((ROOT / "stages" / script).read_text().splitlines()) <= 60
    commands = [PIPELINE[name].get("do", PIPELINE[name])["cmd"] for name in PIPELINE]
    assert any(f"stages/{script}" in command for command in commands)
