"""The currents that a strategy chooses for a torque: what references approximate
and loss budgets compare.

Machines with constant inductances have closed forms as long as no voltage limits them;
everything else is solved.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import (
    CurrentRegion,
    LinearMachine,
    Machine,
    copper_loss,
)
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    id0_currents,
    mtpa_at_current,
    mtpa_currents,
    mtpa_locus,
    region_that_holds,
)
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

_NO_LIMIT = 1e9  # Phase voltage in V that no machine takes at standstill.

# Multiple of the current limit up to which currents are found: a reference in single precision errs
# upwards, too.
_ROOM = 1.1
_TABLE_POINTS = 3001
_POLISHING_STEPS = 4


@dataclass(frozen=True, slots=True)
class SpeedPoint:
    """A mechanical speed in rad/s (positive) and the phase-voltage amplitude in V
    that is not exceeded there.
    """

    omega_m: float
    v_max: float


@dataclass(frozen=True, slots=True)
class OperatingPoints:
    """Currents that were chosen for torques, all arrays of shape (N,).

    ``torque_request`` and ``torque`` in N m differ only where ``limited`` is true: there the limits
    allow no more and ``torque`` is the largest that can be had. ``torque_residual`` is the
    machine's torque at (i_d, i_q) in A minus ``torque``, relative to the largest torque of the set;
    ``stationarity`` is the scaled derivative of the copper loss along the curve of constant torque,
    zero at the optimum (not meaningful for ``id0``, where limited, and where the field is
    weakened). ``held`` marks currents that the data of a flux map hold on their edge: better ones
    may lie beyond. ``copper`` is the copper loss in W.
    """

    torque_request: FloatArray
    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    limited: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    torque_residual: FloatArray
    stationarity: FloatArray
    held: NDArray[np.bool_]
    copper: FloatArray


@dataclass(frozen=True, slots=True)
class CurrentChoice:
    """A strategy for a machine.

    Args:
        machine: Any machine.
        strategy: ``mtpa`` or ``id0``.
        i_max: Current limit in A (peak).
        speed: The one speed for which ``mtpa`` weakens the field; None where the voltage limits
            nothing.

    Raises:
        InputError: ``id0`` at a speed: it leaves no freedom to weaken the field.
    """

    machine: Machine
    strategy: Strategy
    i_max: float
    speed: SpeedPoint | None = None

    def __post_init__(self) -> None:
        """Refuse a strategy that cannot keep the voltage limit."""
        if self.strategy == "id0" and self.speed is not None:
            raise InputError(
                "strategy id0 cannot weaken the field; leave the speed out, or use strategy mtpa"
            )

    @property
    def closed_form(self) -> LinearMachine | None:
        """The machine where its constant inductances give the currents by formula, else None."""
        return (
            self.machine if isinstance(self.machine, LinearMachine) and self.speed is None else None
        )

    def currents(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents (i_d, i_q) in A for torque >= 0 in N m, shape (N,).

        Slightly beyond the largest torque the currents go on where there is no voltage limit;
        further, and at a speed, those of the largest torque are returned.
        """
        torque = np.asarray(torque, dtype=np.float64)
        if self.closed_form is not None:
            return (mtpa_currents if self.strategy == "mtpa" else id0_currents)(
                self.closed_form, torque
            )
        flat = torque.ravel()
        i_d, i_q = self._id0(flat) if self.strategy == "id0" else self._least_loss(flat)
        return i_d.reshape(torque.shape), i_q.reshape(torque.shape)

    @property
    def region(self) -> CurrentRegion | None:
        """Where the data of a flux map hold the currents, None where they cover the
        current limit or may be left.
        """
        return region_that_holds(self.machine, self.i_max)

    def held(self, torque: FloatArray) -> NDArray[np.bool_]:
        """Whether the data of a flux map hold the currents for torque >= 0 in N m on their edge,
        shape (N,).
        """
        if self.region is None:
            return np.zeros(torque.shape, dtype=np.bool_)
        if self.strategy == "id0":
            end = self._end_of_id0()
            return np.asarray((self.currents(torque)[1] >= end * (1.0 - 1e-9)) & (end < self.i_max))
        return np.asarray(self._points(torque).active == Active.DATA)

    def _points(self, torque: FloatArray) -> OptimalPoints:
        if self.speed is None:
            # What lies just beyond the current limit must not be taken from beyond the data.
            i_max = self.i_max if self.region is not None else _ROOM * self.i_max
            return optimal_points(self.machine, torque, 0.0, v_max=_NO_LIMIT, i_max=i_max)
        return optimal_points(
            self.machine, torque, self.speed.omega_m, v_max=self.speed.v_max, i_max=self.i_max
        )

    def _least_loss(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = self._points(torque)
        return found.i_d, found.i_q

    def _end_of_id0(self) -> float:
        """Largest q current in A that ``id0`` may take: the limit, or where the data of a flux map
        end.
        """
        region = self.region
        return self.i_max if region is None else min(self.i_max, region.end_of_ray(0.5 * np.pi))

    def _id0(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Newton's method on T(0, i_q) from a table of the torque over i_q."""
        if self.machine.psi_pm == 0.0:
            raise InputError(
                "strategy id0 needs magnet flux; without it no torque is made at i_d = 0: use mtpa"
            )
        factor = 1.5 * self.machine.pole_pairs
        grid = np.linspace(
            0.0,
            self._end_of_id0() if self.region is not None else _ROOM * self.i_max,
            _TABLE_POINTS,
        )
        i_q = np.interp(torque, self.machine.torque(np.zeros_like(grid), grid), grid)
        zero = np.zeros_like(i_q)
        for _ in range(_POLISHING_STEPS):
            jet = self.machine.jet(zero, i_q)
            i_q = i_q - (jet.psi_d * i_q - torque / factor) / (jet.psi_d + jet.l_dq * i_q)
        return zero, np.minimum(i_q, grid[-1])

    def largest_torque(self) -> float:
        """Largest torque in N m within the limits.

        Raises:
            NoSolutionError: No current keeps the voltage limit at the speed.
        """
        limit = np.array([self.i_max])
        if self.strategy == "id0":
            return float(self.machine.torque(np.zeros(1), np.array([self._end_of_id0()]))[0])
        if self.closed_form is not None:
            return float(self.machine.torque(*mtpa_at_current(self.closed_form, limit))[0])
        locus = mtpa_locus(self.machine, self.i_max)
        if self.speed is None:
            return float(locus.torque[-1])
        beyond = 2.0 * float(locus.torque[-1])
        most = optimal_points(
            self.machine, beyond, self.speed.omega_m, v_max=self.speed.v_max, i_max=self.i_max
        )
        if not most.torque[0] > 0.0:
            raise NoSolutionError(
                f"operation.speed: at {in_rpm(self.speed.omega_m):.4g} rpm no current "
                f"within {self.i_max:.4g} A keeps the voltage limit of {self.speed.v_max:.4g} V "
                "and makes torque; lower the speed"
            )
        return float(most.torque[0])

    def require(self, torque: float, where: str) -> None:
        """Refuse a torque that the limits do not allow.

        Raises:
            NoSolutionError: Names ``where``, the requested torque and the largest that can be had.
        """
        most = self.largest_torque()
        if torque > most * (1.0 + 1e-12):
            at = (
                ""
                if self.speed is None
                else f" and {self.speed.v_max:.4g} V at {self.speed.omega_m:.4g} rad/s"
            )
            raise NoSolutionError(
                f"{where}: {torque:.4g} N m is out of reach: {self.i_max:.4g} A (peak){at} give at "
                f"most {most:.4g} N m with strategy {self.strategy}{self._remedy(most)}"
            )

    def _remedy(self, most: float) -> str:
        """What to change where more than the largest torque in N m is asked for."""
        if self.held(np.array([most * (1.0 - 1e-9)]))[0]:
            return (
                " (held by the data: the flux map ends there); ask for less torque, measure "
                "further, or write flux_map: extrapolate: true"
            )
        return "; ask for less torque or raise max_current"

    def points(self, torque: FloatArray) -> OperatingPoints:
        """Operating points for torques in N m of any sign, shape (N,), clipped
        to what the limits allow.

        A negative torque is the mirror image of the positive one;
        at a speed that leaves it voltage to spare.

        Raises:
            InputError: A torque is not finite, or the strategy cannot drive this machine.
        """
        request = np.atleast_1d(np.asarray(torque, dtype=np.float64))
        if not np.all(np.isfinite(request)):
            raise InputError("torque must be finite; got nan or inf")
        most = self.largest_torque()
        # One part in 1e12 keeps a request for exactly the largest torque from being
        # called limited by rounding.
        limited = np.abs(request) > most * (1.0 + 1e-12)
        granted = np.clip(request, -most, most)
        i_d, magnitude = self.currents(np.abs(granted))
        i_q = np.copysign(magnitude, granted)
        residual = (self.machine.torque(i_d, i_q) - granted) / max(
            float(np.max(np.abs(granted), initial=0.0)), 1e-300
        )
        sine = _stationarity(self.machine, i_d, i_q)
        copper = copper_loss(self.machine.r_s, i_d, i_q)
        return OperatingPoints(
            request, granted, i_d, i_q, limited, residual, sine, self.held(np.abs(granted)), copper
        )

    def curves(self, end: float) -> dict[str, Callable[[FloatArray], FloatArray]]:
        """Curves i_d(T) and i_q(T) in A that are cheap to call often, for torques
        in N m from 0 to ``end``.

        Closed forms as they are; else splines through exact points, even in the root of the torque,
        in which the curves of machines without magnets are smooth, too.
        """
        if self.closed_form is not None:
            return {
                "d": lambda torque: self.currents(torque)[0],
                "q": lambda torque: self.currents(torque)[1],
            }
        from scipy.interpolate import CubicSpline

        root = np.linspace(0.0, 1.0, _TABLE_POINTS)
        exact = dict(zip("dq", self.currents(end * root**2), strict=True))
        splines = {axis: CubicSpline(root, current) for axis, current in exact.items()}

        def curve(axis: str) -> Callable[[FloatArray], FloatArray]:
            return lambda torque: np.asarray(splines[axis](np.sqrt(np.maximum(torque, 0.0) / end)))

        return {axis: curve(axis) for axis in splines}


def _stationarity(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Cross product of the unit gradients of |i|^2 and of torque: the sine
    of the angle between them.
    """
    jet = machine.jet(i_d, i_q)
    torque_d = jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q
    torque_q = jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d
    scale = np.hypot(i_d, i_q) * np.hypot(torque_d, torque_q)
    cross = i_d * torque_q - i_q * torque_d
    sine: FloatArray = np.divide(cross, scale, out=np.zeros_like(cross), where=scale > 0.0)
    return sine


def domain_end(choice: CurrentChoice, settings: FitSettings) -> float:
    """End of the torque domain in N m: as given, or the largest torque that the limits allow.

    Args:
        choice: Machine, strategy and limits.
        settings: Its ``torque_max`` in N m is the given end, if there is one.

    Raises:
        NoSolutionError: The given end needs more current or voltage than the limits.
    """
    if settings.torque_max is None:
        return choice.largest_torque()
    choice.require(settings.torque_max, "fit.max_torque")
    return settings.torque_max
