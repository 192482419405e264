"""Slower speed loops of the same method, and how to ask for one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from dqforge.optimizer.loops.pi_methods import calmer, loop_advice, speed_pi

if TYPE_CHECKING:
    from dqforge.machines.design.settings import SpeedLoopSettings
    from dqforge.optimizer.loops.loop_gains import LoopGains

# Share of the largest factor for which gains are printed: their four digits may round it up.
ROUNDED = 0.998


def slower_speed_pi(
    settings: SpeedLoopSettings, speed: LoopGains, t_sum: float, mechanics: tuple[float, float]
) -> Callable[[float], tuple[float, float]]:
    """Gains (kp in N m s/rad, ki in N m/rad) of a slower loop by a factor below one.

    Of gains that follow from no rule kp by the factor and ki by its square.

    Args:
        settings, speed: How the loop is tuned, and its gains.
        t_sum: Sum of the small delays in s.
        mechanics: Inertia in kg m^2 and friction in N m s.
    """
    if settings.method in ("given", "optimised"):
        return lambda factor: (speed.kp * factor, speed.ki * factor**2)
    return lambda factor: speed_pi(*mechanics, t_sum, calmer(settings, factor))


def speed_advice(settings: SpeedLoopSettings, gains: tuple[float, float], factor: float) -> str:
    """What to write for the slower loop.

    Args:
        settings: How the loop is tuned.
        gains: Of the slower loop.
        factor: The factor that made it.
    """
    if settings.method in ("given", "optimised"):
        return (
            f"it holds with control.speed_loop.kp = {gains[0]:.4g} N m s/rad and ki = "
            f"{gains[1]:.4g} N m/rad"
        )
    return loop_advice("control.speed_loop", settings, factor)
