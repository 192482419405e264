"""What in a VESC motor configuration does not fit together, and what in it is dangerous."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.vesc_format.vesc_keys import loop_number

# Share by which numbers of one rule may differ: the tool shows some of them with four digits.
TOLERANCE = 0.01

# foc_observer_gain times the flux linkage squared by VESC's rule, in rad/s (conf_general.c).
OBSERVER_RATE = 1000.0
ENCODER = 1  # foc_sensor_mode of an encoder.


def contradictions(own: Mapping[str, OwnValue]) -> tuple[str, ...]:
    """Sentences on values that do not fit together, with both numbers.

    Args:
        own: Values of the file by its own names.
    """
    return (*_gains(own), *_observer(own), *_limits(own), *_machine(own))


def tracking_poles(kp: float, ki: float) -> tuple[float, float]:
    """Magnitudes in rad/s of the poles of s^2 + kp s + ki, the slower first."""
    inside = kp * kp - 4.0 * ki
    if inside <= 0.0:
        return math.sqrt(ki), math.sqrt(ki)
    root = math.sqrt(inside)
    return 2.0 * ki / (kp + root), 0.5 * (kp + root)


def _gains(own: Mapping[str, OwnValue]) -> Iterator[str]:
    kp, ki = number(own, "foc_current_kp"), number(own, "foc_current_ki")
    r_s, inductance = number(own, "foc_motor_r"), number(own, "foc_motor_l")
    if not kp or not ki or not r_s or not inductance:
        return
    fast, slow = kp / inductance, ki / r_s
    if abs(fast - slow) > TOLERANCE * max(fast, slow):
        yield (
            f"foc_current_kp {kp:g} is {fast:.4g} rad/s times L, foc_current_ki {ki:g} is "
            f"{slow:.4g} rad/s times R: by VESC's rule (kp = L/tc, ki = R/tc) ki would be "
            f"{kp * r_s / inductance:.4g}; edited by hand, tuned by another rule, or R or L was "
            f"measured again"
        )


def _observer(own: Mapping[str, OwnValue]) -> Iterator[str]:
    gain, psi = number(own, "foc_observer_gain"), number(own, "foc_motor_flux_linkage")
    r_s = number(own, "foc_motor_r")
    if not gain or not psi:
        return
    rate = gain * psi * psi
    if abs(rate - OBSERVER_RATE) > TOLERANCE * OBSERVER_RATE:
        older = ""
        if r_s and abs(rate - 10.0 / r_s) < TOLERANCE * rate:
            older = f"; older versions set 10/(R lambda^2) = {10.0 / (r_s * psi * psi):.4g}"
        yield (
            f"foc_observer_gain {gain:g} is {rate:.4g}/lambda^2 instead of VESC's 1000/lambda^2 = "
            f"{OBSERVER_RATE / (psi * psi):.4g}{older}"
        )


def _limits(own: Mapping[str, OwnValue]) -> Iterator[str]:
    i_max, trip = number(own, "l_current_max"), number(own, "l_abs_current_max")
    if i_max is not None and trip is not None and trip < i_max:
        yield (
            f"l_abs_current_max {trip:g} A trips below the permitted current l_current_max "
            f"{i_max:g} A"
        )
    braking = number(own, "l_current_min")
    if braking is not None and braking > 0.0:
        yield f"l_current_min {braking:g} A is not negative: it limits braking"


def _machine(own: Mapping[str, OwnValue]) -> Iterator[str]:
    inductance, difference = number(own, "foc_motor_l"), number(own, "foc_motor_ld_lq_diff")
    if inductance and difference and abs(difference) >= 2.0 * inductance:
        yield (
            f"foc_motor_ld_lq_diff {difference:g} H leaves one axis without inductance: "
            f"foc_motor_l is {inductance:g} H"
        )
    poles, ratio = number(own, "si_motor_poles"), number(own, "foc_encoder_ratio")
    if poles and poles % 2:
        yield f"si_motor_poles {poles:g} is odd: poles come in pairs"
    encoder = loop_number(own, "foc_sensor_mode") == ENCODER
    if encoder and poles and ratio and abs(ratio - 0.5 * poles) > 1e-3:
        yield (
            f"foc_encoder_ratio {ratio:g} is not half of si_motor_poles {poles:g}: an encoder on "
            f"the shaft turns the field {0.5 * poles:g} times a revolution"
        )
