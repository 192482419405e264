"""Which instructions a program executed on QEMU, from a log of whole blocks.

QEMU translates straight lines of code, each up to its branch, and logs a line whenever it runs one.
A log of blocks is at most a fifth of one of single steps and holds the same instructions: what a
block consists of is logged once, when it is translated.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.verification.cycle_model import (
    Instruction,
    Span,
    summed,
    whole_span,
)

LOGGED = ("-d", "in_asm,exec,nochain")  # Options by which QEMU writes the log.

_LINE = re.compile(
    rb"^(?:Trace [^\[\n]*?(?P<block>0x\w+) \[|(?P<stopped>Stopped)|(?P<translated>IN:)"
    rb"|0x(?P<address>\w+):|(?P<bytes>OBJD))",
    re.MULTILINE,
)


@dataclass(frozen=True, slots=True)
class BlockTrace:
    """Blocks that were executed.

    ``blocks`` holds the addresses of each block's instructions, ``order`` which of the blocks were
    executed, one after the other.
    """

    blocks: tuple[tuple[int, ...], ...]
    order: tuple[int, ...]


def _lines(chunks: Iterable[bytes]) -> Iterator[re.Match[bytes]]:
    rest = b""
    for chunk in chunks:
        whole, _, rest = (rest + chunk).rpartition(b"\n")
        yield from _LINE.finditer(whole)


def executed_blocks(chunks: Iterable[bytes]) -> BlockTrace:
    """The blocks of a log in consecutive pieces.

    A line that says that a block was stopped before it began takes back the line before it.

    Raises:
        VerificationError: The emulator was built without a disassembler, which splits blocks into
            instructions.
    """
    numbers: dict[tuple[int, ...], int] = {}
    known: dict[bytes, int] = {}
    order: list[int] = []
    translated: list[int] = []
    for match in _lines(chunks):
        kind = match.lastgroup
        if kind == "block":
            block = match["block"]
            if translated:
                known[block] = numbers.setdefault(tuple(translated), len(numbers))
                translated = []
            order.append(known[block])
        elif kind == "address":
            translated.append(int(match["address"], 16))
        elif kind == "translated":
            translated = []
        elif kind == "stopped":
            order.pop()
        else:
            raise VerificationError(
                "qemu-system-arm lists no instructions; use one that was built with capstone"
            )
    return BlockTrace(tuple(numbers), tuple(order))


def calls_in_blocks(
    trace: BlockTrace, entry: int, code: Mapping[int, Instruction]
) -> Iterator[tuple[int, ...]]:
    """Blocks executed from each call of a function to its return, both included.

    The call itself is left out.

    Args:
        trace: What was executed.
        entry: Address of the function.
        code: Instructions by address.
    """
    first = [block[0] for block in trace.blocks]
    after = [
        block[-1] + code[block[-1]].size if block[-1] in code else -1 for block in trace.blocks
    ]
    previous, back, path = -1, -1, list[int]()
    for number in trace.order:
        at = first[number]
        if path and at == back:
            yield tuple(path)
            path = []
        if path:
            path.append(number)
        elif at == entry and previous >= 0:
            back, path = after[previous], [number]
        previous = number


def cycles_of_paths(
    paths: Iterable[Sequence[int]], blocks: Sequence[Sequence[Instruction]], core_name: str
) -> Iterator[tuple[int, Span]]:
    """Number of instructions and estimated cycles of each path through blocks.

    The same as `cycle_model.cycles` of all its instructions; a block between the same two others
    is summed once.

    Args:
        paths: Numbers of the blocks in the order of their execution.
        blocks: Instructions of each block.
        core_name: One of `cycle_model.CORES`.
    """
    known: dict[tuple[int, int, int], tuple[int, int, int]] = {}
    for path in paths:
        keys = list(zip((-1, *path[:-1]), path, (*path[1:], -1), strict=True))
        for key in keys:
            if key not in known:
                before, block, after = key
                known[key] = summed(
                    blocks[before][-1] if before >= 0 else None,
                    blocks[block],
                    blocks[after][0] if after >= 0 else None,
                    core_name,
                )
        low, high, slow = (sum(part) for part in zip(*(known[key] for key in keys), strict=True))
        count = sum(len(blocks[block]) for block in path)
        yield count, whole_span(count, (low, high, slow), core_name)
