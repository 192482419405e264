"""What parameters of Infineon's motor-ctrl-lib cannot hold of a design, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.common_shortfalls import (
    NOTICED,
    closed_form_currents,
    other_periods,
)
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.infineon_format.flux_table import flux_table
from dqforge.optimizer.firmware.infineon_format.infineon_configuration import (
    current_rule,
    speed_rule,
)
from dqforge.optimizer.firmware.infineon_format.infineon_keys import (
    TABLE,
    TABLE_POINTS,
    number,
)


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the parameters do not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    return (
        *_rule_of_currents(held),
        *_rule_of_speed(asked, held),
        *_currents(asked, held),
        *other_periods(asked, held, "the library"),
        *_table(asked, held),
    )


def _rule_of_currents(held: Configuration) -> Iterator[Shortfall]:
    """What the library makes of the bandwidth where the gains are not assigned after it."""
    drive, gains, bandwidth = held.drive, held.current_q, number(held.own, "ctrl.curr.bw")
    if gains is None or not bandwidth or not drive.l_q or drive.r_s is None:
        return
    rule = current_rule(drive.r_s, drive.l_q, bandwidth)
    if math.isclose(rule.ki, gains.ki, rel_tol=NOTICED):
        return
    yield Shortfall(
        f"the library's own integral gain is bw r = {rule.ki:.4g} V/(A s); the "
        f"{gains.ki:.4g} V/(A s) asked for hold only where the second function is called after "
        f"PARAMS_InitAutoCalc",
        _off("q integral gain of the library's own rule", rule.ki, gains.ki),
    )


def _off(of: str, its: float, wished: float) -> tuple[Price, ...]:
    """Share by which a gain differs; no price where none was asked for."""
    return (Price(of, its / wished - 1.0, ""),) if wished else ()


def _rule_of_speed(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive, bandwidth = held.drive, number(held.own, "ctrl.speed.bw")
    if asked.speed is None or not bandwidth or not drive.pole_pairs:
        return
    if not drive.psi_pm or not drive.inertia:
        return
    viscous = drive.viscous or 0.0
    rule = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, viscous, bandwidth)
    if math.isclose(rule.ki, asked.speed.ki, rel_tol=NOTICED):
        return
    yield Shortfall(
        f"the library's own integral gain of the speed is viscous friction times bw = "
        f"{rule.ki:.4g} A/rad instead of {asked.speed.ki:.4g} A/rad: without the second function "
        f"the speed sinks by {1.0 / max(rule.kp, 1e-30):.3g} rad/s per ampere of load",
        _off("integral gain of the speed by the library's own rule", rule.ki, asked.speed.ki),
    )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = held.drive
    saliency = (drive.l_q or 0.0) - (drive.l_d or 0.0)
    lead = "with rotor frame orientation the currents of most torque per ampere"
    tail = "; with stator frame orientation the table mtpa_lut holds them"
    return closed_form_currents(asked, held, saliency, lead, tail=tail)


def _table(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    if TABLE not in held.own:
        return
    table = flux_table(asked.design)
    most = float(table.flux[-1])
    words = (
        f"the {TABLE_POINTS} points of mtpa_lut, joined by lines, are off by at most "
        f"{table.error:.2g} Wb ({100.0 * table.error / most:.2g} % of the largest flux linkage)"
    )
    prices = [Price("flux linkage", table.error, "Wb")]
    if table.of_constants > max(NOTICED * most, table.error):
        words += (
            f"; those that the library works out of constant ld and lq by "
            f"{100.0 * table.of_constants / most:.2g} %"
        )
        prices.append(Price("flux linkage of the library's own table", table.of_constants, "Wb"))
    yield Shortfall(words, tuple(prices))
