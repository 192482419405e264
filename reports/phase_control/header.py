"""The C header of the control of phase machines in float32, as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.c_code.title import title
from dqforge.reports.control.header import speed_filter
from dqforge.reports.loops.judged_text import judged_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.float32_parts import steps_per_rad, turns_per_rad
from dqforge.reports.phase_control.plain import (
    HARMONIC_NUMBERS,
    MIDPOINT_NUMBERS,
    NUMBERS,
    PIS,
    Surroundings,
    plain_phase_control,
    structure_of,
)
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.optimizer.phase_control.phase_controller import PhaseControl
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
        speed_filter=speed_filter(
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
    ascending = made.multiples
    acts = made.feedforward != "none" or made.follows
    return {
        "frame": made.frame,
        "feedforward": made.feedforward,
        "topology": made.topology,
        "legs": made.legs,
        "six": len(made.legs) == 6,
        "neutral": made.neutral,
        "midpoint": made.midpoint,
        "by_torque": made.by_torque,
        "follows": made.follows,
        "acts": acts,
        "shaped": acts or made.by_torque or made.neutral,
        "turning": not made.follows or bool(ascending) or made.feedforward == "references",
        "salient": made.salient,
        "by_waveform": made.by_waveform,
        "start_up": made.start_up,
        "proportional": made.proportional,
        "modulator": MODULATORS[made.modulation],
        "turns": made.turns,
        "per_rad": shortest(turns_per_rad(made.turns)),
        "slopes": [False, True] if made.slopes else [False],
        "per_step": shortest(steps_per_rad(len(plain["shape"][0]) - 1, made.turns)),
        "rows": len(plain["shape"]),
        "nodes": len(plain["shape"][0]) - 1,
        "shape": plain["shape"],
        "torque_limit": plain["torque_limit"],
        "limited": plain["limited"],
        "orders": bool(ascending),
        "plane": list(made.plane),
        "zero_orders": list(made.zero),
        "plane_places": [ascending.index(abs(order)) for order in made.plane],
        "zero_places": [ascending.index(order) for order in made.zero],
        "multiples": [
            {"order": order, "gap": order - before}
            for order, before in zip(ascending, (1, *ascending), strict=False)
        ],
        "gains": _gain_lines(plain),
    }


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
