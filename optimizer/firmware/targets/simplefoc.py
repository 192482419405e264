"""SimpleFOC: the members of its motor for a design, and the loops that it then runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    LoopProfile,
    Number,
    Origin,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    Asked,
    Fields,
    FirmwareMethod,
    Price,
    Shortfall,
    field_origins,
    number,
    q_current_alone,
    rounded,
)

SOURCES = (
    "simplefoc/Arduino-FOC 7f9c45f src/common/pid.cpp:41: trapezoid, integral clamped",
    "simplefoc/Arduino-FOC 7f9c45f src/common/base_classes/FOCMotor.cpp:543,650: loop, decoupling",
    "simplefoc/Arduino-FOC 7f9c45f src/common/lowpass_filter.cpp: share T/(T + Tf)",
    "simplefoc/Arduino-FOC 7f9c45f src/BLDCMotor.cpp:38,144: constructor, KV",
    "simplefoc/Arduino-FOC 7f9c45f src/communication/Commander.cpp:131-263: lines",
)

# The library's filter on the speed in s, which is kept where nothing faster is needed.
SPEED_FILTER = 0.005
_FILTER_SHARE = 0.1
_MODULATION = {0: "spwm", 1: "svpwm"}


def rule(inductance: float, r_s: float, bandwidth: float) -> dict[str, float]:
    """The library's own gains (tuneCurrentController): P = 2 pi f L, I = 2 pi f R, and the filter
    at five times that frequency.

    Args:
        inductance, r_s: Of a phase, in H and Ohm.
        bandwidth: In Hz.
    """
    omega = 2.0 * math.pi * bandwidth
    return {"P": inductance * omega, "I": r_s * omega, "Tf": 1.0 / (5.0 * omega)}


def configure(asked: Asked) -> Configuration:
    """The members for a design.

    Raises:
        InputError: A value that they need is missing, or a current loop is faster than half the
            rate of the library's loop, which it refuses itself.
    """
    drive = asked.drive
    own: dict[str, OwnValue] = dict(_machine(drive))
    own |= {"foc_modulation": 1, "torque_controller": FOC_CURRENT}
    own |= {"controller": 0 if asked.speed is None else 1}
    for axis, gains, inductance in (
        ("q", asked.current_q, drive.l_q),
        ("d", asked.current_d, drive.l_d),
    ):
        own |= _current(axis, gains, inductance, drive)
    if asked.speed is not None:
        own |= _speed(asked, asked.speed)
    own |= _limits(drive, with_speed=asked.speed is not None)
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that SimpleFOC runs with a configuration.

    Raises:
        InputError: It does not control the currents.
    """
    if found.current_d is None or found.current_q is None:
        raise InputError(
            "this configuration of SimpleFOC does not control the currents; set torque_controller "
            "to TorqueControlType::foc_current"
        )
    own, pi = found.own, {}
    for axis, gains in (("d", found.current_d), ("q", found.current_q)):
        pi[axis] = PiController(
            gains.kp,
            gains.ki,
            loop_period(own),
            rule="trapezoid",
            anti_windup="clamp",
            limit=number(own, f"PID_current_{axis}.limit") or number(own, "voltage_limit"),
            filter_time=set_or_default(own, f"LPF_current_{axis}.Tf"),
        )
    current = CurrentLoops(
        d=pi["d"],
        q=pi["q"],
        delay=1.0,
        cross=number(own, "axis_inductance.q") is not None,
        back_emf=False,
        order="axes",
        voltage_share=_share(own),
        modulation=_MODULATION.get(int(set_or_default(own, "foc_modulation")), "svpwm"),
    )
    return LoopProfile("simplefoc", found.version, current, _speed_loop(found), sources=SOURCES)


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration cannot hold of what was asked."""
    return shortfalls_of(asked, held, profile(held))


def _machine(drive: DriveValues) -> dict[str, Number]:
    if drive.pole_pairs is None or drive.r_s is None or drive.l_d is None or drive.l_q is None:
        raise InputError("machine: SimpleFOC needs pole pairs, resistance and inductances")
    if not drive.psi_pm or drive.psi_pm < 0.0:
        raise InputError(
            "machine.magnet_flux: SimpleFOC makes its KV of the flux of magnets; a machine without "
            "any needs another firmware"
        )
    if drive.v_dc is None or drive.t_s is None:
        raise InputError("inverter.v_dc: SimpleFOC needs the link's voltage; give it")
    return {
        V_DC: as_printed(drive.v_dc),
        LOOP_PERIOD: as_printed(drive.t_s),
        "pole_pairs": drive.pole_pairs,
        "phase_resistance": as_printed(drive.r_s),
        "axis_inductance.d": as_printed(drive.l_d),
        "axis_inductance.q": as_printed(drive.l_q),
        "KV_rating": as_printed(flux_or_kv(drive.pole_pairs, drive.psi_pm)),
    }


def _current(
    axis: str, gains: PiGains, inductance: float | None, drive: DriveValues
) -> dict[str, Number]:
    """Gains of one axis; no filter on its current, whose lag the loop would pay for."""
    assert inductance is not None
    assert drive.t_s is not None
    crossover, most = gains.kp / inductance / (2.0 * math.pi), 0.5 / drive.t_s
    if crossover > most:
        raise InputError(
            f"control.current_loop: {crossover:.4g} Hz of the {axis} axis are more than half of "
            f"the {1.0 / drive.t_s:.4g} Hz of SimpleFOC's loop, which it refuses; ask for at most "
            f"{most:.4g} Hz"
        )
    return {
        f"PID_current_{axis}.P": as_printed(gains.kp),
        f"PID_current_{axis}.I": as_printed(gains.ki),
        f"PID_current_{axis}.D": 0.0,
        f"PID_current_{axis}.output_ramp": 0.0,
        f"LPF_current_{axis}.Tf": 0.0,
    }


def _speed(asked: Asked, gains: PiGains) -> dict[str, Number]:
    drive, settings = asked.drive, asked.design.control.speed_loop
    filter_time = 0.0 if settings is None else settings.filter_time
    if not filter_time:
        filter_time = SPEED_FILTER
        if drive.inertia and drive.pole_pairs and drive.psi_pm:
            constant = torque_per_ampere(drive.pole_pairs, drive.psi_pm)
            filter_time = min(filter_time, _FILTER_SHARE * drive.inertia / (constant * gains.kp))
    ratio = round(drive.t_speed / drive.t_s) if drive.t_speed and drive.t_s else 1
    return {
        "motion_downsample": max(ratio, 1) - 1,
        "PID_velocity.P": as_printed(gains.kp),
        "PID_velocity.I": as_printed(gains.ki),
        "PID_velocity.D": 0.0,
        "PID_velocity.output_ramp": 0.0,
        "LPF_velocity.Tf": as_printed(filter_time),
    }


def _limits(drive: DriveValues, *, with_speed: bool) -> dict[str, Number]:
    if drive.i_max is None:
        raise InputError("machine.max_current: SimpleFOC needs a largest current; give it")
    volts = voltage_limit(as_printed(drive.v_dc or 0.0))
    limits: dict[str, Number] = {
        "current_limit": as_printed(drive.i_max),
        "voltage_limit": volts,
        "PID_current_q.limit": volts,
        "PID_current_d.limit": volts,
    }
    if with_speed:
        limits["PID_velocity.limit"] = as_printed(drive.i_max)
    if drive.omega_m_max is not None:
        limits["velocity_limit"] = as_printed(drive.omega_m_max)
    return limits


def voltage_limit(v_dc: float) -> float:
    """Largest phase voltage in V of space-vector modulation, as it is written."""
    return as_printed(linear_voltage(v_dc))


def _share(own: Mapping[str, OwnValue]) -> float:

    limit, v_dc = number(own, "voltage_limit"), number(own, V_DC)
    if not limit or not v_dc:
        return 1.0
    return min(1.0, as_printed(limit * math.sqrt(3.0) / v_dc))


def _speed_loop(found: Configuration) -> SpeedController | None:
    """The filter runs where the speed is asked for: in move(), with the controller."""
    if found.speed is None:
        return None
    own, period = found.own, speed_period(found.own)
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        period,
        rule="trapezoid",
        anti_windup="clamp",
        limit=number(own, "PID_velocity.limit") or found.drive.i_max,
    )
    feedback = SpeedEstimate("low-pass", period, filter_time=set_or_default(own, "LPF_velocity.Tf"))
    return SpeedController(pi, feedback)


VERSION = "2.4"
BEFORE = f"before {VERSION}"  # Version of files with ``phase_inductance``, one for both axes.
SIGNIFICANT = 6  # Significant digits that are written: a line of the Commander takes 19 characters.

# What the files say beside the members: the link in V and the period of loopFOC() in s.
V_DC, LOOP_PERIOD = "v_dc", "loop_period"
FOC_CURRENT = 2  # torque_controller that controls both currents.

# The library's own values on processors faster than an AVR (src/common/defaults.h), and the period
# of its loop that its documentation names for them.
DEFAULTS: Mapping[str, Number] = {
    "PID_current_q.P": 3.0,
    "PID_current_q.I": 300.0,
    "PID_current_d.P": 3.0,
    "PID_current_d.I": 300.0,
    "LPF_current_q.Tf": 0.005,
    "LPF_current_d.Tf": 0.005,
    "LPF_velocity.Tf": 0.005,
    "PID_velocity.output_ramp": 1000.0,
    "motion_downsample": 0,
    "foc_modulation": 0,
    LOOP_PERIOD: 1e-4,
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, SIGNIFICANT)


def set_or_default(own: Mapping[str, OwnValue], name: str) -> float:
    """A value of the file, or the library's."""
    value = number(own, name)
    return float(DEFAULTS[name]) if value is None else value


def flux_or_kv(pole_pairs: float, kv_rating: float) -> float:
    """Flux linkage in Wb (peak of phase) from rev/min per volt between two terminals (peak):
    psi = 60/(sqrt 3 2 pi p KV) (BLDCMotor.cpp, estimateBEMF). The other way round it is the same.
    """
    return 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * pole_pairs * kv_rating)


# What the members of SimpleFOC's motor amount to in SI units.

CONVENTIONS = (
    "resistance and inductances are those of one phase of the star, currents peak of phase",
    "KV_rating is in rev/min per volt between two terminals (peak): 60/(sqrt 3 2 pi p psi)",
    "the constructor is BLDCMotor(pole pairs, R, KV, L_q, L_d)",
    "PID_velocity commands amperes of q current per rad/s of the shaft",
)


_ASSUMED_PERIOD = (
    f"the period of loopFOC() is not in the file: {1e6 * DEFAULTS[LOOP_PERIOD]:.4g} us, as the "
    f"library's documentation names for fast processors"
)


_LAG = 0.1


def configuration(
    name: str,
    own: Mapping[str, OwnValue],
    origins: Mapping[str, Origin] | None = None,
    remarks: tuple[str, ...] = (),
) -> Configuration:
    """A configuration from the members of the motor.

    Args:
        name: Name of the drive.
        own: The members by their names, the link and the period of the loop.
        origins: Where they stand, by member; none for values that are no file's.
        remarks: Further conventions of the file.
    """
    found = {} if origins is None else origins
    controlled = controls_currents(own)
    assumed = (_ASSUMED_PERIOD,) if own and LOOP_PERIOD not in own else ()
    return Configuration(
        firmware="simplefoc",
        version=BEFORE if "phase_inductance" in own else VERSION,
        name=name,
        drive=_drive(own),
        current_d=_pair(own, "PID_current_d") if controlled else None,
        current_q=_pair(own, "PID_current_q") if controlled else None,
        speed=_simplefoc_format_speed(own) if controlled else None,
        own=dict(own),
        origins=field_origins(found, _FIELDS),
        conventions=(*CONVENTIONS, *assumed, *remarks),
        contradictions=tuple(_contradictions(own)) if controlled else (),
    )


def controls_currents(own: Mapping[str, OwnValue]) -> bool:
    """Whether both currents are controlled; where a file does not say, whether it sets a gain of
    theirs.
    """
    said = number(own, "torque_controller")
    if said is None:
        return any(name.startswith("PID_current") for name in own)
    return said == FOC_CURRENT


def flux_linkage(own: Mapping[str, OwnValue]) -> float | None:
    """Flux linkage of the magnets in Wb; None without pole pairs or KV."""
    pairs, kv_rating = number(own, "pole_pairs"), number(own, "KV_rating")
    return flux_or_kv(pairs, kv_rating) if pairs and kv_rating else None


def loop_period(own: Mapping[str, OwnValue]) -> float:
    """Period of loopFOC() in s."""
    return set_or_default(own, LOOP_PERIOD)


def speed_period(own: Mapping[str, OwnValue]) -> float:
    """Period in s with which the speed controller runs."""
    return (set_or_default(own, "motion_downsample") + 1.0) * loop_period(own)


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs = number(own, "pole_pairs")
    single = number(own, "phase_inductance")
    l_d, l_q = number(own, "axis_inductance.d"), number(own, "axis_inductance.q")
    return DriveValues(
        pole_pairs=None if pairs is None else int(pairs),
        r_s=number(own, "phase_resistance"),
        l_d=single if l_d is None else l_d,
        l_q=single if l_q is None else l_q,
        psi_pm=flux_linkage(own),
        i_max=number(own, "current_limit"),
        omega_m_max=number(own, "velocity_limit"),
        v_dc=number(own, V_DC),
        t_s=loop_period(own),
        t_speed=speed_period(own) if "PID_velocity.P" in own else None,
    )


def _pair(own: Mapping[str, OwnValue], controller: str) -> PiGains:
    return PiGains(set_or_default(own, f"{controller}.P"), set_or_default(own, f"{controller}.I"))


def _simplefoc_format_speed(own: Mapping[str, OwnValue]) -> PiGains | None:
    kp, ki = number(own, "PID_velocity.P"), number(own, "PID_velocity.I")
    return None if kp is None or ki is None else PiGains(kp, ki)


def _contradictions(own: Mapping[str, OwnValue]) -> Iterator[str]:
    """What spoils the current loops: filters, and bandwidths beyond the loop that runs them."""
    for axis in ("d", "q"):
        inductance = number(own, f"axis_inductance.{axis}") or number(own, "phase_inductance")
        gains = _pair(own, f"PID_current_{axis}")
        if not inductance or not gains.kp:
            continue
        crossover, filter_time = (
            gains.kp / inductance,
            set_or_default(own, f"LPF_current_{axis}.Tf"),
        )
        lag = math.atan(crossover * filter_time)
        if lag > _LAG:
            yield (
                f"LPF_current_{axis}.Tf {filter_time:g} s takes {math.degrees(lag):.0f} deg of the "
                f"phase margin at {crossover:.4g} rad/s (PID_current_{axis}.P over L); 0 takes none"
            )
        if crossover > math.pi / loop_period(own):
            yield (
                f"PID_current_{axis}.P {gains.kp:g} is {crossover / (2.0 * math.pi):.4g} Hz times "
                f"L: more than half of the loop's {1.0 / loop_period(own):.4g} Hz"
            )


_FIELDS: Fields = {
    "pole_pairs": ("pole_pairs", "as it is"),
    "r_s": ("phase_resistance", "as it is, Ohm of a phase"),
    "l_d": (("axis_inductance.d", "phase_inductance"), "as it is, H of a phase"),
    "l_q": (("axis_inductance.q", "phase_inductance"), "as it is, H of a phase"),
    "psi_pm": ("KV_rating", "60/(sqrt 3 2 pi pole_pairs KV), Wb (peak of phase)"),
    "i_max": ("current_limit", "as it is, A (peak of phase)"),
    "omega_m_max": ("velocity_limit", "as it is, rad/s (mechanical)"),
    "v_dc": (V_DC, "as it is, V"),
    "t_s": (LOOP_PERIOD, "as it is, s"),
    "t_speed": ("motion_downsample", "one more, times the period of the loop, s"),
    "current_d.kp": ("PID_current_d.P", "as it is, V/A"),
    "current_d.ki": ("PID_current_d.I", "as it is, V/(A s)"),
    "current_q.kp": ("PID_current_q.P", "as it is, V/A"),
    "current_q.ki": ("PID_current_q.I", "as it is, V/(A s)"),
    "speed.kp": ("PID_velocity.P", "as it is, A s/rad"),
    "speed.ki": ("PID_velocity.I", "as it is, A/rad"),
}


# What SimpleFOC's motor cannot hold of a design, and what that costs.


def shortfalls_of(asked: Asked, held: Configuration, runs: LoopProfile) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
        runs: The loops that the library runs with it.
    """
    return (*_currents(asked, held), *_back_emf(asked, runs), *_loop(held), *_filter(asked, runs))


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    psi = held.drive.psi_pm
    if psi is None:
        return
    lead = "SimpleFOC commands no d current"
    tail = ", unless the sketch sets feed_forward_current.d in every loop"
    yield from q_current_alone(asked, psi, lead, tail=tail)


def _back_emf(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    drive = asked.drive
    if runs.current.back_emf or not drive.omega_m_max or not drive.pole_pairs or not drive.psi_pm:
        return
    volts = drive.omega_m_max * drive.pole_pairs * drive.psi_pm
    yield Shortfall(
        f"the integral of the q current holds the whole back-EMF, {volts:.4g} V at the largest "
        f"speed: it is not fed forward with both currents controlled",
        (Price("voltage in the integral", volts, "V"),),
    )


def _loop(held: Configuration) -> Iterator[Shortfall]:
    period = held.drive.t_s
    if period:
        yield Shortfall(
            f"the library measures the period of its loop and holds none: call loopFOC() every "
            f"{1e6 * period:.4g} us from a timer; margins are those of that period"
        )


def _filter(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    if asked.speed is None or runs.speed is None:
        return
    filter_time, drive = runs.speed.feedback.filter_time, asked.drive
    if drive.inertia and drive.pole_pairs and drive.psi_pm and filter_time > 0.0:
        crossover = (
            torque_per_ampere(drive.pole_pairs, drive.psi_pm) * asked.speed.kp / drive.inertia
        )
        lag = math.atan(crossover * filter_time)
        yield Shortfall(
            f"the measured speed is filtered over {1e3 * filter_time:.3g} ms (LPF_velocity.Tf), "
            f"which takes {math.degrees(lag):.1f} deg at {crossover:.4g} rad/s",
            (Price("phase margin of the speed loop", lag, "rad"),),
        )


SIMPLEFOC = FirmwareMethod("simplefoc", VERSION, "axes", configure, profile, shortfalls)


# The members of SimpleFOC's BLDCMotor that a design decides, and the library's defaults.


@dataclass(frozen=True, slots=True)
class Member:
    """One member of BLDCMotor: its name, its line of the Commander without the motor's letter
    (empty where it has none), and what it means with its unit.
    """

    name: str
    command: str
    says: str
    whole: bool = False


# fmt: off
MEMBERS = {member.name: member for member in (
    Member("pole_pairs", "", "pole pairs", whole=True),
    Member("phase_resistance", "R", "resistance of a phase of the star, Ohm"),
    Member("axis_inductance.d", "ID", "L_d of a phase, H; set, it switches the decoupling on"),
    Member("axis_inductance.q", "IQ", "L_q of a phase, H"),
    Member("KV_rating", "K", "rev/min per volt between two terminals (peak)"),
    Member("foc_modulation", "WT", "1: space-vector modulation", whole=True),
    Member("torque_controller", "T", "2: both currents are controlled", whole=True),
    Member("controller", "C", "0: current is commanded, 1: speed", whole=True),
    Member("motion_downsample", "CD", "the speed controller leaves out so many loops", whole=True),
    Member("PID_current_q.P", "QP", "V/A"),
    Member("PID_current_q.I", "QI", "V/(A s)"),
    Member("PID_current_q.D", "QD", "V s/A"),
    Member("PID_current_q.output_ramp", "QR", "V/s, 0: none"),
    Member("LPF_current_q.Tf", "QF", "time constant of the filter on the current, s"),
    Member("PID_current_d.P", "DP", "V/A"),
    Member("PID_current_d.I", "DI", "V/(A s)"),
    Member("PID_current_d.D", "DD", "V s/A"),
    Member("PID_current_d.output_ramp", "DR", "V/s, 0: none"),
    Member("LPF_current_d.Tf", "DF", "time constant of the filter on the current, s"),
    Member("PID_velocity.P", "VP", "A s/rad"),
    Member("PID_velocity.I", "VI", "A/rad"),
    Member("PID_velocity.D", "VD", "A s^2/rad"),
    Member("PID_velocity.output_ramp", "VR", "A/s, 0: none"),
    Member("LPF_velocity.Tf", "VF", "time constant of the filter on the speed, s"),
    Member("velocity_limit", "LV", "rad/s"),
    Member("current_limit", "LC", "A (peak of phase)"),
    Member("voltage_limit", "LU", "V (peak of phase)"),
    Member("PID_current_q.limit", "QL", "V"),
    Member("PID_current_d.limit", "DL", "V"),
    Member("PID_velocity.limit", "VL", "A"),
)}
# fmt: on

"""In the order in which they are written; limits behind what changes them."""
