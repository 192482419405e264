"""The main header and its test vectors: from a solution to text,
through plain data only (docs/reference/header.md).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.current_reference.forms import Emitted, FixedReference, SignedReference
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import Constant, ConstantGroup, title
from dqforge.reports.current_reference.plain import (
    reference_context,
    to_plain,
    vectors_context,
    vectors_template,
)
from dqforge.reports.loops.figures import loop_constants
from dqforge.reports.main_header.dialect import Dialect, entries_of, names_of
from dqforge.reports.main_header.dialects.neutral.names import NEUTRAL
from dqforge.reports.observers.tracker_header import observer_constants
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

_COMPILING = {
    "float32": (
        (
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
            "errors hold either way."
        ),
        "Plain C99 and C++11; fabsf and sqrtf are the only library functions that may be used.",
    ),
    "fixed": (
        (
            "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign "
            "(checked below)."
        ),
        "No overflow for any torque: proven by interval analysis of every product, sum and result.",
    ),
}


def _drive_text(design: Design) -> str:
    return (
        f"{design.machine.pole_pairs} pole pairs, {design.inverter.v_dc:.6g} V dc link, "
        f"{design.i_max:.6g} A (peak), control sampled every {design.control.t_s * 1e6:.6g} us."
    )


def header_context(solution: Solution, dialect: Dialect = NEUTRAL) -> PlainData:
    """Everything that the header prints, as plain data.

    The `reference` entry alone rebuilds the evaluator's float32 model (`from_plain`).
    """
    design = solution.design
    plain, groups = to_plain(solution.reference), constant_groups(solution)
    return {
        **title(design),
        "preamble": [
            _drive_text(design),
            "Units stand in the names and comments; angles in rad, dq quantities as peak of phase.",
            *_COMPILING["float32" if plain["format"] == "float32" else "fixed"],
            *(line for evidence in design.flux_evidence for line in evidence.short()),
        ],
        "groups": entries_of(dialect, groups),
        "names": names_of(dialect, groups),
        "reference": reference_context(solution, plain),
    }


def header_files(solution: Solution, dialect: Dialect = NEUTRAL) -> dict[str, bytes]:
    """Names and bytes of the emitted C files: the header and its test vectors.

    Args:
        solution: What was solved.
        dialect: Whose names the header takes.
    """
    prefix = solution.design.export.prefix
    contents: dict[str, Any] = {
        f"{prefix}.h": render(dialect.template, header_context(solution, dialect)),
        f"{prefix}_vectors.h": render(
            vectors_template(solution.reference), vectors_context(solution)
        ),
    }
    return {name: text.encode("ascii") for name, text in contents.items()}


# Constants of machine, torque domain and bases for the main header.


def machine_constants(solution: Solution) -> list[ConstantGroup]:
    """Machine, current limit and the ends of the torque domain."""
    machine = solution.design.machine
    rest = "" if isinstance(machine, LinearMachine) else "; at zero current, the machine saturates"
    to_q = f"{rest}; decoupling v_q += omega_e (L_D i_d + PSI_PM)"
    to_d = f"{rest}; decoupling v_d -= omega_e L_Q i_q"
    constants = (
        Constant("machine.pole_pairs", machine.pole_pairs, "", "number of pole pairs"),
        Constant("machine.r_s", machine.r_s, "Ohm", "phase resistance"),
        Constant("machine.l_d", machine.l_d, "H", "d-axis inductance", to_q),
        Constant("machine.l_q", machine.l_q, "H", "q-axis inductance", to_d),
        Constant("machine.psi_pm", machine.psi_pm, "Wb", "magnet flux linkage", " (peak)"),
        Constant("limit.current", solution.design.i_max, "A", "current limit", " (peak)"),
        *_torque_limits(solution.reference),
    )
    title = "Machine (dq quantities are amplitude-invariant: peak of phase)"
    return [ConstantGroup(title, constants)]


def _torque_limits(reference: Emitted) -> list[Constant]:
    """End of the torque domain, and its code in fixed point.

    Both ends where the signs of the torque differ.
    """
    if isinstance(reference, SignedReference):
        end = shortest(reference.negative.torque_max)
        words = "magnitude of its end for negative torques"
        below = Constant("limit.torque_negative", end, "N m", words)
        return [*_torque_limits(reference.positive), below]
    words = "end of the torque domain"
    if not isinstance(reference, FixedReference):
        return [Constant("limit.torque", shortest(reference.torque_max), "N m", words)]
    bits = reference.width - 1
    code = f"the same over BASE_TORQUE_NM, times 2^{bits}"
    return [
        Constant("limit.torque", reference.torque_max, "N m", words),
        Constant("limit.torque_code", reference.end, "", code, base="base.torque", bits=bits),
    ]


def operation_constants(solution: Solution) -> list[ConstantGroup]:
    """The speed for which the references weaken the field, where there is one."""
    speed = solution.fit.speed
    if speed is None:
        return []
    words = "phase amplitude that is not exceeded there"
    return [
        ConstantGroup(
            "The one speed for which the current references hold",
            (
                Constant("reference.speed", speed.omega_m, "rad/s", "mechanical speed"),
                Constant("reference.voltage", speed.v_max, "V", words),
            ),
            (
                (
                    "Below it they keep the voltage limit with current to spare, above it they "
                    "exceed the limit."
                ),
            ),
        )
    ]


def base_constants(solution: Solution) -> list[ConstantGroup]:
    """Bases of what is per unit."""
    bases = solution.design.control.bases
    return [
        ConstantGroup(
            "Bases of the per-unit gains",
            (
                Constant("base.current", bases.current, "A"),
                Constant("base.voltage", bases.voltage, "V"),
                Constant("base.speed", bases.speed, "rad/s", "mechanical speed"),
                Constant("base.torque", bases.torque, "N m"),
            ),
        )
    ]


# What the main header offers to every dialect: groups of constants, in their order.

GROUPS: tuple[Callable[[Solution], list[ConstantGroup]], ...] = (
    machine_constants,
    operation_constants,
    base_constants,
    loop_constants,
    observer_constants,
)


def constant_groups(solution: Solution) -> list[ConstantGroup]:
    """All groups that a solution has."""
    return [group for groups in GROUPS for group in groups(solution)]


# All dialects of the main header.

DIALECTS = {dialect.name: dialect for dialect in (NEUTRAL,)}
