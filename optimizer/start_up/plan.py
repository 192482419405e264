"""What a start from standstill needs, in numbers: given by the design, or computed of the machine.

Electrical angles and speeds, peak values; K_T = 3/2 p psi_pm, T_r = K_T I with the current limit I.

    hand-over        omega_h = (dR I + v_dt)/(psi sin 15 deg), within 10 to 50 % of the base speed:
                     there resistance (off by dR) and dead time (v_dt = 4/pi f_sw t_e V_dc left)
                     turn the observer's angle by 15 deg; of a tracker that cannot follow from
                     rest at least 1.3 times the least speed at which it holds
    pendulum         theta'' = -(p K_T I/J) sin theta: omega_n = sqrt(p K_T I/J) of a rotor in the
                     field of a current I that stands, or turns
    alignment        a regulated current damps nothing; i_q = -2 zeta (I/omega_n) omega, the rotor's
                     speed seen by the voltage across the current, makes zeta = 0.4
    current of I-f   K_T I sin delta = T_L + T_a with sin delta = 0.6 at the largest load, at least
                     half of the limit: with less, dead time rules the observer
    acceleration     a = p T_a/J, T_a = 0.1 T_r, raised from 0 over two swings of the pendulum
    after the start  what the load leaves of T_r, as far as the phase-locked loops (natural
                     frequency w) lag by 10 deg at most: a/w^2
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import StartUpSettings
from dqforge.machines.dq_machines.synchronous import (
    LinearMachine,
    Machine,
    linearised,
    torque_per_ampere,
)
from dqforge.machines.names import AlignmentName, StartUpMethodName
from dqforge.machines.records import dataclass
from dqforge.optimizer.application import alignment_damping, alignment_time, swing_time
from dqforge.optimizer.estimators import TunedTracker, solve_tracker
from dqforge.optimizer.observers.conditions import lost_voltage

USUAL_LOAD = 0.3  # Largest load torque of a design that names none, over the largest torque.
STEEPEST = 0.6  # sin delta of the ramp at the largest load, where it chooses its current.
LEAST_SALIENCY = 1.1  # L_q/L_d below which no start by saliency is tried.

# Fall of L_dd at the current limit below which noise of 0.5 % hides the polarity: five sigma.
LEAST_SATURATION = 0.025
_ACCELERATION, _DAMPING, _DAMPED_BELOW = 0.1, 0.1, 0.65
_ANGLE, _RESISTANCE = math.radians(15.0), 0.3
_SLOWEST, _FASTEST = 0.1, 0.5  # of the base speed, for the hand-over
_LEAST_SHARE = 0.5  # of the current limit, for the ramp
_TRIP, _OPEN_TRIP = 1.8, 2.5  # over the current limit; of a voltage ramp, whose current is open
ALIGN_DAMPING, _ALIGN_FILTER = 0.4, 0.3  # of the alignment, and of its filter over 1/omega_n
_CAUGHT, _REST = 0.15, 0.05  # current of a short circuit over the limit; speed of a rotor at rest
_LAG = math.radians(10.0)  # of a phase-locked loop while the reference accelerates
_TRACKED_LAG = math.radians(3.0)  # of a tracker's, which the correction of drift slows further
_ABOVE = 1.3  # of the least speed of a tracker, for the hand-over
_SLOW_LOOP, _SLOWEST_LOOP, _LOOP = 0.01, 2.0 * math.pi * 40.0, 0.05


@dataclass(frozen=True, slots=True)
class StartUpPlan:
    """Everything that the start-up needs, in SI units; angles and speeds electrical.

    Args:
        method, alignment: How the rotor leaves standstill, and how it is brought to a known angle;
            never ``auto``.
        flying: Whether a rotor that turns already is looked for.
        t_s: Sampling period in s.
        pole_pairs, r_s, l_d, l_q, psi_pm, inertia: The machine as the controller believes it: Ohm,
            H, Wb, kg m^2.
        current_limit, rated_torque, base_speed: I in A, K_T I in N m and the base speed in rad/s.
        load_torque: Largest load torque to start, in N m.
        align_current, align_voltage, align_time: In A, V and s.
        align_damping, align_filter: Current against the turning rotor in A per rad/s, and the time
            constant in s of the filter of its speed.
        ramp_current, ramp_acceleration, ramp_rise: In A and rad/s^2, reached after ``ramp_rise`` s.
        boost: Voltage in V of the voltage ramp beside psi omega.
        damping: Speed taken off the ramp per V of the active voltage above its mean, in rad/s.
        swing_time: 2 pi/omega_n at the current of the ramp, in s.
        hand_over, mix_from, back_below, ramp_end, stall_below, ratio_above: In rad/s: the observer
            at speed rules from the first on, begins to count from the second, rules no more below
            the third; the ramp ends at the fourth; a start that falls below the fifth has stalled;
            the ratio of the EMF is looked at above the last.
        agree_share, agree_time: The observer's speed must be that of the ramp within this share for
            so many s.
        patience: Time in s beyond the planned end until a start has failed.
        held_current, fade_time: d current in A held until the observer rules, and the time in s in
            which it goes.
        run_acceleration: Slope of the speed reference after the start in rad/s^2.
        ratio_low, ratio_high, ratio_filter, ratio_settled, ratio_time: Limits of EMF over omega
            psi, its filter in s, how long the speed must have settled and how long it must be
            outside, in s.
        stall_time: Time in s for which the speed must be too low.
        retries, retry_pause: Further tries, and the time in s before the next.
        trip_current, v_dc_min: Limits in A and V (0: none).
        catch_current, catch_longest, catch_pause, catch_least: Flying start: current in A that a
            pulse should reach, its longest duration and the pause in s, and the speed in rad/s
            below which the rotor counts as at rest.
        search_time, polarity_time, polarity_current, polarity_share: Start by saliency: time in s
            to find the axis, time in s per side of it, current in A, and by what share the ripples
            at both ends must differ.
    """

    method: StartUpMethodName
    alignment: AlignmentName
    flying: bool
    t_s: float
    pole_pairs: float
    r_s: float
    l_d: float
    l_q: float
    psi_pm: float
    inertia: float
    current_limit: float
    rated_torque: float
    base_speed: float
    load_torque: float
    align_current: float
    align_voltage: float
    align_time: float
    align_damping: float
    align_filter: float
    ramp_current: float
    ramp_acceleration: float
    ramp_rise: float
    boost: float
    damping: float
    swing_time: float
    hand_over: float
    mix_from: float
    back_below: float
    ramp_end: float
    stall_below: float
    ratio_above: float
    agree_share: float
    agree_time: float
    patience: float
    held_current: float
    fade_time: float
    run_acceleration: float
    ratio_low: float
    ratio_high: float
    ratio_filter: float
    ratio_settled: float
    ratio_time: float
    stall_time: float
    retries: int
    retry_pause: float
    trip_current: float
    v_dc_min: float
    catch_current: float
    catch_longest: float
    catch_pause: float
    catch_least: float
    search_time: float
    polarity_time: float
    polarity_current: float
    polarity_share: float = 0.01

    @property
    def torque_per_ampere(self) -> float:
        """K_T in N m per A."""
        return torque_per_ampere(self.pole_pairs, self.psi_pm)

    @property
    def load_angle_sine(self) -> float:
        """Sin delta of the ramp at the largest load, while it accelerates."""
        accelerating = self.ramp_acceleration * self.inertia / self.pole_pairs
        return (self.load_torque + accelerating) / (self.torque_per_ampere * self.ramp_current)


def saturation(machine: Machine, i_max: float) -> float:
    """By how much the inductance L_dd falls from no current to the limit along d, relative: what
    tells north from south at rest; 0 of a machine of constant inductances.

    Args:
        machine: The machine.
        i_max: Current limit in A.
    """
    if isinstance(machine, LinearMachine):
        return 0.0
    l_dd = machine.jet(np.array([0.0, i_max]), np.zeros(2)).l_dd
    return float(1.0 - l_dd[1] / l_dd[0])


def _alignment(
    settings: StartUpSettings, method: StartUpMethodName, saturates: bool
) -> AlignmentName:
    """The alignment of a method; by saliency one where nothing tells the polarity."""
    if settings.alignment is not None:
        return settings.alignment
    if method == "saliency":
        return "none" if saturates else "two-step"
    return "one-step" if method == "direct" else "two-step"


def _or(value: float | None, usual: float) -> float:
    return usual if value is None else value


def chosen_method(settings: StartUpSettings, machine: LinearMachine) -> StartUpMethodName:
    """The method that ``auto`` stands for; any other is itself.

    Args:
        settings: Of the start.
        machine: The machine at no current.
    """
    if settings.method != "auto":
        return settings.method
    salient = machine.l_q / machine.l_d >= LEAST_SALIENCY and settings.observer is not None
    return "saliency" if salient else "i-f"


_FADES = {"direct": 1.0}


def hand_over_speed(design: Design, machine: LinearMachine) -> float:
    """Electrical speed in rad/s where resistance and dead time turn the observer's angle by 15 deg,
    within 10 and 50 % of the base speed.

    Args:
        design: The design.
        machine: Its machine at no current.
    """
    tolerances = design.control.tolerances
    share = 0.0 if tolerances is None else max(abs(side) for side in tolerances.limits("r_s"))
    lost = max(abs(volts) for volts in lost_voltage(design))
    wrong = (share or _RESISTANCE) * machine.r_s * design.i_max + lost
    base = design.control.bases.speed * machine.pole_pairs
    found = wrong / (machine.psi_pm * math.sin(_ANGLE))
    return min(max(found, _SLOWEST * base), _FASTEST * base)


def _settled(loop: float) -> float:
    """Time in s in which the double pole of a phase-locked loop in rad/s forgets its start."""
    return max(0.02, 4.0 / loop)


def slowest_loop(
    design: Design, method: StartUpMethodName, tracked: TunedTracker | None = None
) -> float:
    """Natural frequency in rad/s of the slowest phase-locked loop that the speed control runs on.

    Args:
        design: The design.
        method: How it starts.
        tracked: The tracker that it runs on at speed, None where that is an observer.
    """
    if tracked is not None and tracked.loop is not None:
        return math.sqrt(tracked.loop.k_i / tracked.loop.t_s)
    control, settings = design.control, design.control.start_up
    given = None if control.observer is None else control.observer.pll_bandwidth
    loop = _LOOP / control.t_s if given is None else given
    if method != "saliency" or settings is None:
        return loop
    low = None if settings.observer is None else settings.observer.pll_bandwidth
    return min(loop, low or min(_SLOW_LOOP / control.t_s, _SLOWEST_LOOP))


def start_up_plan(design: Design) -> StartUpPlan | None:
    """What the start of a design needs; None where it asks for none.

    Args:
        design: The design; one with a start has a magnet, an inertia, an observer and a speed loop.
    """
    settings = design.control.start_up
    if settings is None:
        return None
    machine, t_s, i_max = linearised(design.machine), design.control.t_s, design.i_max
    inertia = machine.inertia or 0.0
    pairs, k_t = float(machine.pole_pairs), torque_per_ampere(machine.pole_pairs, machine.psi_pm)
    rated = k_t * i_max
    method = chosen_method(settings, machine)
    load = _or(settings.load_torque, USUAL_LOAD * rated)
    accelerating = _or(settings.acceleration_torque, _ACCELERATION * rated)
    aligned = _or(settings.alignment_current, i_max)
    tracked = solve_tracker(design)
    loop = slowest_loop(design, method, tracked)
    lag = _LAG if tracked is None else _TRACKED_LAG
    followed = lag * loop**2 * inertia / pairs
    if tracked is not None and settings.acceleration_torque is None:
        accelerating = min(accelerating, followed)
    matched = max((load + accelerating) / (STEEPEST * k_t), _LEAST_SHARE * i_max)
    current = _or(settings.current, min(matched, i_max))
    sine = (load + accelerating) / (k_t * current)
    swing, align_swing = swing_time(machine, current), swing_time(machine, aligned)
    base = design.control.bases.speed * pairs
    given = settings.hand_over
    usual = hand_over_speed(design, machine)
    if tracked is not None:
        usual = max(usual, _ABOVE * tracked.omega_low)
    hand_over = usual if given is None else given * pairs
    usual_damping = _DAMPING if sine < _DAMPED_BELOW else 0.0
    lost = max(abs(volts) for volts in lost_voltage(design))
    held = {"saliency": 0.3 * i_max, "direct": 0.5 * aligned}.get(method, 0.0)
    agree = 0.02 if tracked is None else _settled(loop)
    back_below = 0.6 * hand_over
    if tracked is not None:
        back_below = max(back_below, min(tracked.omega_low, 0.95 * hand_over))
    running = _or(settings.run_torque, min(max(rated - load, accelerating), followed))
    return StartUpPlan(
        method=method,
        alignment=_alignment(
            settings, method, saturation(design.machine, i_max) >= LEAST_SATURATION
        ),
        flying=settings.flying_start,
        t_s=t_s,
        pole_pairs=pairs,
        r_s=machine.r_s,
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        inertia=inertia,
        current_limit=i_max,
        rated_torque=rated,
        base_speed=base,
        load_torque=load,
        align_current=aligned,
        align_voltage=machine.r_s * aligned + lost,
        align_time=_or(settings.alignment_time, alignment_time(machine, aligned)),
        align_damping=alignment_damping(machine, aligned, ALIGN_DAMPING),
        align_filter=_ALIGN_FILTER * align_swing / (2.0 * math.pi),
        ramp_current=current,
        ramp_acceleration=pairs * accelerating / inertia,
        ramp_rise=2.0 * swing,
        boost=machine.r_s * current + lost,
        damping=_or(settings.damping, usual_damping) / machine.psi_pm,
        swing_time=swing,
        hand_over=hand_over,
        mix_from=0.7 * hand_over,
        back_below=back_below,
        ramp_end=1.3 * hand_over,
        stall_below=0.5 * hand_over,
        ratio_above=1.2 * hand_over,
        agree_share=0.2,
        agree_time=agree,
        patience=_or(settings.patience, 0.8),
        held_current=_or(settings.held_current, held),
        fade_time=_or(settings.fade_time, _FADES.get(method, 0.05)),
        run_acceleration=pairs * running / inertia,
        ratio_low=0.5,
        ratio_high=1.5,
        ratio_filter=0.005,
        ratio_settled=0.05,
        ratio_time=0.02,
        stall_time=0.01,
        retries=settings.retries,
        retry_pause=_or(settings.retry_pause, 0.5),
        trip_current=_or(settings.trip_current, (_OPEN_TRIP if method == "v-f" else _TRIP) * i_max),
        v_dc_min=settings.v_dc_min or 0.0,
        catch_current=_CAUGHT * i_max,
        catch_longest=max(
            t_s, 0.5 * _CAUGHT * i_max * machine.l_q / (_REST * base * machine.psi_pm)
        ),
        catch_pause=max(3.0 * t_s, 0.65 * math.pi / base),
        catch_least=_REST * base,
        search_time=0.1,
        polarity_time=0.01,
        polarity_current=i_max,
    )
