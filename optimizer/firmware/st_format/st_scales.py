"""Full scales of ST's MCSDK: what a count of 16 bits is in A and V, and how values are printed."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.own_values import number, rounded

FULL = 32768.0  # Counts of full scale.
LARGEST = 32767  # Largest integer of 16 bits with sign.
REFERENCE = 3.3  # Reference of the converter in V where a file does not say; its headers do not.
SPEED_UNIT = 0.2 * math.pi  # Unit of the speed controller in mechanical rad/s: tenths of a hertz.

# V s/rad (peak of phase, mechanical) per V r.m.s. line-to-line and 1000 rpm.
EMF = math.sqrt(2.0 / 3.0) * 60.0 / (2000.0 * math.pi)
_WHOLE = re.compile(r"-?\d{1,10}")


@dataclass(frozen=True, slots=True)
class Scales:
    """Full scales of the current controllers.

    Args:
        current: A of 32768 counts of current: reference/2 over shunt and gain.
        voltage: V (peak of phase) of 32768 counts of voltage: v_dc/sqrt(3), by the modulator.
        rate: Hz with which the current controllers run.
    """

    current: float
    voltage: float
    rate: float

    @property
    def proportional(self) -> float:
        """Counts of voltage per count of current, of one V/A."""
        return self.current / self.voltage

    @property
    def integral(self) -> float:
        """The same of one V/(A s), per period."""
        return self.proportional / self.rate


def integers(text: OwnValue | None) -> tuple[int, ...] | None:
    """Integers of a table such as ``{0,-12,3}``; None where there is none."""
    return None if not isinstance(text, str) else tuple(int(part) for part in _WHOLE.findall(text))


def printed(value: float) -> float:
    """A number as it is printed, with six digits."""
    return rounded(value, 6)


def current_scale(own: Mapping[str, OwnValue]) -> float | None:
    """A of 32768 counts, None where shunt or gain are not said."""
    shunt, gain = number(own, "RSHUNT"), number(own, "AMPLIFICATION_GAIN")
    if not shunt or not gain:
        return None
    reference = number(own, "ADC_REFERENCE_VOLTAGE") or REFERENCE
    return 0.5 * reference / (shunt * gain)


def control_rate(own: Mapping[str, OwnValue]) -> float | None:
    """Hz of the current controllers, None where the carrier is not said."""
    carrier = number(own, "PWM_FREQUENCY")
    if not carrier:
        return None
    return carrier / (number(own, "REGULATION_EXECUTION_RATE") or 1.0)


def scales(own: Mapping[str, OwnValue]) -> Scales | None:
    """Full scales of a configuration, None where it says too little."""
    current, rate = current_scale(own), control_rate(own)
    v_dc = number(own, "NOMINAL_BUS_VOLTAGE_V")
    if current is None or rate is None or not v_dc:
        return None
    return Scales(current, v_dc / math.sqrt(3.0), rate)
