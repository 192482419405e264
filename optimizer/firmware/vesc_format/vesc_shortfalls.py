"""What VESC's configuration cannot hold of a design, and what that costs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from dqforge.optimizer.firmware.common_shortfalls import (
    NOTICED,
    closed_form_currents,
    other_periods,
)
from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.firmware_method import Asked, Price, Shortfall
from dqforge.optimizer.firmware.judge import judge
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.profile import LoopProfile
from dqforge.optimizer.firmware.vesc_format.vesc_keys import loop_number

_BACK_EMF_SHARE = 0.98
_MUCH = 0.01

# Share of the newest value in the speed that is fed forward (mcpwm_foc.c, m_speed_est_fast).
FAST_SHARE = 0.01


def shortfalls(asked: Asked, held: Configuration, runs: LoopProfile) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
        runs: The loops that VESC runs with it.
    """
    return (
        *_one_pair(asked, held, runs),
        *_currents(asked, held),
        *other_periods(asked, held, "VESC"),
        *_voltage(asked, held),
        *_dead_time(asked, held),
        *_feed_forward(asked, runs),
    )


def _one_pair(asked: Asked, held: Configuration, runs: LoopProfile) -> Iterator[Shortfall]:
    gains = held.current_q
    if gains is None or (asked.current_d, asked.current_q) == (gains, gains):
        return
    if math.isclose(asked.current_d.kp, asked.current_q.kp, rel_tol=1e-4):
        return
    current = runs.current
    wished = replace(
        current,
        d=replace(current.d, kp=asked.current_d.kp, ki=asked.current_d.ki),
        q=replace(current.q, kp=asked.current_q.kp, ki=asked.current_q.ki),
    )
    now = judge(replace(runs, speed=None), asked.drive)
    then = judge(replace(runs, speed=None, current=wished), asked.drive)
    prices, words = [], []
    for axis, is_now, was in (
        ("d", now.current_d, then.current_d),
        ("q", now.current_q, then.current_q),
    ):
        if is_now is not None and was is not None:
            lost = was.phase_margin - is_now.phase_margin
            prices.append(Price(f"phase margin of the {axis} axis", lost, "rad"))
            words.append(
                f"the {axis} axis crosses over at {is_now.crossover:.4g} rad/s with "
                f"{math.degrees(is_now.phase_margin):.1f} deg instead of {was.crossover:.4g} rad/s "
                f"with {math.degrees(was.phase_margin):.1f} deg"
            )
    yield Shortfall(
        f"one foc_current_kp serves two inductances: {gains.kp:.4g} V/A stands for "
        f"{asked.current_d.kp:.4g} V/A (d) and {asked.current_q.kp:.4g} V/A (q); "
        + "; ".join(words),
        tuple(prices),
    )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    difference = number(held.own, "foc_motor_ld_lq_diff") or 0.0
    used = difference if loop_number(held.own, "foc_mtpa_mode") > 0 else 0.0
    lead = "VESC's currents of most torque per ampere"
    return closed_form_currents(asked, held, used, lead)


def _voltage(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """l_max_duty keeps a share of the range; without field weakening the speed ends there."""
    share = loop_number(held.own, "l_max_duty") * loop_number(held.own, "foc_overmod_factor")
    limit = share * asked.design.inverter.v_dc / math.sqrt(3.0)
    lost = 1.0 - limit / asked.design.v_max
    if lost > NOTICED:
        yield Shortfall(
            f"VESC uses {100.0 * share:.3g} % of the linear range (l_max_duty): {limit:.4g} V of "
            f"the {asked.design.v_max:.4g} V that the design counts on",
            (Price("voltage", lost, ""),),
        )
    drive = asked.drive
    if drive.omega_m_max and drive.pole_pairs and drive.psi_pm:
        emf = drive.omega_m_max * drive.pole_pairs * drive.psi_pm
        if emf > _BACK_EMF_SHARE * limit:
            reached = limit / (drive.pole_pairs * drive.psi_pm)
            yield Shortfall(
                f"the back-EMF at the largest speed is {emf:.4g} V, the voltage {limit:.4g} V: "
                f"without foc_fw_current_max, which is not written, the speed ends at "
                f"{reached:.4g} rad/s",
                (Price("speed", 1.0 - reached / drive.omega_m_max, ""),),
            )


def _dead_time(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = asked.drive
    if held.drive.dead_time and drive.f_sw and drive.v_dc:
        volts = held.drive.dead_time * drive.f_sw * drive.v_dc / 3.0
        yield Shortfall(
            f"VESC's observer takes off 4/3 of the voltage of the dead time foc_dt_us: "
            f"{volts:.3g} V too much; {0.75e6 * held.drive.dead_time:.4g} us would be exact",
            (Price("voltage in the observer", volts, "V"),),
        )


def _feed_forward(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    """The speed that the back-EMF is fed forward with lags behind an acceleration."""
    drive, design = asked.drive, asked.design
    if not (runs.current.back_emf and drive.inertia and drive.pole_pairs and drive.psi_pm):
        return
    lag = runs.current.d.t_s * (1.0 - FAST_SHARE) / FAST_SHARE
    acceleration = 1.5 * drive.pole_pairs * drive.psi_pm * design.i_max / drive.inertia
    volts = drive.pole_pairs * drive.psi_pm * acceleration * lag
    if volts > _MUCH * design.v_max:
        yield Shortfall(
            f"VESC feeds the back-EMF forward by a speed that lags {1e3 * lag:.3g} ms: at "
            f"{acceleration:.4g} rad/s^2, the most that the current limit gives without load, "
            f"{volts:.3g} V are missing, which the integrals make up for",
            (Price("voltage of the feed-forward", volts, "V"),),
        )
