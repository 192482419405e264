"""The C header of the control of phase machines in float32, as text."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from dqforge.machines.design.settings import filter_share
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import CurrentFrame, Feedforward, ModulationName
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.phase_control.leg_duties import duties_of
from dqforge.optimizer.phase_control.phase_records import (
    Measured,
    Shape,
    Structure,
    TorqueLimit,
    blank_gains,
)
from dqforge.optimizer.phase_control.phase_steps import (
    HarmonicSteps,
    control_start,
    open_phase,
    phase_steps,
)
from dqforge.optimizer.steps.step_arithmetic import Abc, Dq, Rotation
from dqforge.reports.c_code.harness import single_from, title
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.control.control_text import (
    duty_functions,
    pi_structs,
    speed_loop_functions,
)
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.loops.proven_text import judged_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.float32_model import (
    PhaseControlModel,
    limited_from,
    plain_limited,
)
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import record_structs, vector_struct
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression, Origin
from dqforge.reports.waveforms.float32_model import phase_reference_from

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.phase_control.phase_controller import PhaseControl
    from dqforge.optimizer.phase_control.phase_controller import TorqueLimit as LimitTable
    from dqforge.optimizer.solution import Solution


_FLOAT_BYTES = 4

_COMMENTS = {
    "d": "d: kp, ki t_s, tracking",
    "q": "q: kp, ki t_s, tracking",
    "zero": "zero sequence: kp, ki t_s, tracking",
    "speed": "speed: kp, ki t_s, tracking",
    "pole_pairs": "number of pole pairs",
    "r_s": "Ohm",
    "l_d": "H",
    "l_q": "H",
    "l_0": "H",
    "psi_pm": "Wb",
    "voltage_share": "1",
    "t_s": "s",
    "sampling": "Hz",
    "torque_max": "N m",
    "speed_filter": "1",
    "fade_end": "1",
    "fade": "s",
    "harmonic_rate": "1",
    "harmonic_fade": "s",
    "harmonic_error_max": "A",
    "balance": "A/V",
    "zero_fade": "s",
}


def surroundings(solution: Solution) -> Surroundings:
    """What the emitted control takes from a design beside its current control."""
    design = solution.design
    settings = design.control.speed_loop
    return Surroundings(
        modulation=design.operation.modulation,
        voltage_margin=design.operation.voltage_margin,
        speed=solution.gains.speed,
        ratio=1 if settings is None else settings.ratio,
        speed_filter=filter_share(
            settings.filter_time if settings is not None else 0.0, design.control.t_s
        ),
    )


def plain_solution_control(solution: Solution, control: PhaseControl) -> PlainData:
    """The emitted control of a solution as plain data.

    Raises:
        InputError: As `plain_phase_control`; or the current reference is in fixed point.
    """
    if control.frame == "dq" and isinstance(solution.fit.reference, FixedReference):
        raise InputError(
            "export.control: float32 control needs current references in float32; write "
            f"fit.format: float32, or export.control: {solution.fit.reference.format}"
        )
    by_waveform = control.frame == "table" and isinstance(
        solution.design.phase_machine, SalientPhaseMachine
    )
    return plain_phase_control(
        control,
        surroundings(solution),
        by_waveform=by_waveform,
        start_up=solution.design.control.start_up is not None,
    )


def _gain_lines(plain: Mapping[str, Any]) -> list[tuple[str, str]]:
    names = [
        *NUMBERS,
        *(name for name in (*HARMONIC_NUMBERS, *MIDPOINT_NUMBERS) if _emitted(plain, name)),
    ]
    return [
        *(
            ("{ " + ", ".join(float_literal(x) for x in plain[name]) + " }", _COMMENTS[name])
            for name in PIS
        ),
        *((float_literal(plain[name]), f"{name}, {_COMMENTS[name]}") for name in names),
        (f"{plain['ratio']}U", "current samples per speed sample"),
    ]


def _emitted(plain: Mapping[str, Any], name: str) -> bool:
    """Whether a number of some controllers only stands in the gains of this one."""
    if name in MIDPOINT_NUMBERS:
        return structure_of(plain).midpoint
    return bool(plain["plane"] or plain["zero_orders"])


def header_context(plain: Mapping[str, Any]) -> dict[str, Any]:
    """What the template needs beside the title, from data as `plain_phase_control` makes them."""
    made = structure_of(plain)
    return {
        "neutral": made.neutral,
        "midpoint": made.midpoint,
        "by_torque": made.by_torque,
        "by_waveform": made.by_waveform,
        "start_up": made.start_up,
        "turns": made.turns,
        "rows": len(plain["shape"]),
        "nodes": len(plain["shape"][0]) - 1,
        "shape": plain["shape"],
        "torque_limit": plain["torque_limit"],
        "limited": plain["limited"],
        "orders": bool(made.multiples),
        "plane": list(made.plane),
        "zero_orders": list(made.zero),
        "gains": _gain_lines(plain),
        "pi_structs": pi_structs,
        "control_functions": partial(control_functions, plain),
    }


# The functions, written from their steps.


def leg_types(made: Structure, prefix: str) -> str:
    """The type of the duty cycles; of three legs with the functions of their modulator."""
    kind = duties_of(made.topology)
    if kind is not Abc:
        return "\n".join(vector_struct(kind, prefix))
    said = "/* Duty cycles 0 to 1 of the upper switches. */"
    types = [f"{said}\ntypedef {prefix}_abc_t {prefix}_duties_t;"]
    if made.modulated:
        types.append(duty_functions(made.modulation, prefix))
    return "\n\n".join(types)


def control_functions(plain: Mapping[str, Any], prefix: str, macro: str) -> str:
    """Control of current and torque, what starts it, and speed control around it."""
    made = structure_of(plain)
    shape = _array(plain["shape"])
    limit = plain["torque_limit"]
    table = None if limit is None else TorqueLimit(*_limit_from(limit))
    beyond = plain["limited"]
    limited = None if beyond is None else limited_from(beyond, shape.shape, made.neutral)
    nominal = None if limit is None else limit["v_nominal"]
    steps = phase_steps(made, shape, nominal, limited, tuple, tuple if made.by_waveform else None)
    results: dict[str, type[Any] | None] = {"small_rotation": Rotation, "turned": Rotation}
    results["speed_loop"] = None
    if made.modulated:
        results["duties"] = Abc
    constants = (
        [] if limited is None else [(limited.table, f"&{macro}_LIMITED", frozenset[Origin]())]
    )
    functions = Functions(results=results, constants=constants)
    reader = StepReader(prefix, functions, Block("", set()))
    gains, state = blank_gains(Shape(tuple(shape)), table), made.at_rest(1)
    number: Any = Expression("number")
    reference = vector(Dq, "reference")
    i = Abc(number, number, number)
    measured = Measured(i, number, number, number, number if made.midpoint else None)
    reader.write("control_start", control_start, [state])
    if made.neutral:
        reader.write("open_phase", open_phase, [state, Expression("phase", kind="uint32_t")])
    reader.write("current_control", steps.current_control, [gains, state, measured, reference])
    reader.write("torque_control", steps.torque_control, [gains, state, measured, number])
    reader.write("speed_control", steps.speed_control, [gains, state, measured, number])
    types = (
        "\n".join(vector_struct(kind, prefix))
        for name, kind in functions.vectors.items()
        if name not in _DECLARED
    )
    turning = HarmonicSteps(made.plane, made.zero).blank(Rotation(number, number))
    turns = record_structs(turning, prefix) if made.multiples else []
    known = [leg_types(made, prefix), *types, *("\n".join(lines) for lines in turns)]
    loop = speed_loop_functions(prefix)
    return "\n\n".join([*known, loop, *functions.texts.values()])


# Vectors whose types stand elsewhere in the header.
_DECLARED = ("alphabetazero", "duties")


_FRAMES = {
    "dq": "References and integrals are constant in rotor coordinates (dq0).",
    "dqx": "References follow the back-EMF without its zero sequence, integrals live along it.",
    "dqy": "References follow the back-EMF with its zero sequence, integrals live along it.",
    "table": "References follow the back-EMF; the integrals are those of rotor coordinates (dq0).",
}

_FED_FORWARD = {
    "references": "Fed forward: the whole voltage of the references where it acts.",
    "emf": "Fed forward: the back-EMF where the voltage acts.",
    "measured": "Fed forward: the back-EMF, and the coupling of measured currents.",
    "none": "Nothing is fed forward.",
}


def preamble(plain: Mapping[str, Any]) -> list[str]:
    """Lines at the head of the header."""
    intervals = len(plain["shape"][0]) - 1
    period = f"{plain['t_s'] * 1e6:.6g} us"
    table = f"The table of the back-EMF has {intervals} intervals, {shape_bytes(plain)} bytes."
    return [
        f"{plain['topology']}; sampled every {period}; the duty cycles of a sample act from the",
        "next on, for one period. Currents, angle and speed of one instant go in; dq quantities",
        "as peak of phase.",
        _FRAMES[plain["frame"]],
        _FED_FORWARD[plain["feedforward"]],
        table,
        "All gains can be changed at run time: copy the constant structure and hand your copy",
        "over.",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def phase_control_files(solution: Solution, control: PhaseControl) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_control.h``.

    Raises:
        InputError: As `plain_solution_control`.
    """
    plain = plain_solution_control(solution, control)
    context = {
        **title(solution.design),
        **header_context(plain),
        "preamble": [*preamble(plain), *_judgement(solution, control)],
    }
    text = render("phase_control/phase_control.h.j2", context)
    return {f"{solution.design.export.prefix}_control.h": text.encode("ascii")}


def _judgement(solution: Solution, control: PhaseControl) -> list[str]:
    """How fast the currents forget, of the control that the design asks for."""
    phases = None if solution.loops is None else solution.loops.phases
    if phases is None or phases.control is not control or phases.judged is None:
        return []
    return judged_lines(phases.judged)


def shape_bytes(plain: Mapping[str, Any]) -> int:
    """Bytes of the table of the back-EMF."""
    return _FLOAT_BYTES * int(np.size(plain["shape"]))


# The emitted control of a phase machine as plain data, and back to its model.

PIS = ("d", "q", "zero", "speed")

NUMBERS = (
    "pole_pairs", "r_s", "l_d", "l_q", "l_0", "psi_pm", "voltage_share", "t_s", "sampling",
    "torque_max", "speed_filter", "fade_end", "fade",
)  # fmt: skip

HARMONIC_NUMBERS = ("harmonic_rate", "harmonic_fade", "harmonic_error_max")

MIDPOINT_NUMBERS = ("balance", "zero_fade")

_FAULT = InputError("control_header is not what dqforge writes; run the design again")

_MOST_NODES, _MOST_ORDER, _MOST_TURNS = 65_536, 200, 1000

_FADE_SHARE = 5.0  # over the last fifth of the frequencies


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the emitted control takes from the design beside its current control.

    Args:
        modulation: Modulator of three legs without a neutral.
        voltage_margin: Share of the DC link that stays unused.
        speed: Gains of the speed loop, None without one.
        ratio: Current samples per speed sample.
        speed_filter: Share of a new speed sample, 1 without filter.
    """

    modulation: ModulationName
    voltage_margin: float = 0.0
    speed: LoopGains | None = None
    ratio: int = 1
    speed_filter: float = 1.0


def _single(value: float) -> float:
    return shortest(np.float32(value))


def _fade(control: PhaseControl) -> tuple[float, float]:
    """Share of the shape = first - second |omega_e|: 1 and 0 at the samples per period given."""
    begins, ends = control.fade
    if begins <= ends:
        return 1.0, 0.0
    slope = 1.0 / (1.0 / ends - 1.0 / begins)
    return slope / ends, slope * control.t_s / (2.0 * math.pi)


def _numbers(control: PhaseControl, around: Surroundings) -> dict[str, float]:
    fade_end, fade = _fade(control)
    l_d, l_q, l_0 = control.inductances
    found = {
        "pole_pairs": control.pole_pairs,
        "r_s": control.r_s,
        "l_d": l_d,
        "l_q": l_q,
        "l_0": l_0,
        "psi_pm": control.psi_pm,
        "voltage_share": 1.0 - around.voltage_margin,
        "t_s": control.t_s,
        "sampling": 1.0 / control.t_s,
        "torque_max": control.torque_max,
        "speed_filter": around.speed_filter,
        "fade_end": fade_end,
        "fade": fade,
    }
    if control.harmonics is not None:
        found["harmonic_rate"] = control.harmonics.rate * control.t_s
        found["harmonic_fade"] = _FADE_SHARE / (2.0 * math.pi * control.harmonics.frequency_max)
        found["harmonic_error_max"] = control.harmonics.error_max
    if control.midpoint is not None:
        least = control.midpoint.omega_e_min
        found["balance"] = control.midpoint.balance
        found["zero_fade"] = 1.0 / least if least > 0.0 else 1e30
    return {name: _single(value) for name, value in found.items()}


def _limit(limit: LimitTable | None) -> PlainData | None:
    """The table with at least two nodes on each axis."""
    if limit is None:
        return None
    axes, torque = [limit.omega_e, limit.v_dc], np.asarray(limit.torque)
    for axis in (0, 1):
        if axes[axis].size == 1:
            axes[axis] = np.append(axes[axis], axes[axis][0] + 1.0)
            torque = np.repeat(torque, 2, axis=axis)
    return {
        "omega_e": [_single(x) for x in axes[0]],
        "v_dc": [_single(x) for x in axes[1]],
        "torque": [[_single(x) for x in row] for row in torque],
        "v_nominal": None if limit.v_nominal is None else _single(limit.v_nominal),
    }


def _require(control: PhaseControl) -> None:
    """Refuse what the emitted control does not do."""
    rule = TOPOLOGIES[control.topology]
    l_d, l_q, _ = control.inductances
    if control.frame == "dqy" and not rule.neutral:
        raise InputError(
            "control.current_loop.frame: dqy needs a zero-sequence current, and "
            f"{control.topology} drives none; write dqx or table"
        )
    if l_d != l_q and control.frame not in ("dq", "table"):
        raise InputError(
            f"control.current_loop.frame: {control.frame} is for machines without saliency; write "
            "table or dq"
        )
    rows, nodes = control.shape.flux.shape
    if rows == 1 and (control.shape.turns > 1 or nodes % 3):
        raise InputError(
            "the emitted back-EMF needs three rows where it repeats after several periods, or "
            f"nodes in multiples of 3 for one row; it has {nodes} nodes and {control.shape.turns} "
            "periods"
        )
    if control.limited is not None and control.frame in ("dq", "dqx"):
        raise InputError(
            "control.current_loop.limited_waveforms: references of frame "
            f"{control.frame} do not follow the back-EMF with its zero sequence; write table"
        )
    if rule.midpoint != (control.midpoint is not None):
        raise InputError(f"{control.topology}: gains of the midpoint belong to split-capacitor")


def plain_phase_control(
    control: PhaseControl,
    around: Surroundings,
    *,
    by_waveform: bool = False,
    start_up: bool = False,
) -> PlainData:
    """The emitted control as plain data; every number is a float32 value.

    ``by_waveform`` says that the references are those of the header of phase currents, ``start_up``
    that a start without encoder adds currents to them.

    Raises:
        InputError: It is not emitted; the message says what is instead.
    """
    _require(control)
    flux: FloatArray = np.concatenate([control.shape.flux, control.shape.flux[:, :1]], axis=1)
    harmonics = control.harmonics
    neutral = TOPOLOGIES[control.topology].neutral
    speed = around.speed
    gains = {
        name: [_single(axis.kp), _single(axis.ki * control.t_s), 0.0]
        for name, axis in zip(PIS[:3], control.gains, strict=True)
    }
    gains["speed"] = (
        [0.0, 0.0, 0.0]
        if speed is None
        else [_single(x) for x in (speed.kp, speed.ki_ts, speed.anti_windup * speed.t_s)]
    )
    return {
        "frame": control.frame,
        "feedforward": control.feedforward,
        "topology": control.topology,
        "modulation": around.modulation,
        "turns": control.shape.turns,
        "by_waveform": by_waveform,
        **({"start_up": True} if start_up else {}),
        "ratio": around.ratio,
        "plane": [] if harmonics is None else list(harmonics.plane),
        "zero_orders": list(harmonics.zero) if harmonics is not None and neutral else [],
        **gains,
        **_numbers(control, around),
        "torque_limit": _limit(control.torque_limit),
        "limited": plain_limited(control.limited),
        "shape": [[_single(x) for x in row] for row in flux],
    }


def structure_of(plain: Mapping[str, Any]) -> Structure:
    """What the code is made of, from data as `plain_phase_control` makes them.

    Raises:
        KeyError, TypeError, ValueError: They are not.
    """
    whole = {name: plain[name] for name in ("turns", "ratio")}
    orders = {name: tuple(plain[name]) for name in ("plane", "zero_orders")}
    for value in (*whole.values(), *orders["plane"], *orders["zero_orders"]):
        if isinstance(value, bool) or not isinstance(value, int):
            raise TypeError
    for values, known in (
        (plain["frame"], get_args(CurrentFrame)),
        (plain["feedforward"], get_args(Feedforward)),
        (plain["topology"], tuple(TOPOLOGIES)),
        (plain["modulation"], tuple(MODULATORS)),
    ):
        if values not in known:
            raise ValueError
    sizes = [abs(order) for order in (*orders["plane"], *orders["zero_orders"])]
    if not all(1 <= size <= _MOST_ORDER for size in sizes) or min(whole.values()) < 1:
        raise ValueError
    if min((*orders["zero_orders"], 1)) < 1 or whole["turns"] > _MOST_TURNS:
        raise ValueError
    if any(len(set(found)) != len(found) for found in orders.values()):
        raise ValueError
    found = Structure(
        plain["frame"], plain["feedforward"], plain["topology"], plain["modulation"],
        whole["turns"], whole["ratio"], orders["plane"], orders["zero_orders"],
        plain["torque_limit"] is not None,
        plain["l_d"] != plain["l_q"],
        bool(plain.get("by_waveform", False)),
        plain.get("start_up", False) is True,
    )  # fmt: skip
    if (found.zero or found.frame == "dqy") and not found.neutral:
        raise ValueError
    return found


def _array(rows: Any) -> SingleArray:
    return np.array([[single_from(x) for x in row] for row in rows], dtype=np.float32)


def phase_control_from(described: Mapping[str, Any], whole: Mapping[str, Any]) -> PhaseControlModel:
    """Read the control functions back from a result and its part that describes them.

    Raises:
        InputError: The data are not what `plain_phase_control` makes.
    """
    try:
        structure = structure_of(described)
        names = (
            *NUMBERS,
            *(HARMONIC_NUMBERS if structure.multiples else ()),
            *(MIDPOINT_NUMBERS if structure.midpoint else ()),
        )
        gains: dict[str, Any] = {
            name: tuple(single_from(x) for x in described[name]) for name in PIS
        }
        gains |= {name: single_from(described[name]) for name in names}
        shape, limit = _array(described["shape"]), described["torque_limit"]
        table = None if limit is None else _limit_from(limit)
        at = None if limit is None else limit["v_nominal"]
        nominal = None if at is None else single_from(at)
        beyond = described.get("limited")
        limited = None
        if beyond is not None:
            limited = limited_from(beyond, shape.shape, structure.neutral)
        reference = None if structure.by_torque else from_plain(whole["header"]["reference"])
        waveform = phase_reference_from(whole["waveform_header"]) if structure.by_waveform else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    rows, columns = shape.shape if shape.ndim == 2 else (0, 0)
    thirds = rows == 3 or ((columns - 1) % 3 == 0 and structure.turns == 1)
    if rows not in (1, 3) or not 4 <= columns <= _MOST_NODES or not thirds:
        raise _FAULT
    if not all(len(gains[name]) == 3 for name in PIS) or isinstance(reference, FixedReference):
        raise _FAULT
    if nominal is not None and not nominal > 0.0:
        raise _FAULT
    return PhaseControlModel(structure, gains, shape, reference, table, nominal, limited, waveform)


def _limit_from(limit: Mapping[str, Any]) -> tuple[SingleArray, SingleArray, SingleArray]:
    speeds, voltages = _array([limit["omega_e"]])[0], _array([limit["v_dc"]])[0]
    torque = _array(limit["torque"])
    ascending = all(np.all(np.diff(axis) > 0.0) for axis in (speeds, voltages))
    if torque.shape != (speeds.size, voltages.size) or min(torque.shape) < 2 or not ascending:
        raise ValueError
    return speeds, voltages, torque
