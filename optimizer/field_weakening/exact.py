"""Least-loss currents over torque and available flux linkage: what a two-dimensional
current reference approximates.

The voltage limits the flux linkage: with the resistance drop left out |psi| <= v_max / omega_e, so
that one number, the available flux linkage in Wb, stands for speed and DC-link voltage alike.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.optimizer.operating_points.region_edges import region_that_holds

# Electrical speed in rad/s at which the points are solved: the resistance drop is some 1e-9 of the
# voltage there.
_OMEGA = 1e9
_NO_LIMIT = 1e12  # Phase voltage in V that limits nothing at standstill.

# Share of the largest torque that must be left at the least flux linkage: below, nothing is worth
# fitting.
LEAST_SHARE = 0.02
_LOCUS_POINTS = 801
_DATA_POINTS = 33


@dataclass(frozen=True, slots=True)
class WeakeningRegion:
    """The domain of torque and available flux linkage of a machine.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
        flux_min, flux_max: Range of the available flux linkage in Wb; from ``flux_max`` upwards it
            limits nothing.
        torque_max: Largest torque in N m within the current limit.
    """

    machine: Machine
    i_max: float
    flux_min: float
    flux_max: float
    torque_max: float

    def points(self, torque: FloatArray, flux: FloatArray) -> OptimalPoints:
        """Least-loss operating points for torques in N m within an available flux linkage in Wb,
        both shape (N,).
        """
        omega_m = _OMEGA / self.machine.pole_pairs
        return optimal_points(self.machine, torque, omega_m, v_max=_OMEGA * flux, i_max=self.i_max)

    def largest_torque(self, flux: FloatArray) -> FloatArray:
        """Largest torque in N m within the current limit and the available flux linkage in Wb,
        shape (N,).
        """
        return self.points(np.full(flux.shape, 2.0 * self.torque_max), flux).torque

    def mtpa(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents (i_d, i_q) in A of least loss for torque in N m where no flux
        linkage limits them, shape (N,).
        """
        found = optimal_points(self.machine, torque, 0.0, v_max=_NO_LIMIT, i_max=self.i_max)
        return found.i_d, found.i_q

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Magnitude of the flux linkage in Wb at currents in A, any shape."""
        return np.hypot(*self.machine.flux(i_d, i_q))


def weakening_region(machine: Machine, i_max: float, flux_min: float) -> WeakeningRegion:
    """Domain from ``flux_min`` Wb up to the largest flux linkage on the MTPA locus
    within ``i_max`` A (peak).

    Raises:
        NoSolutionError: Even ``flux_min`` limits nothing, it leaves next to no torque, or the data
            of a flux map hold the currents.
    """
    torque_max = float(mtpa_locus(machine, i_max).torque[-1])
    probe = WeakeningRegion(machine, i_max, flux_min, np.inf, torque_max)
    flux_max = float(np.max(probe.flux(*probe.mtpa(np.linspace(0.0, torque_max, _LOCUS_POINTS)))))
    if flux_min >= flux_max:
        raise NoSolutionError(
            f"field_weakening: the voltage limits nothing up to that speed ({flux_min:.4g} Wb are "
            f"available, the largest torque takes {flux_max:.4g} Wb); raise the speed or leave the "
            "section out"
        )
    least = float(probe.largest_torque(np.array([flux_min]))[0])
    if least < LEAST_SHARE * torque_max:
        raise NoSolutionError(
            f"field_weakening: within {flux_min:.4g} Wb and {i_max:.4g} A the machine makes less "
            f"than {100.0 * LEAST_SHARE:g} % of its largest torque; lower the speed"
        )
    region = WeakeningRegion(machine, i_max, flux_min, flux_max, torque_max)
    _refuse_what_data_hold(region)
    return region


def _refuse_what_data_hold(region: WeakeningRegion) -> None:
    """Refuse a domain in which the data of a flux map hold the currents: a fit would leave them.

    Raises:
        NoSolutionError: Names the least torque at which that happens.
    """
    if region_that_holds(region.machine, region.i_max) is None:
        return
    share = np.linspace(0.0, 1.0, _DATA_POINTS)
    torque, flux = np.meshgrid(
        share[1:] * region.torque_max, region.flux_min + share * (region.flux_max - region.flux_min)
    )
    held = region.points(torque.ravel(), flux.ravel()).active == Active.DATA
    if np.any(held):
        raise NoSolutionError(
            f"field_weakening: from {float(np.min(torque.ravel()[held])):.4g} N m on the currents "
            "are held by the data: the flux map ends there; measure further, lower max_current, or "
            "write flux_map: extrapolate: true"
        )
