"""Figure 5 of paper 000: the drive holds 300 rad/s while the load grows, by three alternatives,
emitted C in the loop.

Load 30 N m from the start, a ramp to 90 N m from 1.5 s to 2.5 s, a step to 130 N m at 4 s; 6 s in
all. The paper states neither inertia nor speed controller: those of the shipped drive are inferred,
so that transients are ours and steady currents the paper's.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.names import ModulationName, Strategy
from dqforge.machines.plants.scenario import Profile, Scenario
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.mtpa_locus import per_unit_base
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.paper000_stated_method import PRINTED_TABLE_1, PRINTED_TABLE_2
from dqforge.reports.papers.transients import bench
from dqforge.reports.simulation.recorded_run import Simulation
from dqforge.reports.verification.cross_tools import (
    LOGGED,
    Instruction,
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

DESIGN_NAME = "paper000-ipmsm-100kw"


ALTERNATIVES: tuple[tuple[str, Strategy, ModulationName], ...] = (
    ("i_d = 0, SPWM", "id0", "spwm"),
    ("MTPA, SPWM", "mtpa", "spwm"),
    ("MTPA, DPWM", "mtpa", "ddt-gdpwm"),
)


SPEED = 300.0


LOAD = Profile((0.0, 1.5, 2.5, 3.999_99, 4.0), (30.0, 30.0, 90.0, 90.0, 130.0), "linear")


_DURATION = 6.0


_STRIDE = 100


@dataclass(frozen=True, slots=True, eq=False)
class LoadTest:
    """One alternative: the run, and its figures.

    ``deviation`` in rad/s is the largest of the speed after the start, ``end_error`` in rad/s that
    of the last 0.1 s; ``current`` in A (peak) is the mean magnitude of the currents between 5.9 and
    6 s, ``expected`` the one that the strategy's equation gives for the mean torque there.
    """

    name: str
    run: Simulation
    deviation: float
    end_error: float
    torque: float
    current: float
    expected: float


def _test(name: str, strategy: Strategy, modulation: ModulationName) -> LoadTest:
    loaded = catalogue.load(DESIGN_NAME)
    operation = replace(loaded.operation, strategy=strategy, modulation=modulation)
    # The largest torque that each strategy has: i_d = 0 does not make the 200 N m that the
    # shipped drive is fitted to.
    fit = replace(loaded.fit, torque_max=None)
    design = replace(loaded, operation=operation, fit=fit, losses=None, weakening=None)
    with bench(design) as place:
        found = place.run(
            Scenario(_DURATION, "speed", Profile((0.0,), (SPEED,)), load=LOAD), stride=_STRIDE
        )
    settled, last = found.t >= 1.0, found.t >= 5.9
    away = np.abs(found.omega_m - SPEED)
    torque = float(np.mean(found.torque[last]))
    machine = design.machine
    return LoadTest(
        name=name,
        run=found,
        deviation=float(np.max(away[settled])),
        end_error=float(np.max(away[last])),
        torque=torque,
        current=float(np.mean(np.hypot(found.i_d[last], found.i_q[last]))),
        expected=_expected(
            machine.torque_per_ampere, machine.saliency, machine.psi_pm, torque, strategy
        ),
    )


def _expected(
    per_ampere: float, saliency: float, psi_pm: float, torque: float, strategy: Strategy
) -> float:
    """Magnitude of the current in A: (4) of the paper, or its quartic for
    the MTPA by Newton's method.
    """
    if strategy == "id0":
        return torque / per_ampere
    base = psi_pm / (2.0 * saliency)
    asked = torque / (0.5 * per_ampere * base)
    d = -0.1
    for _ in range(60):
        d -= (d * (2.0 - d) ** 3 + asked**2) / ((2.0 - d) ** 3 - 3.0 * d * (2.0 - d) ** 2)
    return float(base * np.hypot(d, asked / (2.0 - d)))


def load_tests() -> tuple[LoadTest, ...]:
    """All three alternatives.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    return tuple(_test(*alternative) for alternative in ALTERNATIVES)


# Table 3 of paper 000 on every core: what each way from the torque to the currents costs.
#
# Every function is compiled twice, without optimisation and with -O2, and run on the emulated core;
# its instructions are counted, its cycles estimated. The paper measured an
# STM32F401, a Cortex-M4F at 84 MHz.

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


def _chunks(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk


def _measured(sources: Mapping[str, bytes], core: str, level: str) -> dict[str, Cost]:
    """Cost of every function on a core, compiled with a level of optimisation."""
    objdump = program("arm-none-eabi-objdump")
    with scratch_folder() as folder:
        build(sources, (level,), core, folder)
        emulate(core, folder, *LOGGED, "-D", "trace.log")
        listing = execute([objdump, "-d", "target.elf"], "arm-none-eabi-objdump", folder).stdout
        trace = executed_blocks(_chunks(folder / "trace.log"))
    code = parse_disassembly(listing)
    blocks = [[code[at] for at in block if at in code] for block in trace.blocks]
    found = {}
    for function in _functions():
        paths = Counter(calls_in_blocks(trace, address_of(listing, function), code))
        if paths.total() != len(_TORQUES):
            raise VerificationError(f"the trace of the emulated {core} is not complete")
        found[function] = _mean(paths, blocks, core)
    return found


def _mean(
    paths: Counter[tuple[int, ...]], blocks: Sequence[Sequence[Instruction]], core: str
) -> Cost:
    weights = np.array(list(paths.values())) / paths.total()
    counts, spans = zip(*cycles_of_paths(paths, blocks, core), strict=True)
    low, high = weights @ np.array(spans)
    return Cost(float(weights @ np.array(counts)), (float(low), float(high)))


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
