"""The C header of field-oriented control in float32, its plain description,
and the run that proves it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import filter_share
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import (
    METHODS,
    MODULATORS,
)
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import fundamental_share
from dqforge.machines.transforms import CURRENT_DELAY, Pair
from dqforge.optimizer.current_reference.forms import FixedReference, FloatReference
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.dynamic_references import DynamicReferences
from dqforge.optimizer.field_weakening.voltage_region import DropReference
from dqforge.optimizer.float_control.current_control import ControlSteps, Numbers
from dqforge.optimizer.float_control.duties import Duties
from dqforge.optimizer.float_control.hexagon_step import overmodulation_step
from dqforge.optimizer.float_control.records import (
    NUMBERS,
    Control,
    ControlGains,
    Measured,
    PiGains,
    ReferenceGains,
    at_rest,
)
from dqforge.optimizer.float_control.speed_loop import speed_loop
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.solution import Solution
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq
from dqforge.reports.c_code.harness import Harness, Programme, control_harness, single_from, title
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.control.control_text import (
    control_functions,
    control_start,
    control_structs,
    duty_functions,
    overmodulation_function,
)
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.loops.firmware_text import stability_lines
from dqforge.reports.loops.proven_text import proven_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.single_headers.field_weakening import weakening_from

_PIS = ("d", "q", "speed")


_COMMENTS = {
    "d": "i_d: kp, ki t_s, tracking",
    "q": "i_q: kp, ki t_s, tracking",
    "speed": "speed: kp, ki t_s, tracking",
    "pole_pairs": "number of pole pairs",
    "r_s": "Ohm",
    "l_d": "H",
    "l_q": "H",
    "psi_pm": "Wb",
    "voltage_share": "V per V of the DC link",
    "advance": "s",
    "torque_max": "N m",
    "speed_filter": "1",
}


_DRIVES, _STEPS = 50, 160


_SEED = 20_261_121


_FAULT = InputError("control_header is not what dqforge writes; run the design again")


def _pi(gains: LoopGains | None) -> list[float]:
    if gains is None:
        return [0.0, 0.0, 0.0]
    return [shortest(np.float32(x)) for x in (gains.kp, gains.ki_ts, gains.anti_windup * gains.t_s)]


def plain_control(solution: Solution) -> PlainData:
    """The gains and the modulator of the emitted control as plain data.

    Every number is a float32 value.

    Raises:
        InputError: The current reference is in fixed point, which the float32 control cannot call.
    """
    design = solution.design
    if isinstance(solution.fit.reference, FixedReference):
        raise InputError(
            "export.control: float32 control needs current references in float32; write "
            f"fit.format: float32, or export.control: {solution.fit.reference.format}"
        )
    operation, control, machine = design.operation, design.control, design.machine
    settings = control.speed_loop
    numbers = {
        "pole_pairs": machine.pole_pairs,
        "r_s": machine.r_s,
        "l_d": machine.l_d,
        "l_q": machine.l_q,
        "psi_pm": machine.psi_pm,
        "voltage_share": _controlled_share(design),
        "advance": CURRENT_DELAY * control.t_s,
        "torque_max": float(solution.reference.torque_max),
        "speed_filter": filter_share(
            settings.filter_time if settings is not None else 0.0, control.t_s
        ),
    }
    return {
        "modulation": operation.modulation,
        **_plain_overmodulation(design),
        **_plain_references(solution.gains.references),
        **({"injects": True} if injects(solution) else {}),
        **({} if control.start_up is None else {"start_up": True}),
        "weakening": solution.weakening is not None,
        "ratio": 1 if settings is None else settings.ratio,
        "d": _pi(solution.gains.i_d),
        "q": _pi(solution.gains.i_q),
        "speed": _pi(solution.gains.speed),
        **{name: shortest(np.float32(value)) for name, value in numbers.items()},
    }


def injects(solution: Solution) -> bool:
    """Whether an estimator of the design asks the control for a voltage of its own."""
    start = None if solution.start_up is None else solution.start_up.low
    return any(
        found is not None and found.tracker.injects for found in (solution.gains.tracker, start)
    )


def _controlled_share(design: Design) -> float:
    """Largest fundamental of the current controllers over the dc link.

    With overmodulation the margin is kept free for them, who answer its harmonics; else they keep
    to what the references have.
    """
    share = fundamental_share(design.inverter, design.operation.modulation)
    if design.inverter.overmodulation != "none":
        return share
    return share * (1.0 - design.operation.voltage_margin)


def _plain_overmodulation(design: Design) -> PlainData:
    """Method, and what of the controllers' voltage the references get; empty without."""
    method, margin = design.inverter.overmodulation, design.operation.voltage_margin
    if method == "none":
        return {}
    return {"overmodulation": method, "reference_share": shortest(np.float32(1.0 - margin))}


def _plain_references(found: DynamicReferences | None) -> PlainData:
    """Members of ``<prefix>_reference_gains_t`` by name, None where one is not asked for."""
    if found is None:
        return {}
    feedback = found.feedback
    members = {
        "torque_step": found.torque_step,
        "current_step": found.current_step,
        "feedback": None if feedback is None else feedback.gain / (2.0 * feedback.voltage),
        "feedback_max": None if feedback is None else feedback.current,
        "i_max": None if feedback is None else feedback.i_max,
    }
    return {
        "references": {
            name: None if value is None or not math.isfinite(value) else shortest(np.float32(value))
            for name, value in members.items()
        }
    }


def control_from(described: Mapping[str, Any], whole: Mapping[str, Any]) -> ControlModel:
    """Read the control functions back from a result and its part that describes them.

    Raises:
        InputError: The data are not what `plain_control` makes.
    """
    try:
        gains: dict[str, Any] = {
            name: tuple(single_from(x) for x in described[name]) for name in _PIS
        }
        gains |= {name: single_from(described[name]) for name in NUMBERS}
        modulation, ratio = described["modulation"], described["ratio"]
        method = described.get("overmodulation", "none")
        moving = _reference_gains(described.get("references"))
        left = single_from(described.get("reference_share", 1.0))
        reference = from_plain(whole["header"]["reference"])
        weakening = weakening_from(whole["weakening_header"]) if described["weakening"] else None
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    whole_ratio = isinstance(ratio, int) and not isinstance(ratio, bool) and ratio >= 1
    triples = all(len(gains[name]) == 3 for name in _PIS)
    if modulation not in tuple(MODULATORS) or not whole_ratio or not triples:
        raise _FAULT
    if isinstance(reference, FixedReference) or method not in ("none", *METHODS):
        raise _FAULT
    injecting = described.get("injects", False) is True
    holds = described.get("start_up", False) is True
    return ControlModel(
        gains, ratio, modulation, reference, weakening, method, left, moving, injecting, holds
    )


def _reference_gains(plain: Mapping[str, Any] | None) -> ReferenceGains | None:
    """Read the members back; None where a control has none."""
    if plain is None:
        return None
    found: dict[str, Any] = {
        member.name: None if plain[member.name] is None else single_from(plain[member.name])
        for member in fields(ReferenceGains)
    }
    return ReferenceGains(**found)


def control_inputs(model: ControlModel) -> SingleArray:
    """Sequences for the harness, shape (steps * drives, 9): every mode, within all
    limits and far beyond them; two columns more with the voltage that is added where one is.
    """
    generator = np.random.default_rng(_SEED)
    shape = (_STEPS, _DRIVES)
    rows = np.zeros((*shape, 9))
    torque_max = float(model.gains["torque_max"])
    ampere = float(
        np.max(np.abs(model.reference.currents(np.array([torque_max], dtype=np.float32))))
    )
    spread = generator.choice([0.3, 1.0, 30.0], size=_DRIVES)
    v_dc = generator.uniform(10.0, 1000.0, _DRIVES)
    speed = generator.uniform(-1.0, 1.0, _DRIVES) * v_dc / max(float(model.gains["psi_pm"]), 1e-3)
    speed /= float(model.gains["pole_pairs"])
    rows[..., 0] = np.arange(_DRIVES) % 3
    rows[..., 1:4] = generator.normal(size=(*shape, 3)) * (spread * ampere)[:, None]
    rows[..., 4] = np.cumsum(generator.normal(size=shape), axis=0)
    rows[..., 5] = speed * (1.0 + 0.01 * generator.normal(size=shape))
    rows[..., 6] = v_dc * generator.uniform(0.9, 1.1, shape)
    rows[..., 7] = generator.normal(size=shape) * spread * ampere
    rows[..., 8] = generator.normal(size=shape) * spread * ampere
    rows[..., 7] = np.where(
        rows[..., 0] == 1, generator.uniform(-1.2, 1.2, shape) * torque_max, rows[..., 7]
    )
    rows[..., 7] = np.where(
        rows[..., 0] == 2, speed * generator.uniform(0.0, 2.0, shape), rows[..., 7]
    )
    if model.overmodulation != "none":
        _run_near_six_step(model, rows, generator)
    rows[:3, :, 1:4] = 0.0  # references and voltages that are exactly equal
    rows[2, :, 7:] = 0.0
    rows[5, :, 6] = 0.0  # no DC-link voltage
    columns = np.arange(1, 9)  # of the measurements and references; one bad sample each
    rows[10:18, :_DRIVES, columns] = np.where(
        np.eye(8, dtype=np.bool_)[:, np.newaxis], np.nan, rows[10:18][..., columns]
    )
    rows[20:28, :_DRIVES, columns] = np.where(
        np.eye(8, dtype=np.bool_)[:, np.newaxis], np.inf, rows[20:28][..., columns]
    )
    return _with_added(model, np.ascontiguousarray(rows.reshape(-1, 9), dtype=np.float32))


def _with_added(model: ControlModel, rows: SingleArray) -> SingleArray:
    """With alpha and beta of an added voltage up to a quarter of the link, where one is added."""
    if not model.injects:
        return rows
    generator = np.random.default_rng(_SEED + 1)
    added = 0.25 * rows[:, 6:7] * generator.uniform(-1.0, 1.0, (len(rows), 2))
    known = np.where(np.isfinite(added), added, 0.0).astype(np.float32)
    return np.ascontiguousarray(np.hstack([rows, known]))


def _run_near_six_step(
    model: ControlModel, rows: FloatArray, generator: np.random.Generator
) -> None:
    """Let the second half of the steps need little more than the back-EMF, about the voltages
    between the linear range and six-step operation.
    """
    quiet = rows[_STEPS // 2 :]
    quiet[..., 1:4] *= 0.003
    quiet[..., 7:] *= 0.003
    share = generator.uniform(0.5, 0.7, quiet.shape[:2])
    flux = float(model.gains["pole_pairs"]) * max(float(model.gains["psi_pm"]), 1e-3)
    quiet[..., 5] = np.sign(quiet[..., 5]) * share * quiet[..., 6] / flux


def control_results(model: ControlModel, inputs: SingleArray) -> SingleArray:
    """What the harness must return for `control_inputs`, shape (N, 8)."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        return _results(model, inputs)


def _results(model: ControlModel, inputs: SingleArray) -> SingleArray:
    drives = [slice(mode, _DRIVES, 3) for mode in range(3)]
    rows = inputs.reshape(-1, _DRIVES, inputs.shape[1])
    results = np.empty((rows.shape[0], _DRIVES, 8), dtype=np.float32)
    for mode, chosen in enumerate(drives):
        mine = rows[:, chosen]
        state = model.at_rest(mine.shape[1])
        for step, row in enumerate(mine):
            reference = np.ascontiguousarray(row[:, 7])
            measured = np.ascontiguousarray(row[:, 1:7])
            if model.injects:
                state.added = AlphaBeta(row[:, 9].copy(), row[:, 10].copy())
            if mode == 0:
                duty = model.current_control(
                    state, measured, (reference, np.ascontiguousarray(row[:, 8]))
                )
            elif mode == 1:
                duty = model.torque_control(state, measured, reference)
            else:
                duty = model.speed_control(state, measured, reference)
            results[step, chosen] = np.stack(
                [*duty, *state.v, *state.reference, state.torque], axis=1
            )
    return results.reshape(-1, 8)


def control_programme(model: ControlModel) -> Programme:
    """The harness of the control functions."""
    inputs = control_inputs(model)
    results = control_results(model, inputs)
    return Programme(_harness(model.injects), inputs, results, "control functions")


def _harness(injects: bool) -> Harness:
    added = ("state->added.alpha = in[9];", "state->added.beta = in[10];") if injects else ()
    duties, voltage = ("duty.a", "duty.b", "duty.c"), ("state->v.alpha", "state->v.beta")
    told = f"reference d (or the only one) and q{', added voltage' if injects else ''}"
    return control_harness(_DRIVES, told, 7, 11 if injects else 9, added, "abc", duties + voltage)


def _gain_lines(plain: PlainData) -> list[tuple[str, str]]:
    triples = [
        ("{ " + ", ".join(float_literal(value) for value in plain[name]) + " }", _COMMENTS[name])
        for name in _PIS
    ]
    numbers = [(float_literal(plain[name]), f"{name}, {_COMMENTS[name]}") for name in NUMBERS]
    lines = [*triples, *numbers, (f"{plain['ratio']}U", "current samples per speed sample")]
    moving = _moving(plain)
    if moving:
        values = ", ".join(float_literal(value) for value in moving.values())
        lines.append(("{ " + values + " }", "references: " + ", ".join(moving)))
    return lines


def _moving(plain: Mapping[str, Any]) -> dict[str, float]:
    """Members of ``<prefix>_reference_gains_t`` that there are, in their order."""
    members = plain.get("references") or {}
    return {name: value for name, value in members.items() if value is not None}


def control_files(solution: Solution) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_control.h``.

    Raises:
        InputError: As `plain_control`.
    """
    design, plain = solution.design, plain_control(solution)
    prefix = design.export.prefix
    gains = gains_of(plain, plain["ratio"], _reference_gains(plain.get("references")))
    state = at_rest(
        1, gains.references, injects=plain.get("injects", False), holds=plain.get("start_up", False)
    )
    steps = control_steps(
        plain["modulation"],
        plain.get("overmodulation", "none"),
        tuple,
        weakens=plain["weakening"],
        reference_share=plain.get("reference_share", 1.0),
    )
    context = {
        **title(design),
        "weakening": plain["weakening"],
        "duties": duty_functions(plain["modulation"], prefix),
        "overmodulation": overmodulation_function(plain.get("overmodulation", "none"), prefix),
        "gains": _gain_lines(plain),
        "structs": control_structs(gains, state, prefix),
        "start": control_start(state),
        "functions": control_functions(steps, gains, state, prefix),
        "preamble": [
            (
                f"Sampled every {design.control.t_s * 1e6:.6g} us; the duty cycles of a sample act "
                "from the next on, for"
            ),
            (
                "one period. Currents, angle and speed of one instant go in; dq quantities as peak "
                "of phase."
            ),
            (
                "All gains can be changed at run time: copy the constant structure and hand your "
                "copy over."
            ),
            "Compile with -ffp-contract=off to equal the model bit for bit.",
            *_over_a_regulator(design),
            *stability_lines(solution.loops, solution.design.machine.pole_pairs),
            *proven_lines(solution.loops),
        ],
    }
    return {f"{prefix}_control.h": render("control/control.h.j2", context).encode("ascii")}


def _over_a_regulator(design: Design) -> list[str]:
    """What is of use where the phase currents switch the bridge themselves."""
    loop = design.control.current_loop
    if not loop.switches:
        return []
    return [
        "",
        f"The {loop.method} regulator switches the bridge: hand it state.reference of the speed or",
        "torque control. The duty cycles and the gains of d and q, which stand for the regulator",
        "as the speed loop sees it, are left aside.",
    ]


def gain_bytes(plain: Mapping[str, Any]) -> bytes:
    """Bytes of ``<prefix>_control_gains_t`` on this machine, from data as
    `plain_control` makes them.
    """
    numbers = [value for name in _PIS for value in plain[name]] + [plain[name] for name in NUMBERS]
    moving = _moving(plain).values()
    return struct.pack(f"={len(numbers)}fI{len(moving)}f", *numbers, plain["ratio"], *moving)


# The control functions in single precision, many drives side by side: the steps that are emitted,
# so that the compiled code equals it bit for bit without contraction of products and sums
# (-ffp-contract=off).

Singles = tuple[SingleArray, ...]


_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


def gains_of(
    gains: Mapping[str, Any], ratio: int, moving: ReferenceGains | None = None
) -> ControlGains:
    """The record of gains as `ControlModel` has them; what is not there is 0."""
    pis = {name: PiGains(*gains.get(name, (_ZERO, _ZERO, _ZERO))) for name in _PIS}
    numbers = {name: gains.get(name, _ZERO) for name in NUMBERS}
    members: dict[str, Any] = {**pis, **numbers, "ratio": ratio}
    return ControlGains(**members, references=moving)


@dataclass(frozen=True, slots=True)
class ControlModel:
    """The control functions of one header.

    Args:
        gains: Members of ``<prefix>_control_gains_t`` by name, float32: ``d``, ``q`` and ``speed``
            are (kp, ki_ts, tracking); numbers, or arrays of shape (N,) where the drives differ.
        ratio: Current samples per speed sample.
        modulation: The modulator.
        reference: Current references of the torque.
        weakening: Current references of torque, voltage and speed, None where there are none.
        overmodulation: What becomes of a voltage beyond the circle in the hexagon.
        reference_share: What the references have of the controllers' voltage; the rest is kept free
            for control.
        moving: Slopes of the references and voltage feedback, None where there are none.
        injects: Whether a voltage is made besides, that of the state.
        holds: Whether a start-up adds currents to the references of a torque.
    """

    gains: Mapping[str, Any]
    ratio: int
    modulation: ModulationName
    reference: FloatReference
    weakening: DropReference | None = None
    overmodulation: OvermodulationName = "none"
    reference_share: np.float32 = _ONE
    moving: ReferenceGains | None = None
    injects: bool = False
    holds: bool = False

    def duties(
        self, voltage: Pair[SingleArray], v_dc: SingleArray, current: Pair[SingleArray]
    ) -> Singles:
        """Duty cycles of a voltage in V and currents in A, both alpha and beta."""
        return three_leg_duties(self.modulation, voltage, v_dc, current)

    def at_rest(self, count: int) -> Control:
        """The state of so many drives, everything at rest."""
        return at_rest(count, self.moving, injects=self.injects, holds=self.holds)

    def steps(self) -> ControlSteps:
        """What the control is made of."""
        return control_steps(
            self.modulation,
            self.overmodulation,
            self.reference.currents if self.weakening is None else self.weakening.currents,
            weakens=self.weakening is not None,
            reference_share=float(self.reference_share),
        )

    def record(self) -> ControlGains:
        """The gains as the steps take them."""
        return gains_of(self.gains, self.ratio, self.moving)

    def current_control(self, state: Control, measured: SingleArray, reference: Singles) -> Singles:
        """Duty cycles from samples (N, 6): i_a, i_b, i_c, theta_e, omega_m, v_dc,
        and references (d, q) in A.
        """
        samples, wanted = _samples(measured), Dq(*reference)
        return self.steps().current_control(SINGLE, self.record(), state, samples, wanted)

    def torque_control(self, state: Control, measured: SingleArray, torque: SingleArray) -> Singles:
        """Duty cycles for a torque in N m."""
        samples = _samples(measured)
        return self.steps().torque_control(SINGLE, self.record(), state, samples, torque)

    def speed_loop(
        self, state: Control, omega_m: SingleArray, reference: SingleArray
    ) -> SingleArray:
        """Torque reference in N m for a speed in rad/s."""
        return speed_loop(SINGLE, self.record(), state, omega_m, reference)

    def speed_control(
        self, state: Control, measured: SingleArray, reference: SingleArray
    ) -> Singles:
        """Duty cycles for a speed in rad/s."""
        samples = _samples(measured)
        return self.steps().speed_control(SINGLE, self.record(), state, samples, reference)


def _samples(measured: SingleArray) -> Measured:
    columns = [np.ascontiguousarray(column) for column in measured.T]
    return Measured(Abc(*columns[:3]), *columns[3:])


def control_steps(
    modulation: ModulationName,
    method: OvermodulationName,
    currents: Numbers,
    *,
    weakens: bool,
    reference_share: float,
) -> ControlSteps:
    """What a control is made of, with the duty cycles in single precision.

    Args:
        modulation, method: Modulator and overmodulation.
        currents, weakens, reference_share: As of `ControlSteps`.
    """
    return ControlSteps(
        currents,
        modulation,
        overmodulated=overmodulation_step(method),
        weakens=weakens,
        reference_share=reference_share,
    )


def three_leg_duties(
    modulation: ModulationName,
    voltage: Pair[SingleArray],
    v_dc: SingleArray,
    current: Pair[SingleArray],
) -> Singles:
    """Duty cycles of three legs, as ``<prefix>_duties``.

    Args:
        modulation: The modulator.
        voltage, current: Alpha and beta in V and A, shape (N,).
        v_dc: DC-link voltage in V, shape (N,).
    """
    made, current_ = AlphaBeta(*voltage), AlphaBeta(*current)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Duties(modulation).duties(SINGLE, made, v_dc, current_)
