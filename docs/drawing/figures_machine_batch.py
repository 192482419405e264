"""Figure of the page on batches of machines: their fits against those of the single path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import FitForm
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.exploration.batch_currents import fit_references
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_per_unit
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, save, style

_MACHINE = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0)


_TAU = np.geomspace(0.3, 40.0, 90)


def machines_over_tau() -> list[LinearMachine]:
    """The machine of paper 000 with current limits that end its curve at each tau."""
    base = _MACHINE.psi_pm / (2.0 * _MACHINE.saliency)
    limits = base * np.hypot(*mtpa_per_unit(_TAU))
    given = (_MACHINE.pole_pairs, _MACHINE.r_s, _MACHINE.l_d, _MACHINE.l_q, _MACHINE.psi_pm)
    return [LinearMachine(*given, float(limit)) for limit in limits]


def _ratios(form: FitForm, degree: int) -> FloatArray:
    """Largest error of the fitted currents over that of the single path."""
    machines, settings = machines_over_tau(), FitSettings(form=form, degree=degree)
    many = fit_references(MachineBatch.of(machines), settings).errors
    names = ("i_d",) if form == "torque-exact" else ("i_d", "i_q")
    found = []
    for row, machine in enumerate(machines):
        one = fit_reference(CurrentChoice(machine, "mtpa", machine.i_max), settings).errors
        worst = max(getattr(one, name) for name in names)
        found.append(max(getattr(many, name)[row] for name in names) / worst)
    return np.array(found)


@style()
def errors_over_tau(path: Path) -> None:
    """Errors of batch over those of the single path, two segments, over the bend of the curve."""
    figure = new_figure("machine-batch", 2.9, "Errors of batch over single path", arranged=True)
    axes = figure.subplots()
    axes.axhline(1.0, color=MUTED, linewidth=0.8)
    cases: tuple[tuple[FitForm, int, str, str], ...] = (
        ("torque-exact", 4, BLUE, "-"),
        ("polynomial", 4, ORANGE, "-"),
        ("torque-exact", 3, TEAL, ":"),
    )
    for form, degree, colour, dashes in cases:
        axes.plot(_TAU, _ratios(form, degree), dashes, color=colour, label=f"{form}, {degree}")
    axes.set(xscale="log", xlabel="End of the domain over the base torque, tau")
    axes.set(ylabel="Error of batch / single path", ylim=(0.6, 1.25))
    axes.legend(title="form, degree")
    save(figure, path)
