"""Many sampled PI loops at once: plants with different parameters, their
closed-loop poles and their margins.

The loop gain comes from poles alone. With the open loop c (zI - A)^-1 b and unity feedback,

    S(z) = 1/(1 + L(z)) = det(zI - A)/det(zI - A + b c),

a quotient of two products over eigenvalues. `dqforge.optimizer.sampled_systems` has the same
margins of one loop at a time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.optimizer.sampled_systems import GOLDEN, GOLDEN_STEPS

FloatArray = NDArray[np.float64]


ComplexArray = NDArray[np.complex128]


IndexArray = NDArray[np.intp]


POINTS_PER_DECADE = 80


EVEN_POINTS = 160


BISECTIONS = 52


@dataclass(frozen=True, slots=True)
class PlantBatch:
    """N plants x[k+1] = A x[k] + b u[k], y = x[measured], sampled every ``t_s`` s.

    Shapes: ``a`` (N, n, n), ``b`` (N, n).
    """

    a: FloatArray
    b: FloatArray
    measured: int
    t_s: float

    @property
    def size(self) -> int:
        """Number of plants N."""
        return int(self.a.shape[0])

    def some(self, places: IndexArray) -> PlantBatch:
        """The plants at indices of shape (M,)."""
        return PlantBatch(self.a[places], self.b[places], self.measured, self.t_s)


@dataclass(frozen=True, slots=True)
class LoopBatch:
    """N loops as poles in z: ``open_poles`` and ``closed_poles`` of shape (N, m),
    sampled every ``t_s`` s.
    """

    open_poles: ComplexArray
    closed_poles: ComplexArray
    t_s: float

    @property
    def radius(self) -> FloatArray:
        """Largest modulus of the closed-loop poles, shape (N,); below 1 the loop is stable."""
        return np.asarray(np.max(np.abs(self.closed_poles), axis=1), dtype=np.float64)

    def sensitivity(self, omega: FloatArray) -> ComplexArray:
        """S at frequencies in rad/s common to all loops, (F,) -> (N, F)."""
        return _quotient(
            np.exp(1j * omega * self.t_s)[np.newaxis, :], self.open_poles, self.closed_poles
        )

    def sensitivity_at(self, rows: IndexArray, omega: FloatArray) -> ComplexArray:
        """S of single loops, each at its own frequency in rad/s: (M,) and (M,) -> (M,)."""
        z = np.exp(1j * omega * self.t_s)[:, np.newaxis]
        return _quotient(z, self.open_poles[rows], self.closed_poles[rows])[:, 0]


@dataclass(frozen=True, slots=True)
class BatchMargins:
    """Margins of N loops as in `dqforge.optimizer.sampled_systems.LoopMargins`,
    arrays of shape (N,).

    ``radius`` is the largest modulus of a closed-loop pole; the margins mean
    something where it is below 1.
    """

    radius: FloatArray
    crossover: FloatArray
    phase_margin: FloatArray
    gain_margin: FloatArray
    delay_margin: FloatArray
    max_sensitivity: FloatArray


def _quotient(z: ComplexArray, zeros: ComplexArray, poles: ComplexArray) -> ComplexArray:
    above = np.ones(np.broadcast_shapes(z.shape, (len(poles), 1)), dtype=np.complex128)
    below = above.copy()
    for column in range(poles.shape[1]):  # one division in the end: each costs several products
        above *= z - zeros[:, column, np.newaxis]
        below *= z - poles[:, column, np.newaxis]
    return np.asarray(above / below)


def current_plants(
    r_s: FloatArray, inductance: FloatArray, t_s: float, gain: FloatArray
) -> PlantBatch:
    """Current loops' plants: L di/dt = g v - R i, one period of computation, zero-order hold.

    Args:
        r_s, inductance, gain: Resistance in Ohm (zero and negative ones are permitted), inductance
            in H and gain of the voltage, shape (N,).
        t_s: Sampling period in s.
    """
    r_s, inductance, gain = (
        np.asarray(v, dtype=np.float64) for v in np.broadcast_arrays(r_s, inductance, gain)
    )
    exponent = r_s * t_s / inductance
    small = np.abs(exponent) < 1e-8
    share = np.where(
        small, 1.0 - 0.5 * exponent, -np.expm1(-exponent) / np.where(small, 1.0, exponent)
    )
    a, b = np.zeros((len(r_s), 2, 2)), np.zeros((len(r_s), 2))
    a[:, 0, 0], a[:, 0, 1] = np.exp(-exponent), gain * share * t_s / inductance
    b[:, 1] = 1.0
    return PlantBatch(a, b, 0, t_s)


@dataclass(frozen=True, slots=True)
class DriveVariants:
    """N variants of a drive, arrays of shape (N,).

    ``r_s`` in Ohm, ``l_q`` in H, ``inertia`` in kg m^2; ``gain`` of the voltage; ``torque_factor``,
    torque over commanded torque; ``back_emf`` in V s/rad times N m/A: what the feedforward leaves
    of the back-EMF over the mechanical speed, times the torque constant that the controller
    assumes.
    """

    r_s: FloatArray
    l_q: FloatArray
    inertia: FloatArray
    gain: FloatArray
    torque_factor: FloatArray
    back_emf: FloatArray


def speed_plants(
    drive: DriveVariants,
    friction: FloatArray | float,
    t_s: float,
    current_gains: tuple[FloatArray | float, FloatArray | float],
    ratio: int,
    filter_time: FloatArray | float = 0.0,
) -> PlantBatch:
    """Speed loops' plants, from the commanded torque to the measured speed,
    exactly with both sampling rates.

    With x = K i_q, K the torque constant that the controller assumes,
    f the torque factor and e the back-EMF's rest::

        L dx/dt = g K v - R x - e omega,   J domega/dt = f x - B omega,   T_f dw/dt = omega - w

    Args:
        drive: The variants.
        friction: B in N m s/rad, one number or shape (N,).
        t_s: Sampling period of the current control in s.
        current_gains: kp in V/A and ki in V/(A s) of the q axis, one number each or shape (N,).
        ratio: Current samples per speed sample.
        filter_time: T_f in s of the filter on the measured speed, one number or shape (N,); 0 for
            none, of all variants alike.
    """
    from scipy.linalg import expm

    count, n = len(drive.r_s), 3 if np.all(np.asarray(filter_time) > 0.0) else 2
    block = np.zeros((count, n + 1, n + 1))
    block[:, 0, 0], block[:, 0, 1] = -drive.r_s / drive.l_q, -drive.back_emf / drive.l_q
    block[:, 1, 0], block[:, 1, 1] = drive.torque_factor / drive.inertia, -friction / drive.inertia
    if n == 3:
        block[:, 2, 1], block[:, 2, 2] = 1.0 / filter_time, -1.0 / filter_time
    block[:, 0, n] = drive.gain / drive.l_q
    held = expm(block * t_s)
    a, b = np.zeros((count, n + 1, n + 1)), np.zeros((count, n + 1))
    a[:, :n, :] = held[:, :n, :]  # the last column is the voltage of one sample ago
    b[:, n] = 1.0
    inner, entry = _open(PlantBatch(a, b, 0, t_s), current_gains[0], current_gains[1] * t_s)
    inner[:, :, 1] -= entry
    stepped = np.zeros((count, n + 3, n + 3))
    stepped[:, : n + 2, : n + 2], stepped[:, : n + 2, n + 2], stepped[:, n + 2, n + 2] = (
        inner,
        entry,
        1.0,
    )
    stepped = np.linalg.matrix_power(stepped, ratio)
    return PlantBatch(stepped[:, : n + 2, : n + 2], stepped[:, : n + 2, n + 2], n, t_s * ratio)


def _open(
    plants: PlantBatch, kp: FloatArray | float, ki_ts: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Matrices A, b of the open loop with a backward-Euler PI before each plant.

    The first state is its integral.
    """
    count, n = plants.b.shape
    a, b = np.zeros((count, n + 1, n + 1)), np.empty((count, n + 1))
    a[:, 0, 0], a[:, 1:, 0], a[:, 1:, 1:] = 1.0, plants.b, plants.a
    b[:, 0] = ki_ts
    b[:, 1:] = plants.b * np.broadcast_to(np.asarray(kp) + np.asarray(ki_ts), count)[:, np.newaxis]
    return a, b


def close_loops(plants: PlantBatch, kp: FloatArray | float, ki: FloatArray | float) -> LoopBatch:
    """Close a backward-Euler PI with gains kp and ki (1/s), one number or shape (N,),
    around every plant.

    Args:
        plants: N plants of one order.
        kp: Proportional gains, one number or shape (N,).
        ki: Integral gains per second, one number or shape (N,).
    """
    a, b = _open(plants, kp, np.asarray(ki) * plants.t_s)
    closed = a.copy()
    closed[:, :, 1 + plants.measured] -= b
    return LoopBatch(_eigenvalues(a), _eigenvalues(closed), plants.t_s)


def _eigenvalues(matrices: FloatArray) -> ComplexArray:
    return np.asarray(np.linalg.eigvals(matrices), dtype=np.complex128)


def _grid(loops: LoopBatch) -> FloatArray:
    """Frequencies in rad/s, ascending, from three decades below the slowest closed-loop
    pole to Nyquist (included).
    """
    nyquist = np.pi / loops.t_s
    moduli = loops.closed_poles[np.abs(loops.closed_poles) > 1e-6]
    slowest = float(np.min(np.abs(np.log(moduli)), initial=np.pi)) / loops.t_s
    low = min(max(1e-3 * slowest, 1e-6 * nyquist), 1e-2 * nyquist)
    spread = np.geomspace(low, nyquist, int(np.ceil(POINTS_PER_DECADE * np.log10(nyquist / low))))
    points = np.concatenate([spread, np.linspace(0.0, nyquist, EVEN_POINTS)[1:]])
    return np.asarray(np.unique(np.minimum(points, nyquist)), dtype=np.float64)


def _roots(
    loops: LoopBatch, values: FloatArray, omega: FloatArray, kind: str
) -> tuple[IndexArray, FloatArray]:
    """Loops and frequencies of the zero crossings of log|L| (``modulus``) or Im L
    (``imaginary``).
    """

    def function(sensitivity: ComplexArray) -> FloatArray:
        gain = 1.0 / sensitivity - 1.0
        return np.asarray(
            np.log(np.abs(gain)) if kind == "modulus" else gain.imag, dtype=np.float64
        )

    rows, columns = np.nonzero(np.sign(values[:, :-1]) * np.sign(values[:, 1:]) < 0)
    low, high = omega[columns], omega[columns + 1]
    sign = np.sign(values[rows, columns])
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        same = np.sign(function(loops.sensitivity_at(rows, middle))) == sign
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return rows, 0.5 * (low + high)


def _peaks(loops: LoopBatch, omega: FloatArray, size: FloatArray) -> FloatArray:
    """Largest |S| per loop, shape (N,): the grid's best local maxima and the resonances,
    refined by golden section.
    """
    best = np.max(size, axis=1)
    inner = size[:, 1:-1]
    at_peak = (
        (inner >= size[:, :-2]) & (inner >= size[:, 2:]) & (inner >= 0.8 * best[:, np.newaxis])
    )
    rows, columns = np.nonzero(at_peak)
    low, high = omega[columns], omega[columns + 2]
    angle = np.abs(np.angle(loops.closed_poles)) / loops.t_s
    resonant, which = np.nonzero((angle > omega[0]) & (np.abs(loops.closed_poles) > 0.9))
    centre = angle[resonant, which]
    rows = np.concatenate([rows, resonant])
    low, high = (
        np.concatenate([low, 0.98 * centre]),
        np.concatenate([high, np.minimum(1.02 * centre, omega[-1])]),
    )
    for _ in range(GOLDEN_STEPS):
        width = GOLDEN * (high - low)
        left, right = high - width, low + width
        rising = np.abs(loops.sensitivity_at(rows, left)) < np.abs(
            loops.sensitivity_at(rows, right)
        )
        low, high = np.where(rising, left, low), np.where(rising, high, right)
    np.maximum.at(best, rows, np.abs(loops.sensitivity_at(rows, 0.5 * (low + high))))
    return np.asarray(best, dtype=np.float64)


def peak_sensitivities(loops: LoopBatch) -> FloatArray:
    """M_s of many loops, inf where one is unstable, shape (N,)."""
    omega = _grid(loops)
    return np.where(
        loops.radius < 1.0, _peaks(loops, omega, np.abs(loops.sensitivity(omega))), np.inf
    )


def batch_margins(loops: LoopBatch) -> BatchMargins:
    """Crossovers and margins of many loops L(z) at z = exp(j omega t_s),
    the worst of several crossings per loop.

    As `dqforge.optimizer.sampled_systems.loop_margins`, all loops together.
    """
    count, omega = len(loops.closed_poles), _grid(loops)
    sensitivity = loops.sensitivity(omega)
    gain = 1.0 / sensitivity - 1.0

    rows, crossing = _roots(loops, np.log(np.abs(gain)), omega, "modulus")
    to_critical = np.angle(1.0 - 1.0 / loops.sensitivity_at(rows, crossing))
    phase, crossover = np.full(count, np.inf), np.full(count, np.nan)
    order = np.argsort(-np.abs(to_critical), kind="stable")  # the worst comes last and stays
    phase[rows[order]], crossover[rows[order]] = to_critical[order], crossing[order]
    delay = np.full(count, np.inf)
    np.minimum.at(delay, rows, np.mod(to_critical, 2.0 * np.pi) / crossing)

    rows, turns = _roots(loops, gain[:, :-1].imag, omega[:-1], "imaginary")
    real = np.concatenate([(1.0 / loops.sensitivity_at(rows, turns) - 1.0).real, gain[:, -1].real])
    rows = np.concatenate([rows, np.arange(count)])
    factor = np.where(real < 0.0, -1.0 / np.where(real < 0.0, real, -1.0), np.inf)
    gain_margin = np.full(count, np.inf)
    np.minimum.at(gain_margin, rows, np.where(factor > 1.0, factor, np.inf))
    return BatchMargins(
        radius=loops.radius,
        crossover=crossover,
        phase_margin=phase,
        gain_margin=gain_margin,
        delay_margin=delay,
        max_sensitivity=_peaks(loops, omega, np.abs(sensitivity)),
    )
