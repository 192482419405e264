"""What a voltage leaves of a machine at a speed, its resistance included:
domain and errors of a current reference.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import PENALTY_FROM
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.optimizer.field_weakening.exact import WeakeningRegion, weakening_region
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import optimal_points

LEAST_VOLTAGE = 0.8

"""Share of the design's voltage from which the errors of the voltage are stated."""


_GRID, _ROUNDS = 49, 6


_LOCUS_POINTS = 801


_SPEEDS, _TORQUES = 28, 24


_VOLTAGES = (LEAST_VOLTAGE, 0.9, 1.2)


_WITHIN = 1.0 - 1e-6


_REACHED = 1.0 + 1e-6


@dataclass(frozen=True, slots=True)
class VoltageRegion:
    """The domain of torque, voltage and speed of a machine.

    Parameters
    ----------
    flux:
        The domain of torque and available flux linkage that it takes.
    v_max:
        The design's largest phase-voltage amplitude in V.
    omega_e:
        Largest electrical speed in rad/s at that voltage; it changes in proportion to the voltage.
    """

    flux: WeakeningRegion
    v_max: float
    omega_e: float

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


def _least_flux(region: WeakeningRegion, v_max: float, omega_e: float) -> float:
    """Flux linkage in Wb that is left at the largest speed for the largest torque that
    can be had there, motoring.
    """
    r_s, whole = region.machine.r_s, v_max / omega_e
    drop = 2.0 * r_s / (omega_e * 1.5 * region.machine.pole_pairs)
    reserve = (r_s * region.i_max / omega_e) ** 2

    def over(levels: FloatArray) -> FloatArray:
        points = region.points(np.full(levels.shape, 2.0 * region.torque_max), levels)
        torque = np.where(
            region.flux(points.i_d, points.i_q) <= _REACHED * levels, points.torque, 0.0
        )
        return np.asarray(levels**2 + drop * torque + reserve - whole**2)

    low, high = 0.0, whole
    for _ in range(_ROUNDS):
        levels = np.linspace(low, high, _GRID)[1:]
        place = int(np.argmax(over(levels) >= 0.0))
        low, high = (float(levels[place - 1]) if place else low), float(levels[place])
    # Without torque the same speed over voltage is to be had at the least voltage,
    # where the drop weighs most.
    idle = whole**2 - reserve / LEAST_VOLTAGE**2
    return min(low, float(np.sqrt(idle)) * _WITHIN)


def voltage_region(machine: Machine, i_max: float, v_max: float, omega_m: float) -> VoltageRegion:
    """Domain up to a mechanical speed in rad/s within ``v_max`` V (phase
    amplitude) and ``i_max`` A (peak).

    Raises
    ------
    NoSolutionError
        The voltage limits nothing up to that speed, leaves next to no torque there,
        or not even the resistance drop.
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
    return VoltageRegion(
        weakening_region(machine, i_max, _least_flux(probe, v_max, omega_e)), v_max, omega_e
    )


@dataclass(frozen=True, slots=True)
class VoltageSamples:
    """Where errors are measured, and the best that can be had there, arrays of shape (N,).

    float32 torques in N m, phase-voltage amplitudes in V, electrical speeds in rad/s; ``most`` is
    the torque of the optimum in N m and ``square`` its squared current in A^2, both nan where it
    was not solved for (other voltages than the design's).
    """

    torque: SingleArray
    v_max: SingleArray
    omega_e: SingleArray
    best: FloatArray
    square: FloatArray


def voltage_samples(region: VoltageRegion) -> VoltageSamples:
    """Motoring and generating at the design's voltage, where the optimum is solved for,
    and at other voltages.
    """
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _TORQUES))
    speeds = region.omega_e * np.linspace(0.0, 1.0, _SPEEDS + 1)[1:]
    torque = region.flux.torque_max * np.concatenate([-shares[:0:-1], shares, [1.05, -1.05]])
    mesh_speed, mesh_torque = (part.ravel() for part in np.meshgrid(speeds, torque, indexing="ij"))
    single = [part.astype(np.float32) for part in (mesh_torque, mesh_speed)]
    double = [part.astype(np.float64) for part in single]
    found = optimal_points(
        region.machine,
        double[0],
        double[1] / region.machine.pole_pairs,
        v_max=float(np.float32(region.v_max)),
        i_max=region.flux.i_max,
    )
    count = mesh_speed.size
    volts = np.repeat(np.array([1.0, *_VOLTAGES]) * region.v_max, count)
    times = len(_VOLTAGES) + 1
    omega = np.concatenate([mesh_speed * share for share in (1.0, *_VOLTAGES)])
    nothing = np.full(count * len(_VOLTAGES), np.nan)
    return VoltageSamples(
        np.tile(single[0], times),
        volts.astype(np.float32),
        omega.astype(np.float32),
        np.concatenate([found.torque, nothing]),
        np.concatenate([found.i_d**2 + found.i_q**2, nothing]),
    )


@dataclass(frozen=True, slots=True)
class VoltageErrors:
    """Largest errors at `VoltageSamples`, with and without fused multiply-add.

    ``voltage_excess`` is the voltage beyond the limit, relative to it, the resistance drop
    included; ``torque`` in N m the torque made less the one asked for or the largest one that can
    be had at the design's voltage; ``loss_relative`` the copper loss above the least for torques
    that can be had, from 5 % of the largest one upwards.
    """

    voltage_excess: float
    torque: float
    loss_relative: float
    samples: int


def voltage_errors(
    region: VoltageRegion, reference: DropReference, samples: VoltageSamples
) -> VoltageErrors:
    """Largest errors of the float32 arithmetic, by the machine in double."""
    excess, error, loss = -np.inf, 0.0, 0.0
    solved = np.isfinite(samples.best)
    volts, omega = samples.v_max.astype(np.float64), samples.omega_e.astype(np.float64)
    asked = samples.torque.astype(np.float64)
    floor = PENALTY_FROM * region.flux.torque_max
    loaded = (
        solved
        & (np.abs(asked) >= floor)
        & (np.abs(asked - samples.best) <= 1e-9 * region.flux.torque_max)
    )
    for fused in (False, True):
        found = reference.currents(samples.torque, samples.v_max, samples.omega_e, fused=fused)
        i_d, i_q = (part.astype(np.float64) for part in found)
        taken = np.sqrt(region.squared_voltage(i_d, i_q, omega))
        excess = max(excess, float(np.max(taken / volts)) - 1.0)
        made = region.machine.torque(i_d, i_q)
        error = max(error, float(np.max(np.abs(made - samples.best)[solved])))
        more = (i_d**2 + i_q**2)[loaded] / samples.square[loaded] - 1.0
        loss = max(loss, float(np.max(more, initial=0.0)))
    return VoltageErrors(excess, error, loss, 2 * samples.torque.size)
