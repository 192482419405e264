"""Runs of commands and of tests whose functions of physics are kept (`kept_values`): few, quick,
and together they come to nearly every function.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import io
import shlex
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack, chdir, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import faults
import fuzz
import house
import kept_values
import pytest

from dqforge import cli

# What commands find in their folder.
FILES = {
    "study.yaml": faults.STUDY.encode(),
    "cap.csv": fuzz.CAPTURE,
    "mission.csv": b"time [s],speed [rpm],torque [N m]\n0,0,10\n1,900,50\n2,2000,30\n3,2500,-20\n",
}
COMMANDS = {
    "mtpa": "mtpa paper000-ipmsm-100kw",
    "mtpa-data": 'mtpa abb-syrm-6k7-saturated --speed "2000 rpm"',
    "mtpa-total": "mtpa paper000-ipmsm-100kw --map 4x5 --objective total",
    "mtpa-dead-time": "mtpa abb-ipmsm-2k2 --map 4x5 --margin dead-time",
    "mtpa-point": 'mtpa thor-pmsyrm-5k --torque "10 N m" --speed "3000 rpm"',
    "fit": "fit paper000-ipmsm-100kw",
    "fit-thor": "fit thor-pmsyrm-5k",
    "tune": "tune paper000-ipmsm-100kw",
    "tune-optimised": """tune baldor-pmsyrm-5k6 --set 'control.current_loop={method: optimised}'""",
    "tune-tolerances": "tune abb-ipmsm-2k2 --set control.tolerances.r_s='{from: 0 %, to: 30 %}'",
    "tune-map": "tune thor-pmsyrm-5k",
    "losses": "losses paper000-ipmsm-100kw --modulations all",
    "losses-map": "losses paper000-ipmsm-100kw --map 4x5",
    "losses-choice": "losses paper000-ipmsm-100kw --choice"
    " --set modulation_choice.torques=4 --set modulation_choice.speeds=5",
    "losses-points": "losses abb-ipmsm-2k2 --points '5 N m 900 rpm' --frequencies '8 kHz, 16 kHz'"
    " --strategies mtpa,id0,least-loss",
    "losses-phases": "losses paper002-phase-waveforms --points '0.5 N m 900 rpm'",
    "losses-mission": "losses paper000-ipmsm-100kw --mission mission.csv",
    "dqy": "dqy paper002-phase-waveforms",
    "dqy-salient": "dqy salient-phase-waveforms",
    "dqy-open": "dqy paper002-phase-waveforms --open-phase c --torque '0.5 N m'",
    "dqy-flash": "dqy paper002-phase-waveforms --flash",
    "compared": "estimators paper001-pmsm-bench --only flux,injection",
    "capture": "bemf cap.csv --pole-pairs 4",
    "identify-plan": "identify paper001-pmsm-bench --plan -o plan",
    "explore": "explore study.yaml -o study --workers 1",
    "check": "check paper000-ipmsm-100kw",
}
# So many cases of a test at most.
MOST = 12
# A folder with more tests than that makes a case of each file.
MANY = 9
# File and function, a line each.
TESTS = Path(__file__).with_name("kept_tests.txt")


def _commanded(line: str) -> None:
    """Run a command line in a folder of their own.

    Raises:
        AssertionError: It is refused.
    """
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        stack.enter_context(chdir(place))
        stack.enter_context(redirect_stdout(said))
        stack.enter_context(redirect_stderr(said))
        for name, content in FILES.items():
            Path(name).write_bytes(content)
        with pytest.raises(SystemExit) as end:
            cli.main(shlex.split(line))
        assert not end.value.code, f"{line}: {said.getvalue()}"


def _module(path: str) -> ModuleType:
    """A file of tests, loaded once, with what lies beside it at hand."""
    name = "kept_" + path.removesuffix(".py").replace("/", "_")
    if name not in sys.modules:
        file = house.ROOT / path
        spec = importlib.util.spec_from_file_location(name, file)
        assert spec is not None
        assert spec.loader is not None
        if str(file.parent) not in sys.path:
            sys.path.append(str(file.parent))
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        with kept_values.unseen():
            spec.loader.exec_module(module)
    return sys.modules[name]


def _arguments(test: Callable[..., object]) -> list[dict[str, Any]]:
    """What a test is called with, by its marks; not what is slow."""
    found: list[dict[str, Any]] = [{}]
    for mark in getattr(test, "pytestmark", ()):
        if mark.name == "parametrize":
            names, rows = mark.args[:2]
            names = names.replace(" ", "").split(",") if isinstance(names, str) else list(names)
            rows = [
                row if hasattr(row, "marks") else pytest.param(*_row(names, row)) for row in rows
            ]
            rows = [dict(zip(names, row.values, strict=True)) for row in rows if not row.marks]
            found = [one | row for one in found for row in rows]
    return found[:MOST]


def _row(names: list[str], row: Any) -> tuple[Any, ...]:
    return (row,) if len(names) == 1 else tuple(row)


class _Fixtures(dict[str, Any]):
    """Values of fixtures of a file or of all files, made when they are first asked for."""

    def __init__(self, module: ModuleType, place: Path) -> None:
        super().__init__(tmp_path=place)
        self._places = [module, importlib.import_module("conftest")]

    def __missing__(self, name: str) -> Any:
        fixture: Any = next(vars(one)[name] for one in self._places if name in vars(one))
        made = _called(fixture._fixture_function, self)
        self[name] = next(made) if inspect.isgenerator(made) else made
        return self[name]


def _called(function: Callable[..., Any], fixtures: _Fixtures, **known: Any) -> Any:
    wanted = inspect.signature(function).parameters.keys() - known.keys()
    return function(**known, **{name: fixtures[name] for name in sorted(wanted)})


def _tested(path: str, names: list[str]) -> None:
    """Run tests of a file, with the fixtures that stand beside them."""
    module = _module(path)
    for name in names:
        test = getattr(module, name)
        for arguments in _arguments(test):
            with tempfile.TemporaryDirectory() as place:
                _called(test, _Fixtures(module, Path(place)), **arguments)


def _all(runs: Sequence[Callable[[], None]]) -> dict[str, str]:
    for run in runs:
        run()
    return {}


def cases() -> dict[str, Callable[[], dict[str, str]]]:
    """All of them by name: commands, and the tests of a folder, or of its files if it has many."""
    lines = TESTS.read_text(encoding="utf-8").split()
    rooms = Counter(line.rpartition("/")[0] for line in lines)
    folders: dict[str, dict[str, list[str]]] = {}
    for line in lines:
        path, name = line.split("::")
        room = path.rpartition("/")[0]
        whole = path if rooms[room] > MANY else room
        case = whole.removesuffix(".py").replace("/", "-")
        folders.setdefault(case, {}).setdefault(f"tests/{path}", []).append(name)
    by_command = {name: [partial(_commanded, line)] for name, line in COMMANDS.items()}
    by_folder = {
        room: [partial(_tested, path, names) for path, names in files.items()]
        for room, files in folders.items()
    }
    return {name: partial(_all, runs) for name, runs in (by_command | by_folder).items()}
