"""Figures of the how-to pages on the constants of data sheets and on designs made of them."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path

import numpy as np
from page_text import DOCS, written_file

from dqforge import Design, operating_map
from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.sheet_judged import design_text
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    PAPER,
    TEAL,
    new_figure,
    save,
    style,
)

_PAGE = "how-to/convert-constants.md"

_POLE_PAIRS = 4

_KINDS = ("line-to-line rms", "line-to-line peak", "phase rms", "phase peak")


def _flux(key: str, kind: str) -> float:
    """Flux linkage in Wb of the page's design by one of its two constants, read as a kind."""
    other = {"back_emf_constant": "torque_constant", "torque_constant": "back_emf_constant"}[key]
    text = written_file(_PAGE, "servo.yaml")
    alone = re.sub(rf"^  {other}:.*\n", "", text, flags=re.MULTILINE)
    read = re.sub(rf"(  {key}: .*kind: )[^}}]*", rf"\g<1>{kind}", alone)
    return load_text(read.encode(), "servo.yaml").machine.psi_pm


@style()
def constants(path: Path) -> None:
    """Back-EMF at 1000 rpm with its four values, and the flux linkage that each reading makes."""
    omega_e = _POLE_PAIRS * 1000.0 * math.pi / 30.0
    phase = omega_e * _flux("back_emf_constant", _KINDS[0])
    line = math.sqrt(3.0) * phase
    times = np.linspace(0.0, 2.0 * math.pi / omega_e, 241)
    figure = new_figure("convert-constants", 3.2, "One back-EMF, and what it can be called")
    left = figure.add_axes((0.085, 0.15, 0.42, 0.76))
    left.plot(1e3 * times, line * np.sin(omega_e * times), color=BLUE)
    left.plot(1e3 * times, phase * np.sin(omega_e * times - math.pi / 6.0), color=ORANGE)
    for value, colour, words, side in (
        (line, BLUE, "line-to-line peak", "bottom"),
        (line / math.sqrt(2.0), BLUE, "line-to-line r.m.s.", "bottom"),
        (phase, ORANGE, "phase peak", "top"),
        (phase / math.sqrt(2.0), ORANGE, "phase r.m.s.", "top"),
    ):
        left.axhline(value, color=colour, linewidth=0.8, linestyle="--")
        place = 1e3 * times[-1], value + (1.5 if side == "bottom" else -2.5)
        left.text(*place, f"{value:.1f} V {words}", ha="right", va=side, color=INK)
    left.set(title="53 V/krpm at 1000 rpm", xlabel="Time in ms", ylabel="Voltage in V")
    left.set(xlim=(0.0, 1e3 * times[-1]), ylim=(-1.05 * line, 1.22 * line))
    right = figure.add_axes((0.7, 0.15, 0.28, 0.76))
    flux = [1e3 * _flux("back_emf_constant", kind) for kind in _KINDS]
    right.barh(range(4), flux, color=[BLUE, MUTED, MUTED, MUTED], height=0.55)
    for place, value in enumerate(flux):
        right.text(4.0, place, f"{value:.1f}", va="center", color=PAPER, fontweight="bold")
    right.axvline(1e3 * _flux("torque_constant", "rms"), color=TEAL, linestyle="--")
    right.set_yticks(range(4), [kind.replace("rms", "r.m.s.") for kind in _KINDS])
    right.invert_yaxis()
    right.set(
        title="53 V/krpm read as", xlabel="$ψ_{pm}$ in mWb; dashed: by $K_t$", xlim=(0.0, 200.0)
    )
    save(figure, path)


_OPTIONS = {"v-dc": "inverter.v_dc"}

_FASTEST = 4000.0  # rpm


def _scooter() -> Design:
    """The design that the first command of the page makes."""
    page = (DOCS / "how-to" / "from-a-data-sheet.md").read_text(encoding="utf-8")
    command = page[page.index("$ dqforge new scooter") :].split("\nMy drive", maxsplit=1)[0]
    words = shlex.split(command.replace("\\\n", " "))[4:]
    options = zip(words[::2], words[1::2], strict=True)
    given = {name.removeprefix("--"): value for name, value in options}
    keys = {_OPTIONS.get(name, f"machine.{name.replace('-', '_')}"): given[name] for name in given}
    return load_text(design_text(keys).encode(), "design.yaml")


@style()
def scooter(path: Path) -> None:
    """Torque over speed of the motor that six values of a data sheet describe."""
    design = _scooter()
    machine = design.machine
    found = operating_map(design, torques=4, speeds=120).found
    edge, figures = found.envelope.points, found.figures
    rpm = 30.0 / math.pi
    figure = new_figure("scooter-torque", 3.0, "Torque over speed of a data sheet", arranged=True)
    axes = figure.add_subplot()
    speed = np.linspace(0.0, _FASTEST / rpm, 400)
    torque = np.interp(speed, edge.omega_m, edge.torque)
    axes.fill_between(speed * rpm, torque, color=FAINT, alpha=0.35, linewidth=0.0)
    axes.plot(speed * rpm, torque, color=BLUE, label="with field weakening")
    alone = _without_weakening(design, speed)
    axes.plot(speed * rpm, alone, color=ORANGE, linestyle="--", label="$i_d$ = 0")
    base, unloaded = figures.base_speed * rpm, design.inverter.v_dc * 60.0
    constant = 1.5 * machine.pole_pairs * machine.psi_pm
    for place, words, across in (
        ((base, figures.torque_max), f"{base:.0f} rpm: the voltage is used up", 90.0),
        ((unloaded, 0.0), f"{unloaded:.0f} rpm: Kv times 48 V", 90.0),
    ):
        axes.plot(*place, "o", color=INK, markersize=4, zorder=4, label="_", clip_on=False)
        axes.text(place[0] + across, place[1] + 0.25, words, color=INK)
    axes.text(
        90.0,
        figures.torque_max - 0.65,
        f"{figures.torque_max:.2f} N m = {constant:.4f} N m/A times {design.i_max:.1f} A",
        color=INK,
    )
    axes.set(xlabel="Speed in rpm", ylabel="Torque in N m", xlim=(0.0, _FASTEST), ylim=(0.0, 9.0))
    axes.legend(loc="lower left")
    save(figure, path)


def _without_weakening(design: Design, omega_m: FloatArray) -> FloatArray:
    """Largest torque in N m of the q current alone within current and voltage limit, (N,)."""
    machine, v_max = design.machine, design.inverter.v_dc / math.sqrt(3.0)
    omega = machine.pole_pairs * omega_m
    square = machine.r_s**2 + (omega * machine.l_q) ** 2
    drop, emf = machine.r_s * omega * machine.psi_pm, omega * machine.psi_pm
    root = np.sqrt(np.maximum(drop**2 - square * (emf**2 - v_max**2), 0.0))
    i_q = np.where(emf < v_max, np.minimum((root - drop) / square, design.i_max), np.nan)
    return 1.5 * machine.pole_pairs * machine.psi_pm * i_q
