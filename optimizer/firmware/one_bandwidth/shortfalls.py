"""What firmware that is told one bandwidth cannot hold of a design: in words, with prices."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.optimizer.firmware.configuration import Configuration, PiGains
from dqforge.optimizer.firmware.current_prices import linear_rule, price_of
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.judge import JudgedFirmware, JudgedLoop, judge
from dqforge.optimizer.firmware.profile import LoopProfile

_SAME = 1e-3  # Relative difference below which two numbers count as one.


def margin_words(judged: JudgedFirmware) -> str:
    """Phase margins and crossovers of the current loops in words.

    Args:
        judged: The loops.
    """
    return " and ".join(
        f"{_degrees(loop)} at {loop.crossover / (2.0 * math.pi):.4g} Hz ({axis})"
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )


def gains_changed(
    asked: Asked, held: Configuration, judged: JudgedFirmware, lead: str
) -> tuple[Shortfall, ...]:
    """Current gains that the firmware works out by itself, where they are not those asked for.

    Args:
        asked, held: The wishes, and what was made of them.
        judged: The loops that run.
        lead: Which key decides, in words.
    """
    pairs = (("d", asked.current_d, held.current_d), ("q", asked.current_q, held.current_q))
    changes = [
        f"{axis} kp {own.kp:.4g} V/A and ki {own.ki:.4g} V/(A s) instead of {wish.kp:.4g} and "
        f"{wish.ki:.4g}"
        for axis, wish, own in pairs
        if own is not None and not _same(wish, own)
    ]
    if not changes:
        return ()
    words = f"{lead}: {'; '.join(changes)}; phase margins {margin_words(judged)}"
    prices = tuple(
        Price(f"phase margin ({axis})", loop.phase_margin, "rad")
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )
    return (Shortfall(words, prices),)


def rates_changed(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """Frequency of the inverter and periods of the controllers that are not those of the design.

    Args:
        asked, held: The wishes, and what was made of them.
    """
    wish, own = asked.drive, held.drive
    changes = [
        f"{name} {was * scale:.6g} {unit} becomes {now * scale:.6g} {unit}"
        for name, was, now, scale, unit in (
            ("switching frequency", wish.f_sw, own.f_sw, 1e-3, "kHz"),
            ("current control every", wish.t_s, own.t_s, 1e6, "us"),
            ("speed control every", wish.t_speed, own.t_speed, 1e6, "us"),
        )
        if was is not None and now is not None and abs(now / was - 1.0) > _SAME
    ]
    return (Shortfall(f"{held.firmware} runs at its own rates: {'; '.join(changes)}"),) * bool(
        changes
    )


def saturation_unknown(asked: Asked, loops: LoopProfile, what: str) -> tuple[Shortfall, ...]:
    """What constant inductances make of the margins where the machine saturates.

    Args:
        asked: The design.
        loops: The current loops that run.
        what: What the format holds, in words.
    """
    drive, machine = asked.drive, asked.design.machine
    if drive.i_max is None or drive.l_d is None or drive.l_q is None:
        return ()
    jet = machine.jet(np.zeros(1), np.full(1, drive.i_max))
    l_d, l_q = float(jet.l_dd[0]), float(jet.l_qq[0])
    if abs(l_q / drive.l_q - 1.0) <= _SAME and abs(l_d / drive.l_d - 1.0) <= _SAME:
        return ()
    if not (l_d > 0.0 and l_q > 0.0):
        return ()
    judged = judge(replace(loops, speed=None), replace(drive, l_d=l_d, l_q=l_q))
    words = (
        f"{what}; at {drive.i_max:.4g} A of q current they are {l_d * 1e6:.4g} uH (d) and "
        f"{l_q * 1e6:.4g} uH (q) instead of {drive.l_d * 1e6:.4g} and {drive.l_q * 1e6:.4g} uH, "
        f"and the phase margins {margin_words(judged)}"
    )
    prices = tuple(
        Price(f"phase margin ({axis}) at i_max", loop.phase_margin, "rad")
        for axis, loop in (("d", judged.current_d), ("q", judged.current_q))
        if loop is not None
    )
    return (Shortfall(words, prices),)


def d_current_missing(asked: Asked) -> tuple[Shortfall, ...]:
    """What it costs that no d current flows, where the design asks for one.

    Args:
        asked: The design.
    """
    design, i_max = asked.design, asked.drive.i_max
    if design.strategy == "id0" or i_max is None:
        return ()
    machine = design.machine
    price = price_of(machine, i_max, linear_rule(machine.psi_pm, 0.0))
    torque = float(machine.torque(np.zeros(1), np.full(1, i_max))[0])
    if price.torque < _SAME or not torque > 0.0:
        return ()
    best = torque / (1.0 - price.torque)
    loss = 1.5 * machine.r_s * i_max * i_max
    least = loss / (1.0 + price.copper_loss)
    words = (
        f"no d current below the voltage limit: {torque:.4g} N m at {i_max:.4g} A instead of "
        f"{best:.4g} N m ({price.torque:.1%} less); for the same {torque:.4g} N m {loss:.4g} W of "
        f"copper loss instead of {least:.4g} W"
    )
    prices = (Price("torque", best - torque, "N m"), Price("copper loss", loss - least, "W"))
    return (Shortfall(words, prices),)


def field_weakening_missing(asked: Asked, words: str) -> tuple[Shortfall, ...]:
    """That currents beyond base speed are not those of the design, where it asks for any.

    Args:
        asked: The design.
        words: What the firmware does instead.
    """
    return () if asked.design.weakening is None else (Shortfall(words),)


def _same(wish: PiGains, own: PiGains) -> bool:
    return abs(own.kp - wish.kp) <= _SAME * wish.kp and abs(own.ki - wish.ki) <= _SAME * wish.ki


def _degrees(loop: JudgedLoop) -> str:
    return f"{math.degrees(loop.phase_margin):.1f} deg"
