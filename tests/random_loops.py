"""Random current loops of one axis with tolerances, for what is proven of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from drives import make_design

from dqforge.machines.design.settings import CurrentLoopSettings, Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import CurrentLoopMethod
from dqforge.optimizer.loops.loop_gains import LoopGains, analyse_current_loop
from dqforge.optimizer.loops.pi_methods import BatchMargins, batch_margins, close_loops, current_pi
from dqforge.optimizer.loops.robustness import BoxPoints, DriveBox, LoopRobustness, summarise

METHODS: tuple[CurrentLoopMethod, ...] = (
    "bandwidth",
    "damping",
    "magnitude-optimum",
    "symmetrical-optimum",
)

WIDE = Tolerances(r_s=(-0.3, 0.6), l_d=0.3, l_q=0.3, v_dc=0.2)


@dataclass(frozen=True)
class AxisDrive:
    """A drive, the loop of its q axis, and what corners and samples find."""

    box: DriveBox
    gains: LoopGains
    found: LoopRobustness

    def margins(self, points: BoxPoints) -> BatchMargins:
        """Margins of the loop at points of the box."""
        plants = self.box.current_loop_plants("i_q", points)
        return batch_margins(close_loops(plants, self.gains.kp, self.gains.ki))


def axis_drive(
    r_s: float,
    inductance: float,
    t_s: float,
    gains: tuple[float, float],
    tolerances: Tolerances = WIDE,
) -> AxisDrive | None:
    """A drive with gains (V/A, V/(A s)), None where a corner or a sample is unstable."""
    machine = LinearMachine(2, r_s, inductance, inductance, 0.1, 10.0, inertia=1e-3)
    made = make_design(machine)
    control = replace(made.control, t_s=t_s, observer=None, tolerances=tolerances)
    box = DriveBox(replace(made, control=control), tolerances, (inductance, inductance))
    points = box.current_points("i_q")
    margins = batch_margins(close_loops(box.current_loop_plants("i_q", points), *gains))
    if np.max(margins.radius) >= 1.0:
        return None
    loop = analyse_current_loop(r_s, inductance, t_s, *gains, respond=False)
    return AxisDrive(box, loop, summarise(margins, points))


def random_axis_drive(generator: np.random.Generator) -> AxisDrive:
    """A drive with gains by a random method, stable at the corners and samples of its box."""
    while True:
        r_s = 10.0 ** generator.uniform(-2.5, 0.7)
        inductance = r_s * 10.0 ** generator.uniform(-3.3, -1.5)
        t_s = 10.0 ** generator.uniform(-4.6, -3.6)
        settings = CurrentLoopSettings(
            method=METHODS[int(generator.integers(len(METHODS)))],
            bandwidth=generator.uniform(0.03, 0.5) / t_s,
            damping=generator.uniform(0.6, 1.5),
            spread=generator.uniform(1.8, 4.0),
        )
        gains = current_pi(r_s, inductance, t_s, settings)
        if min(gains) > 0.0:
            found = axis_drive(r_s, inductance, t_s, gains)
            if found is not None:
                return found
