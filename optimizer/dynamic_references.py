"""References that move: slopes, what they permit the speed loop, and field weakening by voltage
feedback, an integrator that takes the d current further down while the controllers ask for more
voltage than there is.

With r the largest amplitude of the phase voltage and v the voltage that the controllers asked for
at the sample before,

    w[k] = max(-i_w, min(0, w[k-1] + K (r^2 - |v|^2)/(2 r))),    i_d* = i_d*(map) + w,
    |i_q*| <= sqrt(i_max^2 - i_d*^2).

Around an operating point (r^2 - |v|^2)/(2 r) is r - |v|. More demagnetising current lowers the
voltage by omega L_d v_q/r per ampere where the current follows, so that K = omega_b t_s/(omega L_d)
at the largest speed makes the loop no faster than omega_b anywhere. It is judged with both current
loops, sampled, at operating points on the voltage limit and over the tolerances.

At the voltage's least over i_d (MTPV) that slope is zero and turns its sign beyond: what the
integrator may add ends where the d flux of the least magnet would.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ReferenceSettings, filter_share
from dqforge.machines.dq_machines.synchronous import Machine, torque_from_flux
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, closed_matrices
from dqforge.optimizer.loops.loop_gains import LoopGains, decoupling
from dqforge.optimizer.loops.robustness import BoxPoints, DriveBox, box_points
from dqforge.optimizer.operating_points.points import optimal_points

_SPEEDS = 8

_TORQUES = 5

_MOST_GAIN = 100.0  # times the gain, up to which a margin is looked for


@dataclass(frozen=True, slots=True)
class OffMap:
    """A drive that is off its data, at an operating point of the reference.

    ``text`` says how far it is off; ``torque`` in N m and ``omega_m`` in rad/s (mechanical) are
    what was asked and where. ``missing`` is the voltage in V that the references of the map alone
    need beyond the limit, ``current`` the d current in A that the feedback adds, nan where none
    would do; ``kept`` the torque that is made then over that of the references of the map, if their
    voltage were there.
    """

    text: str
    torque: float
    omega_m: float
    missing: float
    current: float
    kept: float


@dataclass(frozen=True, slots=True)
class VoltageFeedback:
    """The feedback with what it is judged by.

    Args:
        gain: K in A per V and sample.
        current: Largest d current in A that it adds.
        i_max: Current limit in A (peak).
        voltage: Largest amplitude of the phase voltage in V at the nominal link.
        bandwidth: Slowest and fastest bandwidth in rad/s at the operating points.
        largest_pole: Largest modulus of the poles of both current loops with the feedback, over
            operating points and tolerances.
        gain_margin: By how much the gain may grow until it is 1; infinity where it never is within
            a hundred times.
        worst: The drive and operating point at which the references of the map alone lack most
            voltage; None where the design has no tolerances, or no map of the voltage.
    """

    gain: float
    current: float
    i_max: float
    voltage: float
    bandwidth: tuple[float, float]
    largest_pole: float
    gain_margin: float
    worst: OffMap | None


@dataclass(frozen=True, slots=True)
class LimitPoints:
    """Operating points on the voltage limit, arrays of shape (N,): N m, rad/s (mechanical), A."""

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray


def limit_points(machine: Machine, i_max: float, v_max: float, omega_m: float) -> LimitPoints:
    """Operating points that need all of the voltage ``v_max`` in V, of both signs of the torque, up
    to a mechanical speed in rad/s.

    Raises:
        InputError: The voltage limits nothing up to that speed.
    """
    speeds = np.linspace(0.1, 1.0, 4 * _SPEEDS) * omega_m
    most = optimal_points(machine, 1e9, speeds, v_max=v_max, i_max=i_max).torque
    shares = np.linspace(0.0, 1.0, _TORQUES)
    torque = np.concatenate([sign * np.outer(most, shares).ravel() for sign in (1.0, -1.0)])
    speed = np.tile(np.repeat(speeds, _TORQUES), 2)
    found = optimal_points(machine, torque, speed, v_max=v_max, i_max=i_max)
    full = found.reached & (found.voltage > 0.999 * v_max)
    if not full.any():
        raise InputError(
            "control.references.voltage_feedback: the voltage limits nothing up to the largest "
            "speed of the machine; remove it, or write a larger machine.max_speed"
        )
    return LimitPoints(torque[full], speed[full], found.i_d[full], found.i_q[full])


def feedback_matrices(
    machines: TurningMachines, control: CurrentControl, direction: FloatArray, gain: float
) -> FloatArray:
    """Maps of (i_d, i_q, v_d, v_q, I_d, I_q, w) over one sampling period, shape (M, 7, 7).

    Args:
        machines, control: As of `dqforge.optimizer.loops.integer_gains.closed_matrices`.
        direction: Unit vectors (d, q) of the voltage, shape (M, 2).
        gain: K in A per V and sample.
    """
    return _with_feedback(closed_matrices(machines, control), control, direction, gain)


def _with_feedback(
    loops: FloatArray, control: CurrentControl, direction: FloatArray, gain: float
) -> FloatArray:
    """The same from the maps of both current loops alone, shape (M, 6, 6)."""
    count = len(loops)
    reference = np.zeros(6)  # what the d reference adds to the next state
    reference[2] = control.kp[0] + control.ki_ts[0]
    reference[4] = control.ki_ts[0]
    row = np.zeros((count, 7))
    row[:, 2:4] = -gain * direction
    row[:, 6] = 1.0
    matrix = np.zeros((count, 7, 7))
    matrix[:, :6, :6] = loops
    matrix[:, :6] += reference[:, None] * row[:, None]
    matrix[:, 6] = row
    return matrix


def voltage_feedback(
    design: Design, box: DriveBox, loops: tuple[LoopGains, LoopGains], voltage: float
) -> VoltageFeedback:
    """The feedback that a design asks for, judged.

    Args:
        design: With ``control.references.voltage_feedback`` and a largest speed.
        box: Its tolerances.
        loops: Gains of i_d and i_q.
        voltage: Largest amplitude of the phase voltage in V that the controllers may make.

    Raises:
        InputError: The voltage limits nothing, or the current turns the flux.
        NoSolutionError: The loop is not stable somewhere.
    """
    wanted = design.control.references.voltage_feedback
    machine, control = design.machine, design.control
    assert wanted is not None
    assert machine.omega_m_max is not None
    points = limit_points(machine, design.i_max, voltage, machine.omega_m_max)
    l_d = box.nominal[0]
    gain = wanted.bandwidth * control.t_s / (machine.pole_pairs * machine.omega_m_max * l_d)
    turning = machine.pole_pairs * points.omega_m
    v_d, v_q = _voltage(machine, points, turning)
    direction = np.column_stack([v_d, v_q]) / np.hypot(v_d, v_q)[:, None]
    share = wanted.bandwidth / (machine.pole_pairs * machine.omega_m_max)
    rates = share * np.abs(turning * direction[:, 1])
    around = _Around.of(design, box, loops, turning, direction)
    largest = around.largest_pole(gain)
    if largest >= 1.0:
        hertz = wanted.bandwidth / (2.0 * math.pi)
        held = around.stable_share(gain)
        advice = f"bandwidth: {0.9 * held * hertz:.3g} Hz" if held > 0.0 else "a smaller bandwidth"
        raise NoSolutionError(
            f"control.references.voltage_feedback.bandwidth: {hertz:.4g} Hz are not stable "
            f"together with the current loops (largest pole {largest:.4f}); write {advice}"
        )
    current = _current(design, wanted.current, points)
    return VoltageFeedback(
        gain=gain,
        current=current,
        i_max=design.i_max,
        voltage=voltage,
        bandwidth=(float(np.min(rates)), float(np.max(rates))),
        largest_pole=largest,
        gain_margin=around.gain_margin(gain),
        worst=_worst(design, box, points, voltage, current),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """Maps of both current loops, a row per operating point and corner of the tolerances."""

    loops: FloatArray
    control: CurrentControl
    direction: FloatArray

    @classmethod
    def of(
        cls,
        design: Design,
        box: DriveBox,
        loops: tuple[LoopGains, LoopGains],
        turning: FloatArray,
        direction: FloatArray,
    ) -> _Around:
        """Every corner, and the data themselves, at every operating point (rad/s electrical)."""
        drives = _corners(box.turning_points())
        feed = decoupling(design.machine)
        control = CurrentControl(
            kp=(loops[0].kp, loops[1].kp),
            ki_ts=(loops[0].ki_ts, loops[1].ki_ts),
            l_d=feed.l_d,
            l_q=feed.l_q,
            advance=CURRENT_DELAY * design.control.t_s,
            t_s=design.control.t_s,
        )
        machines = box.turning_machines(drives, turning)
        return cls(
            closed_matrices(machines, control),
            control,
            np.tile(direction, (len(drives.deviations), 1)),
        )

    def largest_pole(self, gain: float) -> float:
        """Largest modulus of the poles with a gain in A per V and sample."""
        matrices = _with_feedback(self.loops, self.control, self.direction, gain)
        return float(np.max(np.abs(np.linalg.eigvals(matrices))))

    def stable_share(self, gain: float) -> float:
        """The largest share of an unstable gain that is stable, to 1 %; 0 where a thousandth of it
        is not stable either.
        """
        low, high = 1e-3, 1.0
        if self.largest_pole(low * gain) >= 1.0:
            return 0.0
        while high / low > 1.01:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.largest_pole(middle * gain) < 1.0 else (low, middle)
        return low

    def gain_margin(self, gain: float) -> float:
        """By how much a gain may grow until the loop is at its limit."""
        if self.largest_pole(_MOST_GAIN * gain) < 1.0:
            return math.inf
        low, high = 1.0, _MOST_GAIN
        while high / low > 1.01:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.largest_pole(middle * gain) < 1.0 else (low, middle)
        return low


def _corners(points: BoxPoints) -> BoxPoints:
    """The corners and the data themselves."""
    rows = np.append(np.arange(points.corners), len(points.deviations) - 1)
    return BoxPoints(points.names, points.deviations[rows], points.corners, points.loaded[rows])


def _voltage(
    machine: Machine, points: LimitPoints, turning: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Steady voltages (d, q) in V at operating points, shape (N,)."""
    psi_d, psi_q = machine.flux(points.i_d, points.i_q)
    return (
        machine.r_s * points.i_d - turning * psi_q,
        machine.r_s * points.i_q + turning * psi_d,
    )


def require_feedback(design: Design) -> None:
    """Check what the voltage feedback of a design needs of its operating points, where it asks for
    one.

    Raises:
        InputError: The voltage limits nothing, or the current asked for turns the flux.
    """
    wanted, machine = design.control.references.voltage_feedback, design.machine
    if wanted is None or machine.omega_m_max is None:
        return
    points = limit_points(machine, design.i_max, design.v_max, machine.omega_m_max)
    _current(design, wanted.current, points)


def _current(design: Design, asked: float | None, points: LimitPoints) -> float:
    """The largest current in A that the feedback may add: what is asked, or what brings the d
    current to the limit at its least, or the d flux of the weakest magnet near zero; what is asked
    is refused where that flux would turn.
    """
    machine, least = design.machine, float(np.min(points.i_d))
    room = design.i_max + least
    current = room if asked is None else asked
    tolerances = design.control.tolerances
    weak = 1.0 + (0.0 if tolerances is None else tolerances.limits("psi_pm")[0])
    # the flux that the magnet has left where the map takes most of it
    psi_d = machine.flux(np.array([least - current]), np.zeros(1))[0]
    left = float(psi_d[0]) - (1.0 - weak) * machine.psi_pm
    if left > 0.0:
        return current
    kept = max(0.0, 0.9 * (least - current_of_no_flux(machine, weak)))
    if asked is None:
        return kept
    raise InputError(
        f"control.references.voltage_feedback.current: {current:.4g} A more than the "
        f"{-least:.4g} A of the map turn the d flux of the weakest magnet, beyond which "
        "more current makes more voltage; "
        f"write current: {kept:.3g} A"
    )


def current_of_no_flux(machine: Machine, weak: float) -> float:
    """The d current in A (negative) at which the d flux of a magnet of ``weak`` times its flux is
    zero, at the least incremental inductance.
    """
    l_d = float(machine.jet(np.zeros(1), np.zeros(1)).l_dd[0])
    return -weak * machine.psi_pm / l_d


def _worst(
    design: Design, box: DriveBox, points: LimitPoints, voltage: float, current: float
) -> OffMap | None:
    """The corner and operating point at which the references of the map lack most voltage."""
    machine, tolerances = design.machine, box.tolerances
    drives = _corners(
        box_points(
            {name: tolerances.limits(name) for name in ("r_s", "l_d", "l_q", "psi_pm", "v_dc")}
        )
    )
    if not drives.names:
        return None
    added = np.linspace(0.0, current, 101)
    i_d = points.i_d[:, None] - added
    # references beyond the current limit give way on the q axis
    i_q = np.sign(points.i_q)[:, None] * np.minimum(
        np.abs(points.i_q)[:, None],
        np.sqrt(np.maximum(design.i_max**2 - i_d**2, 0.0)),
    )
    turning = (machine.pole_pairs * points.omega_m)[:, None]
    psi_d, psi_q = (x.reshape(i_d.shape) for x in machine.flux(i_d.ravel(), i_q.ravel()))
    found: list[OffMap] = []
    for row in range(len(drives.deviations)):
        r_s, l_d, l_q, psi, link = (
            1.0 + float(drives.of(name)[row]) for name in ("r_s", "l_d", "l_q", "psi_pm", "v_dc")
        )
        d = psi * machine.psi_pm + l_d * (psi_d - machine.psi_pm)
        q = l_q * psi_q
        v = np.hypot(r_s * machine.r_s * i_d - turning * q, r_s * machine.r_s * i_q + turning * d)
        torque = torque_from_flux(machine.pole_pairs, d, q, i_d, i_q)
        lacks = v[:, 0] - link * voltage
        place = int(np.argmax(lacks))
        enough = np.flatnonzero(v[place] <= link * voltage)
        step = int(enough[0]) if enough.size else -1
        asked = torque[place, 0]
        found.append(
            OffMap(
                text=drives.text(row),
                torque=float(points.torque[place]),
                omega_m=float(points.omega_m[place]),
                missing=float(lacks[place]),
                current=float(added[step]) if enough.size else math.nan,
                kept=float(torque[place, step] / asked) if asked != 0.0 else 1.0,
            )
        )
    return max(found, key=lambda off: off.missing)


# Speed steps that a torque slope lets the speed loop answer.
#
# A torque that may only move at a slope s lags behind what the controller wants; for large errors
# the loop is three integrators and a switch, and swings. The error below which it is the linear
# loop goes with s/(kp omega_c): kp times the error at the crossover omega_c is what the torque has
# to follow. Where it ends is found by the loop itself, sampled: inertia, friction, the PI
# controller with its filter, torque limit, slope and back-calculation as they are emitted, the
# current loops as their delay of one speed sample at most.

_STEPS = 81

_SETTLED = 0.05  # of the step

_PERIODS = 30.0  # of 1/omega_c until it must have settled


def answered_step(design: Design, speed: LoopGains, torque_max: float, slope: float) -> float:
    """Largest step of the speed in rad/s, up to the largest speed, that settles.

    Args:
        design: Machine with its inertia, and sampling.
        speed: The speed loop.
        torque_max: Largest torque in N m.
        slope: Of the torque, in N m/s.
    """
    most = design.machine.omega_m_max or design.control.bases.speed
    steps = np.geomspace(1e-3, 1.0, _STEPS) * most
    settled = _settles(design, speed, torque_max, slope, steps)
    free = _settles(design, speed, torque_max, np.inf, steps)
    held = np.flatnonzero(free & ~settled)
    return float(steps[-1]) if held.size == 0 else float(steps[max(0, int(held[0]) - 1)])


def _settles(
    design: Design, speed: LoopGains, torque_max: float, slope: float, steps: FloatArray
) -> BoolArray:
    """Which steps in rad/s settle within 5 % of them in time."""
    machine, loop = design.machine, design.control.speed_loop
    assert machine.inertia is not None
    assert loop is not None
    t_s = speed.t_s
    share = filter_share(loop.filter_time, design.control.t_s)
    inner = max(1, loop.ratio)
    shared = 1.0 - (1.0 - share) ** inner  # the filter runs at every current sample
    reach = torque_max / machine.inertia  # the torque limit needs its own time
    count = int((_PERIODS / speed.crossover + 4.0 * np.max(steps) / reach) / t_s) + 1
    omega, seen = np.zeros_like(steps), np.zeros_like(steps)
    torque, integral, acting = np.zeros_like(steps), np.zeros_like(steps), np.zeros_like(steps)
    late = np.zeros(steps.shape, dtype=np.float64)
    for k in range(count):
        seen = seen + shared * (omega - seen)
        error = steps - seen
        wanted = speed.kp * error + (integral + speed.ki_ts * error)
        high = np.minimum(torque + slope * t_s, torque_max)
        low = np.maximum(torque - slope * t_s, -torque_max)
        found = np.clip(wanted, low, high)
        integral = integral + speed.ki_ts * error + speed.anti_windup * t_s * (found - wanted)
        middle = 0.5 * (acting + torque)  # the torque moves along the slope within the sample
        acting, torque = torque, found
        omega = omega + t_s / machine.inertia * (middle - machine.friction * omega)
        if k > count - _PERIODS / (3.0 * speed.crossover * t_s):
            late = np.maximum(late, np.abs(omega - steps))
    return np.asarray(late < _SETTLED * steps, dtype=np.bool_)


# References that move, for a design: what they permit, and the feedback judged.


@dataclass(frozen=True, slots=True)
class DynamicReferences:
    """What a design asks of the motion of its references.

    Args:
        settings: The slopes, in N m/s and A/s.
        torque_step, current_step: Largest changes per sample in N m and A; infinity without a
            slope.
        torque_time: Time in s from no torque to the largest; 0 without a slope.
        slope_at_rest: What the voltage lets the q current rise by at rest, in A/s.
        speed_step: Largest step of the speed in rad/s that the speed loop answers with the torque
            slope; nan without either.
        feedback: The voltage feedback, None where none is asked for.
    """

    settings: ReferenceSettings
    torque_step: float
    current_step: float
    torque_time: float
    slope_at_rest: float
    speed_step: float
    feedback: VoltageFeedback | None


def dynamic_references(
    design: Design, box: DriveBox, loops: tuple[LoopGains, LoopGains], speed: LoopGains | None
) -> DynamicReferences | None:
    """Slopes and feedback of a design, None where it asks for none.

    ``loops`` are those of i_d and i_q. Errors as `voltage_feedback`.
    """
    wanted, t_s = design.control.references, design.control.t_s
    if not wanted.any:
        return None
    slope, current_slope = wanted.torque_slope, wanted.current_slope
    from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

    most = float(mtpa_locus(design.machine, design.i_max).torque[-1])

    return DynamicReferences(
        settings=wanted,
        torque_step=math.inf if slope is None else slope * t_s,
        current_step=math.inf if current_slope is None else current_slope * t_s,
        torque_time=0.0 if slope is None else most / slope,
        slope_at_rest=float(design.v_max / np.max(box.nominal[1])),
        speed_step=math.nan
        if slope is None or speed is None
        else answered_step(design, speed, most, slope),
        feedback=None
        if wanted.voltage_feedback is None
        else voltage_feedback(design, box, loops, design.v_max),
    )
