"""Torque, squared voltage and loss at trial currents, with gradients and second derivatives,
for many points at once.

The batched solver works on these three functions alone; linear machines and flux maps
differ only in their `FluxJet`.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import FluxJet, Machine
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class Terms:
    """A function of (i_d, i_q) with its derivatives, arrays of shape (N,)."""

    value: FloatArray
    d: FloatArray
    q: FloatArray
    dd: FloatArray
    dq: FloatArray
    qq: FloatArray


@dataclass(frozen=True, slots=True)
class LossCoefficients:
    """Loss in W as a function of currents and flux linkage at each point's speed,
    arrays of shape (N,) or scalars.

    P = square |i|^2 + linear |i| + iron |psi|^2, with ``square`` in W/A^2 (copper, with its AC
    factor, and what of the inverter is proportional to the squared current), ``linear`` in W/A
    (switching, thresholds) and ``iron`` in W/Wb^2.
    """

    square: FloatArray
    linear: FloatArray
    iron: FloatArray

    def take(self, index: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> LossCoefficients:
        """Coefficients of some points."""
        return LossCoefficients(self.square[index], self.linear[index], self.iron[index])


def torque_terms(machine: Machine, jet: FluxJet, i_d: FloatArray, i_q: FloatArray) -> Terms:
    """Torque in N m, T = 3/2 p (psi_d i_q - psi_q i_d).

    Args:
        machine: Any machine.
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    k = 1.5 * machine.pole_pairs
    return Terms(
        value=k * (jet.psi_d * i_q - jet.psi_q * i_d),
        d=k * (jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q),
        q=k * (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d),
        dd=k * (jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd),
        dq=k * (jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq),
        qq=k * (2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d),
    )


def voltage_terms(
    machine: Machine, jet: FluxJet, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray
) -> Terms:
    """Squared steady-state phase voltage in V^2, the resistance drop included.

    Args:
        machine: Any machine.
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
        omega_e: Electrical speeds in rad/s, shape (N,).
    """
    r_s = machine.r_s
    v_d, v_q = r_s * i_d - omega_e * jet.psi_q, r_s * i_q + omega_e * jet.psi_d
    d_d, d_q = r_s - omega_e * jet.l_qd, -omega_e * jet.l_qq
    q_d, q_q = omega_e * jet.l_dd, r_s + omega_e * jet.l_dq
    return Terms(
        value=v_d * v_d + v_q * v_q,
        d=2.0 * (v_d * d_d + v_q * q_d),
        q=2.0 * (v_d * d_q + v_q * q_q),
        dd=2.0 * (d_d * d_d + q_d * q_d + omega_e * (v_q * jet.d_dd - v_d * jet.q_dd)),
        dq=2.0 * (d_d * d_q + q_d * q_q + omega_e * (v_q * jet.d_dq - v_d * jet.q_dq)),
        qq=2.0 * (d_q * d_q + q_q * q_q + omega_e * (v_q * jet.d_qq - v_d * jet.q_qq)),
    )


def loss_terms(
    coefficients: LossCoefficients, jet: FluxJet, i_d: FloatArray, i_q: FloatArray, soft: float
) -> Terms:
    """Loss in W.

    ``soft`` in A rounds the tip of |i| at zero current, where it has no derivative.

    Args:
        coefficients: Of currents and flux linkages, at the speeds of the points, shape (N,).
        jet: Flux linkages in Wb and their derivatives at the currents, shape (N,).
        i_d, i_q: Currents in A (peak), shape (N,).
        soft: Rounding of the tip in A.
    """
    square, linear, iron = coefficients.square, coefficients.linear, coefficients.iron
    magnitude = np.sqrt(i_d * i_d + i_q * i_q + soft * soft)
    slope = linear / magnitude
    bend = slope / (magnitude * magnitude)
    psi_d, psi_q = jet.psi_d, jet.psi_q
    return Terms(
        value=square * (i_d * i_d + i_q * i_q)
        + linear * (magnitude - soft)
        + iron * (psi_d * psi_d + psi_q * psi_q),
        d=(2.0 * square + slope) * i_d + 2.0 * iron * (psi_d * jet.l_dd + psi_q * jet.l_qd),
        q=(2.0 * square + slope) * i_q + 2.0 * iron * (psi_d * jet.l_dq + psi_q * jet.l_qq),
        dd=2.0 * square
        + slope
        - bend * i_d * i_d
        + 2.0 * iron * (jet.l_dd**2 + jet.l_qd**2 + psi_d * jet.d_dd + psi_q * jet.q_dd),
        dq=-bend * i_d * i_q
        + 2.0
        * iron
        * (jet.l_dd * jet.l_dq + jet.l_qd * jet.l_qq + psi_d * jet.d_dq + psi_q * jet.q_dq),
        qq=2.0 * square
        + slope
        - bend * i_q * i_q
        + 2.0 * iron * (jet.l_dq**2 + jet.l_qq**2 + psi_d * jet.d_qq + psi_q * jet.q_qq),
    )


def current_terms(i_d: FloatArray, i_q: FloatArray) -> Terms:
    """Squared current magnitude in A^2.

    Args:
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    two, zero = np.full_like(i_d, 2.0), np.zeros_like(i_d)
    return Terms(i_d * i_d + i_q * i_q, 2.0 * i_d, 2.0 * i_q, two, zero, two)


def newton_step(
    first: Terms, second: Terms, target_1: FloatArray | float, target_2: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Step (d i_d, d i_q) in A towards first = target_1 and second = target_2, shape (N,).

    The step is nan or inf where the gradients are parallel.
    """
    gap_1: FloatArray = target_1 - first.value
    gap_2: FloatArray = target_2 - second.value
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (gap_1 * second.q - first.q * gap_2) * scale, (
            first.d * gap_2 - gap_1 * second.d
        ) * scale


def cross_of_gradients(first: Terms, second: Terms) -> Terms:
    """Cross product of two gradients, zero where the level curves touch, with its own gradient.

    The second derivatives are not needed and are the gradient again in place of a third-order term.

    Args:
        first, second: Values with first and second derivatives by the currents in A, shape (N,).
    """
    d = first.dd * second.q + first.d * second.dq - first.dq * second.d - first.q * second.dd
    q = first.dq * second.q + first.d * second.qq - first.qq * second.d - first.q * second.dq
    value = first.d * second.q - first.q * second.d
    return Terms(value, d, q, d, q, q)
