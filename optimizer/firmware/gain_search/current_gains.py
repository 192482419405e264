"""Gains of the current loops within the structure of a firmware: what the design asks for where
that holds, else the fastest that does.

Every candidate goes through the firmware's own `configure`, so that what is judged are the numbers
that its file holds, and its own loops over the corners of the tolerances. Deterministic.

Gains by a formula with a number that the design names (a bandwidth, given gains) are judged as they
are, and refused with what would hold. Of a formula without such a number the structure may take
slower gains of the same shape; the method ``optimised`` looks for the largest integral gain within
the bound of M_s in this structure.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod
from dqforge.optimizer.firmware.gain_search.chosen import (
    NAMED,
    SHRUNK,
    Chosen,
    bounds_of,
    configured,
    firmware_text,
    lowered,
    possible,
)
from dqforge.optimizer.firmware.gain_search.structure_box import AXES, Bounds, axis_plants
from dqforge.optimizer.firmware.profile import CurrentLoops, LoopProfile
from dqforge.optimizer.firmware.sampled_structure import added_gain
from dqforge.optimizer.firmware.turning_axes import turning_axes
from dqforge.optimizer.loops.loop_batch import PlantBatch
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import calmer, current_pi, largest_factor, loop_advice
from dqforge.optimizer.loops.tolerance_box import DriveBox
from dqforge.optimizer.loops.vendor_methods import vendor_inductance


@dataclass(frozen=True, slots=True)
class CurrentSearch:
    """Search for the gains of both current loops of a drive within one structure."""

    method: FirmwareMethod
    box: DriveBox
    asked: Asked
    settings: CurrentLoopSettings

    @property
    def bounds(self) -> Bounds:
        """What the loops must keep."""
        return bounds_of(self.settings)

    def with_gains(self, d: tuple[float, float], q: tuple[float, float]) -> Asked:
        """What is asked with other current gains, and without a speed loop."""
        return replace(self.asked, current_d=PiGains(*d), current_q=PiGains(*q), speed=None)

    def by(self, trial: CurrentLoopSettings) -> Asked:
        """What is asked by a formula for both axes."""
        design = self.box.design
        d, q = (
            current_pi(
                design.machine.r_s,
                vendor_inductance(trial.method, self.box.nominal, place),
                design.control.t_s,
                trial,
            )
            for place in (0, 1)
        )
        return self.with_gains(d, q)

    def fault(self, chosen: Chosen) -> str | None:
        """What one of both loops does not keep, in words."""
        loops = chosen.profile.current
        for axis, pi in zip(AXES, (loops.d, loops.q), strict=True):
            found = axis_plants(self.box, axis, loops).fault(pi, self.bounds)
            if found is not None:
                return f"the {axis} loop {found}"
        return self._turning_fault(loops)

    def _turning_fault(self, loops: CurrentLoops) -> str | None:
        """That both loops together are unstable at a speed that the machine reaches, in words."""
        machine = self.box.design.machine
        if machine.omega_m_max is None:
            return None
        found = turning_axes(
            machine.r_s, self.box.nominal, loops, machine.pole_pairs, machine.omega_m_max
        )
        if found.unstable_from is None:
            return None
        return (
            "both current loops together are unstable from about "
            f"{found.unstable_from * 30.0 / math.pi:.4g} rpm (largest pole modulus "
            f"{found.radius:.4g})"
        )

    def holds(self, asked: Asked) -> bool:
        """Whether gains can be held and keep the bounds."""
        if not min(asked.current_d.kp, asked.current_d.ki, asked.current_q.kp) > 0.0:
            return False
        chosen = possible(self.method, asked)
        return chosen is not None and self.fault(chosen) is None

    def family(self) -> CurrentLoopSettings:
        """Settings with a number that can be lowered."""
        settings = self.settings
        if settings.method in ("magnitude-optimum", "optimised"):
            bandwidth = self.asked.current_q.kp / self.box.nominal[1]
            return replace(settings, method="bandwidth", bandwidth=bandwidth)
        return settings

    def solve(self) -> Chosen:
        """Gains that keep the bounds; raises `NoSolutionError` where there are none."""
        first = configured(self.method, replace(self.asked, speed=None))
        if self.settings.method == "optimised":
            found = self._optimised(first)
            if found is not None:
                return found
        fault = self.fault(first)
        if fault is None:
            return first
        family = self.family()
        factor = largest_factor(lambda share: self.holds(self.by(calmer(family, share))))
        advice = "no slower gains of this method hold" if factor is None else ""
        if factor is not None and self.settings.method not in NAMED:
            slower = self.by(calmer(family, factor))
            return configured(
                self.method, slower, lowered("the current loops", fault, factor, self.method)
            )
        advice = advice or loop_advice("control.current_loop", family, factor or 1.0)
        raise NoSolutionError(
            f"control.current_loop: as {firmware_text(self.method)} runs it, by method "
            f"'{self.settings.method}' {fault}; {advice}"
        )

    def _optimised(self, first: Chosen) -> Chosen | None:
        """Largest integral gain within M_s in the firmware's structure, after rounding."""
        for share in SHRUNK:
            bound = 1.0 + share * (self.settings.max_sensitivity - 1.0)
            asked = self._free(first.profile, bound)
            if asked is not None and self.holds(asked):
                return configured(self.method, asked)
        return None

    def _free(self, profile: LoopProfile, bound: float) -> Asked | None:
        loops, r_s = profile.current, self.box.design.machine.r_s
        if self.method.free == "bandwidth":
            tight = replace(self, settings=replace(self.settings, max_sensitivity=bound))
            start = replace(self.family(), bandwidth=1.0 / ((loops.delay + 0.5) * loops.q.t_s))
            factor = largest_factor(lambda share: tight.holds(self.by(calmer(start, share))))
            return None if factor is None else self.by(calmer(start, factor))
        both = [axis_plants(self.box, axis, loops).plants for axis in AXES]
        sets = [_together(both)] * 2 if self.method.free == "one-pair" else both
        found = []
        for plants, inductance, pi in zip(sets, self.box.nominal, (loops.d, loops.q), strict=True):
            scale = pi_scale(inductance, r_s, (loops.delay + 0.5) * pi.t_s)
            kp, ki = optimised_pi(plants, bound, scale, "control.current_loop")
            found.append((kp + added_gain(replace(pi, ki=ki)), ki))
        return self.with_gains(found[0], found[1])


def _together(batches: list[PlantBatch]) -> PlantBatch:
    """Plants of both axes as one set."""
    return replace(
        batches[0],
        a=np.concatenate([batch.a for batch in batches]),
        b=np.concatenate([batch.b for batch in batches]),
    )
