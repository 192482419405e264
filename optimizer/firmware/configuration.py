"""What a configuration of another firmware amounts to: machine, gains and limits in SI units, as
that firmware computes with them.

Amplitude-invariant dq quantities (peak of phase), resistances and inductances per phase of the
star. Readers make a `Configuration` of a file, methods make one of a design; files are written
from it. Its numbers are those that the file can hold, already rounded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.names import Firmware

Number = float | int
OwnValue = Number | str


@dataclass(frozen=True, slots=True)
class DriveValues:
    """Machine, inverter and timing as a firmware is told them; None where a file does not say.

    Args:
        pole_pairs: Number of pole pairs.
        r_s, l_d, l_q, psi_pm: Resistance in ohm, inductances in H and magnet flux linkage in Wb of
            one phase.
        inertia, viscous: Inertia in kg m^2 and viscous friction in N m s/rad.
        i_max, omega_m_max: Limits: current in A (peak of phase) and mechanical speed in rad/s.
        v_dc, f_sw, dead_time: Of the inverter, in V, Hz and s.
        t_s, t_speed: Periods in s with which the current and the speed controller run.
        shunt, sense_gain, sense_reference: Of the current measurement, in Ohm, V/V and V, where a
            firmware counts in integers.
    """

    pole_pairs: int | None = None
    r_s: float | None = None
    l_d: float | None = None
    l_q: float | None = None
    psi_pm: float | None = None
    inertia: float | None = None
    viscous: float | None = None
    i_max: float | None = None
    omega_m_max: float | None = None
    v_dc: float | None = None
    f_sw: float | None = None
    dead_time: float | None = None
    t_s: float | None = None
    t_speed: float | None = None
    shunt: float | None = None
    sense_gain: float | None = None
    sense_reference: float | None = None


@dataclass(frozen=True, slots=True)
class PiGains:
    """Gains of the parallel form, per second: V/A and V/(A s) of a current loop; A s/rad and A/rad
    (q current per mechanical speed) of a speed loop.
    """

    kp: float
    ki: float


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a value stands in a file: its key there, the text as printed, the line (from 1), and
    how it was converted.
    """

    key: str
    text: str
    line: int | None = None
    conversion: str = ""


@dataclass(frozen=True, slots=True)
class Configuration:
    """One configuration of a firmware.

    Args:
        firmware, version: Whose it is, and the version of its format.
        drive: Machine, inverter and timing.
        current_d, current_q: Gains of the current controllers as the firmware runs them (worked out
            by its own rule where it has one); None where neither file nor rule gives them.
        speed: Gains of the speed controller, None without one.
        own: Everything else that the file says or that is to be written, by the format's own name
            and in its own unit: PLL, observer, filters, dividers, tables as text.
        origins: Where values stand, by the name of the field (``r_s``, ``current_d.kp``); empty for
            a configuration that no file was read for.
        conventions: How its numbers are to be understood, one sentence each.
        contradictions: What in it does not fit together, one sentence each with both numbers.
    """

    firmware: Firmware
    version: str
    name: str
    drive: DriveValues
    current_d: PiGains | None = None
    current_q: PiGains | None = None
    speed: PiGains | None = None
    own: Mapping[str, OwnValue] = field(default_factory=dict)
    origins: Mapping[str, Origin] = field(default_factory=dict)
    conventions: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
