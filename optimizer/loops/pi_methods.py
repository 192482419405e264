"""Named PI tuning methods: their formulas, and what each can be asked to do
when its loop does not hold.

Formulas are the common ones of drive practice (docs/methods/current-and-speed-loops.md has the
sources);
nothing here knows the sampled loop. `dqforge.optimizer.loops.loop_gains` checks the gains on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import VendorMethod
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.machines.units.quantities import to_digits
from dqforge.optimizer.sampled_systems import GOLDEN, GOLDEN_STEPS

Settings = TypeVar("Settings", CurrentLoopSettings, SpeedLoopSettings)


SEARCH_HALVINGS = 40


SEARCH_BISECTIONS = 14  # the factor is then known to better than the three digits that are printed


def required_setting(value: float | None, key: str, method: str) -> float:
    """Return a setting that the method cannot do without.

    Args:
        value: The setting, None where it is not given.
        key: Its key in the design file.
        method: The method, for the message.
    """
    if value is None:
        raise InputError(f"{key} is missing: method '{method}' needs it")
    if not (value > 0.0 and np.isfinite(value)):
        raise InputError(f"{key} must be positive and finite, got {value:g}")
    return value


def current_pi(
    r_s: float, inductance: float, t_s: float, settings: CurrentLoopSettings
) -> tuple[float, float]:
    """Gains (kp in V/A, ki in V/(A s)) of one axis, before any check of the loop.

        bandwidth            kp = w L             ki = w R
                             (pole cancelled; w crossover without delay)
        damping              kp = 2 xi w L - R    ki = w^2 L
                             (poles of s^2 + 2 xi w s + w^2)
        magnitude-optimum    kp = L/(2 T)         ki = kp R/L            T = 1.5 t_s
        symmetrical-optimum  kp = L/(a T)         ki = kp/(a^2 T)        T = 1.5 t_s, spread a

    and the rules of vendors, `dqforge.optimizer.loops.pi_methods`.

    ``r_s`` in Ohm, ``inductance`` in H, ``t_s`` in s.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        settings: Method and its settings.
    """
    method, key, t_sum = settings.method, "control.current_loop", CURRENT_DELAY * t_s
    if method == "given":
        return required_setting(settings.kp, f"{key}.kp", method), required_setting(
            settings.ki, f"{key}.ki", method
        )
    if method == "magnitude-optimum":
        kp = inductance / (2.0 * t_sum)
        return kp, kp * r_s / inductance
    if method == "symmetrical-optimum":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        kp = inductance / (spread * t_sum)
        return kp, kp / (spread**2 * t_sum)
    omega = required_setting(settings.bandwidth, f"{key}.bandwidth", method)
    if method == "bandwidth":
        return omega * inductance, omega * r_s
    if is_vendor(method):
        return vendor_current_pi(method, r_s, inductance, omega, settings.damping)
    damping = required_setting(settings.damping, f"{key}.damping", method)
    return 2.0 * damping * omega * inductance - r_s, omega**2 * inductance


def speed_pi(
    inertia: float, friction: float, t_sum: float, settings: SpeedLoopSettings
) -> tuple[float, float]:
    """Gains (kp in N m s/rad, ki in N m/rad) of the speed loop, before any check of the loop.

        bandwidth            kp = w J             ki = kp w/4
        damping              kp = 2 xi w J - B    ki = w^2 J
                             (poles of s^2 + 2 xi w s + w^2)
        symmetrical-optimum  kp = J/(a T)         ki = kp/(a^2 T)        T = t_sum, spread a

    Rules of vendors are those of `dqforge.optimizer.loops.pi_methods`; for ti ``t_sum`` is one
    over the bandwidth of the current loop. With ki = kp w/4 and B = 0 the loop without delays has
    the double pole s^2 + w s + w^2/4 = (s + w/2)^2: the fastest integral action that leaves the
    poles real.

    Args:
        inertia, friction: J in kg m^2, B in N m s/rad.
        t_sum: Sum of the small delays in s, see `speed_delay`.
        settings: Method and its settings.
    """
    method, key = settings.method, "control.speed_loop"
    if method == "given":
        return required_setting(settings.kp, f"{key}.kp", method), required_setting(
            settings.ki, f"{key}.ki", method
        )
    if method == "symmetrical-optimum":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        kp = inertia / (spread * t_sum)
        return kp, kp / (spread**2 * t_sum)
    if method == "ti":
        spread = required_setting(settings.spread, f"{key}.spread", method)
        return vendor_speed_pi(method, (inertia, friction), 1.0 / t_sum, 1.0, spread)
    omega = required_setting(settings.bandwidth, f"{key}.bandwidth", method)
    if is_vendor(method):
        return vendor_speed_pi(method, (inertia, friction), omega, settings.damping, 1.0)
    if method == "bandwidth":
        return omega * inertia, 0.25 * omega**2 * inertia
    damping = required_setting(settings.damping, f"{key}.damping", method)
    return 2.0 * damping * omega * inertia - friction, omega**2 * inertia


def require_positive(
    key: str,
    loop: str,
    settings: CurrentLoopSettings | SpeedLoopSettings,
    gains: tuple[float, float],
    rate: float,
) -> None:
    """Refuse gains that are not positive and finite; ``rate`` in rad/s is R/(2 L) or B/(2 J).

    Args:
        key: Section of the design file, for the message.
        loop: Which loop, for the message.
        settings: Method and its settings.
        gains: kp and ki.
        rate: Rate of decay in rad/s that the loop must exceed: R/(2 L) or B/(2 J).
    """
    kp, ki = gains
    if kp > 0.0 and ki > 0.0 and np.isfinite(kp) and np.isfinite(ki):
        return
    reached = (
        f"{key}: method '{settings.method}' gives the {loop} loop kp = {kp:.4g} and ki = {ki:.4g}"
    )
    if settings.method in ("damping", "nxp-mcat") and kp <= 0.0:
        least = rate / settings.damping
        raise NoSolutionError(
            f"{reached}; kp is positive from {key}.bandwidth above {_rate_text(least, up=True)}"
        )
    raise NoSolutionError(
        f"{reached}; both must be positive and finite: use another method, or check the machine"
    )


def by_spread(settings: CurrentLoopSettings | SpeedLoopSettings) -> bool:
    """Whether a method's number is its spread: the symmetrical optimum, and TI's speed loop.

    Args:
        settings: Method and its settings.
    """
    of_ti = settings.method == "ti" and isinstance(settings, SpeedLoopSettings)
    return settings.method == "symmetrical-optimum" or of_ti


def calmer(settings: Settings, factor: float) -> Settings:
    """Make the same settings ask for a calmer loop (factor below one)."""
    if settings.method == "given":
        kp, ki = (
            required_setting(settings.kp, "kp", "given"),
            required_setting(settings.ki, "ki", "given"),
        )
        return replace(settings, kp=kp * factor, ki=ki * factor)
    if by_spread(settings):
        return replace(settings, spread=settings.spread / factor)
    if settings.method == "optimised":
        return replace(settings, max_sensitivity=1.0 + (settings.max_sensitivity - 1.0) * factor)
    return replace(
        settings,
        bandwidth=required_setting(settings.bandwidth, "bandwidth", settings.method) * factor,
    )


def largest_factor(holds: Callable[[float], bool]) -> float | None:
    """Largest factor below one for which the loop holds, to three digits on the safe side,
    or None.
    """
    high, low = 1.0, 0.5
    for _ in range(SEARCH_HALVINGS):
        if holds(low):
            break
        high, low = low, 0.5 * low
    else:
        return None
    for _ in range(SEARCH_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _rate_text(omega: float, *, up: bool) -> str:
    rate = to_digits(omega, 3, up=up)
    return f"{rate:.6g} rad/s ({rate / (2.0 * np.pi):.3g} Hz)"


def loop_advice(key: str, settings: CurrentLoopSettings | SpeedLoopSettings, factor: float) -> str:
    """Say what to write for a loop that holds, given the factor from `largest_factor`.

    Args:
        key: Key of the design file whose value does not hold.
        settings: Method and its settings.
        factor: Factor by which all gains may grow at most.
    """
    if settings.method == "given":
        return f"multiply {key}.kp and {key}.ki by {to_digits(factor, 3, up=False):.6g} or less"
    if by_spread(settings):
        return (
            f"it holds from {key}.spread = {to_digits(settings.spread / factor, 3, up=True):.6g} "
            "upwards"
        )
    if settings.method == "optimised":
        largest = 1.0 + to_digits((settings.max_sensitivity - 1.0) * factor, 3, up=False)
        return f"it holds from {key}.max_sensitivity = {largest:.6g} downwards"
    limit = _rate_text(
        required_setting(settings.bandwidth, "bandwidth", settings.method) * factor, up=False
    )
    return f"method '{settings.method}' holds up to {key}.bandwidth = {limit}"


# Many sampled PI loops at once: plants with different parameters, their
# closed-loop poles and their margins.
#
# The loop gain comes from poles alone. With the open loop c (zI - A)^-1 b and unity feedback,
#
#     S(z) = 1/(1 + L(z)) = det(zI - A)/det(zI - A + b c),
#
# a quotient of two products over eigenvalues. `dqforge.optimizer.sampled_systems` has the same
# margins of one loop at a time.

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

        L dx/dt = g K v - R x - e omega,   J domega/dt = f x - B omega

    and of a filter w_f[k + 1] = w_f[k] + (1 - exp(-t_s/T_f)) (omega[k + 1] - w_f[k]).

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

    count, n = len(drive.r_s), 2
    block = np.zeros((count, n + 1, n + 1))
    block[:, 0, 0], block[:, 0, 1] = -drive.r_s / drive.l_q, -drive.back_emf / drive.l_q
    block[:, 1, 0], block[:, 1, 1] = drive.torque_factor / drive.inertia, -friction / drive.inertia
    block[:, 0, n] = drive.gain / drive.l_q
    held = expm(block * t_s)
    a, b = np.zeros((count, n + 1, n + 1)), np.zeros((count, n + 1))
    a[:, :n, :] = held[:, :n, :]  # the last column is the voltage of one sample ago
    b[:, n] = 1.0
    inner, entry = _open(PlantBatch(a, b, 0, t_s), current_gains[0], current_gains[1] * t_s)
    inner[:, :, 1] -= entry
    known = n + 2  # states without a filter
    filtered = bool(np.all(np.asarray(filter_time) > 0.0))
    size, measured = (known + 1, known) if filtered else (known, n)
    stepped = np.zeros((count, size + 1, size + 1))
    stepped[:, :known, :known], stepped[:, :known, -1], stepped[:, -1, -1] = inner, entry, 1.0
    if filtered:  # by the newest sample of the speed, as it is emitted
        share = np.broadcast_to(-np.expm1(-t_s / np.asarray(filter_time)), count)
        stepped[:, known] = share[:, np.newaxis] * stepped[:, n]
        stepped[:, known, known] = 1.0 - share
    stepped = np.linalg.matrix_power(stepped, ratio)
    return PlantBatch(stepped[:, :size, :size], stepped[:, :size, size], measured, t_s * ratio)


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


# PI gains by the rules of vendors' own tools: the numbers that those tools put into firmware, in
# double precision and in the parallel form per second.
#
# Formulas are facts of the sources named in docs/firmware/loops.md. What their macros hold besides
# (scales, factors of the sampling period, dividers, digits) is the firmware's format, not its rule.

_TI_INTEGRAL = 0.25  # of R/L: setupControllers takes a quarter of it into its series form


def is_vendor(method: str) -> bool:
    """Whether a method is the rule of a vendor's tool.

    Args:
        method: As in ``control.current_loop.method``.
    """
    return method in get_args(VendorMethod)


def vendor_inductance(method: str, inductances: tuple[float, float], place: int) -> float:
    """Inductance in H that a rule takes for an axis.

    ``vesc`` knows the mean of both, ``st-mcsdk`` that of q alone (LS); the others each axis' own.

    Args:
        method: As in ``control.current_loop.method``; of those that are no vendor's, the axis' own.
        inductances: L_d and L_q in H.
        place: 0 for d, 1 for q.
    """
    if method == "vesc":
        return 0.5 * (inductances[0] + inductances[1])
    return inductances[1] if method == "st-mcsdk" else inductances[place]


def vendor_current_pi(
    method: str, r_s: float, inductance: float, omega: float, damping: float
) -> tuple[float, float]:
    """Gains (kp in V/A, ki in V/(A s)) of a current loop by a vendor's rule.

        nxp-mcat     kp = 2 xi w L - R     ki = w^2 L
        ti           kp = w L              ki = w R/4
        st-mcsdk, vesc, infineon, moteus
                     kp = w L              ki = w R

    Args:
        method: The rule.
        r_s, inductance: Resistance in Ohm, and inductance in H as of `vendor_inductance`.
        omega: Bandwidth in rad/s.
        damping: Damping ratio, for nxp-mcat.
    """
    if method == "nxp-mcat":
        return 2.0 * damping * omega * inductance - r_s, omega**2 * inductance
    share = _TI_INTEGRAL if method == "ti" else 1.0
    return omega * inductance, share * omega * r_s


def vendor_speed_pi(
    method: str,
    mechanics: tuple[float, float],
    omega: float,
    damping: float,
    spread: float,
) -> tuple[float, float]:
    """Gains (kp in N m s/rad, ki in N m/rad) of the speed loop by a vendor's rule.

        nxp-mcat     kp = 2 xi w J         ki = w^2 J
        infineon     kp = w J              ki = w B
        ti           kp = w J/delta        ki = kp w/delta^2      w of the current loop

    Args:
        method: The rule.
        mechanics: Inertia J in kg m^2 and friction B in N m s/rad.
        omega: Bandwidth in rad/s: of the speed loop, for ti that of the current loop.
        damping: Damping ratio xi, for nxp-mcat.
        spread: delta, for ti.

    Raises:
        NoSolutionError: infineon makes its integral gain of the friction, and there is none.
    """
    inertia, friction = mechanics
    if method == "nxp-mcat":
        return 2.0 * damping * omega * inertia, omega**2 * inertia
    if method == "ti":
        kp = omega * inertia / spread
        return kp, kp * omega / spread**2
    if not friction > 0.0:
        raise NoSolutionError(
            "control.speed_loop: the method 'infineon' makes ki of the friction, w B, and "
            "machine.friction is zero; write it, or another method"
        )
    return omega * inertia, omega * friction
