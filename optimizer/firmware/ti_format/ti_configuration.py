"""What the macros of a motor of TI's universal lab amount to in SI units: machine, and the gains
that its ``setupControllers`` makes of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.field_origins import field_origins
from dqforge.optimizer.firmware.ti_format.ti_contradictions import contradictions
from dqforge.optimizer.firmware.ti_format.ti_keys import (
    INSTASPIN,
    OLDER_LAB,
    VERSION,
    known,
    number,
)

TWO_PI = 2.0 * math.pi

# Share of R/L that ``setupControllers`` takes as the integral gain of the series form.
INTEGRAL_SHARE = 0.25
SPEED_TICKS = 10  # Control steps per step of the speed controller where the file does not say.

CONVENTIONS = (
    "the unit of a value stands in the name of its macro",
    "resistance and inductances are those of one phase of the star, currents are peak values",
    "RATED_FLUX_VpHz is 2 pi times the flux linkage of the magnets (peak of phase)",
    "frequencies are electrical: pole pairs times mechanical ones",
    "the firmware works out its gains: kp = BWc L, integral gain of the series form R/L Ts/4",
    "its speed controller takes Hz, its gain is meant for rad/s: it is p/(2 pi) times as fast",
    "KP_..._SF and KI_..._SF multiply these gains where MOTOR1_PI_TUNE is defined",
)


@dataclass(frozen=True, slots=True)
class Bandwidths:
    """What ``USER_setMotor1Params`` has as constants: crossover in rad/s, and the ratio by which
    the speed loop is slower.
    """

    current: float
    delta: float


BANDWIDTHS = {
    VERSION: Bandwidths(TWO_PI * 200.0, 20.0),
    OLDER_LAB: Bandwidths(TWO_PI * 400.0, 10.0),
}


def current_rule(r_s: float, inductance: float, bandwidth: float) -> PiGains:
    """TI's gains of a current controller, of the parallel form.

    Args:
        r_s, inductance: Resistance in ohm and inductance in H of a phase.
        bandwidth: BWc in rad/s.
    """
    kp = bandwidth * inductance
    return PiGains(kp, kp * INTEGRAL_SHARE * r_s / inductance)


def speed_rule(pole_pairs: int, psi_pm: float, inertia: float, bandwidths: Bandwidths) -> PiGains:
    """TI's gains of the speed controller as they act: in A s/rad and A/rad (mechanical).

    The rule makes a gain per rad/s, the controller is given electrical Hz.

    Args:
        pole_pairs, psi_pm, inertia: Pole pairs, flux linkage in Wb, inertia in kg m^2.
        bandwidths: The constants of the firmware.
    """
    acceleration = 1.5 * pole_pairs * psi_pm / inertia
    per_hertz = bandwidths.current / (bandwidths.delta * acceleration)
    kp = per_hertz * pole_pairs / TWO_PI
    return PiGains(kp, kp * bandwidths.current / bandwidths.delta**2)


def scaled(rule: PiGains, kp: float, ki: float) -> PiGains:
    """Gains of the series form with other factors: that of kp multiplies the integral, too."""
    return PiGains(rule.kp * kp, rule.ki * kp * ki)


def configuration(
    name: str,
    own: Mapping[str, OwnValue],
    origins: Mapping[str, Origin] | None = None,
    version: str = VERSION,
) -> Configuration:
    """A configuration from the macros of a motor.

    Args:
        name: Name of the motor.
        own: Values by macro, of those of `ti_keys`.
        origins: Where they stand, by macro; None where no file was read.
        version: Of the lab: its constants differ.
    """
    drive, bandwidths = _drive(own), BANDWIDTHS.get(version)
    d = q = speed = None
    if bandwidths is not None and drive.r_s is not None:
        if drive.l_d:
            d = _scaled(current_rule(drive.r_s, drive.l_d, bandwidths.current), own, "ID_", version)
        if drive.l_q:
            rule = current_rule(drive.r_s, drive.l_q, bandwidths.current)
            q = _scaled(rule, own, "IQ_HIGH_", version)
    if bandwidths is not None and drive.pole_pairs and drive.psi_pm and drive.inertia:
        rule = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, bandwidths)
        speed = _scaled(rule, own, "SPD_HIGH_", version)
    return Configuration(
        firmware="ti",
        version=version,
        name=name,
        drive=drive,
        current_d=d,
        current_q=q,
        speed=speed,
        own=dict(own),
        origins={} if origins is None else _origins(origins, version),
        conventions=CONVENTIONS if version == VERSION else CONVENTIONS[:-1],
        contradictions=contradictions(name, own, drive),
    )


def _scaled(rule: PiGains, own: Mapping[str, OwnValue], which: str, version: str) -> PiGains:
    if version != VERSION:
        return rule
    return scaled(rule, known(own, f"KP_{which}SF", 1.0), known(own, f"KI_{which}SF", 1.0))


def _positive(value: float | None) -> float | None:
    """None where a macro holds a stand-in such as 0 for what was not identified."""
    return value if value is not None and value > 0.0 else None


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs = number(own, "NUM_POLE_PAIRS")
    flux = _positive(number(own, "RATED_FLUX_VpHz"))
    most = _positive(number(own, "FREQ_MAX_Hz"))
    pwm = _positive(number(own, "M1_PWM_FREQ_kHz"))
    ticks = known(own, "M1_NUM_PWM_TICKS_PER_ISR_TICK", 1)
    steps = known(own, "M1_NUM_ISR_TICKS_PER_SPEED_TICK", SPEED_TICKS)
    t_s = ticks / (1e3 * pwm) if pwm is not None and ticks >= 1 else None
    t_speed = t_s * steps if t_s is not None and steps >= 1 else None
    return DriveValues(
        pole_pairs=None if not pairs else int(pairs),
        r_s=_positive(number(own, "Rs_Ohm")),
        l_d=_positive(number(own, "Ls_d_H")),
        l_q=_positive(number(own, "Ls_q_H")),
        psi_pm=None if flux is None else flux / TWO_PI,
        inertia=_positive(number(own, "INERTIA_Kgm2")),
        i_max=_positive(number(own, "MAX_CURRENT_A")),
        omega_m_max=None if not pairs or not most else TWO_PI * most / pairs,
        v_dc=_positive(number(own, "M1_NOMINAL_DC_BUS_VOLTAGE_V")),
        f_sw=None if pwm is None else 1e3 * pwm,
        t_s=t_s,
        t_speed=t_speed,
    )


_FIELDS = {
    "pole_pairs": ("USER_MOTOR1_NUM_POLE_PAIRS", "as it is"),
    "r_s": ("USER_MOTOR1_Rs_Ohm", "as it is, ohm of a phase"),
    "l_d": ("USER_MOTOR1_Ls_d_H", "as it is, H of a phase"),
    "l_q": ("USER_MOTOR1_Ls_q_H", "as it is, H of a phase"),
    "psi_pm": ("USER_MOTOR1_RATED_FLUX_VpHz", "over 2 pi, Wb (peak of phase)"),
    "inertia": ("USER_MOTOR1_INERTIA_Kgm2", "as it is, kg m^2"),
    "i_max": ("USER_MOTOR1_MAX_CURRENT_A", "as it is, A (peak of phase)"),
    "omega_m_max": ("USER_MOTOR1_FREQ_MAX_Hz", "times 2 pi over pole pairs, rad/s (mechanical)"),
    "v_dc": ("USER_M1_NOMINAL_DC_BUS_VOLTAGE_V", "as it is, V"),
    "f_sw": ("USER_M1_PWM_FREQ_kHz", "times 1000, Hz"),
    "t_s": ("USER_M1_PWM_FREQ_kHz", "PWM periods per control step, s"),
    "t_speed": ("USER_M1_NUM_ISR_TICKS_PER_SPEED_TICK", "control steps, s"),
}

_OF_GAINS = {
    "current_d.kp": ("USER_MOTOR1_Ls_d_H", "times BWc and KP_ID_SF, V/A"),
    "current_d.ki": ("USER_MOTOR1_Rs_Ohm", "times BWc/4, KP_ID_SF and KI_ID_SF, V/(A s)"),
    "current_q.kp": ("USER_MOTOR1_Ls_q_H", "times BWc and KP_IQ_HIGH_SF, V/A"),
    "current_q.ki": ("USER_MOTOR1_Rs_Ohm", "times BWc/4 and both factors, V/(A s)"),
    "speed.kp": ("USER_MOTOR1_INERTIA_Kgm2", "BWc/(delta Kctrl) p/(2 pi) KP_SPD_HIGH_SF, A s/rad"),
    "speed.ki": ("USER_MOTOR1_INERTIA_Kgm2", "the same times BWc/delta^2 KI_SPD_HIGH_SF, A/rad"),
}


def _origins(found: Mapping[str, Origin], version: str) -> dict[str, Origin]:
    return field_origins(found, _FIELDS if version == INSTASPIN else _FIELDS | _OF_GAINS)
