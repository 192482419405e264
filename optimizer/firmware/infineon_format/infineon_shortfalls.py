"""What parameters of Infineon's motor-ctrl-lib cannot hold of a design, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.current_prices import linear_rule, price_of
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.infineon_format.flux_table import flux_table
from dqforge.optimizer.firmware.infineon_format.infineon_configuration import (
    current_rule,
    speed_rule,
)
from dqforge.optimizer.firmware.infineon_format.infineon_keys import TABLE, TABLE_POINTS, number

_NOTICED = 1e-3


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the parameters do not hold of what was asked, each with its price.

    Parameters
    ----------
    asked:
        What was asked.
    held:
        What was made of it.
    """
    return (
        *_rule_of_currents(held),
        *_rule_of_speed(asked, held),
        *_currents(asked, held),
        *_periods(asked, held),
        *_table(asked, held),
    )


def _rule_of_currents(held: Configuration) -> Iterator[Shortfall]:
    """What the library makes of the bandwidth where the gains are not assigned after it."""
    drive, gains, bandwidth = held.drive, held.current_q, number(held.own, "ctrl.curr.bw")
    if gains is None or not bandwidth or not drive.l_q or drive.r_s is None:
        return
    rule = current_rule(drive.r_s, drive.l_q, bandwidth)
    if math.isclose(rule.ki, gains.ki, rel_tol=_NOTICED):
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
    if math.isclose(rule.ki, asked.speed.ki, rel_tol=_NOTICED):
        return
    yield Shortfall(
        f"the library's own integral gain of the speed is viscous friction times bw = "
        f"{rule.ki:.4g} A/rad instead of {asked.speed.ki:.4g} A/rad: without the second function "
        f"the speed sinks by {1.0 / max(rule.kp, 1e-30):.3g} rad/s per ampere of load",
        _off("integral gain of the speed by the library's own rule", rule.ki, asked.speed.ki),
    )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """The closed form of linear machines against what the machine needs."""
    drive = held.drive
    if asked.design.strategy != "mtpa" or drive.psi_pm is None or drive.i_max is None:
        return
    saliency = (drive.l_q or 0.0) - (drive.l_d or 0.0)
    i_max = min(drive.i_max, asked.design.i_max)
    price = price_of(asked.design.machine, i_max, linear_rule(drive.psi_pm, saliency))
    if price.torque < _NOTICED:
        return
    form = "the closed form of a linear machine" if saliency else "no d current"
    yield Shortfall(
        f"with rotor frame orientation the currents of most torque per ampere are {form}: at "
        f"{i_max:.4g} A they make {100.0 * price.torque:.2g} % less torque than this machine can, "
        f"or lose {100.0 * price.copper_loss:.2g} % more in copper for the same torque; with "
        f"stator frame orientation the table mtpa_lut holds them",
        (Price("torque", price.torque, ""), Price("copper loss", price.copper_loss, "")),
    )


def _periods(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    for what, wanted, has in (
        ("control", asked.drive.t_s, held.drive.t_s),
        ("speed controller", asked.drive.t_speed, held.drive.t_speed),
    ):
        if wanted and has and not math.isclose(wanted, has, rel_tol=1e-4):
            yield Shortfall(
                f"the library runs the {what} every {1e6 * has:.4g} us, the design every "
                f"{1e6 * wanted:.4g} us",
                (Price(f"period of the {what}", has - wanted, "s"),),
            )


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
    if table.of_constants > max(_NOTICED * most, table.error):
        words += (
            f"; those that the library works out of constant ld and lq by "
            f"{100.0 * table.of_constants / most:.2g} %"
        )
        prices.append(Price("flux linkage of the library's own table", table.of_constants, "Wb"))
    yield Shortfall(words, tuple(prices))
