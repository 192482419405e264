"""State observer and phase-locked loop of ST's MCSDK: constants in 16 bits, and their poles."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Number, OwnValue
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.st_format.st_gains import shift
from dqforge.optimizer.firmware.st_format.st_scales import EMF, LARGEST, control_rate, current_scale

# Pole per period that Workbench gives the observed current; the other is a quarter of the decay of
# the winding.
_LARGEST_FACTOR = 16384
_FIRST_POLE = 0.25
_ROOM = 1.2  # Full scale of the back-EMF over the one at the largest speed.

# PLL_KP_GAIN over pole pairs and turns per control period, at the divider 16384; with the ratio of
# both gains a loop of 250 rad/s and damping 1/sqrt(2) where the back-EMF is that of 363 rad/s
# (electrical). Found from four projects, to the digit.
_TRACKING = 31926.0

# PLL_KI_GAIN over PLL_KP_GAIN times the rate in Hz, at the dividers 65536 and 16384.
_TRACKING_RATIO = 1000.0 / math.sqrt(2.0)

# Least speed at which the observer is relied on, over the largest, as Workbench writes it.
LOW_SHARE = 0.36


@dataclass(frozen=True, slots=True)
class ObservedMachine:
    """What the constants are made of.

    Resistance in Ohm, inductance in H, ``emf`` the back-EMF constant in V r.m.s. line-to-line per
    1000 rpm, ``speed`` the largest in rpm, ``current`` and ``voltage`` the full scales in A and V
    (peak of phase), ``rate`` in Hz. ``room`` is what Workbench takes for the full scale of the
    back-EMF over that at the largest speed: version 5 took 1 where its firmware has 1.2.
    """

    r_s: float
    inductance: float
    emf: float
    speed: float
    current: float
    voltage: float
    rate: float
    room: float = _ROOM

    @property
    def decay(self) -> float:
        """Share of the current that the resistance takes in a period."""
        return self.r_s / (self.inductance * self.rate)

    @property
    def volt_seconds(self) -> float:
        """V that change the current by its full scale in a period."""
        return self.inductance * self.current * self.rate

    @property
    def emf_scale(self) -> float:
        """Full scale of the back-EMF in V (peak of phase)."""
        return self.speed * _ROOM * self.emf * math.sqrt(2.0 / 3.0) / 1000.0


def observer_poles(decay: float) -> tuple[float, float]:
    """Poles per period that Workbench places: 1/4, and a quarter of 1 - R/(L f)."""
    return _FIRST_POLE, 0.25 * (1.0 - decay)


def constants(machine: ObservedMachine, f1: int) -> dict[str, int]:
    """C1, C3 and C5 as the headers work them out, with F1; not yet held to 16 bits.

    The full scales of back-EMF and voltage are cut to whole volts there.
    """
    return {
        "C1": int(f1 * machine.decay),
        "C3": int(f1 * math.floor(machine.emf_scale) / machine.volt_seconds),
        "C5": int(f1 * math.floor(machine.voltage) / machine.volt_seconds),
    }


def observer_integers(machine: ObservedMachine) -> dict[str, int]:
    """F1, F2, GAIN1 and GAIN2: the largest factors with which all constants fit 16 bits.

    F1 is 0 where none does.
    """
    first, second = observer_poles(machine.decay)
    for_current = first + second - 2.0 + machine.decay
    volts = max(1.0, round(machine.emf_scale * machine.room / _ROOM))
    for_emf = (1.0 - first) * (1.0 - second) * machine.volt_seconds / volts
    f1 = _LARGEST_FACTOR
    while f1 and not _fits(machine, f1, for_current):
        f1 //= 2
    f2 = _LARGEST_FACTOR
    while f2 > 1 and for_emf * f2 > LARGEST:
        f2 //= 2
    return {"F1": f1, "F2": f2, "GAIN1": int(f1 * for_current), "GAIN2": int(f2 * for_emf)}


def _fits(machine: ObservedMachine, f1: int, for_current: float) -> bool:
    whole = (*constants(machine, f1).values(), int(f1 * for_current))
    return max(abs(value) for value in whole) <= LARGEST


def tracking_integers(
    pole_pairs: int, speed: float, rate: float, faster: float = 1.0
) -> dict[str, int]:
    """PLL gains as Workbench writes them, or for a loop that is faster by a factor.

    Args:
        pole_pairs: Number of pole pairs.
        speed: Largest speed in rpm.
        rate: Hz of the current controllers.
        faster: Factor on the proportional gain; above one the integral gain is that of a damping of
            1/sqrt(2) at the least speed (`LOW_SHARE`).
    """
    gain = _TRACKING * pole_pairs * speed / (60.0 * rate)
    integral = gain * _TRACKING_RATIO / rate
    if faster > 1.0:
        gain *= faster
        counts = LARGEST / _ROOM * LOW_SHARE * 2.0 * math.pi / 65536.0
        integral = 4.0 * gain * (0.5 * gain / 16384.0 * counts)
    return {
        "PLL_KP_GAIN": min(LARGEST, round(gain)),
        "PLL_KI_GAIN": min(LARGEST, round(integral)),
        "PLL_KPDIV": 16384,
        "PLL_KIDIV": 65535,
    }


@dataclass(frozen=True, slots=True)
class Tracking:
    """The phase-locked loop at one speed: theta'' from kp (1/s) and ki (1/s^2) of the angle error;
    ``speed`` is mechanical, in rad/s.
    """

    kp: float
    ki: float
    speed: float

    @property
    def poles(self) -> tuple[complex, complex]:
        """Roots of s^2 + kp s + ki in rad/s, the slower one first."""
        root = cmath.sqrt(0.25 * self.kp * self.kp - self.ki)
        return -0.5 * self.kp + root, -0.5 * self.kp - root


def tracking(own: Mapping[str, OwnValue], speed: float) -> Tracking | None:
    """The phase-locked loop of a configuration at a mechanical speed in rad/s.

    Its gain is that of the back-EMF in counts, so that it slows down with the speed.
    """
    kp, ki = number(own, "PLL_KP_GAIN"), number(own, "PLL_KI_GAIN")
    rate, top = control_rate(own), number(own, "MAX_APPLICATION_SPEED_RPM")
    if not kp or ki is None or rate is None or not top:
        return None
    counts = LARGEST / _ROOM * speed / (top * math.pi / 30.0)
    per_count = counts * 2.0 * math.pi / 65536.0
    kp_divider = shift(number(own, "PLL_KPDIV") or 16384.0)
    ki_divider = shift(number(own, "PLL_KIDIV") or 65536.0)
    return Tracking(
        kp / kp_divider * per_count * rate,
        ki / ki_divider * per_count * rate * rate,
        speed,
    )


def low_speed(own: Mapping[str, OwnValue]) -> float | None:
    """Least mechanical speed in rad/s at which the observer is relied on."""
    low, top = number(own, "OBS_MINIMUM_SPEED_RPM"), number(own, "MAX_APPLICATION_SPEED_RPM")
    if low:
        return low * math.pi / 30.0
    return None if not top else LOW_SHARE * top * math.pi / 30.0


def observed_machine(
    own: Mapping[str, OwnValue], voltage: float | None = None
) -> ObservedMachine | None:
    """What a configuration says of the observer's machine, None where it says too little.

    The full scale of the voltage is given in V, or follows from the divider of the bus voltage.
    """
    names = ("RS", "LS", "MOTOR_VOLTAGE_CONSTANT", "MAX_APPLICATION_SPEED_RPM")
    values = [number(own, name) for name in names]
    current, rate = current_scale(own), control_rate(own)
    if voltage is None:
        divider = number(own, "VBUS_PARTITIONING_FACTOR")
        reference = number(own, "ADC_REFERENCE_VOLTAGE") or 3.3
        voltage = None if not divider else reference / math.sqrt(3.0) / divider
    if current is None or rate is None or voltage is None:
        return None
    r_s, inductance, emf, speed = values
    if not r_s or not inductance or emf is None or not speed:
        return None
    return ObservedMachine(r_s, inductance, emf, speed, current, voltage, rate)


def placed_poles(own: Mapping[str, OwnValue], machine: ObservedMachine) -> tuple[complex, complex]:
    """Poles per period of the observer that a configuration runs, with its integers."""
    f1, f2 = number(own, "F1") or 1.0, number(own, "F2") or 1.0
    current = (number(own, "GAIN1") or 0.0) / f1
    back = math.floor(machine.emf_scale) / machine.volt_seconds
    emf = (number(own, "GAIN2") or 0.0) / f2
    total = 2.0 - machine.decay + current
    product = 1.0 - machine.decay + current + back * emf
    root = cmath.sqrt(0.25 * total * total - product)
    return 0.5 * total + root, 0.5 * total - root


def flux_of(emf: float, pole_pairs: int) -> float:
    """Flux linkage in Wb of a back-EMF constant in V r.m.s. line-to-line per 1000 rpm."""
    return emf * EMF / pole_pairs


def emf_of(psi_pm: float, pole_pairs: int) -> Number:
    """Back-EMF constant in V r.m.s. line-to-line per 1000 rpm of a flux linkage in Wb."""
    return psi_pm * pole_pairs / EMF
