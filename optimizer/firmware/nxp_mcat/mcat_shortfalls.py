"""What MCAT's file cannot hold of a design, or its firmware not run, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator

from dqforge.optimizer.firmware.common_shortfalls import NOTICED, q_current_alone
from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.nxp_mcat.mcat_constants import constants
from dqforge.optimizer.firmware.nxp_mcat.mcat_edition import EDITIONS
from dqforge.optimizer.firmware.nxp_mcat.mcat_sheet import McatSheet


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
    """
    sheet = McatSheet(EDITIONS[held.version], held.own)
    return (
        *_currents(asked),
        *_inputs_of_d(sheet),
        *_integers(asked, held),
        *_voltage(asked, sheet),
        *_weakening(asked, sheet),
        *_decoupling(asked),
    )


def _currents(asked: Asked) -> Iterator[Shortfall]:
    lead = "MCAT's control asks for no d current"
    tail = (
        "; i_d from the header of current references has to be written to sIDQReq.fltD by the "
        "application"
    )
    return q_current_alone(asked, asked.drive.psi_pm or 0.0, lead, tail=tail)


def _inputs_of_d(sheet: McatSheet) -> Iterator[Shortfall]:
    """One F0 and ksi among the inputs; the constants hold both axes."""
    made = constants(sheet.edition, sheet.own)
    parts, prices = [], []
    for name in ("M1_D_KP_GAIN", "M1_D_KI_GAIN"):
        stands, other = sheet.number(name), made.get(name)
        if stands and other is not None and abs(other / stands - 1.0) > NOTICED:
            parts.append(f"{name} {other:.6g} instead of {stands:.6g}")
            prices.append(Price(name, other / stands - 1.0, ""))
    if parts:
        yield Shortfall(
            "the inputs in the comment have one F0 and ksi for two inductances: the constants hold "
            "the gains of both axes, but MCAT makes " + ", ".join(parts) + " once the file is "
            "loaded and saved there",
            tuple(prices),
        )


def _integers(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """What printing and, in fixed point, cutting off make of the gains."""
    for of, wished, has in (
        ("d axis", asked.current_d, held.current_d),
        ("q axis", asked.current_q, held.current_q),
        ("speed loop", asked.speed, held.speed),
    ):
        worst = 0.0 if wished is None or has is None else _largest_error(wished, has)
        if wished is not None and has is not None and worst > NOTICED:
            yield Shortfall(
                f"gains of the {of}: {has.kp:.5g} and {has.ki:.5g} run for {wished.kp:.5g} and "
                f"{wished.ki:.5g} that were asked for: the integers of the format are that coarse",
                (Price(f"gain of the {of}", worst, ""),),
            )


def _largest_error(wished: PiGains, has: PiGains) -> float:
    pairs = ((wished.kp, has.kp), (wished.ki, has.ki))
    return max((abs(is_now / was - 1.0) for was, is_now in pairs if was), default=0.0)


def _limit(asked: Asked, sheet: McatSheet) -> float:
    """Phase amplitude in V that the current loop may ask for."""
    share = (sheet.number("currentLoopOutputLimit") or 90.0) / 100.0
    return share * asked.design.inverter.v_dc / math.sqrt(3.0)


def _voltage(asked: Asked, sheet: McatSheet) -> Iterator[Shortfall]:
    limit, counted = _limit(asked, sheet), asked.design.v_max
    lost = 1.0 - limit / counted
    if lost > NOTICED:
        yield Shortfall(
            f"M1_CLOOP_LIMIT lets the current loop ask for {limit:.4g} V of the {counted:.4g} V "
            f"that the design counts on: shunts in the low side need the rest of the period; raise "
            f"currentLoopOutputLimit where the currents are measured otherwise",
            (Price("voltage", lost, ""),),
        )


def _weakening(asked: Asked, sheet: McatSheet) -> Iterator[Shortfall]:
    """No field weakening: the speed ends where the back-EMF meets the limit."""
    drive, limit = asked.drive, _limit(asked, sheet)
    if not drive.omega_m_max or not drive.pole_pairs or not drive.psi_pm:
        return
    reached = limit / (drive.pole_pairs * drive.psi_pm)
    if reached < drive.omega_m_max:
        yield Shortfall(
            f"the file holds no field weakening: the back-EMF meets the limit of {limit:.4g} V at "
            f"{reached:.4g} rad/s, before the largest speed of {drive.omega_m_max:.4g} rad/s",
            (Price("speed", 1.0 - reached / drive.omega_m_max, ""),),
        )


def _decoupling(asked: Asked) -> Iterator[Shortfall]:
    """No feedforward between the axes: what their integrals carry at the largest speed."""
    drive = asked.drive
    if not drive.omega_m_max or not drive.pole_pairs or not drive.l_q:
        return
    volts = drive.omega_m_max * drive.pole_pairs * drive.l_q * asked.design.i_max
    rate = min(gains.ki / gains.kp for gains in (asked.current_d, asked.current_q) if gains.kp)
    if volts > 0.05 * asked.design.v_max:
        yield Shortfall(
            f"the axes are not decoupled: a step of {asked.design.i_max:.4g} A in q current brings "
            f"{volts:.4g} V into the d axis at the largest speed, which its integral takes up at "
            f"{rate:.4g} rad/s",
            (Price("voltage between the axes", volts, "V"),),
        )
