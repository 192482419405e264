"""The C header of field-oriented control in float32, its plain description,
and the run that proves it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import filter_share
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import (
    LEAST_HOLD,
    METHODS,
    MODULATORS,
    SIX_STEP,
    load_turn,
    overmodulated,
    zero_sequence_of,
)
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import fundamental_share
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.current_reference.forms import FixedReference, FloatReference
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.dynamic_references.solve import DynamicReferences
from dqforge.optimizer.field_weakening.voltage_region import DropReference
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import (
    SINGLE,
    Programme,
    rotation,
    single_from,
    small_rotation,
    title,
    turned,
)
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.control.fixed_header import ReferenceModel, ReferenceState, reference_model
from dqforge.reports.current_reference.plain import from_plain
from dqforge.reports.loops.firmware_text import stability_lines
from dqforge.reports.loops.proven_text import proven_lines
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.single_headers.field_weakening import weakening_from

_PIS = ("d", "q", "speed")


_NUMBERS = (
    "pole_pairs", "r_s", "l_d", "l_q", "psi_pm", "voltage_share", "advance", "torque_max",
    "speed_filter",
)  # fmt: skip


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
        "advance": 1.5 * control.t_s,
        "torque_max": float(solution.reference.torque_max),
        "speed_filter": speed_filter(
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


def speed_filter(filter_time: float, t_s: float) -> float:
    """Share of a new sample in the sampled first-order filter of a time constant in s: 1 -
    exp(-t_s/filter_time).
    """
    return filter_share(filter_time, t_s)


def control_from(described: Mapping[str, Any], whole: Mapping[str, Any]) -> ControlModel:
    """Read the control functions back from a result and its part that describes them.

    Raises:
        InputError: The data are not what `plain_control` makes.
    """
    try:
        gains: dict[str, Any] = {
            name: tuple(single_from(x) for x in described[name]) for name in _PIS
        }
        gains |= {name: single_from(described[name]) for name in _NUMBERS}
        modulation, ratio = described["modulation"], described["ratio"]
        method = described.get("overmodulation", "none")
        moving = reference_model(described.get("references"))
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
        state = ControlState.start(mine.shape[1])
        for step, row in enumerate(mine):
            reference = np.ascontiguousarray(row[:, 7])
            measured = np.ascontiguousarray(row[:, 1:7])
            if model.injects:
                state.added = (row[:, 9].copy(), row[:, 10].copy())
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
    return Programme(
        "control/harness.c.j2",
        inputs,
        control_results(model, inputs),
        {"drives": _DRIVES, "injects": model.injects},
        name="control functions",
    )


def _gain_lines(plain: PlainData) -> list[tuple[str, str]]:
    triples = [
        ("{ " + ", ".join(float_literal(value) for value in plain[name]) + " }", _COMMENTS[name])
        for name in _PIS
    ]
    numbers = [(float_literal(plain[name]), f"{name}, {_COMMENTS[name]}") for name in _NUMBERS]
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
    context = {
        **title(design),
        "weakening": plain["weakening"],
        "modulator": MODULATORS[plain["modulation"]],
        "overmodulation": METHODS.get(plain.get("overmodulation", "none")),
        "reference_share": plain.get("reference_share", 1.0) != 1.0 and plain["reference_share"],
        "six_step": SIX_STEP,
        "least_hold": LEAST_HOLD,
        "dynamic": plain.get("references"),
        "injects": plain.get("injects", False),
        "start_up": plain.get("start_up", False),
        "gains": _gain_lines(plain),
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
            *stability_lines(solution.loops, solution.design.machine.pole_pairs),
            *proven_lines(solution.loops),
        ],
    }
    return {f"{prefix}_control.h": render("control/control.h.j2", context).encode("ascii")}


def gain_bytes(plain: Mapping[str, Any]) -> bytes:
    """Bytes of ``<prefix>_control_gains_t`` on this machine, from data as
    `plain_control` makes them.
    """
    numbers = [value for name in _PIS for value in plain[name]] + [plain[name] for name in _NUMBERS]
    moving = _moving(plain).values()
    return struct.pack(f"={len(numbers)}fI{len(moving)}f", *numbers, plain["ratio"], *moving)


# The C functions of ``control.h.j2`` on numpy arrays of float32, many drives side by side:
# same operations, same bits.
#
# The compiled code equals it bit for bit without contraction of products and
# sums (-ffp-contract=off).

Singles = tuple[SingleArray, ...]


_UNKNOWN, _UNKNOWN_SQUARE = np.float32(1.0e15), np.float32(1.0e30)  # beyond, and not-a-number


_INSIDE = np.float32(0.999999)  # whose rounding keeps all duty cycles within 0 to 1


_HALF, _ZERO, _ONE = np.float32(0.5), np.float32(0.0), np.float32(1.0)


@dataclass(slots=True)
class ControlState:
    """State of N drives, arrays of shape (N,), as ``<prefix>_control_t``."""

    d: SingleArray
    q: SingleArray
    speed: SingleArray
    reference: Singles
    v: Singles
    omega_m: SingleArray
    torque: SingleArray
    count: NDArray[np.uint32]
    moving: ReferenceState
    added: Singles | None = None
    held: Singles = (np.zeros(1, dtype=np.float32), np.zeros(1, dtype=np.float32))

    @classmethod
    def start(cls, count: int) -> ControlState:
        """Everything at rest."""
        zeros = [np.zeros(count, dtype=np.float32) for _ in range(9)]
        return cls(
            zeros[0], zeros[1], zeros[2], (zeros[3], zeros[4]), (zeros[5], zeros[6]), zeros[7],
            zeros[8],
            np.zeros(count, dtype=np.uint32),
            ReferenceState.start(count),
        )  # fmt: skip


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
    moving: ReferenceModel | None = None
    injects: bool = False
    holds: bool = False

    def duties(
        self, voltage: Pair[SingleArray], v_dc: SingleArray, current: Pair[SingleArray]
    ) -> Singles:
        """Duty cycles of a voltage in V and currents in A, both alpha and beta."""
        return three_leg_duties(self.modulation, voltage, v_dc, current)

    def current_control(
        self, state: ControlState, measured: SingleArray, reference: Singles
    ) -> Singles:
        """Duty cycles from samples (N, 6): i_a, i_b, i_c, theta_e, omega_m, v_dc,
        and references (d, q) in A.
        """
        gains = self.gains
        i_a, i_b, i_c, theta, omega_m, v_dc = (
            np.ascontiguousarray(column) for column in measured.T
        )
        omega_e = gains["pole_pairs"] * omega_m
        v_max = gains["voltage_share"] * v_dc
        if state.added is not None:
            x, y = state.added
            v_max = v_max - np.sqrt((x * x) + (y * y))
        current = clarke(SINGLE, Triple(i_a, i_b, i_c))
        now, ahead = rotation(theta), small_rotation(omega_e * gains["advance"])
        i_d, i_q = park(SINGLE, current, now)
        error_d, error_q = reference[0] - i_d, reference[1] - i_q
        integral_d = state.d + (gains["d"][1] * error_d)
        integral_q = state.q + (gains["q"][1] * error_q)
        wanted_d = ((gains["d"][0] * error_d) + integral_d) - (omega_e * (gains["l_q"] * i_q))
        wanted_q = ((gains["q"][0] * error_q) + integral_q) + (
            omega_e * ((gains["l_d"] * i_d) + gains["psi_pm"])
        )
        square = (wanted_d * wanted_d) + (wanted_q * wanted_q)
        told = (square < _UNKNOWN_SQUARE) & (v_max >= _ZERO)
        state.moving.square = np.where(told, square, state.moving.square)
        within = (square - (v_max * np.abs(v_max))) <= _ZERO
        short = ~within & (square < _UNKNOWN_SQUARE) & (v_max >= _ZERO)
        share = np.where(short, v_max / np.sqrt(np.where(short, square, _ONE)), _ONE)
        known = within | short
        v_d, v_q = (
            np.where(known, share * wanted_d, _ZERO),
            np.where(known, share * wanted_q, _ZERO),
        )
        back_d, back_q = gains["d"][2] * (v_d - wanted_d), gains["q"][2] * (v_q - wanted_q)
        next_d = np.where(short, integral_d + back_d, integral_d)
        next_q = np.where(short, integral_q + back_q, integral_q)
        state.d, state.q = np.where(known, next_d, state.d), np.where(known, next_q, state.q)
        state.reference = reference
        voltage = park_inverse(SINGLE, (v_d, v_q), turned(now, ahead))
        if state.added is not None:
            voltage = Pair(voltage.x + state.added[0], voltage.y + state.added[1])
        state.v = voltage = overmodulated(self.overmodulation, voltage, v_dc)
        if MODULATORS[self.modulation].kind == "centred" and self.overmodulation == "none":
            return centred_duties(voltage, v_dc)
        return self.duties(voltage, v_dc, current)

    def torque_control(
        self, state: ControlState, measured: SingleArray, torque: SingleArray
    ) -> Singles:
        """Duty cycles for a torque in N m."""
        asked = torque if self.moving is None else self.moving.ramped_torque(state.moving, torque)
        v_max = self.gains["voltage_share"] * measured[:, 5]
        if self.weakening is None:
            reference: Singles = self.reference.currents(asked)
        else:
            omega_e = self.gains["pole_pairs"] * measured[:, 4]
            reference = self.weakening.currents(asked, self.reference_share * v_max, omega_e)
        state.torque = torque
        if self.moving is not None:
            reference = self.moving.weakened(state.moving, v_max, reference)
            reference = self.moving.ramped_current(state.moving, reference)
        if self.holds:
            reference = (reference[0] + state.held[0], reference[1] + state.held[1])
        return self.current_control(state, measured, reference)

    def speed_loop(
        self, state: ControlState, omega_m: SingleArray, reference: SingleArray
    ) -> SingleArray:
        """Torque reference in N m for a speed in rad/s."""
        step = None if self.moving is None else self.moving.torque_step
        return speed_loop(self.gains, self.ratio, state, omega_m, reference, step)

    def speed_control(
        self, state: ControlState, measured: SingleArray, reference: SingleArray
    ) -> Singles:
        """Duty cycles for a speed in rad/s."""
        omega_m = np.ascontiguousarray(measured[:, 4])
        return self.torque_control(state, measured, self.speed_loop(state, omega_m, reference))


class SpeedLoopState(Protocol):
    """What the speed loop keeps, arrays of shape (N,)."""

    speed: SingleArray
    omega_m: SingleArray
    torque: SingleArray
    count: NDArray[np.uint32]


def speed_loop(
    gains: Mapping[str, Any],
    ratio: int,
    state: SpeedLoopState,
    omega_m: SingleArray,
    reference: SingleArray,
    torque_step: np.float32 | None = None,
) -> SingleArray:
    """Torque reference in N m, as ``<prefix>_speed_loop``.

    Args:
        gains: As of `ControlModel`: ``speed``, ``torque_max`` and ``speed_filter``.
        ratio: Current samples per speed sample.
        state: What the loop keeps; it is changed.
        omega_m, reference: Mechanical speed and its reference in rad/s, shape (N,).
        torque_step: Largest change of the torque per current sample in N m, None where there is no
            limit.
    """
    _, ki_ts, tracking = gains["speed"]
    most = gains["torque_max"]
    filtered = state.omega_m + (gains["speed_filter"] * (omega_m - state.omega_m))
    state.omega_m = np.where(np.abs(omega_m) < _UNKNOWN, filtered, state.omega_m)
    due = (state.count == 0) & (np.abs(reference) < _UNKNOWN)
    error = reference - state.omega_m
    wanted = _pi_output(gains["speed"], state.speed, error)
    high, low = most, -most
    if torque_step is not None:
        step = np.float32(ratio) * torque_step
        high, low = np.minimum(state.torque + step, most), np.maximum(state.torque - step, -most)
    limited = np.where(wanted > high, high, np.where(wanted < low, low, wanted))
    integral = state.speed + ((ki_ts * error) + (tracking * (limited - wanted)))
    state.torque = np.where(due, limited, state.torque)
    state.speed = np.where(due, integral, state.speed)
    state.count = np.where(state.count + 1 < ratio, state.count + 1, 0).astype(np.uint32)
    return state.torque


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
    if MODULATORS[modulation].kind == "centred":
        centred = centred_duties(voltage, v_dc)
        return tuple(np.where(v_dc > _ZERO, one, _HALF) for one in centred)
    v = clarke_inverse(SINGLE, voltage)
    compares_currents = MODULATORS[modulation].compared == "currents"
    i = clarke_inverse(SINGLE, current) if compares_currents else v
    turn = _turn(modulation, voltage, current)
    zero = zero_sequence_of(SINGLE, modulation, v, i, v_dc, voltage, turn)
    powered = v_dc > _ZERO
    scale = np.where(powered, _ONE / np.where(powered, v_dc, _ONE), _ZERO)
    duty = (np.where(powered, (phase + zero) * scale, _HALF) for phase in v)
    return tuple(_clamped(one) for one in duty)


def _clamped(duty: SingleArray) -> SingleArray:
    """Within 0 to 1; 0 for not-a-number."""
    return np.where(duty > _ONE, _ONE, np.where(duty > _ZERO, duty, _ZERO))


def centred_duties(voltage: Pair[SingleArray], v_dc: SingleArray) -> Singles:
    """Duty cycles of three legs with a centred zero sequence, as ``<prefix>_centred_duties``.

    Args:
        voltage: Alpha and beta in V, shape (N,); 0 where ``v_dc`` is not above 0.
        v_dc: DC-link voltage in V, shape (N,).
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = _ONE / v_dc
        alpha = scale * voltage.x
        middle = -_HALF * alpha
        side = np.float32(0.8660254) * (scale * voltage.y)
        high, low = middle + np.abs(side), middle - np.abs(side)
        above = alpha > high
        below = ~above & (alpha < low)
        high, low = np.where(above, alpha, high), np.where(below, alpha, low)
        zero = _HALF - (_HALF * (high + low))
        duty = alpha + zero, (middle + side) + zero, (middle - side) + zero
        inside = (high + zero) <= _INSIDE
    beyond = (np.where(v_dc > _ZERO, _clamped(one), _HALF) for one in duty)
    return tuple(np.where(inside, one, other) for one, other in zip(duty, beyond, strict=True))


def _turn(
    modulation: ModulationName, voltage: Pair[SingleArray], current: Pair[SingleArray]
) -> Pair[SingleArray] | None:
    """Delay at which the references are compared, None where they are compared as they are."""
    rule = MODULATORS[modulation]
    if rule.delay is not None:
        return Pair(*(np.full_like(voltage.x, value) for value in rule.delay))
    return load_turn(voltage, current) if rule.compared == "load angle" else None


def _pi_output(gains: Singles, integral: SingleArray, error: SingleArray) -> SingleArray:
    return gains[0] * error + (integral + gains[1] * error)
