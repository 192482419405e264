"""Results carry what is printed: modules that print import results of the optimizer,
and none of its functions.
"""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path
from typing import get_args

import pytest

import dqforge
from dqforge.machines.names import Firmware

REPORTS = Path(dqforge.__file__).parent / "reports"

# Rooms whose modules ask the optimizer, and what for.
ROOMS_THAT_ASK = {
    "answers": "from the request of a command to its answer: solve, then hand on to print",
    "papers": "reproduce a paper, from its figures to the tables beside them",
    "session": "the face for Python, which asks the optimizer for its caller",
}

# Modules that ask the optimizer, and why; what they find, others print.
ORCHESTRATORS = {
    "comparison.sources": "solves a design, or judges the loops of a file, that is to be compared",
    "estimator_comparison.random_starts": "starts drives that are drawn, as solved",
    "exploration.summary_files": "has those rows computed that no earlier study has",
    "exploration.winners": "finds the designs of rows again, and has them solved like any",
    "firmware.design_made": "tunes what a file leaves open: a loop that does not settle, a PLL",
    "firmware.design_simulation": "solves a design, and runs the loops of its firmware beside it",
    "run": "the main job: solves a design and gathers its files",
    "six_step.drive_run": "solves a six-step drive, compiles its control and simulates it",
    "simulation.design_run": "solves a design, compiles its control and simulates the drive",
    "simulation.feedback_run": "the same where a regulator switches the bridge itself",
}

# Modules that evaluate emitted C in its own arithmetic, for test vectors and to compare with the
# compiled C.
MODELS = {
    "c_code.harness": "angle functions and transforms in single precision",
    "steps.control_types": "writes angle functions and transforms in C, from their steps",
    "control.control_text": "writes the control functions in C, from their steps",
    "control.fixed_text": "writes the control functions in fixed point in C, from their steps",
    "steps.code_reader": "steps in codes of one word on numbers that know their text",
    "steps.code_text": "writes sine, transforms and shortening of codes in C, from their steps",
    "control.header": "the control functions in single precision, by the steps that are emitted",
    "control.fixed_model": "the control functions in integers, step by step, and proven again",
    "firmware.loop_code": "the loops of other firmware in C, by the rules they are judged by",
    "fixed_observers.fixed_observer_header": "the observers in integers, step by step",
    "single_headers.fixed_mesh_reading": "proves again what is read back",
    "single_headers.current_feedback": "the sampled rules by their steps, in words and in C",
    "observers.online_estimation": "the estimation on line by its step, in words and in C",
    "observers.commissioning": "the tests of a drive by their steps, in words and in C",
    "single_headers.speed_measurement": "the measured speed by its steps, in words and in C",
    "single_headers.frame_tables": "the frames dqx and dqy by their steps, in floats and in C",
    "modulation_choice.rule_model": "the choice of modulator in single precision",
    "phase_control.float32_model": "the control of phases in single precision",
    "phase_control.header": "writes the control of phases in C, from its steps",
    "phase_control.fixed_phase_text": "writes the control of phases in fixed point in C, likewise",
    "phase_control.fixed_phase_model": "the control of phases in integers, step by step",
    "output.recomputation": "computes and proves again what is read back",
    "six_step.header": "control of a six-step drive in single precision",
    "observers.float32_model": "observers of position and speed, and trackers, in single precision",
    "steps.integer_reader": "steps in integers on numbers that know their text and range",
    "steps.integer_text": "the observers in integers on numbers that know their text and range",
    "start_up.tried": "the state machine of a start in single precision",
    "verification.range_claims": "ranges of the integers, by their gains and largest codes",
    "waveforms.float32_model": "phase currents in single precision",
}


# Modules of the firmware of others that work out what a file amounts to, by the functions that
# serve a design.
def reads_firmware(name: str) -> bool:
    """Whether a module reads and writes files of a firmware."""
    return name.removeprefix("firmware.") in get_args(Firmware)


@cache
def parsed(source: str) -> ast.Module:
    return ast.parse(source)


def functions_of_the_optimizer(source: str) -> list[str]:
    """What a module imports of the optimizer, anywhere in it, beside classes and constants:
    functions and modules.
    """
    found = []
    for node in ast.walk(parsed(source)):
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


@cache
def modules() -> dict[str, Path]:
    """Every module of the reports by its dotted name below that folder."""
    return {
        ".".join(path.relative_to(REPORTS).with_suffix("").parts): path
        for path in sorted(REPORTS.rglob("*.py"))
        if path.name != "__init__.py"
    }


def test_modules_that_print_import_results_and_no_functions() -> None:
    calling: dict[str, list[str]] = {}
    needless = []
    for name, path in modules().items():
        if name.split(".", maxsplit=1)[0] in ROOMS_THAT_ASK or reads_firmware(name):
            continue
        found = functions_of_the_optimizer(path.read_text(encoding="utf-8"))
        if name not in {*ORCHESTRATORS, *MODELS}:
            calling |= {name: found} if found else {}
        elif not found:
            needless.append(name)
    assert calling == {}, "let the result carry what is printed"
    assert needless == [], "they stand on a list of exceptions and need none: take them off"


@cache
def functions_that_ask(source: str) -> set[str]:
    """Functions and classes of a module that use functions of the optimizer, or each other's."""
    asked = set(functions_of_the_optimizer(source))
    used = {
        node.name: {name.id for name in ast.walk(node) if isinstance(name, ast.Name)}
        | {alias.name for alias in ast.walk(node) if isinstance(alias, ast.alias)}
        for node in parsed(source).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }
    while more := {name for name, names in used.items() if names & asked} - asked:
        asked |= more
    return asked & set(used)


def functions_of_orchestrators(source: str) -> list[str]:
    """Functions that a module imports of those that ask the optimizer, and that ask it."""
    asking = {f"dqforge.reports.{name}": name for name in ORCHESTRATORS}
    return [
        name.name
        for node in ast.walk(parsed(source))
        if isinstance(node, ast.ImportFrom) and node.module in asking
        for name in node.names
        if name.name in functions_that_ask(modules()[asking[node.module]].read_text("utf-8"))
    ]


def test_a_function_asks_through_others() -> None:
    source = """
from dqforge.optimizer.solution import Solution, solve
def first(design): return second(design)
def second(design): return solve(design)
def third(solution: Solution): return solution.design
"""
    assert functions_that_ask(source) == {"first", "second"}


def test_modules_that_print_ask_nobody_who_asks() -> None:
    asks = {*ORCHESTRATORS, "output.recomputation"}
    asking = {
        name: found
        for name, path in modules().items()
        if name not in asks and name.split(".", maxsplit=1)[0] not in ROOMS_THAT_ASK
        if (found := functions_of_orchestrators(path.read_text(encoding="utf-8")))
    }
    assert asking == {}


def test_lists_name_modules_that_there_are_and_each_once() -> None:
    listed = [*ORCHESTRATORS, *MODELS]
    assert len(listed) == len(set(listed))
    assert set(listed) <= set(modules())
    assert len(modules()) > 2 * len(listed)


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("from dqforge.optimizer.gains import LoopGains, MOST_POINTS", []),
        ("from dqforge.optimizer.gains import LoopGains, per_unit", ["per_unit"]),
        ("def f():\n    from dqforge.optimizer.solution import solve as _s\n", ["solve"]),
        ("if True:\n    import dqforge.optimizer.gains\n", ["dqforge.optimizer.gains"]),
        ("from dqforge.optimizer import gains", ["gains"]),
        ("from dqforge import optimizer", ["optimizer"]),
        ("from dqforge.optimizer.gains import _evidence", ["_evidence"]),
        ("from dqforge.optimizer.gains import *", ["*"]),
        ("from dqforge.machines.synchronous import copper_loss", []),
    ],
)
def test_every_way_to_import_a_function_is_seen(source: str, names: list[str]) -> None:
    assert functions_of_the_optimizer(source) == names
