"""The C functions of ``control.h.j2`` on numpy arrays of float32, many drives side by side:
same operations, same bits.

The compiled code equals it bit for bit without contraction of products and
sums (-ffp-contract=off).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.modulation.hexagon import overmodulated
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.zero_sequence import load_turn, zero_sequence_of
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.current_reference.forms import FloatReference
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.reports.c_code.float32_functions import SINGLE, rotation, small_rotation, turned
from dqforge.reports.control.reference_model import ReferenceModel, ReferenceState

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
