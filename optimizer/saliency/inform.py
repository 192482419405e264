"""INFORM as a tracker, with the axis of the saliency taken for the d axis (``inform``), or with a
table of where it lies under load (``inductance-mapping``); docs/methods/estimators.md has the
equations, `dqforge.optimizer.saliency.inform_steps` the steps of the firmware.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.estimators.tracker import Tracker, TrackerLoop
from dqforge.optimizer.observers.sampled_machine import electrical_limit
from dqforge.optimizer.saliency.inform_steps import (
    DIRECTIONS,
    LAST,
    MIDDLE,
    InformGains,
    inform_start,
    inform_step,
)
from dqforge.optimizer.saliency.injection import (
    FASTEST_LOOP,
    MOST_OF_LINK,
    NOISE_ANGLE,
    current_noise,
    pll_gains,
)
from dqforge.optimizer.saliency.saliency_map import (
    LoadedSaliency,
    along_locus,
    require_saliency,
)
from dqforge.optimizer.saliency.wave_steps import POINTS

USUAL_PERIOD = 16  # Samples from one sequence to the next.
_LOOP = 0.08  # Natural frequency of the loop times the period between sequences.

# Largest angle of the axis beside d that INFORM without a table may leave.
_STRAIGHT = math.radians(5.0)
_TURN = 0.3  # Angle in rad (electrical) by which the rotor may turn while a sequence lasts.


def usual_pulse(design: Design) -> float:
    """Voltage in V that makes 15 % of the largest current in a period, at most 0.28 of the link."""
    l_d = linearised(design.machine).l_d
    return min(0.15 * design.i_max * l_d / design.control.t_s, MOST_OF_LINK * design.inverter.v_dc)


def sequence_noise(sigma: float, step: float) -> float:
    """Standard deviation of the angle of one sequence in rad.

    Args:
        sigma: That of a measured current in A, per axis.
        step: V t_s |Y_delta| in A.

    Neighbouring pulses share a sample: 0.51 sigma/step, where pulses with samples of their own
    would give 0.41.
    """
    gamma = np.array([math.atan2(sine, cosine) for cosine, sine in DIRECTIONS])
    theta = np.linspace(0.0, np.pi, 36, endpoint=False)[:, np.newaxis]
    weight = np.sin(2.0 * theta + gamma)[..., np.newaxis] * np.array(DIRECTIONS)
    taps = np.zeros((len(theta), LAST, 2))
    for k in range(3):
        for place, share in ((2 * k, -0.5), (2 * k + 1, 1.0), (2 * k + 2, -0.5)):
            taps[:, place] += share * weight[:, k]
    return float(np.sqrt(np.mean(np.sum(taps**2, axis=(1, 2)))) * sigma / (3.0 * step))


def tracked_noise(gains: InformGains, sigma: float) -> float:
    """Standard deviation of the angle in rad behind the loop, without load."""
    from scipy.linalg import solve_discrete_lyapunov

    period = gains.period * gains.t_s
    ahead = np.array([[1.0, period], [0.0, 1.0]])
    gain = np.array([gains.k_p, gains.k_i])
    a = ahead - np.outer(gain, ahead[0])
    covariance = solve_discrete_lyapunov(a, np.outer(gain, gain))
    own = sequence_noise(sigma, 1.0 / (3.0 * abs(gains.scale[0])))
    return float(np.sqrt(covariance[0, 0]) * own)


def _period(design: Design, settings: ObserverSettings) -> int:
    """Samples from one sequence to the next."""
    if settings.period is None:
        return USUAL_PERIOD
    count, t_s = round(settings.period / design.control.t_s), design.control.t_s
    if not LAST < count <= 10_000:
        raise InputError(
            f"control.observer.period: a sequence takes {LAST + 1} samples, {(LAST + 1) * t_s:.3g} "
            f"s; write that or more, got {settings.period:.3g} s"
        )
    return count


def design_inform(mapped: bool, design: Design, settings: ObserverSettings) -> InformGains:
    """Gains of the firmware.

    Args:
        mapped: Whether the flux map says where the axis lies under load.
        design, settings: The design, and its settings of this estimator.

    Raises:
        InputError: A setting is out of range.
        NoSolutionError: The saliency or the voltage is too small, or the axis moves without a
            table.
    """
    if design.phase_machine is not None:
        raise NoSolutionError(
            f"control.observer: {settings.method} needs a control that adds its voltage, which "
            "machines of model: waveform have not; choose third-harmonic, or an observer"
        )
    loaded = along_locus(design, POINTS)
    require_saliency(loaded, settings.method)
    if not mapped:
        _require_straight(loaded)
    t_s, machine = design.control.t_s, linearised(design.machine)
    voltage = usual_pulse(design) if settings.voltage is None else settings.voltage
    most = 0.5 * design.inverter.v_dc / math.sqrt(3.0)
    if voltage > most:
        raise InputError(
            f"control.observer.voltage: {voltage:.4g} V leave nothing for the current control; "
            f"write at most {most:.4g} V, half of what the link of {design.inverter.v_dc:g} V gives"
        )
    period = _period(design, settings)
    usual = min(_LOOP / (period * t_s), FASTEST_LOOP)
    bandwidth = usual if settings.pll_bandwidth is None else settings.pll_bandwidth
    if not bandwidth * period * t_s <= 1.0:
        raise InputError(
            f"control.observer.pll_bandwidth: {bandwidth:g} rad/s are too fast for a sequence "
            f"every {period * t_s:.3g} s; write at most {1.0 / (period * t_s):.4g} rad/s"
        )
    damping = 1.0 if settings.damping is None else settings.damping
    k_p, k_i = pll_gains(bandwidth, damping, period * t_s)
    axis = loaded.axis if mapped else np.zeros(POINTS)
    gains = InformGains(
        t_s=t_s,
        k_p=k_p,
        k_i=k_i,
        omega_max=electrical_limit(machine, t_s, None),
        voltage=voltage,
        period=float(period),
        per_ampere=(POINTS - 1) / float(loaded.i_q[-1]),
        scale=tuple((1.0 / (3.0 * voltage * t_s * loaded.y_delta * np.cos(2.0 * axis))).tolist()),
        shift=tuple((0.5 * np.tan(2.0 * axis) + 0.0).tolist()),
    )
    _require_quiet(gains, design)
    return gains


def _require_straight(loaded: LoadedSaliency) -> None:
    worst = int(np.argmax(np.abs(loaded.axis)))
    if abs(loaded.axis[worst]) > _STRAIGHT:
        raise NoSolutionError(
            "control.observer: cross saturation turns the axis that inform finds by "
            f"{math.degrees(loaded.axis[worst]):.3g} deg at {loaded.torque[worst]:.3g} N m, "
            f"{math.degrees(_STRAIGHT):.3g} are permitted; write method: inductance-mapping"
        )


def _require_quiet(gains: InformGains, design: Design) -> None:
    noise = tracked_noise(gains, current_noise(design))
    if noise > NOISE_ANGLE:
        raise NoSolutionError(
            f"control.observer: {current_noise(design):.3g} A of current noise make the angle of "
            f"the pulses wander by {math.degrees(noise):.3g} deg (r.m.s.), "
            f"{math.degrees(NOISE_ANGLE):.3g} are permitted; write voltage: "
            f"{gains.voltage * noise / NOISE_ANGLE:.3g} V or more, or a smaller pll_bandwidth"
        )


def _speeds(design: Design, gains: InformGains) -> tuple[float, float]:
    """From standstill to where the rotor turns too far in a sequence, or from one to the next, or
    the voltage leaves no room for the pulses.
    """
    machine = linearised(design.machine)
    turn = min(_TURN / (6.0 * gains.t_s), 0.8 / (gains.period * gains.t_s))
    i_q = (POINTS - 1) / gains.per_ampere
    room = design.inverter.v_dc / math.sqrt(3.0) - gains.voltage - machine.r_s * i_q
    flux = math.hypot(machine.psi_pm, machine.l_q * i_q)
    return 0.0, min(turn, room / flux, gains.omega_max)


def _in_words(gains: InformGains) -> str:
    period = gains.period * gains.t_s
    return (
        f"six pulses of {gains.voltage:.4g} V, each {gains.t_s * 1e6:.4g} us, every "
        f"{period * 1e3:.4g} ms; loop {math.sqrt(gains.k_i / period):.4g} rad/s"
    )


def _tracking(gains: InformGains) -> TrackerLoop:
    """The loop as if it were corrected at every sample, with the mean age of what it measures: that
    of the pulses when they are judged, and half the time from one sequence to the next.
    """
    age = round(MIDDLE + 0.5 * (gains.period - 1.0))
    bandwidth = math.sqrt(gains.k_i / (gains.period * gains.t_s))
    return TrackerLoop(
        gains.t_s,
        gains.k_p / gains.period,
        bandwidth**2 * gains.t_s,
        ((age, 1.0),),
    )


def pulse_tracker(name: str, title: str, *, mapped: bool) -> Tracker:
    """The record of a tracker by pulses, with or without the table over the load."""
    return Tracker(
        name=name,
        code=name.replace("-", "_"),
        title=title,
        design=partial(design_inform, mapped),
        start=inform_start,
        step=inform_step,
        gains=InformGains,
        speeds=_speeds,
        in_words=_in_words,
        injects=True,
        loop=_tracking,
    )


TRACKER = pulse_tracker(
    "inform", "INFORM: pairs of voltage pulses that show the saliency", mapped=False
)
