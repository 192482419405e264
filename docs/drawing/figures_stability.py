"""Figure of the page on the stability of currents over a period of the back-EMF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from dqforge.machines.design import catalogue
from dqforge.machines.names import CurrentFrame, Feedforward
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.phase_control.judged_box import PhasePlants, radius
from dqforge.optimizer.phase_control.phase_controller import AxisGains, PhaseControl
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, new_figure, save, style

_LOOPS: tuple[tuple[str, CurrentFrame, Feedforward, float], ...] = (
    ("table, references", "table", "references", 1.0),
    ("the same, inductances halved", "table", "references", 0.5),
    ("dqy, measured currents", "dqy", "measured", 1.0),
    ("the same, inductances halved", "dqy", "measured", 0.5),
)


def _control() -> PhaseControl:
    """That of the shipped machine without harmonic integrators."""
    phases = solve_gains(catalogue.load("paper002-phase-waveforms")).phases
    assert phases is not None
    return replace(phases.control, harmonics=None)


def _tuned(control: PhaseControl, bandwidth: float, l_0: float, *, one: bool) -> PhaseControl:
    """Gains omega_c L and omega_c^2 L/10, ``one`` set for all axes or each axis its own."""
    omega = 2.0 * np.pi * bandwidth
    l_d, l_q, _ = control.inductances
    d, q, zero = (
        AxisGains(omega * size, omega * size * omega / 10.0)
        for size in (l_d, l_q, l_q if one else l_0)
    )
    return replace(control, inductances=(l_d, l_q, l_0), gains=(d, q, zero))


def _radius(control: PhaseControl, share: float, omega_e: float) -> float:
    l_d, l_q, l_0 = (np.array([share * size]) for size in control.inductances)
    plant = PhasePlants(np.array([control.r_s]), l_d, l_q, l_0, np.ones(1))
    return float(radius(control, plant, omega_e)[0])


def periodic_stability(path: Path) -> None:
    """Radius over samples per period, and of one gain for all axes over the inductance ratio."""
    base = _control()
    with style():
        figure = _drawn(base)
    save(figure, path)


def _drawn(base: PhaseControl) -> Figure:
    figure = new_figure("periodic-stability", 3.4, "Radius of the current loops")
    left, right = (figure.add_axes((x, 0.14, 0.41, 0.8)) for x in (0.08, 0.57))
    samples = np.unique(np.round(np.geomspace(10, 400, 70)))
    speeds = 2.0 * np.pi / (samples * base.t_s)
    for number, (label, frame, feedforward, share) in enumerate(_LOOPS):
        tuned = _tuned(base, 500.0, base.inductances[2], one=False)
        control = replace(tuned, frame=frame, feedforward=feedforward)
        found = [_radius(control, share, speed) for speed in speeds]
        line = "-" if share == 1.0 else "--"
        left.semilogx(samples, found, line, color=(BLUE, ORANGE)[number // 2], label=label)
    left.set_xticks([10, 20, 50, 100, 200, 400], ["10", "20", "50", "100", "200", "400"])
    left.minorticks_off()
    left.set(xlabel="Samples per electrical period", ylabel="Radius per sample", ylim=(0.95, 1.2))
    ratios = np.linspace(1.0, 4.0, 61)
    for number, bandwidth in enumerate((500.0, 1000.0)):
        found = []
        for ratio in ratios:
            own = _tuned(base, bandwidth, base.inductances[1] / float(ratio), one=True)
            found.append(_radius(replace(own, frame="dqy"), 1.0, 2.0 * np.pi / (200 * base.t_s)))
        limit = 1.0 / (2.0 * np.pi * bandwidth * base.t_s)
        right.plot(ratios, found, color=(BLUE, ORANGE)[number], label=f"{bandwidth:.0f} Hz")
        right.axvline(limit, color=(BLUE, ORANGE)[number], linewidth=0.8, linestyle=":")
    right.set(xlabel="Inductance, plane over zero sequence (one gain)", ylim=(0.95, 1.2))
    for axes in (left, right):
        axes.axhline(1.0, color=MUTED, linewidth=0.8)
        axes.legend(frameon=False, loc="upper right")
    return figure
