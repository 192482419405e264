"""What a voltage leaves of a machine at a speed, its resistance included:
domain and errors of a current reference.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import PENALTY_FROM
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.optimizer.field_weakening.exact import (
    LEAST_SHARE,
    WeakeningRegion,
    weakening_region,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

# Share of the design's voltage from which the errors of the voltage are stated.
LEAST_VOLTAGE = 0.8
_GRID, _ROUNDS = 49, 6
_LOCUS_POINTS = 801
_SPEEDS, _TORQUES = 48, 40

# Shares of the design's voltage at which errors are measured: nearly even in the share of the
# voltage that the resistance takes, which falls with them.
_VOLTAGES = (LEAST_VOLTAGE, 0.9, 1.0, 1.2, 1.6, 4.0)
_WITHIN = 1.0 - 1e-6
_REACHED = 1.0 + 1e-6


@dataclass(frozen=True, slots=True)
class VoltageRegion:
    """The domain of torque, voltage and speed of a machine.

    Args:
        flux: The domain of torque and available flux linkage that it takes.
        v_max: The design's largest phase-voltage amplitude in V.
        omega_e: Largest electrical speed in rad/s at that voltage; from `LEAST_VOLTAGE` up it
            changes in proportion to the voltage.
    """

    flux: WeakeningRegion
    v_max: float
    omega_e: float

    @property
    def voltages(self) -> tuple[float, ...]:
        """Voltages in V at which errors are measured, the least one first."""
        return tuple(share * self.v_max for share in _VOLTAGES)

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.flux.machine

    @property
    def largest_drop(self) -> float:
        """What the resistance takes of the voltage at the current limit, in V."""
        return self.machine.r_s * self.flux.i_max

    @property
    def per_torque(self) -> float:
        """2 R/(3/2 p) in Ohm: what speed and torque take off the squared voltage."""
        return 2.0 * self.machine.r_s / (1.5 * self.machine.pole_pairs)

    def squared_voltage(self, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray) -> FloatArray:
        """|v|^2 in V^2 of currents in A at signed electrical speeds in rad/s, any shape."""
        psi_d, psi_q = self.machine.flux(i_d, i_q)
        r_s = self.machine.r_s
        return np.asarray((r_s * i_d - omega_e * psi_q) ** 2 + (r_s * i_q + omega_e * psi_d) ** 2)


def _locus_voltage(region: WeakeningRegion, omega_e: float) -> float:
    """Largest phase-voltage amplitude in V that any torque takes when nothing limits it,
    motoring at a speed.
    """
    i_d, i_q = region.mtpa(np.linspace(0.0, region.torque_max, _LOCUS_POINTS))
    probe = VoltageRegion(region, 0.0, omega_e)
    return float(np.sqrt(np.max(probe.squared_voltage(i_d, i_q, np.full(i_d.shape, omega_e)))))


def _largest_within(region: WeakeningRegion, levels: FloatArray) -> FloatArray:
    """Largest torque in N m within flux linkages in Wb, 0 where not even the least one is kept."""
    points = region.points(np.full(levels.shape, 2.0 * region.torque_max), levels)
    kept = region.flux(points.i_d, points.i_q) <= _REACHED * levels
    return np.asarray(np.where(kept, points.torque, 0.0))


def _first_above(function: Callable[[FloatArray], FloatArray], high: float) -> tuple[float, float]:
    """Bracket of where a function of a flux linkage in Wb that rises reaches 0, up to ``high``."""
    low = 0.0
    for _ in range(_ROUNDS):
        levels = np.linspace(low, high, _GRID)[1:]
        place = int(np.argmax(function(levels) >= 0.0))
        low, high = (float(levels[place - 1]) if place else low), float(levels[place])
    return low, high


def _least_flux(region: WeakeningRegion, v_max: float, omega_e: float) -> float:
    """Flux linkage in Wb that is left at the largest speed for the largest torque that
    can be had there, motoring, at the least voltage, where the drop weighs most.
    """
    r_s, whole, least = region.machine.r_s, v_max / omega_e, LEAST_VOLTAGE * omega_e
    drop = 2.0 * r_s / (least * 1.5 * region.machine.pole_pairs)
    reserve = (r_s * region.i_max / least) ** 2

    def over(levels: FloatArray) -> FloatArray:
        return levels**2 + drop * _largest_within(region, levels) + reserve - whole**2

    return _first_above(over, whole)[0] * _WITHIN


def voltage_region(machine: Machine, i_max: float, v_max: float, omega_m: float) -> VoltageRegion:
    """Domain up to a mechanical speed in rad/s within ``v_max`` V (phase
    amplitude) and ``i_max`` A (peak).

    Raises:
        NoSolutionError: The voltage limits nothing up to that speed, leaves next to no torque
            there, or not even the resistance drop.
    """
    omega_e = machine.pole_pairs * omega_m
    torque_max = float(mtpa_locus(machine, i_max).torque[-1])
    probe = WeakeningRegion(machine, i_max, 0.0, np.inf, torque_max)
    drop = machine.r_s * i_max
    if drop >= LEAST_VOLTAGE * v_max:
        raise NoSolutionError(
            f"field_weakening: the resistance alone takes {drop:.4g} V at the current limit, of "
            f"{v_max:.4g} V; lower the current limit or raise the voltage"
        )
    taken = _locus_voltage(probe, omega_e)
    if taken <= v_max:
        fastest = format_quantity(omega_m, "rpm", 4)
        raise NoSolutionError(
            f"field_weakening: the voltage limits nothing up to {fastest} (at most {taken:.4g} V "
            f"are taken there, the resistance drop included, {v_max:.4g} V are available); raise "
            "the speed or leave the section out"
        )
    least = _least_flux(probe, v_max, omega_e)
    if _largest_within(probe, np.array([least]))[0] < LEAST_SHARE * torque_max:
        raise NoSolutionError(_too_fast(probe, v_max, omega_m))
    return VoltageRegion(weakening_region(machine, i_max, least), v_max, omega_e)


def _too_fast(region: WeakeningRegion, v_max: float, omega_m: float) -> str:
    """What to write where a speed in rad/s leaves next to no torque at the least voltage."""
    machine, sagged = region.machine, LEAST_VOLTAGE * v_max
    torque = LEAST_SHARE * region.torque_max
    plenty = 1.01 * float(region.flux(*region.mtpa(np.array([torque])))[0])
    _, flux = _first_above(lambda levels: _largest_within(region, levels) - torque, plenty)
    half = machine.r_s * torque / (1.5 * machine.pole_pairs)
    left = sagged**2 - (machine.r_s * region.i_max) ** 2
    omega_e = (np.sqrt(half**2 + flux**2 * left) - half) / flux**2
    fastest = float(omega_e) / LEAST_VOLTAGE / machine.pole_pairs * 30.0 / np.pi
    step = 10.0 ** (np.floor(np.log10(fastest)) - 2.0)
    return (
        f"field_weakening: at {100.0 * LEAST_VOLTAGE:g} % of {v_max:.4g} V, to which the dc link "
        f"may sag, and of {format_quantity(omega_m, 'rpm', 4)} the machine makes less than "
        f"{100.0 * LEAST_SHARE:g} % of its largest torque; lower the speed to "
        f"{np.floor(fastest / step) * step:g} rpm"
    )


@dataclass(frozen=True, slots=True)
class VoltageSamples:
    """Where errors are measured, and the best that can be had there, arrays of shape (N,).

    float32 torques in N m, phase-voltage amplitudes in V, electrical speeds in rad/s; ``best`` is
    the torque of the optimum in N m, ``square`` its squared current in A^2 and ``most`` the
    magnitude of the largest torque in N m.
    """

    torque: SingleArray
    v_max: SingleArray
    omega_e: SingleArray
    best: FloatArray
    square: FloatArray
    most: FloatArray


def voltage_samples(region: VoltageRegion) -> VoltageSamples:
    """Torques to beyond the largest at every speed and voltage, motoring and generating.

    Speeds reach to the largest in proportion to the voltage; those of one voltage lie between those
    of the others.
    """
    shift = np.arange(len(_VOLTAGES))[:, np.newaxis] / len(_VOLTAGES)
    shares = (np.arange(1, _SPEEDS + 1) - shift * (np.arange(1, _SPEEDS + 1) < _SPEEDS)) / _SPEEDS
    volts = np.repeat(np.array(_VOLTAGES) * region.v_max, 2 * _SPEEDS).astype(np.float32)
    # Rounding must not put a speed above the largest one.
    speed = region.omega_e * _WITHIN * np.repeat(shares.ravel(), 2)
    omega = (speed * volts.astype(np.float64) / region.v_max).astype(np.float32)
    signs = np.tile([1.0, -1.0], volts.size // 2)

    def solve(torque: FloatArray, places: NDArray[np.intp]) -> OptimalPoints:
        return optimal_points(
            region.machine,
            torque,
            omega[places].astype(np.float64) / region.machine.pole_pairs,
            v_max=volts[places].astype(np.float64),
            i_max=region.flux.i_max,
        )

    most = np.abs(solve(2.0 * signs * region.flux.torque_max, np.arange(volts.size)).torque)
    steps = np.append(0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _TORQUES)), [0.97, 1.05])
    mesh = signs[:, np.newaxis] * steps * most[:, np.newaxis]
    beyond = 1.05 * signs[:, np.newaxis] * region.flux.torque_max
    torque = np.hstack([mesh, beyond]).astype(np.float32).ravel()
    places = np.repeat(np.arange(volts.size), steps.size + 1)
    found = solve(torque.astype(np.float64), places)
    return VoltageSamples(
        torque,
        volts[places],
        omega[places],
        found.torque,
        found.i_d**2 + found.i_q**2,
        most[places],
    )


@dataclass(frozen=True, slots=True)
class VoltageErrors:
    """Largest errors at `VoltageSamples`, with and without fused multiply-add.

    ``voltage_excess`` is the voltage beyond the limit, relative to it, the resistance drop
    included, and ``current_excess`` likewise; ``torque`` in N m the torque made less the one
    requested or the largest one that can be had at that voltage and speed; ``missed`` what is not
    granted of the largest one, as a share of it, where that is at least 5 % of the largest of all;
    ``loss_relative`` the copper loss above the least for torques that can be had, from 5 % of the
    largest one upwards. ``torque_nominal`` and ``loss_nominal`` are those at the design's voltage.
    """

    voltage_excess: float
    current_excess: float
    torque: float
    missed: float
    loss_relative: float
    torque_nominal: float
    loss_nominal: float
    samples: int


def voltage_errors(
    region: VoltageRegion, reference: DropReference, samples: VoltageSamples
) -> VoltageErrors:
    """Largest errors of the float32 arithmetic, by the machine in double."""
    volts, omega = samples.v_max.astype(np.float64), samples.omega_e.astype(np.float64)
    requested, torque_max = samples.torque.astype(np.float64), region.flux.torque_max
    floor, reached = (
        PENALTY_FROM * torque_max,
        np.abs(requested - samples.best) <= 1e-9 * torque_max,
    )
    loaded = reached & (np.abs(requested) >= floor)
    beyond = ~reached & (samples.most >= floor)
    nominal = samples.v_max == np.float32(region.v_max)
    found = np.full((7, 2), -np.inf)
    for column, fused in enumerate((False, True)):
        i_d, i_q = (
            part.astype(np.float64)
            for part in reference.currents(
                samples.torque, samples.v_max, samples.omega_e, fused=fused
            )
        )
        made, square = region.machine.torque(i_d, i_q), i_d**2 + i_q**2
        off = np.abs(made - samples.best)
        missed = np.where(beyond, off / np.maximum(samples.most, floor), 0.0)
        more = np.where(loaded, square / np.where(loaded, samples.square, 1.0) - 1.0, 0.0)
        found[:, column] = [
            np.max(np.sqrt(region.squared_voltage(i_d, i_q, omega)) / volts) - 1.0,
            np.sqrt(np.max(square)) / region.flux.i_max - 1.0,
            np.max(off),
            np.max(missed),
            np.max(more),
            np.max(off[nominal]),
            np.max(more[nominal]),
        ]
    worst = [float(value) for value in np.max(found, axis=1)]
    return VoltageErrors(
        voltage_excess=worst[0],
        current_excess=worst[1],
        torque=worst[2],
        missed=worst[3],
        loss_relative=worst[4],
        torque_nominal=worst[5],
        loss_nominal=worst[6],
        samples=2 * samples.torque.size,
    )
