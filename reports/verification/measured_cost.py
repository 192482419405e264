"""What an evaluator costs on an emulated Cortex-M: instructions that it really executes,
estimated cycles, bytes.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import VerificationError
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.cross_tools import build, emulate, execute, program
from dqforge.reports.verification.cycle_model import (
    Span,
    address_of,
    calls_of,
    cycles,
    parse_disassembly,
    traced_addresses,
)
from dqforge.reports.verification.host import WARNINGS

_CHUNK = 1 << 24


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


def cost_on_target(
    sources: Mapping[str, bytes], header: str, function: str, target: str, torques: NDArray[Any]
) -> TargetCost:
    """Compile an evaluator for a target, run it in single steps on the emulation,
    and sum what it executed.

    Parameters
    ----------
    sources:
        Contents of the headers, and of C files that belong to them, by name.
    header:
        The one of them that declares the evaluator.
    function:
        Its name; ``void function(number torque, number *i_d, number *i_q)`` with the
        number type of ``torques``.
    target:
        One of `target_tools.TARGETS`.
    torques:
        Float32 torques in N m, or int16 or int32 codes of them, shape (N,), N >= 1.

    Raises
    ------
    InputError
        There is no such target.
    VerificationError
        A tool is missing (its Debian package is named), the files do not compile,
        or the emulation failed.
    """
    objdump, sizer = program("arm-none-eabi-objdump"), program("arm-none-eabi-size")
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
    with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
        folder = Path(name)
        build(
            {**sources, **{key: text.encode("ascii") for key, text in made.items()}},
            WARNINGS,
            target,
            folder,
        )
        emulate(target, folder, "-singlestep", "-d", "exec,nochain", "-D", "trace.log")
        listing = execute([objdump, "-d", "target.elf"], "arm-none-eabi-objdump", folder).stdout
        modules = [
            f"{Path(key).stem}.o" for key in (*sources, "target_evaluator.c") if key.endswith(".c")
        ]
        sizes = execute([sizer, *modules], "arm-none-eabi-size", folder).stdout.splitlines()[1:]
        code = parse_disassembly(listing)
        addresses = traced_addresses(_chunks(folder / "trace.log"))
        paths = Counter(calls_of(addresses, address_of(listing, "evaluator"), code))
        currents = np.fromfile(
            folder / "currents.bin", dtype=torques.dtype.newbyteorder("<")
        ).reshape(-1, 2)
    if paths.total() != len(torques) or len(currents) != len(torques):
        raise VerificationError(f"the trace of the emulated {target} is not complete")
    spans = np.array([cycles([code[address] for address in path], target) for path in paths])
    weights = np.array(list(paths.values())) / paths.total()
    mean = weights @ spans
    return TargetCost(
        instructions=float(weights @ np.array([len(path) for path in paths])),
        cycles=(float(mean[0]), float(mean[1])),
        cycles_largest=(int(spans[:, 0].max()), int(spans[:, 1].max())),
        flash=sum(int(line.split()[0]) for line in sizes),
        currents=currents,
    )
