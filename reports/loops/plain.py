"""Loops as plain data."""

from __future__ import annotations

from dataclasses import asdict

from dqforge.machines.design.design import Design
from dqforge.machines.names import QFormats
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.fixed_control.gains import pi_integers
from dqforge.optimizer.loops.gains import LoopGains, per_unit
from dqforge.reports.loops.robustness_text import plain_robustness
from dqforge.reports.loops.schedule_text import plain_schedule
from dqforge.reports.observers.speed_loop_text import plain_observed
from dqforge.reports.observers.text import plain_position
from dqforge.reports.plain_data import PlainData


def _plain_loop(
    gains: LoopGains, bases: tuple[float, float], q_formats: QFormats | None
) -> PlainData:
    kp_pu, ki_ts_pu = per_unit(gains, *bases)
    integers, found = {}, pi_integers(kp_pu, ki_ts_pu, q_formats)
    if found is not None:
        kp, ki_ts = found
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
        "kp_pu": kp_pu,
        "ki_ts_pu": ki_ts_pu,
        **integers,
        "crossover_rad_per_s": gains.crossover,
        "phase_margin_rad": gains.phase_margin,
        "gain_margin": gains.gain_margin,
        "delay_margin_s": gains.delay_margin,
        "max_sensitivity": gains.max_sensitivity,
        "poles": [[pole.real, pole.imag] for pole in gains.poles.tolist()],
        **plain_observed(gains),
    }


def plain_gains(design: Design, gains: GainSet) -> PlainData:
    """Gains of each loop with their margins; None where the design has no such loop."""
    control = design.control
    current = (control.bases.current, control.bases.voltage)
    speed = None
    if gains.speed is not None and control.speed_loop is not None:
        bases = (control.bases.speed, control.bases.torque)
        speed = _plain_loop(gains.speed, bases, control.speed_loop.q_formats)
    return {
        "i_d": _plain_loop(gains.i_d, current, control.current_loop.q_formats),
        "i_q": _plain_loop(gains.i_q, current, control.current_loop.q_formats),
        "speed": speed,
        "observer": None if gains.observer is None else asdict(gains.observer),
        "position": None if gains.position is None else plain_position(gains.position),
        "bases": asdict(control.bases),
        **plain_robustness(gains.robust),
        **plain_schedule(gains.schedule),
    }
