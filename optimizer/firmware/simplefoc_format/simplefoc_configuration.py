"""What the members of SimpleFOC's motor amount to in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.field_origins import Fields, field_origins
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.simplefoc_format.simplefoc_keys import (
    BEFORE,
    DEFAULTS,
    FOC_CURRENT,
    LOOP_PERIOD,
    V_DC,
    VERSION,
    flux_or_kv,
    set_or_default,
)

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
        speed=_speed(own) if controlled else None,
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


def _speed(own: Mapping[str, OwnValue]) -> PiGains | None:
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
