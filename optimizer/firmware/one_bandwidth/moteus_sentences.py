"""How the numbers of a moteus configuration are meant, and what in them does not fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

Numbers = Mapping[str, float | int]

# Rate of the control over the bandwidth of the currents, as moteus_tool keeps it at least.
SLOWEST_SHARE = 30.0
FILTER_SHARE = 10.0  # Rate of the control over the bandwidth of the encoder's filter, likewise.


def conventions(numbers: Numbers, period: float | None = None) -> Iterator[str]:
    """Sentences on how numbers are meant that a reader could take otherwise.

    Args:
        numbers: Values by key, of the rotor.
        period: Of the control in s, None where it is not known.
    """
    if "motor.Kv" in numbers:
        yield "motor.Kv is in rpm per volt between two phases (peak), of the rotor"
    if "motor.poles" in numbers:
        yield "motor.poles counts poles, not pole pairs"
    if "servo.max_current_A" in numbers:
        yield "servo.max_current_A (peak of phase) limits d and q current each by itself"
    if "servo.pid_position.kd" in numbers:
        yield (
            "servo.pid_position is taken as a controller of the speed: kd as its proportional, kp "
            "as its integral gain"
        )
    yield from _feedforward(numbers)
    hertz = numbers.get("servo.pid_dq_hz")
    if hertz is not None and period is not None and hertz * period > 1.001 / SLOWEST_SHARE:
        yield (
            f"servo.pid_dq_hz {hertz:g} Hz is above 1/{SLOWEST_SHARE:g} of the control's "
            f"{1.0 / period:g} Hz, the most that moteus_tool sets by itself: the firmware takes "
            "it, and the margins of the current loops say what becomes of it"
        )


def contradictions(numbers: Numbers, period: float | None) -> Iterator[str]:
    """Sentences on what does not fit together.

    Args:
        numbers: Values by key, of the rotor.
        period: Of the control in s, None where it is not known.
    """
    hertz = numbers.get("servo.pid_dq_hz")
    if hertz is not None and "servo.pid_dq.kp" in numbers:
        yield (
            f"servo.pid_dq.kp {numbers['servo.pid_dq.kp']:g} stands beside servo.pid_dq_hz "
            f"{hertz:g}: firmware from ABI 0x010e on takes the latter alone"
        )
    if period is not None:
        yield from _too_fast(numbers, 1.0 / period)
    yield from _integral(numbers)
    if numbers.get("servo.voltage_mode_control"):
        yield "servo.voltage_mode_control 1: the current loops do not run, currents become voltages"
    if (
        numbers.get("servo.pid_position.ki", 0.0)
        > 0.0
        < numbers.get("servo.pid_position.ilimit", 0)
    ):
        yield (
            f"servo.pid_position.ki {numbers['servo.pid_position.ki']:g} with ilimit "
            f"{numbers['servo.pid_position.ilimit']:g} N m integrates the position error: that is "
            "not part of the speed loop judged here"
        )


def _feedforward(numbers: Numbers) -> Iterator[str]:
    share = numbers.get("servo.current_feedforward", 0.0)
    r_s, l_q = numbers.get("motor.resistance_ohm", 0.0), numbers.get("motor.inductance_q_H", 0.0)
    hertz = numbers.get("servo.pid_dq_hz", 0.0)
    if share > 0.0 < r_s and l_q > 0.0 < hertz:
        more = overshoot(share, 2.0 * math.pi * hertz * l_q / r_s)
        yield (
            f"servo.current_feedforward {share:g} adds R times the reference to the voltage: a "
            f"step of the q current overshoots by {more:.1%}, the margins stay"
        )


def _too_fast(numbers: Numbers, rate: float) -> Iterator[str]:
    key = "motor_position.sources.0.pll_filter_hz"
    value = numbers.get(key)
    if value is not None and value > 1.001 * rate / FILTER_SHARE:
        yield (
            f"{key} {value:g} Hz is above 1/{FILTER_SHARE:g} of the control's {rate:g} Hz, the "
            "most that moteus_tool sets for the filter of the encoder"
        )


def _integral(numbers: Numbers) -> Iterator[str]:
    """Gains written by hand whose integral does not go with resistance and inductance."""
    if "servo.pid_dq_hz" in numbers or "servo.pid_dq.kp" not in numbers:
        return
    kp, ki = numbers["servo.pid_dq.kp"], numbers.get("servo.pid_dq.ki", 0.0)
    r_s = numbers.get("motor.resistance_ohm", 0.0)
    inductance = numbers.get("motor.inductance_d_H", 0.0)
    if not (r_s > 0.0 and inductance > 0.0):
        return
    fitting = kp * r_s / inductance
    if abs(ki - fitting) > 0.02 * fitting:
        yield (
            f"servo.pid_dq.ki {ki:g} is not R/L kp = {fitting:.4g} V/(A s): edited by hand, or "
            "R or L were measured again"
        )


# What a voltage R times the reference, added to a PI controller that cancels the winding's pole,
# does to a step of the current.


def overshoot(share: float, ratio: float) -> float:
    """Largest excess of the current over a unit step of its reference, sampling left aside.

    The error of the step is A e^(-b t) + B e^(-t/tau) with the bandwidth b, the winding's time
    constant tau, B = -k/(b tau - 1) and A = 1 - B.

    Args:
        share: Part k of R times the reference that is added, 0..1.
        ratio: Bandwidth times the winding's time constant, positive.
    """
    if share <= 0.0:
        return 0.0
    if abs(ratio - 1.0) < 1e-6:
        ratio = 1.0 + 1e-6
    slow = -share / (ratio - 1.0)
    fast = 1.0 - slow
    # Time over tau at which e' = 0: -ratio fast e^(-ratio x) - slow e^(-x) = 0.
    inside = -ratio * fast / slow
    if inside <= 0.0:
        return 0.0
    x = math.log(inside) / (ratio - 1.0)
    error = fast * math.exp(-ratio * x) + slow * math.exp(-x)
    return max(-error, 0.0) if x > 0.0 else 0.0
