"""Figure of the page on proofs of single loops: sensitivity of a box, and gains that change."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from page_text import DOCS

from dqforge import load_design
from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.optimizer.axis_margins import prove_margins
from dqforge.optimizer.changing_loops import parallel_step, velocity_step
from dqforge.optimizer.control_design.gain_set import solve_current_loops
from dqforge.optimizer.loops.pi_methods import close_loops, current_pi
from dqforge.optimizer.loops.robustness import current_robustness, drive_box
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    MUTED,
    ORANGE,
    RED,
    new_figure,
    save,
    style,
)

_SIDES = {"r_s": (0.0, 0.3), "l_q": (-0.2, 0.0)}

_R, _L, _T_S = 0.4, 2e-3, 1e-4  # Ohm, H, s

_SAMPLES = 41


@style()
def loop_proofs(path: Path) -> None:
    """Sensitivity of the drives of a box below what is proven, and the current while inductance
    and gains change 1 : 3 at every sample.
    """
    figure = new_figure(
        "loop-proofs", 3.1, "Sensitivity of a box, and loops that change", arranged=True
    )
    left, right = figure.subplots(1, 2)
    _draw_sensitivities(left)
    for form, colour in (("velocity", RED), ("parallel", BLUE)):
        right.semilogy(_deviations(form), ".-", color=colour, linewidth=0.9, label=f"{form} form")
    right.set(title="Inductance and gains 1 : 3 in turn", xlabel="Sample", xlim=(0.0, _SAMPLES - 1))
    right.set(ylabel="Deviation of the flux linkage", ylim=(1e-3, 1e5))
    right.minorticks_off()
    right.legend(loc="upper left")
    save(figure, path)


def _draw_sensitivities(axes: Axes) -> None:
    """Those of the q loop of hub.yaml over winding temperature and inductance."""
    sides = {
        f"control.tolerances.{name}": {"from": low, "to": high}
        for name, (low, high) in _SIDES.items()
    }
    design = load_design(DOCS / "how-to" / "files" / "hub.yaml", sides)
    gains = solve_current_loops(design)[1]
    nominal = design.machine.l_d, design.machine.l_q
    box = drive_box(design, nominal, nominal)
    found = current_robustness(box, gains, "i_q")
    bound = prove_margins(box, gains, found).max_sensitivity
    assert bound is not None
    points = box.current_points("i_q")
    loops = close_loops(box.current_loop_plants("i_q", points), gains.kp, gains.ki)
    hertz = np.geomspace(100.0, 0.5 / design.control.t_s, 70)
    size = np.abs(loops.sensitivity(2.0 * math.pi * hertz))
    inside = f"{len(size) - points.corners} drives inside"
    axes.fill_between(hertz, size.min(axis=0), size.max(axis=0), color=FAINT, label=inside)
    worst = f"{points.corners} corners, worst {found.max_sensitivity.value:.3f}"
    for row in range(points.corners):
        axes.semilogx(hertz, size[row], color=BLUE, linewidth=0.9, label="_" if row else worst)
    axes.axhline(bound, color=ORANGE, linestyle="--", label=f"proven: at most {bound:.3f}")
    axes.axhline(1.0, color=MUTED, linewidth=0.8)
    axes.set(title="q loop of hub.yaml", xlabel="Frequency in Hz", ylabel="Sensitivity $|S|$")
    axes.set(xlim=(hertz[0], hertz[-1]), ylim=(0.0, 2.25))
    axes.legend(loc="lower right")


def _deviations(form: str) -> FloatArray:
    """Flux linkage over its first value while the inductance alternates, with the gains of each."""
    settings = CurrentLoopSettings("magnitude-optimum")
    state, found = np.array([1.0, 0.0, 0.0]), []
    for sample in range(_SAMPLES):
        found.append(abs(state[0]))
        inductance = _L if sample % 2 == 0 else 3.0 * _L
        kp, ki = current_pi(_R, inductance, _T_S, settings)
        rho, share = _R * _T_S / inductance, _T_S / inductance
        alpha, beta = math.exp(-rho), -math.expm1(-rho) / rho
        if form == "velocity":
            step = velocity_step(alpha, beta, share, (kp, ki * _T_S))
        else:
            step = parallel_step(alpha, beta, kp * share, ki * _T_S * share)
        state = np.array(step) @ state
    return np.array(found)
