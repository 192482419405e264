"""``import dqforge``: light, complete, typed, and as the README shows it."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import dqforge

ROOT = Path(__file__).resolve().parent.parent
HEAVY = (
    "numpy",
    "scipy",
    "pydantic",
    "yaml",
    "pint",
    "casadi",
    "cvxpy",
    "nlopt",
    "matplotlib",
    "jinja2",
    "typer",
)


def lines_of(program: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def test_the_import_loads_nothing_heavy() -> None:
    program = (
        "import sys, dqforge\ndir(dqforge)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    assert lines_of(program) == ["[]"]


def test_a_name_loads_what_it_needs_alone() -> None:
    """The errors come without numpy, and a machine without pydantic."""
    program = (
        "import sys, dqforge\ndqforge.InputError\nprint('numpy' in sys.modules)\n"
        "dqforge.LinearMachine\n"
        "print('numpy' in sys.modules, 'pydantic' in sys.modules, 'yaml' in sys.modules)"
    )
    assert lines_of(program) == ["False", "True False False"]


def test_every_name_is_there_and_says_what_it_is() -> None:
    assert list(dqforge.__all__) == sorted(
        dqforge.__all__, key=lambda name: (name[0].islower(), name)
    )
    for name in dqforge.__all__:
        found = getattr(dqforge, name)
        assert found.__name__ == name
        assert inspect.getdoc(found)
    assert set(dir(dqforge)) == {*dqforge.__all__, "__version__"}


def test_what_type_checkers_read_is_what_is_loaded() -> None:
    """The imports for type checkers and the table of homes are the same list."""
    source = (ROOT / "__init__.py").read_text(encoding="utf-8")
    checked = source.split("if TYPE_CHECKING:\n")[1].split("\n__version__")[0]
    pattern = r"from dqforge\.([\w.]+) import (?:\(([^)]*)\)|([^\n]*))"
    listed = {
        home: tuple(sorted(re.findall(r"\w+", block or line)))
        for home, block, line in re.findall(pattern, checked)
    }
    assert listed == {home: tuple(sorted(names)) for home, names in dqforge._HOMES.items()}
    assert sorted(name for names in listed.values() for name in names) == sorted(dqforge.__all__)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="module 'dqforge' has no attribute 'mtpa'"):
        getattr(dqforge, "mt" + "pa")
    with pytest.raises(ImportError):
        exec("from dqforge import mtpa")


@pytest.mark.parametrize(
    "name", [name for name in dqforge.__all__ if inspect.isfunction(getattr(dqforge, name))]
)
def test_functions_describe_every_argument(name: str) -> None:
    """Each parameter is named in the docstring, and every function has types."""
    function = getattr(dqforge, name)
    signature = inspect.signature(function)
    text = inspect.getdoc(function) or ""
    described = text.partition("Args:")[2]
    for parameter in signature.parameters.values():
        assert re.search(rf"\b{parameter.name}\b", described), f"{name}: {parameter.name}"
        assert parameter.annotation is not inspect.Parameter.empty
    assert signature.return_annotation is not inspect.Signature.empty


@pytest.mark.parametrize("name", dqforge.__all__)
def test_the_reference_page_has_every_name(name: str) -> None:
    page = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    assert f"`{name}" in page


def test_the_reference_page_has_the_signatures() -> None:
    """Names in their order, those behind a star by name alone; ``...`` leaves out the rest."""
    page = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)\(([^)`]*)\)`", page, re.MULTILINE)
    functions = {
        name: listed for name, listed in rows if inspect.isfunction(getattr(dqforge, name))
    }
    assert set(functions) == {n for n in dqforge.__all__ if inspect.isfunction(getattr(dqforge, n))}
    for name, listed in functions.items():
        parts = [part.strip() for part in listed.split(",") if part.strip()]
        expected = []
        for parameter in inspect.signature(getattr(dqforge, name)).parameters.values():
            if parameter.kind is parameter.KEYWORD_ONLY and "*" not in expected:
                expected.append("*")
            many = parameter.kind is parameter.VAR_KEYWORD
            expected.append(f"**{parameter.name}" if many else parameter.name)
        if parts[-1:] == ["..."]:
            parts.pop()
            expected = expected[: len(parts)]
        assert parts == expected, name


def blocks(page: str) -> list[str]:
    """The Python sessions of a page."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def test_the_ten_lines_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten lines: a flux map from arrays, its map, the figure and the header."""
    session = blocks("docs/reference/python.md")[0]
    assert len([line for line in session.splitlines() if line.strip()]) <= 11
    monkeypatch.chdir(tmp_path)
    exec(compile(session, "docs/reference/python.md", "exec"), {})
    assert (tmp_path / "efficiency.svg").stat().st_size > 10_000
    assert "bench_current_reference(" in (tmp_path / "out" / "bench.h").read_text(encoding="ascii")


@pytest.mark.slow
def test_the_examples_of_the_reference_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for number, session in enumerate(blocks("docs/reference/python.md")[1:], start=1):
        exec(compile(session, f"docs/reference/python.md, block {number}", "exec"), names)
    assert names["dqforge"] is dqforge
