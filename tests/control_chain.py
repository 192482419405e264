"""Steps of the control's whole chain as called functions, to be costed on emulated cores.

A `Step` is a function that is not inlined into its caller and a program that calls it for rows of
random inputs. To add one, write a function that returns a `Step` and put it into a list of
tests/benchmarks/test_control_chain_cost.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.reports.verification.measured_cost import CallCost, cost_of_calls

MEASURED = """#include "{header}"

{result} measured_call({parameters});

{result} measured_call({parameters})
{{
    {body}
}}
"""

MAIN = """#include "{header}"

#include <stdint.h>

int main(void);
{result} measured_call({parameters});

static const union {{
    uint32_t bits[{count}][{width}];
    {number} values[{count}][{width}];
}} rows = {{ {{
{rows}
}} }};

int main(void)
{{
    {state}
    uint32_t k;

    {start}
    for (k = 0U; k < {count}U; ++k) {{
        const {number} *const r = rows.values[k];

        {prepare}
        (void)measured_call({passed});
    }}
    return 0;
}}
"""


@dataclass(frozen=True)
class Step:
    """A function of the chain with what calls it.

    Args:
        label, numbers: Names of the row and of its number format.
        files: Headers by name, and C files that belong to them.
        header: The one of them that is included.
        parameters, body, result: Of the measured function, as C.
        state, start, prepare, passed: The caller's declarations, what it does once, what it does
            with the row ``r`` before each call, and the arguments that it passes, as C.
        rows: Float32 numbers or int32 codes, shape (calls, width).
        flags: Further flags of the compiler.
    """

    label: str
    numbers: str
    files: Mapping[str, bytes]
    header: str
    parameters: str
    body: str
    passed: str
    rows: NDArray[Any] = field(repr=False)
    result: str = "void"
    state: str = ""
    start: str = ""
    prepare: str = ""
    flags: tuple[str, ...] = ()

    def compiled_with(self, label: str, *flags: str) -> Step:
        """The same with further flags, under another label."""
        return replace(self, label=label, flags=(*self.flags, *flags))

    def sources(self, calls: int) -> dict[str, bytes]:
        """All files of the program that makes the first ``calls`` calls."""
        words = np.ascontiguousarray(self.rows[:calls]).view(np.uint32)
        lines = ("    { " + ", ".join(f"0x{word:X}U" for word in row) + " }" for row in words)
        context = {
            "header": self.header,
            "result": self.result,
            "parameters": self.parameters,
            "body": self.body,
            "passed": self.passed,
            "state": self.state,
            "start": self.start,
            "prepare": self.prepare,
            "number": "float" if self.rows.dtype == np.float32 else "int32_t",
            "count": len(words),
            "width": words.shape[1],
            "rows": ",\n".join(lines),
        }
        made = {"measured.c": MEASURED, "calls.c": MAIN}
        return dict(self.files) | {
            name: text.format(**context).encode("ascii") for name, text in made.items()
        }

    def cost(self, core: str, calls: int) -> CallCost:
        """Cost on a core over the first ``calls`` rows."""
        sources = self.sources(calls)
        sized = [name for name in sources if name.endswith(".c") and name != "calls.c"]
        return cost_of_calls(sources, "measured_call", core, sized, self.flags)


def current_rows(count: int, v_max: float, i_max: float, omega_m: float, v_dc: float) -> Any:
    """Rows of the current control: i_a, i_b, i_c, theta_e, omega_m, v_dc, references d and q, and
    both integrals.

    Two thirds lie close to their references, one third is thrown far off them, beyond the voltage.

    Args:
        count: Number of rows.
        v_max: Voltage in V around which the integrals spread: a fifth of it.
        i_max, omega_m, v_dc: Current in A, mechanical speed in rad/s and DC-link voltage in V, all
            largest.
    """
    generator = np.random.default_rng(20_261_122)
    theta = generator.uniform(-np.pi, np.pi, count)
    i = generator.uniform(-0.6, 0.6, (2, count)) * i_max
    spread = np.where(np.arange(count) % 3 == 0, 2.0, 0.02) * i_max
    reference = i + spread * generator.uniform(-1.0, 1.0, (2, count))
    alpha = i[0] * np.cos(theta) - i[1] * np.sin(theta)
    beta = i[0] * np.sin(theta) + i[1] * np.cos(theta)
    side = np.sqrt(0.75) * beta
    speed = generator.uniform(-1.0, 1.0, count) * omega_m
    integral = 0.2 * v_max * generator.uniform(-1.0, 1.0, (2, count))
    columns = [
        alpha, -0.5 * alpha + side, -0.5 * alpha - side, theta, speed,
        generator.uniform(0.9, 1.0, count) * v_dc, *reference, *integral,
    ]  # fmt: skip
    return np.stack(columns, axis=1).astype(np.float32)
