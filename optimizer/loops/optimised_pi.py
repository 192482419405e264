"""PI gains of least integrated error whose maximum sensitivity stays within a bound
for every plant of a set.

The integral of the error after a step of the disturbance d is d/(g ki), g the plant's gain: the
controller's output has to move by d/g in the end, and only its integral can. It is least where ki
is largest, whatever the other parameters of the plant, so that one objective serves all corners of
a tolerance box. The bound on M_s keeps the loop from oscillating: the integral of the absolute
error is 11 % above that of the error at M_s = 1.3 and 15 % at 1.6, where the least absolute error
under the same bound would be 6 % less.

References:
    K. J. Astroem, H. Panagopoulos, T. Haegglund, "Design of PI controllers based on non-convex
    optimization", Automatica 34(5), 1998, doi:10.1016/S0005-1098(98)00011-9: largest ki under a
    bound on M_s, for one plant.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.pi_methods import PlantBatch, close_loops, peak_sensitivities

FloatArray = NDArray[np.float64]


IndexArray = NDArray[np.intp]


_LOW = np.log([1e-3, 1e-6])


_HIGH = np.log([6.0, 3.0])


_GRID_POINTS = 260


_GLOBAL_EVALUATIONS = 500


_LOCAL_EVALUATIONS = 250


_ROUNDS = 12


_UNSTABLE = 10.0  # instead of the logarithm of M_s, plus the largest pole's


_REFINED = 1e-9


@dataclass(frozen=True, slots=True)
class PiScale:
    """Gains (V/A and V/(A s), or N m s/rad and N m/rad) that the logarithms of the search refer
    to.
    """

    kp: float
    ki: float


def pi_scale(inertia: float, loss: float, t_sum: float) -> PiScale:
    """Scale of a loop around 1/(a s + b) with small delays: kp = a/(2 T), ki = a/(8 T^2) + b/(2 T).

    ``inertia`` is a and ``loss`` b: inductance in H and resistance in Ohm of a current loop,
    inertia in kg m^2 and friction in N m s/rad of a speed loop; ``t_sum`` is the sum T of the
    delays in s.
    """
    return PiScale(inertia / (2.0 * t_sum), inertia / (8.0 * t_sum**2) + loss / (2.0 * t_sum))


def sensitivity_excess(
    plants: PlantBatch, gains: tuple[float, float], max_sensitivity: float, omega: FloatArray
) -> FloatArray:
    """Logarithm of M_s over its bound on a grid of frequencies in rad/s, shape (N,).

    Large where a loop is unstable.

    Args:
        plants: N plants whose sensitivity is bounded.
        gains: kp and ki of the loop.
        max_sensitivity: Bound of M_s.
        omega: Frequencies in rad/s, shape (K,).
    """
    loops = close_loops(plants, *gains)
    radius = loops.radius
    size = np.max(np.abs(loops.sensitivity(omega)), axis=1)
    return np.where(
        radius < 1.0, np.log(size / max_sensitivity), _UNSTABLE + np.log(np.maximum(radius, 1.0))
    )


def _frequencies(t_s: float) -> FloatArray:
    nyquist = np.pi / t_s
    return np.unique(
        np.append(
            np.geomspace(1e-5 * nyquist, nyquist, _GRID_POINTS), np.linspace(0.0, nyquist, 60)[1:]
        )
    )


def _gains(scale: PiScale, x: FloatArray) -> tuple[float, float]:
    return scale.kp * float(np.exp(x[0])), scale.ki * float(np.exp(x[1]))


def _search(
    plants: PlantBatch, scale: PiScale, bound: float, start: FloatArray | None
) -> FloatArray:
    """Logarithms of kp and ki over their scale with the largest ki: searched globally, unless
    started, then locally.
    """
    import nlopt

    omega = _frequencies(plants.t_s)

    def penalised(x: FloatArray, _gradient: FloatArray) -> float:
        return float(
            -x[1]
            + 50.0 * max(0.0, np.max(sensitivity_excess(plants, _gains(scale, x), bound, omega)))
        )

    def constraints(result: FloatArray, x: FloatArray, _gradient: FloatArray) -> None:
        result[:] = sensitivity_excess(plants, _gains(scale, x), bound, omega)

    if start is None:
        wide = nlopt.opt(nlopt.GN_DIRECT_L, 2)
        wide.set_lower_bounds(_LOW)
        wide.set_upper_bounds(_HIGH)
        wide.set_min_objective(penalised)
        wide.set_maxeval(_GLOBAL_EVALUATIONS)
        start = np.asarray(wide.optimize(0.5 * (_LOW + _HIGH)))
    near = nlopt.opt(nlopt.LN_COBYLA, 2)
    near.set_lower_bounds(_LOW)
    near.set_upper_bounds(_HIGH)
    near.set_min_objective(lambda x, _gradient: float(-x[1]))
    near.add_inequality_mconstraint(constraints, np.full(plants.size, 1e-9))
    near.set_initial_step(0.1)
    near.set_xtol_abs(1e-7)
    near.set_maxeval(_LOCAL_EVALUATIONS)
    try:
        found = np.asarray(near.optimize(start))
    except nlopt.RoundoffLimited:
        found = start
    return found if np.all(np.isfinite(found)) else start


def _onto_the_bound(plants: PlantBatch, scale: PiScale, bound: float, x: FloatArray) -> FloatArray:
    """Largest ki not above the found one for which every loop keeps the bound, at the same kp."""

    def keeps(shift: float) -> bool:
        gains = _gains(scale, np.array([x[0], x[1] - shift]))
        return bool(
            np.max(peak_sensitivities(close_loops(plants, *gains))) <= bound * (1.0 + _REFINED)
        )

    if keeps(0.0):
        return x
    low, high = 0.0, 1e-4
    while not keeps(high):
        low, high = high, 4.0 * high
        if high > 12.0:
            raise NoSolutionError("no gains keep the bound")
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if keeps(middle) else (middle, high)
    return np.array([x[0], x[1] - high])


def optimised_pi(
    plants: PlantBatch, max_sensitivity: float, scale: PiScale, key: str
) -> tuple[float, float]:
    """Gains (kp, ki) with the largest ki for which every plant's loop is stable
    with M_s within the bound.

    NLopt searches the logarithms of both gains (DIRECT-L, then COBYLA) on the few plants that bind;
    the worst of the others joins them until none exceeds the bound. Deterministic.

    Args:
        plants: The plants, of a tolerance box its corners; the first is where the search begins.
        max_sensitivity: Bound on M_s, above 1.
        scale: Order of magnitude of the gains, see `pi_scale`.
        key: Section of the design for the message.

    Raises:
        NoSolutionError: No gains keep the bound for all plants.
    """
    active: list[int] = [0]
    found: FloatArray | None = None
    for _ in range(_ROUNDS):
        subset = plants.some(np.array(active))
        try:
            found = _onto_the_bound(
                subset, scale, max_sensitivity, _search(subset, scale, max_sensitivity, found)
            )
            gains = _gains(scale, found)
        except NoSolutionError as error:
            raise NoSolutionError(
                f"{key}: no gains keep M_s within {max_sensitivity:.4g} for the drive and its "
                f"tolerances; raise {key}.max_sensitivity, or narrow control.tolerances"
            ) from error
        worst = peak_sensitivities(close_loops(plants, *gains))
        place = int(np.argmax(worst))
        if worst[place] <= max_sensitivity * (1.0 + 1e-6) or place in active:
            return gains
        active.append(place)
    raise NoSolutionError(
        f"{key}: the search for gains within M_s = {max_sensitivity:.4g} did not settle; raise it"
    )
