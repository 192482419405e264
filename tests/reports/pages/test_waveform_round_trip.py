"""The data of the figures of waveforms are those of the results."""

from __future__ import annotations

import numpy as np
from figure_pages import Table, table_of
from matplotlib.figure import Figure

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.optimizer.waveforms.comparison import compare_waveforms
from dqforge.reports.pages.figure_sheet import read_figure
from dqforge.reports.waveforms.figures import plot_waveforms

PHASES = ("a", "b", "c")
RULES = {"dq": "dq", "dqx": "dqx", "dqy": "dqy", "limited": "within all limits"}


def read(figure: Figure) -> Table:
    return table_of(read_figure(figure).csv())


def taken(table: Table, head: str, values: FloatArray) -> None:
    """A column that holds the values, to five digits of the largest; it is taken off the table."""
    cells = table.pop(head)
    found = np.array([float(cell) if cell else np.nan for cell in cells])
    atol = 1e-5 * float(np.nanmax(np.abs(values)))
    np.testing.assert_allclose(found, values, rtol=0.0, atol=atol, err_msg=head)


def closed(values: FloatArray) -> FloatArray:
    """With the first value repeated at the end of the period."""
    return np.append(values, values[0])


def test_currents_torque_and_harmonics_of_every_rule() -> None:
    design = catalogue.load("paper002-phase-waveforms")
    assert design.waveform is not None
    compared = compare_waveforms(design, design.waveform)
    table = read(plot_waveforms(compared))
    angle = np.linspace(0.0, 360.0, compared.machine.flux.shape[1] + 1)
    taken(table, "Angle [deg]", angle)
    taken(table, "Electrical angle [deg]", angle)
    for phase, values in zip(PHASES, compared.machine.flux, strict=True):
        taken(table, f"e / omega_e: {phase} [mWb]", closed(1e3 * values))
    floor = 1e-3 * max(float(np.max(found.harmonics[0])) for found in compared.rules)
    orders = np.arange(1, 14)
    taken(table, "Order [1]", orders.astype(float))
    for found in compared.rules:
        name = RULES[found.rule]
        for phase, values in zip(PHASES, found.currents, strict=True):
            taken(table, f"{name}, Current: {phase} [A]", closed(values))
        if f"{name}, Current: neutral [A]" in table:
            neutral = closed(np.sum(found.currents, axis=0))
            taken(table, f"{name}, Current: neutral [A]", neutral)
        else:
            assert np.max(np.abs(np.sum(found.currents, axis=0))) < 1e-5
        taken(table, f"Torque: {name} [N m]", closed(found.torque))
        drawn = np.where(found.harmonics[0] > floor, found.harmonics[0], np.nan)[orders]
        last = int(np.flatnonzero(~np.isnan(drawn))[-1])
        taken(table, f"Harmonics of phase a: {name} [A]", drawn[: last + 1])
    assert not table
