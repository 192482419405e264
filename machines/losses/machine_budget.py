"""Losses of a machine at operating points as its terminals see them,
the winding as warm as its loss makes it.

Every loss has its place in the equivalent circuit, so that the power at the terminals is the sum of
losses and shaft power without remainder: copper and magnet loss as resistances in series, iron loss
as a conductance beside the back-EMF. The currents of a reference are those that make the torque;
the iron's current comes on top.

Source of the circuit: T. M. Jahns, "Flux-weakening regime operation of an interior permanent-magnet
synchronous motor drive", IEEE Transactions on Industry Applications IA-23(4), 1987,
doi:10.1109/TIA.1987.4504966 (without iron loss); S. Morimoto et al., "Loss minimization control of
permanent magnet synchronous motor drives", IEEE Transactions on Industrial Electronics 41(5), 1994,
doi:10.1109/41.315269 (with it).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineOrBatch
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.records import dataclass

COPPER_COEFFICIENT = 0.00393  # Relative change of the resistance of copper per kelvin, at 20 degC.


@dataclass(frozen=True, slots=True)
class WindingHeat:
    """How warm the winding becomes.

    Args:
        thermal_resistance: Winding to coolant in K/W.
        coolant_temperature: In degC.
        reference_temperature: Temperature in degC at which the machine's r_s holds.
        coefficient: Relative change of r_s per kelvin, in 1/K, at the reference temperature.
    """

    thermal_resistance: float
    coolant_temperature: float = 25.0
    reference_temperature: float = 20.0
    coefficient: float = COPPER_COEFFICIENT

    def __post_init__(self) -> None:
        """Refuse what no winding has."""
        values = (
            self.thermal_resistance,
            self.coolant_temperature,
            self.reference_temperature,
            self.coefficient,
        )
        if (
            not all(math.isfinite(value) for value in values)
            or self.thermal_resistance < 0.0
            or self.coefficient < 0.0
        ):
            raise InputError(
                "winding: thermal resistance and coefficient must be zero or positive finite "
                "numbers"
            )
        if 1.0 + self.coefficient * (self.coolant_temperature - self.reference_temperature) <= 0.0:
            raise InputError(
                "winding: the resistance vanishes at the coolant temperature; check the coefficient"
            )


@dataclass(frozen=True, slots=True)
class MachineBudget:
    """Losses of a machine and what its terminals see, arrays of the shape (...).

    Args:
        torque, shaft_power: In N m and W.
        copper, iron, magnet: Losses in W; copper with the AC factor, at the winding temperature.
        resistance: Resistance in Ohm that makes the copper loss.
        winding_temperature: In degC, NaN without data of the winding's heat or where it is not
            steady.
        steady: False where the winding temperature runs away; copper loss, resistance and voltages
            are NaN there.
        i_d, i_q, v_d, v_q: Currents in A and voltages in V at the terminals (peak).
    """

    torque: FloatArray
    shaft_power: FloatArray
    copper: FloatArray
    iron: FloatArray
    magnet: FloatArray
    resistance: FloatArray
    winding_temperature: FloatArray
    steady: BoolArray
    i_d: FloatArray
    i_q: FloatArray
    v_d: FloatArray
    v_q: FloatArray


def warm_ratio(
    heat: WindingHeat, cold_loss: FloatArray, extra: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Resistance over r_s of the steady winding, shape (...), and where it is steady.

    Args:
        heat: How warm the winding becomes.
        cold_loss: Copper loss c in W with r_s, shape (...).
        extra: Relative rise k of the resistance by eddy currents in cold copper, shape (...).

    Notes:
        With r = 1 + alpha (T - T_ref) and the copper loss c (r + k / r), whose eddy currents warm
        copper damps: (1 - g) r^2 - b r - g k = 0 with g = alpha R_th c and b = 1 + alpha (T_coolant
        - T_ref).
    """
    gain = heat.coefficient * heat.thermal_resistance * cold_loss
    base = 1.0 + heat.coefficient * (heat.coolant_temperature - heat.reference_temperature)
    steady = np.asarray(gain < 1.0)
    rest = np.where(steady, 1.0 - gain, 1.0)
    ratio = (base + np.sqrt(base * base + 4.0 * rest * gain * extra)) / (2.0 * rest)
    return np.where(steady, ratio, np.nan), steady


def machine_budget(
    machine: MachineOrBatch,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_m: FloatArray,
    *,
    loss: MachineLoss = NO_EXTRA_LOSS,
    heat: WindingHeat | None = None,
) -> MachineBudget:
    """Losses and terminal quantities of a machine in the steady state.

    ::

        e     = j omega_e psi
              back-EMF, psi and the torque from the currents given
        i_t   = i + e P_iron / (3/2 |e|^2)              current at the terminals
        R     = r_s (r + k_ac omega_e^2 / r)            r = 1 + alpha (T_winding - T_ref)
        v     = (R + 2/3 k_m omega_e^2) i_t + e
        3/2 Re(v i_t*) = 3/2 R |i_t|^2 + k_m omega_e^2 |i_t|^2 + P_iron + T omega_m

    Args:
        machine: Any machine, or one per point.
        i_d, i_q, omega_m: Currents in A (peak) that make the torque, and mechanical speed in rad/s,
            of one shape (...).
        loss: AC copper, iron and magnet loss.
        heat: How warm the winding becomes; None keeps r_s. Only the copper loss of the fundamental
            heats it.

    Returns:
        MachineBudget
    """
    omega_e = machine.pole_pairs * omega_m
    psi_d, psi_q = machine.flux(i_d, i_q)
    square = psi_d * psi_d + psi_q * psi_q
    iron = loss.iron_factor(omega_e) * square
    # e P / (3/2 |e|^2) with e = j omega psi: the flux linkage cancels.
    turning = np.where(omega_e == 0.0, 1.0, omega_e)
    conductance = np.where(omega_e == 0.0, 0.0, loss.iron_factor(omega_e) / (1.5 * turning))
    t_d, t_q = i_d - conductance * psi_q, i_q + conductance * psi_d
    current = t_d * t_d + t_q * t_q
    extra = loss.ac_copper * omega_e * omega_e
    steady = np.ones(current.shape, dtype=np.bool_)
    ratio, temperature = np.ones(current.shape), np.full(current.shape, np.nan)
    if heat is not None:
        ratio, steady = warm_ratio(heat, 1.5 * machine.r_s * current, extra)
        temperature = (
            heat.coolant_temperature
            + heat.thermal_resistance * 1.5 * machine.r_s * current * (ratio + extra / ratio)
        )
    resistance = machine.r_s * (ratio + extra / ratio)
    series = resistance + loss.magnet * omega_e * omega_e / 1.5
    torque = 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
    return MachineBudget(
        torque=torque,
        shaft_power=torque * omega_m,
        copper=1.5 * resistance * current,
        iron=iron,
        magnet=loss.magnet * omega_e * omega_e * current,
        resistance=resistance,
        winding_temperature=temperature,
        steady=steady,
        i_d=t_d,
        i_q=t_q,
        v_d=series * t_d - omega_e * psi_q,
        v_q=series * t_q + omega_e * psi_d,
    )
