"""Gains of the three axes of a phase machine: d, q and the zero sequence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.settings import ControlSettings, CurrentLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.loops.analysis import analyse_current_loop
from dqforge.optimizer.loops.gains import tune_current_loop
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.phase_control.phase_controller import AxisGains

KEY = "control.current_loop.axis_gains"


def zero_loop(
    control: ControlSettings, q_axis: LoopGains, r_s: float, l_q: float, l_0: float
) -> LoopGains:
    """The loop of the zero-sequence current, by the rule of the settings.

    ``own``: by the same method on the zero-sequence inductance; gains that are given are those of
    the q axis, scaled with the inductance, so that both loops are equally fast. ``one``: the gains
    of the q axis.

    Args:
        control: Sampling and settings.
        q_axis: The loop of the q axis.
        r_s: Phase resistance in Ohm.
        l_q, l_0: Inductances of the q axis and of the zero sequence in H, a choke of the neutral
            included.

    Raises:
        NoSolutionError: The loop does not hold.
    """
    settings = control.current_loop
    if settings.axis_gains == "one":
        _require_stable(q_axis, control.t_s, l_q, l_0)
        return _one_gain(control.t_s, settings, q_axis, r_s, l_0)
    if settings.method == "given":
        settings = _given(settings, q_axis.kp * l_0 / l_q, q_axis.ki * l_0 / l_q)
    return tune_current_loop(r_s, l_0, control.t_s, settings, "i_0")


def _one_gain(
    t_s: float, settings: CurrentLoopSettings, q_axis: LoopGains, r_s: float, l_0: float
) -> LoopGains:
    """The zero sequence with the gains of the q axis, refused without the margin of a loop."""
    found = analyse_current_loop(r_s, l_0, t_s, q_axis.kp, q_axis.ki, loop="i_0")
    margin, required = np.degrees([abs(found.phase_margin), settings.min_phase_margin])
    if found.stable and margin >= required:
        return found
    reached = f"a phase margin of {margin:.1f} deg" if found.stable else "no stable loop"
    raise NoSolutionError(
        f"{KEY}: one set of gains leaves the zero sequence {reached}, required are "
        f"{required:.1f} deg; write own, or lower the gains"
    )


def axis_gains(loop: LoopGains | None) -> AxisGains:
    """Gains of one axis, none where nothing drives a current."""
    return AxisGains(0.0, 0.0) if loop is None else AxisGains(loop.kp, loop.ki)


def _given(settings: CurrentLoopSettings, kp: float, ki: float) -> CurrentLoopSettings:
    return replace(settings, method="given", kp=kp, ki=ki)


def _require_stable(q_axis: LoopGains, t_s: float, l_q: float, l_0: float) -> None:
    """Refuse one gain for all axes where the zero sequence is unstable with it.

    Its loop gain per sample is kp T_s / L_0; with one sample of delay it is unstable above one.
    """
    bandwidth = q_axis.kp / l_q
    ratio, limit = l_q / l_0, 1.0 / (t_s * bandwidth)
    if ratio < limit:
        return
    raise NoSolutionError(
        f"{KEY}: one set of gains is unstable in the zero sequence: L_ab/L_0 is {ratio:.3g}, and "
        f"f_s/omega_c permits {limit:.3g}; write own"
    )
