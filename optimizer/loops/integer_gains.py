"""Gains per unit, in double and as integers: a mantissa that uses its word, and a right shift.

A gain g between per-unit codes is mantissa / 2^shift. Plain Qn formats have shifts below the width
of the word; with power-of-two dividers the shift may be larger, so that small gains keep all their
digits.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import PerUnitBases
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import QFormats
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import LoopGains, loop_bases, per_unit, step_response
from dqforge.optimizer.loops.plants import PiLoop, SpeedLoop, StepResponse, current_step
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.sampled_systems import ComplexArray

GainStyle = Literal["power-of-two", "q"]


@dataclass(frozen=True, slots=True)
class FixedGain:
    """A gain in integers, mantissa / 2^shift.

    ``value`` is the real gain that it stands for, dimensionless (between per-unit codes).
    """

    mantissa: int
    shift: int
    value: float

    @property
    def realised(self) -> float:
        """The gain that the integers make."""
        return float(self.mantissa * 2.0**-self.shift)

    @property
    def error(self) -> float:
        """Relative error of the gain, 0 where the gain is 0."""
        return self.realised / self.value - 1.0 if self.value else 0.0

    @property
    def half(self) -> int:
        """Half of what the shift leaves, added before it to round to nearest."""
        return (1 << self.shift) >> 1

    def text(self) -> str:
        """Integers as they are written: ``20000 / 2^10``."""
        return f"{self.mantissa} / 2^{self.shift}"


def to_q(value: float, bits: int, width: Literal[16, 32] = 16) -> int:
    """Round value 2^bits to the nearest integer, halves away from zero.

    Args:
        value: The number, dimensionless.
        bits: Fractional bits, 0 to ``width`` - 1.
        width: Size of the signed integer that must hold the result, 16 (default) or 32 bits.

    Raises:
        NoSolutionError: If the integer does not fit, or if a value other than zero would become 0.
    """
    if not 0 <= bits < width:
        raise InputError(
            f"a Q format of int{width}_t has 0 to {width - 1} fractional bits, got {bits}"
        )
    if not np.isfinite(value):
        raise NoSolutionError(f"{value} cannot be written as an integer in Q{bits}")
    magnitude = int(np.floor(abs(value) * 2.0**bits + 0.5))
    result = -magnitude if value < 0.0 else magnitude
    if not -(2 ** (width - 1)) <= result < 2 ** (width - 1):
        raise NoSolutionError(
            f"{value:.6g} is {result} in Q{bits}, which int{width}_t cannot hold: use fewer "
            "fractional bits"
        )
    if result == 0 and value != 0.0:
        raise NoSolutionError(f"{value:.6g} rounds to 0 in Q{bits}: use more fractional bits")
    return result


def quantise(
    value: float, width: int, argument: int, style: GainStyle = "power-of-two"
) -> FixedGain:
    """Largest mantissa that a word of ``width`` bits holds and whose product with the
    argument twice the width holds.

    Args:
        value: The gain, dimensionless.
        width: Bits of the mantissa, 16 or 32; the product with half of what the shift leaves has
            twice as many.
        argument: Largest magnitude of what the gain is multiplied with.
        style: ``power-of-two``: any shift up to 2 width - 2; ``q``: below the width, as Qn formats
            have it.

    Raises:
        NoSolutionError: The gain is too large for the mantissa even without a shift, or so small
            that it becomes 0.
    """
    largest = width - 1 if style == "q" else 2 * width - 2
    if value == 0.0:
        return FixedGain(0, 0, 0.0)
    for shift in range(largest, -1, -1):
        mantissa = rounded_mantissa(value, shift)
        if abs(mantissa) < 2 ** (width - 1) and abs(mantissa) * argument + (
            (1 << shift) >> 1
        ) < 2 ** (2 * width - 1):
            if mantissa == 0:
                raise NoSolutionError(
                    f"{value:.4g} is 0 in {width} bits with a shift of {shift}; use other bases"
                )
            return FixedGain(mantissa, shift, value)
    raise NoSolutionError(
        f"{value:.4g} is more than int{width}_t holds; use larger bases of what it multiplies"
    )


def given(value: float, bits: int, width: Literal[16, 32] = 16) -> FixedGain:
    """A gain in a format that was asked for; errors as `to_q`.

    Args:
        value: The gain as a real number.
        bits: Fractional bits of the format.
        width: Bits of the integer.
    """
    return FixedGain(to_q(value, bits, width), bits, value)


def rounded_mantissa(value: float, bits: int) -> int:
    """Value 2^bits rounded to the nearest integer, halves away from zero.

    ``value`` is dimensionless.
    """
    magnitude = int(abs(value) * 2.0**bits + 0.5)
    return -magnitude if value < 0.0 else magnitude


def pi_integers(
    kp: float, ki_ts: float, q_formats: QFormats | None
) -> tuple[FixedGain, FixedGain] | None:
    """Integers of 16 bits of kp and ki t_s per unit in the formats of the settings,
    None where none are asked for.

    ``auto`` gives each gain the plain Qn format, n up to 30, with the most digits.

    Args:
        kp, ki_ts: Gain and integral gain times the sampling period, per unit.
        q_formats: Fractional bits of both, ``auto``, or None.

    Raises:
        NoSolutionError: An integer does not fit its format, or becomes 0.
    """
    if q_formats is None:
        return None
    if q_formats == "auto":
        argument = 2**16 - 1  # an error of two full scales
        return quantise(kp, 16, argument), quantise(ki_ts, 16, argument)
    return given(kp, q_formats[0]), given(ki_ts, q_formats[1])


@dataclass(frozen=True, slots=True)
class PerUnitGains:
    """Gains of one loop between per-unit quantities: ``kp`` and ``ki_ts`` = ki t_s, dimensionless.

    ``integers`` are those of 16 bits in the formats that the design asks for, (kp, ki t_s); None
    where it asks for none.
    """

    kp: float
    ki_ts: float
    integers: tuple[FixedGain, FixedGain] | None


def per_unit_gains(
    gains: LoopGains, bases: PerUnitBases, q_formats: QFormats | None
) -> PerUnitGains:
    """Gains of a loop per unit of the bases, as real numbers and as integers.

    Errors as `pi_integers`.

    Args:
        gains: The loop, gains in SI units.
        bases: Per-unit bases in SI units.
        q_formats: Fractional bits of both gains, ``auto``, or None.
    """
    kp, ki_ts = per_unit(gains, *loop_bases(bases, gains.loop))
    return PerUnitGains(kp, ki_ts, pi_integers(kp, ki_ts, q_formats))


# Both current loops together while the machine turns: what the decoupling
# leaves over couples them.
#
# Each axis alone is judged as if the decoupling were perfect. It is not: its inductances are those
# of the design, it works with currents one period old, and the voltage stands still in the stator
# while the rotor turns on. With d + j q:
#
#     l_d di_d/dt = -R i_d + omega l_q i_q + g v_d,
#         l_q di_q/dt = -R i_q - omega l_d i_d + g v_q (- omega psi)
#     v(k T + s)  = exp(j omega (a - T - s)) v[k-1],   0 <= s < T
#                 a: angle advance of the emitted control, in time
#     v[k]        = -(kp + ki T) i[k] + I[k-1] + (-omega l_q' i_q[k], omega l_d' i_d[k]),
#                 I[k] = I[k-1] - ki T i[k]
#
# for references of zero; magnets and references are inputs and move no pole. The poles are the
# eigenvalues of this map of (i, v, I), six states.


@dataclass(frozen=True, slots=True)
class TurningMachines:
    """M windings that turn, arrays of shape (M,).

    ``r_s`` in Ohm, ``l_d`` and ``l_q`` in H, ``gain`` of the voltage,
    ``omega_e`` electrical speed in rad/s.
    """

    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    gain: FloatArray
    omega_e: FloatArray


@dataclass(frozen=True, slots=True)
class CurrentControl:
    """What the emitted current control works with.

    ``kp`` in V/A and ``ki_ts`` in V/A are those of (d, q), ``l_d`` and ``l_q`` in H the
    decoupling's, ``advance`` in s the time by which its voltage is turned ahead, ``t_s`` in s the
    sampling period.
    """

    kp: tuple[float, float]
    ki_ts: tuple[float, float]
    l_d: float
    l_q: float
    advance: float
    t_s: float


def closed_matrices(machines: TurningMachines, control: CurrentControl) -> FloatArray:
    """Maps of (i_d, i_q, v_d, v_q, I_d, I_q) over one sampling period, shape (M, 6, 6).

    Args:
        machines: M machines at constant electrical speeds.
        control: Gains, decoupling and sampling period.
    """
    from scipy.linalg import expm

    count, omega = len(machines.omega_e), machines.omega_e
    flow = np.zeros((count, 4, 4))
    flow[:, 0, 0], flow[:, 0, 1] = -machines.r_s / machines.l_d, omega * machines.l_q / machines.l_d
    flow[:, 1, 0], flow[:, 1, 1] = (
        -omega * machines.l_d / machines.l_q,
        -machines.r_s / machines.l_q,
    )
    flow[:, 0, 2], flow[:, 1, 3] = machines.gain / machines.l_d, machines.gain / machines.l_q
    flow[:, 2, 3], flow[:, 3, 2] = omega, -omega  # the voltage stands still while the rotor turns
    held = expm(flow * control.t_s)
    turn = omega * (control.advance - control.t_s)
    rotation = np.moveaxis(
        np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]), -1, 0
    )
    matrix = np.zeros((count, 6, 6))
    matrix[:, :2, :2], matrix[:, :2, 2:4] = held[:, :2, :2], held[:, :2, 2:] @ rotation
    proportional = np.array(control.kp) + np.array(control.ki_ts)
    matrix[:, 2, 0], matrix[:, 3, 1] = -proportional[0], -proportional[1]
    matrix[:, 2, 1], matrix[:, 3, 0] = -omega * control.l_q, omega * control.l_d
    matrix[:, 2, 4] = matrix[:, 3, 5] = matrix[:, 4, 4] = matrix[:, 5, 5] = 1.0
    matrix[:, 4, 0], matrix[:, 5, 1] = -control.ki_ts[0], -control.ki_ts[1]
    return matrix


def largest_pole(machines: TurningMachines, control: CurrentControl) -> FloatArray:
    """Largest modulus of the poles of both loops together, shape (M,); stable below 1.

    Args:
        machines: M machines at constant electrical speeds.
        control: Gains, decoupling and sampling period.
    """
    poles = np.linalg.eigvals(closed_matrices(machines, control))
    return np.asarray(np.max(np.abs(poles), axis=1), dtype=np.float64)


# Answers of the control loops over time and frequency: closed loops to a step,
# open loops to a sine.

_CURRENT_TIME, _SPEED_TIME = 9.0, 22.0  # Length of a step response in 1/crossover.
_LEAST_SAMPLES = 12.0
_BELOW_CROSSOVER = 40.0
_FREQUENCIES = 160


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """How one loop answers.

    Args:
        gains: The loop.
        step: Answer of the closed loop to a unit step of its reference; of a speed loop on an
            observer that at its samples.
        frequency: Hz, ascending, shape (N,).
        gain, phase: Of the open loop there, as a factor and in degrees, shape (N,).
        phase_at_crossover: The same phase at the crossover of ``gains``, in degrees.
    """

    gains: LoopGains
    step: StepResponse
    frequency: FloatArray
    gain: FloatArray
    phase: FloatArray
    phase_at_crossover: float


def loop_responses(
    i_d: LoopGains, i_q: LoopGains, speed: LoopGains | None, zero: LoopGains | None = None
) -> tuple[LoopResponse, ...]:
    """Step and frequency responses of the loops; without the speed loop where its
    observer makes it unstable.

    Args:
        i_d, i_q: The current loops; their step responses are of one length.
        speed: The speed loop, None where there is none.
        zero: The loop of the zero-sequence current, None where nothing drives one.
    """
    currents = [i_d, i_q] if zero is None else [i_d, i_q, zero]
    loops = currents if speed is None else [*currents, speed]
    low = min(loop.crossover for loop in loops) / _BELOW_CROSSOVER
    longest = max(_CURRENT_TIME / loop.crossover for loop in currents)
    found = [
        _response(loop, step_response(loop, max(longest, _LEAST_SAMPLES * loop.t_s)), low)
        for loop in currents
    ]
    if speed is not None and (speed.observed is None or speed.observed.stable):
        found.append(_response(speed, _speed_step(speed), low))
    return tuple(found)


def _speed_step(speed: LoopGains) -> StepResponse:
    shown = _SPEED_TIME / speed.crossover
    if isinstance(speed.model, SpeedLoop):
        return step_response(speed, max(shown, _LEAST_SAMPLES * speed.t_s))
    # On an observer: the loop has the same shape as one of a current.
    return current_step(speed.model, int(max(shown / speed.t_s, _LEAST_SAMPLES)))


def _open_loop(model: PiLoop | SpeedLoop) -> PiLoop:
    return model.loop if isinstance(model, SpeedLoop) else model


def _response(gains: LoopGains, step: StepResponse, low: float) -> LoopResponse:
    """``low`` is the least angular frequency in rad/s."""
    open_loop = _open_loop(gains.model).open_loop
    omega = np.unique(
        np.append(np.geomspace(low, np.pi / open_loop.t_s, _FREQUENCIES), gains.crossover)
    )
    response = open_loop.response(omega)
    phase = _phase(response)
    at = float(phase[np.searchsorted(omega, gains.crossover)])
    return LoopResponse(gains, step, omega / (2.0 * np.pi), np.abs(response), phase, at)


def _phase(response: ComplexArray) -> FloatArray:
    """Continuous phase in degrees that begins between -270 and 90."""
    phase = np.degrees(np.unwrap(np.angle(response)))
    return np.asarray(phase - (360.0 if phase[0] > 90.0 else 0.0), dtype=np.float64)


# Inductances that current loops are tuned for, and their range over the currents.


def inductance_range(
    machine: Machine, i_max: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Least and largest incremental inductances (l_d, l_q) in H along the
    MTPA locus up to ``i_max`` A.

    Current loops are tuned for the least ones: a loop is fastest there, so that it is slower and
    has more margin everywhere else.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
    """
    if isinstance(machine, LinearMachine):
        return (machine.l_d, machine.l_q), (machine.l_d, machine.l_q)
    locus = mtpa_locus(machine, i_max)
    jet = machine.jet(locus.i_d, locus.i_q)
    least, largest = ((float(of(jet.l_dd)), float(of(jet.l_qq))) for of in (np.min, np.max))
    return least, largest
