"""The cross compiler and the emulator: programs built for an emulated
Cortex-M and run to their end.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.packages import WAYS
from dqforge.reports.pages.templating import render, resource

# Exit codes by which a program on a target says something; the emulator's own failures end with 1.
_COMPILER = "arm-none-eabi-gcc"
_EMULATOR = "qemu-system-arm"
_TIMEOUT_S = 60
PROGRAM_CODES = range(100, 120)


@dataclass(frozen=True, slots=True)
class Target:
    """A core with the board that emulates it: compiler flags, QEMU's machine,
    and where its memories lie.
    """

    flags: tuple[str, ...]
    machine: str
    flash: int = 0x0
    ram: int = 0x20000000
    ram_size: int = 64


TARGETS: dict[str, Target] = {
    "cortex-m0plus": Target(("-mcpu=cortex-m0plus", "-mfloat-abi=soft"), "microbit", ram_size=16),
    "cortex-m3": Target(("-mcpu=cortex-m3", "-mfloat-abi=soft"), "mps2-an385"),
    "cortex-m4": Target(("-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"), "mps2-an386"),
    "cortex-m7": Target(("-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "mps2-an500"),
    "cortex-m33": Target(
        ("-mcpu=cortex-m33", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"),
        "mps2-an505",
        0x10000000,
        0x38000000,
    ),
}


def target_of(name: str) -> Target:
    """The target of a name; raises `InputError` when there is none."""
    if name not in TARGETS:
        raise InputError(f"--target: expected one of {', '.join(TARGETS)}, got '{name}'")
    return TARGETS[name]


def core_named(text: str) -> str:
    """The name in `TARGETS` that a text says in another way: ``Cortex-M4F``, ``m7``, ``cortexm33``;
    else the text itself.
    """
    match = re.fullmatch(r"(?:cortex)?[-_ ]?(m\d+)([+]|plus)?f?", text.strip().casefold())
    name = "" if match is None else f"cortex-{match[1]}{'plus' if match[2] else ''}"
    return name if name in TARGETS else text


def program(name: str) -> str:
    """Path of a tool; raises `VerificationError` with the Debian package of one that is missing."""
    path = shutil.which(name)
    if path is None:
        packages = " and ".join(WAYS[name].apt)
        raise VerificationError(f"{name} is missing; install the Debian package {packages}")
    return path


def execute(command: list[str], what: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program to its end inside a folder."""
    try:
        return subprocess.run(
            command,
            cwd=folder,
            env=os.environ | {"LC_ALL": "C"},  # whose messages are searched for "error"
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(f"{what} cannot be started ({error.strerror})") from error


def require_library(target: str, folder: Path) -> None:
    """Raise `VerificationError` where the compiler has no C library for a target."""
    command = [program(_COMPILER), *TARGETS[target].flags, "-mthumb", "-print-file-name=libnosys.a"]
    found = execute(command, f"the compiler for {target}", folder).stdout.strip()
    if not Path(found).is_absolute():  # the bare name comes back for what is nowhere
        raise VerificationError(
            f"the C library of {_COMPILER} is missing; install the Debian package "
            "libnewlib-arm-none-eabi"
        )


def compile_files(arguments: list[str], target: str, folder: Path) -> None:
    """Run the compiler inside a folder with the flags of a target.

    Raises `VerificationError` with its first error.
    """
    # Without -fno-math-errno the compiler guards a square root by a call.
    common = [
        "-std=c99",
        "-O2",
        "-mthumb",
        "-ffp-contract=off",
        "-fno-math-errno",
        *TARGETS[target].flags,
    ]
    done = execute([program(_COMPILER), *common, *arguments], f"the compiler for {target}", folder)
    if done.returncode != 0:
        lines = done.stderr.splitlines()
        first = next((line for line in lines if "error" in line), "; ".join(lines)[:200])
        raise VerificationError(f"the headers do not compile for {target}: {first}")


def build(sources: Mapping[str, bytes], strict: tuple[str, ...], target: str, folder: Path) -> None:
    """Compile C files and link them with the start-up code to ``target.elf``.

    Args:
        sources: Contents of headers and of C files by name.
        strict: Flags for the C files, such as those that turn warnings into errors.
        target: One of `TARGETS`.
        folder: An empty folder, in which the object files stay.

    Raises:
        VerificationError: A tool is missing, or the files do not compile.
    """
    board = target_of(target)
    program(_EMULATOR)  # what is missing is said before anything is compiled
    require_library(target, folder)
    memory = {"flash": board.flash, "ram": board.ram, "ram_size": board.ram_size}
    start, script = resource("verification/start.c"), render("verification/target.ld.j2", memory)
    for name, text in (("target_start.c", start), ("target.ld", script)):
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    for name, content in sources.items():
        (folder / name).write_bytes(content)
    compile_files(["-c", "target_start.c"], target, folder)
    modules = [name for name in sources if name.endswith(".c")]
    for name in modules:
        compile_files([*strict, "-c", name], target, folder)
    objects = [f"{Path(name).stem}.o" for name in ("target_start.c", *modules)]
    compile_files(
        [
            "-nostartfiles",
            "-T",
            "target.ld",
            *objects,
            "-lm",
            "-lc",
            "-lgcc",
            "-lnosys",
            "-o",
            "target.elf",
        ],
        target,
        folder,
    )


def emulate(target: str, folder: Path, *options: str) -> int:
    """Run ``target.elf`` on its board and return the exit code of the program.

    Raises:
        VerificationError: The emulator failed (it ends with 1), or the program met a fault.
    """
    command = [
        program(_EMULATOR),
        "-M",
        TARGETS[target].machine,
        "-nographic",
        "-monitor",
        "none",
        "-serial",
        "none",
    ]
    command += [*options, "-semihosting-config", "enable=on,target=native", "-kernel", "target.elf"]
    done = execute(command, f"the emulated {target}", folder)
    if done.returncode not in (0, *PROGRAM_CODES):
        said = "".join(f": {line}" for line in done.stderr.splitlines()[:1])
        raise VerificationError(
            f"the emulated {target} stopped with exit code {done.returncode}{said}"
        )
    return done.returncode


# Estimated cycles of instructions that were really executed: a disassembly and a sequence
# of addresses to (lo, hi).
#
# Zero wait states; ``lo`` and ``hi`` enclose what the cited tables leave open,
# they are no bounds for a real memory.
#
# References:
#     cortex-m3
#         ARM DDI 0337I, 3.3.1 and 3.3.3: refill after a taken branch P = 1 to 3; LDR 2, directly
#         after another load 1; STR 1; load and store multiple 1 + N; MLA 2; long multiply 3 to 5,
#         with accumulate 4 to 7; divide 2 to 12; IT 0 where it is folded, else 1.
#     cortex-m4
#       ARM DDI 0439, 3.3.1, 3.3.3 and 7.2.3: as the M3, with every multiply 1; float add, multiply,
#         compare, convert 1; multiply-accumulate 3; divide and root 14; single load and store 2,
#         where the core may overlap neighbours (lo). A result that the next instruction consumes
#         costs one more cycle, unless it is the addend of a multiply-accumulate. A float moved from
#         or to a core register is 1 there; GCC's cortex-m4-fpu.md schedules it with 2, which is hi.
#     cortex-m0plus
#         ARM DDI 0484C, 3.3: ALU 1; MULS 1 (the single-cycle multiplier; the small one takes 32);
#         loads and stores 2; taken branch 2, BL 3; multiple 1 + N; POP to the PC 3 + N. No floating
#         point: its library routines are in the sequence.
#     cortex-m7
#       Arm publishes no table. It issues up to two instructions per cycle and predicts branches: lo
#       is half of the instructions plus the waits of divisions, roots and consumed results, hi the
#         sum of the M4. Inferred.
#     cortex-m33
#         Arm publishes no table (100230 has none); taken as the M4, whose pipeline is of the same
#         depth. Inferred.

_LINE = re.compile(r"^\s*([0-9a-f]+):\t([0-9a-f ]+)\t(\S+)(?:\t(.*))?$")
_TRACE = re.compile(rb"^(?:Trace .*?\[\w+/(\w+)/|(Stopped))", re.MULTILINE)
_REGISTER = re.compile(r"\b([sd])(\d+)\b")
_CONDITIONS = ("eq", "ne", "cs", "cc", "mi", "pl", "vs", "vc", "hi", "ls", "ge", "lt", "gt", "le")

_BRANCHES = {
    "b",
    "bx",
    "cbz",
    "cbnz",
    *(f"b{condition}" for condition in (*_CONDITIONS, "hs", "lo")),
}

_FLOAT_SLOW = ("vdiv.", "vsqrt.")
_FLOAT_MAC = ("vmla.", "vmls.", "vnmla.", "vnmls.", "vfma.", "vfms.", "vfnma.", "vfnms.")
_NO_RESULT = ("vcmp", "vstr", "vmrs", "vmsr", "vstm", "vpush")
Span = tuple[int, int]  # (lo, hi) in cycles.


@dataclass(frozen=True, slots=True)
class Instruction:
    """One line of a disassembly.

    ``size`` in bytes; ``mnemonic`` without width and without the condition that an IT block adds,
    which ``conditional`` keeps.
    """

    address: int
    size: int
    mnemonic: str
    operands: str
    conditional: bool = False


@dataclass(frozen=True, slots=True)
class CoreTiming:
    """What the tables of a core say, each as (lo, hi) in cycles; see the module for the sources.

    ``refill`` is added to a taken branch, ``call`` to BL and BLX;
    ``load_next`` is a load directly after a load.
    """

    refill: Span = (1, 3)
    call: Span = (1, 3)
    pop_pc: Span = (1, 3)
    load: Span = (2, 2)
    load_next: Span = (1, 1)
    store: Span = (1, 1)
    accumulate: Span = (1, 1)
    long: Span = (1, 1)
    long_accumulate: Span = (1, 1)
    divide: Span = (2, 12)
    folded: Span = (0, 1)
    float_load: Span = (2, 2)
    float_load_next: Span = (1, 2)
    float_store: Span = (1, 2)
    float_core: Span = (1, 2)
    float_accumulate: Span = (3, 3)
    float_divide: Span = (14, 14)
    dual_issue: bool = False


_M4 = CoreTiming()

CORES: dict[str, CoreTiming] = {
    "cortex-m0plus": CoreTiming(
        refill=(1, 1), call=(2, 2), pop_pc=(2, 2), load_next=(2, 2), store=(2, 2), folded=(1, 1)
    ),
    "cortex-m3": replace(_M4, accumulate=(2, 2), long=(3, 5), long_accumulate=(4, 7)),
    "cortex-m4": _M4,
    "cortex-m7": replace(_M4, dual_issue=True),
    "cortex-m33": _M4,
}


def parse_disassembly(text: str) -> dict[int, Instruction]:
    """Instructions by address from what ``arm-none-eabi-objdump -d`` prints.

    Data lines are left out.
    """
    instructions = {}
    conditional = 0
    for line in text.splitlines():
        match = _LINE.match(line)
        if match is None or match[3].startswith("."):
            continue
        mnemonic, operands = match[3], (match[4] or "").split("@")[0].strip()
        stem, *types = [part for part in mnemonic.split(".") if part not in ("n", "w")]
        in_block = conditional > 0
        if in_block:
            conditional -= 1
            stem = stem[:-2] if stem[-2:] in _CONDITIONS else stem
        if re.fullmatch("it[te]{0,3}", stem):
            conditional = len(stem) - 1
        address, size = int(match[1], 16), len(match[2].replace(" ", "")) // 2
        instructions[address] = Instruction(
            address, size, ".".join([stem, *types]), operands, in_block
        )
    return instructions


def address_of(text: str, symbol: str) -> int:
    """Address of a symbol in a disassembly; raises `ValueError` where it has none."""
    match = re.search(rf"^([0-9a-f]+) <{re.escape(symbol)}>:", text, re.MULTILINE)
    if match is None:
        raise ValueError(f"{symbol} is not in the disassembly")
    return int(match[1], 16)


def traced_addresses(chunks: Iterable[bytes]) -> Iterator[int]:
    """Addresses that QEMU logged with ``-singlestep -d exec,nochain``, from
    consecutive pieces of the log.

    A line that says that an instruction was stopped before it began takes back the line before it.
    """
    rest, last = b"", None
    for chunk in chunks:
        whole, _, rest = (rest + chunk).rpartition(b"\n")
        for match in _TRACE.finditer(whole):
            if last is not None and match[2] is None:
                yield last
            last = None if match[2] is not None else int(match[1], 16)
    if last is not None:
        yield last


def calls_of(
    addresses: Iterable[int], entry: int, code: dict[int, Instruction]
) -> Iterator[tuple[int, ...]]:
    """Addresses executed from each call of a function to its return, both included.

    The call itself is left out.
    """
    previous, back, path = 0, -1, list[int]()
    for address in addresses:
        if path and address == back:
            yield tuple(path)
            path = []
        if path:
            path.append(address)
        elif address == entry and previous in code:
            back, path = previous + code[previous].size, [address]
        previous = address


def _registers(operands: str) -> set[int]:
    """Single-precision registers in operands; a double register is two of them."""
    found = set()
    for kind, number in _REGISTER.findall(operands):
        index = int(number)
        found |= {index} if kind == "s" else {2 * index, 2 * index + 1}
    return found


def _float_result(instruction: Instruction) -> set[int]:
    """Registers into which a float operation puts its result; loads and moves are no operations."""
    name = instruction.mnemonic
    if not name.startswith("v") or name.startswith((*_NO_RESULT, "vldr", "vldm", "vpop", "vmov")):
        return set()
    return _registers(instruction.operands.split(",")[0])


def _consumed(instruction: Instruction) -> set[int]:
    """Float registers that an instruction needs at its start."""
    name, operands = instruction.mnemonic, instruction.operands
    if not name.startswith("v"):
        return set()
    if name.startswith(_NO_RESULT):
        return _registers(operands)
    return _registers(operands.partition(",")[2])


def _listed(operands: str) -> int:
    """Number of registers in a list such as ``{r4, r5, lr}``, where objdump
    writes ranges with a hyphen.
    """
    count = 0
    for part in operands[operands.index("{") + 1 : operands.index("}")].split(","):
        first, _, last = part.strip().partition("-")
        count += 1 + (int(last[1:]) - int(first[1:]) if last else 0)
    return count


def _is_load(instruction: Instruction | None, prefix: str) -> bool:
    return instruction is not None and instruction.mnemonic.startswith(prefix)


def _memory_span(
    instruction: Instruction, previous: Instruction | None, core: CoreTiming
) -> Span | None:
    """Cycles of a load or a store, None for any other instruction."""
    name, operands = instruction.mnemonic, instruction.operands
    single = {
        "vldr": core.float_load_next if _is_load(previous, "vldr") else core.float_load,
        "vstr": core.float_store,
    }
    if name.split(".")[0] in single and "d" not in operands.split(",")[0]:
        return single[name.split(".")[0]]
    if name.startswith(("vldr", "vstr", "ldrd", "strd")):
        return (3, 3)
    if "{" in operands and name.startswith(
        ("push", "pop", "ldm", "stm", "vpush", "vpop", "vldm", "vstm")
    ):
        count = 1 + _listed(operands)
        return (count, count)
    if name.startswith("ldr"):
        return core.load_next if _is_load(previous, "ldr") else core.load
    return core.store if name.startswith("str") else None


def _span(instruction: Instruction, previous: Instruction | None, core: CoreTiming) -> Span:
    """Cycles of an instruction by itself, the refill of a taken branch left out."""
    name = instruction.mnemonic
    memory = _memory_span(instruction, previous, core)
    if memory is not None:
        return memory
    if name.startswith("v"):
        if name.startswith(_FLOAT_SLOW):
            return core.float_divide
        if name.startswith(_FLOAT_MAC):
            return core.float_accumulate
        moves_core = name == "vmov" and bool(
            re.search(r"\b(r\d+|ip|sl|fp|lr)\b", instruction.operands)
        )
        return core.float_core if moves_core else (1, 1)
    table = {
        "mla": core.accumulate,
        "mls": core.accumulate,
        "umull": core.long,
        "smull": core.long,
        "umlal": core.long_accumulate,
        "smlal": core.long_accumulate,
        "sdiv": core.divide,
        "udiv": core.divide,
    }
    return core.folded if re.fullmatch("it[te]{0,3}", name) else table.get(name, (1, 1))


def _refill(instruction: Instruction, core: CoreTiming) -> Span:
    """What leaving the straight line costs beyond the instruction itself."""
    if instruction.mnemonic in ("bl", "blx"):
        return core.call
    if instruction.mnemonic.startswith(("pop", "ldm")):
        return core.pop_pc
    return core.refill


def _waits(instruction: Instruction, following: Instruction | None) -> int:
    """One cycle where the next instruction consumes a float result."""
    return 0 if following is None else int(bool(_float_result(instruction) & _consumed(following)))


@cache
def _step(
    previous: Instruction | None,
    instruction: Instruction,
    following: Instruction | None,
    core_name: str,
) -> tuple[int, int, int]:
    """(lo, hi) of an instruction between its neighbours, and those cycles of it that
    no second issue can hide.
    """
    core = CORES[core_name]
    least, most = _span(instruction, previous, core)
    if instruction.conditional:
        least = min(least, 1)  # its condition may not have held
    if following is None or following.address != instruction.address + instruction.size:
        refill = _refill(instruction, core)
        least, most = least + refill[0], most + refill[1]
    wait = _waits(instruction, following)
    slow = core.float_divide[0] - 1 if instruction.mnemonic.startswith(_FLOAT_SLOW) else 0
    return least + wait, most + wait, slow + wait


def summed(
    before: Instruction | None,
    sequence: Sequence[Instruction],
    after: Instruction | None,
    core_name: str,
) -> tuple[int, int, int]:
    """Sums over a sequence between its neighbours: (lo, hi), and what no second issue can hide.

    Args:
        before, sequence, after: What was executed; ``before`` and ``after`` are not summed, and
            None where nothing was.
        core_name: One of `CORES`.
    """
    neighbours = [before, *sequence, after]
    steps = [
        _step(previous, instruction, following, core_name)
        for previous, instruction, following in zip(
            neighbours[:-2], sequence, neighbours[2:], strict=True
        )
    ]
    return sum(a for a, _, _ in steps), sum(b for _, b, _ in steps), sum(c for _, _, c in steps)


def whole_span(count: int, sums: tuple[int, int, int], core_name: str) -> Span:
    """(lo, hi) of ``count`` instructions from what `summed` gives for all of them."""
    low, high, slow = sums
    return ((count + 1) // 2 + slow if CORES[core_name].dual_issue else low), high


def cycles(sequence: Sequence[Instruction], core_name: str) -> Span:
    """Estimated cycles of instructions in the order of their execution.

    Args:
        sequence: What was executed, up to the return; an instruction that is not followed by its
            neighbour in memory was a taken branch, and the last one is. Conditional instructions
            are in it whether or not their condition held.
        core_name: One of `CORES`.

    Returns:
        (lo, hi) in cycles.
    """
    return whole_span(len(sequence), summed(None, sequence, None, core_name), core_name)


# Which instructions a program executed on QEMU, from a log of whole blocks.
#
# QEMU translates straight lines of code, each up to its branch, and logs a line whenever it runs
# one. A log of blocks is at most a fifth of one of single steps and holds the same instructions:
# what a block consists of is logged once, when it is translated.

LOGGED = ("-d", "in_asm,exec,nochain")  # Options by which QEMU writes the log.

_BLOCK_TRACE_LINE = re.compile(
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
        yield from _BLOCK_TRACE_LINE.finditer(whole)


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
