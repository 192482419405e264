"""Figures of the page on a measured drive: the capture with what is identified in it, and the drive
that runs on it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import CurrentFrame
from dqforge.reports.pages.figures_style import (
    BLUE,
    MUTED,
    ORANGE,
    PALE,
    TEAL,
    new_figure,
    save,
    style,
)
from dqforge.reports.session.losses import BackEmf, read_back_emf
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.simulation.recorded_run import Simulation

DRIVE = "vdyno-trampa-6340"
CAPTURES = {
    "500 rpm": "vdyno_trampa6340_0500rpm1_dec10.csv",
    "250 rpm": "vdyno_trampa6340_0250rpm1_dec10.csv",
}
FOLDER = Path(__file__).resolve().parents[3] / "shared" / "data" / "bemf"
"""Where the captures lie, which are no part of the project; without them the identified shape
alone is drawn.
"""

_COLOURS = (BLUE, ORANGE, TEAL)
_ORDERS = (3, 5, 7, 9, 11, 13)
_STRIDE = 12
_FRAMES: tuple[CurrentFrame, ...] = ("dq", "table")


def capture(path: Path) -> None:
    """The first electrical period at 500 rpm with the shape of the design, and the harmonics of
    both captures with their uncertainty.
    """
    design = catalogue.load(DRIVE)
    with style():
        figure = new_figure(
            "measured-drive-capture", 3.0, "A captured period and its harmonics", arranged=True
        )
        left, right = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
        _draw_shape(left, design)
        shares = 100.0 * _shares(design)
        right.bar(_ORDERS, shares, 0.8, color=PALE, label="shipped")
        for place, (name, file) in enumerate(CAPTURES.items()):
            if (FOLDER / file).is_file():
                _draw_harmonics(right, _reading(file), name, _COLOURS[place], 0.5 * place - 0.25)
        right.set(xlabel="Order", ylabel="% of the fundamental", xticks=_ORDERS, ylim=(0.0, None))
        right.legend()
    save(figure, path)


def _reading(file: str) -> BackEmf:
    return read_back_emf(FOLDER / file, pole_pairs=7, scale=(1.0, 1.0, 10.0), harmonics=13)


def _shares(design: Design) -> FloatArray:
    """Harmonics of the shipped machine over its fundamental, at `_ORDERS`."""
    assert design.phase_machine is not None
    lines = np.abs(np.fft.rfft(design.phase_machine.flux[0]))
    return np.asarray(lines[list(_ORDERS)] / lines[1])


def _draw_shape(axes: Axes, design: Design) -> None:
    assert design.phase_machine is not None
    theta = np.degrees(design.phase_machine.theta)
    file = FOLDER / CAPTURES["500 rpm"]
    if file.is_file():
        result, record = _reading(file.name).result, _reading(file.name).reading.capture
        assert record.time is not None
        time = record.time - record.time[0]
        omega = 2.0 * np.pi * result.frequency * (1.0 - 0.5 * result.drift)
        angle = result.start_angle + omega * time
        shown = np.flatnonzero(angle <= result.start_angle + 2.0 * np.pi)[::_STRIDE]
        volts = (record.voltages - result.offsets[:, np.newaxis]) / omega
        for colour, values in zip(_COLOURS, volts, strict=True):
            place = np.degrees(np.mod(angle[shown], 2.0 * np.pi))
            axes.plot(place, 1e3 * values[shown], ".", color=colour, markersize=2.0, alpha=0.6)
    for colour, name, values in zip(_COLOURS, "abc", design.phase_machine.flux, strict=True):
        axes.plot(theta, 1e3 * values, color=colour, linewidth=1.0, label=name)
    axes.set(
        xlabel="Electrical angle in deg",
        ylabel="e / $\u03c9_e$ in mWb",
        xlim=(0.0, 360.0),
        xticks=np.arange(0, 361, 60),
    )
    axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)


def _draw_harmonics(axes: Axes, read: BackEmf, name: str, colour: str, shift: float) -> None:
    """Means of the three phases, with their largest uncertainty."""
    found, places = read.result, np.array(_ORDERS) - 1
    base = found.amplitudes[:, :1]
    share = np.mean(found.amplitudes[:, places] / base, axis=0)
    doubt = np.max(found.amplitude_uncertainty[:, places] / base, axis=0)
    axes.errorbar(
        np.array(_ORDERS) + shift,
        100.0 * share,
        yerr=100.0 * doubt,
        fmt="o",
        markersize=2.5,
        linewidth=0.9,
        color=colour,
        label=name,
    )


def running(path: Path) -> None:
    """Speed and torque of the simulated drive with a table over the angle, and its torque over two
    electrical periods beside that of constant dq currents.
    """
    design = catalogue.load(DRIVE)
    runs = {frame: _run(design, frame) for frame in _FRAMES}
    with style():
        figure = new_figure(
            "measured-drive-running", 3.2, "Speed and torque of the simulated drive", arranged=True
        )
        whole, part = figure.subplots(1, 2)
        table = runs["table"]
        whole.plot(1e3 * table.t, table.omega_m * 30.0 / np.pi, color=BLUE)
        whole.set(xlabel="Time in ms", ylabel="Speed in rpm")
        for colour, (frame, run) in zip((MUTED, BLUE), runs.items(), strict=True):
            shown = steady(run)
            angle = np.degrees(np.unwrap(run.theta_e[shown]))
            angle -= angle[0]
            seen = angle <= 720.0
            part.plot(angle[seen], run.torque[shown][seen], color=colour, label=frame)
        part.set(
            xlabel="Electrical angle in deg",
            ylabel="Torque in N m",
            xlim=(0.0, 720.0),
            xticks=np.arange(0, 721, 180),
        )
        part.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    save(figure, path)


def _run(design: Design, frame: CurrentFrame) -> Simulation:
    loop = replace(design.control.current_loop, frame=frame)
    return simulate_design(replace(design, control=replace(design.control, current_loop=loop))).run


def steady(run: Simulation) -> slice:
    """The last quarter of the time before the step of the speed reference."""
    step = int(np.argmax(np.abs(np.diff(run.reference)) > 0.0)) or run.t.size - 1
    return slice(3 * step // 4, step)
