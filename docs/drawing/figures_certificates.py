"""Figure of the page on certificates."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.optimizer.certificates.current_reference import certify, interval_bounds
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.forms import PENALTY_FROM, error_curves
from dqforge.optimizer.operating_points.solve import current_choice
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

_DRIVE = "paper000-ipmsm-100kw"
_SAMPLES = 40_000


def proven_bounds(path: Path) -> None:
    """Errors of one reference over the torque with the bounds on every interval and
    those of the whole domain.
    """
    design = catalogue.load(_DRIVE)
    choice = current_choice(design)
    fit = fit_reference(choice, FitSettings(form="polynomial", degree=3))
    certificate, parts = (
        make(choice, fit.reference, fit.errors) for make in (certify, interval_bounds)
    )
    torque = fit.reference.samples(_SAMPLES)
    curves = error_curves(choice, fit.reference, torque)
    loaded = torque >= PENALTY_FROM * fit.torque_max
    rows = (
        ("i_d", np.abs(curves.i_d), 1e3, "$i_d$ in mA", BLUE),
        ("torque", np.abs(curves.torque_error), 1e3, "Torque in mN m", TEAL),
        ("loss_relative", np.where(loaded, curves.loss_relative, 0.0), 1e6, "Loss in 1e-6", ORANGE),
    )
    edges = np.append(parts.low, parts.high[-1])
    with style():
        figure = new_figure(
            "certificate", 5.0, "Errors over the torque below the proven bounds of each interval"
        )
        for index, (name, error, factor, label, colour) in enumerate(rows):
            axes = figure.add_axes((0.09, 0.7 - 0.305 * index, 0.89, 0.26))
            axes.plot(*thinned(torque.astype(np.float64), error * factor, 500), color=colour)
            axes.stairs(
                getattr(parts, name) * factor, edges, baseline=None, color=INK, linewidth=0.7
            )
            axes.axhline(
                getattr(certificate, name) * factor, color=MUTED, linewidth=0.8, linestyle="dashed"
            )
            axes.set(ylabel=label, xlim=(0.0, fit.torque_max), ylim=(0.0, None))
            if index == 0:
                axes.set_title("Magnitude of the error, and what is proven of it")
            axes.tick_params(labelbottom=index == len(rows) - 1)
        axes.set_xlabel("Torque in N m")
        save(figure, path)
