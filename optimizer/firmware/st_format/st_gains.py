"""Integer gains of ST's MCSDK with their power-of-two dividers, as its Workbench chooses them."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import OwnValue, PiGains
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.st_format.st_scales import LARGEST, SPEED_UNIT, Scales

BANDWIDTH = 6000.0  # rad/s of the current loops that Workbench tunes for by itself.
_BOUND = 4000.0  # Gains stay below it; the divider is the largest with which they do.
_USUAL_DIVIDER = 16384
_LARGEST_DIVIDER = 32768
_COARSE = 1e-3  # Relative error of rounding from which on a gain is given the largest divider.


@dataclass(frozen=True, slots=True)
class IntegerGain:
    """A gain as the quotient of two integers, the divider a power of two."""

    gain: int
    divider: int

    @property
    def value(self) -> float:
        """The quotient."""
        return self.gain / self.divider


def vendor_gain(value: float) -> IntegerGain:
    """A gain as Workbench writes it: below 4000, with a divider of at most 16384.

    Raises:
        InputError: It does not fit 16 bits.
    """
    divider = _USUAL_DIVIDER
    while divider > 1 and value * divider >= _BOUND:
        divider //= 2
    gain = round(value * divider)
    if gain > LARGEST:
        raise InputError(f"a gain of {value:.4g} counts per count does not fit 16 bits")
    return IntegerGain(gain, divider)


def fine_gain(value: float) -> IntegerGain:
    """A gain as Workbench writes it, with a finer divider where that rounds by more than 0.1 %."""
    found = vendor_gain(value)
    if value > 0.0 and abs(found.value - value) > _COARSE * value:
        finer = IntegerGain(round(value * _LARGEST_DIVIDER), _LARGEST_DIVIDER)
        if finer.gain <= LARGEST:
            return finer
    return found


def workbench_gains(
    r_s: float, inductance: float, v_dc: float, scale: Scales, bandwidth: float = BANDWIDTH
) -> tuple[IntegerGain, IntegerGain]:
    """Proportional and integral gain by Workbench's own rule.

    It makes L w and R w of the voltage v_dc/2 per full scale. The modulator makes v_dc/sqrt(3) of
    full scale, so that the loop which then runs is 2/sqrt(3) = 1.155 times as fast as w.

    Args:
        r_s, inductance: Resistance in Ohm and inductance in H of a phase.
        v_dc: Nominal voltage of the dc link in V.
        scale: Full scales, of which the current and the rate are used.
        bandwidth: w in rad/s.
    """
    per_volt = scale.current / (0.5 * v_dc)
    return (
        vendor_gain(inductance * bandwidth * per_volt),
        vendor_gain(r_s * bandwidth * per_volt / scale.rate),
    )


def current_integers(d: PiGains, q: PiGains, scale: Scales) -> dict[str, int]:
    """Macros of both current controllers, which share their dividers.

    Raises:
        InputError: A gain does not fit 16 bits.
    """
    larger_kp, larger_ki = max(d.kp, q.kp), max(d.ki, q.ki)
    kp_divider = fine_gain(larger_kp * scale.proportional).divider
    ki_divider = fine_gain(larger_ki * scale.integral).divider
    return {
        "PID_TORQUE_KP_DEFAULT": round(q.kp * scale.proportional * kp_divider),
        "PID_TORQUE_KI_DEFAULT": round(q.ki * scale.integral * ki_divider),
        "PID_FLUX_KP_DEFAULT": round(d.kp * scale.proportional * kp_divider),
        "PID_FLUX_KI_DEFAULT": round(d.ki * scale.integral * ki_divider),
        "TF_KPDIV": kp_divider,
        "TF_KIDIV": ki_divider,
    }


def speed_integers(speed: PiGains, full_current: float, rate: float) -> dict[str, int]:
    """Macros of the speed controller: counts of q current per tenth of a hertz.

    Args:
        speed: Gains in A s/rad and A/rad.
        full_current: A of 32768 counts.
        rate: Hz with which it runs.
    """
    per_unit = SPEED_UNIT * 32768.0 / full_current
    kp, ki = fine_gain(speed.kp * per_unit), fine_gain(speed.ki * per_unit / rate)
    return {
        "PID_SPEED_KP_DEFAULT": kp.gain,
        "PID_SPEED_KI_DEFAULT": ki.gain,
        "SP_KPDIV": kp.divider,
        "SP_KIDIV": ki.divider,
    }


def current_gains(own: Mapping[str, OwnValue], axis: str, scale: Scales) -> PiGains | None:
    """Gains of the axis ``TORQUE`` (q) or ``FLUX`` (d) in V/A and V/(A s), None where not said."""
    found = _quotients(own, f"PID_{axis}", "TF")
    if found is None:
        return None
    return PiGains(found[0] / scale.proportional, found[1] / scale.integral)


def speed_gains(own: Mapping[str, OwnValue], full_current: float, rate: float) -> PiGains | None:
    """Gains of the speed controller in A s/rad and A/rad, None where not said."""
    found = _quotients(own, "PID_SPEED", "SP")
    if found is None:
        return None
    per_unit = SPEED_UNIT * 32768.0 / full_current
    return PiGains(found[0] / per_unit, found[1] * rate / per_unit)


def shift(divider: float) -> float:
    """The power of two by which a divider divides: its logarithm is rounded, so that 65535 is
    65536.
    """
    return float(2 ** round(math.log2(max(divider, 1.0))))


def _quotients(
    own: Mapping[str, OwnValue], gains: str, dividers: str
) -> tuple[float, float] | None:
    kp, ki = number(own, f"{gains}_KP_DEFAULT"), number(own, f"{gains}_KI_DEFAULT")
    kp_divider, ki_divider = number(own, f"{dividers}_KPDIV"), number(own, f"{dividers}_KIDIV")
    if kp is None or ki is None or not kp_divider or not ki_divider:
        return None
    return kp / shift(kp_divider), ki / shift(ki_divider)
