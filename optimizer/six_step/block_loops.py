"""The speed loop of a six-step drive, whose speed is known six times per turn.

The speed is the mean over two blocks, old by one block on average and held for half of one more:
1.5 pi/(3 omega), longest at the least speed. That is one more of the small delays of the
symmetrical optimum, and a dead time in its margin.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.pi_methods import speed_pi

_FASTER = 1.25  # of the spread that rising gains may take away


_MOST = 10.0  # by which they rise


_BLOCKS = 1.5  # by which the speed is late


@dataclass(frozen=True, slots=True)
class BlockSpeedLoop:
    """A speed controller that commands torque.

    Args:
        kp, ki: In N m s/rad and N m/rad.
        t_s, ratio: Period in s, and periods of the current controller in it.
        delay: Of the speed at the least speed, in s.
        crossover, margin: In rad/s, and in rad at the least speed.
        scale: How far kp rises with the speed, and ki with its square: the delay falls as they
            rise.
    """

    kp: float
    ki: float
    t_s: float
    ratio: int
    delay: float
    crossover: float
    margin: float
    scale: float


def block_speed_loop(design: Design, current: LoopGains, omega_low: float) -> BlockSpeedLoop | None:
    """The speed loop that a design asks for.

    Args:
        design: With the inertia.
        current: Its current loop.
        omega_low: Least electrical speed in rad/s.

    Raises:
        NoSolutionError: Its margin at the least speed is too small.
    """
    settings, machine = design.control.speed_loop, design.machine
    if settings is None:
        return None
    inertia = machine.inertia or math.nan
    t_s = settings.ratio * design.control.t_s
    delay = _BLOCKS * math.pi / 3.0 / omega_low
    lag = 1.0 / current.crossover
    kp, ki = speed_pi(inertia, machine.friction, lag + 0.5 * t_s + delay, settings)
    scale = 1.0
    if settings.method != "given":
        fixed = lag + 0.5 * t_s
        scale = min(max((_FASTER * (fixed + delay) - delay) / fixed, 1.0), _MOST)

    def at(factor: float) -> tuple[float, float]:
        w = np.geomspace(1e-3, 10.0, 4000) * factor * kp / inertia
        s = 1j * w
        loop = (factor * kp + factor**2 * ki / s) / (inertia * s + machine.friction)
        loop = loop / (1.0 + lag * s)
        crossing = int(np.argmin(np.abs(np.log(np.abs(loop)))))
        late = delay / factor + 0.5 * t_s
        angle = math.pi + float(np.angle(loop[crossing])) - float(w[crossing]) * late
        return float(w[crossing]), angle

    (crossover, margin), (_, fast) = at(1.0), at(scale)
    margin = min(margin, fast)
    if margin < settings.min_phase_margin:
        better = (
            f"a spread above {settings.spread:.3g}"
            if settings.method == "symmetrical-optimum"
            else "method: symmetrical-optimum, or smaller gains"
        )
        raise NoSolutionError(
            f"control.speed_loop: kp = {kp:.4g}, ki = {ki:.4g} leave "
            f"{math.degrees(margin):.3g} deg at {omega_low:.4g} rad/s (electrical), "
            f"where the speed is {1e3 * delay:.3g} ms late, "
            f"{math.degrees(settings.min_phase_margin):.3g} deg are wanted; write {better}"
        )
    return BlockSpeedLoop(kp, ki, t_s, settings.ratio, delay, crossover, margin, scale)
