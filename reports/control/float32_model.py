"""The C functions of ``control.h.j2`` on numpy arrays of float32, many drives side by side:
same operations, same bits.

The compiled code equals it bit for bit without contraction of products and
sums (-ffp-contract=off).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.modulation.hexagon import overmodulated
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.zero_sequence import load_turn, zero_sequence_of
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse, park, park_inverse
from dqforge.optimizer.current_reference.forms import FloatReference
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.reports.c_code.float32_functions import SINGLE, rotation, wrap

Singles = tuple[SingleArray, ...]


_UNKNOWN = np.float32(1.0e15)  # beyond, and not-a-number


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

    @classmethod
    def start(cls, count: int) -> ControlState:
        """Everything at rest."""
        zeros = [np.zeros(count, dtype=np.float32) for _ in range(9)]
        return cls(
            zeros[0], zeros[1], zeros[2], (zeros[3], zeros[4]), (zeros[5], zeros[6]), zeros[7],
            zeros[8],
            np.zeros(count, dtype=np.uint32),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class ControlModel:
    """The control functions of one header.

    Parameters
    ----------
    gains:
        Members of ``<prefix>_control_gains_t`` by name, float32: ``d``, ``q`` and ``speed`` are
        (kp, ki_ts, tracking); numbers, or arrays of shape (N,) where the drives differ.
    ratio:
        Current samples per speed sample.
    modulation:
        The modulator.
    reference:
        Current references of the torque.
    weakening:
        Current references of torque, voltage and speed, None where there are none.
    overmodulation:
        What becomes of a voltage beyond the circle in the hexagon.
    """

    gains: Mapping[str, Any]
    ratio: int
    modulation: ModulationName
    reference: FloatReference
    weakening: DropReference | None = None
    overmodulation: OvermodulationName = "none"

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
        current = clarke(SINGLE, Triple(i_a, i_b, i_c))
        i_d, i_q = park(SINGLE, current, rotation(wrap(theta)))
        error_d, error_q = reference[0] - i_d, reference[1] - i_q
        wanted_d = _pi_output(gains["d"], state.d, error_d) - (omega_e * (gains["l_q"] * i_q))
        wanted_q = _pi_output(gains["q"], state.q, error_q) + (
            omega_e * ((gains["l_d"] * i_d) + gains["psi_pm"])
        )
        length = np.sqrt((wanted_d * wanted_d) + (wanted_q * wanted_q))
        beyond = length > v_max
        share = np.where(beyond, v_max / np.where(beyond, length, _ONE), _ONE)
        known = (length < _UNKNOWN) & (v_max >= _ZERO)
        v_d, v_q = (
            np.where(known, share * wanted_d, _ZERO),
            np.where(known, share * wanted_q, _ZERO),
        )
        next_d = state.d + ((gains["d"][1] * error_d) + (gains["d"][2] * (v_d - wanted_d)))
        next_q = state.q + ((gains["q"][1] * error_q) + (gains["q"][2] * (v_q - wanted_q)))
        state.d, state.q = np.where(known, next_d, state.d), np.where(known, next_q, state.q)
        state.reference = reference
        turn = rotation(wrap(theta + (omega_e * gains["advance"])))
        voltage = park_inverse(SINGLE, (v_d, v_q), turn)
        state.v = voltage = overmodulated(self.overmodulation, voltage, v_dc)
        return self.duties(voltage, v_dc, current)

    def torque_control(
        self, state: ControlState, measured: SingleArray, torque: SingleArray
    ) -> Singles:
        """Duty cycles for a torque in N m."""
        state.torque = torque
        if self.weakening is None:
            return self.current_control(state, measured, self.reference.currents(torque))
        v_max, omega_e = (
            self.gains["voltage_share"] * measured[:, 5],
            self.gains["pole_pairs"] * measured[:, 4],
        )
        return self.current_control(
            state, measured, self.weakening.currents(torque, v_max, omega_e)
        )

    def speed_loop(
        self, state: ControlState, omega_m: SingleArray, reference: SingleArray
    ) -> SingleArray:
        """Torque reference in N m for a speed in rad/s."""
        return speed_loop(self.gains, self.ratio, state, omega_m, reference)

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
) -> SingleArray:
    """Torque reference in N m, as ``<prefix>_speed_loop``.

    Parameters
    ----------
    gains:
        As of `ControlModel`: ``speed``, ``torque_max`` and ``speed_filter``.
    ratio:
        Current samples per speed sample.
    state:
        What the loop keeps; it is changed.
    omega_m, reference:
        Mechanical speed and its reference in rad/s, shape (N,).
    """
    _, ki_ts, tracking = gains["speed"]
    most = gains["torque_max"]
    filtered = state.omega_m + (gains["speed_filter"] * (omega_m - state.omega_m))
    state.omega_m = np.where(np.abs(omega_m) < _UNKNOWN, filtered, state.omega_m)
    due = (state.count == 0) & (np.abs(reference) < _UNKNOWN)
    error = reference - state.omega_m
    wanted = _pi_output(gains["speed"], state.speed, error)
    limited = np.where(wanted > most, most, np.where(wanted < -most, -most, wanted))
    step = state.speed + ((ki_ts * error) + (tracking * (limited - wanted)))
    state.torque = np.where(due, limited, state.torque)
    state.speed = np.where(due, step, state.speed)
    state.count = np.where(state.count + 1 < ratio, state.count + 1, 0).astype(np.uint32)
    return state.torque


def three_leg_duties(
    modulation: ModulationName,
    voltage: Pair[SingleArray],
    v_dc: SingleArray,
    current: Pair[SingleArray],
) -> Singles:
    """Duty cycles of three legs, as ``<prefix>_duties``.

    Parameters
    ----------
    modulation:
        The modulator.
    voltage, current:
        Alpha and beta in V and A, shape (N,).
    v_dc:
        DC-link voltage in V, shape (N,).
    """
    v = clarke_inverse(SINGLE, voltage)
    compares_currents = MODULATORS[modulation].compared == "currents"
    i = clarke_inverse(SINGLE, current) if compares_currents else v
    turn = _turn(modulation, voltage, current)
    zero = zero_sequence_of(SINGLE, modulation, v, i, v_dc, voltage, turn)
    powered = v_dc > _ZERO
    scale = np.where(powered, _ONE / np.where(powered, v_dc, _ONE), _ZERO)
    duty = (np.where(powered, (phase + zero) * scale, _HALF) for phase in v)
    return tuple(np.where(one > _ONE, _ONE, np.where(one > _ZERO, one, _ZERO)) for one in duty)


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
