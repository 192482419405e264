"""What in parameters of Infineon's motor-ctrl-lib does not fit together, and what is dangerous."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.configuration import DriveValues, OwnValue, PiGains
from dqforge.optimizer.firmware.infineon_format.infineon_keys import number

TOLERANCE = 0.01
_FAR = 5.0  # How many times faster than the speed loop a filter must be to go unnoticed.


def contradictions(
    own: Mapping[str, OwnValue], drive: DriveValues, q: PiGains | None, speed: PiGains | None
) -> tuple[str, ...]:
    """Sentences on values that do not fit together, with both numbers.

    Args:
        own: Values by member.
        drive: What they amount to.
        q, speed: Gains of q current and speed, None where they are not known.
    """
    return (
        *_poles(own),
        *_voltages(own, drive),
        *_gains(own, drive, q),
        *_speed(own, speed),
        *_current_filter(own),
    )


def filter_time(own: Mapping[str, OwnValue]) -> float:
    """Time constant in s that stands for the filter on the speed: its poles less its zeros; 0
    where it is off.
    """
    if own.get("params.filt.spd_ar_en") != "En":
        return 0.0
    total = 0.0
    for index in (0, 1):
        pole = number(own, f"filt.spd_ar_wp[{index}]")
        zero = number(own, f"filt.spd_ar_wz[{index}]")
        total += (1.0 / pole if pole else 0.0) - (1.0 / zero if zero else 0.0)
    return max(total, 0.0)


def _poles(own: Mapping[str, OwnValue]) -> Iterator[str]:
    poles = number(own, "motor.P")
    if poles is not None and (poles % 2 or poles <= 0):
        yield f"motor.P {poles:g} is no number of poles, which come in pairs"


def _voltages(own: Mapping[str, OwnValue], drive: DriveValues) -> Iterator[str]:
    most, v_dc = number(own, "motor.w_max.elec"), drive.v_dc
    if most and v_dc and drive.psi_pm:
        emf, available = most * drive.psi_pm, v_dc / math.sqrt(3.0)
        if emf > available:
            yield (
                f"at w_max {most:.4g} rad/s the magnets of lam {drive.psi_pm:g} Wb induce "
                f"{emf:.4g} V (peak of phase), vdc_nom {v_dc:g} V gives {available:.4g} V: without "
                f"field weakening the speed ends at {available / drive.psi_pm:.4g} rad/s"
            )
    nominal = number(own, "motor.v_nom")
    if nominal and v_dc and nominal > v_dc / math.sqrt(3.0) * (1.0 + TOLERANCE):
        yield (
            f"v_nom {nominal:.4g} V (peak of phase) is above vdc_nom/sqrt(3) = "
            f"{v_dc / math.sqrt(3.0):.4g} V"
        )
    rated = number(own, "motor.w_nom.elec")
    if rated and most and rated > most * (1.0 + TOLERANCE):
        yield f"w_nom {rated:.4g} rad/s is above w_max {most:.4g} rad/s"


def _gains(own: Mapping[str, OwnValue], drive: DriveValues, q: PiGains | None) -> Iterator[str]:
    bandwidth = number(own, "ctrl.curr.bw")
    if q is None or not bandwidth or not drive.l_q or not drive.r_s:
        return
    fast = q.kp / drive.l_q
    if abs(fast - bandwidth) > TOLERANCE * bandwidth:
        yield (
            f"ctrl.curr.kp.q {q.kp:.4g} V/A is {fast:.4g} rad/s times lq, ctrl.curr.bw is "
            f"{bandwidth:.4g} rad/s: edited by hand, or lq was measured again"
        )


def _speed(own: Mapping[str, OwnValue], speed: PiGains | None) -> Iterator[str]:
    bandwidth = number(own, "ctrl.speed.bw")
    if speed is not None and speed.ki == 0.0:
        yield (
            "the integral gain of the speed controller is 0, as it is viscous friction times bw "
            "and mech.viscous is 0: under load the speed stays below its reference"
        )
    slow = filter_time(own)
    if slow and bandwidth and 1.0 / slow < _FAR * bandwidth:
        yield (
            f"the filter on the speed (spd_ar_en) lags like a pole at {1.0 / slow:.4g} rad/s, "
            f"ctrl.speed.bw is {bandwidth:.4g} rad/s: it takes "
            f"{math.degrees(math.atan(bandwidth * slow)):.0f} deg of the phase margin"
        )


def _current_filter(own: Mapping[str, OwnValue]) -> Iterator[str]:
    corner, rate = number(own, "sys.analog.filt.w0_i_ph"), number(own, "sys.samp.fs0")
    if corner and rate and corner > rate * (1.0 + TOLERANCE):
        state = "unstable" if corner >= 2.0 * rate else "overshooting"
        yield (
            f"w0_i_ph {corner:.4g} rad/s is above fs0 {rate:.4g} Hz: the filter of the currents "
            f"takes {corner / rate:.3g} times the difference each step and is {state}"
        )
