"""What VESC's configuration cannot hold of a design, and what that costs."""

from __future__ import annotations

from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Parameters
    ----------
    asked:
        What was asked.
    held:
        What `configure` made of it.
    """
    return tuple(_one_pair(asked, held))


def _one_pair(asked: Asked, held: Configuration) -> list[Shortfall]:
    if held.current_q is None or asked.current_d == asked.current_q:
        return []
    changes = [
        Price(f"gain of the {axis} axis", held.current_q.kp / gains.kp - 1.0, "")
        for axis, gains in (("d", asked.current_d), ("q", asked.current_q))
    ]
    return [
        Shortfall(
            f"VESC has one foc_current_kp for both axes: {held.current_q.kp:.4g} V/A stands for "
            f"{asked.current_d.kp:.4g} V/A (d) and {asked.current_q.kp:.4g} V/A (q)",
            tuple(changes),
        )
    ]
