"""The main header of a design: its names, its dialects, its text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.current_reference.forms import (
    Emitted,
    FixedReference,
    FloatReference,
    SignedReference,
)
from dqforge.optimizer.solution import Solution
from dqforge.optimizer.steps.code_vectors import Coded
from dqforge.optimizer.steps.code_vectors import Dq as CodeDq
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq
from dqforge.reports.c_code.harness import Constant, ConstantGroup, title
from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.current_reference.plain import (
    from_plain,
    reference_context,
    reference_harness,
    to_plain,
    vectors_of,
)
from dqforge.reports.loops.figures import loop_constants
from dqforge.reports.observers.position_header import observer_constants
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.code_reader import Code, Word
from dqforge.reports.steps.code_text import SHIFTS_KEEP_SIGNS, code_reader, texts
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

# The evaluator of a current reference in C, written from its step.

# Names of the ends of the domain, by sign of the torque.
_ENDS = "limit.torque", "limit.torque_negative"
_INTO = "i_d_A", "i_q_A"


def evaluator(
    plain: Mapping[str, Any], names: Mapping[str, str], prefix: str, lines: Sequence[str]
) -> str:
    """The evaluator and what is said of it; in float32 with one for each sign of the torque where
    these differ.

    Args:
        plain: What `dqforge.reports.current_reference.plain.to_plain` says of the reference.
        names: Of the ends of its domain, by quantity, without prefix.
        prefix: Before the names of functions, in capitals before those of ends.
        lines: Of its comment.
    """
    reference = from_plain(plain)
    comment = ["/* Current references for a torque.", " *"]
    comment += [f" * {comment_text(line)}".rstrip() for line in lines] + [" */"]
    said = "\n".join(comment)
    if not isinstance(reference, FixedReference):
        return f"{said}\n{_in_floats(reference, names, prefix)}"
    end = f"{prefix.upper()}_{names['limit.torque_code']}"
    return f"{SHIFTS_KEEP_SIGNS}\n\n{said}\n{_in_codes(reference, end, prefix)}"


def _in_floats(reference: FloatReference, names: Mapping[str, str], prefix: str) -> str:
    functions = Functions()
    reader = StepReader(prefix, functions, Block("", set()))

    def write(name: str, step: Callable[..., Dq]) -> None:
        reader.write(name, step, [Expression("torque")], into=_INTO, names=["torque_Nm"])

    ends = [Expression(f"{prefix.upper()}_{names[end]}") for end in _ENDS if end in names]
    if isinstance(reference, SignedReference):
        signs = reference.steps(*ends)
        for step in signs:
            write(step.__name__, step)

        def current_reference(o: Arithmetic, torque: Reals) -> Dq:
            return reference.by_sign(o, torque, *signs)

    else:

        def current_reference(o: Arithmetic, torque: Reals) -> Dq:
            return reference.step(o, torque, ends[0])

    write("current_reference", current_reference)
    return "\n\n".join(functions.texts.values())


def _in_codes(reference: FixedReference, end: str, prefix: str) -> str:
    reader = code_reader(prefix, reference.width)

    def current_reference(o: Any, torque: Coded[Any]) -> Any:
        return CodeDq(*reference.step(o, torque, Word(end, kind="int32_t")))

    torque = Code("torque", kind=reader.pointed)
    reader.write("current_reference", current_reference, [torque], into=("i_d", "i_q"))
    return texts(reader)


# The main header of a design: its names, its dialects, its text.


def _loop(name: str, kp: str, ki: str) -> dict[str, str]:
    """Names of one controller; ``kp`` and ``ki`` are the units of its gains."""
    return {
        "kp": f"{name}_KP_{kp}",
        "ki": f"{name}_KI_{ki}",
        "ki_ts": f"{name}_KI_TS_{kp}",
        "t_i": f"{name}_T_I_S",
        "q0": f"{name}_Q0_{kp}",
        "q1": f"{name}_Q1_{kp}",
        "anti_windup": f"{name}_ANTI_WINDUP_PER_S",
        "kp_pu": f"{name}_KP_PU",
        "ki_ts_pu": f"{name}_KI_TS_PU",
        "kp_code": f"{name}_KP_PU_Q{{bits}}",
        "ki_ts_code": f"{name}_KI_TS_PU_Q{{bits}}",
    }


_LOOPS = {
    "i_d": _loop("ID", "V_PER_A", "V_PER_AS"),
    "i_q": _loop("IQ", "V_PER_A", "V_PER_AS"),
    "speed": _loop("SPEED", "NMS_PER_RAD", "NM_PER_RAD"),
}

# Names without prefix by quantity; ``bits`` are the fractional bits of a code.
NAMES = {
    "machine.pole_pairs": "POLE_PAIRS",
    "machine.r_s": "R_S_OHM",
    "machine.l_d": "L_D_H",
    "machine.l_q": "L_Q_H",
    "machine.psi_pm": "PSI_PM_WB",
    "limit.current": "CURRENT_MAX_A",
    "limit.torque": "TORQUE_MAX_NM",
    "limit.torque_code": "TORQUE_MAX_Q{bits}",
    "limit.torque_negative": "TORQUE_MAX_NEGATIVE_NM",
    "reference.speed": "REFERENCE_SPEED_RAD_PER_S",
    "reference.voltage": "REFERENCE_VOLTAGE_V",
    "base.current": "BASE_CURRENT_A",
    "base.voltage": "BASE_VOLTAGE_V",
    "base.speed": "BASE_SPEED_RAD_PER_S",
    "base.torque": "BASE_TORQUE_NM",
    "sampling.period": "T_S_S",
    "speed.ratio": "SPEED_RATIO",
    "observer.a": "OBSERVER_A",
    "observer.b_u": "OBSERVER_B_U_RAD_PER_VS",
    "observer.b_i": "OBSERVER_B_I_RAD_PER_AS",
    "observer.c": "OBSERVER_C_RAD_PER_AS",
    **{f"{loop}.{key}": name for loop, names in _LOOPS.items() for key, name in names.items()},
}


def neutral_entry(constant: Constant) -> Entry:
    """A constant in SI, with its unit in name and comment."""
    name = NAMES[constant.quantity].format(bits=constant.bits)
    words = ", ".join(part for part in (constant.meaning, constant.unit) if part)
    return Entry(name, constant.value, words + constant.note)


@dataclass(frozen=True, slots=True)
class Entry:
    """A constant as the header prints it: name without prefix, value and comment."""

    name: str
    value: float
    comment: str


@dataclass(frozen=True, slots=True)
class Dialect:
    """How one firmware writes the header.

    Args:
        name: Of the dialect.
        template: The header (``c_code/<file>``, or the path of a file). It sees the groups and
            prints the ``evaluator``.
        entry: A constant in its names and units; None where it has none of that kind. Names without
            the prefix, which the template puts before them; the ends of the torque domain
            (``limit.``) need one, because the evaluator compares with them.
    """

    name: str
    template: str
    entry: Callable[[Constant], Entry | None]


NEUTRAL = Dialect("neutral", "c_code/main_header.h.j2", neutral_entry)


# A dialect of the main header: the names and scales of one firmware, with a template.


def entries_of(dialect: Dialect, groups: Sequence[ConstantGroup]) -> list[PlainData]:
    """Groups as the template prints them, less constants that the dialect does not have."""
    return [
        {
            "title": group.title,
            "comment": group.comment,
            "entries": [
                entry for constant in group.constants if (entry := dialect.entry(constant))
            ],
        }
        for group in groups
    ]


def names_of(dialect: Dialect, groups: Sequence[ConstantGroup]) -> dict[str, str]:
    """Names by quantity: the evaluator asks for those of the ends of its domain."""
    found = [
        (constant, dialect.entry(constant)) for group in groups for constant in group.constants
    ]
    return {constant.quantity: entry.name for constant, entry in found if entry is not None}


# The main header and its test vectors: from a solution to text, through plain data only
# (docs/reference/header.md).

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
    names, reference = names_of(dialect, groups), reference_context(solution, plain)
    return {
        **title(design),
        "preamble": [
            _drive_text(design),
            "Units stand in the names and comments; angles in rad, dq quantities as peak of phase.",
            *_COMPILING["float32" if plain["format"] == "float32" else "fixed"],
            *(line for evidence in design.flux_evidence for line in evidence.short()),
        ],
        "groups": entries_of(dialect, groups),
        "reference": reference,
        "evaluator": evaluator(plain, names, design.export.prefix, reference["comment"]),
    }


def header_files(solution: Solution, dialect: Dialect = NEUTRAL) -> dict[str, bytes]:
    """Names and bytes of the emitted C files: the header and its test vectors.

    Args:
        solution: What was solved.
        dialect: Whose names the header takes.
    """
    text = render(dialect.template, header_context(solution, dialect))
    return reference_harness(solution.reference).files(solution.design, text, vectors_of(solution))


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
