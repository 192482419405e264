"""What the parameters of Infineon's motor-ctrl-lib amount to in SI units, by its own rules where
they give no gains.
"""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.field_origins import field_origins
from dqforge.optimizer.firmware.infineon_format.infineon_contradictions import contradictions
from dqforge.optimizer.firmware.infineon_format.infineon_keys import VERSION, number

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
    per_torque = 1.0 / (1.5 * pole_pairs * psi_pm)
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
    "pole_pairs": (("motor.P",), "half of it"),
    "r_s": (("motor.r",), "as it is, ohm of a phase"),
    "l_d": (("motor.ld",), "as it is, H of a phase"),
    "l_q": (("motor.lq",), "as it is, H of a phase"),
    "psi_pm": (("motor.lam",), "as it is, Wb (peak of phase)"),
    "inertia": (("mech.inertia",), "as it is, kg m^2"),
    "viscous": (("mech.viscous",), "as it is, N m s/rad"),
    "i_max": (("motor.i_peak",), "as it is, A (peak of phase)"),
    "omega_m_max": (("motor.w_max.elec",), "over pole pairs, rad/s (mechanical)"),
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
