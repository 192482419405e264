"""What every function of the control's chain costs on emulated cores, beside the current control
made of CMSIS-DSP, in one run.

Both tables of docs/reference/control-cost.md are printed: the short one and that of every figure,
with DQFORGE_WHOLE_TABLES=1 of every function, else of those whose instructions are asserted, none
of which depends on the machine that measures. Rows are `control_chain.Step`; a further one joins
`chain`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator

import fixed_chain_steps as integers
import pytest
from chain_steps import (
    current_control,
    modulators,
    observers,
    speed_control,
    speed_loop,
    torque_reference,
    weakening_reference,
)
from cmsis_source import cmsis_folder, cmsis_step
from control_chain import Step

from dqforge.machines.names import Core, NumberFormat
from dqforge.reports.verification.measured_cost import CallCost

pytestmark = pytest.mark.benchmark

# Calls on each core; without floating point a call is up to fifty times as long.
CALLS: dict[Core, int] = {
    "cortex-m4": 300, "cortex-m33": 300, "cortex-m7": 300, "cortex-m0plus": 16,
}  # fmt: skip

NAMES: dict[str, str] = {
    "cortex-m4": "M4F", "cortex-m33": "M33", "cortex-m7": "M7", "cortex-m0plus": "M0+",
}  # fmt: skip

FORMATS: tuple[NumberFormat, ...] = ("q15", "q31")

# Columns of the short table.
SHORT: tuple[tuple[Core, str], ...] = (
    ("cortex-m4", "float32"), ("cortex-m33", "float32"), ("cortex-m7", "float32"),
    ("cortex-m4", "q15"), ("cortex-m0plus", "q15"), ("cortex-m0plus", "q31"),
    ("cortex-m0plus", "float32"),
)  # fmt: skip

NO_ERRNO, ERRNO = "-fno-math-errno", "-fmath-errno"

CURRENT, WHOLE = "current control", "speed control, the whole step"

GUARDED = f"{CURRENT}, without {NO_ERRNO}"

Found = dict[tuple[str, str], dict[Core, CallCost]]


def chain() -> Iterator[Step]:
    """Rows of the tables in the order in which they are printed, those of CMSIS-DSP left out."""
    yield torque_reference()
    yield from (integers.one_torque_reference(f) for f in FORMATS)
    yield weakening_reference()
    yield from (integers.torque_mesh(f) for f in FORMATS)
    yield current_control()
    yield current_control().compiled_with(GUARDED, ERRNO)
    yield from (integers.fixed_current_control(f) for f in FORMATS)
    yield speed_loop()
    yield from (integers.fixed_speed_loop(f) for f in FORMATS)
    yield speed_control()
    yield from (integers.fixed_speed_control(f) for f in FORMATS)
    yield from observers()
    for f in FORMATS:
        yield integers.fixed_speed_observer(f)
        yield from integers.fixed_observers(f)
    yield from modulators()
    for f in FORMATS:
        yield from integers.fixed_modulators(f)


def asserted() -> Iterator[Step]:
    """The rows of the chain that something is asked of."""
    yield current_control()
    yield current_control().compiled_with(GUARDED, ERRNO)
    yield from (integers.fixed_current_control(f) for f in FORMATS)
    yield speed_control()
    yield from (integers.fixed_speed_control(f) for f in FORMATS)


def compared() -> Iterator[Step]:
    """The current control made of CMSIS-DSP, with and without the flag; nothing where it cannot
    be had.
    """
    source = cmsis_folder()
    if source is not None:
        step = cmsis_step(current_control(), source)
        yield step.compiled_with(f"{step.label}, {NO_ERRNO}", NO_ERRNO)
        yield step.compiled_with(step.label, ERRNO)


def costs_of(steps: Iterable[Step]) -> Found:
    return {
        (step.label, step.numbers): {core: step.cost(core, calls) for core, calls in CALLS.items()}
        for step in steps
    }


def calls_said() -> str:
    """How many calls the means of a table are over."""
    (most, *_), least = CALLS.values(), CALLS["cortex-m0plus"]
    return f"function, over {most} calls, {least} on {NAMES['cortex-m0plus']}"


def short_cell(cost: CallCost | None) -> str:
    if cost is None:
        return ""
    (low, high), mean = cost.cycles, cost.instructions
    span = f"{low:.0f}" if round(low) == round(high) else f"{low:.0f}-{high:.0f}"
    return f"{mean:.0f} / {span} / {cost.flash}"


def short_table(found: Found) -> Iterator[str]:
    """Rows are functions, columns cores with number formats: mean instructions, cycles, bytes."""
    columns = (f"{NAMES[core]} {numbers}" for core, numbers in SHORT)
    yield f"| {calls_said()} | {' | '.join(columns)} |"
    yield f"|{'---|' * (1 + len(SHORT))}"
    for label in dict.fromkeys(label for label, _ in found):
        cells = (found.get((label, numbers), {}).get(core) for core, numbers in SHORT)
        yield f"| {label} | {' | '.join(short_cell(cost) for cost in cells)} |"


def long_table(found: Found) -> Iterator[str]:
    """Rows are functions in a number format, columns cores; with the largest number in brackets."""
    yield f"| {calls_said()} | numbers | {' | '.join(NAMES[core] for core in CALLS)} |"
    yield f"|{'---|' * (2 + len(CALLS))}"
    for (label, numbers), costs in found.items():
        cells = (
            short_cell(cost).replace(" /", f" ({cost.instructions_largest}) /", 1)
            for cost in costs.values()
        )
        yield f"| {label} | {numbers} | {' | '.join(cells)} |"


def test_the_chain_on_cores(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    steps = chain() if os.environ.get("DQFORGE_WHOLE_TABLES") else asserted()
    ours, others = costs_of(steps), costs_of(compared())
    at = list(ours).index((GUARDED, "float32")) + 1
    shown = dict([*list(ours.items())[:at], *others.items(), *list(ours.items())[at:]])
    with capsys.disabled():
        print("", *short_table(shown), "", *long_table(shown), sep="\n")
        if not others:
            print("CMSIS-DSP could not be had from PyPI.")
    if not others and os.environ.get("CI"):
        pytest.fail("CMSIS-DSP cannot be had from PyPI; CI needs it")
    plain, guarded = ours[CURRENT, "float32"], ours[GUARDED, "float32"]
    for core in ("cortex-m4", "cortex-m33", "cortex-m7"):
        assert plain[core].instructions <= guarded[core].instructions <= 200.0
        for costs in others.values():
            assert guarded[core].instructions < 0.75 * costs[core].instructions
            assert guarded[core].flash < costs[core].flash
    assert ours[CURRENT, "q15"]["cortex-m0plus"].instructions <= 600.0
    for numbers in ("float32", *FORMATS):
        for core in CALLS:
            assert (
                ours[WHOLE, numbers][core].instructions > ours[CURRENT, numbers][core].instructions
            )
