"""What the keys of a moteus configuration amount to: constants, gains and rates in SI units.

Facts of github.com/mjbots/moteus (firmware ABI 0x010e and later unless said otherwise):
`fw/bldc_servo_control.h` (UpdateDerivedMotorConstants, UpdateEffectiveInductance, ISR_DoCurrent),
`fw/bldc_servo.cc` (torque constant), `fw/motor_position.h` (filter of the encoder),
`utils/moteus_tool` of the package `moteus` 1.1.1 (upgrades of older configurations).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, torque_per_ampere
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import to_digits
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    LoopProfile,
    OwnValue,
    PiGains,
    Winding,
    current_loop,
)
from dqforge.optimizer.firmware.firmware_method import (
    FLOAT32_DIGITS,
    Asked,
    JudgedFirmware,
    JudgedLoop,
    Price,
    Shortfall,
    judge,
    linear_rule,
    price_of,
    rounded,
)
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import loop_margins

FIRMWARE: Firmware = "moteus"
VERSION = "ABI 0x010e and later"
OLD_VERSION = "before ABI 0x010e"

# Kv p psi in V s/rad times rpm/V: Kv is the speed in rpm per volt (peak) between two phases.
KV_FLUX = 60.0 / (2.0 * math.pi * math.sqrt(3.0))
WHOLE = ("motor.poles", "servo.pwm_rate_hz", "servo.voltage_mode_control")
FILTER = "motor_position.sources.0.pll_filter_hz"
GEAR = "motor_position.rotor_to_output_ratio"
SLIP = "servo.max_position_slip"

# Keys that are those of the output of a gear, and the power of its ratio that they carry.
OF_OUTPUT = {
    "servo.max_velocity": 1,
    SLIP: 1,
    "servo.default_accel_limit": 1,
    "servo.pid_position.kp": -2,
    "servo.pid_position.ki": -2,
    "servo.pid_position.kd": -2,
    "servo.inertia_feedforward": -2,
}

# Keys that mean something to loops and machine, in the order in which they are written.
KNOWN = (
    "motor.poles",
    "motor.resistance_ohm",
    "motor.inductance_d_H",
    "motor.inductance_q_H",
    "motor.inductance_d_scale",
    "motor.Kv",
    "motor.rotation_current_cutoff_A",
    "motor.rotation_current_scale",
    "motor.rotation_torque_scale",
    "servo.pwm_rate_hz",
    "servo.pid_dq_hz",
    "servo.pid_dq.kp",
    "servo.pid_dq.ki",
    "servo.pid_q.kp",
    "servo.pid_q.ki",
    "servo.max_current_desired_rate",
    "servo.current_feedforward",
    "servo.cross_coupling_feedforward",
    "servo.bemf_feedforward",
    "servo.max_current_A",
    "servo.max_velocity",
    "servo.default_accel_limit",
    "servo.inertia_feedforward",
    "servo.pid_position.kp",
    "servo.pid_position.ki",
    "servo.pid_position.ilimit",
    "servo.pid_position.kd",
    SLIP,
    "servo.voltage_mode_control",
    FILTER,
)

# Largest rate in Hz of the control; above it every second period of the PWM has one.
FASTEST_INTERRUPT = 30000.0
_PWM_LOWEST, _PWM_HIGHEST = 15000, 60000

# Seconds for which the low-side switches conduct at least, so that the currents are sampled.
_SENSE_TIME = 0.6e-6

# Bandwidth (3 dB) over natural frequency of the filter of the encoder, damping 1.
_FILTER_RATIO = 2.48
Numbers = Mapping[str, float | int]


def as_printed(key: str, value: float) -> float | int:
    """A value as the file holds it: whole, or seven digits, which float32 keeps.

    Args:
        key: Name of the parameter.
        value: In its unit.
    """
    return round(value) if key in WHOLE else rounded(value, FLOAT32_DIGITS)


def pwm_rate(wished: float) -> int:
    """The rate in Hz that moteus runs for one wished for: even, from 15 to 60 kHz.

    Args:
        wished: In Hz.
    """
    return int(min(max(wished, _PWM_LOWEST), _PWM_HIGHEST)) // 2 * 2


def control_period(rate: float) -> float:
    """Period in s of current and position control at a rate of the PWM in Hz.

    Args:
        rate: In Hz.
    """
    return (2.0 if rate > FASTEST_INTERRUPT else 1.0) / rate


def voltage_share(rate: float) -> float:
    """Largest phase voltage over v_dc/sqrt(3): what the time for sampling leaves.

    Args:
        rate: Of the PWM in Hz.
    """
    return 1.0 - 4.0 * _SENSE_TIME * rate


def filter_gains(bandwidth: float) -> tuple[float, float]:
    """Gains (kp, ki) in 1/s and 1/s^2 of the filter of the encoder for its bandwidth in Hz.

    Args:
        bandwidth: As ``pll_filter_hz`` states it.
    """
    natural = 2.0 * math.pi * bandwidth / _FILTER_RATIO
    return 2.0 * natural, natural * natural


def filter_bandwidth(kp: float) -> float:
    """Bandwidth in Hz that the filter of the encoder has with a gain kp in 1/s.

    Args:
        kp: Twice its natural frequency.
    """
    return 0.5 * kp * _FILTER_RATIO / (2.0 * math.pi)


def configuration(name: str, numbers: Numbers) -> Configuration:
    """What keys amount to; gains that the firmware works out by itself included.

    Args:
        name: Of the drive.
        numbers: Values by key in the units of moteus, of the rotor (`OF_OUTPUT` undone).
    """
    own: dict[str, OwnValue] = {key: numbers[key] for key in KNOWN if key in numbers}
    current_d, current_q = _current_gains(numbers)
    drive = _drive(numbers)
    return Configuration(
        firmware=FIRMWARE,
        version=OLD_VERSION if _old(numbers) else VERSION,
        name=name,
        drive=drive,
        current_d=current_d,
        current_q=current_q,
        speed=_speed_gains(numbers, drive),
        own=own,
        conventions=tuple(conventions(numbers, drive.t_s)),
        contradictions=tuple(contradictions(numbers, drive.t_s)),
    )


def _old(numbers: Numbers) -> bool:
    return "servo.pid_dq_hz" not in numbers and "servo.pid_dq.kp" in numbers


def _drive(numbers: Numbers) -> DriveValues:
    poles, speed = numbers.get("motor.poles"), numbers.get("servo.max_velocity")
    pairs = int(poles) // 2 if poles else None
    rate = numbers.get("servo.pwm_rate_hz")
    period = None if rate is None else control_period(pwm_rate(rate))
    return DriveValues(
        pole_pairs=pairs,
        r_s=_positive(numbers, "motor.resistance_ohm"),
        l_d=_positive(numbers, "motor.inductance_d_H"),
        l_q=_positive(numbers, "motor.inductance_q_H"),
        psi_pm=_flux(numbers, pairs),
        inertia=_positive(numbers, "servo.inertia_feedforward"),
        i_max=_positive(numbers, "servo.max_current_A"),
        omega_m_max=None if speed is None else 2.0 * math.pi * speed,
        f_sw=None if rate is None else float(pwm_rate(rate)),
        t_s=period,
        t_speed=period if "servo.pid_position.kd" in numbers else None,
    )


def _positive(numbers: Numbers, key: str) -> float | None:
    """A value that is not known where it is zero."""
    value = numbers.get(key, 0.0)
    return float(value) if value > 0.0 else None


def _flux(numbers: Numbers, pairs: int | None) -> float | None:
    speed_constant = numbers.get("motor.Kv", 0.0)
    if pairs is None or speed_constant <= 0.0:
        return None
    return KV_FLUX / (pairs * speed_constant)


def _current_gains(numbers: Numbers) -> tuple[PiGains | None, PiGains | None]:
    """Gains of d and q: 2 pi f L and 2 pi f R, or those that stand there."""
    if _old(numbers):
        given = PiGains(numbers["servo.pid_dq.kp"], numbers.get("servo.pid_dq.ki", 0.0))
        own_q = numbers.get("servo.pid_q.kp")
        if own_q is None:
            return given, given
        return given, PiGains(own_q, numbers.get("servo.pid_q.ki", given.ki))
    resistance = _positive(numbers, "motor.resistance_ohm")
    hertz = _positive(numbers, "servo.pid_dq_hz")
    if resistance is None or hertz is None:
        return None, None
    rate = 2.0 * math.pi * hertz
    found = []
    for key in ("motor.inductance_d_H", "motor.inductance_q_H"):
        inductance = _positive(numbers, key)
        found.append(None if inductance is None else PiGains(rate * inductance, rate * resistance))
    return found[0], found[1]


def _speed_gains(numbers: Numbers, drive: DriveValues) -> PiGains | None:
    """The position controller as one of the speed: kd acts on the error of the speed, kp on that of
    the position, which is the integral of it.
    """
    damping = numbers.get("servo.pid_position.kd")
    if damping is None or drive.psi_pm is None or drive.pole_pairs is None:
        return None
    turn = 2.0 * math.pi * torque_per_ampere(drive.pole_pairs, drive.psi_pm)
    return PiGains(damping / turn, numbers.get("servo.pid_position.kp", 0.0) / turn)


# What firmware that is told one bandwidth cannot hold of a design: in words, with prices.

_SAME = 1e-3  # Relative difference below which two numbers count as one.


def margin_words(judged: JudgedFirmware) -> str:
    """Phase margins and crossovers of the current loops in words.

    Args:
        judged: The loops.
    """
    return " and ".join(
        f"{_degrees(loop)} at {loop.crossover / (2.0 * math.pi):.4g} Hz ({axis})"
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )


def gains_changed(
    asked: Asked, held: Configuration, judged: JudgedFirmware, lead: str
) -> tuple[Shortfall, ...]:
    """Current gains that the firmware works out by itself, where they are not those asked for.

    Args:
        asked, held: The wishes, and what was made of them.
        judged: The loops that run.
        lead: Which key decides, in words.
    """
    pairs = (("d", asked.current_d, held.current_d), ("q", asked.current_q, held.current_q))
    changes = [
        f"{axis} kp {own.kp:.4g} V/A and ki {own.ki:.4g} V/(A s) instead of {wish.kp:.4g} and "
        f"{wish.ki:.4g}"
        for axis, wish, own in pairs
        if own is not None and not _same(wish, own)
    ]
    if not changes:
        return ()
    words = f"{lead}: {'; '.join(changes)}; phase margins {margin_words(judged)}"
    prices = tuple(
        Price(f"phase margin ({axis})", loop.phase_margin, "rad")
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )
    return (Shortfall(words, prices),)


def rates_changed(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """Frequency of the inverter and periods of the controllers that are not those of the design.

    Args:
        asked, held: The wishes, and what was made of them.
    """
    wish, own = asked.drive, held.drive
    changes = [
        f"{name} {was * scale:.6g} {unit} becomes {now * scale:.6g} {unit}"
        for name, was, now, scale, unit in (
            ("switching frequency", wish.f_sw, own.f_sw, 1e-3, "kHz"),
            ("current control every", wish.t_s, own.t_s, 1e6, "us"),
            ("speed control every", wish.t_speed, own.t_speed, 1e6, "us"),
        )
        if was is not None and now is not None and abs(now / was - 1.0) > _SAME
    ]
    return (Shortfall(f"{held.firmware} runs at its own rates: {'; '.join(changes)}"),) * bool(
        changes
    )


def saturation_unknown(asked: Asked, loops: LoopProfile, what: str) -> tuple[Shortfall, ...]:
    """What constant inductances make of the margins where the machine saturates.

    Args:
        asked: The design.
        loops: The current loops that run.
        what: What the format holds, in words.
    """
    drive, machine = asked.drive, asked.design.machine
    if drive.i_max is None or drive.l_d is None or drive.l_q is None:
        return ()
    jet = machine.jet(np.zeros(1), np.full(1, drive.i_max))
    l_d, l_q = float(jet.l_dd[0]), float(jet.l_qq[0])
    if abs(l_q / drive.l_q - 1.0) <= _SAME and abs(l_d / drive.l_d - 1.0) <= _SAME:
        return ()
    if not (l_d > 0.0 and l_q > 0.0):
        return ()
    judged = judge(replace(loops, speed=None), replace(drive, l_d=l_d, l_q=l_q))
    words = (
        f"{what}; at {drive.i_max:.4g} A of q current they are {l_d * 1e6:.4g} uH (d) and "
        f"{l_q * 1e6:.4g} uH (q) instead of {drive.l_d * 1e6:.4g} and {drive.l_q * 1e6:.4g} uH, "
        f"and the phase margins {margin_words(judged)}"
    )
    prices = tuple(
        Price(f"phase margin ({axis}) at i_max", loop.phase_margin, "rad")
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )
    return (Shortfall(words, prices),)


def d_current_missing(asked: Asked) -> tuple[Shortfall, ...]:
    """What it costs that no d current flows, where the design asks for one.

    Args:
        asked: The design.
    """
    design, i_max = asked.design, asked.drive.i_max
    if design.strategy == "id0" or i_max is None:
        return ()
    machine = design.machine
    price = price_of(machine, i_max, linear_rule(machine.psi_pm, 0.0))
    torque = float(machine.torque(np.zeros(1), np.full(1, i_max))[0])
    if price.torque < _SAME or not torque > 0.0:
        return ()
    best = torque / (1.0 - price.torque)
    loss = 1.5 * machine.r_s * i_max * i_max
    least = loss / (1.0 + price.copper_loss)
    words = (
        f"no d current below the voltage limit: {torque:.4g} N m at {i_max:.4g} A instead of "
        f"{best:.4g} N m ({price.torque:.1%} less); for the same {torque:.4g} N m {loss:.4g} W of "
        f"copper loss instead of {least:.4g} W"
    )
    prices = (Price("torque", best - torque, "N m"), Price("copper loss", loss - least, "W"))
    return (Shortfall(words, prices),)


def field_weakening_missing(asked: Asked, words: str) -> tuple[Shortfall, ...]:
    """That currents beyond base speed are not those of the design, where it asks for any.

    Args:
        asked: The design.
        words: What the firmware does instead.
    """
    return () if asked.design.weakening is None else (Shortfall(words),)


def _same(wish: PiGains, own: PiGains) -> bool:
    return abs(own.kp - wish.kp) <= _SAME * wish.kp and abs(own.ki - wish.ki) <= _SAME * wish.ki


def _degrees(loop: JudgedLoop) -> str:
    return f"{math.degrees(loop.phase_margin):.1f} deg"


# Torque over q current as moteus models it, fitted to that of a saturating machine: proportional
# up to a current, a logarithm from there on.
#
# T = K i up to i_c, and K i_c + t log2(1 + s (i - i_c)) beyond (`fw/torque_model.h` of moteus); no
# d current flows. The fit makes the largest error over 0..i_max as small as it can.

# Current in A from which moteus counts a machine as saturated when nothing else is set.
NEVER = 10000.0

# What the other two are when nothing is set; without meaning below `NEVER`.
NO_CURRENT_SCALE, NO_TORQUE_SCALE = 0.05, 14.7
_POINTS = 241
_LINEAR_ENOUGH = 1e-4  # Largest error over the largest torque below which nothing is fitted.


@dataclass(frozen=True, slots=True)
class TorqueRotation:
    """The model of moteus of one machine.

    ``cutoff`` in A, ``current_scale`` in 1/A, ``torque_scale`` in N m; ``error`` in N m is the
    largest over 0..i_max, ``straight`` that of the torque constant alone, ``largest`` the machine's
    torque at i_max.
    """

    cutoff: float
    current_scale: float
    torque_scale: float
    error: float
    straight: float
    largest: float

    def torque(self, constant: float, current: FloatArray) -> FloatArray:
        """Torque in N m of q currents in A from zero on, any shape.

        Args:
            constant: Torque per ampere in N m/A.
            current: In A.
        """
        beyond = np.maximum(current - self.cutoff, 0.0)
        bent = self.torque_scale * np.log2(1.0 + self.current_scale * beyond)
        return constant * np.minimum(current, self.cutoff) + bent


def torque_rotation(machine: Machine, constant: float, i_max: float) -> TorqueRotation:
    """Fit the model to a machine.

    Args:
        machine: The machine.
        constant: Torque per ampere in N m/A with which moteus computes.
        i_max: Largest current in A.
    """
    current = np.linspace(0.0, i_max, _POINTS)
    torque = machine.torque(np.zeros(_POINTS), current)
    straight = float(np.max(np.abs(constant * current - torque)))
    largest = float(torque[-1])
    unused = TorqueRotation(NEVER, NO_CURRENT_SCALE, NO_TORQUE_SCALE, straight, straight, largest)
    if straight <= _LINEAR_ENOUGH * abs(largest):
        return unused
    cutoff, scale = _best_shape(current, torque, constant)
    weight, error = _best_weight(current, torque, constant, np.array([cutoff]), np.array([scale]))
    cutoff, scale, torque_scale = (
        rounded(value, FLOAT32_DIGITS) for value in (cutoff, scale, weight[0])
    )
    found = TorqueRotation(cutoff, scale, torque_scale, float(error[0]), straight, largest)
    return found if found.torque_scale > 0.0 and found.error < straight else unused


def _best_shape(current: FloatArray, torque: FloatArray, constant: float) -> tuple[float, float]:
    """Cutoff and current scale with the least largest error: a grid, refined round its best."""
    i_max = float(current[-1])
    cutoffs = np.linspace(0.0, 0.98 * i_max, 41)
    scales = np.geomspace(1e-3, 1e3, 41) / i_max
    width, factor = cutoffs[1], scales[1] / scales[0]
    for _ in range(14):
        grid = np.meshgrid(cutoffs, scales, indexing="ij")
        flat = (grid[0].ravel(), grid[1].ravel())
        best = int(np.argmin(_best_weight(current, torque, constant, *flat)[1]))
        cutoff, scale = float(flat[0][best]), float(flat[1][best])
        cutoffs = np.clip(cutoff + width * np.linspace(-1.0, 1.0, 9), 0.0, 0.98 * i_max)
        scales = scale * factor ** np.linspace(-1.0, 1.0, 9)
        width, factor = 0.6 * width, factor**0.6
    return cutoff, scale


def _best_weight(
    current: FloatArray,
    torque: FloatArray,
    constant: float,
    cutoff: FloatArray,
    scale: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Torque scale of each pair with its largest error in N m, arrays of shape (n,).

    The error is convex in the torque scale: the least of it is found by sections.
    """
    beyond = np.maximum(current - cutoff[:, None], 0.0)
    shape = np.log2(1.0 + scale[:, None] * beyond)
    rest = torque - constant * np.minimum(current, cutoff[:, None])

    def error(weight: FloatArray) -> FloatArray:
        found: FloatArray = np.max(np.abs(weight[:, None] * shape - rest), axis=1)
        return found

    low = np.zeros(cutoff.size)
    high = 2.0 * np.max(np.abs(rest), axis=1) / np.max(shape, axis=1)
    for _ in range(48):
        left, right = low + (high - low) / 3.0, high - (high - low) / 3.0
        falls = error(left) > error(right)
        low, high = np.where(falls, left, low), np.where(falls, high, right)
    weight = 0.5 * (low + high)
    return weight, error(weight)


# The bandwidth of a firmware that works out its gains from one: the largest up to what was asked
# for with which its own loops keep their margins, from no current to the limit.

# Largest modulus of 1/(1 + L) of current loops whose bandwidth had to be lowered, as that of the
# optimised gains: a phase margin of some 60 deg where the winding's pole is cancelled.
MOST_SENSITIVITY = 1.6
_LEAST_SHARE = 1e-4
_STEP = 0.7
_RESOLUTION = 1e-3
_DIGITS = 4


def bandwidth_asked(asked: Asked) -> float:
    """Bandwidth in rad/s that the gains wished for have: kp/L of the slower axis.

    Args:
        asked: What is asked of the firmware, with both inductances.
    """
    l_d, l_q = asked.drive.l_d, asked.drive.l_q
    assert l_d is not None
    assert l_q is not None
    return min(asked.current_d.kp / l_d, asked.current_q.kp / l_q)


def drives_over_current(asked: Asked) -> tuple[DriveValues, ...]:
    """The drive with its inductances at no current, and where it saturates at the current limit.

    Args:
        asked: What is asked of the firmware.
    """
    drive, i_max = asked.drive, asked.drive.i_max
    if i_max is None:
        return (drive,)
    jet = asked.design.machine.jet(np.zeros(1), np.full(1, i_max))
    limit = replace(drive, l_d=float(jet.l_dd[0]), l_q=float(jet.l_qq[0]))
    return (drive,) if limit == drive or min(jet.l_dd[0], jet.l_qq[0]) <= 0.0 else (drive, limit)


def held_bandwidth(wished: float, loops: Callable[[float], LoopProfile], asked: Asked) -> float:
    """Largest bandwidth, at most the one wished for, with which both current loops keep the phase
    margin of the design and, at no current, a sensitivity of at most `MOST_SENSITIVITY`; four
    digits, rounded down.

    Args:
        wished: In the unit of the firmware.
        loops: The loops with a bandwidth in that unit.
        asked: What is asked of the firmware; the ``min_phase_margin`` of its design must hold.
    """
    from scipy.optimize import brentq

    least = asked.design.control.current_loop.min_phase_margin
    drives = [
        (Winding(drive.r_s, drive.l_d), Winding(drive.r_s, drive.l_q))
        for drive in drives_over_current(asked)
        if drive.r_s is not None and drive.l_d is not None and drive.l_q is not None
    ]

    @cache
    def spare(bandwidth: float) -> float:
        """What is left of margin and sensitivity, relative to what must hold; below zero where
        one of them does not.
        """
        current = loops(bandwidth).current
        return min(
            _spare(current_loop(winding, pi, current.delay), least, damped=index == 0)
            for index, pair in enumerate(drives)
            for winding, pi in zip(pair, (current.d, current.q), strict=True)
        )

    high = rounded_down(wished)
    low = high
    while spare(low) < 0.0:
        high, low = low, _STEP * low
        if low < _LEAST_SHARE * wished:
            raise NoSolutionError(
                f"no bandwidth of the current loops of {loops(low).firmware} keeps a phase margin "
                f"of {math.degrees(least):.4g} deg; lower control.current_loop.min_phase_margin"
            )
    if low == high:
        return high
    edge = rounded_down(float(brentq(spare, low, high, rtol=_RESOLUTION)))
    while spare(edge) < 0.0:
        edge = rounded_down((1.0 - _RESOLUTION) * edge)
    return edge


def _spare(loop: PiLoop, least: float, *, damped: bool) -> float:
    if abs(loop.closed.poles[0]) >= 1.0:
        return -1.0
    margins = loop_margins(loop.open_loop)
    margin = margins.phase_margin / max(least, 1e-6) - 1.0  # a design may ask for none
    return min(margin, MOST_SENSITIVITY / margins.max_sensitivity - 1.0) if damped else margin


def rounded_down(value: float) -> float:
    """A positive number with four digits, not above what it was.

    Args:
        value: Any positive number.
    """
    return to_digits(value, _DIGITS, up=False)


# How the numbers of a moteus configuration are meant, and what in them does not fit together.

# Rate of the control over the bandwidth of the currents, as moteus_tool keeps it at least.
SLOWEST_SHARE = 30.0
FILTER_SHARE = 10.0  # Rate of the control over the bandwidth of the encoder's filter, likewise.


def conventions(numbers: Numbers, period: float | None = None) -> Iterator[str]:
    """Sentences on how numbers are meant that a reader could take otherwise.

    Args:
        numbers: Values by key, of the rotor.
        period: Of the control in s, None where it is not known.
    """
    if "motor.Kv" in numbers:
        yield "motor.Kv is in rpm per volt between two phases (peak), of the rotor"
    if "motor.poles" in numbers:
        yield "motor.poles counts poles, not pole pairs"
    if "servo.max_current_A" in numbers:
        yield "servo.max_current_A (peak of phase) limits d and q current separately"
    if "servo.pid_position.kd" in numbers:
        yield (
            "servo.pid_position is taken as a controller of the speed: kd as its proportional, kp "
            "as its integral gain"
        )
    yield from _feedforward(numbers)
    hertz = numbers.get("servo.pid_dq_hz")
    if hertz is not None and period is not None and hertz * period > 1.001 / SLOWEST_SHARE:
        yield (
            f"servo.pid_dq_hz {hertz:g} Hz is above 1/{SLOWEST_SHARE:g} of the control's "
            f"{1.0 / period:g} Hz, the most that moteus_tool sets: the firmware accepts "
            "it, and the margins of the current loops show the effect"
        )


def contradictions(numbers: Numbers, period: float | None) -> Iterator[str]:
    """Sentences on what does not fit together.

    Args:
        numbers: Values by key, of the rotor.
        period: Of the control in s, None where it is not known.
    """
    hertz = numbers.get("servo.pid_dq_hz")
    if hertz is not None and "servo.pid_dq.kp" in numbers:
        yield (
            f"servo.pid_dq.kp {numbers['servo.pid_dq.kp']:g} stands beside servo.pid_dq_hz "
            f"{hertz:g}: firmware from ABI 0x010e on takes the latter alone"
        )
    if period is not None:
        yield from _too_fast(numbers, 1.0 / period)
    yield from _integral(numbers)
    if numbers.get("servo.voltage_mode_control"):
        yield "servo.voltage_mode_control 1: the current loops do not run, currents become voltages"
    if (
        numbers.get("servo.pid_position.ki", 0.0)
        > 0.0
        < numbers.get("servo.pid_position.ilimit", 0)
    ):
        yield (
            f"servo.pid_position.ki {numbers['servo.pid_position.ki']:g} with ilimit "
            f"{numbers['servo.pid_position.ilimit']:g} N m integrates the position error: that is "
            "not part of the speed loop evaluated here"
        )


def _feedforward(numbers: Numbers) -> Iterator[str]:
    share = numbers.get("servo.current_feedforward", 0.0)
    r_s, l_q = numbers.get("motor.resistance_ohm", 0.0), numbers.get("motor.inductance_q_H", 0.0)
    hertz = numbers.get("servo.pid_dq_hz", 0.0)
    if share > 0.0 < r_s and l_q > 0.0 < hertz:
        more = overshoot(share, 2.0 * math.pi * hertz * l_q / r_s)
        yield (
            f"servo.current_feedforward {share:g} adds R times the reference to the voltage: a "
            f"step of the q current overshoots by {more:.1%}, the margins stay"
        )


def _too_fast(numbers: Numbers, rate: float) -> Iterator[str]:
    key = "motor_position.sources.0.pll_filter_hz"
    value = numbers.get(key)
    if value is not None and value > 1.001 * rate / FILTER_SHARE:
        yield (
            f"{key} {value:g} Hz is above 1/{FILTER_SHARE:g} of the control's {rate:g} Hz, the "
            "most that moteus_tool sets for the filter of the encoder"
        )


def _integral(numbers: Numbers) -> Iterator[str]:
    """Gains written by hand whose integral does not go with resistance and inductance."""
    if "servo.pid_dq_hz" in numbers or "servo.pid_dq.kp" not in numbers:
        return
    kp, ki = numbers["servo.pid_dq.kp"], numbers.get("servo.pid_dq.ki", 0.0)
    r_s = numbers.get("motor.resistance_ohm", 0.0)
    inductance = numbers.get("motor.inductance_d_H", 0.0)
    if not (r_s > 0.0 and inductance > 0.0):
        return
    fitting = kp * r_s / inductance
    if abs(ki - fitting) > 0.02 * fitting:
        yield (
            f"servo.pid_dq.ki {ki:g} is not R/L kp = {fitting:.4g} V/(A s): edited by hand, or "
            "R or L were measured again"
        )


# What a voltage R times the reference, added to a PI controller that cancels the winding's pole,
# does to a step of the current.


def overshoot(share: float, ratio: float) -> float:
    """Largest excess of the current over a unit step of its reference, sampling left aside.

    The error of the step is A e^(-b t) + B e^(-t/tau) with the bandwidth b, the winding's time
    constant tau, B = -k/(b tau - 1) and A = 1 - B.

    Args:
        share: Part k of R times the reference that is added, 0..1.
        ratio: Bandwidth times the winding's time constant, positive.
    """
    if share <= 0.0:
        return 0.0
    if abs(ratio - 1.0) < 1e-6:
        ratio = 1.0 + 1e-6
    slow = -share / (ratio - 1.0)
    fast = 1.0 - slow
    # Time over tau at which e' = 0: -ratio fast e^(-ratio x) - slow e^(-x) = 0.
    inside = -ratio * fast / slow
    if inside <= 0.0:
        return 0.0
    x = math.log(inside) / (ratio - 1.0)
    error = fast * math.exp(-ratio * x) + slow * math.exp(-x)
    return max(-error, 0.0) if x > 0.0 else 0.0
