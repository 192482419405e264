"""The loops of a firmware over the box of drives that the tolerances allow: its corners, and the
data themselves.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.profile import CurrentLoops, PiController, SpeedController
from dqforge.optimizer.firmware.sampled_structure import (
    Mechanics,
    Winding,
    current_plant,
    equivalent_gains,
    speed_plant,
)
from dqforge.optimizer.loops.loop_batch import BatchMargins, PlantBatch, batch_margins, close_loops
from dqforge.optimizer.loops.robustness import LoopRobustness, first_fault, summarise
from dqforge.optimizer.loops.tolerance_box import Axis, BoxPoints, DriveBox
from dqforge.optimizer.sampled_systems import SampledSystem

AXES: tuple[Axis, Axis] = ("i_d", "i_q")


_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a loop must keep: phase margin in rad, and largest M_s (inf where none is asked)."""

    phase_margin: float
    max_sensitivity: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class BoxedPlants:
    """Plants of one loop at M points of the box."""

    plants: PlantBatch
    points: BoxPoints

    def margins(self, pi: PiController) -> BatchMargins:
        """Margins with a controller, at every point."""
        return batch_margins(close_loops(self.plants, *equivalent_gains(pi)))

    def fault(self, pi: PiController, bounds: Bounds) -> str | None:
        """What the worst point does not keep, in words; None where all keep all."""
        loops = close_loops(self.plants, *equivalent_gains(pi))
        stable = bool(np.max(loops.radius) < 1.0)
        margins = batch_margins(loops) if stable else _radii_only(loops.radius)
        found = first_fault(margins, self.points, bounds.phase_margin)
        if found is not None:
            text = f"{found}, required are {math.degrees(bounds.phase_margin):.1f} deg"
            return text if self.points.names else text.replace(f" at {self.points.text(0)}", "")
        row = int(np.argmax(margins.max_sensitivity))
        worst = float(margins.max_sensitivity[row])
        if worst <= bounds.max_sensitivity * (1.0 + _ROUNDING):
            return None
        where = f" at {self.points.text(row)}" if self.points.names else ""
        return f"has M_s = {worst:.4g}{where}, required is {bounds.max_sensitivity:.4g}"

    def kept(self, pi: PiController) -> LoopRobustness:
        """The worst margins over the points."""
        return summarise(self.margins(pi), self.points)


def _radii_only(radius: FloatArray) -> BatchMargins:
    silent = np.full(len(radius), np.nan)
    return BatchMargins(radius, silent, silent, silent, silent, silent)


def _corners(points: BoxPoints) -> BoxPoints:
    """The corners, and last the data themselves."""
    rows = np.append(np.arange(points.corners), len(points.deviations) - 1)
    return replace(points, deviations=points.deviations[rows], loaded=points.loaded[rows])


def _batch(systems: list[SampledSystem]) -> PlantBatch:
    return PlantBatch(
        np.stack([system.a for system in systems]),
        np.stack([system.b[:, 0] for system in systems]),
        int(np.argmax(systems[0].c[0])),
        systems[0].t_s,
    )


def axis_plants(box: DriveBox, axis: Axis, loops: CurrentLoops) -> BoxedPlants:
    """Plants of one current loop over the box.

    Args:
        box: The drive with its tolerances.
        axis: Which axis.
        loops: The structure: period, filter and delay.
    """
    place, name = (0, "l_d") if axis == "i_d" else (1, "l_q")
    pi = loops.d if axis == "i_d" else loops.q
    points = _corners(box.current_points(axis))
    rows = zip(
        box.resistance(points),
        box.nominal[place] * (1.0 + points.of(name)),
        1.0 + points.of("v_dc"),
        strict=True,
    )
    systems = [
        current_plant(Winding(float(r_s), float(inductance), float(gain)), pi, loops.delay)
        for r_s, inductance, gain in rows
    ]
    return BoxedPlants(_batch(systems), points)


def speed_plants_over(box: DriveBox, loops: CurrentLoops, speed: SpeedController) -> BoxedPlants:
    """Plants of the speed loop over the box, from q current to the speed that is controlled.

    Args:
        box: The drive with its tolerances; its machine has magnets and an inertia.
        loops, speed: The structure with its current gains.
    """
    machine, points = box.design.machine, _corners(box.speed_points())
    assert machine.inertia is not None
    constant = machine.pole_pairs * machine.psi_pm
    left = points.of("psi_pm") if loops.back_emf else 1.0 + points.of("psi_pm")
    inertia = machine.inertia * (1.0 + points.of("inertia"))
    torque = 1.5 * constant * box.torque_factor(points)
    inductance = box.nominal[1] * (1.0 + points.of("l_q"))
    resistance, gain = box.resistance(points), 1.0 + points.of("v_dc")
    systems = [
        speed_plant(
            Winding(float(resistance[row]), float(inductance[row]), float(gain[row])),
            Mechanics(
                float(inertia[row]),
                machine.friction,
                float(torque[row]),
                float(constant * left[row]),
            ),
            loops,
            speed,
        )
        for row in range(len(points.deviations))
    ]
    return BoxedPlants(_batch(systems), points)
