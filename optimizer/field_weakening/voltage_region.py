"""What a voltage leaves of a machine at a speed, its resistance included:
domain and errors of a current reference.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, in_rpm
from dqforge.machines.units.quantities import format_quantity, to_digits
from dqforge.optimizer.current_reference.forms import PENALTY_FROM
from dqforge.optimizer.curves.single_precision import (
    SingleArray,
    compiled,
    in_segments,
)
from dqforge.optimizer.field_weakening.form import (
    LEAST_SHARE,
    WeakeningReference,
    WeakeningRegion,
    weakening_region,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, where

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
    fastest = in_rpm(float(omega_e) / LEAST_VOLTAGE / machine.pole_pairs)
    return (
        f"field_weakening: at {100.0 * LEAST_VOLTAGE:g} % of {v_max:.4g} V, to which the dc link "
        f"may sag, and of {format_quantity(omega_m, 'rpm', 4)} the machine makes less than "
        f"{100.0 * LEAST_SHARE:g} % of its largest torque; lower the speed to "
        f"{to_digits(fastest, 3, up=False):g} rpm"
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


# Current references over torque, voltage and speed: the resistance drop taken off,
# the torque held to what is left.
#
# |v|^2 = R^2 |i|^2 + 2 R omega tau + omega^2 |psi|^2 with tau = T/(3/2 p), omega counted along the
# torque. So the flux linkage a that is available follows from the torque and the magnitude of the
# current alone: in closed form but for that magnitude, for which a bound stands first and then the
# current that the bound gives. The currents over torque and a are those of
# `dqforge.optimizer.field_weakening.form`. The evaluator is the list of float32 operations of the
# header.

# Trials of the torque at most: what cannot be had is halved down to 2^-12 of what was asked for.
STEPS = 14

# Code and literals beside those of the surface: always, for a second look at the current, for a
# bound of the current that falls with the flux linkage. Above what gcc 12 makes for a Cortex-M4F
# with -O2.
_BYTES = 115, 255, 215


def _singles(*parts: SingleArray) -> list[SingleArray]:
    return [np.asarray(part, dtype=np.float32) for part in parts]


@dataclass(slots=True)
class Search:
    """Where the search of the torque stands.

    ``t`` in N m can be had with the flux linkage ``a`` in Wb, ``beyond`` cannot, and ``trial`` is
    what is tried next.
    """

    t: Any
    a: Any
    beyond: Any
    trial: Any


@dataclass(slots=True)
class Pass:
    """Currents in A of a pass, and the flux linkage in Wb that is left for the next one."""

    weak_d: Any
    weak_q: Any
    flux: Any


class Granted(NamedTuple):
    """What can be had: torque in N m, flux linkage in Wb, squared voltage in V^2, of which a torque
    takes ``per_torque`` in V^2 per N m, and electrical speed in rad/s.
    """

    t: Reals
    a: Reals
    room: Reals
    per_torque: Reals
    omega: Reals


@dataclass(frozen=True, slots=True)
class DropReference:
    """i_d and i_q in A over torque in N m, largest phase-voltage amplitude in V and
    electrical speed in rad/s.

    Args:
        surface: Currents over torque and available flux linkage.
        torque_max: Largest torque in N m.
        per_torque: 2 R/(3/2 p) in Ohm, so that 2 R omega tau is this times speed and torque.
        square: R^2 in Ohm^2.
        reserve: R^2 I^2 in V^2 with the current limit I, not below it.
        near: (c, e) in V^2 and Ohm^2 A^2/Wb^2: at the largest torque of an available flux linkage
            a, where MTPV holds it, R^2 |i|^2 is at most c + e a^2; None where that does not matter.
        passes: Evaluations of the surface: 1, or 2 where the current of the first one tells the
            drop of the second.
    """

    surface: WeakeningReference
    torque_max: np.float32
    per_torque: np.float32
    square: np.float32
    reserve: np.float32
    near: tuple[np.float32, np.float32] | None
    passes: int

    @property
    def coefficients(self) -> int:
        """Number of constants that the emitted C spells out."""
        return self.surface.coefficients + 4 + (0 if self.near is None else 2)

    @property
    def flash(self) -> int:
        """Estimate of the bytes of code and constants on a Cortex-M4F, without fused
        multiply-add.
        """
        fixed, again, line = _BYTES
        return (
            self.surface.flash + fixed + again * (self.passes > 1) + line * (self.near is not None)
        )

    def weakening_limit(self, o: Arithmetic, flux: Reals) -> Reals:
        """Largest torque in N m within an available flux linkage in Wb and the current limit."""
        f = o.let("f", flux - self.surface.flux_min)
        found: Reals = self.surface.limit.step(o, "limit", f)
        return found

    def weakening_flux(self, o: Arithmetic, squared: Reals, omega: Reals) -> Reals:
        """Flux linkage in Wb that a squared voltage in V^2 leaves at an electrical speed in rad/s,
        0 for none.
        """
        most: Any = self.surface.flux_max
        top = o.let("top", omega * most)

        def some() -> Reals:
            found = o.let("found", o.root(squared) / omega)
            return o.choose(found < most, found, most)

        return o.cases(
            "flux",
            (squared >= top * top, lambda: o.full(most, omega)),
            (squared > 0.0, some),
            otherwise=lambda: o.full(0.0, omega),
        )

    def weakening_least_flux(self, o: Arithmetic, squared: Reals, omega: Reals) -> Reals:
        """The same before the current is known: bounds of it stand for what the resistance
        takes.
        """
        least = o.call(self.weakening_flux, squared - float(self.reserve), omega)
        if self.near is None:
            return least
        flux, constant, slope = o.let("flux", least), *map(float, self.near)
        rest = o.let("rest", squared - constant)

        def falling() -> Reals:
            o.remark("where MTPV holds the torque the current falls with the flux linkage")
            found = o.let("found", o.root(rest / o.multiply_add(omega, omega, slope)))
            most: Any = self.surface.flux_max
            held = o.let("held", o.choose(found < most, found, most))
            return o.choose(held > flux, held, flux)

        return o.cases("least", (rest > 0.0, falling), otherwise=lambda: flux)

    def search(
        self, o: Arithmetic, torque: Reals, v_max: Reals, omega_e: Reals, trials: Any = STEPS
    ) -> Granted:
        """The step of `granted`, in at most ``trials`` trials."""
        omega = o.let("omega", o.choose(omega_e < 0.0, -omega_e, omega_e))
        volts = o.let("volts", o.choose(v_max > 0.0, v_max, 0.0), "0 for not-a-number")
        room = o.let("room", volts * volts)
        drop = o.let("drop", float(self.per_torque) * omega)
        against = o.differ(torque < 0.0, omega_e < 0.0)
        per_torque = o.let("per_torque", o.choose(against, -drop, drop), "V^2 per N m")
        size = o.let("size", o.choose(torque < 0.0, -torque, torque))
        most, some = float(self.torque_max), o.let("some", o.choose(size > 0.0, size, 0.0))
        asked = o.let("asked", o.choose(some < most, some, most), "0 for not-a-number")
        now = Search(o.full(0.0, asked), o.full(0.0, asked), asked, asked)

        def none() -> None:
            now.trial = o.full(0.0, asked)

        def had(flux: Reals) -> None:
            now.t, now.a = now.trial, flux

        def missed() -> None:
            now.beyond = now.trial

        def tried(k: Any) -> None:
            last = (k >= trials - 1) & (now.t <= 0.0)
            where(o, last, none, now)
            left = o.multiply_add(o.negative(per_torque), now.trial, room)
            flux = o.let("flux", o.call(self.weakening_least_flux, left, omega))
            limit = o.call(self.weakening_limit, flux)
            fits = (flux >= self.surface.flux_min) & (now.trial <= limit)
            o.cases("", (fits, lambda: had(flux)), otherwise=missed, changing=[now])
            now.trial = 0.5 * (now.t + now.beyond)

        o.repeated(now, trials, tried, until=lambda: now.t >= asked)
        least: Any = self.surface.flux_min
        said = "beyond the largest speed of the voltage"
        a = o.let("a_held", o.choose(now.a > 0.0, now.a, least), said)
        return Granted(now.t, a, room, per_torque, omega)

    def step(
        self, o: Arithmetic, torque: Reals, v_max: Reals, omega_e: Reals, trials: Any = STEPS
    ) -> Dq:
        """Currents in A for a torque in N m, a voltage in V and a speed in rad/s, any shape."""
        granted, surface = self.search(o, torque, v_max, omega_e, trials), self.surface
        t, a = granted.t, granted.a
        o.remark("Least current without any limit of the flux linkage, and that which it makes")
        curves = surface.d, surface.q, surface.flux
        mtpa_d, mtpa_q, taken = in_segments(
            o,
            ("mtpa_d", "mtpa_q", "taken"),
            surface.d.starts,
            t,
            lambda number, x: tuple(curve.within(o, number, x) for curve in curves),
        )

        def weakened() -> tuple[Reals, Reals]:
            o.remark("Field weakening: delta in Wb is the flux linkage that is too much")
            base = mtpa_d, mtpa_q
            if self.passes == 1:
                found = surface.weakened(o, t, o.let("delta", taken - a), base)
                return found.d, found.q
            return self._in_passes(o, granted, taken, base)

        i_d, i_q = o.cases(
            ("i_d", "i_q"), (taken > a, weakened), otherwise=lambda: (mtpa_d, mtpa_q)
        )
        return Dq(i_d, o.choose(torque < 0.0, -i_q, i_q))

    def _in_passes(
        self, o: Arithmetic, granted: Granted, taken: Reals, base: tuple[Reals, Reals]
    ) -> tuple[Reals, Reals]:
        """Weakened currents in A, of which each pass tells the next what the resistance takes."""
        t, a, room, per_torque, omega = granted
        left = o.let("left", o.multiply_add(o.negative(per_torque), t, room))
        now = Pass(*base, a)

        def again() -> None:
            used = o.let("used", o.multiply_add(now.weak_d, now.weak_d, now.weak_q * now.weak_q))
            rest = o.multiply_add(o.negative(used), float(self.square), left)
            more = o.let("more", o.call(self.weakening_flux, rest, omega))
            now.flux = o.choose(more > now.flux, more, now.flux)

        def passed(n: Any) -> None:
            delta = o.let("delta", o.choose(taken > now.flux, taken - now.flux, 0.0))
            weak = self.surface.weakened(o, t, delta, base)
            now.weak_d, now.weak_q = weak
            where(o, n < self.passes - 1, again, now)

        o.repeated(now, self.passes, passed)
        return now.weak_d, now.weak_q

    def granted(
        self, torque: SingleArray, v_max: SingleArray, omega_e: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, ...]:
        """Magnitude of the torque within reach in N m, flux linkage in Wb, and squared
        voltage in V^2, shape (N,).

        The squared voltage is what R^2 |i|^2 and omega^2 |psi|^2 may take together. NaN as a torque
        counts as none; NaN as voltage or speed as no voltage, which gives no torque at the least
        flux linkage.
        """
        o, asked = compiled(fused=fused), _singles(torque, v_max, omega_e)
        with np.errstate(invalid="ignore", under="ignore", over="ignore", divide="ignore"):
            t, a, room, per_torque, omega = self.search(o, *asked)
            return t, a, o.multiply_add(o.negative(per_torque), t, room), omega

    def currents(
        self, torque: SingleArray, v_max: SingleArray, omega_e: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A as the emitted C returns them, bit for bit, for any float32 inputs,
        shape (N,).
        """
        o, asked = compiled(fused=fused), _singles(torque, v_max, omega_e)
        with np.errstate(invalid="ignore", under="ignore", over="ignore", divide="ignore"):
            i_d, i_q = self.step(o, *asked)
        return i_d, i_q


# Bounds of the voltage that a two-dimensional reference takes, resistance included,
# on boxes of torque and excess.
#
# With the flux linkage a of the last evaluation and what was taken for the squared current there,
# J^2, the step holds omega^2 a^2 + 2 R omega s k t + R^2 J^2 <= V^2, where k t = T/(3/2 p) and s =
# 1 motoring, -1 generating. So, with z = R/(omega a) and q = k t/a,
#
#     |v|^2/V^2 - 1 <= (|psi|^2/a^2 - 1 + 2 s z k e/a + z^2 (|i|^2 - J^2)) / (1 + 2 s z q + z^2 J^2)
#
# where e is the error of the torque: nothing but what boxes of torque and excess flux linkage
# bound, and z, which V >= V_least holds to 1/z >= sqrt(q^2 + (V_least/R)^2 - J^2) - s q; where the
# voltage is larger than it need be, at low speed, larger z count for less.

# Share of the squared voltage that the rounded operations of the step may add. Each adds at most
# 2^-24 of its result, in squared voltages: 1 the square, 3 times 4 the drop by the torque, 5 and 5
# what is left of both, twice 5 the root, twice 5 the quotient; at most 5 the squared current with
# its factor.
ROUNDING = 64.0 * 2.0**-24

# Share of the squared voltage up to which the drop by the torque is known to stay, for `ROUNDING`.
LARGEST_SHARE = 4.0

# Errors over the largest torque and over the flux linkage up to which the least current of a torque
# is taken.
TORQUE_SHARE, FLUX_SHARE = 0.01, 0.02
_MORE = 1.02  # squared currents beyond the limit, for z alone
_SLACK = 1.0 + 1e-12


@dataclass(frozen=True, slots=True)
class Taken:
    """What is known on each box, arrays of shape (N,).

    Torques in N m and available flux linkages in Wb from ``t_low`` and ``a_low`` to ``t_high`` and
    ``a_high``; ``less`` and ``more`` bound the torque made less t and t less the torque made in N
    m, ``flux`` is the squared flux linkage over the squared available one less 1, ``current`` the
    squared current in A^2.
    """

    t_low: FloatArray
    t_high: FloatArray
    a_low: FloatArray
    a_high: FloatArray
    more: FloatArray
    less: FloatArray
    flux: FloatArray
    current: FloatArray


def voltage_excess(region: VoltageRegion, step: DropReference, taken: Taken) -> FloatArray:
    """Upper bounds of |v|^2/V^2 - 1 on boxes without what `ROUNDING` and `moved` add,
    shape (N,).
    """
    machine, i_max = region.machine, region.flux.i_max
    r_s, k = machine.r_s, 1.0 / (1.5 * machine.pole_pairs)
    if r_s == 0.0:
        return np.asarray(taken.flux)
    whole = (LEAST_VOLTAGE * region.v_max / r_s) ** 2 - _MORE * i_max**2
    q_low = k * np.maximum(taken.t_low, 0.0) / taken.a_high / _SLACK
    q_high = k * np.maximum(taken.t_high, 0.0) / taken.a_low * _SLACK
    bound = np.full(taken.flux.shape, float(step.reserve) / r_s**2)
    if step.near is not None:
        constant, slope = (float(part) for part in step.near)
        bound = np.minimum(bound, (constant + slope * taken.a_low**2) / r_s**2)
    beyond = np.maximum(taken.current - bound / _SLACK, 0.0)

    # Motoring the largest z rises with q; the bound lies between those without drop
    # and with the largest one.
    z = _SLACK / (np.sqrt(q_high**2 + whole) - q_high)
    more = 2.0 * z * k * np.maximum(taken.more, 0.0) / taken.a_low
    motoring = np.maximum(taken.flux, (taken.flux + more) / (1.0 + 2.0 * z * q_low)) + z**2 * beyond

    # Generating it falls with q, and the drop helps: the less the larger the
    # least current of the torque.
    z = _SLACK / (np.sqrt(q_low**2 + whole) + q_low)
    less = 2.0 * z * k * np.maximum(taken.less, 0.0) / taken.a_low
    top = np.maximum(taken.flux + less + z**2 * beyond, 0.0)
    least = q_high * (1.0 - FLUX_SHARE) - TORQUE_SHARE * k * region.flux.torque_max / taken.a_low
    below = 1.0 - 2.0 * z * q_high + (z * np.maximum(least, 0.0)) ** 2
    fine = (below > 0.0) & (2.0 * z * q_high <= LARGEST_SHARE * below)
    generating = np.where(fine, top / np.where(fine, below, 1.0), np.inf)
    return np.asarray(np.maximum(motoring, generating) * _SLACK + 1e-12)


def moved(region: VoltageRegion, step: DropReference, rise: float, room: float) -> float:
    """What |v|^2/V^2 - 1 may gain where the second evaluation takes more current than the first.

    ``rise`` in A^2/Wb bounds how the squared current may rise with the available flux linkage,
    which grows by at most z^2 a J^2 between the two; ``room`` in A^2 bounds what rounding adds to
    the squared current of either.
    """
    r_s, i_max = region.machine.r_s, region.flux.i_max
    if step.passes < 2 or r_s == 0.0:
        return 0.0
    k = 1.0 / (1.5 * region.machine.pole_pairs)
    q = _MORE * i_max + TORQUE_SHARE * k * region.flux.torque_max / region.flux.flux_min
    whole = (LEAST_VOLTAGE * region.v_max / r_s) ** 2 - _MORE * i_max**2
    z = 1.0 / (np.sqrt(q**2 + whole) - q)
    share = _MORE * (z * i_max) ** 2
    return float((share * rise * region.flux.flux_max + 2.0 * room) * z**2 * _SLACK)
