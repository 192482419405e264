"""Steady angle errors of the flux observer on drives that differ from its data.

The current controllers hold the current that is commanded, i^ = i^_d + j i^_q in the angle of the
observer. In coordinates that turn with that angle, which is ahead of the rotor by delta, voltage,
flux linkage and the observer's two models are sums of three terms: a part that does not depend on
delta (resistance, mean inductance), one in exp(-j delta) (the magnet), one in exp(-2 j delta)
(saliency). So is the active flux that the phase-locked loop turns to,

    psi_a(delta) = c_0 + c_1 exp(-j delta) + c_2 exp(-2 j delta),

and three evaluations of the emitted equations give its coefficients exactly. The loop rests where
Im psi_a = 0 with Re psi_a > 0 and a falling Im psi_a: of all such angles that next to zero is the
error. It is a fixed point of `dqforge.optimizer.observers.steady_states`, found for 20,000 drives
in a fraction of a second.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.drive_motion import ComplexArray, Plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.methods.flux import flux_of_voltage
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.parts import EXACT
from dqforge.optimizer.observers.training import TrainingBox

# Share of the largest current below which a dead time takes less than its whole voltage.
SOFT = 0.02

# Angle error in rad beyond which the angle counts as lost: no correction would help.
LARGEST_ERROR = 2.0
NOISE = 0.003  # Standard deviation of the residual over psi_pm, on each axis, that is trained.
_GRID = np.radians(np.arange(-180.0, 181.0, 10.0))
_HALVINGS = 45


@dataclass(frozen=True, slots=True, eq=False)
class SteadyErrors:
    """M drives at rest in the observer's coordinates.

    ``omega`` in rad/s; ``current`` i_d + j i_q in A as it is controlled; ``residual`` flux linkage
    of the observer less that of its current model, d + j q in Wb; ``error`` estimated minus true
    angle in rad. All in the angle of the observer, shape (M,). ``held`` says which drives have a
    steady state at all.
    """

    omega: FloatArray
    current: ComplexArray
    residual: ComplexArray
    error: FloatArray
    held: NDArray[np.bool_]

    def only(self, rows: NDArray[np.bool_]) -> SteadyErrors:
        """Some of the drives."""
        return SteadyErrors(
            self.omega[rows],
            self.current[rows],
            self.residual[rows],
            self.error[rows],
            self.held[rows],
        )


# Voltage d + j q in V, at the end of a period in the frame of the rotor, that a steady state takes
# without current, and what one ampere of i_d and of i_q adds to it.
Volts = tuple[ComplexArray, ComplexArray, ComplexArray]


def volts_of(plant: Plants, omega: FloatArray, t_s: float) -> Volts:
    """Voltages of M machines at speeds in rad/s: exact, and linear in the current."""
    bare, along, across = (
        steady_voltage(plant, np.full(omega.shape, i), omega, t_s) for i in (0j, 1.0 + 0j, 1j)
    )
    return bare, along - bare, across - bare


def _flux(
    gains: FluxGains,
    volts: Volts,
    current: ComplexArray,
    omega: FloatArray,
    lost: ComplexArray,
    delta: float | FloatArray,
) -> tuple[ComplexArray, ComplexArray]:
    """Flux linkage of the observer and of its current model in Wb, in its own coordinates."""
    ahead, x = np.exp(1j * np.asarray(delta)), gains.path.t_s * omega
    i = current * ahead
    back = np.exp(-1j * x)
    v = volts[0] + volts[1] * i.real + volts[2] * i.imag + lost * ahead * np.exp(-0.5j * x)
    last, zero = i * back, np.zeros_like(omega)
    parts = [(z.real, z.imag) for z in (v, last, i)]
    gained = flux_of_voltage(EXACT, gains.path, (zero, zero), parts[0], parts[1], parts[2], x)
    alpha = np.minimum(gains.alpha_1 * np.abs(x) + gains.alpha_0, 1.0)
    model = gains.l_d * current.real + gains.psi_pm + 1j * gains.l_q * current.imag
    path = (gained[0] + 1j * gained[1]) / ahead
    psi = ((1.0 - alpha) * path + alpha * model) / (1.0 - (1.0 - alpha) * back)
    return np.asarray(psi, dtype=np.complex128), np.asarray(model, dtype=np.complex128)


def _coefficients(samples: list[ComplexArray]) -> list[ComplexArray]:
    """Those of a polynomial in exp(-j delta) by its values at three equal steps of a turn."""
    turns = 2.0 * np.pi * np.arange(3) / 3.0
    return [
        np.asarray(
            sum(value * np.exp(1j * n * turn) for value, turn in zip(samples, turns, strict=True))
            / 3.0
        )
        for n in range(3)
    ]


def _rest(c: list[ComplexArray]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The angle next to zero at which the loop rests, and whether there is one."""

    def value(delta: float | FloatArray) -> ComplexArray:
        turn = np.exp(-1j * np.asarray(delta))
        return np.asarray(c[0] + (c[1] + c[2] * turn) * turn)

    least = np.full(c[0].shape, np.inf)
    start = np.zeros(c[0].shape)
    before = value(_GRID[0])
    for low, high in zip(_GRID[:-1].tolist(), _GRID[1:].tolist(), strict=True):
        after = value(high)
        falls = (before.imag > 0.0) & (after.imag <= 0.0) & (before.real + after.real > 0.0)
        nearer = falls & (abs(0.5 * (low + high)) < least)
        least = np.where(nearer, abs(0.5 * (low + high)), least)
        start = np.where(nearer, low, start)
        before = after
    low_end, high_end = start, start + (_GRID[1] - _GRID[0])
    for _ in range(_HALVINGS):
        middle = 0.5 * (low_end + high_end)
        above = value(middle).imag > 0.0
        low_end, high_end = np.where(above, middle, low_end), np.where(above, high_end, middle)
    return 0.5 * (low_end + high_end), np.isfinite(least)


def steady_errors(
    gains: FluxGains,
    volts: Volts,
    current: ComplexArray,
    omega: FloatArray,
    lost: FloatArray,
    i_max: float,
) -> SteadyErrors:
    """Where the observer rests on M drives.

    Args:
        gains: Of the flux observer.
        volts: Of the true machines, see `volts_of`.
        current: i_d + j i_q in A in the angle of the observer, shape (M,).
        omega: Electrical speed in rad/s, not nil, shape (M,).
        lost: Voltage in V along the current that the observer knows nothing of, shape (M,).
        i_max: Largest current in A; below `SOFT` of it the lost voltage fades.
    """
    along = lost * current / np.sqrt(np.abs(current) ** 2 + (SOFT * i_max) ** 2)
    samples = []
    for delta in (2.0 * np.pi * np.arange(3) / 3.0).tolist():
        psi, _ = _flux(gains, volts, current, omega, along, delta)
        samples.append(psi - gains.l_q * current)
    error, held = _rest(_coefficients(samples))
    psi, model = _flux(gains, volts, current, omega, along, error)
    return SteadyErrors(omega, current, psi - model, error, held & (np.abs(error) < LARGEST_ERROR))


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """M drives, at a speed in rad/s each: the voltages that they take, the ``current`` i_d + j i_q
    in A that is commanded, the voltage ``lost`` along it in V, and the ``noise`` of the residual
    in Wb.
    """

    volts: Volts
    omega: FloatArray
    current: ComplexArray
    lost: FloatArray
    noise: ComplexArray
    i_max: float

    def at_rest(self, gains: FluxGains, correction: FloatArray | float = 0.0) -> SteadyErrors:
        """Where the observer rests if the currents are held in its angle with a correction.

        Args:
            gains: Of the flux observer.
            correction: Angle in rad that is added to the observer's, shape (M,) or one for all.
        """
        current = self.current * np.exp(1j * np.asarray(correction))
        found = steady_errors(gains, self.volts, current, self.omega, self.lost, self.i_max)
        return SteadyErrors(
            found.omega, found.current, found.residual + self.noise, found.error, found.held
        )


def drawn(machine: LinearMachine, box: TrainingBox, t_s: float, count: int, seed: int) -> Drives:
    """Drives of a box at any speed and current.

    Speeds are even in their logarithm, parameters and the lost voltage between their limits, i_q to
    both sides and i_d from its least value to a little above nought, within the largest current and
    a twentieth more. Forwards alone: backwards everything is mirrored.
    """
    generator = np.random.default_rng(seed)

    def between(low: float, high: float) -> FloatArray:
        return generator.uniform(low, high, count)

    omega = np.exp(between(float(np.log(box.omega_low)), float(np.log(box.omega_high))))
    plant = Plants(
        machine.r_s * (1.0 + between(*box.r_s)),
        machine.l_d * (1.0 + between(*box.l_d)),
        machine.l_q * (1.0 + between(*box.l_q)),
        machine.psi_pm * (1.0 + between(*box.psi_pm)),
    )
    largest = 1.05 * box.i_max
    i_d, i_q = between(box.i_d_low, 0.05 * box.i_max), between(-largest, largest)
    current: ComplexArray = i_d + 1j * i_q
    current /= np.maximum(1.0, np.abs(current) / largest)
    noise: ComplexArray = generator.standard_normal(count) + 1j * generator.standard_normal(count)
    noise *= NOISE * machine.psi_pm
    volts = volts_of(plant, omega, t_s)
    return Drives(volts, omega, current, between(*box.lost), noise, box.i_max)
