"""Loss budgets: where the watts go at each operating point, and which control strategy and modulator loses least.

Copper loss of the machine, conduction and switching loss of the inverter, and its junction temperature, in the steady
state. Iron loss, friction and the losses that the current ripple causes are left out.

Source: paper 000, section 3 and Table 4, with the corrections on docs/loss-budget.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.inverter import Inverter, SwitchDevice
from dqforge.machines.modulation import BoolArray, in_linear_range, linear_limit, modulation_index
from dqforge.machines.semiconductors import (
    bridge_load,
    junction_temperature,
    required_device,
    resistance_factor,
    thermal_balance,
    thermal_gain,
)
from dqforge.machines.settings import LoadPoint, LossSettings, ModulationName, Strategy
from dqforge.machines.synchronous import FloatArray, Machine, copper_loss

# Alternatives whose losses differ by less than this fraction are equally good; the one listed first is named.
_EQUAL_LOSS = 1e-9


@dataclass(frozen=True, slots=True)
class LossBudget:
    """Losses at operating points; all arrays have one shape, (N,) unless said otherwise.

    Parameters
    ----------
    torque:
        Torque of the machine at the currents, in N m.
    copper:
        Copper loss of the machine in W.
    conduction, switching:
        Losses of the inverter in W.
    inverter:
        Conduction plus switching loss in W.
    total:
        Copper plus inverter loss in W.
    junction_temperature:
        Average junction temperature of a switch position in degC.
    voltage:
        Amplitude of the phase voltage in V, peak.
    modulation_index:
        That amplitude relative to six-step operation, 2 v_dc / pi.
    linear:
        False where the voltage is beyond the linear range of the modulator, which cannot make it there.
    thermally_stable:
        False where the junction temperature runs away; what depends on it is NaN there.
    cool_enough:
        False where the junction is hotter than the device permits.
    thermal_residual:
        Residual of the balance of heat, in K.
    ripple_copper, iron, ripple_iron, magnet, dead_time, capacitor:
        Losses in W that the complete budget counts besides (`complete_comparison`); zero in `loss_budget`.
    """

    torque: FloatArray
    copper: FloatArray
    conduction: FloatArray
    switching: FloatArray
    inverter: FloatArray
    total: FloatArray
    junction_temperature: FloatArray
    voltage: FloatArray
    modulation_index: FloatArray
    linear: BoolArray
    thermally_stable: BoolArray
    cool_enough: BoolArray
    thermal_residual: FloatArray
    ripple_copper: FloatArray
    iron: FloatArray
    ripple_iron: FloatArray
    magnet: FloatArray
    dead_time: FloatArray
    capacitor: FloatArray

    @property
    def feasible(self) -> BoolArray:
        """True where the modulator can make the voltage and the junction stays within its permitted temperature."""
        return self.linear & self.thermally_stable & self.cool_enough


@dataclass(frozen=True, slots=True)
class LossComparison:
    """Losses of S strategies with M modulators at P operating points.

    Parameters
    ----------
    strategies, modulations, points:
        Labels of the three axes.
    budget:
        Losses, arrays of the shape (S, M, P).
    saving:
        Total loss saved, in percent of that of the first strategy with the first modulator, shape (S, M, P); NaN where
        either of the two is not feasible or the first has no loss.
    best_strategy, best_modulation:
        Indices of the feasible alternative with the least total loss, shape (P,), or -1 where none is feasible. Of
        equally good alternatives the first, in the order of the labels.
    """

    strategies: tuple[Strategy, ...]
    modulations: tuple[ModulationName, ...]
    points: tuple[LoadPoint, ...]
    budget: LossBudget
    saving: FloatArray
    best_strategy: NDArray[np.intp]
    best_modulation: NDArray[np.intp]

    @property
    def best_labels(self) -> tuple[tuple[Strategy, ModulationName] | None, ...]:
        """Strategy and modulator with the least total loss at each point, or None where none is feasible."""
        indices = zip(self.best_strategy.tolist(), self.best_modulation.tolist(), strict=True)
        return tuple((self.strategies[s], self.modulations[m]) if s >= 0 else None for s, m in indices)


_NOT_COUNTED = ("ripple_copper", "iron", "ripple_iron", "magnet", "dead_time", "capacitor")


def loss_budget(
    machine: Machine,
    inverter: Inverter,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    modulation: ModulationName,
    *,
    on_runaway: Literal["raise", "mark"] = "raise",
) -> LossBudget:
    """Losses of machine and inverter in the steady state.

    Parameters
    ----------
    machine, inverter:
        The drive; the inverter with the data of its device.
    i_d, i_q:
        Currents in A (peak), broadcastable to the shape (N,) together with `omega_m`.
    omega_m:
        Mechanical speed in rad/s.
    modulation:
        The modulator.
    on_runaway:
        Whether points without a steady junction temperature are an error or only marked.

    Returns
    -------
    LossBudget
        Arrays of the shape (N,), or of the broadcast shape if it has more axes.

    Raises
    ------
    NoSolutionError
        At thermal runaway, if `on_runaway` is "raise".
    """
    points = (np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (i_d, i_q, omega_m))
    i_d, i_q, omega = np.broadcast_arrays(*points)
    v_d, v_q = machine.voltage(i_d, i_q, machine.pole_pairs * omega)
    voltage = np.hypot(v_d, v_q)
    load = bridge_load(inverter, modulation, v_d, v_q, i_d, i_q)
    bridge = thermal_balance(inverter, load)
    if on_runaway == "raise":
        _refuse_runaway(machine, omega, i_d, i_q, thermal_gain(inverter, load))
    copper = copper_loss(machine.r_s, i_d, i_q)
    hottest = required_device(inverter).max_junction_temperature
    bridge_total = bridge.conduction + bridge.switching
    return LossBudget(
        torque=machine.torque(i_d, i_q),
        copper=copper,
        conduction=bridge.conduction,
        switching=bridge.switching,
        inverter=bridge_total,
        total=copper + bridge_total,
        junction_temperature=bridge.junction_temperature,
        voltage=voltage,
        modulation_index=modulation_index(voltage, inverter.v_dc),
        linear=in_linear_range(modulation, voltage, inverter.v_dc),
        thermally_stable=bridge.thermally_stable,
        cool_enough=bridge.junction_temperature <= hottest,
        thermal_residual=bridge.thermal_residual,
        **{part: np.zeros(copper.shape) for part in _NOT_COUNTED},
    )


def _refuse_runaway(machine: Machine, omega_m: FloatArray, i_d: FloatArray, i_q: FloatArray, gain: FloatArray) -> None:
    if not np.all(np.isfinite(gain) & np.isfinite(omega_m)):
        raise InputError("loss budget: currents and speeds must be finite numbers")
    if np.all(gain < 1.0):
        return
    worst = np.unravel_index(np.argmax(gain), gain.shape)
    raise NoSolutionError(
        f"thermal runaway at {machine.torque(i_d, i_q)[worst]:.4g} N m and {omega_m[worst]:.4g} rad/s"
        f" ({np.hypot(i_d, i_q)[worst]:.4g} A): each kelvin at the junction adds losses that heat it by"
        f" {gain[worst]:.3g} K more, so that no temperature is steady ({np.count_nonzero(gain >= 1.0)} of {gain.size}"
        " points); lower the current, the thermal resistance or the on resistance"
    )


def compare(
    machine: Machine,
    inverter: Inverter,
    losses: LossSettings,
    currents: Mapping[Strategy, tuple[ArrayLike, ArrayLike]],
) -> LossComparison:
    """Loss budgets of every strategy with every modulator at every point.

    Alternatives that are not feasible at a point (voltage beyond the linear range, thermal runaway) are computed and
    marked, and take no part in the choice of the best.

    Parameters
    ----------
    machine, inverter:
        The drive; the inverter with the data of its device.
    losses:
        Operating points, strategies and modulators.
    currents:
        For each strategy (i_d, i_q) in A (peak), shape (P,) each, at the P points. NaN where the strategy has no
        currents for a point.

    Returns
    -------
    LossComparison
    """
    i_d, i_q = stack_currents(losses, currents)
    omega_m = np.array([point.omega_m for point in losses.points])
    budgets = [loss_budget(machine, inverter, i_d, i_q, omega_m, m, on_runaway="mark") for m in losses.modulations]
    budget = _stack_budgets(budgets)
    return ranked(losses, budget)


def ranked(losses: LossSettings, budget: LossBudget) -> LossComparison:
    """The comparison of budgets of the shape (S, M, P): savings, and the best of each point."""
    total = np.where(budget.feasible, budget.total, np.inf)
    strategy, modulation = _first_minimum(total)
    return LossComparison(
        strategies=losses.strategies,
        modulations=losses.modulations,
        points=losses.points,
        budget=budget,
        saving=_saving(total),
        best_strategy=strategy,
        best_modulation=modulation,
    )


def stack_currents(
    losses: LossSettings, currents: Mapping[Strategy, tuple[ArrayLike, ArrayLike]]
) -> tuple[FloatArray, FloatArray]:
    """Stack the currents of the strategies, shape (S, P) each."""
    missing = [name for name in losses.strategies if name not in currents]
    if missing:
        raise InputError(f"loss comparison: no currents are given for the strategies {', '.join(missing)}")
    shape = (len(losses.points),)
    stacked = []
    for axis in (0, 1):
        rows = {name: np.asarray(currents[name][axis], dtype=np.float64) for name in losses.strategies}
        for name, row in rows.items():
            if row.shape != shape:
                raise InputError(
                    f"loss comparison: the currents of {name} have the shape {row.shape}, but the points need {shape}"
                )
        stacked.append(np.stack(list(rows.values())))
    return stacked[0], stacked[1]


def _stack_budgets(budgets: Sequence[LossBudget]) -> LossBudget:
    """Join the budgets of M modulators, arrays (S, P), into one with arrays (S, M, P)."""
    names = [field.name for field in fields(LossBudget)]
    return LossBudget(**{name: np.stack([getattr(b, name) for b in budgets], axis=1) for name in names})


def _first_minimum(total: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Strategy and modulator of the least total loss (S, M, P), shape (P,) each, -1 where all are infinite."""
    flat = total.reshape(-1, total.shape[-1])
    least = np.min(flat, axis=0)
    first = np.argmax(flat <= least * (1.0 + _EQUAL_LOSS), axis=0)
    found = np.isfinite(least)
    return np.where(found, first // total.shape[1], -1), np.where(found, first % total.shape[1], -1)


def _saving(total: FloatArray) -> FloatArray:
    """Compute the saving in percent of the first alternative; total loss (S, M, P), infinite where not feasible."""
    first = np.broadcast_to(total[:1, :1], total.shape)
    valid = np.isfinite(total) & np.isfinite(first) & (first > 0.0)
    return np.where(valid, 100.0 * (1.0 - np.where(valid, total, 0.0) / np.where(valid, first, 1.0)), np.nan)


def calibrate_switching(
    total_loss: float,
    machine: Machine,
    inverter: Inverter,
    i_d: float,
    i_q: float,
    omega_m: float,
    modulation: ModulationName,
) -> SwitchDevice:
    """Scale the switching energies of a device so that the total loss at one measured point is met.

    Parameters
    ----------
    total_loss:
        Measured copper plus inverter loss in W at the point.
    machine, inverter:
        The drive; the inverter with the data of its device.
    i_d, i_q, omega_m, modulation:
        The measured point: currents in A (peak), mechanical speed in rad/s, and its modulator.

    Returns
    -------
    SwitchDevice
        The device with all three switching energies multiplied by one factor.

    Raises
    ------
    InputError
        Where the measurement contradicts the other data.
    NoSolutionError
        At thermal runaway, whatever the switching energies.
    """
    device = required_device(inverter)
    currents = np.array([i_d], dtype=np.float64), np.array([i_q], dtype=np.float64)
    omega = np.array([omega_m], dtype=np.float64)
    voltage = machine.voltage(*currents, machine.pole_pairs * omega)
    _check_measured_voltage(inverter, float(np.hypot(*voltage)[0]), modulation)
    load = bridge_load(inverter, modulation, *voltage, *currents)
    _refuse_runaway(machine, omega, *currents, thermal_gain(inverter, load))
    copper = copper_loss(machine.r_s, *currents)
    temperature = junction_temperature(inverter, total_loss - copper)
    conduction = load.threshold + load.resistive * resistance_factor(device, temperature)
    return _scaled_device(device, total_loss, float(copper[0]), float(conduction[0]), float(load.switching[0]))


def _check_measured_voltage(inverter: Inverter, amplitude: float, modulation: ModulationName) -> None:
    if not in_linear_range(modulation, amplitude, inverter.v_dc):
        raise InputError(
            f"calibration: the measured point needs a phase voltage of {amplitude:.4g} V (peak), but {modulation} makes"
            f" at most {linear_limit(modulation, inverter.v_dc):.4g} V from {inverter.v_dc:.4g} V"
        )


def _scaled_device(
    device: SwitchDevice, total_loss: float, copper: float, conduction: float, switching: float
) -> SwitchDevice:
    """Scale the energies of the device so that its switching loss, now `switching`, makes up the total; all in W."""
    remainder = total_loss - copper - conduction
    if remainder < 0.0:
        raise InputError(
            f"calibration: the measured total loss of {total_loss:.4g} W is below the copper loss of {copper:.4g} W"
            f" plus the conduction loss of {conduction:.4g} W; check R_s, R_DS(on) and the currents"
        )
    if switching <= 0.0:
        raise InputError(
            "calibration: the device has no switching loss at the measured point, so that its energies cannot be"
            " scaled; give switching energies above zero, and a point with current"
        )
    factor = remainder / switching
    return replace(
        device,
        turn_on_energy=device.turn_on_energy * factor,
        turn_off_energy=device.turn_off_energy * factor,
        reverse_recovery_energy=device.reverse_recovery_energy * factor,
    )
