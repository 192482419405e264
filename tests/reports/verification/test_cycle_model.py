"""The cycle model against hand counts, the tables it cites, and figures that were
found by another emulator.
"""

from __future__ import annotations

import os
import shutil

import numpy as np
import pytest

from dqforge.reports.verification.cross_tools import (
    CORES,
    TARGETS,
    address_of,
    calls_of,
    cycles,
    parse_disassembly,
    traced_addresses,
)
from dqforge.reports.verification.measured_cost import cost_on_target

LISTING = """
00000010 <main>:
  10:\tf000 f806 \tbl\t20 <evaluator>
  14:\t4770      \tbx\tlr

00000020 <evaluator>:
  20:\ted9f 7a05 \tvldr\ts14, [pc, #20]\t@ 38 <evaluator+0x18>
  24:\teddf 7a05 \tvldr\ts15, [pc, #20]\t@ 3c <evaluator+0x1c>
  28:\tee20 0a07 \tvmul.f32\ts0, s0, s14
  2c:\tee30 0a27 \tvadd.f32\ts0, s0, s15
  30:\teeb5 0ac0 \tvcmpe.f32\ts0, #0.0
  34:\teef1 fa10 \tvmrs\tAPSR_nzcv, fpscr
  38:\tbf48      \tit\tmi
  3a:\teeb1 0a40 \tvnegmi.f32\ts0, s0
  3e:\ted80 0a00 \tvstr\ts0, [r0]
  42:\te92d 4030 \tstmdb\tsp!, {r4, r5, lr}
  46:\tbd30      \tpop\t{r4-r5, pc}
  48:\t43480000 \t.word\t0x43480000
"""


def test_a_straight_line_is_what_a_hand_counts() -> None:
    """Loads 2 + 1..2, product and sum 1 + 1 wait, compare and flags 2, IT 0..1,
    negation 1 + 1 wait, store 1..2.

    Three registers pushed 4, three popped 4 with a refill of 1..3.
    """
    code = parse_disassembly(LISTING)
    body = [code[address] for address in sorted(code) if address >= 0x20]
    assert [instruction.mnemonic for instruction in body[6:8]] == ["it", "vneg.f32"]
    assert body[7].conditional
    assert not body[8].conditional
    low = 2 + 1 + 2 + 2 + 1 + 1 + 0 + 2 + 1 + 4 + 4 + 1
    high = 2 + 2 + 2 + 2 + 1 + 1 + 1 + 2 + 2 + 4 + 4 + 3
    for core in ("cortex-m4", "cortex-m33"):
        assert cycles(body, core) == (low, high)
    assert cycles(body, "cortex-m7") == (6 + 3, high)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("mla\tr0, r1, r2, r3", {"cortex-m3": (2, 2), "cortex-m4": (1, 1)}),
        ("umull\tr0, r1, r2, r3", {"cortex-m3": (3, 5), "cortex-m4": (1, 1)}),
        ("umlal\tr0, r1, r2, r3", {"cortex-m3": (4, 7), "cortex-m4": (1, 1)}),
        ("sdiv\tr0, r1, r2", {"cortex-m3": (2, 12), "cortex-m4": (2, 12)}),
        ("ldr.w\tr0, [r1]", {"cortex-m0plus": (2, 2), "cortex-m3": (2, 2), "cortex-m4": (2, 2)}),
        ("str\tr0, [r1]", {"cortex-m0plus": (2, 2), "cortex-m4": (1, 1)}),
        ("strd\tr0, r2, [r1]", {"cortex-m4": (3, 3)}),
        ("ldmia.w\tr0!, {r1, r2, r4-r7}", {"cortex-m4": (7, 7), "cortex-m0plus": (7, 7)}),
        ("muls\tr0, r1", {"cortex-m0plus": (1, 1), "cortex-m4": (1, 1)}),
        ("vfma.f32\ts0, s1, s2", {"cortex-m4": (3, 3)}),
        ("vdiv.f32\ts0, s1, s2", {"cortex-m4": (14, 14)}),
        ("vsqrt.f32\ts0, s1", {"cortex-m33": (14, 14)}),
        ("vmov\tr3, s0", {"cortex-m4": (1, 2)}),
        ("vmov\tsl, s0", {"cortex-m4": (1, 2)}),
        ("vmov.f32\ts1, s0", {"cortex-m4": (1, 1)}),
        ("vldr\td7, [r0]", {"cortex-m4": (3, 3)}),
    ],
)
def test_single_instructions_have_the_cycles_of_their_tables(
    line: str, expected: dict[str, tuple[int, int]]
) -> None:
    """Between two others that touch nothing of theirs, whose cycles are taken off again."""
    text = (
        f"   0:\tbf00      \tnop\n   2:\t0000 0000 \t{line}\n   6:\tbf00      \tnop\n"
        "   8:\t4770      \tbx\tlr\n"
    )
    code = parse_disassembly(text)
    for core, (low, high) in expected.items():
        whole = cycles([code[0], code[2], code[6], code[8]], core)
        rest = cycles([code[0], code[6], code[8]], core)
        jump = CORES[core].refill  # the line that is left out makes a jump of the nop before it
        assert (whole[0] - rest[0] + jump[0], whole[1] - rest[1] + jump[1]) == (low, high)


def test_branches_cost_what_they_do_only_when_taken() -> None:
    code = parse_disassembly(
        "   0:\td0fe      \tbeq.n\t0 <x>\n   2:\tf7ff fffe \tbl\t0 <x>\n   6:\t4770      \tbx\tlr\n"
    )
    for core, branch, call in (("cortex-m4", (2, 4), (2, 4)), ("cortex-m0plus", (2, 2), (3, 3))):
        assert cycles([code[0]], core) == branch
        assert cycles([code[2]], core) == call
        straight = cycles([code[0], code[2]], core)
        assert straight == (1 + call[0], 1 + call[1])


def test_the_addend_of_a_multiply_accumulate_needs_no_wait() -> None:
    lines = (
        "   0:\t0000 0000 \tvmul.f32\t{0}\n   4:\t0000 0000 \tvmla.f32\ts3, s4, s5\n"
        "   8:\t4770      \tbx\tlr\n"
    )
    found = []
    for operands in ("s3, s1, s1", "s4, s1, s1", "s9, s1, s1"):
        code = parse_disassembly(lines.format(operands))
        found.append(cycles([code[0], code[4], code[8]], "cortex-m4")[0])
    assert found == [6, 7, 6]


def test_trace_is_cut_at_any_byte_and_gives_the_calls() -> None:
    code = parse_disassembly(LISTING)
    line = "Trace 0: 0x7f00 [00800408/{:08x}/00000110/ff000201] name\n"
    log = "".join(
        line.format(address) for address in (0x10, 0x20, 0x24, 0x14, 0x10, 0x20, 0x28, 0x14)
    ).encode()
    for size in (1, 7, 60, 1000):
        chunks = [log[k : k + size] for k in range(0, len(log), size)]
        calls = list(calls_of(traced_addresses(chunks), address_of(LISTING, "evaluator"), code))
        assert calls == [(0x20, 0x24), (0x20, 0x28)]
    held = (
        line.format(0x10).encode()
        + b"Stopped execution of TB chain before 0x7f [00000010] main\n"
        + log
    )
    assert list(traced_addresses([held])) == list(traced_addresses([log]))
    with pytest.raises(ValueError, match="absent is not in the disassembly"):
        address_of(LISTING, "absent")


def polynomial(degree: int, first: float) -> str:
    text = f"{first}F"
    for power in range(1, degree + 1):
        text = f"({text} * t + {first + 0.37 * power}F)"
    return text


def two_curves(degree: int) -> str:
    return (
        f"if (t < 1.7F) {{ *i_d = {polynomial(degree, 1.13)}; *i_q = {polynomial(degree, -2.21)}; "
        f"}} else {{ *i_d = {polynomial(degree, 3.47)}; *i_q = {polynomial(degree, -4.59)}; }}"
    )


TABLE = (
    "const float x = t * 12.8F; const int32_t k = (int32_t)x; const float f = x - (float)k;"
    "*i_d = d[k] + f * (d[k + 1] - d[k]); *i_q = q[k] + f * (q[k + 1] - q[k]);"
)


@pytest.mark.parametrize(
    ("body", "instructions", "nominal"),
    [
        (two_curves(2), 21, 28),
        (two_curves(3), 27, 35),
        (two_curves(4), 33, 42),
        ("(void)i_q; *i_d = 0.93F - sqrtf(t * t + 0.8649F);", 9, 26),
        (TABLE, None, 33),
    ],
    ids=["degree-2", "degree-3", "degree-4", "root", "table"],
)
def test_estimates_enclose_what_another_emulator_and_table_gave(
    body: str, instructions: int | None, nominal: int
) -> None:
    """Bare functions without sign and clamp, costed before under Unicorn with P = 2: 28, 35, 42,
    26, 33 cycles.

    The root waited one cycle less there (for its store), and the table was
    costed without the return.
    """
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    values = ", ".join(f"{value:.3f}F" for value in np.linspace(0.1, 0.9, 66))
    tables = (
        f"static const float d[66] = {{ {values} }}; static const float q[66] = {{ {values} }};"
    )
    text = f"#include <math.h>\n#include <stdint.h>\n{tables if 'd[k]' in body else ''}\n"
    text += f"static inline void bare(float t, float *i_d, float *i_q) {{ {body} }}\n"
    torque = np.linspace(0.05, 4.95, 64, dtype=np.float32)
    cost = cost_on_target({"bare.h": text.encode()}, "bare.h", "bare", "cortex-m4", torque)
    low, high = cost.cycles
    if instructions is not None:
        assert abs(cost.instructions - instructions) <= 1.0
    assert 0.92 * low <= nominal <= high
    assert set(CORES) == set(TARGETS)
