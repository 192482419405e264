"""Saturated machines: the machine behind a flux map, and its inductances at a current."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.checked_numbers import MACHINE, check_numbers
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import FluxJet, Machine, MachineFormulas
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

# Current over the largest of the grid below which a quotient of differences loses more digits than
# its series.
_SMALL_CURRENT = 1e-5


@dataclass(frozen=True, slots=True)
class SaturatedMachine(MachineFormulas):
    """A machine whose flux linkages are a map.

    Parameters as in `LinearMachine`, but for ``flux_map``.
    """

    pole_pairs: int
    r_s: float
    flux_map: FluxMap
    i_max: float
    inertia: float | None = None
    friction: float = 0.0
    omega_m_max: float | None = None
    _origin: FluxJet = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check every number, and keep the values at zero current, which several properties
        read.
        """
        check_numbers(self, MACHINE)
        if not isinstance(self.flux_map, FluxMap):
            got = type(self.flux_map).__name__
            raise InputError(f"flux_map: expected a FluxMap, got {got}; make one by make_flux_map")
        zero = np.zeros(1)
        object.__setattr__(self, "_origin", self.flux_map.jet(zero, zero))

    @property
    def psi_pm(self) -> float:
        """Open-circuit flux linkage in Wb, peak of phase."""
        return float(self._origin.psi_d[0])

    @property
    def l_d(self) -> float:
        """Incremental d inductance at zero current, in H."""
        return float(self._origin.l_dd[0])

    @property
    def l_q(self) -> float:
        """Incremental q inductance at zero current, in H."""
        return float(self._origin.l_qq[0])

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any broadcastable shapes."""
        return self.flux_map.flux(i_d, i_q)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, arrays of shape
        (N,).
        """
        return self.flux_map.jet(i_d, i_q)

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie on the map, any one shape."""
        return self.flux_map.inside(i_d, i_q)

    @property
    def region(self) -> CurrentRegion | None:
        """Where the data of the map are, None where it may be left."""
        return None if self.flux_map.extrapolate else self.flux_map.region


@dataclass(frozen=True, slots=True)
class Inductances:
    """Inductances at operating points, arrays of the shape of the currents.

    Incremental, in H: ``l_dd`` = d psi_d/d i_d, ``l_dq`` = d psi_d/d i_q, ``l_qd`` = d psi_q/d i_d,
    ``l_qq`` = d psi_q/d i_q. Apparent: psi_d = ``psi_m`` + ``l_d`` i_d and psi_q = ``l_q`` i_q,
    with ``psi_m`` (Wb) the d flux linkage at i_d = 0 and the same i_q; at zero current they pass
    into the incremental ones.
    """

    l_dd: FloatArray
    l_dq: FloatArray
    l_qd: FloatArray
    l_qq: FloatArray
    psi_m: FloatArray
    l_d: FloatArray
    l_q: FloatArray


def inductances(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> Inductances:
    """Incremental and apparent inductances of any machine at currents in A, shape (N,).

    Args:
        machine: Any machine.
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    here = machine.jet(i_d, i_q)
    at_no_d, at_no_q = machine.jet(np.zeros_like(i_d), i_q), machine.jet(i_d, np.zeros_like(i_q))
    small = _SMALL_CURRENT * machine.i_max
    return Inductances(
        here.l_dd,
        here.l_dq,
        here.l_qd,
        here.l_qq,
        at_no_d.psi_d,
        _quotient(here.psi_d - at_no_d.psi_d, i_d, at_no_d.l_dd + 0.5 * at_no_d.d_dd * i_d, small),
        _quotient(here.psi_q, i_q, at_no_q.l_qq + 0.5 * at_no_q.q_qq * i_q, small),
    )


def _quotient(
    flux: FloatArray, current: FloatArray, series: FloatArray, small: float
) -> FloatArray:
    """Flux over current, or the series about zero current where the quotient has no digits."""
    tiny = np.abs(current) < small
    return np.where(tiny, series, flux / np.where(tiny, 1.0, current))
