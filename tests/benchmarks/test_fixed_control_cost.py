"""What one step of the current control in integers costs on emulated cores, as a called function.

The table is printed; what is asserted are instructions, which depend on the compiler alone.
"""

from __future__ import annotations

import os
import shutil
from functools import cache

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import Core
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.steps.integer_arithmetic import CodeArray
from dqforge.reports.control.fixed_header import control_fixed_files
from dqforge.reports.verification.measured_cost import CallCost, cost_of_calls

pytestmark = pytest.mark.benchmark

DRIVES = ("paper001-pmsm-bench", "paper000-ipmsm-100kw")
SAMPLES = 300

_STEP = """#include "{p}_control_q15.h"

{p}_duties_q15_t measured_step(const {p}_control_gains_q15_t *gains, {p}_control_q15_t *state,
    const {p}_measured_q15_t *measured, {p}_dq_q15_t reference);

{p}_duties_q15_t measured_step(const {p}_control_gains_q15_t *gains, {p}_control_q15_t *state,
    const {p}_measured_q15_t *measured, {p}_dq_q15_t reference)
{{
    return {p}_current_control_q15(gains, state, measured, reference);
}}
"""

_MAIN = """#include "{p}_control_q15.h"

{p}_duties_q15_t measured_step(const {p}_control_gains_q15_t *gains, {p}_control_q15_t *state,
    const {p}_measured_q15_t *measured, {p}_dq_q15_t reference);
int main(void);

static const int32_t rows[{count}][10] = {{ {rows} }};

int main(void)
{{
    {p}_control_q15_t state;
    uint32_t k;

    {p}_control_start_q15(&state);
    for (k = 0U; k < {count}U; ++k) {{
        const int32_t *row = rows[k];
        const {p}_measured_q15_t measured = {{
            {{ (int16_t)row[0], (int16_t)row[1], (int16_t)row[2] }},
            (uint16_t)row[3], (int16_t)row[4], (int16_t)row[5] }};
        const {p}_dq_q15_t reference = {{ (int16_t)row[6], (int16_t)row[7] }};

        state.d.integral = row[8];
        state.q.integral = row[9];
        (void)measured_step(&{P}_CONTROL_GAINS_Q15, &state, &measured, reference);
    }}
    return 0;
}}
"""


def samples(fit: FixedControlFit) -> CodeArray:
    """Half of them anywhere, half with currents near their references; shape (SAMPLES, 10)."""
    generator, control = np.random.default_rng(1), fit.control
    top = control.top
    length, angle = generator.uniform(0.0, 0.8, SAMPLES) * top, generator.uniform(0, 6.28, SAMPLES)
    theta = generator.integers(0, 2**16, SAMPLES)
    phases = [length * np.cos(angle - k * 2.0 * np.pi / 3.0) for k in range(3)]
    omega = generator.uniform(-0.8, 0.8, SAMPLES) * top
    link = 2.0 * control.dc_least * generator.uniform(0.8, 1.1, SAMPLES)
    anywhere = generator.uniform(-0.6, 0.6, (2, SAMPLES)) * top
    inner = angle - theta * (2.0 * np.pi / 2**16)
    near = length * np.stack([np.cos(inner), np.sin(inner)])
    near = near + generator.normal(size=(2, SAMPLES)) * top / 100.0
    settled = np.arange(SAMPLES) % 2 == 1
    reference = np.where(settled, np.clip(near, -top, top), anywhere)
    integrals = [
        (top << forms["parallel"].fraction)
        * generator.uniform(-1.0, 1.0, SAMPLES)
        * np.where(settled, 0.1, 0.5)
        for forms in (control.i_d, control.i_q)
    ]
    return np.stack([*phases, theta, omega, link, *reference, *integrals], axis=1).astype(np.int64)


def fitted(name: str) -> tuple[Design, FixedControlFit]:
    design = catalogue.load(name)
    gains = solve_gains(design)
    return design, fit_control(design, (gains.i_d, gains.i_q, gains.speed), None, 16)


@cache
def cost_of_samples(name: str, core: Core) -> CallCost:
    design, fit = fitted(name)
    prefix = design.export.prefix
    rows = ", ".join("{ " + ", ".join(map(str, row)) + " }" for row in samples(fit).tolist())
    names = {"p": prefix, "P": prefix.upper(), "rows": rows, "count": SAMPLES}
    sources = control_fixed_files(design, fit) | {
        "measured_step.c": _STEP.format(**names).encode("ascii"),
        "all_steps.c": _MAIN.format(**names).encode("ascii"),
    }
    return cost_of_calls(sources, "measured_step", core, ["measured_step.c"])


def test_current_control_in_q15(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    least: tuple[Core, Core] = ("cortex-m0plus", "cortex-m4")
    found = {(core, name): cost_of_samples(name, core) for core in least for name in DRIVES}
    with capsys.disabled():
        print()
        for (core, name), cost in found.items():
            mean, largest = cost.instructions, cost.instructions_largest
            print(f"Q15 {core} {name}: {mean:.0f} ({largest}) instructions")
    for (core, _), cost in found.items():
        assert cost.calls == SAMPLES
        assert cost.instructions <= (600 if core == "cortex-m0plus" else 400)
        assert cost.instructions_largest <= (650 if core == "cortex-m0plus" else 440)
