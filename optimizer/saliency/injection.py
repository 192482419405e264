"""Injection as a tracker: square wave at half the sampling frequency, sine along the assumed d axis
or a rotating voltage; docs/methods/estimators.md has the equations,
`dqforge.optimizer.saliency.wave_steps` the steps of the firmware.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import InjectionWave
from dqforge.machines.records import dataclass
from dqforge.optimizer.estimators.tracker import Tracker
from dqforge.optimizer.observers.sampled_machine import electrical_limit
from dqforge.optimizer.observers.tuning_numbers import usual_disturbances
from dqforge.optimizer.saliency.saliency_map import LoadedSaliency, along_locus, require_saliency
from dqforge.optimizer.saliency.sampled_injection import DELAY, LONGEST, admittance
from dqforge.optimizer.saliency.wave_loop import angle_noise, largest_pole, wave_tracking
from dqforge.optimizer.saliency.wave_steps import POINTS, WaveGains, wave_start, wave_step

# Natural frequency in rad/s of the phase-locked loop, unless the design says otherwise.
FASTEST_LOOP = 2.0 * math.pi * 40.0

# Largest standard deviation of the angle in rad that the noise of the current may cause.
NOISE_ANGLE = math.radians(5.0)

# Standard deviation down to which the usual voltage is raised where it can be.
QUIET_ANGLE = math.radians(2.0)
MOST_OF_LINK = 0.28  # Share of the dc link that the usual voltage never exceeds.
_SAMPLES = 10
_NARROW = 0.95  # Modulus of the poles of the notch of sine and rotating voltage.


def usual_voltage(design: Design) -> float:
    """The smaller of a tenth of the dc link and what makes a fifth of the largest current in a
    period, in V: where the noise of the current leaves it enough.
    """
    l_d = linearised(design.machine).l_d
    return min(0.1 * design.inverter.v_dc, 0.2 * design.i_max * l_d / design.control.t_s)


def usual_loop(t_s: float) -> float:
    """Natural frequency in rad/s."""
    return min(0.01 / t_s, FASTEST_LOOP)


def pll_gains(bandwidth: float, damping: float, t_s: float) -> tuple[float, float]:
    """k_p, and k_i in 1/s, that put two poles at exp(s t_s), s^2 + 2 damping bandwidth s +
    bandwidth^2 = 0.
    """
    roots = np.exp(np.roots([1.0, 2.0 * damping * bandwidth, bandwidth**2]) * t_s)
    product, total = float(np.real(np.prod(roots))), float(np.real(np.sum(roots)))
    return 1.0 - product, (1.0 + product - total) / t_s


def notch(wave: InjectionWave, samples: int) -> tuple[float, float, float, float, float]:
    """Coefficients that take the injected frequency out of the current and leave a steady one.

    Square wave: (3 + 2/z - 1/z^2)/4, nothing at half the sampling frequency, no lag of a ramp.
    """
    if wave == "square":
        return 0.75, 0.5, -0.25, 0.0, 0.0
    cosine = math.cos(2.0 * math.pi / samples)
    a_1, a_2 = -2.0 * _NARROW * cosine, _NARROW**2
    whole = (1.0 + a_1 + a_2) / (2.0 - 2.0 * cosine)
    return whole, -2.0 * cosine * whole, whole, a_1, a_2


def _wave(
    wave: InjectionWave, samples: int, voltage: float, difference: complex
) -> tuple[tuple[tuple[float, ...], ...], float]:
    """(carrier d or alpha, beta, reference, beta), and what a radian demodulates to, in A.

    ``difference`` is Y_d - Y_q in A/V at the injected frequency.
    """
    n = np.arange(samples)
    turn = 2.0 * np.pi / samples
    carrier = voltage * np.cos(turn * n)
    if wave == "square":
        # the sum of two directions and of two differences, each 2 V Y eps
        found = (carrier, np.empty(0), np.cos(turn * n), np.empty(0))
        return _floats(found), -8.0 * voltage * difference.real
    phase = turn * (n - DELAY) + np.angle(difference)
    if wave == "sine":
        found = (carrier, np.empty(0), np.cos(phase), np.empty(0))
        return _floats(found), 0.5 * samples * voltage * abs(difference)
    found = (carrier, voltage * np.sin(turn * n), np.cos(phase), np.sin(phase))
    return _floats(found), samples * voltage * abs(difference)


def _floats(parts: tuple[FloatArray, ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(part.tolist()) for part in parts)


def _settings(
    design: Design, settings: ObserverSettings
) -> tuple[InjectionWave, int, float | None]:
    """Wave, samples per period and voltage in V, None where it is left open."""
    wave: InjectionWave = settings.wave or "square"
    samples = settings.samples or (2 if wave == "square" else _SAMPLES)
    if wave == "square" and samples != 2:
        raise InputError(
            f"control.observer.samples: a square wave changes its sign every sample, got "
            f"{samples}; write 2, or wave: sine"
        )
    if wave != "square" and samples not in range(6, LONGEST + 1, 2):
        raise InputError(
            f"control.observer.samples: {wave} takes 6, 8, ... {LONGEST} samples per period, got "
            f"{samples}"
        )
    voltage, most = settings.voltage, 0.5 * design.inverter.v_dc / math.sqrt(3.0)
    if voltage is not None and voltage > most:
        raise InputError(
            f"control.observer.voltage: {voltage:.4g} V leave nothing for the current control; "
            f"write at most {most:.4g} V, half of what the link of {design.inverter.v_dc:g} V gives"
        )
    return wave, samples, voltage


def design_injection(design: Design, settings: ObserverSettings) -> WaveGains:
    """Gains of the firmware.

    Raises:
        InputError: A setting is out of range.
        NoSolutionError: The saliency or the voltage is too small, or the loop too fast.
    """
    if design.phase_machine is not None:
        raise NoSolutionError(
            "control.observer: injection needs a control that adds its voltage, which machines of "
            "model: waveform have not; choose third-harmonic, or an observer"
        )
    wave, samples, voltage = _settings(design, settings)
    loaded = along_locus(design, POINTS)
    require_saliency(loaded, "injection")
    t_s = design.control.t_s
    bandwidth = usual_loop(t_s) if settings.pll_bandwidth is None else settings.pll_bandwidth
    damping = 1.0 if settings.damping is None else settings.damping
    if not bandwidth * t_s <= 0.5:
        raise InputError(
            f"control.observer.pll_bandwidth: {bandwidth:g} rad/s are too fast; write at most "
            f"{0.5 / t_s:g} rad/s"
        )
    shape = _Shape(design, loaded, wave, samples, pll_gains(bandwidth, damping, t_s))
    first = _gains(shape, usual_voltage(design) if voltage is None else voltage)
    _require_stable(first)
    if voltage is not None:
        _require_quiet(first, design)
        return first
    gains = _gains(shape, _raised(first, design))
    _require_quiet(gains, design)
    return gains


@dataclass(frozen=True, slots=True)
class _Shape:
    """All but the voltage: the design, its saliency along the load, wave, samples per period, and
    k_p and k_i of the loop.
    """

    design: Design
    loaded: LoadedSaliency
    wave: InjectionWave
    samples: int
    loop: tuple[float, float]


def _gains(shape: _Shape, voltage: float) -> WaveGains:
    machine, t_s = linearised(shape.design.machine), shape.design.control.t_s
    y, loaded = admittance(machine, t_s, shape.samples), shape.loaded
    parts, whole = _wave(shape.wave, shape.samples, voltage, complex(y[0, 0] - y[1, 1]))
    share = loaded.y_delta / (0.5 * (1.0 / machine.l_d - 1.0 / machine.l_q))
    cosine = np.cos(2.0 * loaded.axis)
    return WaveGains(
        t_s=t_s,
        k_p=shape.loop[0],
        k_i=shape.loop[1],
        omega_max=electrical_limit(machine, t_s, None),
        notch=notch(shape.wave, shape.samples),
        per_ampere=(POINTS - 1) / float(loaded.i_q[-1]),
        scale=tuple((1.0 / (whole * share * cosine)).tolist()),
        shift=tuple((0.5 * np.tan(2.0 * loaded.axis) + 0.0).tolist()),
        carrier=parts[0],
        carrier_beta=parts[1],
        reference=parts[2],
        reference_beta=parts[3],
        rest=tuple((t_s * (loaded.y_sum - loaded.y_delta * np.cos(2.0 * loaded.axis))).tolist()),
    )


def current_noise(design: Design) -> float:
    """Standard deviation of a measured current in A, as observers are judged with."""
    machine = linearised(design.machine)
    return usual_disturbances(machine, design.inverter.v_dc, 1.0).i_noise


def _raised(gains: WaveGains, design: Design) -> float:
    """The voltage in V that leaves little noise, as far as the link allows."""
    voltage, noise = gains.carrier[0], angle_noise(gains, current_noise(design))
    most = max(MOST_OF_LINK * design.inverter.v_dc, voltage)
    return min(voltage * max(noise / QUIET_ANGLE, 1.0), most)


def _require_stable(gains: WaveGains) -> None:
    """Refuse a loop that swings."""
    if largest_pole(gains) >= 1.0:
        raise NoSolutionError(
            "control.observer: the loop is too fast for the delay of the injected voltage: its "
            f"largest pole is {largest_pole(gains):.4g}; write a smaller pll_bandwidth"
        )


def _require_quiet(gains: WaveGains, design: Design) -> None:
    """Refuse a voltage that noise hides."""
    noise = angle_noise(gains, current_noise(design))
    if noise > NOISE_ANGLE:
        raise NoSolutionError(
            f"control.observer: {current_noise(design):.3g} A of current noise make the angle of "
            f"the injection wander by {math.degrees(noise):.3g} deg (r.m.s.), "
            f"{math.degrees(NOISE_ANGLE):.3g} are permitted; write voltage: "
            f"{gains.carrier[0] * noise / NOISE_ANGLE:.3g} V or more, a smaller pll_bandwidth, or "
            "a slower wave"
        )


def _speeds(design: Design, gains: WaveGains) -> tuple[float, float]:
    """From standstill to where a turn lasts ten injected periods or the voltage leaves no room for
    the injection.
    """
    machine = linearised(design.machine)
    samples = max(len(gains.carrier), 4)
    turn = 2.0 * math.pi / (10.0 * samples * gains.t_s)
    voltage = max(gains.carrier)
    i_q = (POINTS - 1) / gains.per_ampere
    room = design.inverter.v_dc / math.sqrt(3.0) - voltage - machine.r_s * i_q
    flux = math.hypot(machine.psi_pm, machine.l_q * i_q)
    return 0.0, min(turn, room / flux, gains.omega_max)


def _in_words(gains: WaveGains) -> str:
    wave = "rotating" if gains.carrier_beta else ("square" if len(gains.carrier) == 2 else "sine")
    frequency = 1.0 / (len(gains.carrier) * gains.t_s)
    bandwidth = math.sqrt(gains.k_i / gains.t_s)
    return (
        f"{wave} wave of {max(gains.carrier):.4g} V at {frequency:.4g} Hz; loop "
        f"{bandwidth:.4g} rad/s"
    )


TRACKER = Tracker(
    name="injection",
    code="injection",
    title="injected voltage that shows the saliency, with phase-locked loop",
    design=design_injection,
    start=wave_start,
    step=wave_step,
    gains=WaveGains,
    speeds=_speeds,
    in_words=_in_words,
    injects=True,
    loop=wave_tracking,
)
