"""What every function of the control's chain costs on emulated cores, beside the current control
made of CMSIS-DSP, in one run.

The table is printed; what is asserted follows from instructions, none of which depends on the
machine that measures. Rows are `control_chain.Step`; a further one joins a list below.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator

import pytest
from chain_steps import (
    current_control,
    fixed_current_control,
    fixed_modulators,
    fixed_speed_observer,
    fixed_torque_reference,
    modulators,
    observers,
    speed_control,
    speed_loop,
    torque_reference,
    weakening_reference,
)
from cmsis_source import cmsis_folder, cmsis_step
from control_chain import Step

from dqforge.machines.names import Core
from dqforge.reports.verification.measured_cost import CallCost

pytestmark = pytest.mark.benchmark

# Calls on each core; without floating point a trace is a hundred times as long.
CALLS: dict[Core, int] = {
    "cortex-m4": 300, "cortex-m33": 300, "cortex-m7": 300, "cortex-m0plus": 16,
}  # fmt: skip

NO_ERRNO = "-fno-math-errno"

ERRNO = "-fmath-errno"

CURRENT, GUARDED = "current control", "current control, without -fno-math-errno"


def chain() -> Iterator[Step]:
    """Rows of the table but for CMSIS-DSP, in the order in which they are printed."""
    yield torque_reference()
    yield fixed_torque_reference("q15")
    yield fixed_torque_reference("q31")
    yield weakening_reference()
    yield current_control()
    yield current_control().compiled_with(GUARDED, ERRNO)
    yield fixed_current_control("q15")
    yield fixed_current_control("q31")
    yield speed_loop()
    yield speed_control()
    yield from observers()
    yield fixed_speed_observer("q15")
    yield fixed_speed_observer("q31")
    yield from modulators()
    yield from fixed_modulators("q15")


def cells(costs: dict[Core, CallCost]) -> Iterator[str]:
    for cost in costs.values():
        low, high = cost.cycles
        yield (
            f"{cost.instructions:.0f} ({cost.instructions_largest})"
            f" / {low:.0f}-{high:.0f} / {cost.flash}"
        )


def line(step: Step, costs: dict[Core, CallCost]) -> str:
    return f"| {' | '.join([step.label, step.numbers, *cells(costs)])} |"


def costs_of(step: Step) -> dict[Core, CallCost]:
    return {core: step.cost(core, calls) for core, calls in CALLS.items()}


def test_the_chain_on_cores(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    source = cmsis_folder()
    if source is None and os.environ.get("CI"):
        pytest.fail("CMSIS-DSP cannot be had from PyPI; CI needs it")
    found: dict[tuple[str, str], dict[Core, CallCost]] = {}
    lines = []
    for step in chain():
        costs = found[step.label, step.numbers] = costs_of(step)
        lines.append(line(step, costs))
        if step.label == GUARDED and source is not None:
            for label, flag in ((", -fno-math-errno", NO_ERRNO), ("", ERRNO)):
                other = cmsis_step(current_control(), source)
                other = other.compiled_with(other.label + label, flag)
                costs = found[other.label, "cmsis"] = costs_of(other)
                lines.append(line(other, costs))
    cores = " | ".join(core[7:].upper() for core in CALLS)
    with capsys.disabled():
        print("", f"| function | numbers | {cores} |", f"|{'---|' * (2 + len(CALLS))}", sep="\n")
        print(*lines, sep="\n")
        if source is None:
            print("CMSIS-DSP could not be had from PyPI.")
    plain, guarded = found[CURRENT, "float32"], found[GUARDED, "float32"]
    for core in ("cortex-m4", "cortex-m33", "cortex-m7"):
        assert plain[core].instructions <= guarded[core].instructions <= 200.0
        for (_, numbers), costs in found.items():
            if numbers == "cmsis":
                assert guarded[core].instructions < costs[core].instructions
    whole = found["speed control, the whole step", "float32"]["cortex-m4"]
    assert whole.instructions > plain["cortex-m4"].instructions
