"""Figures of the pages on the firmware of NXP, ST, TI and Infineon, each on the design of its page
or the tables that the page speaks of.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from figures_firmware_pages import (
    TURN,
    margins_of,
    page_fit,
    q_winding,
    step_of,
)

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.firmware.configuration import (
    PiGains,
    SpeedController,
    current_loop,
    speed_loop,
)
from dqforge.optimizer.firmware.firmware_method import mechanics_of
from dqforge.optimizer.firmware.mcat_numbers import gain_i, gain_p
from dqforge.optimizer.firmware.solve import FirmwareFit
from dqforge.optimizer.firmware.st_keys import fitted_table, table_currents
from dqforge.optimizer.firmware.targets.ti import BANDWIDTHS, VERSION, current_rule, speed_rule
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import constant_input_states
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
    thinned,
)

_PUBLISHED = (
    2921,
    (-1412, -2572, -4576, -5200, -5564, -10551, -12664, -15567),
    (0, 105, 463, 632, 764, 3012, 4162, 5997),
)
"""SEGDIV, ANGC and OFST of the published example of docs/firmware/st.md."""

_FITTED_SCALE, _LARGEST = 53664.7, 23687
"""psi/(2 (L_q - L_d)) in counts of the linear machine that this table fits best, and its range."""

_SPEED_FILTER = 1.0 / (TURN * 10.0)
"""Time constant in s of the filter on the speed in Infineon's defaults: a pole at 10 Hz."""


def _speed_of(fit: FirmwareFit, speed: SpeedController) -> PiLoop:
    """The speed loop of a drive with another controller."""
    current = fit.profile.current
    return speed_loop(q_winding(fit), mechanics_of(fit.asked.drive, current), current, speed)


def _speed(fit: FirmwareFit) -> SpeedController:
    assert fit.profile.speed is not None
    return fit.profile.speed


def _answer(loop: PiLoop, inputs: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Times in s, and the speed itself, which follows both integrals and the current."""
    closed = loop.closed
    states = constant_input_states(closed, inputs, round(duration / closed.t_s) + 1)
    return np.asarray(closed.t_s * np.arange(len(states))), states[:, 3]


@style()
def nxp(path: Path) -> None:
    """Crossover and phase margin over MCAT's F0 for two dampings and a cancelled pole."""
    fit = page_fit("nxp", "nxp")
    winding, current = q_winding(fit), fit.profile.current
    hertz = np.linspace(100.0, 2000.0, 39)

    def mcat(f_0: float, ksi: float) -> PiGains:
        inductance, r_s = winding.inductance, winding.r_s
        return PiGains(gain_p(ksi, f_0, inductance, r_s), gain_i(f_0, inductance, 1.0))

    def cancelled(f_0: float) -> PiGains:
        return PiGains(TURN * f_0 * winding.inductance, TURN * f_0 * winding.r_s)

    def loop(gains: PiGains) -> PiLoop:
        return current_loop(winding, replace(current.q, kp=gains.kp, ki=gains.ki), current.delay)

    figure = new_figure(
        "firmware-nxp", 2.9, "Crossover and phase margin over the bandwidth F0", arranged=True
    )
    left, right = figure.subplots(1, 2)
    for label, gains in (
        ("MCAT, ξ = 1", [mcat(float(f), 1.0) for f in hertz]),
        ("MCAT, ξ = 0.7", [mcat(float(f), 0.7) for f in hertz]),
        ("winding's pole cancelled", [cancelled(float(f)) for f in hertz]),
    ):
        margins, crossovers, _ = margins_of(loop(one) for one in gains)
        left.plot(hertz, crossovers, label=label)
        right.plot(hertz, margins, label=label)
    left.set(ylabel="Crossover in Hz", ylim=(0.0, 3500.0))
    right.set(ylabel="Phase margin in deg", ylim=(0.0, 90.0))
    for axes in (left, right):
        axes.set(xlabel="F0 in Hz", xlim=(0.0, 2000.0))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save(figure, path)


@style()
def st(path: Path) -> None:
    """Errors of the published table of currents and of the fitted one, over all counts."""
    i_q = np.arange(_LARGEST + 1)
    size = i_q.astype(np.float64)
    wanted = -size * size / (_FITTED_SCALE + np.hypot(_FITTED_SCALE, size))
    ours = fitted_table(wanted)
    errors = {
        "published example": table_currents(*_PUBLISHED, i_q) - wanted,
        "dqforge": ours.currents(i_q) - wanted,
    }
    figure = new_figure("firmware-st", 2.9, "Errors of two tables of d currents", arranged=True)
    left, right = figure.subplots(1, 2)
    for (label, error), colour in zip(errors.items(), (ORANGE, BLUE), strict=True):
        left.plot(*thinned(size, error), color=colour, linewidth=1.1, label=label)
    right.plot(*thinned(size, errors["dqforge"]), color=BLUE, linewidth=0.8)
    left.set(ylabel="Error of $i_d$ in counts")
    left.legend(loc="upper left")
    right.set(ylabel="Error of $i_d$ in counts, dqforge", ylim=(-12.0, 12.0))
    for axes in (left, right):
        axes.set(xlabel="$i_q$ in counts", xlim=(0.0, _LARGEST))
        axes.set_xticks([0, 5000, 10000, 15000, 20000])
    save(figure, path)


@style()
def ti(path: Path) -> None:
    """Steps of current and speed by the gains that the lab works out, and with the factors."""
    fit = page_fit("ti", "ti")
    winding, current, speed = q_winding(fit), fit.profile.current, _speed(fit)
    drive, own = fit.asked.drive, BANDWIDTHS[VERSION]
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.inertia is not None
    inner = current_rule(winding.r_s, winding.inductance, own.current)
    outer = speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, own)
    slow = replace(current.q, kp=inner.kp, ki=inner.ki)
    theirs = replace(
        fit,
        profile=replace(fit.profile, current=replace(current, d=slow, q=slow)),
    )
    slow_speed = replace(speed, pi=replace(speed.pi, kp=outer.kp, ki=outer.ki))
    figure = new_figure(
        "firmware-ti", 2.9, "Steps of the current and of the speed by two sets of gains",
        arranged=True,
    )  # fmt: skip
    left, right = figure.subplots(1, 2)
    for label, colour, pi, loop in (
        ("the lab's own gains", ORANGE, slow, _speed_of(theirs, slow_speed)),
        ("with the factors written", BLUE, current.q, _speed_of(fit, speed)),
    ):
        times, answer = step_of(current_loop(winding, pi, current.delay), 30e-3)
        left.plot(1e3 * times, answer, color=colour, label=label)
        times, answer = _answer(loop, np.array([1.0, 0.0]), 0.2)
        right.plot(1e3 * times, answer, color=colour, label=label)
    left.set(ylabel="q current after a step of 1 A in A", xlim=(0.0, 30.0), ylim=(0.0, 1.1))
    right.set(ylabel="Speed after a step of 1 rad/s in rad/s", xlim=(0.0, 200.0))
    for axes in (left, right):
        axes.axhline(1.0, color=MUTED, linewidth=0.8)
        axes.set_xlabel("Time in ms")
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    save(figure, path)


@style()
def infineon(path: Path) -> None:
    """Phase margin of the speed loop with and without the filter; the speed under load."""
    fit = page_fit("infineon", "infineon")
    speed, drive = _speed(fit), fit.asked.drive
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    constant = 1.5 * drive.pole_pairs * drive.psi_pm
    filtered = replace(speed, pi=replace(speed.pi, filter_time=_SPEED_FILTER))
    without = replace(speed, pi=replace(speed.pi, ki=0.0))
    own = TURN * 15.0

    def faster(controller: SpeedController, bandwidth: float) -> PiLoop:
        share = TURN * bandwidth / own
        pi = replace(controller.pi, kp=share * controller.pi.kp, ki=share**2 * controller.pi.ki)
        return _speed_of(fit, replace(controller, pi=pi))

    figure = new_figure(
        "firmware-infineon", 2.9, "Phase margin of the speed loop, and the speed under load",
        arranged=True,
    )  # fmt: skip
    left, right = figure.subplots(1, 2)
    hertz = np.geomspace(1.0, 100.0, 33)
    for controller, label, colour in (
        (speed, "no filter, as written", BLUE),
        (filtered, "filter of 10 Hz, the default", ORANGE),
    ):
        margins, _, _ = margins_of(faster(controller, float(f)) for f in hertz)
        left.semilogx(hertz, margins, color=colour, label=label)
    left.axvline(15.0, 0.2, color=INK, linewidth=0.9, linestyle=":")
    left.set(xlabel="ctrl.speed.bw in Hz", ylabel="Phase margin in deg", ylim=(0.0, 90.0))
    left.legend(loc="lower left")
    for controller, label, colour in (
        (speed, "ki of the design", BLUE),
        (without, "own rule, no friction: ki = 0", TEAL),
    ):
        times, answer = _answer(_speed_of(fit, controller), np.array([0.0, constant]), 0.4)
        right.plot(1e3 * times[::20], answer[::20], color=colour, label=label)
    right.set(xlabel="Time in ms", ylabel="Speed in rad/s after a load of 1 A", xlim=(0.0, 400.0))
    right.legend(loc="center right")
    save(figure, path)
