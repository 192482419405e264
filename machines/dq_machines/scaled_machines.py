"""Many machines over one flux map: each with its own magnet, inductances and saturation current.

A tolerance of a saturated machine is a change of its map. With psi_0 the open-circuit flux linkage
of the map and i' = i / current::

    psi_d(i) = current (magnet psi_0 + inductance_d (psi_d'(i') - psi_0)),
    psi_q(i) = current inductance_q psi_q'(i')

is the map of a machine whose magnet, whose d and q inductances and whose current of saturation
differ by those factors; ``current`` scales flux linkage and current alike, so that the inductances
stay. Where the d and q factors differ, cross-coupled maps lose their reciprocity by as much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import FluxFormulas, FluxJet
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class ScaledMachines(FluxFormulas):
    """N machines over the flux map of one; columns of shape (N,).

    As with `MachineBatch`, the last axis of currents is that of the machines.

    Args:
        nominal: The machine whose map is scaled; pole pairs, inertia, friction and speed are its
            own.
        magnet, inductance_d, inductance_q, current: Factors of the open-circuit flux linkage, of
            the flux linkage that d and q currents make, and of the current at which it saturates.
        r_s: Phase resistances in Ohm.
        i_max: Largest permitted currents in A, peak of phase.

    Raises:
        InputError: Columns of different lengths, or a value that is not positive: names column and
            row.
    """

    nominal: SaturatedMachine
    magnet: FloatArray
    inductance_d: FloatArray
    inductance_q: FloatArray
    current: FloatArray
    r_s: FloatArray
    i_max: FloatArray

    def __post_init__(self) -> None:
        """Own the columns and refuse what no machine has."""
        names = [part.name for part in fields(self)[1:]]
        shape = np.shape(self.magnet)
        for name in names:
            owned = np.array(getattr(self, name), dtype=np.float64)
            if owned.ndim != 1 or owned.shape != shape:
                raise InputError(
                    f"machines: {name} has the shape {owned.shape}, magnet {shape}; every column "
                    "needs one value per machine"
                )
            least = owned >= 0.0 if name in ("magnet", "r_s") else owned > 0.0
            wrong = ~(least & np.isfinite(owned))
            if np.any(wrong):
                row = int(np.argmax(wrong))
                raise InputError(
                    f"machines: {name} of machine {row} is {owned[row]:g}; expected a positive "
                    "number"
                )
            owned.flags.writeable = False
            object.__setattr__(self, name, owned)

    @classmethod
    def varied(
        cls, nominal: SaturatedMachine, count: int, columns: Mapping[str, ArrayLike]
    ) -> ScaledMachines:
        """One machine ``count`` times, but for the ``columns`` given: by name, shape (count,)."""
        base = {part.name: 1.0 for part in fields(cls)[1:]}
        base |= {"r_s": nominal.r_s, "i_max": nominal.i_max}
        unknown = sorted(set(columns) - set(base))
        if unknown:
            raise InputError(f"machines: no column {unknown[0]}; there are {', '.join(base)}")
        whole = {
            name: np.asarray(columns[name], dtype=np.float64)
            if name in columns
            else np.full(count, value)
            for name, value in base.items()
        }
        return cls(nominal, **whole)

    @property
    def count(self) -> int:
        """Number of machines N."""
        return int(self.magnet.size)

    @property
    def pole_pairs(self) -> int:
        """Number of pole pairs p, of all."""
        return self.nominal.pole_pairs

    @property
    def friction(self) -> float:
        """Viscous friction in N m s/rad, of all."""
        return self.nominal.friction

    def taken(self, rows: IndexArray | BoolArray) -> ScaledMachines:
        """The machines of some rows, by their places or by a mask, in that order."""
        columns = {part.name: getattr(self, part.name)[rows] for part in fields(self)[1:]}
        return ScaledMachines(self.nominal, **columns)

    def repeated(self, count: int) -> ScaledMachines:
        """Each machine ``count`` times in a row: one per point of a list, machine by machine."""
        return self.taken(np.repeat(np.arange(self.count), count))

    def machine(self, row: int) -> SaturatedMachine:
        """One of the machines, with a map of its own."""
        flux_map, k = self.nominal.flux_map, float(self.current[row])
        hull = flux_map.hull
        if hull is not None:
            hull = CurrentRegion(k * hull.corner_d, k * hull.corner_q)
        whole = self._flux(flux_map.psi_d, flux_map.psi_q, np.array([row]))
        own = FluxMap(k * flux_map.i_d, k * flux_map.i_q, *whole, flux_map.extrapolate, hull)
        return SaturatedMachine(
            self.pole_pairs,
            float(self.r_s[row]),
            own,
            float(self.i_max[row]),
            self.nominal.inertia,
            self.friction,
            self.nominal.omega_m_max,
        )

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, shape (..., N)."""
        found = self.nominal.flux_map.flux(i_d / self.current, i_q / self.current)
        return self._flux(*found, np.arange(self.count))

    def _flux(
        self, psi_d: FloatArray, psi_q: FloatArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flux linkages of the map as those of machines."""
        own, k = self.nominal.psi_pm, self.current[rows]
        magnet, d, q = self.magnet[rows], self.inductance_d[rows], self.inductance_q[rows]
        # Written so that scales of 1 leave every digit of the map.
        return k * ((magnet - d) * own + d * psi_d), k * (q * psi_q)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, shape (..., N)."""
        jet = self.nominal.flux_map.jet(i_d / self.current, i_q / self.current)
        psi_d, psi_q = self._flux(jet.psi_d, jet.psi_q, np.arange(self.count))
        # Flux linkage and current scale alike: the inductances do not, their slopes inversely.
        d, q = self.inductance_d, self.inductance_q
        bend_d, bend_q = d / self.current, q / self.current
        return FluxJet(
            psi_d=psi_d,
            psi_q=psi_q,
            l_dd=d * jet.l_dd,
            l_dq=d * jet.l_dq,
            l_qd=q * jet.l_qd,
            l_qq=q * jet.l_qq,
            d_dd=bend_d * jet.d_dd,
            d_dq=bend_d * jet.d_dq,
            d_qq=bend_d * jet.d_qq,
            q_dd=bend_q * jet.q_dd,
            q_dq=bend_q * jet.q_dq,
            q_qq=bend_q * jet.q_qq,
        )

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether the map has data at currents in A, shape (..., N)."""
        return self.nominal.flux_map.inside(i_d / self.current, i_q / self.current)
