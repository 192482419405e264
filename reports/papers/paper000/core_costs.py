"""Table 3 of paper 000 on every core: what each way from the torque to the currents costs.

Every function is compiled twice, without optimisation and with -O2, and run in single steps on the
emulated core; its instructions are counted, its cycles estimated. The paper measured an STM32F401,
a Cortex-M4F at 84 MHz.
"""

from __future__ import annotations

import os
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.mtpa import per_unit_base
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.paper000.ipmsm_tables import PRINTED_TABLE_1, PRINTED_TABLE_2
from dqforge.reports.verification.cross_tools import build, emulate, execute, program
from dqforge.reports.verification.cycle_model import (
    Instruction,
    address_of,
    cycles,
    parse_disassembly,
    traced_addresses,
)

CORES = ("cortex-m4", "cortex-m33", "cortex-m7", "cortex-m0plus")
CLOCK_MHZ = 84.0  # Of the paper's Cortex-M4F.

# Table 3 in us; ``powers`` are the polynomials without Horner's rule.
PRINTED_MICROSECONDS = {
    "direct": 0.43087,
    "morimoto": 19.31,
    "horner_2": 0.86175,
    "horner_3": 1.06,
    "horner_4": 1.24,
    "powers_2": 17.75,
    "powers_3": 242.15,
    "powers_4": 465.53,
}

_TORQUES = (30.0, 90.0, 150.0, 220.0)
_CHUNK = 1 << 22


@dataclass(frozen=True, slots=True)
class Cost:
    """Mean instructions, exact, and mean cycles (lo, hi) of a call, its return included."""

    instructions: float
    cycles: tuple[float, float]


@dataclass(frozen=True, slots=True)
class MethodCost:
    """A row of Table 3 on a core.

    ``plain`` is the build without optimisation and ``optimised`` the same source with -O2, both
    with the library's double precision where the paper must have used it; ``single`` the one with
    -O2 and single precision throughout. None where a build does not have it.
    """

    core: str
    method: str
    plain: Cost | None
    optimised: Cost | None
    single: Cost | None


@dataclass(frozen=True, slots=True)
class CoreCosts:
    """All rows, and by core why it has none."""

    rows: tuple[MethodCost, ...]
    left_out: dict[str, str]

    def microseconds(self, method: str, build: str) -> tuple[float, float]:
        """Time (lo, hi) in us of a method in a build (a field of `MethodCost`) on the paper's
        core.
        """
        row = next(row for row in self.rows if (row.core, row.method) == (CORES[0], method))
        cost = getattr(row, build)
        return cost.cycles[0] / CLOCK_MHZ, cost.cycles[1] / CLOCK_MHZ


def _functions() -> list[str]:
    polynomials = [
        f"{name}_{degree}"
        for name in ("horner", "powers_double", "powers_single")
        for degree in PRINTED_TABLE_1
    ]
    # the last takes codes
    return [
        "direct",
        "morimoto_double",
        "morimoto_single",
        *polynomials,
        "emitted",
        "emitted_q15",
    ]


def method_sources(
    machine: LinearMachine, headers: Mapping[str, bytes], prefix: str, fixed_prefix: str
) -> dict[str, bytes]:
    """C files of all functions and of the program that calls them.

    Args:
        machine: For bases and breakpoints.
        headers: The emitted headers of the printed polynomials and of a reference in Q15, by name.
        prefix, fixed_prefix: Their prefixes.
    """
    base = per_unit_base(machine)
    parts = [
        {
            "degree": degree,
            **{
                axis: {
                    "limit": PRINTED_TABLE_1[degree]["dq".index(axis)] * base.torque,
                    "rows": PRINTED_TABLE_2[axis, degree],
                }
                for axis in "dq"
            },
        }
        for degree in PRINTED_TABLE_1
    ]
    context = {
        "prefix": prefix,
        "fixed_prefix": fixed_prefix,
        "gain": 1.0 / machine.torque_per_ampere,
        "base": base.current,
        "polynomials": parts,
    }
    codes = [int(torque / _TORQUES[-1] * 16_000.0) for torque in _TORQUES]
    calls = {"names": _functions()[:-1], "torques": _TORQUES, "codes": codes}
    room = "papers/paper000"
    return {
        f"{prefix}.h": headers[f"{prefix}.h"],
        f"{fixed_prefix}.h": headers[f"{fixed_prefix}.h"],
        "methods.c": render(f"{room}/mtpa_methods.c.j2", context).encode("ascii"),
        "method_calls.c": render(f"{room}/method_calls.c.j2", calls).encode("ascii"),
    }


def calls_by_entry(
    addresses: Iterable[int], entries: Mapping[int, str], code: Mapping[int, Instruction]
) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Name of each called function and the addresses from its entry to its return, one after the
    other; functions do not call each other.
    """
    previous, back, name = 0, -1, ""
    path: list[int] = []
    for address in addresses:
        if path and address == back:
            yield name, tuple(path)
            path = []
        if path:
            path.append(address)
        elif address in entries and previous in code:
            back, name, path = previous + code[previous].size, entries[address], [address]
        previous = address


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk


def _measured(sources: Mapping[str, bytes], core: str, level: str) -> dict[str, Cost]:
    """Cost of every function on a core, compiled with a level of optimisation."""
    objdump = program("arm-none-eabi-objdump")
    with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
        folder = Path(name)
        build(sources, (level,), core, folder)
        emulate(core, folder, "-singlestep", "-d", "exec,nochain", "-D", "trace.log")
        listing = execute([objdump, "-d", "target.elf"], "arm-none-eabi-objdump", folder).stdout
        code = parse_disassembly(listing)
        entries = {address_of(listing, function): function for function in _functions()}
        addresses = traced_addresses(_chunks(folder / "trace.log"))
        paths: dict[str, Counter[tuple[int, ...]]] = defaultdict(Counter)
        for function, path in calls_by_entry(addresses, entries, code):
            paths[function][path] += 1
    if {found.total() for found in paths.values()} != {len(_TORQUES)}:
        raise VerificationError(f"the trace of the emulated {core} is not complete")
    return {function: _mean(found, code, core) for function, found in paths.items()}


def _mean(paths: Counter[tuple[int, ...]], code: Mapping[int, Instruction], core: str) -> Cost:
    weights = np.array(list(paths.values())) / paths.total()
    spans = np.array([cycles([code[address] for address in path], core) for path in paths])
    low, high = weights @ spans
    instructions = float(weights @ np.array([len(path) for path in paths]))
    return Cost(instructions, (float(low), float(high)))


def _rows(core: str, plain: dict[str, Cost], optimised: dict[str, Cost]) -> list[MethodCost]:
    rows = [
        MethodCost(core, "direct", plain["direct"], optimised["direct"], optimised["direct"]),
        MethodCost(
            core,
            "morimoto",
            plain["morimoto_double"],
            optimised["morimoto_double"],
            optimised["morimoto_single"],
        ),
    ]
    for degree in PRINTED_TABLE_1:
        name = f"horner_{degree}"
        rows.append(MethodCost(core, name, plain[name], optimised[name], optimised[name]))
    for degree in PRINTED_TABLE_1:
        double, single = f"powers_double_{degree}", f"powers_single_{degree}"
        rows.append(
            MethodCost(
                core, f"powers_{degree}", plain[double], optimised[double], optimised[single]
            )
        )
    emitted = (
        MethodCost(core, name, None, None, optimised[name]) for name in ("emitted", "emitted_q15")
    )
    return [*rows, *emitted]


def core_costs(
    machine: LinearMachine, headers: Mapping[str, bytes], prefix: str, fixed_prefix: str
) -> CoreCosts:
    """Costs on every core; what cannot be run is left out with its reason.

    Args:
        machine, headers, prefix, fixed_prefix: As `method_sources`.
    """
    sources = method_sources(machine, headers, prefix, fixed_prefix)
    jobs = [(core, level) for core in CORES for level in ("-O0", "-O2")]

    def measure(job: tuple[str, str]) -> dict[str, Cost] | str:
        try:
            return _measured(sources, *job)
        except VerificationError as error:
            return str(error)

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        found = dict(zip(jobs, pool.map(measure, jobs), strict=True))
    rows: list[MethodCost] = []
    left_out = {}
    for core in CORES:
        plain, optimised = found[core, "-O0"], found[core, "-O2"]
        if isinstance(plain, str) or isinstance(optimised, str):
            left_out[core] = plain if isinstance(plain, str) else str(optimised)
        else:
            rows += _rows(core, plain, optimised)
    return CoreCosts(tuple(rows), left_out)
