"""What a configuration of another firmware amounts to: machine, gains and limits in SI units, as
that firmware computes with them.

Amplitude-invariant dq quantities (peak of phase), resistances and inductances per phase of the
star. Readers make a `Configuration` of a file, methods make one of a design; files are written
from it. Its numbers are those that the file can hold, already rounded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING, Literal

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


# The structure of a firmware's loops, with its numbers: what is judged, and what is simulated.

# ``integral-first``: I += ki T e, u = kp e + I (backward Euler); ``integral-last``: u = kp e + I,
# then I += ki T e (forward Euler); ``trapezoid``: I += ki T (e + e_before)/2, u = kp e + I.
PiRule = Literal["integral-first", "integral-last", "trapezoid"]

# What the integral does where the output is limited: it is clamped to the limit, it stands still,
# it is driven back by the excess, or it runs on.
AntiWindup = Literal["clamp", "hold", "back-calculation", "none"]

# Which voltage gives way: the vector along its direction, q after d, d after q, each by itself.
LimitOrder = Literal["vector", "d-first", "q-first", "axes"]
SpeedKind = Literal["ideal", "pll", "low-pass", "difference"]


@dataclass(frozen=True, slots=True)
class PiController:
    """One PI controller as it is computed.

    ``kp`` and ``ki`` are those of the parallel form, per second; ``t_s`` its period in s; ``limit``
    that of its output in the unit of the output, None where only what follows limits it.
    ``filter_time`` is the time constant in s of a first-order filter on what it measures,
    ``tracking`` the back-calculation gain in 1/s.
    """

    kp: float
    ki: float
    t_s: float
    rule: PiRule = "integral-first"
    anti_windup: AntiWindup = "clamp"
    limit: float | None = None
    filter_time: float = 0.0
    tracking: float = 0.0


@dataclass(frozen=True, slots=True)
class CurrentLoops:
    """Both current controllers and what leads from them to the inverter.

    Args:
        d, q: The controllers; volts per ampere.
        delay: Periods from the sampling of the currents to the beginning of the period for which
            the voltage made of them is held: 1 where it is loaded with the next update.
        cross, back_emf: Whether the voltages of the other axis' current, and of the magnet, are fed
            forward.
        order, voltage_share: Which voltage gives way, and the limit as a share of v_dc/sqrt(3).
        angle_advance: Periods by which the angle is advanced when the voltage is turned back to the
            phases.
        modulation: As it is named among the modulators.
    """

    d: PiController
    q: PiController
    delay: float = 1.0
    cross: bool = False
    back_emf: bool = False
    order: LimitOrder = "vector"
    voltage_share: float = 1.0
    angle_advance: float = 0.0
    modulation: str = "svpwm"


@dataclass(frozen=True, slots=True)
class SpeedEstimate:
    """How the speed that is controlled is made of the angle.

    ``pll``: omega += ki e T, theta += (omega + kp e) T over the electrical angle, so that the speed
    has the transfer function ki/(s^2 + kp s + ki). ``low-pass``: a first-order filter of
    ``filter_time`` s on the difference of angles. ``difference``: that difference over
    ``samples`` periods. ``t_s`` is the period in s at which it runs. ``averaged`` is the number of
    periods over which the speed of any of them is averaged before it is used, and ``whole`` says
    that a ``pll`` hands on omega + kp e instead of omega alone, so that its transfer function is
    (kp s + ki)/(s^2 + kp s + ki).
    """

    kind: SpeedKind = "ideal"
    t_s: float = 0.0
    kp: float = 0.0
    ki: float = 0.0
    filter_time: float = 0.0
    samples: int = 1
    averaged: int = 1
    whole: bool = False


@dataclass(frozen=True, slots=True)
class SpeedController:
    """The speed controller: amperes of q current per rad/s (mechanical), and what it measures.

    ``ramp`` is the slope in rad/s^2 to which the reference is held, None without one.
    """

    pi: PiController
    feedback: SpeedEstimate
    ramp: float | None = None


@dataclass(frozen=True, slots=True)
class FluxObserver:
    """A position observer of a firmware: its name there, and the rate in rad/s with which its error
    decays at standstill and at speed, None where that depends on more than its numbers.
    """

    name: str
    rate: float | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoopProfile:
    """The loops of one firmware with the numbers of one configuration.

    ``reference`` says where the currents for a torque come from: no d current, the closed form of
    linear machines, or a table of the firmware. ``sources`` name where the structure is taken from.
    ``table`` holds the points of that table, (command, i_d, i_q) in A, commands ascending from 0:
    joined by lines, held behind the last; for negative commands i_q changes its sign. The command
    is the torque over 1.5 p psi_pm, or what the speed controller puts out.
    """

    firmware: Firmware
    version: str
    current: CurrentLoops
    speed: SpeedController | None = None
    observer: FluxObserver | None = None
    reference: Literal["id-zero", "mtpa-linear", "table"] = "id-zero"
    sources: tuple[str, ...] = ()
    table: tuple[tuple[float, float, float], ...] = ()
