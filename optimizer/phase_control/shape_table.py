"""The table of the back-EMF that the firmware gets: as small as the torque permits."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import PhaseShape
from dqforge.optimizer.phase_control.shape_vectors import flux_at, torque_of, unit_currents

# Nodes per electrical period that are tried: multiples of 24, so that corners at multiples of 15
# degrees can lie on nodes.
SIZES = (*range(24, 481, 24), *range(576, 1537, 96))

# Torque ripple, peak to peak over the torque, that the emitted control keeps in steady state at 400
# samples per electrical period, as far as its table can.
RIPPLE = 5e-4

# Torque error of the table that is aimed at: half of the square of the ripple, since sampling
# leaves about as much.
SHAPE_ERROR = RIPPLE / 2.0**0.5

# Permitted error where no table reaches that, and of the flux where currents do not follow it.
LARGEST_ERROR = 1e-3
_SAME = 1e-9
_BAND = 1e-7
_DENSE = 7680


@dataclass(frozen=True, slots=True)
class ShapeFit:
    """A table and what it errs by.

    ``error`` is the torque that its currents make on the machine, peak to peak over the torque
    asked for; where currents do not follow it, the largest distance from the back-EMF over the
    fundamental's peak. ``samples`` are the angles that it was measured at.
    """

    shape: PhaseShape
    error: float
    samples: int


def has_equal_phases(machine: PhaseMachine) -> bool:
    """Whether b and c are phase a, a third and two thirds of the period later."""
    flux, third = machine.flux, machine.angles // 3
    scale = _SAME * float(np.max(np.abs(flux)))
    return all(bool(np.max(np.abs(np.roll(flux[0], k * third) - flux[k])) <= scale) for k in (1, 2))


def shape_error(machine: PhaseMachine, shape: PhaseShape, *, zero: bool) -> tuple[float, int]:
    """Torque of a table's currents on the machine, peak to peak over the torque, and the number
    of angles.

    It is measured between the machine's own angles too where its waveform is band-limited, so
    that it is known there; else, as with corners, at its own angles.

    Args:
        machine: The machine.
        shape: The table.
        zero: Whether the zero sequence shares the torque.
    """
    flux = machine.flux
    if _is_band_limited(flux):
        count = machine.angles * -(-_DENSE * shape.turns // machine.angles)
        flux = resampled(flux, count)
    angle = 2.0 * np.pi * shape.turns * np.arange(flux.shape[1]) / flux.shape[1]
    unit = unit_currents(flux_at(shape, angle), machine.pole_pairs, zero=zero)
    torque = torque_of(clarke_matrix() @ flux, unit, machine.pole_pairs)
    return float(np.ptp(torque)), int(angle.size)


def flux_error(machine: PhaseMachine, shape: PhaseShape) -> tuple[float, int]:
    """Largest distance of a table from the back-EMF over the fundamental's peak, at the machine's
    own angles, and their number.

    Args:
        machine: The machine.
        shape: The table.
    """
    angle = 2.0 * np.pi * shape.turns * np.arange(machine.angles) / machine.angles
    away = flux_at(shape, angle) - clarke_matrix() @ machine.flux
    largest = float(np.max(np.linalg.norm(away, axis=0)))
    return largest / machine.psi_pm, machine.angles


def fit_shape(
    machine: PhaseMachine,
    *,
    zero: bool,
    turns: int = 1,
    currents: bool = True,
) -> ShapeFit:
    """The smallest table whose currents make the torque constant within `SHAPE_ERROR`; where none
    does, the smallest within `LARGEST_ERROR`.

    The machine's own angles are among the sizes: the data say no more.

    Args:
        machine: The machine.
        zero: Whether the zero sequence shares the torque.
        turns: Electrical periods of the machine's waveform.
        currents: Whether the currents follow the table; else it serves the voltage alone, and the
            error is that of the back-EMF, `LARGEST_ERROR` at most.

    Raises:
        NoSolutionError: No table up to 1536 nodes per electrical period keeps the bound.
    """
    equal = turns == 1 and has_equal_phases(machine)
    rows = machine.flux[:1] if equal else machine.flux
    own = machine.angles // turns
    sizes = sorted({*SIZES, *([own] if own <= SIZES[-1] and own % 3 == 0 else [])})
    aim = SHAPE_ERROR if currents else LARGEST_ERROR
    fits = []
    for size in sizes:
        shape = PhaseShape(resampled(rows, size * turns), turns)
        error, samples = (
            shape_error(machine, shape, zero=zero) if currents else flux_error(machine, shape)
        )
        fits.append(ShapeFit(shape, error, samples))
        if error <= aim:
            return fits[-1]
    for fit in fits:
        if fit.error <= LARGEST_ERROR:
            return fit
    least = min(fit.error for fit in fits)
    raise NoSolutionError(
        f"machine.back_emf: no table of up to {SIZES[-1]} nodes follows it, the torque errs by "
        f"{100.0 * least:.2g} % peak to peak where {100.0 * LARGEST_ERROR:.2g} % are permitted; "
        "smooth the measured waveform, or write control.current_loop.frame: dq"
    )


def resampled(waveform: FloatArray, count: int) -> FloatArray:
    """Periodic rows, shape (..., N), at ``count`` even angles, by trigonometric interpolation.

    Angles that the rows have themselves keep their values.
    """
    size = waveform.shape[-1]
    if size % count == 0:
        return np.asarray(waveform[..., :: size // count])
    # Values are read from a denser grid, so that a smaller one loses nothing by aliasing twice.
    factor = count // int(np.gcd(count, size))
    lines = np.fft.rfft(waveform, axis=-1)
    dense = np.fft.irfft(lines, n=size * factor, axis=-1) * factor
    return np.asarray(dense[..., :: size * factor // count])


def _is_band_limited(flux: FloatArray) -> bool:
    """Whether the upper half of the spectrum is empty, so that all between the angles is known."""
    lines = np.abs(np.fft.rfft(flux, axis=-1))
    return bool(np.max(lines[:, lines.shape[1] // 2 :]) <= _BAND * np.max(lines))
