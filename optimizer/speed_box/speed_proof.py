"""What is proven of a design's speed loop: all of its box, or which share."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.cell_queue import Proven, Tree
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.tolerance_box import DriveBox
from dqforge.optimizer.speed_box.speed_loop_steps import SpeedLoopNumbers, cell_corners, speed_scale
from dqforge.optimizer.speed_box.speed_parameters import Interval, SpeedBox
from dqforge.optimizer.speed_box.speed_search import Chain, Effort, SpeedSearch

_ROUNDED = 1e-12  # Share by which the torque factor, a result of several operations, is widened.

# Inequalities of a search: a cell has one per corner and current sample. Counted, not timed, so
# that the same design gives the same bytes.
_SAMPLES = 20_000
_SEED = 20_261_122
_QUICK, _THOROUGH = 640, 30_000
_LARGEST = 16  # Cells of a quick search at most.


@dataclass(frozen=True, slots=True)
class SpeedProof:
    """What is proven of the speed loop.

    Args:
        share: Share of the box that is proven, 1 where all of it is.
        cells: Cells that were looked at.
        leaves: Cells that the proof consists of.
        ratio: Current samples between two of the speed, each with a matrix of its own in the proof.
        box: The drives, as the loop sees them.
        unstable: Deviations of a drive that is unstable, None where none was found.
        tree: The search, with a chain of matrices per proven cell.
    """

    share: float
    cells: int
    leaves: int
    ratio: int
    box: SpeedBox
    unstable: Mapping[str, float] | None
    tree: Tree[Chain]

    @property
    def complete(self) -> bool:
        """Whether every drive of the box is proven."""
        return self.tree.complete


def _reach(deviations: FloatArray) -> Interval:
    return 1.0 + float(np.min(deviations)), 1.0 + float(np.max(deviations))


def speed_box(box: DriveBox) -> SpeedBox:
    """The drives that the speed loop depends on.

    Args:
        box: The drive with its tolerances.
    """
    points, design = box.speed_points(), box.design
    factors = box.torque_factor(points)
    wider = np.array([1.0 - _ROUNDED, 1.0 + _ROUNDED])
    torque = wider * (float(np.min(factors)), float(np.max(factors)))
    if np.ptp(factors) == 0.0:
        torque = np.full(2, factors[0])
    masses = _reach(points.of("inertia"))
    # What a dead time adds to R/R' per gain of the voltage, in 1/s at first.
    per_gain = 4.0 / np.pi * design.inverter.f_sw * design.inverter.v_dc / design.machine.r_s
    dead = _extremes(points.of("dead_time"))
    if dead != (0.0, 0.0):
        per_gain /= box.tolerances.low_current
    flux = design.machine.pole_pairs * design.machine.psi_pm
    emf = _extremes(points.of("psi_pm"))
    return SpeedBox(
        resistance=_reach(points.of("r_s")),
        inductance=_reach(points.of("l_q")),
        gain=_reach(points.of("v_dc")),
        dead_time=(dead[0] * per_gain, dead[1] * per_gain),
        torque=(float(torque[0]), float(torque[1])),
        inertia=(1.0 / masses[1], 1.0 / masses[0]),
        back_emf=(flux * emf[0], flux * emf[1]),
    )


def _extremes(deviations: FloatArray) -> Interval:
    return float(np.min(deviations)), float(np.max(deviations))


def speed_numbers(
    box: DriveBox, drives: SpeedBox, gains: LoopGains, current_gains: LoopGains
) -> SpeedLoopNumbers:
    """The loop without unit.

    Args:
        box: The drive with its tolerances.
        drives: The same as the speed loop sees it.
        gains, current_gains: The speed loop, and the current loop of the q axis.
    """
    machine, control = box.design.machine, box.design.control
    settings, inertia, l_q = control.speed_loop, machine.inertia, box.nominal[1]
    assert settings is not None
    assert inertia is not None
    t_s, constant = control.t_s, machine.torque_per_ampere
    h, eta = gains.kp * t_s / inertia, t_s * constant / (l_q * gains.kp)
    emf = max(abs(side) for side in drives.back_emf) / drives.gain[0]
    scale = speed_scale(h, eta * emf)
    return SpeedLoopNumbers(
        rho=machine.r_s * t_s / l_q,
        h=h / scale,
        p=current_gains.kp * t_s / l_q,
        q=current_gains.ki_ts * t_s / l_q,
        eta=eta * scale,
        integral=gains.ki_ts / gains.kp,
        friction=machine.friction * t_s / inertia,
        filtering=t_s / settings.filter_time if settings.filter_time > 0.0 else 0.0,
        ratio=settings.ratio,
        uneven=max(abs(1.0 / side - 1.0) for side in drives.torque),
        scale=scale,
    )


def prove_speed_loop(
    box: DriveBox, gains: LoopGains, current_gains: LoopGains, *, thorough: bool = False
) -> SpeedProof:
    """Prove the speed loop for every drive of the box, or as much of it as the effort allows.

    Args:
        box: The drive with its tolerances.
        gains, current_gains: The speed loop on a measured speed, and the current loop of the q
            axis.
        thorough: Whether some fifty times the effort is spent that every run can afford.
    """
    drives = speed_box(box)
    loop = speed_numbers(box, drives, gains, current_gains)
    per_cell = loop.ratio * len(cell_corners(drives.root()))
    cells = _THOROUGH // per_cell if thorough else min(_QUICK // per_cell, _LARGEST)
    tree = SpeedSearch(loop, drives, Effort(cells)).run()
    point = tree.counterexample
    return SpeedProof(
        share=_share(drives, tree),
        cells=tree.examined,
        leaves=sum(isinstance(node.verdict, Proven) for node in tree.nodes),
        ratio=loop.ratio,
        box=drives,
        unstable=None if point is None else drives.named(point),
        tree=tree,
    )


def _share(drives: SpeedBox, tree: Tree[Chain]) -> float:
    """Share of random drives outside all open cells."""
    cells = tree.open_cells
    if not cells:
        return 1.0
    points = drives.samples(_SAMPLES, np.random.default_rng(_SEED))
    inside = np.zeros(len(points), dtype=np.bool_)
    for cell in cells:
        inside |= np.all((points >= cell.low) & (points <= cell.high), axis=1)
    return 1.0 - float(np.mean(inside))
