"""What all position observers are made of: their record, their state, its steady values, and the
numbers by which they are tuned and judged.

An observer is a module of three functions (docs/methods/position-observers.md): ``design`` makes
its gains, ``start`` its first state, ``step`` the next one, written once, over an `Arithmetic`
(`dqforge.optimizer.steps.step_arithmetic`), from which `dqforge.reports.steps.observer_text` writes
C.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import Deviation, ObserverSettings, both_sides
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import ComplexArray, DriveMotion, Plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.reduced_order import Training, TrainingBox
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Member, Pair, cast


@dataclass(frozen=True, slots=True)
class StateMembers:
    """Vectors and scalars of an `ObserverState` by their names in the firmware, in their order,
    and what its angle is.
    """

    vectors: tuple[tuple[str, Member], ...]
    scalars: tuple[tuple[str, Member], ...] = ()
    angle: Member = Member("estimated electrical angle", "rad, -pi to pi")


@dataclass(frozen=True, slots=True, eq=False)
class ObserverState:
    """State of N observers: vectors in stationary coordinates, angle in rad and
    speed in rad/s (electrical).

    ``started`` is false until the first step, which takes the currents of the instant for which the
    angle was given. ``scalars`` are what else it remembers, none of which turns with the rotor.
    """

    vectors: tuple[Pair, ...]
    theta_e: Reals
    omega_e: Reals
    started: bool = True
    scalars: tuple[Reals, ...] = ()


# Steady states of a position observer: fixed points of its step, poles,
# and the noise that it lets through.
#
# In coordinates that turn with the rotor a steady drive stands still, and so does its observer: its
# state is a fixed point of the step, found by Newton's method at many speeds and many wrong
# machines at once. The derivative there has the poles of the whole observer, loop included, as
# eigenvalues; it carries the noise of currents and voltages into the angle (Lyapunov equation). A
# constant acceleration is a steady state, too, with a speed that moves by a t_s per sample.

_NEWTON_STEPS = 12


_DOUBLINGS = 40
_VANISHED = 1e-100  # Of a power of the derivative: what its square adds is below every digit.


@dataclass(frozen=True, slots=True, eq=False)
class SteadyObserver:
    """Steady states of an observer, arrays over M cases.

    ``theta_error`` in rad and ``omega_error`` in rad/s are estimate minus truth, shape (M,);
    ``jacobian`` (M, n, n) the derivative of one step by the state (vectors, angle, speed);
    ``by_current``, ``by_voltage`` (M, n, 2) that by the measured current and voltage; ``found``
    (M,) whether a fixed point was found, ``states`` (M, n) its vectors, scalars, angle error and
    speed error.
    """

    theta_error: FloatArray
    omega_error: FloatArray
    jacobian: FloatArray
    by_current: FloatArray
    by_voltage: FloatArray
    found: NDArray[np.bool_]
    states: FloatArray

    @property
    def poles(self) -> ComplexArray:
        """Poles in the z plane, largest modulus first, shape (M, n)."""
        values = np.linalg.eigvals(self.jacobian).astype(np.complex128)
        order = np.argsort(-np.abs(values), axis=1, kind="stable")
        return np.take_along_axis(values, order, axis=1)

    def angle_noise(self, i_noise: float, v_noise: float) -> FloatArray:
        """Standard deviation of the angle in rad under white noise of A and V per component;
        inf if unstable.
        """
        drive = i_noise**2 * _square(self.by_current) + v_noise**2 * _square(self.by_voltage)
        covariance, power = drive, self.jacobian.copy()
        stable = np.max(np.abs(np.linalg.eigvals(self.jacobian)), axis=1) < 1.0 - 1e-9
        power[~stable] = 0.0
        for _ in range(_DOUBLINGS):
            covariance = covariance + power @ covariance @ np.swapaxes(power, 1, 2)
            power = power @ power
            if np.max(np.abs(power), initial=0.0) < _VANISHED:
                break
        return np.where(stable, np.sqrt(np.maximum(covariance[:, -2, -2], 0.0)), np.inf)


def _square(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix @ np.swapaxes(matrix, 1, 2), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """M steady operating points in rotor coordinates at the instant of sampling."""

    omega: FloatArray
    turn: FloatArray
    drift: FloatArray
    v: ComplexArray
    i: ComplexArray

    def repeated(self, count: int) -> _Case:
        omega, turn, drift = (np.tile(part, count) for part in (self.omega, self.turn, self.drift))
        return _Case(omega, turn, drift, np.tile(self.v, count), np.tile(self.i, count))

    def taken(self, index: NDArray[np.intp]) -> _Case:
        own = (self.omega, self.turn, self.drift)
        omega, turn, drift = (part[index] for part in own)
        return _Case(omega, turn, drift, self.v[index], self.i[index])


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


def vector_count(method: ObserverMethod) -> int:
    """How many vectors the state of an observer holds."""
    return len(method.start(np.zeros(1), np.zeros(1)).vectors)


def _stepped(method: ObserverMethod, gains: Any, case: _Case, states: FloatArray) -> FloatArray:
    """States (M, n) one sample on; angle and speed in them are relative to the truth."""
    back = np.exp(-1j * case.turn)
    count = vector_count(method)
    vectors = tuple(
        _pair((states[:, 2 * n] + 1j * states[:, 2 * n + 1]) * back) for n in range(count)
    )
    scalars = tuple(states[:, n] for n in range(2 * count, states.shape[1] - 2))
    angle, speed = states[:, -2] - case.turn, states[:, -1] + case.omega - case.drift
    before = ObserverState(vectors, angle, speed, scalars=scalars)
    after = method.step(gains, before, _pair(case.v), _pair(case.i), EXACT)
    columns = [part for vector in after.vectors for part in vector] + list(after.scalars)
    return np.stack([*columns, EXACT.wrap(after.theta_e), after.omega_e - case.omega], axis=1)


def _settled(method: ObserverMethod, gains: Any, case: _Case) -> FloatArray:
    """States (M, n) some steps after the start."""
    state = method.step(
        gains,
        method.start(np.zeros_like(case.omega), case.omega),
        _pair(case.v),
        _pair(case.i),
        EXACT,
    )
    columns = [part for vector in state.vectors for part in vector] + list(state.scalars)
    states = np.stack([*columns, np.zeros_like(case.omega), np.zeros_like(case.omega)], axis=1)
    for _ in range(method.settle):
        states = _stepped(method, gains, case, states)
    return states


def _derivative(method: ObserverMethod, gains: Any, case: _Case, states: FloatArray) -> FloatArray:
    """Central differences of a step by the state, shape (M, n, n)."""
    m, n = states.shape
    size = np.ones((m, n))
    count = 2 * vector_count(method)
    if method.sizes is not None:
        size[:, count:-2] = method.sizes(states[:, count:-2], case.omega)
    for k in range(0, count, 2):
        norm = np.hypot(states[:, k], states[:, k + 1])
        size[:, k] = size[:, k + 1] = np.where(norm > 1e-6, norm, 1.0)
    size[:, -1] = np.maximum(np.abs(case.omega), 1.0)
    steps = 1e-6 * size
    moved = np.concatenate(
        [states + sign * steps * np.eye(n)[k] for sign in (1.0, -1.0) for k in range(n)]
    )
    values = _stepped(method, gains, case.repeated(2 * n), moved).reshape(2, n, m, n)
    slope = (values[0] - values[1]) / (2.0 * steps.T[:, :, None])
    return np.asarray(np.moveaxis(slope, 0, -1), dtype=np.float64)


def _by_input(
    method: ObserverMethod, gains: Any, case: _Case, states: FloatArray, name: str
) -> FloatArray:
    """Central differences of a step by current or voltage, shape (M, n, 2)."""
    columns = []
    value = case.i if name == "i" else case.v
    size = 1e-6 * (np.max(np.abs(value)) + 1e-3)
    for direction in (1.0, 1j):
        ends = []
        for sign in (1.0, -1.0):
            other = value + sign * size * direction
            moved = _Case(
                case.omega,
                case.turn,
                case.drift,
                case.v if name == "i" else other,
                other if name == "i" else case.i,
            )
            ends.append(_stepped(method, gains, moved, states))
        columns.append((ends[0] - ends[1]) / (2.0 * size))
    return np.stack(columns, axis=-1)


def steady_observer(
    method: ObserverMethod,
    gains: Any,
    t_s: float,
    plant: Plants,
    i_dq: ComplexArray,
    omega: FloatArray,
    acceleration: FloatArray | float = 0.0,
    lost: FloatArray | float = 0.0,
) -> SteadyObserver:
    """Steady states of an observer on M drives.

    Args:
        plant: The true machines, M of them; the observer knows the one of its gains.
        i_dq: True currents i_d + j i_q in A, shape (M,).
        omega, acceleration: Electrical speed in rad/s at the sampling instant and acceleration in
            rad/s^2, shape (M,).
        lost: Voltage in V along the current that the inverter loses and the observer knows nothing
            of (dead time), scalar or shape (M,).
    """
    drift = np.broadcast_to(np.asarray(acceleration, dtype=np.float64) * t_s, omega.shape)
    mean = omega - 0.5 * drift
    i_dq = np.array(np.broadcast_to(i_dq, omega.shape), dtype=np.complex128)
    acted = steady_voltage(plant, i_dq, mean, t_s)
    # The current turns with the rotor; what is lost along it lies, on average over the period,
    # half a turn behind.
    believed = acted + np.asarray(lost) * np.exp(1j * (np.angle(i_dq) - 0.5 * mean * t_s)) * (
        i_dq != 0.0
    )
    case = _Case(omega, mean * t_s, np.array(drift), believed, i_dq)
    with np.errstate(
        all="ignore"
    ):  # beyond the range of an observer its numbers may grow without bound
        return _solved(method, gains, case)


def newton_moves(slope: FloatArray, gap: FloatArray) -> FloatArray:
    """Newton's moves, shape (N, n); where a matrix is singular the shortest that fits best, nan
    where its numbers are not finite.
    """
    try:
        return np.asarray(np.linalg.solve(slope, gap[..., None])[..., 0])
    except np.linalg.LinAlgError:
        finite = np.all(np.isfinite(slope), axis=(1, 2))
        inverse = np.linalg.pinv(np.where(finite[:, None, None], slope, 0.0))
        return np.where(finite[:, None], (inverse @ gap[..., None])[..., 0], np.nan)


def _solved(method: ObserverMethod, gains: Any, case: _Case) -> SteadyObserver:
    """Steady states of all cases, and what a step there makes of states and inputs.

    One whose numbers are not finite counts as lost and unstable.
    """
    if method.rest is None:
        states, jacobian, found = _newton(method, gains, case, _settled(method, gains, case))
    else:
        first = method.rest(gains, case.omega, case.v, case.i)
        zero = np.zeros((len(first), 2))
        states, jacobian, found = _newton(method, gains, case, np.hstack([first, zero]))
        if len(lost := np.flatnonzero(~found)):
            left = case.taken(lost)
            again = _newton(method, gains, left, _settled(method, gains, left))
            states[lost], jacobian[lost], found[lost] = again
    inputs = [_by_input(method, gains, case, states, name) for name in ("i", "v")]
    finite = np.all(np.isfinite(states), axis=1)
    for part in (jacobian, *inputs):
        finite &= np.all(np.isfinite(part), axis=(1, 2))
    jacobian[~finite] = 2.0 * np.eye(states.shape[1])
    return SteadyObserver(
        theta_error=states[:, -2],
        omega_error=states[:, -1],
        jacobian=jacobian,
        by_current=np.where(finite[:, None, None], inputs[0], 0.0),
        by_voltage=np.where(finite[:, None, None], inputs[1], 0.0),
        found=found & finite,
        states=states,
    )


def _newton(
    method: ObserverMethod, gains: Any, case: _Case, states: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """States (M, n) that a step leaves as they are, its derivative there, and which were found.

    Those that rest are left alone: in most sets a few never do.
    """
    jacobian = _derivative(method, gains, case, states)
    states, moving, own = states.copy(), np.arange(len(states)), case
    for _ in range(_NEWTON_STEPS):
        gap = _stepped(method, gains, own, states[moving]) - states[moving]
        gap[:, -2] = EXACT.wrap(gap[:, -2])
        away = np.max(np.abs(gap) / (1.0 + np.abs(states[moving])), axis=1) >= 1e-11
        if not np.any(away):
            break
        moving = moving[away]
        own = case.taken(moving)
        slope = np.eye(states.shape[1]) * (1.0 + 1e-13) - jacobian[moving]
        moved = states[moving] + newton_moves(slope, gap[away])
        moved[:, -2] = EXACT.wrap(moved[:, -2])
        states[moving] = moved
        jacobian[moving] = _derivative(method, gains, own, moved)
    gap = _stepped(method, gains, case, states) - states
    found = (np.abs(EXACT.wrap(gap[:, -2])) < 1e-9) & (np.abs(states[:, -2]) < 0.5 * np.pi)
    return states, jacobian, found


def closed_form_error(
    machine: LinearMachine, believed: LinearMachine, i_dq: complex, omega: FloatArray
) -> FloatArray:
    """Steady angle error in rad of the extended EMF and of the open-loop flux, shape (S,).

    Both follow psi_a = psi_pm + (L_d - L_q^) i_d + j (L_q - L_q^) i_q + (R - R^) (i_d + j i_q)/(j
    omega), with ^ for what the observer believes; neither L_d^ nor psi_pm^ matters. The error
    theta_hat - theta is the angle of psi_a.
    """
    along = machine.psi_pm + (machine.l_d - believed.l_q) * i_dq.real
    across = (machine.l_q - believed.l_q) * i_dq.imag
    drop = (machine.r_s - believed.r_s) * i_dq / (1j * omega)
    return np.asarray(np.arctan2(across + drop.imag, along + drop.real), dtype=np.float64)


# What a position observer is: its record, its estimates, and a run over samples.


def loop_in_words(tuning: ObserverTuning, _gains: Any, _t_s: float) -> str:
    """``in_words`` of a filter before a phase-locked loop.

    Args:
        tuning: Its numbers.
    """
    return (
        f"bandwidth {tuning.bandwidth:.5g} rad/s; loop {tuning.pll_bandwidth:.5g} rad/s, "
        f"damping {tuning.damping:.3g}"
    )


def flux_in_words(tuning: ObserverTuning, _gains: Any, _t_s: float) -> str:
    """``in_words`` of a flux linkage that is corrected before a phase-locked loop.

    Args:
        tuning: Its numbers.
    """
    return (
        f"bandwidth {tuning.bandwidth:.5g} rad/s, speed_gain {tuning.speed_gain:.4g}; loop "
        f"{tuning.pll_bandwidth:.5g} rad/s, damping {tuning.damping:.3g}"
    )


def loop_scale(gains: Any) -> tuple[float, float]:
    """``scale`` of gains that hold those of a phase-locked loop and the magnet flux linkage.

    Args:
        gains: With members ``pll`` and ``psi_pm``.
    """
    return float(gains.pll.t_s), float(gains.psi_pm)


@dataclass(frozen=True, slots=True)
class ObserverMethod:
    """One method of observing the position.

    Args:
        name: As in the design file; ``code`` is the part of C names, ``title`` says it in words.
        design: (machine, tuning, t_s, largest electrical speed in rad/s) -> gains, a frozen
            dataclass of floats.
        start, step: First and next state, see `dqforge.optimizer.observers.parts`.
        usual: (machine, t_s, largest electrical speed in rad/s) -> the tuning where the design
            leaves it open.
        searched: The tuning entries that ``tuning: optimised`` searches; none of a method that
            tunes itself.
        gains: The dataclass that ``design`` returns.
        scale: gains -> (sampling period in s, magnet flux linkage in Wb): the scale of what it
            sees.
        in_words: (tuning, gains, sampling period in s) -> by what numbers it is tuned.
        settle: Steps from the start after which Newton's method finds the steady state that is
            reached, and no other.
        rest: (gains, electrical speeds in rad/s, voltages in V, currents in A) -> scalars of the
            steady state of machines that are as believed, shape (M, n), from which Newton's method
            is tried first; voltages and currents are d + j q in the rotor's frame at the sample.
        sizes: (scalars of M states, shape (M, n), electrical speeds in rad/s, shape (M,)) -> how
            large a change of each scalar is noticeable, shape (M, n), positive. In a steady state
            many are nil, so that their own size tells nothing. None without scalars.
        certify: (gains, least and largest electrical speed in rad/s, largest |i_q| in A) -> factor
            by which a norm of a small error shrinks at least in every sample, however the speed
            changes in between, proven without gaps, and the matrix of the norm; `NoSolutionError`
            where none is found. None for a method whose step is checked at many speeds instead.
        unproven: Why neither is sought; empty where one is.
        train: (gains of ``design``, machine, settings, box, largest electrical speed in rad/s) ->
            gains with what was learned in them, and what that gains. None for a method that learns
            nothing.
        members: What the firmware calls vectors and scalars of the state; its C is written from
            ``step``.
    """

    name: str
    code: str
    title: str
    design: Callable[[LinearMachine, ObserverTuning, float, float], Any]
    start: Callable[[Reals, Reals], ObserverState]
    step: Callable[[Any, ObserverState, Pair, Pair, Arithmetic], ObserverState]
    usual: Callable[[LinearMachine, float, float], ObserverTuning]
    searched: tuple[str, ...]
    gains: type[Any]
    scale: Callable[[Any], tuple[float, float]]
    members: StateMembers
    in_words: Callable[[ObserverTuning, Any, float], str] = loop_in_words
    settle: int = 0
    rest: Callable[[Any, FloatArray, ComplexArray, ComplexArray], FloatArray] | None = None
    sizes: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    certify: Callable[[Any, float, float, float], tuple[float, FloatArray]] | None = None
    unproven: str = ""
    train: (
        Callable[[Any, LinearMachine, ObserverSettings, TrainingBox, float], tuple[Any, Training]]
        | None
    ) = None


@dataclass(frozen=True, slots=True)
class FirmwareStep:
    """An observer of any kind as far as the firmware runs it.

    Args:
        code: Part of the names in C.
        gains: Type of the gains.
        start: (angle in rad, speed in rad/s) -> first state, shapes (N,).
        step: (gains, state, voltage, current, arithmetic, further numbers) -> next state.
        members: Vectors and scalars of the state.
        started, stepped: What is said of both functions.
        further: Names of the numbers that the step is told besides.
    """

    code: str
    gains: type[Any]
    start: Callable[[Reals, Reals], ObserverState]
    step: Callable[..., ObserverState]
    members: StateMembers
    started: str = (
        "Start from an angle in rad and a speed in rad/s (electrical) at the instant of the first "
        "step."
    )
    stepped: str = (
        "One sample: v in V acted over the period that ends at the sampling instant of i in A."
    )
    further: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Estimated electrical angle in rad (wrapped) and speed in rad/s at the samples, shape (steps,
    N).
    """

    theta_e: FloatArray
    omega_e: FloatArray

    def angle_error(self, motion: DriveMotion) -> FloatArray:
        """Estimated minus true angle in rad, wrapped to -pi to pi, shape (steps, N)."""
        gap = np.asarray(self.theta_e, dtype=np.float64) - motion.theta_e
        return np.asarray((gap + np.pi) % (2.0 * np.pi) - np.pi, dtype=np.float64)


def observe(
    method: ObserverMethod,
    gains: Any,
    motion: DriveMotion,
    theta_0: Any = None,
    omega_0: Any = None,
    maths: Arithmetic = EXACT,
) -> Estimates:
    """Run an observer over what N drives measured.

    Args:
        theta_0, omega_0: First estimates, scalars or shape (N,); None for the true values.
    """
    number, shape = maths.number, motion.theta_e.shape
    first = (
        motion.theta_e[0] if theta_0 is None else np.broadcast_to(np.asarray(theta_0), shape[1:])
    )
    speed = (
        motion.omega_e[0] if omega_0 is None else np.broadcast_to(np.asarray(omega_0), shape[1:])
    )
    seen = [
        part.astype(number)
        for part in (motion.v_alpha, motion.v_beta, motion.i_alpha, motion.i_beta)
    ]
    own = cast(gains, maths)
    state = method.start(maths.wrap(first.astype(number)), np.array(speed, dtype=number))
    theta, omega = np.empty(shape, dtype=number), np.empty(shape, dtype=number)
    for k in range(shape[0]):
        state = method.step(own, state, (seen[0][k], seen[1][k]), (seen[2][k], seen[3][k]), maths)
        theta[k], omega[k] = state.theta_e, state.omega_e
    return Estimates(theta, omega)


# The few numbers by which every position observer is tuned, and the sensible ones of a machine.

# Largest angle in rad per period for which the observers are made: the omitted terms of their
# series stay small.
LARGEST_TURN = 0.8


@dataclass(frozen=True, slots=True)
class ObserverTuning:
    """Tuning of a position observer.

    Args:
        bandwidth: In rad/s: of the EMF filter, or of the correction of the flux at standstill.
        pll_bandwidth, damping: Natural frequency in rad/s and damping ratio of the phase-locked
            loop.
        speed_gain: Share of the electrical speed that is added to the correction of the flux.
        omega_floor: Electrical speed in rad/s below which no observer by the back-EMF follows at
            full strength.
    """

    bandwidth: float
    pll_bandwidth: float
    damping: float = 1.0
    speed_gain: float = 0.2
    omega_floor: float = 1.0


@dataclass(frozen=True, slots=True)
class Load:
    """A steady load: currents in A, and the machine there.

    ``l_d`` in H is the incremental inductance, ``psi_pm`` in Wb what psi_d has beside l_d i_d,
    ``l_q`` in H the ratio of psi_q and i_q: of a saturated machine these make the flux linkages
    that it has at this very load.
    """

    i_d: float
    i_q: float
    l_d: float
    l_q: float
    psi_pm: float

    @classmethod
    def on(cls, machine: LinearMachine, i_q: float) -> Load:
        """A load of a linear machine with i_d = 0."""
        return cls(0.0, i_q, machine.l_d, machine.l_q, machine.psi_pm)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """What an observer has to live with.

    ``i_noise`` in A and ``v_noise`` in V are r.m.s. values per component; ``r_s``, ``l_d``,
    ``l_q``, ``psi_pm`` relative parameter errors, to either side or from the first to the second;
    ``acceleration`` in rad/s^2 (electrical). ``lost`` in V is the voltage along the current that a
    dead time costs and the observer knows nothing of, ``lost_least`` the least that it may be:
    negative where it may as well be compensated too much. ``loads`` are the steady loads, the
    acceleration at the first of them; none for one of ``i_load`` A with i_d = 0.
    """

    i_noise: float
    v_noise: float
    i_load: float
    acceleration: float
    r_s: Deviation = 0.3
    l_d: Deviation = 0.1
    l_q: Deviation = 0.1
    psi_pm: Deviation = 0.1
    lost: float = 0.0
    lost_least: float = 0.0
    loads: tuple[Load, ...] = ()

    def limits(self, name: str) -> tuple[float, float]:
        """Least and largest relative error of one parameter."""
        return both_sides(getattr(self, name))


def usual_disturbances(machine: LinearMachine, v_dc: float, omega_max: float) -> Disturbances:
    """Noise of 0.5 % of the current limit and 0.2 % of the dc link, R 30 % and the rest 10 % wrong,
    half the current.

    The acceleration is that of the load current, or the one that reaches ``omega_max`` rad/s in 0.2
    s where the inertia is not known.
    """
    i_load = 0.5 * machine.i_max
    acceleration = omega_max / 0.2
    if machine.inertia is not None and machine.psi_pm > 0.0:
        acceleration = machine.pole_pairs * machine.torque_per_ampere * i_load / machine.inertia
    return Disturbances(5e-3 * machine.i_max, 2e-3 * v_dc, i_load, acceleration)


def require_magnet(machine: LinearMachine) -> None:
    """Refuse a machine whose back-EMF or active flux vanishes without current."""
    if not machine.psi_pm > 0.0:
        raise InputError(
            "control.observer: this observer needs a magnet flux (machine.psi_pm); leave the "
            "section out"
        )


USUAL_WIDTH = 200.0
USUAL_SHARE_OF_SPEED = 0.3
