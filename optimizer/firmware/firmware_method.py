"""One record per firmware: from a design to its configuration, and from that to its loops."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware, LoadedByName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.optimizer.firmware.configuration import (
    DriveValues,
    Mechanics,
    PiGains,
    TurningAxes,
    Winding,
    current_loop,
    speed_loop,
    turning_axes,
)
from dqforge.optimizer.sampled_systems import ComplexArray, SampledSystem, loop_margins

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.optimizer.firmware.configuration import (
        Configuration,
        CurrentLoops,
        LoopProfile,
        Origin,
        OwnValue,
        PiController,
        SpeedEstimate,
    )
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.plants import PiLoop


# What a firmware leaves to choose: kp and ki of each axis, one pair for both, or only a bandwidth
# from which it works out the gains by itself.
FreeGains = Literal["axes", "one-pair", "bandwidth"]


@dataclass(frozen=True, slots=True)
class Asked:
    """What a configuration is to hold.

    Args:
        design: The design; its machine may be saturated.
        drive: What can be told of it in constants
            (`dqforge.optimizer.firmware.firmware_method.drive_values`).
        current_d, current_q: Gains wished for, V/A and V/(A s); a structure that cannot hold them
            takes what is nearest.
        speed: Gains wished for in A s/rad and A/rad, None without a speed loop.
        pll: Gains wished for (1/s and 1/s^2) of the phase-locked loop that makes the speed, s^2 +
            kp s + ki; None for the firmware's own. A firmware without one takes no notice.
    """

    design: Design
    drive: DriveValues
    current_d: PiGains
    current_q: PiGains
    speed: PiGains | None = None
    pll: PiGains | None = None


@dataclass(frozen=True, slots=True)
class Price:
    """What something costs: of what (``torque``, ``copper loss``, ``phase margin``, ...), how much,
    in which unit (SI; shares are plain numbers with the unit ``""``).
    """

    of: str
    value: float
    unit: str


def prices(price: CurrentPrice) -> tuple[Price, ...]:
    """The shares of torque and copper loss."""
    return Price("torque", price.torque, ""), Price("copper loss", price.copper_loss, "")


@dataclass(frozen=True, slots=True)
class CurrentPrice:
    """What a rule costs at the current limit.

    Args:
        torque: Share of the torque that is lost with the same current.
        copper_loss: Share of copper loss more than the same torque needs.
    """

    torque: float
    copper_loss: float


@dataclass(frozen=True, slots=True)
class Shortfall:
    """Something of the design that a format cannot hold: in words, with its price where it has
    one in numbers.
    """

    words: str
    prices: tuple[Price, ...] = ()


@dataclass(frozen=True, slots=True)
class FirmwareMethod:
    """How one firmware is configured, and what it then runs.

    Args:
        name, version: The firmware and the version of its format.
        free: Which gains of its current loops can be chosen.
        configure: The configuration for what is asked, rounded as its file prints it. Raises
            InputError where a value that it needs is missing or does not fit its numbers, and names
            the key.
        profile: The loops that a configuration amounts to. Raises InputError where it says too
            little.
        shortfalls: What the configuration cannot hold of what was asked.
        needs: Keys that a design may leave out and this firmware needs.
    """

    name: Firmware
    version: str
    free: FreeGains
    configure: Callable[[Asked], Configuration]
    profile: Callable[[Configuration], LoopProfile]
    shortfalls: Callable[[Asked, Configuration], tuple[Shortfall, ...]]
    needs: tuple[str, ...] = ()


# What the loops of a firmware make of a machine: crossovers, margins, damping, and what is wrong.
#
# Each loop alone takes the axes as decoupled, the inverter as linear, and the back-EMF, where the
# firmware feeds it forward, as exactly cancelled; `turning` is what the coupling makes of both
# current loops. The speed loop runs at no d current.

# Phase that a phase-locked loop may cost at the crossover without being remarked upon: where other
# gains would make it faster for nothing, and where its poles are as they should be.
_DEAR, _DEAR_AT_BEST = math.radians(10.0), math.radians(30.0)
_APART = 0.5  # Share of kp^2/4 below which ki leaves one of its poles far behind the other.
_BANDWIDTH_POINTS = 1200


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLoop:
    """One loop as a firmware runs it.

    Args:
        crossover: Gain crossover in rad/s; nan without one.
        phase_margin: In rad, negative where the loop lags by more than pi.
        gain_margin: As a factor above one.
        delay_margin: In s.
        max_sensitivity: Largest modulus of 1/(1 + L).
        bandwidth: Least frequency in rad/s at which the answer to the reference is 3 dB below one;
            nan where that is nowhere below half the sampling frequency.
        damping: Least damping ratio of the closed loop's poles, -cos of the angle of ln z; below
            zero where it is unstable.
        stable: Whether all poles lie inside the unit circle.
        poles: Of the closed loop, in the z plane of ``t_s``, largest modulus first, shape (n,).
        t_s: Period in s of its controller.
    """

    crossover: float
    phase_margin: float
    gain_margin: float
    delay_margin: float
    max_sensitivity: float
    bandwidth: float
    damping: float
    stable: bool
    poles: ComplexArray
    t_s: float


def pll_poles(feedback: SpeedEstimate) -> tuple[complex, complex] | None:
    """Poles in rad/s of s^2 + kp s + ki, slowest first; None where no phase-locked loop runs.

    Args:
        feedback: How the speed is made.
    """
    if feedback.kind != "pll":
        return None
    root = complex(0.25 * feedback.kp**2 - feedback.ki) ** 0.5
    fast = -0.5 * feedback.kp - root
    slow = feedback.ki / fast if fast != 0.0 else 0.0j  # without the difference of large numbers
    return slow, fast


@dataclass(frozen=True, slots=True, eq=False)
class JudgedFirmware:
    """The loops of one firmware on one machine; None where profile or machine say too little.

    Args:
        current_d, current_q, speed: The loops.
        pll_poles: Of the phase-locked loop that makes the speed, in rad/s (s plane), slowest first;
            None without one.
        remarks: What is wrong, what limits, and what is left out, one sentence each.
        turning: Both current loops together up to the largest speed, None where that is not known.
        faults: Those of the remarks that say what is wrong.
    """

    current_d: JudgedLoop | None
    current_q: JudgedLoop | None
    speed: JudgedLoop | None
    pll_poles: tuple[complex, complex] | None
    remarks: tuple[str, ...]
    turning: TurningAxes | None = None
    faults: tuple[str, ...] = ()


def judge(profile: LoopProfile, drive: DriveValues) -> JudgedFirmware:
    """Judge the loops of a profile on a machine.

    Args:
        profile: The structure with its numbers.
        drive: The machine.
    """
    current, speed = profile.current, profile.speed
    l_q = drive.l_q if drive.l_q is not None else drive.l_d
    l_d = drive.l_d if drive.l_d is not None else l_q
    judged_d = _judged_current(drive.r_s, l_d, current.d, current.delay)
    judged_q = _judged_current(drive.r_s, l_q, current.q, current.delay)
    missing = _missing(drive) if speed is not None else ()
    judged_speed = None
    if speed is not None and not missing:
        assert drive.r_s is not None
        assert l_q is not None
        judged_speed = judged_loop(
            speed_loop(Winding(drive.r_s, l_q), mechanics_of(drive, current), current, speed)
        )
    poles = None if speed is None else pll_poles(speed.feedback)
    turning = _turning(drive, l_d, l_q, current)
    faults = (
        *_unstable(profile, (("d", judged_d), ("q", judged_q), ("speed", judged_speed))),
        *_unstable_together(profile, turning, (judged_d, judged_q)),
        *_of_pll(profile, judged_speed, poles),
    )
    remarks = (
        *faults,
        *_of_observer(profile, judged_speed),
        *_left_out(missing, judged_q),
    )
    return JudgedFirmware(judged_d, judged_q, judged_speed, poles, remarks, turning, faults)


def judged_loop(loop: PiLoop) -> JudgedLoop:
    """Margins, bandwidth and damping of a sampled loop.

    Args:
        loop: The loop, from its error to what is measured.
    """
    margins, poles = loop_margins(loop.open_loop), loop.closed.poles
    return JudgedLoop(
        crossover=margins.crossover,
        phase_margin=margins.phase_margin,
        gain_margin=margins.gain_margin,
        delay_margin=margins.delay_margin,
        max_sensitivity=margins.max_sensitivity,
        bandwidth=_bandwidth(loop.closed),
        damping=least_damping(poles),
        stable=bool(np.abs(poles[0]) < 1.0),
        poles=poles,
        t_s=loop.closed.t_s,
    )


def least_damping(poles: ComplexArray) -> float:
    """Least damping ratio of sampled poles, -Re(ln z)/|ln z|; 1 where all are real and positive.

    Args:
        poles: In the z plane, shape (n,).
    """
    moving = np.log(poles[np.abs(poles) > 1e-9])
    moving = moving[np.abs(moving) > 0.0]
    return float(np.min(-moving.real / np.abs(moving), initial=1.0))


def mechanics_of(drive: DriveValues, current: CurrentLoops) -> Mechanics:
    """What a drive turns, and what of its back-EMF acts; the drive must state all of it.

    Args:
        drive: The machine.
        current: The current loops, which feed the back-EMF forward or do not.
    """
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.inertia is not None
    constant = drive.pole_pairs * drive.psi_pm
    return Mechanics(
        drive.inertia, drive.viscous or 0.0, 1.5 * constant, 0.0 if current.back_emf else constant
    )


def _judged_current(
    r_s: float | None, inductance: float | None, pi: PiController, delay: float
) -> JudgedLoop | None:
    if r_s is None or not inductance:
        return None
    return judged_loop(current_loop(Winding(r_s, inductance), pi, delay))


def _bandwidth(closed: SampledSystem) -> float:
    """Least frequency in rad/s at which the closed loop's answer falls to 3 dB below one."""
    from scipy.optimize import brentq

    def excess(omega: float) -> float:
        return float(np.abs(closed.response(np.array([omega]))[0])) - math.sqrt(0.5)

    nyquist = math.pi / closed.t_s
    omega = np.geomspace(1e-6 * nyquist, nyquist, _BANDWIDTH_POINTS)
    size = np.abs(closed.response(omega)) - math.sqrt(0.5)
    falls = np.flatnonzero((size[:-1] >= 0.0) & (size[1:] < 0.0))
    if not falls.size:
        return math.nan
    return float(brentq(excess, omega[falls[0]], omega[falls[0] + 1], rtol=1e-12))


def _missing(drive: DriveValues) -> tuple[str, ...]:
    """What the speed loop needs and the drive does not say."""
    inductance = drive.l_q if drive.l_q is not None else drive.l_d
    wanted = (
        ("pole pairs", drive.pole_pairs),
        ("resistance", drive.r_s),
        ("inductance", inductance),
        ("flux linkage of the magnets", drive.psi_pm),
        ("inertia", drive.inertia),
    )
    return tuple(name for name, value in wanted if not value)


def _rate(value: float) -> str:
    return f"{value:.4g} rad/s ({value / (2.0 * math.pi):.3g} Hz)"


def _unstable(
    profile: LoopProfile, loops: tuple[tuple[str, JudgedLoop | None], ...]
) -> tuple[str, ...]:
    found = []
    for name, loop in loops:
        if loop is None or loop.stable:
            continue
        what = "speed loop" if name == "speed" else f"{name}-axis current loop"
        found.append(
            f"the {what} is unstable as {profile.firmware} runs it: largest pole modulus "
            f"{abs(loop.poles[0]):.4g}"
        )
    return tuple(found)


def _turning(
    drive: DriveValues, l_d: float | None, l_q: float | None, loops: CurrentLoops
) -> TurningAxes | None:
    if drive.r_s is None or not l_d or not l_q or not drive.pole_pairs or not drive.omega_m_max:
        return None
    return turning_axes(drive.r_s, (l_d, l_q), loops, drive.pole_pairs, drive.omega_m_max)


def _unstable_together(
    profile: LoopProfile, turning: TurningAxes | None, axes: tuple[JudgedLoop | None, ...]
) -> tuple[str, ...]:
    """That the axes are unstable together where each alone is not."""
    alone = all(axis is not None and axis.stable for axis in axes)
    if turning is None or turning.unstable_from is None or not alone:
        return ()
    left = "" if profile.current.cross else ", with no feedforward of the other axis' current"
    words = (
        f"both current loops together are unstable as {profile.firmware} runs them from about "
        f"{in_rpm(turning.unstable_from):.4g} rpm{left}: largest pole modulus "
        f"{turning.radius:.4g} at {in_rpm(turning.omega_m):.4g} rpm"
    )
    return (words,)


def _of_pll(
    profile: LoopProfile, speed: JudgedLoop | None, poles: tuple[complex, complex] | None
) -> tuple[str, ...]:
    if profile.speed is None or poles is None:
        return ()
    feedback, slow = profile.speed.feedback, abs(poles[0])
    crossover = math.nan if speed is None else speed.crossover
    cost = -cmath.phase(
        complex(feedback.ki, feedback.kp * crossover if feedback.whole else 0.0)
        / complex(feedback.ki - crossover**2, feedback.kp * crossover)
    )
    double = 0.25 * feedback.kp**2
    apart = feedback.ki < _APART * double
    if not (math.isfinite(crossover) and cost > (_DEAR if apart else _DEAR_AT_BEST)):
        return ()
    relation = "below" if slow < crossover else "close to"
    remedy = (
        f"ki = kp^2/4 = {double:.6g} puts both poles at {0.5 * feedback.kp:.6g} rad/s"
        if apart
        else "a larger kp, with ki = kp^2/4, makes it faster where the format permits it"
    )
    words = (
        f"the PLL of {profile.firmware} (kp {feedback.kp:.6g}, ki {feedback.ki:.6g}) has a pole at "
        f"{float(f'{slow:.3g}'):g} rad/s, {relation} the speed loop's crossover of "
        f"{_rate(crossover)}, where it costs {math.degrees(cost):.0f} deg of the phase; {remedy}"
    )
    return (words,)


def _of_observer(profile: LoopProfile, speed: JudgedLoop | None) -> tuple[str, ...]:
    observer = profile.observer
    if observer is None or speed is None:
        return ()
    made = f"the speed is made of the angle of {observer.name}, whose"
    if observer.rate is None:
        return (f"{made} own lag is not in the margins of the speed loop",)
    words = (
        f"{made} errors decay with {observer.rate:.4g} rad/s; with the right resistance, "
        "inductance and flux linkage they are not part of the speed loop, with wrong ones they are"
    )
    return (words,)


def _left_out(missing: tuple[str, ...], judged_q: JudgedLoop | None) -> tuple[str, ...]:
    found = []
    if judged_q is None:
        found.append("no current loop is evaluated: resistance or inductance is not known")
    if missing:
        found.append(f"the speed loop is not evaluated: {', '.join(missing)} not known")
    return tuple(found)


# Shortfalls that several firmwares share: in words, with prices.

NOTICED = 1e-3  # Share from which on something is said of it.
_SAME_PERIOD = 1e-4


def closed_form_currents(
    asked: Asked, held: Configuration, saliency: float, lead: str, *, tail: str = ""
) -> Iterator[Shortfall]:
    """The closed form of linear machines, or no d current, against what the machine needs.

    Args:
        asked, held: The wishes, and what was made of them.
        saliency: L_q - L_d in H that the firmware takes; with 0 it commands no d current.
        lead: Whose currents they are, in words.
        tail: What helps, in words; follows the sentence.
    """
    psi, most = held.drive.psi_pm, held.drive.i_max
    if asked.design.strategy != "mtpa" or psi is None or most is None:
        return
    i_max = min(most, asked.design.i_max)
    price = price_of(asked.design.machine, i_max, linear_rule(psi, saliency))
    if price.torque >= NOTICED:
        form = "the closed form of a linear machine" if saliency else "no d current"
        yield Shortfall(
            f"{lead} are {form}: at {i_max:.4g} A they make {less_torque(price, 'lose')}{tail}",
            prices(price),
        )


def q_current_alone(asked: Asked, psi_pm: float, lead: str, *, tail: str) -> Iterator[Shortfall]:
    """No d current at all, against what the machine needs.

    Args:
        asked: The wishes.
        psi_pm: Flux linkage in Wb that the firmware is told.
        lead: That it commands none, in words; the current follows.
        tail: What helps, in words; follows the sentence.
    """
    if asked.design.strategy != "mtpa":
        return
    i_max = asked.design.i_max
    price = price_of(asked.design.machine, i_max, linear_rule(psi_pm, 0.0))
    if price.torque >= NOTICED:
        yield Shortfall(
            f"{lead}: at {i_max:.4g} A it makes {less_torque(price, 'loses')}{tail}",
            prices(price),
        )


def less_torque(price: CurrentPrice, lose: str) -> str:
    """What is lost, in words; of currents that `lose` it, or of a firmware that `loses` it."""
    return (
        f"{100.0 * price.torque:.2g} % less torque than this machine can, or {lose} "
        f"{100.0 * price.copper_loss:.2g} % more in copper for the same torque"
    )


def other_periods(asked: Asked, held: Configuration, firmware: str) -> Iterator[Shortfall]:
    """Periods of the controllers that are not those of the design.

    Args:
        asked, held: The wishes, and what was made of them.
        firmware: Who runs them, in words.
    """
    for what, wanted, has in (
        ("control step", asked.drive.t_s, held.drive.t_s),
        ("speed controller", asked.drive.t_speed, held.drive.t_speed),
    ):
        if wanted and has and not math.isclose(wanted, has, rel_tol=_SAME_PERIOD):
            yield Shortfall(
                f"{firmware} runs the {what} every {1e6 * has:.4g} us, the design every "
                f"{1e6 * wanted:.4g} us",
                (Price(f"period of the {what}", has - wanted, "s"),),
            )


# What currents by another rule cost against those of most torque per ampere of the machine.

# Currents (i_d, i_q) in A for amplitudes in A, shape (N,).
CurrentRule = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
_AMPLITUDES = 60
_ANGLES = 721


def price_of(machine: Machine, i_max: float, rule: CurrentRule) -> CurrentPrice:
    """Price of a rule on a machine, which may saturate, at its current limit.

    Args:
        machine: The machine.
        i_max: Current limit in A (peak).
        rule: The currents for an amplitude.
    """
    amplitudes = np.linspace(0.0, i_max, _AMPLITUDES + 1)[1:]
    most = _most_torque(machine, amplitudes)
    i_d, i_q = rule(amplitudes[-1:])
    made = float(machine.torque(i_d, i_q)[0])
    if made >= most[-1]:
        return CurrentPrice(0.0, 0.0)
    needed = float(np.interp(made, most, amplitudes))
    return CurrentPrice(1.0 - made / float(most[-1]), (i_max / needed) ** 2 - 1.0)


def linear_rule(psi_pm: float, saliency: float) -> CurrentRule:
    """The closed form for linear machines: i_d = (psi - sqrt(psi^2 + 8 (dL i)^2))/(4 dL).

    Args:
        psi_pm: Flux linkage of the magnets in Wb.
        saliency: dL = L_q - L_d in H; with 0 all current is q current.
    """

    def currents(amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        if saliency == 0.0:
            return np.zeros_like(amplitude), amplitude
        root = np.sqrt(psi_pm * psi_pm + 8.0 * (saliency * amplitude) ** 2)
        i_d = (psi_pm - root) / (4.0 * saliency)
        return i_d, np.sqrt(np.maximum(amplitude**2 - i_d**2, 0.0))

    return currents


def _most_torque(machine: Machine, amplitudes: FloatArray) -> FloatArray:
    """Largest torque in N m of each amplitude in A, shape (N,)."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ANGLES)
    i_d = amplitudes[:, np.newaxis] * np.sin(angle)
    i_q = amplitudes[:, np.newaxis] * np.cos(angle)
    torque = np.where(machine.known(i_d, i_q), machine.torque(i_d, i_q), -np.inf)
    return np.asarray(np.max(torque, axis=1), dtype=np.float64)


# What a design asks a firmware to hold: constants of its drive, and its gains.


def drive_values(design: Design) -> DriveValues:
    """Constants of the design's machine, inverter and timing.

    Of a saturating machine the inductances are the incremental ones at zero current.
    """
    machine, inverter, control = design.machine, design.inverter, design.control
    speed = control.speed_loop
    return DriveValues(
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        inertia=machine.inertia,
        viscous=machine.friction,
        i_max=design.i_max,
        omega_m_max=machine.omega_m_max,
        v_dc=inverter.v_dc,
        f_sw=inverter.f_sw,
        dead_time=inverter.dead_time,
        t_s=control.t_s,
        t_speed=None if speed is None else speed.ratio * control.t_s,
    )


def asked(design: Design, i_d: LoopGains, i_q: LoopGains, speed: LoopGains | None) -> Asked:
    """What is asked of a firmware where the design's own gains are wished for.

    The speed controller of other firmware commands q current: its gains are those of the torque
    over the torque per ampere at zero current.
    """
    return Asked(
        design,
        drive_values(design),
        PiGains(i_d.kp, i_d.ki),
        PiGains(i_q.kp, i_q.ki),
        None if speed is None else _per_ampere(speed, design),
    )


def _per_ampere(loop: LoopGains, design: Design) -> PiGains | None:
    """Gains in A s/rad and A/rad; None for a machine that makes no torque without d current."""
    constant = design.machine.torque_per_ampere
    if not math.isfinite(constant) or constant <= 0.0:
        return None
    return PiGains(loop.kp / constant, loop.ki / constant)


# Numbers among a firmware's own values: found, rounded as its file prints them, and asked for.

FLOAT32_DIGITS = 7  # Significant digits that are printed for firmware that computes in float32.
_LEAST, _MOST = 1e-30, 1e30


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A value as a number; None where it is not there, or a word."""
    value = own.get(name)
    return None if value is None or isinstance(value, str) else float(value)


def rounded(value: float, digits: int) -> float:
    """A number as it comes back from a file that prints that many significant digits."""
    return float(f"{value:.{digits}g}")


def float32_value(value: float, asked_by: str, firmware: str) -> float:
    """A value as a file for float32 holds it.

    Args:
        value: In its unit.
        asked_by: Key of the design that asks for it, for the message.
        firmware: Whose it is, for the message.

    Raises:
        InputError: A float32 cannot hold it.
    """
    printed = rounded(value, FLOAT32_DIGITS)
    if printed != 0.0 and not _LEAST < abs(printed) < _MOST:
        raise InputError(
            f"{asked_by}: {firmware} computes in float32, which {value:g} does not fit"
        )
    return printed


def needed(
    value: float | None, key: str, firmware: str, what: str, otherwise: str = "give it"
) -> float:
    """A positive value of the design.

    Args:
        value: As the design says it.
        key: Key of the design that gives it, for the message.
        firmware, what: Who needs it, and what it is, for the message.
        otherwise: What to do without it, for the message.

    Raises:
        InputError: It is missing, or not above zero.
    """
    if value is None or not math.isfinite(value) or value <= 0.0:
        raise InputError(f"{key}: {firmware} needs {what}; {otherwise}")
    return float(value)


# What firmware needs of a design that it does not say: all of it in one refusal, with text to
# paste.

MAX_SPEED, INERTIA = "machine.max_speed", "machine.inertia"
CURRENT_SENSING = "inverter.current_sensing"
_HEADROOM = 1.25  # Full scale of a current measurement that is proposed, over the current limit.
_RUN_UP = 0.1  # Time in s in which a proposed inertia runs up to the largest speed.


def check_drivable(design: Design, methods: Sequence[FirmwareMethod]) -> None:
    """Refuse a machine of a kind that no firmware of others drives, and a design that lacks what
    they need.

    Raises:
        InputError: With everything that is missing, as keys with values that fit this drive.
    """
    names = " and ".join(method.name for method in methods)
    if methods and design.phase_machine is not None:
        raise InputError(
            f"export.firmware: {names} drives machines with a sinusoidal back-EMF, and this one "
            "has model: waveform; omit it"
        )
    needed = {key for method in methods for key in method.needs}
    proposals = {
        MAX_SPEED: (design.machine.omega_m_max, _speed_text),
        INERTIA: (design.machine.inertia, _inertia_text),
        CURRENT_SENSING: (design.inverter.current_sensing, _sensing_text),
    }
    missing = {
        key: text(design)
        for key, (value, text) in proposals.items()
        if key in needed and value is None
    }
    if not missing:
        return
    who = " and ".join(method.name for method in methods if missing.keys() & set(method.needs))
    lines = [
        f"in {section} "
        + " and ".join(
            f"'{key.partition('.')[2]}: {text}'"
            for key, text in missing.items()
            if key.startswith(f"{section}.")
        )
        for section in dict.fromkeys(key.partition(".")[0] for key in missing)
    ]
    raise InputError(
        f"{next(iter(missing))}: {who} cannot do without {', '.join(missing)}; write "
        f"{', and '.join(lines)}, with your own values in place of these, which fit this drive"
    )


def _base_speed(design: Design) -> float:
    """Mechanical speed in rad/s at which flux linkage and link meet."""
    machine = design.machine
    flux = math.hypot(machine.psi_pm, machine.l_q * design.i_max)
    return linear_voltage(design.inverter.v_dc) / (flux * machine.pole_pairs)


def _speed_text(design: Design) -> str:
    return f"{float(f'{in_rpm(_base_speed(design)):.2g}'):g} rpm"


def _inertia_text(design: Design) -> str:
    machine = design.machine
    flux = max(machine.psi_pm, abs(machine.l_q - machine.l_d) * design.i_max)
    torque = torque_per_ampere(machine.pole_pairs, flux) * design.i_max
    speed = machine.omega_m_max or _base_speed(design)
    return f"{torque * _RUN_UP / speed:.2g} kg m^2"


def _sensing_text(design: Design) -> str:
    gain, reference = 20.0, 3.3
    shunt = 0.5 * reference / gain / (_HEADROOM * design.i_max)
    milliohm = float(f"{1e3 * shunt:.2g}")
    return f"{{shunt: {milliohm:g} mOhm, gain: {gain:g}, reference: {reference:g} V}}"


# Where the fields of a configuration stand in a file, from where its own values stand.

# By the field of the configuration (``r_s``, ``current_d.kp``) the name in the file, or several of
# which the first one there counts, and how the value is converted.
Fields = Mapping[str, tuple[str | tuple[str, ...], str]]


def field_origins(found: Mapping[str, Origin], fields: Fields) -> dict[str, Origin]:
    """Origins by the field of the configuration, and by the file's own name.

    Args:
        found: By the file's own name.
        fields: What the fields are made of; those of which nothing is there are left out.
    """
    by_field = {}
    for field, (names, conversion) in fields.items():
        those = (names,) if isinstance(names, str) else names
        origin = next((found[name] for name in those if name in found), None)
        if origin is not None:
            by_field[field] = replace(origin, conversion=conversion)
    return by_field | dict(found)


# The methods of every firmware, by name.

METHODS: LoadedByName[Firmware, FirmwareMethod] = LoadedByName(
    {
        name: f"dqforge.optimizer.firmware.targets.{name}:{name.upper()}"
        for name in get_args(Firmware)
    }
)
