"""dvc.yaml lists the code of each stage: folders where it uses a quarter of a package or more, else modules."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PACKAGE = Path("src/clothkit")
PIPELINE = YAML(typ="safe").load(ROOT / "dvc.yaml")["stages"]
PLANS = ("plan", "plan_fixed")


def definition(name: str) -> dict:
    return PIPELINE[name].get("do", PIPELINE[name])


def imported_modules(file: Path, seen: set[Path]) -> set[Path]:
    """The files of the clothkit modules that a file imports, and of those that they import, as paths from the root."""
    for node in ast.walk(ast.parse((ROOT / file).read_text())):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            if not name.startswith("clothkit."):
                continue
            path = PACKAGE.parent / Path(*name.split("."))
            for module in (path.with_suffix(".py"), path / "__init__.py"):
                # params.py reads every stage's settings: its dependencies are in the stage's own params.
                if (ROOT / module).is_file() and module.stem != "params" and module not in seen:
                    seen.add(module)
                    imported_modules(module, seen)
    return seen


def modules_of(name: str) -> set[Path]:
    """The modules that a stage imports. Packages whose __init__.py does nothing are left out."""
    script = Path(re.search(r"stages/\w+\.py", definition(name)["cmd"])[0])
    found = imported_modules(script, set())
    return {module for module in found if module.name != "__init__.py" or "import" in (ROOT / module).read_text()}


def packages() -> Iterator[Path]:
    """The packages of the library, as paths from the root."""
    for folder in sorted(path for path in (ROOT / PACKAGE).iterdir() if (path / "__init__.py").is_file()):
        yield folder.relative_to(ROOT)


def expected_deps(name: str) -> set[str]:
    """What a stage depends on: its script, packages of which it imports a quarter of the modules, and other modules."""
    modules, found = modules_of(name), {re.search(r"stages/\w+\.py", definition(name)["cmd"])[0]}
    for package in packages():
        own = {module for module in modules if package in module.parents}
        most = 4 * len(own) >= len([path for path in (ROOT / package).rglob("*.py") if path.name != "__init__.py"])
        found |= {str(package)} if own and most else {str(module) for module in own}
        modules -= own
    return found | {str(module) for module in modules}


@pytest.mark.parametrize("name", list(PIPELINE))
def test_code_deps_are_those_of_the_modules_that_the_stage_imports(name: str) -> None:
    code = {dep for dep in definition(name)["deps"] if dep.startswith(("stages/", "src/"))}
    assert code == expected_deps(name)


@pytest.mark.parametrize("name", PLANS)
@pytest.mark.parametrize("package", ["training", "report", "app"])
def test_a_comment_in_a_package_reruns_no_planning(name: str, package: str) -> None:
    """No dependency of a plan stage is, or holds, a file of the package."""
    deps = [Path(dep) for dep in definition(name)["deps"]]
    for file in (ROOT / PACKAGE / package).rglob("*.py"):
        module = file.relative_to(ROOT)
        assert not [dep for dep in deps if dep == module or dep in module.parents]


def test_the_pipeline_fits_a_few_screens() -> None:
    assert len((ROOT / "dvc.yaml").read_text().splitlines()) < 350


@pytest.mark.parametrize("script", sorted(p.name for p in (ROOT / "stages").glob("*.py")))
def test_every_stage_script_is_short_and_in_the_pipeline(script: str) -> None:
    assert len((ROOT / "stages" / script).read_text().splitlines()) <= 60
    assert any(f"stages/{script}" in definition(name)["cmd"] for name in PIPELINE)
