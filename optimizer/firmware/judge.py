"""What the loops of a firmware make of a machine: crossovers, margins, damping, and what is wrong.

Each loop alone takes the axes as decoupled, the inverter as linear, and the back-EMF, where the
firmware feeds it forward, as exactly cancelled; `turning` is what the coupling makes of both
current loops. The speed loop runs at no d current.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.sampled_structure import (
    Mechanics,
    Winding,
    current_loop,
    speed_loop,
)
from dqforge.optimizer.firmware.turning_axes import TurningAxes, turning_axes
from dqforge.optimizer.sampled_systems import (
    ComplexArray,
    SampledSystem,
    loop_margins,
)

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import DriveValues
    from dqforge.optimizer.firmware.profile import (
        CurrentLoops,
        LoopProfile,
        PiController,
        SpeedEstimate,
    )
    from dqforge.optimizer.loops.plants import PiLoop

# Phase that a phase-locked loop may cost at the crossover without being remarked upon: where other
# gains would make it faster for nothing, and where its poles are as they should be.
_DEAR, _DEAR_AT_BEST = math.radians(10.0), math.radians(30.0)
_APART = 0.5  # Share of kp^2/4 below which ki leaves one of its poles far behind the other.
_BANDWIDTH_POINTS = 1200


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLoop:
    """One loop as a firmware runs it.

    Args:
        crossover: Gain crossover in rad/s; nan without one.
        phase_margin: In rad, negative where the loop lags by more than pi.
        gain_margin: As a factor above one.
        delay_margin: In s.
        max_sensitivity: Largest modulus of 1/(1 + L).
        bandwidth: Least frequency in rad/s at which the answer to the reference is 3 dB below one;
            nan where that is nowhere below half the sampling frequency.
        damping: Least damping ratio of the closed loop's poles, -cos of the angle of ln z; below
            zero where it is unstable.
        stable: Whether all poles lie inside the unit circle.
        poles: Of the closed loop, in the z plane of ``t_s``, largest modulus first, shape (n,).
        t_s: Period in s of its controller.
    """

    crossover: float
    phase_margin: float
    gain_margin: float
    delay_margin: float
    max_sensitivity: float
    bandwidth: float
    damping: float
    stable: bool
    poles: ComplexArray
    t_s: float


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFirmware:
    """The loops of one firmware on one machine; None where profile or machine say too little.

    Args:
        current_d, current_q, speed: The loops.
        pll_poles: Of the phase-locked loop that makes the speed, in rad/s (s plane), slowest first;
            None without one.
        remarks: What is wrong, what limits, and what is left out, one sentence each.
        turning: Both current loops together up to the largest speed, None where that is not known.
        faults: Those of the remarks that say what is wrong.
    """

    current_d: JudgedLoop | None
    current_q: JudgedLoop | None
    speed: JudgedLoop | None
    pll_poles: tuple[complex, complex] | None
    remarks: tuple[str, ...]
    turning: TurningAxes | None = None
    faults: tuple[str, ...] = ()


def judge(profile: LoopProfile, drive: DriveValues) -> JudgedFirmware:
    """Judge the loops of a profile on a machine.

    Args:
        profile: The structure with its numbers.
        drive: The machine.
    """
    current, speed = profile.current, profile.speed
    l_q = drive.l_q if drive.l_q is not None else drive.l_d
    l_d = drive.l_d if drive.l_d is not None else l_q
    judged_d = _judged_current(drive.r_s, l_d, current.d, current.delay)
    judged_q = _judged_current(drive.r_s, l_q, current.q, current.delay)
    missing = _missing(drive) if speed is not None else ()
    judged_speed = None
    if speed is not None and not missing:
        assert drive.r_s is not None
        assert l_q is not None
        judged_speed = judged_loop(
            speed_loop(Winding(drive.r_s, l_q), mechanics_of(drive, current), current, speed)
        )
    poles = None if speed is None else pll_poles(speed.feedback)
    turning = _turning(drive, l_d, l_q, current)
    faults = (
        *_unstable(profile, (("d", judged_d), ("q", judged_q), ("speed", judged_speed))),
        *_unstable_together(profile, turning, (judged_d, judged_q)),
        *_of_pll(profile, judged_speed, poles),
    )
    remarks = (
        *faults,
        *_of_observer(profile, judged_speed),
        *_left_out(missing, judged_q),
    )
    return JudgedFirmware(judged_d, judged_q, judged_speed, poles, remarks, turning, faults)


def judged_loop(loop: PiLoop) -> JudgedLoop:
    """Margins, bandwidth and damping of a sampled loop.

    Args:
        loop: The loop, from its error to what is measured.
    """
    margins, poles = loop_margins(loop.open_loop), loop.closed.poles
    return JudgedLoop(
        crossover=margins.crossover,
        phase_margin=margins.phase_margin,
        gain_margin=margins.gain_margin,
        delay_margin=margins.delay_margin,
        max_sensitivity=margins.max_sensitivity,
        bandwidth=_bandwidth(loop.closed),
        damping=least_damping(poles),
        stable=bool(np.abs(poles[0]) < 1.0),
        poles=poles,
        t_s=loop.closed.t_s,
    )


def least_damping(poles: ComplexArray) -> float:
    """Least damping ratio of sampled poles, -Re(ln z)/|ln z|; 1 where all are real and positive.

    Args:
        poles: In the z plane, shape (n,).
    """
    moving = np.log(poles[np.abs(poles) > 1e-9])
    moving = moving[np.abs(moving) > 0.0]
    return float(np.min(-moving.real / np.abs(moving), initial=1.0))


def pll_poles(feedback: SpeedEstimate) -> tuple[complex, complex] | None:
    """Poles in rad/s of s^2 + kp s + ki, slowest first; None where no phase-locked loop runs.

    Args:
        feedback: How the speed is made.
    """
    if feedback.kind != "pll":
        return None
    root = complex(0.25 * feedback.kp**2 - feedback.ki) ** 0.5
    fast = -0.5 * feedback.kp - root
    slow = feedback.ki / fast if fast != 0.0 else 0.0j  # without the difference of large numbers
    return slow, fast


def mechanics_of(drive: DriveValues, current: CurrentLoops) -> Mechanics:
    """What a drive turns, and what of its back-EMF acts; the drive must state all of it.

    Args:
        drive: The machine.
        current: The current loops, which feed the back-EMF forward or do not.
    """
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.inertia is not None
    constant = drive.pole_pairs * drive.psi_pm
    return Mechanics(
        drive.inertia, drive.viscous or 0.0, 1.5 * constant, 0.0 if current.back_emf else constant
    )


def _judged_current(
    r_s: float | None, inductance: float | None, pi: PiController, delay: float
) -> JudgedLoop | None:
    if r_s is None or not inductance:
        return None
    return judged_loop(current_loop(Winding(r_s, inductance), pi, delay))


def _bandwidth(closed: SampledSystem) -> float:
    """Least frequency in rad/s at which the closed loop's answer falls to 3 dB below one."""
    from scipy.optimize import brentq

    def excess(omega: float) -> float:
        return float(np.abs(closed.response(np.array([omega]))[0])) - math.sqrt(0.5)

    nyquist = math.pi / closed.t_s
    omega = np.geomspace(1e-6 * nyquist, nyquist, _BANDWIDTH_POINTS)
    size = np.abs(closed.response(omega)) - math.sqrt(0.5)
    falls = np.flatnonzero((size[:-1] >= 0.0) & (size[1:] < 0.0))
    if not falls.size:
        return math.nan
    return float(brentq(excess, omega[falls[0]], omega[falls[0] + 1], rtol=1e-12))


def _missing(drive: DriveValues) -> tuple[str, ...]:
    """What the speed loop needs and the drive does not say."""
    inductance = drive.l_q if drive.l_q is not None else drive.l_d
    wanted = (
        ("pole pairs", drive.pole_pairs),
        ("resistance", drive.r_s),
        ("inductance", inductance),
        ("flux linkage of the magnets", drive.psi_pm),
        ("inertia", drive.inertia),
    )
    return tuple(name for name, value in wanted if not value)


def _rate(value: float) -> str:
    return f"{value:.4g} rad/s ({value / (2.0 * math.pi):.3g} Hz)"


def _unstable(
    profile: LoopProfile, loops: tuple[tuple[str, JudgedLoop | None], ...]
) -> tuple[str, ...]:
    found = []
    for name, loop in loops:
        if loop is None or loop.stable:
            continue
        what = "speed loop" if name == "speed" else f"{name}-axis current loop"
        found.append(
            f"the {what} is unstable as {profile.firmware} runs it: largest pole modulus "
            f"{abs(loop.poles[0]):.4g}"
        )
    return tuple(found)


def _turning(
    drive: DriveValues, l_d: float | None, l_q: float | None, loops: CurrentLoops
) -> TurningAxes | None:
    if drive.r_s is None or not l_d or not l_q or not drive.pole_pairs or not drive.omega_m_max:
        return None
    return turning_axes(drive.r_s, (l_d, l_q), loops, drive.pole_pairs, drive.omega_m_max)


def _unstable_together(
    profile: LoopProfile, turning: TurningAxes | None, axes: tuple[JudgedLoop | None, ...]
) -> tuple[str, ...]:
    """That the axes are unstable together where each alone is not."""
    alone = all(axis is not None and axis.stable for axis in axes)
    if turning is None or turning.unstable_from is None or not alone:
        return ()
    left = "" if profile.current.cross else ", with no feedforward of the other axis' current"
    words = (
        f"both current loops together are unstable as {profile.firmware} runs them from about "
        f"{turning.unstable_from * 30.0 / math.pi:.4g} rpm{left}: largest pole modulus "
        f"{turning.radius:.4g} at {turning.omega_m * 30.0 / math.pi:.4g} rpm"
    )
    return (words,)


def _of_pll(
    profile: LoopProfile, speed: JudgedLoop | None, poles: tuple[complex, complex] | None
) -> tuple[str, ...]:
    if profile.speed is None or poles is None:
        return ()
    feedback, slow = profile.speed.feedback, abs(poles[0])
    crossover = math.nan if speed is None else speed.crossover
    cost = -cmath.phase(
        complex(feedback.ki, feedback.kp * crossover if feedback.whole else 0.0)
        / complex(feedback.ki - crossover**2, feedback.kp * crossover)
    )
    double = 0.25 * feedback.kp**2
    apart = feedback.ki < _APART * double
    if not (math.isfinite(crossover) and cost > (_DEAR if apart else _DEAR_AT_BEST)):
        return ()
    relation = "below" if slow < crossover else "close to"
    remedy = (
        f"ki = kp^2/4 = {double:.6g} puts both poles at {0.5 * feedback.kp:.6g} rad/s"
        if apart
        else "a larger kp, with ki = kp^2/4, makes it faster where the format permits it"
    )
    words = (
        f"the PLL of {profile.firmware} (kp {feedback.kp:.6g}, ki {feedback.ki:.6g}) has a pole at "
        f"{float(f'{slow:.3g}'):g} rad/s, {relation} the speed loop's crossover of "
        f"{_rate(crossover)}, where it costs {math.degrees(cost):.0f} deg of the phase; {remedy}"
    )
    return (words,)


def _of_observer(profile: LoopProfile, speed: JudgedLoop | None) -> tuple[str, ...]:
    observer = profile.observer
    if observer is None or speed is None:
        return ()
    made = f"the speed is made of the angle of {observer.name}, whose"
    if observer.rate is None:
        return (f"{made} own lag is not in the margins of the speed loop",)
    words = (
        f"{made} errors decay with {observer.rate:.4g} rad/s; with the right resistance, "
        "inductance and flux linkage they are not part of the speed loop, with wrong ones they are"
    )
    return (words,)


def _left_out(missing: tuple[str, ...], judged_q: JudgedLoop | None) -> tuple[str, ...]:
    found = []
    if judged_q is None:
        found.append("no current loop is judged: resistance or inductance is not known")
    if missing:
        found.append(f"the speed loop is not judged: {', '.join(missing)} not known")
    return tuple(found)
