"""Each floor of the library imports only from its own and those below it (design section 3)."""

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "clothkit"
FLOORS = [
    "cloth",
    "manipulation",
    "simulation",
    "dataset",
    "models",
    "observation",
    "estimation",
    "planning",
    "episodes",
    "evaluation",
    "goals",
    "prebuilt",
    "training",
    "report",
    "environment",
    "app",
]
ABOVE_MODELS = FLOORS[FLOORS.index("observation") : FLOORS.index("training")]
"""What training does not import, and what does not import it."""
ONLY_IN = {"warp": "simulation", "matplotlib": "report", "dvc": None}


def imports_of(file: Path) -> list[str]:
    names: list[str] = []
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append(node.module or "")
    return names


@pytest.mark.parametrize("file", sorted(SOURCE.rglob("*.py")), ids=lambda f: str(f.relative_to(SOURCE)))
def test_imports_point_downwards(file: Path) -> None:
    parts = file.relative_to(SOURCE).parts
    floor = FLOORS.index(parts[0]) if parts[0] in FLOORS else None
    for name in imports_of(file):
        top, *rest = name.split(".")
        if top in ONLY_IN:
            assert parts[0] == ONLY_IN[top], f"{file} imports {name}"
        if top == "clothkit" and rest and floor is not None:
            assert rest[:2] != ["runtime", "stage"], f"{file} imports {name}"
            assert rest[0] != "params" or parts[0] == "app", f"{file} imports {name}"
            assert rest[0] not in FLOORS or FLOORS.index(rest[0]) <= floor, f"{file} imports {name}"
            assert parts[0] != "training" or rest[0] not in ABOVE_MODELS, f"{file} imports {name}"
