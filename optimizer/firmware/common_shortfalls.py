"""Shortfalls that several firmwares share: in words, with prices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.current_prices import CurrentPrice, linear_rule, price_of
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration

NOTICED = 1e-3  # Share from which on something is said of it.
_SAME_PERIOD = 1e-4


def closed_form_currents(
    asked: Asked, held: Configuration, saliency: float, lead: str, *, tail: str = ""
) -> Iterator[Shortfall]:
    """The closed form of linear machines, or no d current, against what the machine needs.

    Args:
        asked, held: The wishes, and what was made of them.
        saliency: L_q - L_d in H that the firmware takes; with 0 it commands no d current.
        lead: Whose currents they are, in words.
        tail: What helps, in words; follows the sentence.
    """
    psi, most = held.drive.psi_pm, held.drive.i_max
    if asked.design.strategy != "mtpa" or psi is None or most is None:
        return
    i_max = min(most, asked.design.i_max)
    price = price_of(asked.design.machine, i_max, linear_rule(psi, saliency))
    if price.torque >= NOTICED:
        form = "the closed form of a linear machine" if saliency else "no d current"
        yield Shortfall(
            f"{lead} are {form}: at {i_max:.4g} A they make {less_torque(price, 'lose')}{tail}",
            prices(price),
        )


def q_current_alone(asked: Asked, psi_pm: float, lead: str, *, tail: str) -> Iterator[Shortfall]:
    """No d current at all, against what the machine needs.

    Args:
        asked: The wishes.
        psi_pm: Flux linkage in Wb that the firmware is told.
        lead: That it commands none, in words; the current follows.
        tail: What helps, in words; follows the sentence.
    """
    if asked.design.strategy != "mtpa":
        return
    i_max = asked.design.i_max
    price = price_of(asked.design.machine, i_max, linear_rule(psi_pm, 0.0))
    if price.torque >= NOTICED:
        yield Shortfall(
            f"{lead}: at {i_max:.4g} A it makes {less_torque(price, 'loses')}{tail}",
            prices(price),
        )


def less_torque(price: CurrentPrice, lose: str) -> str:
    """What is lost, in words; of currents that `lose` it, or of a firmware that `loses` it."""
    return (
        f"{100.0 * price.torque:.2g} % less torque than this machine can, or {lose} "
        f"{100.0 * price.copper_loss:.2g} % more in copper for the same torque"
    )


def prices(price: CurrentPrice) -> tuple[Price, ...]:
    """The shares of torque and copper loss."""
    return Price("torque", price.torque, ""), Price("copper loss", price.copper_loss, "")


def other_periods(asked: Asked, held: Configuration, firmware: str) -> Iterator[Shortfall]:
    """Periods of the controllers that are not those of the design.

    Args:
        asked, held: The wishes, and what was made of them.
        firmware: Who runs them, in words.
    """
    for what, wanted, has in (
        ("control step", asked.drive.t_s, held.drive.t_s),
        ("speed controller", asked.drive.t_speed, held.drive.t_speed),
    ):
        if wanted and has and not math.isclose(wanted, has, rel_tol=_SAME_PERIOD):
            yield Shortfall(
                f"{firmware} runs the {what} every {1e6 * has:.4g} us, the design every "
                f"{1e6 * wanted:.4g} us",
                (Price(f"period of the {what}", has - wanted, "s"),),
            )
