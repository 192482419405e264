"""Figures 6.2 to 6.16 of paper 002 as they follow from the definitions, for the shipped drive at
the torque of the bench: back-EMF, frames, and the currents of dqx and dqy in every frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import (
    FrameAngles,
    frame_angles,
    loss_ratio_x_over_y,
    to_frame,
)
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT
from dqforge.optimizer.waveforms.comparison import require_phases
from dqforge.optimizer.waveforms.constraint_rows import spectrum, unit_currents
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


DESIGN_NAME = "paper002-phase-waveforms"
BENCH_TORQUE = 1.0  # N m, section 6.2.
HIGHEST_ORDER = 13


@dataclass(frozen=True, slots=True, eq=False)
class BenchCurves:
    """Curves of the shipped drive at 1 N m over ``theta`` in rad, shape (N,).

    ``flux`` in Wb, shape (3, N), and ``flux_harmonics`` in Wb (peak), shape (H,), of orders 0..H-1
    of phase a. ``currents`` of phase a in A, shape (2, N), first dqx; ``harmonics`` in A (peak),
    shape (2, H). All others are those of dqy, power-invariant as in the thesis, in A: ``i_qy`` the
    constant reference, ``dqy`` and ``dqx`` divided by a_y and a_x, ``stationary`` alpha, beta and
    0, shape (3, N) each. ``loss_ratio`` is copper loss of dqx over that of dqy.
    """

    theta: FloatArray
    flux: FloatArray
    flux_harmonics: FloatArray
    angles: FrameAngles
    currents: FloatArray
    harmonics: FloatArray
    i_qy: float
    dqy: FloatArray
    dqx: FloatArray
    stationary: FloatArray
    loss_ratio: float


@dataclass(frozen=True, slots=True)
class CurveFigure:
    """A number of a figure: ``expected`` by an identity of the frames, which needs no curve, and
    ``found`` from the currents of the phases.
    """

    figure: str
    quantity: str
    unit: str
    found: float
    expected: float | None = None
    identity: str = ""


def bench_machine() -> PhaseMachine:
    """The shipped machine, without saliency.

    Raises:
        InputError: The shipped design has become one with saliency.
    """
    machine = require_phases(catalogue.load(DESIGN_NAME))
    if isinstance(machine, SalientPhaseMachine):
        raise InputError(f"{DESIGN_NAME} has saliency, which chapter 4 has no equations for")
    return machine


def bench_curves() -> BenchCurves:
    """Curves of the shipped drive at 1 N m."""
    machine = bench_machine()
    phi_m = float(np.max(np.abs(machine.flux)))
    shape = machine.flux / phi_m
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    x, y = (BENCH_TORQUE * unit_currents(machine, rule) for rule in ("dqx", "dqy"))
    currents = np.stack([x[0], y[0]])
    return BenchCurves(
        theta=theta,
        flux=machine.flux,
        flux_harmonics=spectrum(machine.flux)[0][0],
        angles=frame_angles(shape),
        currents=currents,
        harmonics=spectrum(currents)[0],
        i_qy=float(BENCH_TORQUE / (machine.pole_pairs * phi_m * POWER_INVARIANT)),
        dqy=to_frame("dqy", theta, shape, y, scaled=True),
        dqx=to_frame("dqx", theta, shape, y, scaled=True),
        stationary=to_frame("alphabeta0", theta, shape, y),
        loss_ratio=loss_ratio_x_over_y(shape),
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _peak(values: FloatArray) -> float:
    return float(np.max(np.abs(values)))


def curve_figures(curves: BenchCurves) -> tuple[CurveFigure, ...]:
    """Numbers of Figures 6.9 to 6.16."""
    i_qy, ratio = curves.i_qy, (curves.angles.a_y / curves.angles.a_x) ** 2
    alpha, beta, zero = curves.stationary
    orders = spectrum(curves.stationary)[0][2]
    reference = "T/(p phi_m sqrt(3/2))"
    x = "i_qy (a_y/a_x)^2"
    whole = float(np.sqrt(np.mean((curves.i_qy * curves.angles.a_y) ** 2)))
    return (
        CurveFigure("6.9", "i_qy, least", "A", float(np.min(curves.dqy[1])), i_qy, reference),
        CurveFigure("6.9", "i_qy, largest", "A", float(np.max(curves.dqy[1])), i_qy, reference),
        CurveFigure("6.9", "i_dy, i_0y, largest", "A", _peak(curves.dqy[::2]), 0.0, "(4.5), (4.6)"),
        CurveFigure(
            "6.10", "i_qx, least", "A", float(np.min(curves.dqx[1])), i_qy * np.min(ratio), x
        ),
        CurveFigure(
            "6.10", "i_qx, largest", "A", float(np.max(curves.dqx[1])), i_qy * np.max(ratio), x
        ),
        CurveFigure("6.11", "i_alpha, r.m.s.", "A", _rms(alpha), _rms(beta), "that of i_beta"),
        CurveFigure("6.11", "i_alpha, peak", "A", _peak(alpha)),
        CurveFigure("6.12", "i_beta, peak", "A", _peak(beta)),
        CurveFigure("6.13", "i_0, r.m.s.", "A", _rms(zero)),
        CurveFigure("6.13", "i_0, peak", "A", _peak(zero)),
        CurveFigure("6.13", "i_0, order 3", "A", float(orders[3])),
        CurveFigure("6.13", "i_0, order 9", "A", float(orders[9])),
        CurveFigure(
            "6.15",
            "length of the current, r.m.s.",
            "A",
            float(np.sqrt(np.mean(np.sum(curves.stationary**2, axis=0)))),
            whole,
            "i_qy a_y",
        ),
        CurveFigure(
            "6.16",
            "i_a, r.m.s.",
            "A",
            _rms(curves.currents[1]),
            whole / 3**0.5,
            "the same / sqrt 3",
        ),
        CurveFigure("6.16", "i_a, peak", "A", _peak(curves.currents[1])),
    )


def telling_orders(curves: BenchCurves) -> tuple[int, ...]:
    """Orders by which the currents of phase a differ, the largest difference first."""
    difference = np.abs(curves.harmonics[1] - curves.harmonics[0])[: HIGHEST_ORDER + 1]
    return tuple(int(order) for order in np.argsort(-difference)[:4])


# Which harmonics of the back-EMF the words of the thesis leave: it prints them as a figure alone,
# and says that the currents of dqx and dqy differ most in the orders 1, 3 and 7.

SPOKEN_ORDERS = (1, 3, 7)
_SCAN_ANGLES = 240  # of a turn: enough for orders up to 7 and what the currents make of them

# Shares of the fundamental; negative: in opposite phase.
_THIRD = np.arange(2, 31) * 0.01
_FIFTH, _SEVENTH = np.arange(-8, 9) * 0.01, np.arange(-6, 7) * 0.01


@dataclass(frozen=True, slots=True)
class SpokenHarmonics:
    """What the words leave.

    Args:
        sets, agreeing: How many sets of shares were scanned, and in how many the orders are those
            of the thesis.
        opposed: Whether the orders 5 and 7 together are opposite to the fundamental in all these.
        loss_least, loss_largest: Copper loss of dqx over that of dqy among them.
        shipped: Shares of the orders 3, 5, 7 of the shipped drive.
        shipped_agrees: Whether they are among them; ``turned_agrees``: with order 5 in opposite
            phase.
    """

    sets: int
    agreeing: int
    opposed: bool
    loss_least: float
    loss_largest: float
    shipped: tuple[float, ...]
    shipped_agrees: bool
    turned_agrees: bool


def apart_of(shares: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Differences of the currents of dqx and dqy by order, shape (M, `HIGHEST_ORDER` + 1), and
    copper loss of dqx over dqy, shape (M,), of M sets of shares of the orders 3, 5 and 7, shape
    (M, 3).
    """
    theta = 2.0 * np.pi * np.arange(_SCAN_ANGLES) / _SCAN_ANGLES
    lags = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    waves = np.sin(np.multiply.outer(np.array([1.0, 3.0, 5.0, 7.0]), lags))
    flux = waves[0] + np.tensordot(shares, waves[1:], axes=1)
    seen = flux - np.mean(flux, axis=1, keepdims=True)
    squares = [np.sum(wave**2, axis=1) for wave in (seen, flux)]
    apart = flux[:, 0] / squares[1] - seen[:, 0] / squares[0]
    lines = np.abs(np.fft.rfft(apart, axis=1))[:, : HIGHEST_ORDER + 1]
    losses = [np.mean(1.0 / square, axis=1) for square in squares]
    return lines, np.asarray(losses[0] / losses[1])


def _as_spoken(lines: FloatArray) -> BoolArray:
    largest = np.argsort(-lines, axis=1)[:, : len(SPOKEN_ORDERS)]
    return np.asarray(np.all(np.sort(largest, axis=1) == SPOKEN_ORDERS, axis=1))


def spoken_harmonics(curves: BenchCurves) -> SpokenHarmonics:
    """Scan the shares of three harmonics for what the thesis says of their currents."""
    grids = np.meshgrid(_THIRD, _FIFTH, _SEVENTH, indexing="ij")
    shares = np.stack([grid.ravel() for grid in grids], axis=1)
    lines, ratio = apart_of(shares)
    agree = _as_spoken(lines)
    orders = np.fft.rfft(curves.flux[0]).imag[[1, 3, 5, 7]]
    shipped = orders[1:] / orders[0]
    own = _as_spoken(apart_of(np.stack([shipped, shipped * np.array([1.0, -1.0, 1.0])]))[0])
    return SpokenHarmonics(
        sets=agree.size,
        agreeing=int(np.count_nonzero(agree)),
        opposed=bool(np.all(np.sum(shares[agree, 1:], axis=1) < 1e-9)),
        loss_least=float(np.min(ratio[agree])),
        loss_largest=float(np.max(ratio[agree])),
        shipped=tuple(float(share) for share in shipped),
        shipped_agrees=bool(own[0]),
        turned_agrees=bool(own[1]),
    )


# Figures 6.2 to 6.7 and 6.9 to 6.16 of paper 002 as they follow from the definitions.

_COLOURS = (BLUE, ORANGE, TEAL)


_FIRST_BAR = 1e-4  # of the fundamental: less is rounding


def _over_angle(axes: Axes, labels: bool = True) -> None:
    axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 60), xlabel="Electrical angle in deg")
    if labels:
        axes.legend(frameon=False, loc="best", ncols=3)


def _bars(axes: Axes, lines: FloatArray, colours: tuple[str, ...], factor: float) -> None:
    """Amplitudes by order, shape (K, H), side by side; what is rounding left out."""
    orders = np.arange(1, HIGHEST_ORDER + 1)
    width = 0.72 / len(lines)
    for place, (row, colour) in enumerate(zip(lines, colours, strict=True)):
        values = factor * row[1 : HIGHEST_ORDER + 1]
        shown = values > _FIRST_BAR * np.max(values)
        offset = width * (place - 0.5 * (len(lines) - 1))
        axes.bar(orders[shown] + offset, values[shown], 0.95 * width, color=colour)
    axes.set(xlabel="Order", yscale="log", xticks=orders[::2], xlim=(0.0, HIGHEST_ORDER + 1.0))


def plot_machine(curves: BenchCurves) -> Figure:
    """Back-EMF, frames and currents of phase a: Figures 6.2 to 6.7."""
    degrees = np.degrees(curves.theta)
    angles = curves.angles
    with style():
        figure = new_figure(
            "paper-002-machine", 6.6, "Back-EMF, frames and currents of phase a, inferred machine"
        )
        places = (
            (0.08, 0.73),
            (0.575, 0.73),
            (0.08, 0.4),
            (0.575, 0.4),
            (0.08, 0.07),
            (0.575, 0.07),
        )
        emf, spectrum, turned, factors, current, lines = (
            figure.add_axes((x, y, 0.4, 0.215)) for x, y in places
        )
        for values, colour, label in zip(1e3 * curves.flux, _COLOURS, "abc", strict=True):
            emf.plot(degrees, values, color=colour, label=label)
        emf.set(
            title="Figure 6.2: back-EMF over speed, inferred",
            ylabel="mV s/rad",
            ylim=(-230.0, 320.0),
        )
        _bars(spectrum, curves.flux_harmonics[np.newaxis], (BLUE,), 1e3)
        spectrum.set(title="Figure 6.3: its harmonics", ylabel="mV s/rad")
        turned.plot(degrees, degrees, color=TEAL, label="θ_r")
        total = degrees + np.degrees(angles.theta_x)
        turned.plot(degrees, total, color=ORANGE, linestyle="dashed", label="θ_r + θ_x")
        turned.plot(degrees, np.degrees(angles.theta_y), color=BLUE, label="θ_y")
        turned.set(title="Figure 6.4: angles", ylabel="deg")
        factors.plot(degrees, angles.a_x, color=ORANGE, label="a_x")
        factors.plot(degrees, angles.a_y, color=BLUE, label="a_y")
        factors.set(title="Figure 6.5: factors", ylim=(0.86, 0.93))
        for values, colour, label in zip(
            curves.currents, (ORANGE, BLUE), ("dqx", "dqy"), strict=True
        ):
            current.plot(degrees, values, color=colour, label=label)
        current.set(title="Figure 6.6: phase a at 1 N m", ylabel="A")
        _bars(lines, curves.harmonics, (ORANGE, BLUE), 1e3)
        lines.set(title="Figure 6.7: its harmonics", ylabel="mA")
        for axes in (emf, turned, factors, current):
            _over_angle(axes)
    return figure


def plot_currents(curves: BenchCurves) -> Figure:
    """Currents of dqy in every frame, and their path: Figures 6.9 to 6.16."""
    degrees = np.degrees(curves.theta)
    alpha, beta, zero = curves.stationary
    with style():
        figure = new_figure(
            "paper-002-currents", 6.6, "Currents of dqy in every frame at 1 N m, inferred machine"
        )
        rows = (0.73, 0.4, 0.07)
        q, plane, nought, phase = (
            figure.add_axes((x, y, 0.4, 0.215))
            for x, y in ((0.08, rows[0]), (0.575, rows[0]), (0.08, rows[1]), (0.575, rows[1]))
        )
        q.plot(degrees, curves.dqy[1], color=BLUE, label="i_qy (6.9)")
        q.plot(degrees, curves.dqx[1], color=ORANGE, label="i_qx (6.10)")
        q.set(title="Figures 6.9, 6.10", ylabel="A", ylim=(1.95, 2.06))
        plane.plot(degrees, alpha, color=BLUE, label="i_\u03b1 (6.11)")
        plane.plot(degrees, beta, color=ORANGE, label="i_β (6.12)")
        plane.set(title="Figures 6.11, 6.12", ylabel="A", ylim=(-2.1, 2.8))
        nought.plot(degrees, zero, color=TEAL)
        nought.set(title="Figure 6.13: i_0", ylabel="A")
        phase.plot(degrees, curves.currents[1], color=BLUE)
        phase.set(title="Figure 6.16: i_a", ylabel="A")
        for axes, labels in ((q, True), (plane, True), (nought, False), (phase, False)):
            _over_angle(axes, labels)
        path = figure.add_axes((0.08, rows[2], 0.22, 0.235))
        path.plot(np.append(alpha, alpha[0]), np.append(beta, beta[0]), color=BLUE)
        path.set(title="Figure 6.14", xlabel="i_\u03b1 in A", ylabel="i_β in A", aspect="equal")
        for place, (across, colour, label) in enumerate(
            ((alpha, BLUE, "i_\u03b1 in A"), (beta, ORANGE, "i_β in A"))
        ):
            view = figure.add_axes((0.41 + 0.33 * place, rows[2], 0.235, 0.235))
            view.plot(np.append(across, across[0]), np.append(zero, zero[0]), color=colour)
            title = "Figure 6.15, seen along β" if place == 0 else "and along \u03b1"
            view.set(title=title, xlabel=label, ylabel="i_0 in A")
    return figure


# Figures 2.3 to 3.2 of paper 002: the back-EMF of four shapes in five frames.

_AXES = {
    "2.3": ("a", "b", "c"),
    "2.4": ("$\u03b1$", "$\u03b2$", "0"),
    "2.5": ("d", "q", "0"),
    "2.6": ("dx", "qx", "0"),
    "3.2": ("dy", "qy", "0y"),
}


def plot_frames(curves: dict[str, dict[str, FloatArray]]) -> Figure:
    """Back-EMF of the four shapes (columns) in the five frames (rows): Figures 2.3 to 2.6 and
    3.2.
    """
    with style():
        figure = new_figure("paper-002-frames", 8.2, "Back-EMF of four shapes in five frames")
        for row, (number, names) in enumerate(_AXES.items()):
            for column, (name, components) in enumerate(curves[number].items()):
                axes = figure.add_axes((0.075 + 0.235 * column, 0.82 - 0.192 * row, 0.2, 0.135))
                theta = 2.0 * np.pi * np.arange(components.shape[1]) / components.shape[1]
                for values, colour, label in zip(components, _COLOURS, names, strict=True):
                    axes.plot(np.degrees(theta), values, color=colour, linewidth=1.0, label=label)
                axes.set(xlim=(0.0, 360.0), xticks=(0, 120, 240), ylim=(-1.8, 2.0))
                if row == 0:
                    axes.set_title(name, fontsize=7.0)
                if column == 0:
                    axes.set_ylabel(f"Figure {number}")
                    axes.legend(
                        frameon=False, loc="upper right", ncols=3, fontsize=6.0, handlelength=1.0
                    )
                else:
                    axes.set_yticklabels([])
                if row == len(_AXES) - 1:
                    axes.set_xlabel("Electrical angle in deg")
    return figure
