"""The members of ``params`` of Infineon's motor-ctrl-lib that a design decides, or that its loops
depend on.

Names and units are those of ``Params.h`` and ``ParamsDefault.c`` of the library's release 4.5
(Infineon/REF_MTR_48V30A_GaN); its text is not used.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised, torque_per_ampere
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.firmware import firmware_method
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.firmware_method import (
    FLOAT32_DIGITS,
    NOTICED,
    Asked,
    Price,
    Shortfall,
    closed_form_currents,
    field_origins,
    float32_value,
    other_periods,
    rounded,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents

FIRMWARE = "Infineon's library"  # Its name in messages.
VERSION = "motor-ctrl-lib 4.5"
TABLE_POINTS = 128  # Points of a table of the library (LUT_1D_WIDTH).
TABLE = "params.motor.mtpa_lut.y"

# A float, a float that is whole, an unsigned integer, an enumerator.
Kind = Literal["real", "poles", "count", "word"]

# Where it is assigned: in every build, in builds with rotor frame orientation only, or there but
# after the library has worked out its gains.
Place = Literal["any", "rotor", "gains"]


@dataclass(frozen=True, slots=True)
class Key:
    """One member: its name, its kind, its unit, what it means, and where it is assigned; ``start``
    marks rules for starting the motor.
    """

    name: str
    kind: Kind
    unit: str
    says: str
    place: Place = "any"
    start: bool = False


# fmt: off
_KEYS = (
    Key("motor.P", "poles", "", "poles: twice the pole pairs"),
    Key("motor.lq", "real", "H", "inductance of a phase, q axis"),
    Key("motor.ld", "real", "H", "inductance of a phase, d axis"),
    Key("motor.lam", "real", "Wb", "flux linkage of the magnets, peak of phase"),
    Key("motor.r", "real", "Ohm", "resistance of a phase"),
    Key("motor.T_max", "real", "N m", "largest torque"),
    Key("motor.i_peak", "real", "A", "largest current, peak of phase"),
    Key("motor.i_cont", "real", "A", "continuous current: the same, as the design has one limit"),
    Key("motor.id_max", "real", "A", "largest current against the magnets: the same"),
    Key("motor.v_nom", "real", "V", "peak phase voltage: that of the dc link over sqrt(3)"),
    Key("motor.w_nom.elec", "real", "rad/s", "speed at which the back-EMF takes it"),
    Key("motor.w_max.elec", "real", "rad/s", "largest electrical speed"),
    Key("sys.samp.fs0", "real", "Hz", "frequency of the control"),
    Key("sys.samp.fpwm_fs0_ratio", "count", "", "PWM periods per control step"),
    Key("sys.analog.filt.w0_i_ph", "real", "rad/s", "filter of the currents: none at fs0"),
    Key("sys.analog.filt.w0_v_ph", "real", "rad/s", "filter of the voltages: the same"),
    Key("sys.analog.shunt.res", "real", "Ohm", "resistance of a shunt"),
    Key("sys.vdc_nom", "real", "V", "voltage of the dc link"),
    Key("sys.cmd.w_max.mech", "real", "rad/s", "full scale of the speed command"),
    Key("sys.cmd.i_max", "real", "A", "full scale of the current command", "rotor"),
    Key("sys.rate_lim.i_cmd", "real", "A/s", "slope of the current: in one step", "rotor"),
    Key("sys.rate_lim.w_cmd.elec", "real", "rad/s^2", "slope of the speed", start=True),
    Key("mech.inertia", "real", "kg m^2", "moment of inertia"),
    Key("mech.viscous", "real", "N m s/rad", "viscous friction"),
    Key("mech.friction", "real", "N m", "dry friction: the design knows none"),
    Key("obs.pll.w0", "real", "rad/s", "phase-locked loop for angle and speed"),
    Key("obs.pll.w_max.elec", "real", "rad/s", "its largest speed: 150 % of the largest"),
    Key("obs.w_thresh.elec", "real", "rad/s", "least of the observer: 10 % of w_nom", start=True),
    Key("obs.w_hyst.elec", "real", "rad/s", "its hysteresis", start=True),
    Key("filt.spd_ar_en", "word", "", "no filter on the speed"),
    Key("ctrl.speed.bw", "real", "rad/s", "bandwidth of the speed controller"),
    Key("ctrl.curr.bw", "real", "rad/s", "bandwidth of the current controllers", "rotor"),
    Key("ctrl.curr.ff_coef", "real", "", "back-EMF and cross terms are fed forward", "rotor"),
    Key("ctrl.curr.i_cmd_thresh", "real", "A", "least: 20 % of i_cont", "rotor", start=True),
    Key("ctrl.curr.i_cmd_hyst", "real", "A", "its hysteresis", "rotor", start=True),
    Key("ctrl.flux_weaken.bw", "real", "rad/s", "field weakening: a fifth of it", "rotor"),
    Key("ctrl.volt.w_thresh.elec", "real", "rad/s", "least speed of V/f: 1 % of w_nom", start=True),
    Key("ctrl.volt.w_hyst.elec", "real", "rad/s", "its hysteresis", start=True),
    Key("ctrl.align.voltage", "real", "V", "voltage that aligns: half of r i_cont", start=True),
    Key("ctrl.six_pulse_inj.i_peak", "real", "A", "pulses that find the rotor: 50 %", start=True),
    Key("ctrl.high_freq_inj.i_qd_r_peak.d", "real", "A", "injected d current: 20 %", start=True),
    Key("obs.pll.kp", "real", "rad/s/Wb", "proportional gain of the loop over lam", "gains"),
    Key("obs.pll.ki", "real", "rad/s^2/Wb", "integral gain of the loop over lam", "gains"),
    Key("ctrl.curr.kp.q", "real", "V/A", "proportional gain, q current", "gains"),
    Key("ctrl.curr.kp.d", "real", "V/A", "proportional gain, d current", "gains"),
    Key("ctrl.curr.ki.q", "real", "V/(A s)", "integral gain, q current", "gains"),
    Key("ctrl.curr.ki.d", "real", "V/(A s)", "integral gain, d current", "gains"),
    Key("ctrl.speed.kp", "real", "A s/rad", "proportional gain, per electrical speed", "gains"),
    Key("ctrl.speed.ki", "real", "A/rad", "integral gain, per electrical speed", "gains"),
)
# fmt: on

# What `configure` writes, by the name of the member, in the order of the file.
KEYS: Mapping[str, Key] = {
    f"params.{key.name}": Key(
        f"params.{key.name}", key.kind, key.unit, key.says, key.place, key.start
    )
    for key in _KEYS
}

TABLE_KEYS: Mapping[str, Key] = {
    f"params.motor.mtpa_lut.{name}": Key(name, "real", unit, says)
    for name, unit, says in (
        ("x_min", "N m", "torque of the first point"),
        ("x_max", "N m", "torque of the last point"),
        ("x_step", "N m", "between two points"),
        ("x_step_inv", "1/(N m)", "one over that"),
    )
}

# Members that are read beside those, as the loops depend on them.
READ_ONLY: Mapping[str, Key] = {
    f"params.filt.spd_ar_w{kind}[{index}]": Key(f"spd_ar_w{kind}", "real", "rad/s", what)
    for kind, what in (("p", "pole"), ("z", "zero"))
    for index in (0, 1)
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, FLOAT32_DIGITS)


def kept(value: float, asked_by: str) -> float:
    """A value as the file holds it; raises InputError, naming the key of the design, where a
    float32 cannot.
    """
    return float32_value(value, asked_by, FIRMWARE)


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A member (``motor.r``) as a number, None without one."""
    return firmware_method.number(own, f"params.{name}")


# What the parameters of Infineon's motor-ctrl-lib amount to in SI units, by its own rules where
# they give no gains.

CONVENTIONS = (
    "P counts poles, not pairs",
    "r, ld, lq and lam are those of one phase of the star, lam and currents are peak values",
    "members ending in .elec are electrical, in .mech mechanical, both in rad/s",
    "the library works out kp = bw L and ki = bw r; members kp and ki given after that count",
    "gains of the speed controller are amperes per electrical rad/s",
    "loops are those of the build with rotor frame orientation (CTRL_METHOD_RFO)",
)


def current_rule(r_s: float, inductance: float, bandwidth: float) -> PiGains:
    """The library's gains of a current controller.

    Args:
        r_s, inductance: Resistance in ohm and inductance in H of a phase.
        bandwidth: In rad/s.
    """
    return PiGains(bandwidth * inductance, bandwidth * r_s)


def speed_rule(
    pole_pairs: int, psi_pm: float, inertia: float, viscous: float, bandwidth: float
) -> PiGains:
    """The library's gains of the speed controller, (8/3)/(P^2 lam) J bw and (8/3)/(P^2 lam) B bw,
    brought to mechanical speed: A s/rad and A/rad.

    Args:
        pole_pairs, psi_pm: Pole pairs, flux linkage in Wb.
        inertia, viscous: Inertia in kg m^2 and viscous friction in N m s/rad.
        bandwidth: In rad/s.
    """
    per_torque = 1.0 / torque_per_ampere(pole_pairs, psi_pm)
    return PiGains(per_torque * inertia * bandwidth, per_torque * viscous * bandwidth)


def configuration(
    name: str,
    own: Mapping[str, OwnValue],
    origins: Mapping[str, Origin] | None = None,
) -> Configuration:
    """A configuration from members of ``params``.

    Args:
        name: What it is the configuration of.
        own: Values by member.
        origins: Where they stand, by member; None where no file was read.
    """
    drive = _drive(own)
    d, q = (_current(own, drive, axis) for axis in ("d", "q"))
    speed = _speed(own, drive)
    return Configuration(
        firmware="infineon",
        version=VERSION,
        name=name,
        drive=drive,
        current_d=d,
        current_q=q,
        speed=speed,
        own=dict(own),
        origins={} if origins is None else _origins(origins),
        conventions=CONVENTIONS,
        contradictions=contradictions(own, drive, q, speed),
    )


def _positive(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A member as a number, None where it is missing or no magnitude."""
    value = number(own, name)
    return value if value is not None and value > 0.0 else None


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    poles, most = number(own, "motor.P"), _positive(own, "motor.w_max.elec")
    pairs = None if not poles or poles % 2 else int(poles) // 2
    rate = _positive(own, "sys.samp.fs0")
    ratio = number(own, "sys.samp.fpwm_fs0_ratio") or 1.0
    t_s = None if not rate else 1.0 / rate
    return DriveValues(
        pole_pairs=pairs,
        r_s=_positive(own, "motor.r"),
        l_d=_positive(own, "motor.ld"),
        l_q=_positive(own, "motor.lq"),
        psi_pm=_positive(own, "motor.lam"),
        inertia=_positive(own, "mech.inertia"),
        viscous=number(own, "mech.viscous"),
        i_max=_positive(own, "motor.i_peak"),
        omega_m_max=None if most is None or pairs is None else most / pairs,
        v_dc=_positive(own, "sys.vdc_nom"),
        f_sw=None if not rate else rate * ratio,
        t_s=t_s,
        t_speed=t_s,
    )


def _current(own: Mapping[str, OwnValue], drive: DriveValues, axis: str) -> PiGains | None:
    """Gains as given, else by the library's rule."""
    bandwidth = number(own, "ctrl.curr.bw")
    inductance = drive.l_d if axis == "d" else drive.l_q
    rule = None
    if bandwidth and inductance and drive.r_s is not None:
        rule = current_rule(drive.r_s, inductance, bandwidth)
    return _given(own, f"ctrl.curr.kp.{axis}", f"ctrl.curr.ki.{axis}", 1.0, rule)


def _speed(own: Mapping[str, OwnValue], drive: DriveValues) -> PiGains | None:
    bandwidth, rule = number(own, "ctrl.speed.bw"), None
    if drive.pole_pairs is None:
        return None
    if bandwidth and drive.psi_pm and drive.inertia:
        rule = speed_rule(
            drive.pole_pairs, drive.psi_pm, drive.inertia, drive.viscous or 0.0, bandwidth
        )
    return _given(own, "ctrl.speed.kp", "ctrl.speed.ki", drive.pole_pairs, rule)


def _given(
    own: Mapping[str, OwnValue], kp: str, ki: str, scale: float, rule: PiGains | None
) -> PiGains | None:
    proportional, integral = number(own, kp), number(own, ki)
    if rule is None and (proportional is None or integral is None):
        return None
    return PiGains(
        rule.kp if proportional is None and rule is not None else (proportional or 0.0) * scale,
        rule.ki if integral is None and rule is not None else (integral or 0.0) * scale,
    )


_FIELDS = {
    "pole_pairs": (("motor.P",), "twice the pole pairs"),
    "r_s": (("motor.r",), "as it is, ohm of a phase"),
    "l_d": (("motor.ld",), "as it is, H of a phase"),
    "l_q": (("motor.lq",), "as it is, H of a phase"),
    "psi_pm": (("motor.lam",), "as it is, Wb (peak of phase)"),
    "inertia": (("mech.inertia",), "as it is, kg m^2"),
    "viscous": (("mech.viscous",), "as it is, N m s/rad"),
    "i_max": (("motor.i_peak",), "as it is, A (peak of phase)"),
    "omega_m_max": (("motor.w_max.elec",), "pole pairs times the speed, rad/s (electrical)"),
    "v_dc": (("sys.vdc_nom",), "as it is, V"),
    "f_sw": (("sys.samp.fs0",), "times fpwm_fs0_ratio, Hz"),
    "t_s": (("sys.samp.fs0",), "one over it, s"),
    "t_speed": (("sys.samp.fs0",), "one over it, s"),
    "current_d.kp": (("ctrl.curr.kp.d", "ctrl.curr.bw"), "kp, or bw times ld, V/A"),
    "current_d.ki": (("ctrl.curr.ki.d", "ctrl.curr.bw"), "ki, or bw times r, V/(A s)"),
    "current_q.kp": (("ctrl.curr.kp.q", "ctrl.curr.bw"), "kp, or bw times lq, V/A"),
    "current_q.ki": (("ctrl.curr.ki.q", "ctrl.curr.bw"), "ki, or bw times r, V/(A s)"),
    "speed.kp": (("ctrl.speed.kp", "ctrl.speed.bw"), "times pole pairs, A s/rad"),
    "speed.ki": (("ctrl.speed.ki", "ctrl.speed.bw"), "times pole pairs, A/rad"),
    "pll.kp": (("obs.pll.kp", "obs.pll.w0"), "kp times the flux linkage, or w0, 1/s"),
    "pll.ki": (("obs.pll.ki", "obs.pll.w0"), "ki times the flux linkage, or w0^2/2, 1/s^2"),
}


def _origins(found: Mapping[str, Origin]) -> dict[str, Origin]:
    fields = {
        field: (tuple(f"params.{key}" for key in keys), conversion)
        for field, (keys, conversion) in _FIELDS.items()
    }
    return field_origins(found, fields)


# What in parameters of Infineon's motor-ctrl-lib does not fit together, and what is dangerous.

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
        *_contradicted_speed(own, speed),
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
        yield f"motor.P {poles:g} is not a number of poles, which come in pairs"


def _voltages(own: Mapping[str, OwnValue], drive: DriveValues) -> Iterator[str]:
    most, v_dc = number(own, "motor.w_max.elec"), drive.v_dc
    if most and v_dc and drive.psi_pm:
        emf, available = most * drive.psi_pm, linear_voltage(v_dc)
        if emf > available:
            yield (
                f"at w_max {most:.4g} rad/s the magnets of lam {drive.psi_pm:g} Wb induce "
                f"{emf:.4g} V (peak of phase), vdc_nom {v_dc:g} V gives {available:.4g} V: without "
                f"field weakening the speed ends at {available / drive.psi_pm:.4g} rad/s"
            )
    nominal = number(own, "motor.v_nom")
    if nominal and v_dc and nominal > linear_voltage(v_dc) * (1.0 + TOLERANCE):
        yield (
            f"v_nom {nominal:.4g} V (peak of phase) is above vdc_nom/sqrt(3) = "
            f"{linear_voltage(v_dc):.4g} V"
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


def _contradicted_speed(own: Mapping[str, OwnValue], speed: PiGains | None) -> Iterator[str]:
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


# What parameters of Infineon's motor-ctrl-lib cannot hold of a design, and what that costs.


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the parameters do not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    return (
        *_rule_of_currents(held),
        *_rule_of_speed(asked, held),
        *_currents(asked, held),
        *other_periods(asked, held, "the library"),
        *_table(asked, held),
    )


def _rule_of_currents(held: Configuration) -> Iterator[Shortfall]:
    """What the library makes of the bandwidth where the gains are not assigned after it."""
    drive, gains, bandwidth = held.drive, held.current_q, number(held.own, "ctrl.curr.bw")
    if gains is None or not bandwidth or not drive.l_q or drive.r_s is None:
        return
    rule = current_rule(drive.r_s, drive.l_q, bandwidth)
    if math.isclose(rule.ki, gains.ki, rel_tol=NOTICED):
        return
    yield Shortfall(
        f"the library's own integral gain is bw r = {rule.ki:.4g} V/(A s); the "
        f"{gains.ki:.4g} V/(A s) requested hold only where the second function is called after "
        f"PARAMS_InitAutoCalc",
        _off("q integral gain of the library's own rule", rule.ki, gains.ki),
    )


def _off(of: str, its: float, wished: float) -> tuple[Price, ...]:
    """Share by which a gain differs; no price where none was asked for."""
    return (Price(of, its / wished - 1.0, ""),) if wished else ()


def _rule_of_speed(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive, bandwidth = held.drive, number(held.own, "ctrl.speed.bw")
    if asked.speed is None or not bandwidth or not drive.pole_pairs:
        return
    if not drive.psi_pm or not drive.inertia:
        return
    viscous = drive.viscous or 0.0
    rule = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, viscous, bandwidth)
    if math.isclose(rule.ki, asked.speed.ki, rel_tol=NOTICED):
        return
    yield Shortfall(
        f"the library's own integral gain of the speed is viscous friction times bw = "
        f"{rule.ki:.4g} A/rad instead of {asked.speed.ki:.4g} A/rad: without the second function "
        f"the speed sinks by {1.0 / max(rule.kp, 1e-30):.3g} rad/s per ampere of load",
        _off("integral gain of the speed by the library's own rule", rule.ki, asked.speed.ki),
    )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = held.drive
    saliency = (drive.l_q or 0.0) - (drive.l_d or 0.0)
    lead = "with rotor frame orientation the currents of most torque per ampere"
    tail = "; with stator frame orientation the table mtpa_lut holds them"
    return closed_form_currents(asked, held, saliency, lead, tail=tail)


def _table(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    if TABLE not in held.own:
        return
    table = flux_table(asked.design)
    most = float(table.flux[-1])
    words = (
        f"the {TABLE_POINTS} points of mtpa_lut, joined by lines, are off by at most "
        f"{table.error:.2g} Wb ({100.0 * table.error / most:.2g} % of the largest flux linkage)"
    )
    prices = [Price("flux linkage", table.error, "Wb")]
    if table.of_constants > max(NOTICED * most, table.error):
        words += (
            f"; those that the library works out of constant ld and lq by "
            f"{100.0 * table.of_constants / most:.2g} %"
        )
        prices.append(Price("flux linkage of the library's own table", table.of_constants, "Wb"))
    yield Shortfall(words, tuple(prices))


# Flux linkage over torque for the build with stator frame orientation: the table that motor-ctrl-
# lib joins by lines, from the machine as it is instead of a constant ratio of inductances.

_BETWEEN = 8


@dataclass(frozen=True, slots=True, eq=False)
class FluxTable:
    """Stator flux linkage over torque.

    Args:
        most: Torque in N m of the last point; the first is at 0.
        flux: In Wb at even steps, shape (TABLE_POINTS,), rounded as printed.
        error: Largest deviation in Wb of the lines between them from the machine's own.
        of_constants: Largest deviation in Wb of what constant inductances give, as the library
            works it out.
    """

    most: float
    flux: FloatArray
    error: float
    of_constants: float


def largest_torque(design: Design) -> float:
    """Largest torque in N m within the current limit, by the design's strategy."""
    return CurrentChoice(design.machine, design.strategy, design.i_max).largest_torque()


def flux_table(design: Design) -> FluxTable:
    """The table for a design, whose machine may saturate.

    Its lines are shifted by half of what they miss between the points, which halves their error.

    Args:
        design: The design.
    """
    most = as_printed(largest_torque(design))
    choice = CurrentChoice(design.machine, design.strategy, design.i_max)
    torque = np.linspace(0.0, most, (TABLE_POINTS - 1) * _BETWEEN + 1)
    i_d, i_q = choice.currents(torque)
    exact = np.hypot(*design.machine.flux(i_d, i_q))
    points = exact[::_BETWEEN].copy()
    missed = exact - np.interp(torque, torque[::_BETWEEN], points)
    inside = missed[:-1].reshape(TABLE_POINTS - 1, _BETWEEN)
    middle = 0.5 * (np.max(inside, axis=1) + np.min(inside, axis=1))
    points[1:-1] += 0.5 * (middle[:-1] + middle[1:])
    flux = np.array([as_printed(float(value)) for value in points])
    error = np.max(np.abs(exact - np.interp(torque, torque[::_BETWEEN], flux)))
    constant = _of_constants(design, torque)
    return FluxTable(most, flux, float(error), float(np.max(np.abs(exact - constant))))


def _of_constants(design: Design, torque: FloatArray) -> FloatArray:
    """Flux linkage in Wb over torque in N m, shape (N,), with the inductances at zero current."""
    linear = linearised(design.machine)
    return np.hypot(*linear.flux(*mtpa_currents(linear, torque)))
