"""The current control of a phase machine judged from standstill to its largest speed, over the box
of drives that the tolerances allow.

Of each speed the loop's currents are judged (`dqforge.optimizer.phase_control.judged_box`): without
harmonic integrators and with the midpoint of a split link held, whose own, far slower motions are
stated beside. Every speed must forget what disturbed it at every point of the box, with all of them
running.

L_0 is no key of the tolerances: it moves on its own, as far as the inductance of d or of q may,
whichever is further. Corners are all combinations; where the step of the loop is the same at every
angle, random points inside them are tried as well.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentFrame
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import POWER_INVARIANT, clarke_matrix, in_rpm
from dqforge.optimizer.loops.robustness import BoxPoints, DriveBox, Worst
from dqforge.optimizer.phase_control.phase_controller import HarmonicGains, PhaseControl, PhaseShape

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # Of the largest speed, at which the loop is judged.

# Radius above 1 that is taken for rounding: of an integrator that has all but faded.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class JudgedSpeed:
    """What the loop keeps of a disturbance at one speed.

    Args:
        omega_m: Mechanical speed in rad/s.
        samples: Samples per electrical period; infinite at standstill.
        nominal: Largest modulus of a multiplier of the currents per sample, with the data
            themselves.
        decay_time: Time in s in which the slowest of them falls to 1/e.
        worst: The largest over the box and where, None without tolerances.
        orders: Orders of the harmonic integrators that run, of the plane and of the zero sequence;
            at standstill, where all of them do the work of the plain integrators, none are counted.
        learning_time: Time in s in which the slowest of those that run at more than half of their
            weight learns to 1/e; None where none does.
    """

    omega_m: float
    samples: float
    nominal: float
    decay_time: float
    worst: Worst | None
    orders: tuple[tuple[int, ...], tuple[int, ...]]
    learning_time: float | None


@dataclass(frozen=True, slots=True)
class JudgedLoops:
    """The judgement of the current control of a phase machine.

    ``speeds`` ascend from standstill. ``corners`` and ``inside`` count the points of the box that
    were checked at each, 0 without tolerances. ``midpoint_time`` is the time in s in which the
    midpoint of a split link returns to 1/e, at the largest speed, None for all other topologies.
    """

    speeds: tuple[JudgedSpeed, ...]
    corners: int
    inside: int
    midpoint_time: float | None

    @property
    def slowest(self) -> JudgedSpeed:
        """The speed with the largest radius, over the box where there is one."""
        return max(
            self.speeds,
            key=lambda found: found.nominal if found.worst is None else found.worst.value,
        )


@dataclass(frozen=True, slots=True, eq=False)
class TriedDrives:
    """Drives of the box: their windings, and which of its points they are; the last is the data.

    ``rows`` of ``points`` has shape (M,) for the M ``plants``.
    """

    plants: PhasePlants
    points: BoxPoints
    rows: NDArray[np.int64]

    @property
    def data(self) -> PhasePlants:
        """The drive of the data themselves."""
        every = self.plants
        held = None if every.capacitance is None else every.capacitance[-1:]
        l_d, l_q, l_0 = every.l_d[-1:], every.l_q[-1:], every.l_0[-1:]
        return PhasePlants(every.r_s[-1:], l_d, l_q, l_0, every.gain[-1:], held)

    def worst(self, radii: FloatArray) -> Worst:
        """The largest radius, shape (M,), and where."""
        row = int(np.argmax(radii))
        return Worst(float(radii[row]), self.points.text(int(self.rows[row])))


def judge_loops(
    control: PhaseControl,
    box: DriveBox,
    omega_m_max: float,
    capacitance: float | None,
    *,
    named: bool,
) -> JudgedLoops:
    """Radii of the current control over speeds and tolerances.

    Args:
        control: The current control.
        box: The drive with its tolerances.
        omega_m_max: Largest mechanical speed in rad/s.
        capacitance: Of both halves of a split link together in F.
        named: Whether the design names tolerances.

    Raises:
        NoSolutionError: The loop does not forget at some speed and point; names both.
    """
    drives = _drives(control, box, capacitance, named=named)
    speeds = tuple(_judged(control, drives, share * omega_m_max, named=named) for share in SHARES)
    midpoint = None
    if control.midpoint is not None:
        unlearned = replace(control, harmonics=None)
        slow = radius(unlearned, drives.data, control.pole_pairs * omega_m_max)
        midpoint = _time(control, slow)
    corners = drives.points.corners if named else 0
    return JudgedLoops(speeds, corners, drives.rows.size - 1 - corners if named else 0, midpoint)


def _drives(
    control: PhaseControl, box: DriveBox, capacitance: float | None, *, named: bool
) -> TriedDrives:
    """The drives that are tried, all of the box or the data alone."""
    points = box.phase_points(zero=TOPOLOGIES[control.topology].neutral)
    count = len(points.deviations)
    rows = np.arange(count if named else 0, dtype=np.int64)
    if not turns_at_rest(control):
        rows = rows[: points.corners]
    rows = np.union1d(rows, [count - 1])
    l_d, l_q, l_0 = (
        size * (1.0 + points.of(name)[rows])
        for size, name in zip(control.inductances, ("l_d", "l_q", "l_0"), strict=True)
    )
    held = None if capacitance is None else np.full(rows.size, capacitance)
    gain = 1.0 + points.of("v_dc")[rows]
    plants = PhasePlants(box.resistance(points)[rows], l_d, l_q, l_0, gain, held)
    return TriedDrives(plants, points, rows)


def _judged(
    control: PhaseControl, drives: TriedDrives, omega_m: float, *, named: bool
) -> JudgedSpeed:
    omega_e = control.pole_pairs * omega_m
    currents = _held_midpoint(replace(control, harmonics=None))
    if not turns_at_rest(currents) and omega_e != 0.0:
        omega_e = whole_samples(control, omega_e).omega_e
    if omega_e == 0.0:  # At rest all orders are one integrator.
        control = replace(control, harmonics=None)
    state = loop_state(control, omega_e)
    found = radius(currents, drives.plants, omega_e)
    _require(drives.worst(found), control, omega_e, 1.0)
    if state.plane or state.zero or state.midpoint:
        together = radius(control, drives.plants, omega_e)
        _require(drives.worst(together), control, omega_e, 1.0 + ROUNDING)
    return JudgedSpeed(
        omega_m=omega_e / control.pole_pairs,
        samples=_samples(control, omega_e),
        nominal=float(found[-1]),
        decay_time=_time(control, found[-1:]),
        worst=drives.worst(found) if named else None,
        orders=(tuple(m for m, _ in state.plane), tuple(m for m, _ in state.zero)),
        learning_time=_learning_time(control, drives.data, omega_e),
    )


def _held_midpoint(control: PhaseControl) -> PhaseControl:
    """The same control against a midpoint that stays where it is: legs drive the same currents."""
    if control.midpoint is None:
        return control
    return replace(control, topology="six-leg", midpoint=None)


def _learning_time(control: PhaseControl, data: PhasePlants, omega_e: float) -> float | None:
    """Time in s of the slowest order that runs at more than half of its weight."""
    state, harmonics = loop_state(control, omega_e), control.harmonics
    plane, zero = (
        tuple(m for m, weight in part if weight > 0.5) for part in (state.plane, state.zero)
    )
    if harmonics is None or not (plane or zero):
        return None
    running = replace(control, harmonics=replace(harmonics, plane=plane, zero=zero))
    return _time(control, radius(_held_midpoint(running), data, omega_e))


def _time(control: PhaseControl, radii: FloatArray) -> float:
    """Time in s in which what is multiplied by the radius per sample, shape (1,), falls to 1/e."""
    modulus = float(radii[0])
    return float(-control.t_s / np.log(modulus)) if 0.0 < modulus < 1.0 else float("inf")


def _samples(control: PhaseControl, omega_e: float) -> float:
    """Samples per electrical period."""
    return 2.0 * np.pi / (omega_e * control.t_s) if omega_e else float("inf")


def _require(worst: Worst, control: PhaseControl, omega_e: float, limit: float) -> None:
    """Refuse a loop that does not forget, with speed, point and what to write instead."""
    if worst.value < limit:
        return
    rpm = in_rpm(omega_e / control.pole_pairs)
    if control.feedforward == "measured":
        advice = "write control.current_loop.feedforward: references, which moves no pole"
    else:
        advice = "lower the gains or machine.max_speed, sample faster, or narrow control.tolerances"
    period = f", {_samples(control, omega_e):.3g} samples per period" if omega_e else ""
    raise NoSolutionError(
        f"control.current_loop: in frame {control.frame} the currents are unstable at {rpm:.5g} "
        f"rpm{period}, {worst.at} (radius {worst.value:.4g} per sample): {advice}"
    )


# One sample of plant and current controller of a phase machine, as a linear map that repeats with
# the back-EMF.
#
# References and back-EMF are inputs and move no multiplier; what remains is linear in the state
#
#     x[k] = (i[k], v_m[k], u[k], I[k-1], s_m[k])
#
# of the currents, the midpoint of a split link, the voltage in flight (computed from sample k - 1,
# it acts from k to k + 1), the integrators, and two numbers per order of a harmonic integrator,
# turned along with its harmonic: s_m[k] = r_m[k-1] exp(j (m - 1) theta_k) in alpha and beta, with m
# in place of m - 1 on the 0 axis. Currents, voltages and s_m are seen from the rotor (d, q and 0 of
# theta_k), so that the rotor's saliency is a constant and, where the integrators live in dq0 and no
# midpoint is balanced along the back-EMF, the whole step: then its eigenvalues are those of the
# loop at any speed, and no period needs to be whole. The voltage stands still in the stator while
# the rotor turns on by omega T_s.
#
#     plant        L di/dt = u - R i - omega J L i per axis, exactly over a period; a split link
#                  besides C dv_m/dt = 3 i_0, L_0 di_0/dt = u_0 - R i_0 - v_m, u_0 = v_0 + v_m[k-1]
#     controller   u[k+1] = kp e + I[k] + harmonic integrators + coupling of measured currents,
#                  e = -i (of a split link less balance times v_m, at constant torque)
#
# The voltage limit, the fading of the references and what rests at large errors have no part in it.

FADES_FROM = 0.8  # Share of ``frequency_max`` from which on a harmonic integrator fades.

# Power-invariant over amplitude-invariant quantity on d, q and 0.
SCALE = np.array([POWER_INVARIANT, POWER_INVARIANT, np.sqrt(3.0)])
PLAIN = clarke_matrix()  # From phases to alpha, beta and 0, amplitude-invariant.
ADVANCE = 1.5  # Sampling periods from the sample to the middle of what its voltage does.


@dataclass(frozen=True, slots=True, eq=False)
class PhasePlants:
    """M windings and what feeds them, arrays of shape (M,).

    ``r_s`` in Ohm, ``l_d``, ``l_q`` and ``l_0`` in H, ``gain`` of the voltage, ``capacitance`` in F
    of both halves of a split link together, None for all other topologies.
    """

    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    l_0: FloatArray
    gain: FloatArray
    capacitance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class LoopState:
    """Which rows of the state are what.

    ``axes`` is 2 without and 3 with a zero sequence, ``midpoint`` whether v_m is a state, ``plane``
    and ``zero`` the orders of the harmonic integrators that run, each with its weight.
    """

    axes: int
    midpoint: bool
    plane: tuple[tuple[int, float], ...]
    zero: tuple[tuple[int, float], ...]

    @property
    def plant(self) -> int:
        """Number of states of the plant; those of the controller follow."""
        return self.axes + self.midpoint

    @property
    def size(self) -> int:
        """Number of all states."""
        return self.plant + 2 * self.axes + 2 * (len(self.plane) + len(self.zero))

    @property
    def currents(self) -> slice:
        """Currents in A."""
        return slice(0, self.axes)

    @property
    def voltages(self) -> slice:
        """Voltages in flight in V."""
        return slice(self.plant, self.plant + self.axes)

    @property
    def integrators(self) -> slice:
        """Integrators in V, in their frame."""
        return slice(self.plant + self.axes, self.plant + 2 * self.axes)

    def harmonic(self, place: int) -> slice:
        """Harmonic integrator in A, those of the plane first."""
        first = self.plant + 2 * self.axes + 2 * place
        return slice(first, first + 2)


def weight_of(harmonics: HarmonicGains, frequency: float) -> float:
    """How much of a harmonic integrator runs, 1 to 0, at its frequency in Hz."""
    share = abs(frequency) / harmonics.frequency_max
    return float(np.clip((1.0 - share) / (1.0 - FADES_FROM), 0.0, 1.0))


def loop_state(control: PhaseControl, omega_e: float) -> LoopState:
    """State of the loop at an electrical speed in rad/s; orders that have faded are no part of it.

    Args:
        control: The current control.
        omega_e: Electrical speed in rad/s.
    """
    rule, harmonics = TOPOLOGIES[control.topology], control.harmonics

    def running(orders: tuple[int, ...]) -> tuple[tuple[int, float], ...]:
        assert harmonics is not None
        weights = ((m, weight_of(harmonics, m * omega_e / (2.0 * np.pi))) for m in orders)
        return tuple((m, weight) for m, weight in weights if weight > 0.0)

    plane = () if harmonics is None else running(harmonics.plane)
    zero = () if harmonics is None or not rule.neutral else running(harmonics.zero)
    midpoint = rule.midpoint and control.midpoint is not None
    return LoopState(3 if rule.neutral else 2, midpoint, plane, zero)


def _turns(angle: float) -> FloatArray:
    """Matrix (2, 2) that turns by an angle in rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def _turned(angle: float, axes: int) -> FloatArray:
    """The same on d and q with the 0 axis as it is, where there is one; shape (axes, axes)."""
    matrix = np.eye(axes)
    matrix[:2, :2] = _turns(angle)
    return matrix


def _complex(number: complex) -> FloatArray:
    """What multiplies two real numbers as the complex number does, shape (2, 2)."""
    return np.array([[number.real, -number.imag], [number.imag, number.real]])


def plant_rows(plants: PhasePlants, state: LoopState, omega_e: float, t_s: float) -> FloatArray:
    """Maps of the state to the next currents (and midpoint), shape (M, ``state.plant``, n).

    Args:
        plants: The windings.
        state: Which rows are what.
        omega_e: Electrical speed in rad/s.
        t_s: Sampling period in s.
    """
    from scipy.linalg import expm

    count, own = len(plants.r_s), state.plant
    flow = np.zeros((count, own + state.axes, own + state.axes))
    flow[:, 0, 1] = omega_e * plants.l_q / plants.l_d
    flow[:, 1, 0] = -omega_e * plants.l_d / plants.l_q
    for axis, inductance in enumerate((plants.l_d, plants.l_q, plants.l_0)[: state.axes]):
        flow[:, axis, axis] = -plants.r_s / inductance
        flow[:, axis, own + axis] = plants.gain / inductance
    flow[:, own, own + 1], flow[:, own + 1, own] = omega_e, -omega_e
    if state.midpoint:
        assert plants.capacitance is not None
        flow[:, 2, 3], flow[:, 3, 2] = -1.0 / plants.l_0, 3.0 / plants.capacitance
    rows = np.zeros((count, own, state.size))
    rows[:, :, : own + state.axes] = expm(flow * t_s)[:, :own]
    return rows


def controller_rows(
    control: PhaseControl, state: LoopState, omega_e: float, theta: FloatArray
) -> FloatArray:
    """Maps of the state at K angles to what the controller holds next, shape (K, n - plant, n).

    Args:
        control: The current control.
        state: Which rows are what.
        omega_e: Electrical speed in rad/s.
        theta: Electrical angles of the samples in rad, shape (K,).
    """
    axes, own, t_s = state.axes, state.plant, control.t_s
    step = omega_e * t_s
    here = frame_motion(control.frame, control.shape, theta)
    ahead = frame_motion(control.frame, control.shape, theta + ADVANCE * step)
    error = _errors(control, state, theta)
    kp, ki = (
        np.array([[getattr(gain, name)] for gain in control.gains[:axes]]) for name in ("kp", "ki")
    )
    inward, outward = _into(here, axes), _turned(ADVANCE * step, axes) @ _out_of(ahead, axes)
    rows = np.zeros((theta.size, state.size - own, state.size))
    integral = t_s * ki * (inward @ error)
    integral[:, :, state.integrators] += np.eye(axes)
    rows[:, axes : 2 * axes] = integral
    voltage = kp * error + outward @ integral
    if control.feedforward == "measured":
        # What the currents need that keep their place in the frame, there where the voltage acts.
        needed = omega_e * _coupling(control, ahead, axes) @ _out_of(ahead, axes) @ inward
        voltage[:, :, state.currents] += _turned(ADVANCE * step, axes) @ needed
    if state.midpoint:
        voltage[:, 2, axes] += 1.0  # The duty cycles make up for the midpoint that is measured.
        if control.feedforward == "references":
            voltage[:, :, axes] += _balancing_voltage(control, omega_e, theta)
    _add_harmonics(control, state, omega_e, error, (voltage, rows))
    rows[:, :axes] = _turned(-step, axes) @ voltage
    return rows


def _errors(control: PhaseControl, state: LoopState, theta: FloatArray) -> FloatArray:
    """Maps of the state to the errors of the currents, shape (K, axes, n)."""
    error = np.zeros((theta.size, state.axes, state.size))
    error[:, :, state.currents] = -np.eye(state.axes)
    if state.midpoint:
        error[:, :, state.axes] = _balancing_current(control, theta)
    return error


def _balancing_current(control: PhaseControl, theta: FloatArray) -> FloatArray:
    """Reference in A per volt of the midpoint, in d, q and 0 of the angles, shape (K, 3).

    A zero sequence against the deviation, less its part along the back-EMF, which would make
    torque.
    """
    assert control.midpoint is not None
    alpha, beta, zero = PLAIN @ shape_at(control.shape, theta)[0]
    scale = 3.0 * zero / (1.5 * (alpha**2 + beta**2) + 3.0 * zero**2)
    cosine, sine = np.cos(theta), np.sin(theta)
    d, q = alpha * cosine + beta * sine, beta * cosine - alpha * sine
    return -control.midpoint.balance * np.stack(
        [-scale * d, -scale * q, 1.0 - scale * zero], axis=1
    )


def _balancing_voltage(control: PhaseControl, omega_e: float, theta: FloatArray) -> FloatArray:
    """Voltage in V per volt of the midpoint that is fed forward for its balance, shape (K, 3)."""
    step = omega_e * control.t_s
    found = np.zeros((theta.size, 3))
    for ahead, sign in ((1.0, -1.0), (2.0, 1.0)):
        current = _balancing_current(control, theta + ahead * step)
        part = 0.5 * control.r_s + sign / control.t_s * np.array(control.inductances)
        found += (current * part) @ _turned(ahead * step, 3).T
    return found


def _add_harmonics(
    control: PhaseControl,
    state: LoopState,
    omega_e: float,
    error: FloatArray,
    into: tuple[FloatArray, FloatArray],
) -> None:
    """Adds the harmonic integrators' voltages, and their rows, into (voltage, rows)."""
    voltage, rows = into
    for place, (order, weight) in enumerate(state.plane + state.zero):
        plane, at = place < len(state.plane), state.harmonic(place)
        picked = slice(0, 2) if plane else slice(2, 3)
        assert control.harmonics is not None
        acts = _complex(weight * _inverse_plant(control, order, omega_e, plane=plane))
        voltage[:, picked, at] += acts if plane else acts[:1]
        held = np.zeros((len(error), 2, state.size))
        held[:, : 2 if plane else 1] = (
            control.harmonics.rate * control.t_s * weight * error[:, picked]
        )
        held[:, :, at] += np.eye(2)
        own = slice(at.start - state.plant, at.stop - state.plant)
        rows[:, own] = _turns((order - plane) * omega_e * control.t_s) @ held


def _into(motion: FrameMotion, axes: int) -> FloatArray:
    """From amplitude-invariant d, q and 0 into a frame, over its factors; shape (K, axes, axes)."""
    matrix = motion.axes * SCALE / motion.factor[:, :, np.newaxis]
    return np.asarray(matrix[:, :axes, :axes])


def _out_of(motion: FrameMotion, axes: int) -> FloatArray:
    """The inverse of `_into`, shape (K, axes, axes)."""
    matrix = np.swapaxes(motion.axes / SCALE * motion.factor[:, :, np.newaxis], 1, 2)
    return np.asarray(matrix[:, :axes, :axes])


def _coupling(control: PhaseControl, motion: FrameMotion, axes: int) -> FloatArray:
    """Voltage over electrical speed that currents at rest in the frame induce, in H, on d, q and 0:
    L (a'/a + Omega x) + (J L - L J), the last bracket of the saliency that turns; (K, axes, axes).
    """
    x, y, z = motion.turning.T
    nil = np.zeros_like(x)
    cross = np.moveaxis(np.array([[nil, -z, y], [z, nil, -x], [-y, x, nil]]), -1, 0)
    cross = cross * SCALE / SCALE[:, np.newaxis]
    inductance = np.diag(control.inductances)
    salient = np.zeros((3, 3))
    salient[0, 1] = salient[1, 0] = control.inductances[0] - control.inductances[1]
    grown = np.swapaxes(motion.axes, 1, 2) @ (motion.growth[:, :, np.newaxis] * motion.axes)
    return np.asarray((inductance @ (grown + cross) + salient)[:, :axes, :axes])


def _inverse_plant(control: PhaseControl, order: int, omega_e: float, *, plane: bool) -> complex:
    """Voltage per current of a harmonic in V/A that the closed P loop needs: kp + (R + j m omega L)
    exp(1.5 j m omega T_s), means of d and q in their plane.
    """
    l_d, l_q, l_0 = control.inductances
    d, q, zero = control.gains
    kp, inductance = ((d.kp + q.kp) / 2, (l_d + l_q) / 2) if plane else (zero.kp, l_0)
    turn = order * omega_e
    impedance = control.r_s + 1j * turn * inductance
    return complex(kp + impedance * np.exp(1j * ADVANCE * turn * control.t_s))


# How fast the current loop of a phase machine forgets: the multipliers of its step over whole
# periods of the back-EMF (Floquet), per sample.
#
# The product of the steps over N samples has eigenvalues lambda; what a disturbance keeps of itself
# per sample is the radius |lambda|^(1/N), stable below 1. Where the step is the same at every angle
# (integrators in dq0) N is 1. Else N samples must make whole periods: the speed is taken where they
# do (`whole_samples`), and the worst of some angles of the first sample within a step counts.

FEW_SAMPLES = 40  # Samples of a period below which it matters where within a step they fall.
STARTS = 3  # Angles of the first sample within a step at which a period of few samples is begun.

# Share of the distance of two starts by which the first lies off angle 0, a node, where the slope
# of the back-EMF jumps.
OFF_NODES = 0.382
MOST_PERIODS = 4  # Periods of few samples that may pass until samples fall on the same angles.

# Samples of a period beyond which the loop is judged at rest, at so many angles.
MOST_SAMPLES = 400
_RESCALED = 32  # samples after which a product is scaled, far before it could under- or overflow


@dataclass(frozen=True, slots=True)
class WholePeriods:
    """``samples`` that make ``periods`` whole periods of the back-EMF, at ``omega_e`` in rad/s."""

    samples: int
    periods: int
    omega_e: float


def turns_at_rest(control: PhaseControl) -> bool:
    """Whether the step of the loop is the same at every angle."""
    return control.frame in ("dq", "table") and control.midpoint is None


def whole_samples(control: PhaseControl, omega_e: float) -> WholePeriods:
    """The speed nearest to a given one at which one period is a whole number of samples, or, where
    those are few, some periods are.

    Args:
        control: The current control.
        omega_e: Electrical speed in rad/s, not zero.
    """
    turn = 2.0 * np.pi * control.shape.turns
    samples = turn / (abs(omega_e) * control.t_s)
    most = MOST_PERIODS if samples < FEW_SAMPLES * control.shape.turns else 1
    share = Fraction(samples).limit_denominator(most)
    speed = turn * share.denominator / (share.numerator * control.t_s)
    return WholePeriods(share.numerator, share.denominator, float(np.copysign(speed, omega_e)))


def radius(control: PhaseControl, plants: PhasePlants, omega_e: float) -> FloatArray:
    """Largest modulus of a multiplier per sample, shape (M,), of M plants; stable below 1.

    Args:
        control: The current control.
        plants: The windings.
        omega_e: Electrical speed in rad/s. Where the frame does not turn with the rotor, the
            nearest that makes periods whole; with more than `MOST_SAMPLES` samples per period, and
            at standstill, the largest radius of the steps at fixed angles.
    """
    if turns_at_rest(control):
        return _over_period(control, plants, omega_e, np.zeros((1, 1)))
    turn = 2.0 * np.pi * control.shape.turns
    if abs(omega_e) * control.t_s * MOST_SAMPLES * control.shape.turns < turn:
        fixed = turn * np.arange(MOST_SAMPLES // 4) / (MOST_SAMPLES // 4)
        return _over_period(control, plants, omega_e, fixed[:, np.newaxis])
    whole = whole_samples(control, omega_e)
    step = whole.omega_e * control.t_s
    starts = STARTS if whole.samples < FEW_SAMPLES * control.shape.turns * whole.periods else 1
    first = (np.arange(starts) + OFF_NODES) / starts * turn / whole.samples
    theta = first[:, np.newaxis] + step * np.arange(whole.samples)
    return _over_period(control, plants, whole.omega_e, theta)


def _over_period(
    control: PhaseControl, plants: PhasePlants, omega_e: float, theta: FloatArray
) -> FloatArray:
    """Largest radius per sample over S runs of angles, shape (S, N) in rad -> (M,)."""
    state = loop_state(control, omega_e)
    own = plant_rows(plants, state, omega_e, control.t_s)
    others = controller_rows(control, state, omega_e, theta.ravel())
    return _growth(state, own, others.reshape(*theta.shape, *others.shape[1:]))


def _growth(state: LoopState, own: FloatArray, others: FloatArray) -> FloatArray:
    """Radius per sample of the products of steps, the largest over the runs.

    ``own`` (M, plant, n) are the rows of the plants, ``others`` (S, N, n - plant, n) those of the
    controller.
    """
    runs, samples = others.shape[:2]
    product = np.tile(np.eye(state.size), (runs, len(own), 1, 1))
    size = np.zeros((runs, len(own)))
    for sample in range(samples):
        product = np.concatenate([own @ product, others[:, sample, np.newaxis] @ product], axis=-2)
        if sample % _RESCALED == _RESCALED - 1:
            largest = np.max(np.abs(product), axis=(-2, -1))
            product /= largest[..., np.newaxis, np.newaxis]
            size += np.log(largest)
    largest = np.max(np.abs(np.linalg.eigvals(product)), axis=-1)
    with np.errstate(divide="ignore"):
        return np.asarray(np.max(np.exp((np.log(largest) + size) / samples), axis=0))


# Where the frames of a phase machine point, sample by sample, as the firmware finds them from the
# nodes of the back-EMF.
#
# Vectors here are power-invariant and seen from the rotor: d, q and 0 of the angle theta. A frame
# is the three unit vectors of its axes, the factor a by which paper 002 divides quantities in it,
# and how both change with the angle: n_j' = Omega x n_j, a' = growth a.

TO_AXES = clarke_matrix(power_invariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class FrameMotion:
    """A frame at K angles.

    Args:
        axes: Unit vectors of the frame's axes in rows, in d, q and 0 of the rotor; shape (K, 3, 3).
        factor: What quantities on each axis are divided by, shape (K, 3), known up to a constant;
            the zero sequence of dqx is left as it is.
        growth: Its relative derivative by the angle in 1/rad, shape (K, 3).
        turning: Omega, by which the axes turn in the stator per radian, in d, q and 0; shape (K,
            3).
    """

    axes: FloatArray
    factor: FloatArray
    growth: FloatArray
    turning: FloatArray


def shape_at(shape: PhaseShape, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Back-EMF over speed between its nodes and its slope there, of the phases.

    Args:
        shape: The nodes, joined by straight lines.
        theta: Electrical angles in rad, shape (K,), any; at a node the line behind it counts.

    Returns:
        Values in Wb and slopes in Wb/rad, each of shape (3, K)
    """
    rows, count = shape.flux.shape
    step = 2.0 * np.pi * shape.turns / count
    phase = np.arange(3)[:, np.newaxis]
    lag = phase * (2.0 * np.pi / 3.0) if rows == 1 else 0.0 * phase
    place = np.mod((theta - lag) / step, count)
    node = np.minimum(place.astype(np.int64), count - 1)
    row = 0 * phase if rows == 1 else phase
    here, there = shape.flux[row, node], shape.flux[row, (node + 1) % count]
    return here + (place - node) * (there - here), (there - here) / step


def frame_motion(frame: CurrentFrame, shape: PhaseShape, theta: FloatArray) -> FrameMotion:
    """The frame of a controller at angles; ``dq`` and ``table`` turn with the rotor.

    Args:
        frame: Where the integrators live.
        shape: Back-EMF over the angle.
        theta: Electrical angles in rad, shape (K,).
    """
    count = theta.size
    upright = np.zeros((count, 3))
    upright[:, 2] = 1.0
    if frame in ("dq", "table"):
        same = np.tile(np.eye(3), (count, 1, 1))
        return FrameMotion(same, np.ones((count, 3)), np.zeros((count, 3)), upright)
    flux, slope = (TO_AXES @ part for part in shape_at(shape, theta))
    size = np.hypot(flux[0], flux[1])
    size_rate = (flux[0] * slope[0] + flux[1] * slope[1]) / size
    turn = (flux[0] * slope[1] - flux[1] * slope[0]) / size**2
    cosine, sine = np.cos(theta), np.sin(theta)
    along = np.stack(  # the direction of the shape in the plane, seen from the rotor
        [
            (flux[0] * cosine + flux[1] * sine) / size,
            (flux[1] * cosine - flux[0] * sine) / size,
            np.zeros(count),
        ],
        axis=1,
    )
    across = np.stack([-along[:, 1], along[:, 0], np.zeros(count)], axis=1)
    turning = turn[:, np.newaxis] * upright
    if frame == "dqx":
        scaled = np.array([1.0, 1.0, 0.0])
        return FrameMotion(
            np.stack([across, along, upright], axis=1),
            (1.0 / size)[:, np.newaxis] ** scaled,
            (-size_rate / size)[:, np.newaxis] * scaled,
            turning,
        )
    whole = np.hypot(size, flux[2])
    lift = (size * slope[2] - flux[2] * size_rate) / whole**2
    q = (size[:, np.newaxis] * along + flux[2][:, np.newaxis] * upright) / whole[:, np.newaxis]
    return FrameMotion(
        np.stack([across, q, np.cross(across, q)], axis=1),
        np.tile((1.0 / whole)[:, np.newaxis], 3),
        np.tile((-(size * size_rate + flux[2] * slope[2]) / whole**2)[:, np.newaxis], 3),
        turning - lift[:, np.newaxis] * across,
    )
