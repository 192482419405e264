"""Logs of blocks against hand-written ones, and against single steps of the same program."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from pathlib import Path

import pytest

from dqforge.machines.errors import VerificationError
from dqforge.machines.names import Core
from dqforge.reports.verification.cross_tools import (
    LOGGED,
    address_of,
    build,
    calls_in_blocks,
    calls_of,
    cycles,
    cycles_of_paths,
    emulate,
    execute,
    executed_blocks,
    parse_disassembly,
    program,
    traced_addresses,
)

LOG = b"""----------------
IN: main
0x00000010:  f000 f806  bl       #0x20

Trace 0: 0x7f0100 [00800408/00000010/00000110/ff000200] main
----------------
IN: evaluator
0x00000020:  2300       movs     r3, #0
0x00000022:  4770       bx       lr

Trace 0: 0x7f0200 [00800408/00000020/00000010/ff000200] evaluator
----------------
IN: main
0x00000014:  e7fc       b        #0x10

Trace 0: 0x7f0300 [00800408/00000014/00000010/ff000200] main
Trace 0: 0x7f0100 [00800408/00000010/00000110/ff000200] main
Stopped execution of TB chain before 0x7f0100 [00000010] main
Trace 0: 0x7f0100 [00800408/00000010/00000110/ff000200] main
Trace 0: 0x7f0200 [00800408/00000020/00000010/ff000200] evaluator
Trace 0: 0x7f0300 [00800408/00000014/00000010/ff000200] main
"""

LISTING = """
00000010 <main>:
  10:\tf000 f806 \tbl\t20 <evaluator>
  14:\te7fc      \tb.n\t10 <main>

00000020 <evaluator>:
  20:\t2300      \tmovs\tr3, #0
  22:\t4770      \tbx\tlr
"""


def test_a_log_is_cut_at_any_byte_and_gives_blocks_and_calls() -> None:
    code = parse_disassembly(LISTING)
    for size in (1, 7, 60, 10_000):
        trace = executed_blocks(LOG[k : k + size] for k in range(0, len(LOG), size))
        assert trace.blocks == ((0x10,), (0x20, 0x22), (0x14,))
        assert trace.order == (0, 1, 2, 0, 1, 2)
        calls = list(calls_in_blocks(trace, address_of(LISTING, "evaluator"), code))
        assert calls == [(1,), (1,)]


def test_a_block_that_is_translated_anew_is_the_later_one() -> None:
    """QEMU reuses the place of a block whose code it threw away."""
    anew = LOG.replace(b"0x00000022:  4770       bx       lr\n", b"") + LOG
    trace = executed_blocks([anew])
    assert trace.blocks == ((0x10,), (0x20,), (0x14,), (0x20, 0x22))
    assert trace.order == (0, 1, 2, 0, 1, 2, 0, 3, 2, 0, 3, 2)


def test_blocks_that_are_not_split_into_instructions_are_refused() -> None:
    bare = b"IN: main\n0x00000010:  \nOBJD-T: f000f806\n\nTrace 0: 0x7f0100 [0/00000010/0/0] main\n"
    with pytest.raises(VerificationError, match="built with capstone"):
        executed_blocks([bare])


PROGRAM = {
    "called.c": """#include <stdint.h>
int32_t called(int32_t n, float x);
int32_t called(int32_t n, float x)
{
    int32_t k, sum = 0;
    float y = x;
    for (k = 0; k < n; ++k) { sum += (k & 1) ? k : (int32_t)(y * 3.0F); y = y / (1.5F + x); }
    if (sum > 40) { sum = -sum; }
    return (sum > n) ? sum / (n + 1) : (int32_t)((int64_t)sum * sum);
}
""",
    "calls.c": """#include <stdint.h>
int32_t called(int32_t n, float x);
volatile int32_t kept;
int main(void);
int main(void)
{
    int32_t k;
    for (k = 0; k < 40; ++k) { kept = called(k % 13, (float)k * 0.37F - 3.0F); }
    return 0;
}
""",
}


@pytest.mark.thinned
@pytest.mark.parametrize("core", ["cortex-m0plus", "cortex-m4", "cortex-m7", "cortex-m33"])
def test_blocks_are_the_same_instructions_as_single_steps(core: Core, tmp_path: Path) -> None:
    """Loops, conditional instructions and routines of the library; every path and its cycles."""
    for name in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(name) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{name} is missing; CI needs it")
            pytest.skip(f"{name} is not installed")
    build({name: text.encode("ascii") for name, text in PROGRAM.items()}, (), core, tmp_path)
    emulate(core, tmp_path, *LOGGED, "-D", "blocks.log")
    emulate(core, tmp_path, "-singlestep", "-d", "exec,nochain", "-D", "steps.log")
    tool = program("arm-none-eabi-objdump")
    listing = execute([tool, "-d", "target.elf"], tool, tmp_path).stdout
    code, entry = parse_disassembly(listing), address_of(listing, "called")
    blocks, steps = (tmp_path / f"{name}.log" for name in ("blocks", "steps"))
    single = list(calls_of(traced_addresses([steps.read_bytes()]), entry, code))
    trace = executed_blocks([blocks.read_bytes()])
    paths = list(calls_in_blocks(trace, entry, code))
    whole = [tuple(at for number in path for at in trace.blocks[number]) for path in paths]
    assert len(single) == 40
    assert Counter(single).total() > len(Counter(single)) > 10
    assert whole == single
    instructions = [[code[at] for at in block if at in code] for block in trace.blocks]
    costs = list(cycles_of_paths(paths, instructions, core))
    assert costs == [(len(path), cycles([code[at] for at in path], core)) for path in single]
    assert steps.stat().st_size > 2 * blocks.stat().st_size
