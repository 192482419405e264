"""What is proven of both current loops together over a box of drives: searched, confirmed in balls,
and where it ends.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.both_axes_sensitivity import MOST_WORK, bound_sensitivity
from dqforge.optimizer.box_proofs.cell_queue import Cell
from dqforge.optimizer.box_proofs.current_loop_checker import (
    Confirmation,
    confirm,
    confirm_sensitivity,
)
from dqforge.optimizer.box_proofs.current_loop_model import (
    BoxDrive,
    CurrentLoopBox,
    gain_interval,
)
from dqforge.optimizer.box_proofs.current_loop_search import CELLS, WORK, find_certificate
from dqforge.optimizer.box_proofs.interior_point import Budget
from dqforge.optimizer.box_proofs.plain_certificate import (
    PlainCertificate,
    plain_certificate,
    plain_inputs,
)

_SAMPLES = 20_000

_SEED = 20_261_122


@dataclass(frozen=True, slots=True)
class DriveRange:
    """Least and largest values between which drives lie: Ohm (dead time included), H, the gain of
    the voltage, and rad/s.
    """

    r_s: tuple[float, float]
    l_d: tuple[float, float]
    l_q: tuple[float, float]
    gain: tuple[float, float]
    omega_e: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ProvenSensitivity:
    """Sensitivity of both axes together over a box: the largest value ``found``, the drive ``at``
    which it is, and the ``bound`` that none exceeds, confirmed with ``certificate``; both None
    where the search ended before.
    """

    found: float
    at: BoxDrive
    bound: float | None
    certificate: PlainCertificate | None


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoopProof:
    """What is known of both current loops together over a box of drives.

    Args:
        box: Control and drives.
        confirmation: What the checker said of the certificate; None with a counterexample.
        certificate: What it was made of, as it is stored; None with a counterexample.
        share: Share of the drives that is proven, of uniform random ones where it is not all.
        still_open: Between which values the drives lie of which nothing is proven; None where all
            are.
        counterexample: A drive of the box whose loops are unstable; None where none was met.
        sensitivity: That of both axes together, where it was asked for.
        left: Work that the search left.
    """

    box: CurrentLoopBox
    confirmation: Confirmation | None
    certificate: PlainCertificate | None
    share: float
    still_open: DriveRange | None = None
    counterexample: BoxDrive | None = None
    sensitivity: ProvenSensitivity | None = None
    left: int = 0

    @property
    def proven(self) -> bool:
        """Whether every drive of the box is proven stable."""
        return self.confirmation is not None and self.confirmation.proven


@lru_cache(maxsize=64)
def prove_current_loops(
    box: CurrentLoopBox, largest: int = CELLS, work: int = WORK
) -> CurrentLoopProof:
    """Prove both current loops together stable for every drive of a box at every constant speed.

    Args:
        box: Control and drives.
        largest: How many cells are looked at before the rest is left open.
        work: Work that may be done before it is.
    """
    budget = Budget(work)
    found = find_certificate(box, largest, budget)
    if found.counterexample is not None:
        return CurrentLoopProof(box, None, None, 0.0, counterexample=found.counterexample)
    certificate = plain_certificate(box, found.tree)
    confirmation = confirm(certificate, plain_inputs(box))
    if confirmation.fault:  # nothing is stated that doubles alone have seen
        return CurrentLoopProof(box, confirmation, None, 0.0, _ranges(box, [found.root]))
    left = found.tree.open_cells
    if not left:
        return CurrentLoopProof(box, confirmation, certificate, 1.0, left=budget.left)
    return CurrentLoopProof(
        box, confirmation, certificate, _proven_share(box, left), _ranges(box, left)
    )


@lru_cache(maxsize=64)
def prove_sensitivity(box: CurrentLoopBox, work: int = MOST_WORK) -> ProvenSensitivity:
    """The largest sensitivity of both axes together that is found in a box, with a proven bound.

    Args:
        box: Control and drives, all of them proven stable.
        work: Work that is left; `MOST_WORK` of it at most is done.
    """
    searched = bound_sensitivity(box, work=min(work, MOST_WORK))
    if np.isfinite(searched.bound):
        certificate = plain_certificate(box, searched.tree)
        if confirm_sensitivity(certificate, plain_inputs(box), searched.bound).proven:
            return ProvenSensitivity(searched.found, searched.at, searched.bound, certificate)
    return ProvenSensitivity(searched.found, searched.at, None, None)


def _proven_share(box: CurrentLoopBox, left: list[Cell]) -> float:
    """Share of uniform random drives that lie in no open cell."""
    points = random_parameters(box, _SAMPLES)
    inside: BoolArray = np.zeros(len(points), dtype=np.bool_)
    for cell in left:
        inside |= ((points >= cell.low) & (points <= cell.high)).all(axis=1)
    return float(1.0 - inside.mean())


def random_parameters(box: CurrentLoopBox, count: int, seed: int = _SEED) -> FloatArray:
    """b_d, b_q, s and x of random drives, uniform in everything that may vary, shape (count, 4)."""
    ends = np.array(
        [box.r_s, box.dead_time, box.l_d, box.l_q, box.gain, (0.0, box.omega_e)], dtype=np.float64
    )
    drives = np.random.default_rng(seed).uniform(ends[:, 0], ends[:, 1], (count, len(ends)))
    r_s, dead_time, l_d, l_q, gain, omega_e = drives.T
    return np.column_stack(
        [
            gain * box.decoupling[0] / l_d,
            gain * box.decoupling[1] / l_q,
            r_s / gain + dead_time,
            omega_e * box.t_s,
        ]
    )


def _ranges(box: CurrentLoopBox, cells: list[Cell]) -> DriveRange:
    """Between which values the drives of some cells lie."""
    each = [_range(box, cell) for cell in cells]
    rows = np.array([[part.r_s, part.l_d, part.l_q, part.gain, part.omega_e] for part in each])
    pairs = zip(rows[:, :, 0].min(axis=0), rows[:, :, 1].max(axis=0), strict=True)
    return DriveRange(*((float(low), float(high)) for low, high in pairs))


def _range(box: CurrentLoopBox, cell: Cell) -> DriveRange:
    low, high = gain_interval(box, cell)
    reach = [
        (
            max(limits[0], low * reference / float(cell.high[axis])),
            min(limits[1], high * reference / float(cell.low[axis])),
        )
        for axis, (limits, reference) in enumerate(
            zip((box.l_d, box.l_q), box.decoupling, strict=True)
        )
    ]
    resistances = [float(s) * gain for s in (cell.low[2], cell.high[2]) for gain in (low, high)]
    least, most = (
        (r + min(c * low, c * high), r + max(c * low, c * high))
        for r, c in zip(box.r_s, box.dead_time, strict=True)
    )
    return DriveRange(
        (max(least[0], min(resistances)), min(most[1], max(resistances))),
        reach[0],
        reach[1],
        (low, high),
        (float(cell.low[3]) / box.t_s, float(cell.high[3]) / box.t_s),
    )
