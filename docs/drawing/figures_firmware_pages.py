"""Figures of the pages on firmware of others: all eight on one drive, and VESC, SimpleFOC, ODrive
and moteus, each on the design of its page.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.configuration import Winding, current_loop
from dqforge.optimizer.firmware.firmware_method import METHODS
from dqforge.optimizer.firmware.moteus_format import (
    MOST_SENSITIVITY,
    bandwidth_asked,
    torque_rotation,
)
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.optimizer.firmware.targets.simplefoc import SPEED_FILTER
from dqforge.optimizer.firmware.targets.simplefoc import rule as simplefoc_rule
from dqforge.optimizer.firmware.targets.vesc import TRACKING_GAIN
from dqforge.optimizer.firmware.targets.vesc import rule as vesc_rule
from dqforge.optimizer.firmware.vesc_format import tracking_poles
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import LoopMargins, constant_input_states, loop_margins
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
)

_PAGES = Path(__file__).resolve().parents[1] / "firmware"

TURN = 2.0 * math.pi

_NAMES: dict[Firmware, str] = {
    "vesc": "VESC",
    "simplefoc": "SimpleFOC",
    "moteus": "moteus",
    "odrive": "ODrive",
    "nxp": "NXP",
    "st": "ST",
    "ti": "TI",
    "infineon": "Infineon",
}

_PLL_DEFAULT = 30000.0
"""foc_pll_ki as VESC comes, docs/firmware/vesc.md."""


def page_design(page: str) -> Design:
    """The design that a page goes from a data sheet with; a page without one has that of VESC, in
    which its command sets keys.
    """
    text = (_PAGES / f"{page}.md").read_text(encoding="utf-8")
    settings: list[str] = []
    if "```yaml" not in text:
        named = re.findall(r"--set ([\w.]+=(?:'[^']*'|\S+))", text)
        settings = [setting.replace("'", "") for setting in named]
        text = (_PAGES / "vesc.md").read_text(encoding="utf-8")
    found = re.search(r"```yaml\n(dqforge: .*?)```", text, flags=re.DOTALL)
    assert found is not None
    return load_text(found[1].encode(), f"{page}.md", None, settings)


def page_fit(page: str, name: Firmware) -> FirmwareFit:
    """What a firmware is given of the design of a page."""
    design = page_design(page)
    return solve_firmware(design, solve_gains(design, proofs=False), (name,))[0]


def q_winding(fit: FirmwareFit) -> Winding:
    """The q axis of a drive."""
    drive = fit.asked.drive
    assert drive.r_s is not None
    assert drive.l_q is not None
    return Winding(drive.r_s, drive.l_q)


def held_margins(loop: PiLoop) -> LoopMargins | None:
    """Margins of a loop, None of one that is unstable."""
    return loop_margins(loop.open_loop) if abs(loop.closed.poles[0]) < 1.0 else None


def margins_of(loops: Iterable[PiLoop]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Phase margins in deg, crossovers in Hz and M_s, shape (n,); nan of unstable loops."""
    found = [held_margins(loop) for loop in loops]
    rows = [
        (math.nan,) * 3
        if one is None
        else (math.degrees(one.phase_margin), one.crossover / TURN, one.max_sensitivity)
        for one in found
    ]
    margins, crossovers, peaks = np.array(rows).T
    return margins, crossovers, peaks


def step_of(loop: PiLoop, duration: float) -> tuple[FloatArray, FloatArray]:
    """Times in s, and the current after a step of its reference of 1."""
    closed = loop.closed
    states = constant_input_states(closed, np.array([1.0, 0.0]), round(duration / closed.t_s) + 1)
    return np.asarray(closed.t_s * np.arange(len(states))), states[:, 1]


@style()
def eight_targets(path: Path) -> None:
    """Margins of the current and the speed loop, and crossovers of the former, on one drive."""
    design = page_design("st")
    fits = solve_firmware(design, solve_gains(design, proofs=False), tuple(METHODS))
    figure = new_figure(
        "firmware-targets", 2.8, "Margins and crossovers of eight kinds of firmware on one drive",
        arranged=True,
    )  # fmt: skip
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(fits))
    for name, words, colour, mark in (
        ("current_q", "q current", BLUE, "o"),
        ("speed", "speed", ORANGE, "D"),
    ):
        loops = [getattr(fit.judged, name) for fit in fits]
        margins = np.degrees([loop.phase_margin for loop in loops])
        left.plot(margins, places, mark, color=colour, markersize=6, label=words)
    hertz = [fit.judged.current_q.crossover / TURN for fit in fits if fit.judged.current_q]
    right.barh(places, hertz, height=0.55, color=BLUE)
    left.set(xlabel="Phase margin in deg", xlim=(0.0, 90.0))
    left.set_yticks(places, [_NAMES[fit.name] for fit in fits])
    left.invert_yaxis()
    left.legend(loc="lower left")
    right.set(xlabel="Crossover of the q current in Hz", xlim=(0.0, 1200.0))
    save(figure, path)


@style()
def vesc(path: Path) -> None:
    """The current by VESC Tool's rule and by the design; poles of the tracking loop over its ki."""
    fit = page_fit("vesc", "vesc")
    winding, current = q_winding(fit), fit.profile.current
    drive, speed = fit.asked.drive, fit.judged.speed
    assert drive.psi_pm is not None
    assert speed is not None
    own = vesc_rule(winding.r_s, winding.inductance, drive.psi_pm)
    tool = replace(current.q, kp=own["foc_current_kp"], ki=own["foc_current_ki"])
    figure = new_figure(
        "firmware-vesc", 2.9, "Steps of the current, and poles of the tracking loop", arranged=True
    )
    left, right = figure.subplots(1, 2)
    ways = ((tool, "VESC Tool, tc = 1 ms", ORANGE), (current.q, "design, 1 kHz", BLUE))
    for pi, label, colour in ways:
        times, answer = step_of(current_loop(winding, pi, current.delay), 5e-3)
        left.step(1e3 * times, answer, where="post", color=colour, label=label)
    left.set(xlabel="Time in ms", ylabel="q current after a step of 1 A in A", xlim=(0.0, 5.0))
    left.legend(loc="lower right")
    most = 0.25 * TRACKING_GAIN**2
    gains = most * np.geomspace(1e-2, 1.0, 200)
    slow, fast = np.array([tracking_poles(TRACKING_GAIN, float(gain)) for gain in gains]).T
    right.loglog(gains, fast, color=MUTED, label="fast pole")
    right.loglog(gains, slow, color=TEAL, label="slow pole")
    for gain, words in ((_PLL_DEFAULT, "as it comes"), (most, "written")):
        pole = tracking_poles(TRACKING_GAIN, gain)[0]
        right.plot(gain, pole, "o", color=TEAL, label=f"_{words}")
        text = f"{words}: {float(f'{pole:.3g}'):g}"
        right.annotate(text, (gain, pole), (7.0, -4.0), textcoords="offset points")
    right.axhline(speed.crossover, color=INK, linewidth=0.9, linestyle="--")
    right.text(1.9e7, 0.87 * speed.crossover, "crossover of the speed loop", ha="right", va="top")
    right.set(xlabel="foc_pll_ki in 1/s²", ylabel="Poles in rad/s")
    right.set(xlim=(1e4, 2e7), ylim=(2.0, 5000.0))
    right.legend(loc="lower right")
    save(figure, path)


@style()
def simplefoc(path: Path) -> None:
    """Phase margin over the period of the loop, and steps, with three filters on the current."""
    fit = page_fit("simplefoc", "simplefoc")
    winding, current = q_winding(fit), fit.profile.current
    tool = simplefoc_rule(winding.inductance, winding.r_s, current.q.kp / winding.inductance / TURN)

    def loop(period: float, filter_time: float) -> PiLoop:
        pi = replace(current.q, t_s=period, filter_time=filter_time)
        return current_loop(winding, pi, current.delay)

    figure = new_figure(
        "firmware-simplefoc", 2.9, "Phase margin over the period of the loop, and steps",
        arranged=True,
    )  # fmt: skip
    left, right = figure.subplots(1, 2)
    periods = np.linspace(10e-6, 170e-6, 33)
    for time, label in (
        (0.0, "no filter, as written"),
        (tool["Tf"], f"Tf = {1e6 * tool['Tf']:.0f} µs, the tool's"),
        (SPEED_FILTER, f"Tf = {1e3 * SPEED_FILTER:.0f} ms, the default"),
    ):
        margins, _, _ = margins_of(loop(float(period), time) for period in periods)
        left.plot(1e6 * periods, margins, label=label)
        times, answer = step_of(loop(current.q.t_s, time), 4e-3)
        right.step(1e3 * times, answer, where="post", label=label)
    left.axvline(1e6 * current.q.t_s, color=MUTED, linewidth=0.9, linestyle=":")
    left.text(1e6 * current.q.t_s + 2.0, 84.0, "as on this page")
    left.set(xlabel="Period of loopFOC() in µs", ylabel="Phase margin in deg")
    left.set(xlim=(0.0, 170.0), ylim=(0.0, 90.0))
    right.set(xlabel="Time in ms", ylabel="q current after a step of 1 A in A", xlim=(0.0, 4.0))
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save(figure, path)


@style()
def odrive(path: Path) -> None:
    """Phase margin and sensitivity over the bandwidth at 8 kHz; what is requested and written."""
    fit = page_fit("moteus", "odrive")
    winding, current = q_winding(fit), fit.profile.current
    asked = bandwidth_asked(fit.asked)
    written = float(fit.configuration.own["motor.config.current_control_bandwidth"])

    def loop(bandwidth: float) -> PiLoop:
        gains = bandwidth * winding.inductance, bandwidth * winding.r_s
        pi = replace(current.q, kp=gains[0], ki=gains[1])
        return current_loop(winding, pi, current.delay)

    grid = np.linspace(300.0, 8000.0, 78)
    margins, _, peaks = margins_of(loop(float(bandwidth)) for bandwidth in grid)
    figure = new_figure(
        "firmware-odrive", 2.9, "Phase margin and sensitivity over the bandwidth", arranged=True
    )
    left, right = figure.subplots(1, 2)
    left.plot(grid, margins, color=BLUE)
    right.plot(grid, peaks, color=BLUE)
    right.axhline(MOST_SENSITIVITY, color=INK, linewidth=0.9, linestyle="--")
    right.text(7900.0, MOST_SENSITIVITY - 0.06, "limit", ha="right", va="top")
    for bandwidth, words, colour in ((written, "written", TEAL), (asked, "requested", ORANGE)):
        one = held_margins(loop(bandwidth))
        assert one is not None
        left.plot(bandwidth, math.degrees(one.phase_margin), "o", color=colour, label=words)
        right.plot(bandwidth, one.max_sensitivity, "o", color=colour, label=words)
    left.set(ylabel="Phase margin in deg", ylim=(0.0, 90.0))
    right.set(ylabel="Largest sensitivity $M_s$", ylim=(1.0, 5.0))
    for axes in (left, right):
        axes.set(xlabel="current_control_bandwidth in rad/s", xlim=(0.0, 8000.0))
        axes.set_xticks([0, 2000, 4000, 6000, 8000])
    left.legend(loc="lower left")
    save(figure, path)


@style()
def moteus(path: Path) -> None:
    """Torque over the q current of a saturating machine, and what moteus makes of it."""
    design = catalogue.load("baldor-pmsyrm-5k6")
    machine, i_max = design.machine, design.i_max
    constant = 1.5 * machine.pole_pairs * machine.psi_pm
    fitted = torque_rotation(machine, constant, i_max)
    current = np.linspace(0.0, i_max, 181)
    torque = machine.torque(np.zeros_like(current), current)
    model = fitted.torque(constant, current)
    figure = new_figure(
        "firmware-moteus", 2.9, "Torque over the q current, and the error of the fit", arranged=True
    )
    left, right = figure.subplots(1, 2)
    left.plot(current, constant * current, color=ORANGE, label="torque constant alone")
    left.plot(current, torque, color=INK, linewidth=2.4, label="machine without d current")
    left.plot(current, model, "--", color=TEAL, label="moteus, fitted")
    left.axvline(fitted.cutoff, 0.0, 0.4, color=MUTED, linewidth=0.9, linestyle=":")
    left.text(fitted.cutoff + 0.3, 0.6, "$i_c$")
    left.set(ylabel="Torque in N m", ylim=(0.0, None))
    left.legend(loc="upper left")
    right.axhline(0.0, color=MUTED, linewidth=0.8)
    right.plot(current, 1e3 * (model - torque), color=TEAL)
    right.set(ylabel="Error of the fit in mN m")
    for axes in (left, right):
        axes.set(xlabel="$i_q$ in A", xlim=(0.0, i_max))
    save(figure, path)
