"""Sampled linear systems: exact discretisation with an input delay, loop frequency response,
margins and poles.

The one home of these formulas; the loops of the drive are built from them in
`dqforge.optimizer.loops.plants`.

References:
    K. J. Astroem, B. Wittenmark, "Computer-Controlled Systems", 3rd edition, 1997: chapter 2
    (zero-order hold, systems with time delay) and chapter 3 (margins). A. J. Laub, "Efficient
    multivariable frequency response computations", IEEE Trans. Automatic Control 26, 1981 (with
    Hessenberg matrices; the triangular ones here take fewer operations). T. R. Chandrupatla, "A new
    hybrid quadratic/bisection algorithm for finding the zero of a nonlinear function without using
    derivatives", Advances in Engineering Software 28, 1997.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
POINTS_PER_DECADE = 200
LEAST_SHARE = 1e-7  # Share of the Nyquist frequency below which no crossing is looked for.
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
GOLDEN_STEPS = 45  # narrows a bracket by 4e-10; the error of a maximum is the square of that
_MOST_STEPS = 100  # Chandrupatla's method takes some eight; a function of pure noise ends here.
_SPACING = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, slots=True)
class HeldInput:
    """x[k+1] = phi x[k] + gamma0 u[k-m] + gamma1 u[k-m-1]: a plant whose held input arrives late.

    ``phi`` has shape (n, n), ``gamma0`` and ``gamma1`` (n, inputs);
    ``m`` counts the whole samples of the delay.
    """

    phi: FloatArray
    gamma0: FloatArray
    gamma1: FloatArray
    m: int


@dataclass(frozen=True, slots=True)
class SampledSystem:
    """x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k], sampled every ``t_s`` seconds.

    Shapes: ``a`` (n, n), ``b`` (n, inputs), ``c`` (outputs, n), ``d`` (outputs, inputs).
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    t_s: float

    @property
    def poles(self) -> ComplexArray:
        """Eigenvalues of A, largest modulus first, shape (n,)."""
        return sorted_poles(self.a)

    def response(self, omega: FloatArray) -> ComplexArray:
        """Frequency response from the first input to the first output at omega in rad/s,
        shape (N,) -> (N,).
        """
        z = np.exp(1j * np.asarray(omega, dtype=np.float64) * self.t_s)
        matrices = z[:, None, None] * np.eye(len(self.a)) - self.a
        states = np.linalg.solve(matrices, np.broadcast_to(self.b[:, :1], (len(z), len(self.a), 1)))
        value: ComplexArray = (states[:, :, 0] @ self.c[0]) + self.d[0, 0]
        return value


@dataclass(frozen=True, slots=True)
class LoopMargins:
    """How far a stable loop is from instability.

    Args:
        crossovers: All frequencies in rad/s at which the loop gain is one, ascending, shape
            (crossings,).
        crossover: The one of them with the smallest phase margin, in rad/s; nan if there is none.
        phase_margin: Smallest angle in rad between the loop and -1 on the unit circle, negative if
            the loop lags by more than pi.
        gain_margin: Smallest factor above one on the loop gain that reaches -1; inf if there is
            none.
        gain_reduction: Largest factor below one that reaches -1; 0 if there is none.
        delay_margin: Smallest dead time in s whose phase lag reaches -1 at a crossover (exact for
            whole samples).
        max_sensitivity: Largest modulus M_s of the sensitivity 1/(1 + L) up to the Nyquist
            frequency.
    """

    crossovers: FloatArray
    crossover: float
    phase_margin: float
    gain_margin: float
    gain_reduction: float
    delay_margin: float
    max_sensitivity: float


def sorted_poles(a: FloatArray) -> ComplexArray:
    """Eigenvalues of a real matrix, shape (n, n) -> (n,), by falling modulus, then rising angle."""
    values = np.asarray(np.linalg.eigvals(a), dtype=np.complex128)
    order = np.lexsort((np.angle(values), -np.round(np.abs(values), 12)))
    return np.asarray(values[order], dtype=np.complex128)


def _hold(a: FloatArray, b: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """exp(A t) and its integral from 0 to t, times B, from one matrix exponential."""
    from scipy.linalg import expm

    n, inputs = b.shape
    block = np.zeros((n + inputs, n + inputs))
    block[:n, :n], block[:n, n:] = a, b
    exponential = np.asarray(expm(block * time), dtype=np.float64)
    return exponential[:n, :n], exponential[:n, n:]


def discretise(a: FloatArray, b: FloatArray, t_s: float, tau: float = 0.0) -> HeldInput:
    """Sample dx/dt = A x + B u(t - tau) exactly, with u held over each sample (modified
    z-transform).

        tau = m t_s + tau',  0 <= tau' < t_s
        phi = exp(A t_s)
        gamma0 = integral of exp(A s) B over 0 .. t_s - tau'
        gamma1 = exp(A (t_s - tau')) times the integral of exp(A s) B over 0 .. tau'

    Args:
        a, b: Continuous-time matrices, shapes (n, n) and (n, inputs).
        t_s: Sampling period in s.
        tau: Input delay in s, zero or more, of any fraction of the period.

    References:
        Astroem and Wittenmark, chapter 2.
    """
    if not t_s > 0.0 or not tau >= 0.0:
        raise InputError(
            f"the sampling period must be positive and the delay not negative, got {t_s:g} s and "
            f"{tau:g} s"
        )
    m = int(np.floor(tau / t_s * (1.0 + 1e-12)))
    rest = max(tau - m * t_s, 0.0)
    if rest <= 1e-12 * t_s:
        phi, gamma0 = _hold(a, b, t_s)
        return HeldInput(phi=phi, gamma0=gamma0, gamma1=np.zeros_like(gamma0), m=m)
    late, gamma0 = _hold(a, b, t_s - rest)
    early, integral = _hold(a, b, rest)
    return HeldInput(phi=late @ early, gamma0=gamma0, gamma1=late @ integral, m=m)


def delayed_plant(
    a: FloatArray, b: FloatArray, c: FloatArray, t_s: float, tau: float = 0.0
) -> SampledSystem:
    """Exact sampled system of dx/dt = A x + B u(t - tau), y = C x.

    The state is (x[k], u[k-1], u[k-2], ...), with as many past inputs as the delay needs. Shapes as
    in `discretise`, ``c`` (outputs, n).
    """
    held = discretise(a, b, t_s, tau)
    n, inputs = held.gamma0.shape
    depth = held.m + (1 if np.any(held.gamma1) else 0)
    line = depth * inputs
    taps = np.zeros((n, (depth + 1) * inputs))  # columns: u[k], u[k-1], ...
    taps[:, held.m * inputs : (held.m + 1) * inputs] += held.gamma0
    if depth > held.m:
        taps[:, (held.m + 1) * inputs :] += held.gamma1
    shift = np.zeros((line, line))
    shift[inputs:, : max(line - inputs, 0)] = np.eye(max(line - inputs, 0))
    entry = np.zeros((line, inputs))
    entry[: min(inputs, line)] = np.eye(inputs)[: min(inputs, line)]
    return SampledSystem(
        a=np.block([[held.phi, taps[:, inputs:]], [np.zeros((line, n)), shift]]),
        b=np.vstack([taps[:, :inputs], entry]),
        c=np.hstack([c, np.zeros((len(c), line))]),
        d=np.zeros((len(c), inputs)),
        t_s=t_s,
    )


def lift(system: SampledSystem, ratio: int) -> SampledSystem:
    """The same system seen only every ``ratio``-th sample, its input held in between (exact)."""
    a, b = np.eye(len(system.a)), np.zeros_like(system.b)
    for _ in range(ratio):
        a, b = system.a @ a, system.a @ b + system.b
    return SampledSystem(a=a, b=b, c=system.c, d=system.d, t_s=system.t_s * ratio)


def constant_input_states(system: SampledSystem, inputs: FloatArray, steps: int) -> FloatArray:
    """States x[0] = 0 .. x[steps-1] under constant inputs of shape (inputs,).

    Result of shape (steps, n).

    The block of known states is doubled with the matching power of the transition
    matrix until it is long enough.
    """
    n = len(system.a)
    power = np.zeros((n + 1, n + 1))
    power[:n, :n], power[:n, n], power[n, n] = system.a, system.b @ inputs, 1.0
    states = np.zeros((1, n + 1))
    states[0, n] = 1.0
    while len(states) < steps:
        states = np.vstack([states, states @ power.T])
        power = power @ power
    return np.asarray(states[:steps, :n], dtype=np.float64)


def _maxima(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Where a function is largest in the brackets [low, high], shape (brackets,), by golden section
    on all together.
    """
    if len(low) == 0:
        return low
    for _ in range(GOLDEN_STEPS):
        width = GOLDEN * (high - low)
        left, right = high - width, low + width
        rising = function(left) < function(right)
        low, high = np.where(rising, left, low), np.where(rising, high, right)
    return np.asarray(0.5 * (low + high), dtype=np.float64)


def _grid(loop: SampledSystem, closed_poles: ComplexArray) -> FloatArray:
    """Frequencies in rad/s, ascending, from three decades below the slowest closed-loop
    pole to Nyquist (included).
    """
    nyquist = np.pi / loop.t_s
    moving = closed_poles[np.abs(closed_poles) > 1e-6]
    rates = np.abs(np.log(moving)) / loop.t_s
    slowest = float(np.min(rates, initial=nyquist))
    low = min(max(1e-3 * slowest, LEAST_SHARE * nyquist), 1e-2 * nyquist)
    count = int(np.ceil(POINTS_PER_DECADE * np.log10(nyquist / low)))
    spread = np.geomspace(low, nyquist, count)
    even = np.linspace(0.0, nyquist, 2 * POINTS_PER_DECADE + 1)[1:]
    near_end = nyquist * (1.0 - np.geomspace(1e-6, 1e-2, POINTS_PER_DECADE // 4))
    resonances = np.abs(np.angle(moving)) / loop.t_s
    points = np.concatenate([spread, even, near_end, resonances[resonances > low]])
    return np.asarray(np.unique(np.minimum(points, nyquist)), dtype=np.float64)


def _sign_changes(values: FloatArray) -> NDArray[np.intp]:
    return np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)


def _worst_sensitivity(loop: SampledSystem, omega: FloatArray, values: ComplexArray) -> float:
    """Largest 1/|1 + L|: the grid's local maxima, refined."""
    sensitivity = 1.0 / np.abs(1.0 + values)
    inner = (
        np.flatnonzero(
            (sensitivity[1:-1] >= sensitivity[:-2]) & (sensitivity[1:-1] >= sensitivity[2:])
        )
        + 1
    )
    # At the Nyquist frequency every derivative is zero.
    high = np.minimum(omega[inner + 1], omega[-1] * (1.0 - 1e-9))
    peaks = _peak_places(loop, omega[inner - 1], high)
    places = np.concatenate([peaks, omega[[int(np.argmax(sensitivity))]]])
    return float(np.max(1.0 / np.abs(1.0 + loop.response(places))))


def _peak_places(loop: SampledSystem, low: FloatArray, high: FloatArray) -> FloatArray:
    """Where |1 + L| is least in brackets, shape (brackets,): roots of its derivative, by golden
    section where the ends of a bracket do not show one.
    """
    found = 0.5 * (low + high)
    if len(low) == 0:
        return found
    sound = (_falling(loop, low) < 0.0) & (_falling(loop, high) > 0.0)
    found[sound] = bracketed_roots(lambda w: _falling(loop, w), low[sound], high[sound])
    found[~sound] = _maxima(
        lambda w: 1.0 / np.abs(1.0 + loop.response(w)), low[~sound], high[~sound]
    )
    return found


def _falling(loop: SampledSystem, omega: FloatArray) -> FloatArray:
    """Derivative of |1 + L|^2 by z along the circle, but for a positive factor, (N,) -> (N,)."""
    z = np.exp(1j * omega * loop.t_s)
    matrices = z[:, None, None] * np.eye(len(loop.a)) - loop.a
    entry = np.broadcast_to(loop.b[:, :1], (len(z), len(loop.a), 1))
    states = np.linalg.solve(matrices, entry)
    slopes = np.linalg.solve(matrices, states)
    value = 1.0 + states[:, :, 0] @ loop.c[0] + loop.d[0, 0]
    slope = -1j * z * (slopes[:, :, 0] @ loop.c[0])
    return np.asarray((np.conj(value) * slope).real, dtype=np.float64)


def grid_crossings(values: ComplexArray) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Where an open loop over a grid of frequencies crosses the gain of one, by interpolation.

    Args:
        values: Open loop at rising frequencies, shape (F,).

    Returns:
        Indices of the points before the crossings, the shares of the way to the next point, and the
        phase margins in rad, not wrapped, all of shape (C,).
    """
    size = np.log(np.abs(values))
    at = np.flatnonzero(np.sign(size[:-1]) * np.sign(size[1:]) < 0)
    share = size[at] / (size[at] - size[at + 1])
    phase = np.angle(-values[at]) + share * np.angle(values[at + 1] / values[at])
    return at, share, phase


def loop_margins(loop: SampledSystem) -> LoopMargins:
    """Crossovers and margins of a single loop L(z) with unity negative feedback,
    at z = exp(j omega t_s).

    A scan up to the Nyquist frequency brackets every crossing, which is refined to the last digit.
    With several crossings the worst counts. The frequency pi/t_s itself, where L is real, counts as
    a phase crossing.
    """
    closed_poles = sorted_poles(loop.a - loop.b @ loop.c / (1.0 + loop.d[0, 0]))
    omega = _grid(loop, closed_poles)
    values = scanned_response(
        loop.a, loop.b[:, 0], loop.c[0], float(loop.d[0, 0]), np.exp(1j * omega * loop.t_s)
    )

    at = _sign_changes(np.log(np.abs(values)))
    crossovers = bracketed_roots(
        lambda w: np.log(np.abs(loop.response(w))), omega[at], omega[at + 1]
    )
    to_critical = np.angle(-loop.response(crossovers)) if len(crossovers) else crossovers
    worst = int(np.argmin(np.abs(to_critical))) if len(crossovers) else -1

    at = _sign_changes(values.imag[:-1])
    turns = bracketed_roots(lambda w: loop.response(w).imag, omega[at], omega[at + 1])
    real = loop.response(np.append(turns, omega[-1])).real
    factors = -1.0 / real[real < 0.0]

    return LoopMargins(
        crossovers=crossovers,
        crossover=float(crossovers[worst]) if len(crossovers) else float("nan"),
        phase_margin=float(to_critical[worst]) if len(crossovers) else float("inf"),
        gain_margin=float(np.min(factors[factors > 1.0], initial=np.inf)),
        gain_reduction=float(np.max(factors[factors <= 1.0], initial=0.0)),
        delay_margin=float(np.min(np.mod(to_critical, 2.0 * np.pi) / crossovers, initial=np.inf)),
        max_sensitivity=_worst_sensitivity(loop, omega, values),
    )


# A loop over many frequencies at little cost, and roots in brackets in few evaluations.
#
# A scan needs thousands of solutions of (zI - A) x = b with one A. With A = Q T Q^H, T upper
# triangular (Schur), each of them is a back substitution, and n of these serve all frequencies at
# once. Q is unitary: the digits are those of a solution by elimination.


def scanned_response(
    a: FloatArray, b: FloatArray, c: FloatArray, d: float, z: ComplexArray
) -> ComplexArray:
    """C (zI - A)^-1 b + d at many points, (F,) -> (F,).

    Args:
        a: Transition matrix, shape (n, n).
        b, c: Input column and output row, shape (n,).
        d: Direct part.
        z: Points that are no eigenvalues of A.
    """
    from scipy.linalg import matrix_balance, schur

    balanced, scales = matrix_balance(a, permute=False)
    sizes = np.diag(scales)
    triangle, turned = schur(balanced, output="complex")
    entry, exit_ = np.conj(turned.T) @ (b / sizes), (c * sizes) @ turned
    states = np.zeros((len(a), len(z)), dtype=np.complex128)
    for row in range(len(a) - 1, -1, -1):
        after = triangle[row, row + 1 :] @ states[row + 1 :]
        states[row] = (entry[row] + after) / (z - triangle[row, row])
    return np.asarray(exit_ @ states + d, dtype=np.complex128)


def bracketed_roots(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Roots in the brackets [low, high], shape (brackets,), all narrowed together.

    By Chandrupatla's method: inverse quadratic interpolation where that is safe, else bisection,
    until each bracket is as wide as the spacing of doubles.

    Args:
        function: Takes one argument per bracket; of different signs at both ends of each.
        low, high: Ends of the brackets.
    """
    if len(low) == 0:
        return low
    first, value_first = np.array(high), function(high)
    last, value_last = np.array(low), function(low)
    other, value_other = first.copy(), value_first.copy()
    share = np.full(len(low), 0.5)
    best = last.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(_MOST_STEPS):
            trial = first + share * (last - first)
            value = function(trial)
            same = np.sign(value) == np.sign(value_first)
            other = np.where(same, first, last)
            value_other = np.where(same, value_first, value_last)
            last = np.where(same, last, first)
            value_last = np.where(same, value_last, value_first)
            first, value_first = trial, value
            best = np.where(np.abs(value_first) < np.abs(value_last), first, last)
            width = np.abs(last - first)
            least = 0.5 * _SPACING * np.abs(best) / width
            if np.all((least > 0.25) | (value_first == 0.0) | (width == 0.0)):
                break
            share = _interpolated(
                (first, last, other), (value_first, value_last, value_other), least
            )
    return best


def _interpolated(
    points: tuple[FloatArray, FloatArray, FloatArray],
    values: tuple[FloatArray, FloatArray, FloatArray],
    least: FloatArray,
) -> FloatArray:
    """Share of the way from the latest point to the other end at which to try next."""
    (a, b, c), (f_a, f_b, f_c) = points, values
    place, height = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
    safe = (height * height < place) & ((1.0 - height) ** 2 < 1.0 - place)
    found = f_a / (f_b - f_a) * (f_c / (f_b - f_c)) + (c - a) / (b - a) * (f_a / (f_c - f_a)) * (
        f_b / (f_c - f_b)
    )
    share = np.where(safe & np.isfinite(found), found, 0.5)
    least = np.minimum(least, 0.5)
    return np.asarray(np.clip(share, least, 1.0 - least), dtype=np.float64)
