"""What an evaluator, or any called function, costs on an emulated Cortex-M: instructions that it
really executes, estimated cycles, bytes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.cross_tools import (
    LOGGED,
    Span,
    address_of,
    build,
    calls_in_blocks,
    cycles_of_paths,
    emulate,
    execute,
    executed_blocks,
    parse_disassembly,
    program,
)
from dqforge.reports.verification.host import WARNINGS

_CHUNK = 1 << 24

_RESULTS = "currents.bin"


@dataclass(frozen=True, slots=True)
class CallCost:
    """Cost of a called function over all calls of a program, the return included.

    The call itself is left out. ``instructions`` is the mean number executed and
    ``instructions_largest`` the largest, both exact; ``cycles`` the mean (lo, hi) of `cycle_model`
    and ``cycles_largest`` the largest lo and the largest hi of one call; ``flash`` the bytes of the
    files that were sized, with their constants, without library routines.
    """

    calls: int
    instructions: float
    instructions_largest: int
    cycles: tuple[float, float]
    cycles_largest: Span
    flash: int


@dataclass(frozen=True, slots=True)
class TargetCost:
    """Cost of an evaluator as a called function: arguments in registers, both currents stored,
    the return included.

    The call itself and the loop around it are left out. ``instructions`` is the mean number
    executed, exact; ``cycles`` the mean (lo, hi) of `cycle_model` and ``cycles_largest`` the
    largest lo and the largest hi of one evaluation; ``flash`` the bytes of the function with its
    constants, without library routines. ``currents`` are the results in A or in codes, shape (N,
    2).
    """

    instructions: float
    cycles: tuple[float, float]
    cycles_largest: Span
    flash: int
    currents: NDArray[Any]


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk


def _traced_calls(
    sources: Mapping[str, bytes],
    function: str,
    target: str,
    flags: Sequence[str],
    sized: Sequence[str],
    folder: Path,
) -> CallCost:
    """As `cost_of_calls`, in a folder that keeps what the program wrote."""
    objdump, sizer = program("arm-none-eabi-objdump"), program("arm-none-eabi-size")
    build(sources, (*WARNINGS, *flags), target, folder)
    emulate(target, folder, *LOGGED, "-D", "trace.log")
    listing = execute([objdump, "-d", "target.elf"], "arm-none-eabi-objdump", folder).stdout
    modules = [f"{Path(name).stem}.o" for name in sized]
    sizes = execute([sizer, *modules], "arm-none-eabi-size", folder).stdout.splitlines()[1:]
    code = parse_disassembly(listing)
    trace = executed_blocks(_chunks(folder / "trace.log"))
    paths = Counter(calls_in_blocks(trace, address_of(listing, function), code))
    if not paths:
        raise VerificationError(f"the program for the emulated {target} never calls {function}")
    used = {number for path in paths for number in path}
    blocks = [
        [code[address] for address in block] if number in used else []
        for number, block in enumerate(trace.blocks)
    ]
    found = list(cycles_of_paths(paths, blocks, target))
    lengths, spans = np.array([count for count, _ in found]), np.array([span for _, span in found])
    weights = np.array(list(paths.values())) / paths.total()
    mean = weights @ spans
    return CallCost(
        calls=paths.total(),
        instructions=float(weights @ lengths),
        instructions_largest=int(lengths.max()),
        cycles=(float(mean[0]), float(mean[1])),
        cycles_largest=(int(spans[:, 0].max()), int(spans[:, 1].max())),
        flash=sum(int(line.split()[0]) for line in sizes),
    )


def cost_of_calls(
    sources: Mapping[str, bytes],
    function: str,
    target: str,
    sized: Sequence[str],
    flags: Sequence[str] = (),
) -> CallCost:
    """Compile a program for a target, run it on the emulation, and sum what the calls of one of
    its functions executed.

    Args:
        sources: Contents of C files, one of them with ``main``, and of headers by name.
        function: A function with a symbol of its own: it is called from another file.
        target: One of `target_tools.TARGETS`.
        sized: The C files whose bytes count.
        flags: Further flags of the compiler.

    Raises:
        InputError: There is no such target.
        VerificationError: A tool is missing (its Debian package is named), the files do not
            compile, the emulation failed, or the function was never called.
    """
    with scratch_folder() as folder:
        return _traced_calls(sources, function, target, flags, sized, folder)


def cost_on_target(
    sources: Mapping[str, bytes], header: str, function: str, target: str, torques: NDArray[Any]
) -> TargetCost:
    """Compile an evaluator for a target, run it on the emulation, and sum what it executed.

    Args:
        sources: Contents of the headers, and of C files that belong to them, by name.
        header: The one of them that declares the evaluator.
        function: Its name; ``void function(number torque, number *i_d, number *i_q)`` with the
            number type of ``torques``.
        target: One of `target_tools.TARGETS`.
        torques: Float32 torques in N m, or int16 or int32 codes of them, shape (N,), N >= 1.

    Raises:
        InputError: There is no such target.
        VerificationError: A tool is missing (its Debian package is named), the files do not
            compile, or the emulation failed.
    """
    bits = f"uint{8 * torques.itemsize}_t"
    number = "float" if torques.dtype == np.float32 else bits[1:]
    words = torques.view(f"u{torques.itemsize}").tolist()
    made = {
        "target_calls.c": render(
            "verification/calls.c.j2", {"words": words, "bits": bits, "number": number}
        ),
        "target_evaluator.c": render(
            "verification/evaluator.c.j2",
            {"header": header, "function": function, "number": number},
        ),
    }
    files = {**sources, **{key: text.encode("ascii") for key, text in made.items()}}
    sized = [name for name in (*sources, "target_evaluator.c") if name.endswith(".c")]
    with scratch_folder() as folder:
        cost = _traced_calls(files, "evaluator", target, (), sized, folder)
        currents = np.fromfile(folder / _RESULTS, dtype=torques.dtype.newbyteorder("<")).reshape(
            -1, 2
        )
    if cost.calls != len(torques) or len(currents) != len(torques):
        raise VerificationError(f"the trace of the emulated {target} is not complete")
    return TargetCost(cost.instructions, cost.cycles, cost.cycles_largest, cost.flash, currents)
