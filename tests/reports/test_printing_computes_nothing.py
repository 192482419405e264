"""Results carry what is printed: modules that print import results of the optimizer,
and none of its functions.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import dqforge

REPORTS = Path(dqforge.__file__).parent / "reports"

ORCHESTRATORS = {
    "choice_answer": "answers a question: the choice of modulator and frequency",
    "comparison_sources": "solves a design that is to be compared",
    "drive_losses": "answers a question: losses over a map or a mission",
    "drive_simulation": "solves a design, compiles its control and simulates the drive",
    "operating_points": "answers a question: operating points, maps and limits",
    "paper000": "reproduces a paper",
    "paper000_losses": "reproduces a paper",
    "paper001": "reproduces a paper",
    "paper002": "reproduces a paper",
    "run": "the main job: solves a design and gathers its files",
    "sensorless001": "reproduces a paper",
    "simulated_format": "fits the reference of a simulation",
    "transients": "reproduces a paper",
}
"""Modules that ask the optimizer, and why; what they find, others print."""

MODELS = {
    "control_fixed_model": "the control functions in integers, step by step",
    "control_fixed_reading": "proves again what is read back",
    "observer_model": "position observers in single precision",
    "reference_ir": "the current reference in single precision",
    "rule_model": "the choice of modulator in single precision",
    "waveform_model": "phase currents in single precision",
}
"""Modules that evaluate emitted C in its own arithmetic, for test vectors and to
compare with the compiled C."""

TO_BE_MENDED = {"speed_observer_header"}
"""Modules that print and still compute."""


def functions_of_the_optimizer(source: str) -> list[str]:
    """What a module imports of the optimizer, anywhere in it, beside classes and constants:
    functions and modules.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [name.name for name in node.names if name.name.startswith("dqforge.optimizer")]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
            "dqforge.optimizer"
        ):
            whole = node.module == "dqforge.optimizer"
            found += [
                name.name
                for name in node.names
                if whole or name.name == "*" or name.name.lstrip("_")[0].islower()
            ]
        elif isinstance(node, ast.ImportFrom) and node.module == "dqforge":
            found += [name.name for name in node.names if name.name == "optimizer"]
    return found


def modules() -> dict[str, Path]:
    """Every module of the reports by its dotted name below that folder."""
    return {
        ".".join(path.relative_to(REPORTS).with_suffix("").parts): path
        for path in sorted(REPORTS.rglob("*.py"))
        if path.name != "__init__.py"
    }


@pytest.mark.parametrize("name", modules())
def test_a_module_that_prints_imports_results_and_no_functions(name: str) -> None:
    found = functions_of_the_optimizer(modules()[name].read_text(encoding="utf-8"))
    if name in {*ORCHESTRATORS, *MODELS, *TO_BE_MENDED}:
        assert found, f"{name} stands on a list of exceptions and needs none: take it off"
    else:
        assert not found, (
            f"{name} prints and calls {', '.join(found)}: let the result carry what is printed"
        )


def test_lists_name_modules_that_there_are_and_each_once() -> None:
    listed = [*ORCHESTRATORS, *MODELS, *TO_BE_MENDED]
    assert len(listed) == len(set(listed))
    assert set(listed) <= set(modules())
    assert len(modules()) > 2 * len(listed)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("from dqforge.optimizer.gains import LoopGains, MOST_POINTS", []),
        ("from dqforge.optimizer.gains import LoopGains, per_unit", ["per_unit"]),
        ("def f():\n    from dqforge.optimizer.solution import solve as _s\n", ["solve"]),
        ("if True:\n    import dqforge.optimizer.gains\n", ["dqforge.optimizer.loops.gains"]),
        ("from dqforge.optimizer import gains", ["gains"]),
        ("from dqforge import optimizer", ["optimizer"]),
        ("from dqforge.optimizer.gains import _evidence", ["_evidence"]),
        ("from dqforge.optimizer.gains import *", ["*"]),
        ("from dqforge.machines.synchronous import copper_loss", []),
    ],
)
def test_every_way_to_import_a_function_is_seen(source: str, names: list[str]) -> None:
    assert functions_of_the_optimizer(source) == names
