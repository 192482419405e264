"""What one step of the control of phase machines costs on emulated cores, by frame, beside that of
constant dq currents.

The table is printed, with DQFORGE_WHOLE_TABLES=1 of every case, else of those that something is
asked of. What is asserted follows from instructions and bytes, none of which depends on the machine
that measures.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import replace

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control

from dqforge.machines.design import catalogue
from dqforge.machines.names import Core, CurrentFrame, Feedforward, Topology
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import control_files
from dqforge.reports.main_header.header import header_files
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.verification.measured_cost import TargetCost, cost_on_target

pytestmark = pytest.mark.benchmark

CORES: tuple[Core, ...] = ("cortex-m4", "cortex-m33", "cortex-m7", "cortex-m0plus")

ANGLES = np.linspace(-3.1, 3.1, 64).astype(np.float32)

_STEP = """#include "{prefix}_control.h"

static {prefix}_control_t control_state;

static inline void control_step_at(float theta, float *first, float *last)
{{
    {prefix}_measured_t measured;

    measured.i.a = 0.5F;
    measured.i.b = -0.2F;
    measured.i.c = -0.3F;
    measured.theta_e = theta;
    measured.omega_m = 80.0F;
    measured.v_dc = 220.0F;
    {midpoint}
    {{
        const {prefix}_{duties} duty =
            {prefix}_torque_control(&{macro}_CONTROL_GAINS, &control_state, &measured, 1.0F);

        *first = duty.a;
        *last = duty.c;
    }}
}}
"""

CASES: list[tuple[Topology, CurrentFrame, Feedforward, bool]] = [
    ("three-wire", "dq", "references", True),
    ("three-wire", "dqx", "references", True),
    ("three-wire", "table", "none", False),
    ("three-wire", "table", "references", False),
    ("three-wire", "table", "references", True),
    ("four-leg", "dq", "references", True),
    ("four-leg", "dqx", "references", True),
    ("four-leg", "dqy", "references", True),
    ("four-leg", "dqy", "measured", True),
    ("four-leg", "table", "references", False),
    ("four-leg", "table", "references", True),
    ("six-leg", "table", "references", True),
    ("split-capacitor", "table", "references", True),
]


ASSERTED: list[tuple[Topology, CurrentFrame, Feedforward, bool]] = [
    ("four-leg", "dqy", "references", True),
    ("four-leg", "table", "references", False),
    ("four-leg", "table", "references", True),
]


def whole_table() -> bool:
    return bool(os.environ.get("DQFORGE_WHOLE_TABLES"))


def costs_of(
    base: Solution, files: dict[str, bytes], duties: str, midpoint: str = ""
) -> dict[str, TargetCost]:
    """Cost of one step at angles around the period, on every core."""
    prefix = base.design.export.prefix
    step = _STEP.format(prefix=prefix, macro=prefix.upper(), duties=duties, midpoint=midpoint)
    sources = header_files(base) | files | {"step.h": step.encode("ascii")}
    return {
        core: cost_on_target(sources, "step.h", "control_step_at", core, ANGLES) for core in CORES
    }


def phase_costs(base: Solution, control: PhaseControl) -> dict[str, TargetCost]:
    midpoint = "measured.v_m = 110.0F;" if control.midpoint is not None else ""
    return costs_of(base, phase_control_files(base, control), "duties_t", midpoint)


def line(label: str, costs: dict[str, TargetCost]) -> str:
    cells = [label]
    for cost in costs.values():
        low, high = cost.cycles
        cells.append(f"{cost.instructions:.0f} / {low:.0f}-{high:.0f} / {cost.flash}")
    return f"| {' | '.join(cells)} |"


def test_steps_on_cores(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    base = solve(catalogue.load("paper002-phase-waveforms"))
    machine, found = near_sinusoidal(96), {}
    rows = {"dq of sinusoidal machines, three-wire": costs_of(base, control_files(base), "abc_t")}
    for topology, frame, feedforward, harmonics in CASES if whole_table() else ASSERTED:
        control = plain_control(machine, topology, frame, feedforward)
        control = control if harmonics else replace(control, harmonics=None)
        costs = found[topology, frame, feedforward, harmonics] = phase_costs(base, control)
        label = f"{frame}, {topology}, {feedforward}{'' if harmonics else ', no harmonics'}"
        rows[label] = costs
    cores = " | ".join(core[7:].upper() for core in CORES)
    with capsys.disabled():
        print("", f"| step | {cores} |", f"|{'---|' * (1 + len(CORES))}", sep="\n")
        print(*(line(label, costs) for label, costs in rows.items()), sep="\n")
    whole = found["four-leg", "table", "references", True]["cortex-m4"]
    bare = found["four-leg", "table", "references", False]["cortex-m4"]
    follows = found["four-leg", "dqy", "references", True]["cortex-m4"]
    assert bare.instructions < whole.instructions < follows.instructions
    # A tenth of the period at 10 kHz and 168 MHz is 1680 cycles.
    assert whole.cycles[1] < 1680
    assert whole.flash < 8000
