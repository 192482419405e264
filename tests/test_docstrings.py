"""Docstrings of public functions name every argument."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import dqforge

ROOT = Path(dqforge.__file__).parent
# Rooms whose public functions are checked, whoever calls them.
ROOMS = (
    "machines/dq_machines",
    "machines/losses",
    "machines/modulation",
    "machines/phase_machines",
    "optimizer/current_reference",
    "optimizer/loops",
    "optimizer/losses",
    "optimizer/operating_points",
)


def unnamed(function: ast.FunctionDef) -> list[str]:
    """Parameters of a function that its docstring does not name."""
    parts = function.args
    names = [part.arg for part in (*parts.posonlyargs, *parts.args, *parts.kwonlyargs)]
    text = ast.get_docstring(function) or ""
    return [
        name
        for name in names
        if not name.startswith("_") and not re.search(rf"\b{re.escape(name)}\b", text)
    ]


def public_functions(path: Path) -> list[ast.FunctionDef]:
    """Functions of a module that other modules may use."""
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return [
        node for node in body if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")
    ]


@pytest.mark.parametrize("room", [*ROOMS, "machines/transforms.py"])
def test_every_argument_is_named(room: str) -> None:
    place = ROOT / room
    paths = sorted(place.glob("*.py")) if place.is_dir() else [place]
    functions = [(path, function) for path in paths for function in public_functions(path)]
    assert functions
    lacking = {
        f"{path.name} {function.name}": names
        for path, function in functions
        if (names := unnamed(function))
    }
    assert lacking == {}


def test_a_parameter_that_is_not_named_is_found() -> None:
    source = 'def drawn(current, speed):\n    """Current in A."""\n'
    function = ast.parse(source).body[0]
    assert isinstance(function, ast.FunctionDef)
    assert unnamed(function) == ["current", "speed"]
