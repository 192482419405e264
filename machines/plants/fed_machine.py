"""A machine fed by a switched bridge, solved exactly between the switching instants.

At constant speed the machine is a linear system in rotor coordinates. With the voltage vector of a
switching state, which stands still in the stator, as two more states it is one without input, x' =
M x, whose Taylor series converges to rounding over the short steps taken here. An instant within a
step is then a polynomial away.

Source: voltage equations of paper 000, (1); the zero sequence of a star point tied to the
middle of the DC link added.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, phases_to_dq

# Places in the state: currents, voltages, integrals of the current errors, and the constant 1.
I_D, I_Q, I_0, V_D, V_Q, V_0, Z_D, Z_Q, ONE = range(9)


STATES = 9


# Terms of the Taylor series, and the longest step in terms of the fastest time constant:
# 0.1^9 / 9! is 3e-15.
_TERMS = 9


_RELATIVE_STEP = 0.1


@dataclass(frozen=True, slots=True)
class BridgeDrive:
    """A star-connected machine at an ideal two-level bridge.

    Args:
        machine: Machine with constant inductances; r_s may be 0.
        v_dc: DC-link voltage in V, constant.
        neutral_inductance: Zero-sequence inductance in H of a star point that is tied to the middle
            of the DC link, None where the star point is isolated. Phases without mutual coupling
            have l_d = l_q = neutral_inductance.

    Raises:
        InputError: A voltage or an inductance that is not positive.
    """

    machine: LinearMachine
    v_dc: float
    neutral_inductance: float | None = None

    def __post_init__(self) -> None:
        inductances = {"l_d": self.machine.l_d, "l_q": self.machine.l_q}
        if self.neutral_inductance is not None:
            inductances["neutral_inductance"] = self.neutral_inductance
        for name, value, unit in [
            ("v_dc", self.v_dc, "V"),
            *((key, value, "H") for key, value in inductances.items()),
        ]:
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")


@dataclass(frozen=True, slots=True)
class Plant:
    """The drive at N operating points of constant speed and constant references.

    Args:
        drive: Machine and bridge.
        i_d, i_q: Current references in A (peak), shape (N,).
        omega_e: Electrical speed in rad/s, shape (N,), not 0.
        matrix: M of x' = M x, shape (N, 9, 9).
        number: Number of each point, shape (N,), by which a controller with a memory finds its own.
    """

    drive: BridgeDrive
    i_d: FloatArray
    i_q: FloatArray
    omega_e: FloatArray
    matrix: FloatArray
    number: NDArray[np.intp]

    @property
    def longest_step(self) -> FloatArray:
        """Longest time in s over which `series` is exact to rounding, shape (N,)."""
        machine = self.drive.machine
        inductances = [machine.l_d, machine.l_q, *([self.drive.neutral_inductance or machine.l_d])]
        coupling = np.abs(self.omega_e) * max(machine.l_d / machine.l_q, machine.l_q / machine.l_d)
        return _RELATIVE_STEP / np.maximum(coupling, machine.r_s / min(inductances))

    def part(self, index: BoolArray | slice) -> Plant:
        """The plant at some of the points."""
        return Plant(
            self.drive,
            self.i_d[index],
            self.i_q[index],
            self.omega_e[index],
            self.matrix[index],
            self.number[index],
        )

    def start(
        self, legs: BoolArray, integral: tuple[FloatArray, FloatArray] | None = None
    ) -> FloatArray:
        """State (N, 9) at the angle 0 with the currents on their references.

        Args:
            legs: True where the upper switch is on, shape (N, 3).
            integral: Integrals of the current errors in A s, shape (N,) each; zero if None.
        """
        state = np.zeros((self.i_d.size, STATES))
        state[:, I_D], state[:, I_Q], state[:, ONE] = self.i_d, self.i_q, 1.0
        if integral is not None:
            state[:, Z_D], state[:, Z_Q] = integral
        return self.switched(state, np.zeros(self.i_d.size), legs)

    def switched(self, state: FloatArray, theta_e: FloatArray, legs: BoolArray) -> FloatArray:
        """State (..., 9) with the voltages of the switching state (..., 3) at the
        electrical angle (...) in rad.
        """
        leg = self.drive.v_dc * (legs - 0.5)
        changed = np.array(state)
        changed[..., V_D], changed[..., V_Q] = phases_to_dq(leg, theta_e)
        changed[..., V_0] = 0.0 if self.drive.neutral_inductance is None else np.mean(leg, axis=-1)
        return changed

    def series(self, state: FloatArray) -> FloatArray:
        """Taylor coefficients (K, ..., N, 9) of the solution from the state (..., N, 9) on."""
        terms = [state]
        for order in range(1, _TERMS):
            terms.append(np.matmul(self.matrix, terms[-1][..., None])[..., 0] / order)
        return np.stack(terms)

    def advance(self, state: FloatArray, duration: float) -> FloatArray:
        """State (..., N, 9) after `duration` in s with the switching state unchanged."""
        count = max(1, math.ceil(duration / float(np.min(self.longest_step))))
        for _ in range(count):
            state = evaluate(self.series(state), np.full(state.shape[:-1], duration / count))
        return state

    def phase_currents(self, state: FloatArray, theta_e: FloatArray) -> FloatArray:
        """Phase currents in A (..., 3) of states (..., 9) at electrical angles (...) in rad."""
        return dq_to_phases(state[..., I_D], state[..., I_Q], theta_e) + state[..., I_0, None]

    def phase_errors(self, state: FloatArray, theta_e: FloatArray) -> FloatArray:
        """Phase currents less their references in A, shape (..., N, 3), of states (..., N, 9)."""
        difference = dq_to_phases(state[..., I_D] - self.i_d, state[..., I_Q] - self.i_q, theta_e)
        return np.asarray(difference + state[..., I_0, None], dtype=np.float64)


def evaluate(series: FloatArray, time: FloatArray) -> FloatArray:
    """States (..., 9) after the times (...) in s from the coefficients (K, ..., 9) of
    `Plant.series`.
    """
    value = series[-1]
    for term in series[-2::-1]:
        value = value * time[..., None] + term
    return np.asarray(value, dtype=np.float64)


def build_plant(
    drive: BridgeDrive,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_e: FloatArray,
    *,
    rotating: bool = True,
) -> Plant:
    """The drive at N operating points.

    Args:
        drive: Machine and bridge.
        i_d, i_q, omega_e: Current references in A (peak) and electrical speed in rad/s, shape (N,).
        rotating: Whether the errors are integrated in rotor coordinates, or in those of the stator.
    """
    machine = drive.machine
    matrix = np.zeros((i_d.size, STATES, STATES))
    matrix[:, I_D, I_D], matrix[:, I_Q, I_Q] = (
        -machine.r_s / machine.l_d,
        -machine.r_s / machine.l_q,
    )
    matrix[:, I_D, V_D], matrix[:, I_Q, V_Q] = 1.0 / machine.l_d, 1.0 / machine.l_q
    matrix[:, I_D, I_Q] = omega_e * machine.l_q / machine.l_d
    matrix[:, I_Q, I_D] = -omega_e * machine.l_d / machine.l_q
    matrix[:, I_Q, ONE] = -omega_e * machine.psi_pm / machine.l_q
    if drive.neutral_inductance is not None:
        matrix[:, I_0, I_0], matrix[:, I_0, V_0] = (
            -machine.r_s / drive.neutral_inductance,
            1.0 / drive.neutral_inductance,
        )
    matrix[:, V_D, V_Q], matrix[:, V_Q, V_D] = omega_e, -omega_e
    matrix[:, Z_D, I_D] = matrix[:, Z_Q, I_Q] = -1.0
    matrix[:, Z_D, ONE], matrix[:, Z_Q, ONE] = i_d, i_q
    if not rotating:
        matrix[:, Z_D, Z_Q], matrix[:, Z_Q, Z_D] = omega_e, -omega_e
    return Plant(drive, i_d, i_q, omega_e, matrix, np.arange(i_d.size))
