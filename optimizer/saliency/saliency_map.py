"""The saliency of a machine along the currents that it is driven with, from its flux map.

With the incremental inductances at a current, Y = L^-1 is Y_sum + Y_delta (cos 2 chi, sin 2 chi;
sin 2 chi, -cos 2 chi): the axis of the largest admittance lies at chi from the d axis, which cross
saturation turns away from it. References: paper 001, 7.2.4; M. Corley, R. Lorenz, IEEE Trans. IA
34, 1998.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

# Larger over smaller inductance below which noise and unequal phases hide the angle.
LEAST_RATIO = 1.1
_FINE = 65


@dataclass(frozen=True, slots=True, eq=False)
class LoadedSaliency:
    """Saliency at currents, arrays of shape (N,).

    ``i_d``, ``i_q`` in A and ``torque`` in N m; ``y_sum`` and ``y_delta`` in 1/H, the latter
    negative where l_d is above l_q without load; ``axis`` is chi in rad.
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    y_sum: FloatArray
    y_delta: FloatArray
    axis: FloatArray

    @property
    def ratio(self) -> FloatArray:
        """Larger over smaller incremental inductance, shape (N,)."""
        share = np.abs(self.y_delta) / self.y_sum
        return np.asarray((1.0 + share) / (1.0 - share))


def saliency_at(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> LoadedSaliency:
    """Saliency at currents in A, shape (N,)."""
    jet = machine.jet(i_d, i_q)
    none = np.zeros(1)
    bare = machine.jet(none, none)
    sign = 1.0 if bare.l_qq[0] >= bare.l_dd[0] else -1.0
    det = jet.l_dd * jet.l_qq - jet.l_dq * jet.l_qd
    along = sign * 0.5 * (jet.l_qq - jet.l_dd) / det
    across = -sign * 0.5 * (jet.l_dq + jet.l_qd) / det
    return LoadedSaliency(
        i_d,
        i_q,
        machine.torque(i_d, i_q),
        0.5 * (jet.l_dd + jet.l_qq) / det,
        sign * np.hypot(along, across),
        0.5 * np.arctan2(across, along),
    )


def along_locus(design: Design, points: int) -> LoadedSaliency:
    """At equal steps of i_q from none to that of the largest torque, by the currents of the design,
    shape (points,).
    """
    machine = design.machine
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    fine = choice.points(choice.largest_torque() * np.linspace(0.0, 1.0, _FINE))
    i_q = np.linspace(0.0, float(fine.i_q[-1]), points)
    return saliency_at(machine, np.interp(i_q, fine.i_q, fine.i_d), i_q)


def require_saliency(found: LoadedSaliency, name: str) -> None:
    """Refuse a machine whose saliency does not show the angle.

    Raises:
        NoSolutionError: Its ratio is below the least one, without load or at one; the message has
            both.
    """
    ratio = found.ratio
    if ratio[0] < LEAST_RATIO:
        raise NoSolutionError(
            f"control.observer: {name} needs inductances that differ by {LEAST_RATIO:g} or more, "
            f"those of this machine do by {ratio[0]:.3g} without load; choose an observer, and "
            "start by a ramp"
        )
    beyond = np.flatnonzero((ratio < LEAST_RATIO) | (np.abs(found.axis) > np.pi / 4.0))
    if beyond.size:
        k = int(beyond[0])
        raise NoSolutionError(
            f"control.observer: {name} loses the angle under load: at {found.torque[k]:.3g} N m "
            f"(i_d = {found.i_d[k]:.3g} A, i_q = {found.i_q[k]:.3g} A) the incremental inductances "
            f"differ by {ratio[k]:.3g} and their axis lies {np.degrees(found.axis[k]):.3g} deg "
            f"beside d; {LEAST_RATIO:g} and 45 deg are the limits. Write a smaller current limit, "
            "or choose an observer"
        )
