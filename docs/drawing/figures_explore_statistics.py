"""A production of one header: errors, what the torque depends on, and two errors together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.special import ndtr, ndtri

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.exploration.acceptance import empty_histogram
from dqforge.optimizer.exploration.sensitivities import binned_output, sensitivities
from dqforge.optimizer.exploration.yields import (
    LOSS_PENALTY,
    TORQUE_ERROR,
    TORQUE_MADE,
    nominal_header,
    yield_outputs,
)
from dqforge.reports.pages.figures_style import BLUE, ORANGE, TEAL, new_figure, save, style

_ROWS = 20_000


_SPREAD = {"r_s": 0.05, "l_d": 0.05, "l_q": 0.05, "psi_pm": 0.02}


_SYMBOLS = ("R", "$L_d$", "$L_q$", "$\\psi$")


def _drawn(base: LinearMachine) -> MachineBatch:
    """Machines by normal distributions that are cut at three standard deviations."""
    random, low = np.random.default_rng(20261122), ndtr(-3.0)
    columns = {
        name: getattr(base, name)
        * (1.0 + sigma * ndtri(low + (1.0 - 2.0 * low) * random.random(_ROWS)))
        for name, sigma in _SPREAD.items()
    }
    return MachineBatch.varied(base, _ROWS, columns)


@style()
def production(path: Path) -> None:
    """Histogram of the torque error, sensitivities of the torque, penalty over torque error."""
    design = catalogue.load("paper000-ipmsm-100kw")
    assert isinstance(design.machine, LinearMachine)
    machines = _drawn(design.machine)
    names = (TORQUE_ERROR, TORQUE_MADE, LOSS_PENALTY)
    found = yield_outputs(nominal_header(design), machines, names)
    inputs = np.column_stack([getattr(machines, name) for name in _SPREAD])
    error, penalty = 100.0 * found[TORQUE_ERROR], 100.0 * found[LOSS_PENALTY]
    figure = new_figure(
        "explore-statistics",
        2.6,
        "Spread and sensitivities of a production",
        arranged=True,
    )
    left, middle, right = figure.subplots(1, 3)
    edges, counts = empty_histogram().plus(error).coarser(40)
    left.stairs(counts, edges, fill=True, color=BLUE)
    left.axvline(5.0, color=ORANGE, linewidth=1.2)
    left.set_xlabel("Torque error in % of full scale")
    left.set_ylabel("Machines")
    bins = binned_output(inputs, found[TORQUE_MADE]).plus(inputs, found[TORQUE_MADE])
    first = sensitivities(TORQUE_MADE, tuple(_SPREAD), bins).first
    middle.barh(_SYMBOLS, np.maximum(first, 0.0), color=TEAL)
    middle.set_xlabel("Sensitivity of the torque")
    good = (error <= 5.0) & (penalty <= 0.3)
    few = slice(0, 800)
    for mask, colour in ((good, BLUE), (~good, ORANGE)):
        here = mask[few]
        right.plot(error[few][here], penalty[few][here], ".", markersize=2.0, color=colour)
    right.set_xlabel("Torque error in %")
    right.set_ylabel("Loss penalty in %")
    right.set_ylim(0.0, 1.5)
    save(figure, path)
