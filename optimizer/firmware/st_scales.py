"""Full scales of ST's MCSDK: what a count of 16 bits is in A and V, and how values are printed."""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Number,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.firmware_method import number, rounded
from dqforge.optimizer.firmware.st_keys import (
    COUNTED,
    SEGMENTS,
    VERSION,
    MtpaTable,
    best_linear_machine,
)

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
    return Scales(current, linear_voltage(v_dc), rate)


# State observer and phase-locked loop of ST's MCSDK: constants in 16 bits, and their poles.

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


# What in the macros of ST's MCSDK does not fit together, and what does not fit 16 bits.

_STEP = 10  # Counts of d current from which on a step between segments is told.
_ROUNDED = 2e-3  # Relative error of inputs that files print rounded.


def contradictions(own: Mapping[str, OwnValue]) -> tuple[str, ...]:
    """One sentence each, with both numbers."""
    return (
        *_gains(own, "TORQUE"),
        *_gains(own, "FLUX"),
        *_dividers(own),
        *_currents(own),
        *_observer(own),
        *_table(own),
    )


def _gains(own: Mapping[str, OwnValue], axis: str) -> Iterator[str]:
    """Whether ki/kp is R/L, to one count in either and what rounded inputs leave open."""
    kp, ki = number(own, f"PID_{axis}_KP_DEFAULT"), number(own, f"PID_{axis}_KI_DEFAULT")
    kp_divider, ki_divider = number(own, "TF_KPDIV"), number(own, "TF_KIDIV")
    r_s, inductance, rate = number(own, "RS"), number(own, "LS"), control_rate(own)
    if axis == "FLUX" and inductance is not None:
        inductance *= number(own, "ld_lq_ratio") or 1.0
    if not kp or ki is None or not kp_divider or not ki_divider:
        return
    if r_s is None or not inductance or rate is None:
        return
    wanted = kp / shift(kp_divider) * r_s / (inductance * rate) * shift(ki_divider)
    room = 1.0 + wanted * (_ROUNDED + 1.0 / kp)
    if abs(ki - wanted) > room:
        yield (
            f"PID_{axis}_KI_DEFAULT {ki:g} is not R/(L f) of PID_{axis}_KP_DEFAULT {kp:g} = "
            f"{wanted:.1f} counts, Workbench's rule: chosen by another one, edited by hand, or R "
            "or L measured again"
        )


def _dividers(own: Mapping[str, OwnValue]) -> Iterator[str]:
    for name in ("TF_KPDIV", "TF_KIDIV", "SP_KPDIV", "SP_KIDIV"):
        value = number(own, name)
        if value is not None and not math.log2(max(value, 0.5)).is_integer():
            yield (
                f"{name} {value:g} is no power of two, of which the firmware takes the logarithm: "
                f"it divides by {shift(value):.0f}"
            )


def _currents(own: Mapping[str, OwnValue]) -> Iterator[str]:
    full = current_scale(own)
    for name in ("NOMINAL_CURRENT_A", "IQMAX_A", "ID_DEMAG_A"):
        value = number(own, name)
        if value is not None and full is not None and abs(value) > full * LARGEST / FULL:
            yield (
                f"{name} {value:g} A is beyond the full scale of the current measurement, "
                f"{full:.4g} A"
            )


def _table(own: Mapping[str, OwnValue]) -> Iterator[str]:
    """Steps between the segments of a table, which the best table hardly has."""
    width, full = number(own, "SEGDIV"), current_scale(own)
    slopes, offsets = integers(own.get("ANGC")), integers(own.get("OFST"))
    if not width or slopes is None or offsets is None or len(slopes) != len(offsets):
        return
    largest = own_counts(own, full) or min(LARGEST, int(width) * SEGMENTS - 1)
    whole = MtpaTable(int(width), slopes, offsets, largest, 0.0, 0)
    if len(slopes) != SEGMENTS or whole.largest < SEGMENTS:
        return
    found = best_linear_machine(whole)
    if found.jump < _STEP:
        return
    in_amperes = "" if full is None else f" ({found.error * full / FULL:.3g} A)"
    yield (
        f"ANGC and OFST step by up to {found.jump} counts from one segment to the next, and are "
        f"off by {found.error:.0f} counts{in_amperes} from the currents of least loss of any "
        "machine of constant inductances: write the table again from the machine"
    )


def own_counts(own: Mapping[str, OwnValue], full: float | None) -> int | None:
    """Counts of the largest q current, None where it is not known."""
    amperes, counts = number(own, "IQMAX_A"), number(own, "IQMAX")
    if amperes is not None and full is not None:
        return min(LARGEST, round(amperes * FULL / full))
    return None if counts is None else min(LARGEST, int(counts))


def _observer(own: Mapping[str, OwnValue]) -> Iterator[str]:
    f1 = number(own, "F1")
    machine = observed_machine(own) or observed_machine(own, 1.0)
    if not f1 or machine is None:
        return
    measured = number(own, "VBUS_PARTITIONING_FACTOR") is not None
    whole = constants(machine, int(f1))
    for name, value in whole.items():
        if (measured or name != "C5") and abs(value) > LARGEST:
            yield (
                f"{name} of the observer is {value:d} with F1 {f1:g}, beyond the 16 bits that hold "
                f"it: it wraps to {(value + 32768) % 65536 - 32768:d}"
            )
    wanted = observer_integers(machine)
    if not wanted["F1"]:
        yield "no F1 of the observer makes its constants fit 16 bits: L f is too small"
        return
    former = observer_integers(replace(machine, room=1.0))
    for name, scale in (("GAIN1", "F1"), ("GAIN2", "F2")):
        given, factor = number(own, name), number(own, scale)
        if given is None or not factor:
            continue
        expected = [found[name] * factor / max(found[scale], 1) for found in (wanted, former)]
        room = 1.0 + factor / max(wanted[scale], 1)
        if all(abs(given - one) > room + _ROUNDED * abs(one) for one in expected):
            slow = max(abs(pole) for pole in placed_poles(own, machine))
            yield (
                f"{name} {given:g} is not Workbench's {expected[0]:.0f} for these R, L and rates: "
                f"the slower pole of the observer is {slow:.3g} per period"
                + (", unstable" if slow >= 1.0 else "")
            )


# Integer gains of ST's MCSDK with their power-of-two dividers, as its Workbench chooses them.

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


# What the macros of ST's MCSDK amount to in SI units: one way for those read and those chosen.

CONVENTIONS = (
    "currents are peak values of a phase, 32768 counts are reference/2 over shunt and gain",
    "32768 counts of voltage are v_dc/sqrt(3), where Workbench counts v_dc/2: 1.155 times as fast",
    "MOTOR_VOLTAGE_CONSTANT is in V r.m.s. line to line per 1000 rpm (mechanical)",
    "LS is the inductance of a phase along q",
)


def st_configuration(
    name: str,
    own: Mapping[str, OwnValue],
    *,
    version: str = VERSION,
    origins: Mapping[str, Origin] | None = None,
    conventions: tuple[str, ...] = CONVENTIONS,
) -> Configuration:
    """Macros with what they amount to.

    Args:
        name: Name of the drive.
        own: Macros by their names of version 6, and what else the motor file says.
        version: ``5`` or ``6``.
        origins, conventions: As in `Configuration`.
    """
    scale, rate = scales(own), _positive(own, "SPEED_LOOP_FREQUENCY_HZ")
    full = current_scale(own)
    gains: tuple[PiGains | None, PiGains | None] = (None, None)
    if scale is not None:
        gains = current_gains(own, "FLUX", scale), current_gains(own, "TORQUE", scale)
    return Configuration(
        firmware="st",
        version=version,
        name=name,
        drive=_drive(own),
        current_d=gains[0],
        current_q=gains[1],
        speed=None if full is None or rate is None else speed_gains(own, full, rate),
        own=own,
        origins=origins or {},
        conventions=conventions,
        contradictions=contradictions(own),
    )


def joined(parts: Iterable[Configuration]) -> Configuration:
    """Several files of one drive as one configuration; where two say the same, the first counts."""
    whole = tuple(parts)
    own: dict[str, OwnValue] = {}
    origins: dict[str, Origin] = {}
    for part in reversed(whole):
        own |= part.own
        origins |= part.origins
    names = [part.name for part in whole if part.name]
    version = "5" if any(part.version == "5" for part in whole) else VERSION
    said = tuple(dict.fromkeys(words for part in whole for words in part.conventions))
    return st_configuration(
        names[0] if names else "", own, version=version, origins=origins, conventions=said
    )


def amperes(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A current in A that a macro holds in A, or another in counts; None where not said."""
    value = number(own, name)
    if value is not None:
        return value
    counts, full = number(own, COUNTED[name]), current_scale(own)
    return None if counts is None or full is None else counts * full / FULL


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs, inductance = number(own, "POLE_PAIR_NUM"), number(own, "LS")
    emf, rate = number(own, "MOTOR_VOLTAGE_CONSTANT"), control_rate(own)
    speed_rate = _positive(own, "SPEED_LOOP_FREQUENCY_HZ")
    ratio, dead_time = number(own, "ld_lq_ratio"), number(own, "SW_DEADTIME_NS")
    rpm = number(own, "MAX_APPLICATION_SPEED_RPM") or number(own, "MOTOR_MAX_SPEED_RPM")
    return DriveValues(
        pole_pairs=None if not pairs else int(pairs),
        r_s=number(own, "RS"),
        l_d=None if inductance is None else inductance * (1.0 if ratio is None else ratio),
        l_q=inductance,
        psi_pm=None if emf is None or not pairs else flux_of(emf, int(pairs)),
        inertia=_millionths(own, "inertia"),
        viscous=_millionths(own, "friction"),
        i_max=amperes(own, "NOMINAL_CURRENT_A"),
        omega_m_max=None if not rpm else rpm * math.pi / 30.0,
        v_dc=_positive(own, "NOMINAL_BUS_VOLTAGE_V"),
        f_sw=_positive(own, "PWM_FREQUENCY"),
        dead_time=None if dead_time is None else dead_time / 1e9,
        t_s=None if rate is None else 1.0 / rate,
        t_speed=None if speed_rate is None else 1.0 / speed_rate,
        shunt=_positive(own, "RSHUNT"),
        sense_gain=_positive(own, "AMPLIFICATION_GAIN"),
        sense_reference=_positive(own, "ADC_REFERENCE_VOLTAGE"),
    )


def _positive(own: Mapping[str, OwnValue], name: str) -> float | None:
    return number(own, name) or None


def _millionths(own: Mapping[str, OwnValue], name: str) -> float | None:
    value = number(own, name)
    return None if value is None else value / 1e6
