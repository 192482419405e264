"""Loops as plain data."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.reports.loops.firmware_text import plain_firmware
from dqforge.reports.loops.judged_text import plain_judged
from dqforge.reports.loops.proven_text import plain_box_proofs, plain_changing
from dqforge.reports.loops.robustness_text import plain_robustness
from dqforge.reports.loops.schedule_text import plain_schedule
from dqforge.reports.observers.plain import plain_observer_errors
from dqforge.reports.observers.speed_loop_text import plain_observed
from dqforge.reports.observers.tracker_text import plain_tracker

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.reduced_order import ErrorsAtLoad
    from dqforge.reports.plain_data import PlainData


def _plain_position(gains: GainSet) -> PlainData | None:
    if gains.position is None:
        return None
    from dqforge.reports.observers.text import plain_position

    return plain_position(gains.position)


def _plain_loop(gains: LoopGains, scaled: PerUnitGains) -> PlainData:
    integers = {}
    if scaled.integers is not None:
        kp, ki_ts = scaled.integers
        integers = {
            "kp_q": kp.mantissa,
            "ki_ts_q": ki_ts.mantissa,
            "q_formats": (kp.shift, ki_ts.shift),
        }
    return {
        "method": gains.method,
        "kp": gains.kp,
        "ki": gains.ki,
        "t_s": gains.t_s,
        "ki_ts": gains.ki_ts,
        "t_i_s": gains.t_i,
        "q0": gains.velocity[0],
        "q1": gains.velocity[1],
        "anti_windup_per_s": gains.anti_windup,
        "kp_pu": scaled.kp,
        "ki_ts_pu": scaled.ki_ts,
        **integers,
        "crossover_rad_per_s": gains.crossover,
        "phase_margin_rad": gains.phase_margin,
        "gain_margin": gains.gain_margin,
        "delay_margin_s": gains.delay_margin,
        "delay_margin_samples": gains.delay_margin_samples,
        "max_sensitivity": gains.max_sensitivity,
        "stable": gains.stable,
        "disturbance_peak": gains.disturbance.peak,
        "disturbance_settling_s": gains.disturbance.settling_time,
        "poles": [[pole.real, pole.imag] for pole in gains.poles.tolist()],
        **plain_observed(gains),
    }


def _plain_tolerances(gains: GainSet) -> PlainData:
    found = plain_robustness(gains.robust)
    if found:
        found["tolerances"]["single_loops"] = plain_box_proofs(gains)
    return found


def plain_gains(
    design: Design, gains: GainSet, observer_errors: tuple[ErrorsAtLoad, ...] = ()
) -> PlainData:
    """Gains of each loop with their margins; None where the design has no such loop.

    ``observer_errors`` are the steady errors of the speed observer at loads, where they are known.
    """
    zero = None if gains.phases is None else gains.phases.zero
    return {
        "i_d": _plain_loop(gains.i_d, gains.per_unit["i_d"]),
        "i_q": _plain_loop(gains.i_q, gains.per_unit["i_q"]),
        **({} if zero is None else {"i_0": _plain_loop(zero, gains.per_unit["i_0"])}),
        "speed": None if gains.speed is None else _plain_loop(gains.speed, gains.per_unit["speed"]),
        "observer": None if gains.observer is None else asdict(gains.observer),
        **plain_observer_errors(gains.observer_slopes, observer_errors),
        "position": _plain_position(gains),
        **({} if gains.tracker is None else {"tracker": plain_tracker(gains.tracker)}),
        "bases": asdict(design.control.bases),
        **_plain_tolerances(gains),
        **plain_schedule(gains.schedule),
        **plain_changing(gains),
        **({} if gains.phases is None else plain_judged(gains.phases)),
        **plain_firmware(gains),
    }
