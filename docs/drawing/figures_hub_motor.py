"""Figures of the how-to pages whose motor is hub.yaml: two switching frequencies, another firmware,
and tolerances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from page_text import DOCS, written_file

from dqforge import Design, export_for, load_design, read_firmware, tune
from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.firmware.configuration import DriveValues, LoopProfile, Winding, speed_loop
from dqforge.optimizer.firmware.firmware_method import drive_values, mechanics_of
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.pi_methods import (
    BatchMargins,
    batch_margins,
    close_loops,
    current_plants,
)
from dqforge.optimizer.loops.plants import PiLoop
from dqforge.optimizer.sampled_systems import constant_input_states, loop_margins
from dqforge.reports.comparison.sides_compared import Row, compare_sides
from dqforge.reports.comparison.sources import solved_side
from dqforge.reports.firmware.target import (
    firmware_drive,
    firmware_simulator,
    simulate_profile,
    standard_steps,
)
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    RED,
    new_figure,
    save,
    style,
)

_HUB = DOCS / "how-to" / "files" / "hub.yaml"

_QUANTITIES = {
    "kp": "kp",
    "ki": "ki",
    "sampled every": "sampling period",
    "bandwidth (crossover)": "crossover",
    "phase margin": "phase margin",
    "gain margin (factor)": "gain margin",
    "delay margin": "delay margin",
    "M_s": "$M_s$",
}


def _hub(changes: Mapping[str, object] | None = None) -> Design:
    return load_design(_HUB, changes)


@style()
def two_designs(path: Path) -> None:
    """Steps of the q current at 20 and 40 kHz, and what became of the numbers of both loops."""
    designs = {"A, 20 kHz": _hub(), "B, 40 kHz": _hub({"inverter.switching_frequency": 40e3})}
    figure = new_figure("hub-two-designs", 3.1, "Two designs beside each other", arranged=True)
    left, right = figure.subplots(1, 2)
    for (label, design), colour in zip(designs.items(), (BLUE, ORANGE), strict=True):
        step = next(a.step for a in tune(design).gains.responses() if a.gains.loop == "i_q")
        left.step(step.times * 1e3, step.reference, where="post", color=colour, label=label)
    left.axhline(1.0, color=MUTED, linewidth=0.8)
    left.set(xlabel="Time in ms", ylabel="$i_q$ in A after a step of 1 A", xlim=(0.0, 0.8))
    left.legend(loc="lower right")
    a, b = (solved_side(name, design) for name, design in designs.items())
    rows = compare_sides(a, b).rows
    for section, label, mark, off in (
        ("i_q loop", "$i_q$ loop", "o", -0.14),
        ("speed loop", "speed loop", "D", 0.14),
    ):
        ratios = [_ratio(rows, section, name) for name in _QUANTITIES]
        places = np.arange(len(ratios)) + off
        right.plot(ratios, places, linestyle="", marker=mark, markersize=5, label=label)
    right.axvline(1.0, color=MUTED, linewidth=0.8)
    right.set_yticks(range(len(_QUANTITIES)), list(_QUANTITIES.values()))
    right.invert_yaxis()
    right.set(xscale="log", xlim=(0.4, 5.0), xlabel="B over A")
    right.set_xticks([0.5, 1.0, 2.0, 4.0], ["0.5", "1", "2", "4"])
    right.minorticks_off()
    right.legend(loc="lower right")
    save(figure, path)


def _ratio(rows: tuple[Row, ...], section: str, name: str) -> float:
    found = next(row for row in rows if row.section == section and row.label == name)
    assert isinstance(found.a, float)
    assert isinstance(found.b, float)
    return found.b / found.a


@style()
def explained(path: Path) -> None:
    """Phase of the open speed loop and its step, with the phase-locked loop of the page and with
    the one that it advises.
    """
    with TemporaryDirectory() as folder:
        file = Path(folder) / "mcconf.h"
        file.write_text(
            written_file("how-to/explain-a-configuration.md", file.name), encoding="utf-8"
        )
        found = read_firmware(file, machine=_hub()).found
    assert found.profile is not None
    figure = new_figure("hub-explained", 3.0, "A speed loop on a phase-locked loop", arranged=True)
    left, right = figure.subplots(1, 2)
    hertz = np.geomspace(0.5, 100.0, 300)
    kp = 2000.0
    for ki, colour in ((30_000.0, ORANGE), (0.25 * kp * kp, BLUE)):
        loop = _speed_loop(_with_pll(found.profile, ki), found.drive)
        margins = loop_margins(loop.open_loop)
        answer = loop.open_loop.response(2.0 * math.pi * hertz)
        phase = np.degrees(np.unwrap(np.angle(answer)))
        phase -= 360.0 * np.round((phase[0] + 180.0) / 360.0)
        crossover = margins.crossover / (2.0 * math.pi)
        margin = math.degrees(margins.phase_margin)
        label = f"foc_pll_ki {ki:g}: {margin:.0f} deg left at {crossover:.1f} Hz"
        left.semilogx(hertz, phase, color=colour)
        left.plot([crossover] * 2, [-180.0, margin - 180.0], "o-", color=colour, markersize=4)
        states = constant_input_states(loop.closed, np.array([1.0, 0.0]), 500)
        times = loop.closed.t_s * np.arange(len(states))
        right.plot(times, states[:, 3], color=colour, label=label)
    left.axhline(-180.0, color=INK, linewidth=0.8)
    left.set(xlabel="Frequency in Hz", ylabel="Phase of the open speed loop in deg")
    right.axhline(1.0, color=MUTED, linewidth=0.8)
    right.set(xlabel="Time in s", ylabel="Speed after a step of 1 rad/s", xlim=(0.0, times[-1]))
    figure.legend(loc="outside upper center", ncols=2)
    save(figure, path)


def _with_pll(profile: LoopProfile, ki: float) -> LoopProfile:
    assert profile.speed is not None
    feedback = replace(profile.speed.feedback, ki=ki)
    return replace(profile, speed=replace(profile.speed, feedback=feedback))


def _speed_loop(profile: LoopProfile, drive: DriveValues) -> PiLoop:
    assert profile.speed is not None
    assert drive.r_s is not None
    assert drive.l_q is not None
    winding = Winding(drive.r_s, drive.l_q)
    return speed_loop(winding, mechanics_of(drive, profile.current), profile.current, profile.speed)


@style()
def exported(path: Path) -> None:
    """Small step of the speed in VESC's structure with both sets of gains."""
    figure = new_figure("hub-exported", 2.9, "Speed in VESC's structure", arranged=True)
    axes = figure.add_subplot()
    design = _hub()
    adapted = export_for(_hub({"control.firmware": "vesc"}), "vesc", settle=False).found.profile
    own, told = export_for(design, "vesc", settle=False).found.profile, drive_values(design)
    steps, _ = standard_steps(own, told, design.machine, design.i_max, design.inverter.v_dc)
    step = next(step for step in steps if step.name == "small speed step at rest")
    scenario = replace(step.scenario, duration=0.12)
    with firmware_simulator(own, told) as program:
        for profile, colour, label in (
            (own, ORANGE, "gains of the design: refused"),
            (adapted, BLUE, "control.firmware: vesc"),
        ):
            drive = firmware_drive(profile, design)
            run = simulate_profile(profile, told, drive, scenario, stride=4, program=program)
            axes.plot(1e3 * run.t, run.omega_m, color=colour, linewidth=1.1, label=label)
    axes.plot(
        1e3 * run.t, run.reference, color=INK, linewidth=0.8, linestyle="--", label="reference"
    )
    axes.set(xlabel="Time in ms", ylabel="Speed in rad/s", xlim=(0.0, 120.0))
    figure.legend(loc="outside upper center", ncols=3)
    save(figure, path)


@style()
def tolerances(path: Path) -> None:
    """Phase margin of the q loop over its inductance, cold and warm, and both boxes of the page."""
    design = _hub()
    gains = tune(design).gains.i_q
    deviation = np.linspace(-0.75, 0.2, 191)
    figure = new_figure("hub-tolerances", 2.9, "Phase margin over the inductance", arranged=True)
    axes = figure.add_subplot()
    axes.axvspan(-75.0, 0.0, color=FAINT, alpha=0.35, linewidth=0.0, label="-75 to 0 %: refused")
    axes.axvspan(-20.0, 0.0, color=BLUE, alpha=0.25, linewidth=0.0, label="-20 to 0 %: proven")
    for warm, colour in ((0.0, BLUE), (0.3, ORANGE)):
        margins = _margins(design, gains, warm, deviation)
        margin = np.where(margins.radius < 1.0, np.degrees(margins.phase_margin), np.nan)
        axes.plot(100.0 * deviation, margin, color=colour, label=f"$r_s$ {100.0 * warm:+.0f} %")
    axes.axhline(30.0, color=RED, linewidth=0.9, linestyle="--", label="required: 30 deg")
    worst = math.degrees(_margins(design, gains, 0.0, np.array([-0.2])).phase_margin[0])
    axes.plot([-20.0], [worst], "o", color=INK, markersize=4, zorder=4, label="_")
    axes.text(-21.0, worst + 5.0, f"{worst:.1f} deg, the worst of the box", ha="right", color=INK)
    axes.text(-74.4, 5.0, "unstable", color=INK)
    axes.set(xlabel="$l_q$ off by %", ylabel="Phase margin of $i_q$ in deg")
    axes.set(xlim=(-75.0, 20.0), ylim=(0.0, 75.0))
    figure.legend(loc="outside upper center", ncols=3)
    save(figure, path)


def _margins(design: Design, gains: LoopGains, warm: float, deviation: FloatArray) -> BatchMargins:
    """Margins of the q loop with the winding ``warm`` over its data and the inductance off by
    ``deviation``, shape (N,); both relative.
    """
    plants = current_plants(
        np.full(deviation.size, design.machine.r_s * (1.0 + warm)),
        design.machine.l_q * (1.0 + deviation),
        design.control.t_s,
        np.ones(deviation.size),
    )
    return batch_margins(close_loops(plants, gains.kp, gains.ki))
