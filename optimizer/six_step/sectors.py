"""The six sectors of block commutation: which phase is fed, which returns, which floats.

In sector s the current vector lies at -30 + 60 s electrical degrees. Turning forwards it is fed
while the d axis lies 120 to 60 degrees behind it, turning backwards 60 to 120 degrees ahead of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.phase_machines.phase_machine import (
    ANGLES,
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
    grid,
)
from dqforge.machines.records import dataclass

FED = (0, 0, 1, 1, 2, 2)  # Phase (0, 1, 2 for a, b, c) whose leg switches, by sector.
RETURN = (1, 2, 2, 0, 0, 1)  # Phase that returns the current, by sector.
FLOATING = (2, 1, 0, 2, 1, 0)  # Phase whose leg rests, by sector.
SECTOR = np.pi / 3.0


def middle(sector: int, direction: int) -> float:
    """Electrical angle in rad of the d axis in the middle of a sector, where the back-EMF of the
    phase that floats is zero for waveforms without even harmonics.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return -np.pi / 6.0 + SECTOR * sector - direction * np.pi / 2.0


# What the waveform of a machine makes of block commutation.
#
# The terminals of the fed and of the returning phase lie at both rails, and the drops over their
# resistances and (equal) inductances cancel. Against the mean of all three terminals, a star of
# three resistors, the phase k that floats then shows
#
#     u = v_k - (v_a + v_b + v_c)/3 = omega_e g_k(theta),     g_k = f_k - (f_a + f_b + f_c)/3
#
# with f the back-EMF over the electrical speed: harmonics of the orders 3, 9, ... fall out. It
# crosses zero at theta_z; the current is handed on at theta_c, where the EMF of the phase that
# comes equals that of the phase that goes. For a sine theta_c - theta_z is 30 degrees and the
# integral in between psi (1 - cos 30 deg) = 0.134 psi; here both are those of the waveform itself.

_TURN = 2.0 * np.pi / 3.0


_UNFIT = "control.observer: {} is no waveform for blocks of 120 deg; write another observer"


_SALIENT = 1e-6  # relative difference of inductances above which a machine counts as salient


@dataclass(frozen=True, slots=True)
class BlockShape:
    """A waveform in block commutation, turning forwards (backwards it is the same, mirrored).

    Args:
        crossings: Electrical angles of the zero crossings in rad, of the sectors 0 to 5.
        delay: theta_c - theta_z in rad, mean of all sectors.
        spread: Largest deviation of a commutation by the means above from where it belongs, in rad.
        threshold: Integral of the voltage over time from crossing to commutation, in V s.
        slope: Least |dg/dtheta| at a crossing, in V s/rad^2.
        level: Least |g| at a commutation, in V s/rad.
        torque: Mean torque over the current in N m/A; ``ripple`` the peak to peak of it under
            constant current, over the mean.
        emf: Mean voltage of the two phases in series over the electrical speed, in V s/rad;
            ``peak`` its largest value.
    """

    crossings: tuple[float, ...]
    delay: float
    spread: float
    threshold: float
    slope: float
    level: float
    torque: float
    ripple: float
    emf: float
    peak: float


def phases_of(machine: Machine, phases: AnyPhaseMachine | None) -> AnyPhaseMachine:
    """The machine in phase quantities: as it is, or made of constant dq parameters.

    Args:
        machine: In dq coordinates.
        phases: Its phases where its back-EMF is no sine, None for others.

    Raises:
        NoSolutionError: Its inductances depend on the current.
    """
    if phases is not None:
        return phases
    if not isinstance(machine, LinearMachine):
        raise NoSolutionError(
            "control.observer: six-step drives are designed for constant inductances; write "
            "machine.model: linear or waveform"
        )
    theta = grid(ANGLES) - _TURN * np.arange(3)[:, np.newaxis]
    mean = 0.5 * (machine.l_d + machine.l_q)
    made = PhaseMachine(
        machine.pole_pairs,
        machine.r_s,
        mean,  # the star point floats: only the difference to the mutual inductance counts
        0.0,
        -machine.psi_pm * np.sin(theta),
        machine.i_max,
    )
    if abs(machine.l_q - machine.l_d) <= _SALIENT * mean:
        return made
    return SalientPhaseMachine.with_second_harmonic(made, (machine.l_d - machine.l_q) / 3.0)


def dq_inductances(machine: AnyPhaseMachine) -> tuple[float, float]:
    """Means of the inductances along and across the magnets in H.

    Args:
        machine: In phase quantities.
    """
    if isinstance(machine, SalientPhaseMachine):
        return machine.dq_inductances
    return (machine.l_s - machine.m_s,) * 2


def _series(waveform: FloatArray, turns: int) -> Callable[[FloatArray], FloatArray]:
    """The trigonometric polynomial through a periodic waveform, over electrical angles in rad."""
    spectrum = np.fft.rfft(waveform) * (2.0 / waveform.size)
    spectrum[0] *= 0.5
    spectrum = spectrum[: (waveform.size + 1) // 2]
    used = np.flatnonzero(np.abs(spectrum) > 1e-13 * np.max(np.abs(spectrum)))

    def at(theta: FloatArray) -> FloatArray:
        angle = np.multiply.outer(np.asarray(theta) / turns, used)
        return np.asarray(np.real(np.exp(1j * angle) @ spectrum[used]))

    return at


def _zero(function: Callable[[FloatArray], FloatArray], near: float, what: str) -> float:
    """The zero of a function within 30 degrees of an angle in rad."""
    from scipy.optimize import brentq

    low, high = near - SECTOR / 2.0, near + SECTOR / 2.0
    ends = function(np.array([low, high]))
    if ends[0] * ends[1] >= 0.0:
        raise NoSolutionError(_UNFIT.format(f"{what} 30 deg and more off its place"))
    return float(brentq(lambda x: float(function(np.array(x))), low, high, xtol=1e-13))


def _difference(
    one: Callable[[FloatArray], FloatArray], two: Callable[[FloatArray], FloatArray]
) -> Callable[[FloatArray], FloatArray]:
    return lambda x: one(x) - two(x)


def block_shape(machine: AnyPhaseMachine) -> BlockShape:
    """What the waveform of a machine makes of block commutation.

    Args:
        machine: In phase quantities; pole pairs that differ from each other enter with all their
            sectors.

    Raises:
        NoSolutionError: A crossing lies where no block of 120 degrees can be placed by it.
    """
    flux, turns = machine.flux, turns_of(machine)
    seen = flux - np.mean(flux, axis=0)
    waves = [_series(wave, turns) for wave in seen]
    crossings = np.empty((turns, 6))
    ends = np.empty((turns, 6))
    areas, slopes, levels = [], [], []
    for turn in range(turns):
        for sector in range(6):
            near = middle(sector, 1) + 2.0 * np.pi * turn
            wave, sign = waves[FLOATING[sector]], 1.0 if sector % 2 else -1.0
            after = (sector + 1) % 6
            comes = waves[FLOATING[sector]]
            goes = waves[FED[sector] if FED[after] != FED[sector] else RETURN[sector]]
            start = _zero(wave, near, "a zero crossing of the back-EMF")
            end = _zero(_difference(comes, goes), near + SECTOR / 2.0, "a crossing of two EMFs")
            crossings[turn, sector], ends[turn, sector] = start - near, end - near
            line = np.linspace(start, end, 401)
            along = sign * wave(line)
            if np.min(along) < -1e-6 * np.max(np.abs(along)):
                raise NoSolutionError(_UNFIT.format("a back-EMF that crosses zero once more"))
            areas.append(float(np.trapezoid(along, line)))
            slopes.append(sign * float(np.diff(wave(start + np.array([-1e-4, 1e-4])))[0]) / 2e-4)
            levels.append(sign * float(wave(np.array(end))))
    delay, mean = float(np.mean(ends - crossings)), np.mean(crossings, axis=0)
    current = _block_emf(waves, float(np.mean(ends)) - SECTOR / 2.0, turns)
    return BlockShape(
        crossings=tuple(float(middle(n, 1) + mean[n]) for n in range(6)),
        delay=delay,
        spread=float(np.max(np.abs(ends - (crossings + delay)))),
        threshold=float(np.mean(areas)),
        slope=min(slopes),
        level=min(levels),
        torque=machine.pole_pairs * float(np.mean(current)),
        ripple=float(np.ptp(current) / np.mean(current)),
        emf=float(np.mean(current)),
        peak=float(np.max(current)),
    )


def turns_of(machine: AnyPhaseMachine) -> int:
    """Electrical periods after which the waveform repeats.

    Args:
        machine: In phase quantities.
    """
    return (machine.phases if isinstance(machine, SalientPhaseMachine) else machine).turns


def _block_emf(
    waves: list[Callable[[FloatArray], FloatArray]], ahead: float, turns: int
) -> FloatArray:
    """Back-EMF of the two phases in series over the electrical speed within the blocks."""
    places = np.arange(120, dtype=np.float64) + 0.5
    inside: FloatArray = np.asarray(places / 120.0 * SECTOR - SECTOR / 2.0 + ahead)
    parts = []
    for turn in range(turns):
        for sector in range(6):
            theta: FloatArray = middle(sector, 1) + 2.0 * np.pi * turn + inside
            parts.append(_difference(waves[FED[sector]], waves[RETURN[sector]])(theta))
    return np.concatenate(parts)
