"""What benchmarks/mutants.py would change is there, and has tests that could notice."""

import tomllib

from tests.tiny import ROOT

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["clothkit"]["mutants"]
MODULES = [f"{package}/{name}" for package, names in SETTINGS["modules"].items() for name in names]


def test_every_module_exists_and_has_tests() -> None:
    beside = SETTINGS["beside"]
    assert set(beside) <= set(MODULES)
    for module in MODULES:
        assert (ROOT / f"src/clothkit/{module}.py").is_file(), module
        package, name = module.rsplit("/", 1)
        own = ROOT / f"tests/{package}/test_{name}.py"
        assert own.is_file() or beside.get(module), f"{module}: no test"
        for path in beside.get(module, []):
            assert (ROOT / path).is_file(), path


def test_every_way_to_search_is_among_them() -> None:
    files = (ROOT / "src/clothkit/planning/optimisers").glob("[!_]*.py")
    assert {f"planning/optimisers/{file.stem}" for file in files} <= set(MODULES)
