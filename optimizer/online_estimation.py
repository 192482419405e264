"""Resistance and magnet flux linkage on line (paper 001, chapter 9.2.3 b): the step of the
firmware, its numbers for a design, and what it sees and misses at operating points.

Over a sampling period the voltage rests in stationary coordinates while the rotor turns by delta.
Seen from the middle of the period, the change of the flux linkage is exact:

    v t_s = R integral of i + e^(j delta/2) (L i[k] + psi) - e^(-j delta/2) (L i[k-1] + psi)

so that v less what the inductances take is R i + j psi (2/t_s) sin(delta/2), linear in both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.machine_budget import COPPER_COEFFICIENT
from dqforge.machines.plants.scenario import plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.steps.step_arithmetic import (
    EXACT,
    Abc,
    AlphaBeta,
    Arithmetic,
    Dq,
    Member,
    where,
)

# Copper from -40 to 180 degC over that at 20 degC.
COPPER_RANGE = (1.0 - 60.0 * COPPER_COEFFICIENT, 1.0 + 160.0 * COPPER_COEFFICIENT)
# Magnets over the same range, ferrite (-0.2 %/K) included, over those at 20 degC.
MAGNET_RANGE = (0.68, 1.12)
# Back-EMF along the current over the drop at the resistance, up to which the latter is sought: a
# flux linkage that is 20 % wrong makes the resistance 20 % wrong there.
_RESISTIVE = 1.0
# Back-EMF over that drop from which the flux linkage is sought: a resistance that is a quarter
# wrong makes the flux linkage 5 % wrong there.
_TURNING = 5.0
# What is left of a dead time may look like these shares of the resistance and of the back-EMF.
_DEAD_SHARE, _DEAD_EMF = 0.2, 0.05
# Share of the current limit below which no resistance is sought.
_LEAST_CURRENT = 0.1
# Of a modelled dead time, what may be left: edges of the switches and their capacitances.
_LEFT = 0.2
# Least share of the current limit over which the voltage of a dead time turns over.
_SOFT = 0.02

RESISTANCE, FLUX = 1, 2  # Bits of the status.
CONSTANTS = {
    "ONLINE_ESTIMATION_RESISTANCE": RESISTANCE,
    "ONLINE_ESTIMATION_FLUX": FLUX,
}


@dataclass(frozen=True, slots=True)
class OnlineEstimationGains:
    """Numbers of the estimation: the machine's data, how fast it follows, where it looks, and how
    far it may go.
    """

    share: Annotated[float, Member("of a gap that a sample closes")]
    rate: Annotated[float, Member("two over the sampling period", "1/s")]
    mean: Annotated[float, Member("mean of L_d and L_q over the sampling period", "V/A")]
    half: Annotated[float, Member("half of L_d less L_q over the sampling period", "V/A")]
    dead: Annotated[float, Member("what a dead time takes of a phase", "V")]
    per_ampere: Annotated[float, Member("of it per A around zero current", "1/A")]
    r_s: Annotated[float, Member("resistance of a phase at the start", "Ohm")]
    r_least: Annotated[float, Member("of copper at -40 degC", "Ohm")]
    r_most: Annotated[float, Member("of copper at 180 degC", "Ohm")]
    psi_pm: Annotated[float, Member("flux linkage of the magnets at the start", "Wb")]
    psi_least: Annotated[float, Member("of hot magnets", "Wb")]
    psi_most: Annotated[float, Member("of cold magnets", "Wb")]
    square_least: Annotated[
        float, Member("square of the current from which the resistance is sought", "A^2")
    ]
    resistive: Annotated[
        float,
        Member("largest speed times i_q over the square of the current for it", "rad/(s A)"),
    ]
    omega_least: Annotated[
        float, Member("electrical speed from which the flux linkage is sought", "rad/s")
    ]
    turning: Annotated[float, Member("speed that it takes more per current", "rad/(s A)")]


@dataclass(slots=True)
class OnlineEstimation:
    """Estimates, and what is kept from sample to sample; its start makes it."""

    r_s: Annotated[Any, Member("estimated resistance of a phase", "Ohm")]
    psi_pm: Annotated[Any, Member("estimated flux linkage of the magnets (peak of phase)", "Wb")]
    status: Annotated[
        Any,
        Member("what this sample moved: 1 resistance, 2 flux linkage, 3 both, 0 none", whole=True),
    ]
    started: Annotated[Any, Member("0 before the first step", whole=True)]
    r_rest: Annotated[Any, Member("of the resistance, below its last digit", "Ohm")]
    psi_rest: Annotated[Any, Member("of the flux linkage, below its last digit", "Wb")]
    i: Annotated[AlphaBeta, Member("last current", "A")]
    theta_e: Annotated[Any, Member("last electrical angle", "rad")]


def at_rest() -> OnlineEstimation:
    """Members before the start."""
    zero: Any = 0.0
    return OnlineEstimation(zero, zero, 0, 0, zero, zero, AlphaBeta(zero, zero), zero)


def start(o: Arithmetic, gains: OnlineEstimationGains, state: OnlineEstimation) -> None:
    """Start from the data of the design."""
    r_s: Any = gains.r_s
    zero = o.full(0.0, r_s)
    state.r_s, state.psi_pm = gains.r_s, gains.psi_pm
    state.status, state.started = 0, 0
    state.r_rest, state.psi_rest = zero, zero
    state.i, state.theta_e = AlphaBeta(zero, zero), zero


@dataclass(frozen=True, slots=True)
class Sought:
    """What a design lets be estimated, and whether the step takes a dead time from the voltage."""

    flux: bool
    resistance: bool
    dead_time: bool


def step(
    sought: Sought,
    o: Arithmetic,
    gains: OnlineEstimationGains,
    state: OnlineEstimation,
    v: AlphaBeta,
    i: AlphaBeta,
    theta_e: Reals,
    omega_e: Reals,
) -> None:
    """One sample.

    Args:
        sought: What is estimated.
        o: The arithmetic.
        gains, state: Of the estimation.
        v: Voltage reference in V that acted over the period that ends at the sampling instant.
        i: Current in A at that instant.
        theta_e: Electrical angle in rad at that instant.
        omega_e: Electrical speed in rad/s.
    """
    theta = o.let("theta", o.wrap(theta_e))

    def seen() -> None:
        _compare(sought, o, gains, state, v, i, theta, omega_e)

    state.status = 0
    where(o, state.started > 0, seen, state)
    state.started, state.i, state.theta_e = 1, i, theta


def _compare(
    sought: Sought,
    o: Arithmetic,
    gains: OnlineEstimationGains,
    state: OnlineEstimation,
    v: AlphaBeta,
    i: AlphaBeta,
    theta: Reals,
    omega_e: Reals,
) -> None:
    """Move the estimates by what the voltage has beside them.

    A sample closes less of a gap than the last digit of an estimate, so the rest is kept.
    """
    last = state.i
    half = o.let("half", 0.5 * o.wrap(theta - state.theta_e), "half of what the rotor turned, rad")
    turn = o.let("turn", o.rotation(half))
    middle = o.let("middle", o.rotation(o.wrap(theta - half)))
    both = o.let("both", AlphaBeta(i.alpha + last.alpha, i.beta + last.beta))
    change = AlphaBeta(i.alpha - last.alpha, i.beta - last.beta)
    total = o.let("total", o.park(both, middle), "of both currents, A")
    gap = o.let("gap", o.park(o.let("change", change), middle))
    volts = o.let("volts", o.park(_acting(sought, o, gains, v, both), middle))

    o.remark("what L_d and L_q take: in coordinates that turn, by the angle and the change")
    cosine = o.let("cosine", 1.0 - 2.0 * (turn.sine * turn.sine))
    sine = o.let("sine", 2.0 * (turn.sine * turn.cosine))
    swing_d = o.let("swing_d", gains.half * (cosine * gap.d + sine * total.q))
    swing_q = o.let("swing_q", gains.half * (sine * total.d - cosine * gap.q))

    o.remark("mean current of the period, on its arc")
    arc = o.let("arc", 0.5 + 0.16666667 * (half * half))
    current = o.let("current", Dq(arc * total.d, arc * total.q), "A")
    turned = o.let("turned", gains.rate * turn.sine, "electrical speed on the chord, rad/s")
    drop_d = (volts.d - gains.mean * gap.d) - swing_d
    drop_q = (volts.q - gains.mean * gap.q) - swing_q
    error_d = o.let("error_d", drop_d - state.r_s * current.d, "V")
    error_q = drop_q - (state.r_s * current.q + state.psi_pm * turned)
    error_q = o.let("error_q", error_q, "V")
    square = o.let("square", current.d * current.d + current.q * current.q, "A^2")
    _move(sought, o, gains, state, Dq(error_d, error_q), current, square, omega_e)


def _move(
    sought: Sought,
    o: Arithmetic,
    gains: OnlineEstimationGains,
    state: OnlineEstimation,
    error: Dq,
    current: Dq,
    square: Reals,
    omega_e: Reals,
) -> None:
    """Both where the operating point shows them, the resistance along the current, the flux
    linkage along q.
    """

    def resistance() -> None:
        along = error.d * current.d + error.q * current.q
        along = o.let("along", along / square)
        missing = o.let("missing", _bounded(o, along, gains.r_most), "Ohm")
        moved = o.let("moved", gains.share * missing + state.r_rest)
        r_s = o.let("r_s", state.r_s + moved)
        state.r_rest = moved - (r_s - state.r_s)
        state.r_s = _within(o, r_s, gains.r_least, gains.r_most)
        state.status = o.constant("ONLINE_ESTIMATION_RESISTANCE", RESISTANCE)

    def flux() -> None:
        across = o.let("across", error.q / omega_e)
        missing = o.let("missing", _bounded(o, across, gains.psi_most), "Wb")
        moved = o.let("moved", gains.share * missing + state.psi_rest)
        psi_pm = o.let("psi_pm", state.psi_pm + moved)
        state.psi_rest = moved - (psi_pm - state.psi_pm)
        state.psi_pm = _within(o, psi_pm, gains.psi_least, gains.psi_most)
        state.status = state.status + o.constant("ONLINE_ESTIMATION_FLUX", FLUX)

    if sought.resistance:
        power = o.magnitude(omega_e * current.q)
        shown = (square >= gains.square_least) & (power <= gains.resistive * square)
        where(o, shown, resistance, state)
    if sought.flux:
        least = gains.omega_least + gains.turning * o.root(square)
        where(o, o.magnitude(omega_e) >= least, flux, state)


def _acting(
    sought: Sought, o: Arithmetic, gains: OnlineEstimationGains, v: AlphaBeta, both: AlphaBeta
) -> AlphaBeta:
    """The voltage less what a dead time takes from it, by the signs of the phase currents."""
    if not sought.dead_time:
        return v
    o.remark("the dead time takes a voltage of the sign of each phase current")
    phases = o.let("phases", o.clarke_inverse(both))
    signs = Abc(*(_sign(o, gains, name, x) for name, x in zip("abc", phases, strict=True)))
    lost = o.let("lost", o.clarke(o.let("signs", signs)))
    acting = AlphaBeta(v.alpha - gains.dead * lost.alpha, v.beta - gains.dead * lost.beta)
    return o.let("acting", acting, "V")


def _sign(o: Arithmetic, gains: OnlineEstimationGains, name: str, both: Reals) -> Reals:
    size = o.let(f"size_{name}", (0.5 * gains.per_ampere) * both)
    return o.choose(size > 1.0, 1.0, o.choose(size < -1.0, -1.0, size))


def _bounded(o: Arithmetic, gap: Reals, most: Any) -> Reals:
    """What a single sample may be off by, ten times the largest value; 0 for not-a-number."""
    bound = o.let("bound", 10.0 * most)
    low = o.choose(gap < -bound, -bound, o.full(0.0, gap))
    return o.choose(gap > bound, bound, o.choose(gap >= -bound, gap, low))


def _within(o: Arithmetic, value: Reals, least: Any, most: Any) -> Reals:
    return o.choose(value > most, most, o.choose(value > least, value, least))


# Numbers of the step for a design.


def sought_of(design: Design) -> Sought:
    """What is estimated for a design that asks for it."""
    settings = design.control.online_estimation
    assert settings is not None
    return Sought(settings.flux, settings.resistance, _modelled(design) > 0.0)


def _modelled(design: Design) -> float:
    """Height in V of the square wave that the step takes from the voltage for the dead time."""
    tolerances = design.control.tolerances
    if tolerances is not None and any(tolerances.limits("dead_time")):
        return 0.0
    return 0.25 * math.pi * design.inverter.lost_per_dead_time * design.inverter.dead_time


def _crossing(design: Design) -> float:
    """Current in A below which a dead time takes less than its whole voltage: half the largest
    ripple of a leg, since the edges of a period see currents of either sign there.
    """
    inverter, machine = design.inverter, design.machine
    ripple = inverter.v_dc / (8.0 * min(machine.l_d, machine.l_q) * inverter.f_sw)
    return max(_SOFT * design.i_max, 0.5 * ripple)


def left_of_dead_time(design: Design) -> float:
    """Amplitude in V that the fundamental of a phase lacks or has too much: a fifth of a dead time
    that the step models, or what the tolerances state of one that the firmware compensates.
    """
    tolerances, inverter = design.control.tolerances, design.inverter
    left = _LEFT * inverter.dead_time
    if tolerances is not None and any(tolerances.limits("dead_time")):
        left = max(abs(value) for value in tolerances.limits("dead_time"))
    return inverter.lost_per_dead_time * left


def gains_of(design: Design) -> OnlineEstimationGains:
    """Numbers of the step.

    Args:
        design: With ``control.online_estimation`` and a machine of constant inductances.
    """
    machine, control = design.machine, design.control
    settings = control.online_estimation
    assert settings is not None
    t_s, left, ratio = control.t_s, left_of_dead_time(design), machine.r_s / machine.psi_pm
    least = max(_LEAST_CURRENT * design.i_max, left / (_DEAD_SHARE * machine.r_s))
    return OnlineEstimationGains(
        share=-math.expm1(-t_s / settings.time_constant),
        rate=2.0 / t_s,
        mean=0.5 * (machine.l_d + machine.l_q) / t_s,
        half=0.5 * (machine.l_d - machine.l_q) / t_s,
        dead=_modelled(design),
        per_ampere=1.0 / _crossing(design),
        r_s=machine.r_s,
        r_least=machine.r_s * COPPER_RANGE[0],
        r_most=machine.r_s * COPPER_RANGE[1],
        psi_pm=machine.psi_pm,
        psi_least=machine.psi_pm * MAGNET_RANGE[0],
        psi_most=machine.psi_pm * MAGNET_RANGE[1],
        square_least=least * least,
        resistive=_RESISTIVE * ratio,
        omega_least=left / (_DEAD_EMF * machine.psi_pm),
        turning=_TURNING * ratio,
    )


# What the step does at operating points: it is affine in both estimates, so that two starts beside
# a third give its matrix, and with it the poles and the place where it comes to rest.

_ANGLES = 48  # Over a turn, between the instants at which a phase current passes through zero.
_SHARES = (0.1, 0.5, 1.0)  # Of the largest torque.
_SPEEDS = (0.0, 0.1, 0.3, 1.0)  # Of the largest speed.
# Errors that are tried: of each inductance, of the current sensors, and of what is not seen itself.
INDUCTANCE_WRONG, SENSOR_WRONG = 0.1, 0.01
RESISTANCE_WRONG, FLUX_WRONG = 0.2, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class OperatingSamples:
    """Steady samples at N points, arrays of shape (N,): currents in A, electrical speed in
    rad/s.
    """

    i_d: FloatArray
    i_q: FloatArray
    omega_e: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Estimability:
    """What the step sees at N points.

    ``status`` is that of the step, ``poles`` in 1/s (N, 2) are the eigenvalues of the errors of
    resistance and flux linkage, 0 where the point does not show them. ``shifts`` are by cause the
    errors of both at rest over the design's values, shape (N, 2), nan where nothing is sought. One
    that is not sought keeps the design's value.
    """

    status: FloatArray
    poles: FloatArray
    shifts: Mapping[str, FloatArray]

    @property
    def settling(self) -> FloatArray:
        """Time constant in s of the slowest error that a point shows, inf without any,
        shape (N,).
        """
        rates = np.where(self.status[:, None] > 0.0, -self.poles, 0.0)
        slow = np.where(rates > 0.0, rates, np.inf).min(axis=1)
        return np.where(np.isfinite(slow), 1.0 / slow, np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class OnlineEstimationFit:
    """On-line estimation of a design.

    Args:
        sought: What is estimated.
        gains: Numbers of the step.
        time_constant: In s.
        pole_pairs: Of the machine.
        t_s: Sampling period in s.
        dead_time_left: Amplitude in V that the judgement takes to be left of a dead time.
        points: Operating points: torques of the design's strategy at speeds up to the largest.
        torque: At them in N m, shape (N,).
        largest_current: Current limit in A (peak).
        seen: What is seen there.
    """

    sought: Sought
    gains: OnlineEstimationGains
    time_constant: float
    pole_pairs: int
    t_s: float
    dead_time_left: float
    points: OperatingSamples
    torque: FloatArray
    largest_current: float
    seen: Estimability

    @property
    def least_current(self) -> float:
        """Current in A (peak) from which the resistance is sought."""
        return math.sqrt(self.gains.square_least)

    def fastest_for_resistance(self, current: float) -> float:
        """Mechanical speed in rad/s up to which a q current in A (peak) shows the resistance."""
        return self.gains.resistive * current / self.pole_pairs

    def slowest_for_flux(self, current: float) -> float:
        """Mechanical speed in rad/s from which a current in A (peak) leaves the flux to be seen."""
        return (self.gains.omega_least + self.gains.turning * current) / self.pole_pairs


@dataclass(frozen=True, slots=True)
class _Wrong:
    """How a drive differs from what the step knows: relative errors, and in V what is left of a
    dead time.
    """

    r_s: float = 0.0
    psi_pm: float = 0.0
    l_d: float = 0.0
    l_q: float = 0.0
    sensor: float = 0.0
    left: float = 0.0


def _moved(
    machine: LinearMachine,
    t_s: float,
    advance: Callable[[OnlineEstimation, AlphaBeta, AlphaBeta, FloatArray, FloatArray], None],
    at: OperatingSamples,
    wrong: _Wrong,
    modelled: tuple[float, float],
    estimates: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Mean change of both estimates per sample over a turn, shape (N, 2), and the status.

    Args:
        machine: What the step knows.
        t_s: Sampling period in s.
        advance: The step on a state.
        at: Points.
        wrong: How the drive differs.
        modelled: Height in V of the voltage of the dead time that the step takes away, and its
            slope in 1/A.
        estimates: From which the step goes on.
    """
    errors = {name: getattr(wrong, name) for name in ("r_s", "psi_pm", "l_d", "l_q")}
    count = len(at.i_d)
    plant, own = plants(machine, errors, count), at.i_d + 1j * at.i_q
    theta = (np.arange(_ANGLES)[:, None] + 0.5) * (2.0 * np.pi / _ANGLES) + 0.0 * at.omega_e
    before = theta - at.omega_e * t_s
    turn = np.exp(1j * theta)
    last, now = own * np.exp(1j * before), own * turn
    height = modelled[0] + 0.25 * np.pi * wrong.left
    middle = 0.5 * (last + now)
    volts = steady_voltage(plant, own, at.omega_e, t_s) * turn
    volts = volts + _dead(middle, height, modelled[1])
    seen = [x * (1.0 + wrong.sensor) for x in (last, now)]
    r_s, psi_pm = (np.full(theta.shape, value) for value in estimates)
    none, zero = np.zeros(theta.shape, dtype=np.int64), np.zeros(theta.shape)
    kept = AlphaBeta(seen[0].real, seen[0].imag)
    state = OnlineEstimation(r_s, psi_pm, none, none + 1, zero, zero, kept, before)
    advance(
        state,
        AlphaBeta(volts.real, volts.imag),
        AlphaBeta(seen[1].real, seen[1].imag),
        theta,
        0.0 * theta + at.omega_e,
    )
    change = [np.mean(after - old, axis=0) for after, old in
              zip((state.r_s, state.psi_pm), estimates, strict=True)]  # fmt: skip
    return np.stack(change, axis=-1), np.asarray(state.status[0], dtype=np.float64)


_PHASES = np.exp(2j * np.pi / 3.0 * np.arange(3))


def _dead(current: Any, height: float, slope: float) -> Any:
    """Voltage in V that a dead time takes at a current in stator coordinates."""
    phases = (current[..., None] * np.conj(_PHASES)).real * slope
    return 2.0 / 3.0 * (height * np.clip(phases, -1.0, 1.0) @ _PHASES)


def estimability(
    machine: LinearMachine,
    t_s: float,
    gains: OnlineEstimationGains,
    sought: Sought,
    at: OperatingSamples,
    left: float,
) -> Estimability:
    """What the very step sees at points, and where causes shift it to.

    Args:
        machine: What the step knows.
        t_s: Sampling period in s.
        gains, sought: Of the step.
        at: Points.
        left: Amplitude in V of what is left of a dead time.
    """
    # Ends of the ranges are for wrong data; here the errors themselves count.
    wide = {"r": 1e3 * gains.r_most, "psi": 1e3 * gains.psi_most}
    free = replace(
        gains,
        **{f"{name}_least": -size for name, size in wide.items()},
        **{f"{name}_most": size for name, size in wide.items()},
    )

    def advance(
        state: OnlineEstimation, v: AlphaBeta, i: AlphaBeta, theta: FloatArray, omega: FloatArray
    ) -> None:
        step(sought, EXACT, free, state, v, i, theta, omega)

    size = np.array([machine.r_s, machine.psi_pm])
    modelled = gains.dead, gains.per_ampere

    def change(wrong: _Wrong, r_s: float = 0.0, psi_pm: float = 0.0) -> FloatArray:
        """Relative, from estimates that are so much wrong."""
        estimates = tuple(size * (1.0 + np.array([r_s, psi_pm])))
        moved, _ = _moved(machine, t_s, advance, at, wrong, modelled, estimates)
        return np.asarray(moved / size)

    exact = change(_Wrong())
    matrix = np.stack(
        [change(_Wrong(), r_s=1.0) - exact, change(_Wrong(), psi_pm=1.0) - exact], axis=-1
    )
    poles = np.real(np.linalg.eigvals(matrix)) / t_s
    _, status = _moved(machine, t_s, advance, at, _Wrong(), modelled, tuple(size))
    causes = {
        "dead_time": _Wrong(left=left),
        "l_d": _Wrong(l_d=INDUCTANCE_WRONG),
        "l_q": _Wrong(l_q=INDUCTANCE_WRONG),
        "sensor": _Wrong(sensor=SENSOR_WRONG),
        "r_s": _Wrong(r_s=RESISTANCE_WRONG),
        "psi_pm": _Wrong(psi_pm=FLUX_WRONG),
    }
    shifts = {
        name: _rest(matrix, change(wrong)) - np.array([wrong.r_s, wrong.psi_pm])
        for name, wrong in causes.items()
    }
    return Estimability(status, poles, shifts)


def _rest(matrix: FloatArray, change: FloatArray) -> FloatArray:
    """Where matrix x + change is zero, shape (N, 2); nan in what no point moves."""
    found = np.full(change.shape, np.nan)
    for n, (rows, moved) in enumerate(zip(matrix, change, strict=True)):
        live = np.flatnonzero(np.any(rows != 0.0, axis=1))
        if live.size:
            found[n, live] = np.linalg.solve(rows[np.ix_(live, live)], -moved[live])
    return found


def _points(design: Design) -> tuple[FloatArray, OperatingSamples]:
    """Torques in N m by the design's strategy, at each of the speeds."""
    choice, machine = current_choice(design), design.machine
    largest = design.control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    torque, share = (
        grid.ravel()
        for grid in np.meshgrid(
            choice.largest_torque() * np.array(_SHARES), np.array(_SPEEDS), indexing="ij"
        )
    )
    i_d, i_q = (np.asarray(x) for x in choice.currents(torque))
    omega = machine.pole_pairs * largest * share
    v_d = machine.r_s * i_d - omega * machine.l_q * i_q
    v_q = machine.r_s * i_q + omega * (machine.l_d * i_d + machine.psi_pm)
    there = np.hypot(v_d, v_q) <= design.v_max
    return torque[there], OperatingSamples(i_d[there], i_q[there], omega[there])


@on_design("control")
def solve_online_estimation(design: Design) -> OnlineEstimationFit | None:
    """The on-line estimation that a design asks for, None where it asks for none."""
    settings, machine = design.control.online_estimation, design.machine
    if settings is None:
        return None
    assert isinstance(machine, LinearMachine)
    gains, sought, left = gains_of(design), sought_of(design), left_of_dead_time(design)
    torque, points = _points(design)
    return OnlineEstimationFit(
        sought=sought,
        gains=gains,
        time_constant=settings.time_constant,
        pole_pairs=machine.pole_pairs,
        t_s=design.control.t_s,
        dead_time_left=left,
        points=points,
        torque=torque,
        largest_current=design.i_max,
        seen=estimability(machine, design.control.t_s, gains, sought, points, left),
    )


def advancing(sought: Sought) -> Callable[..., None]:
    """The step of what is sought, as a function of an arithmetic and its arguments."""
    return partial(step, sought)
