"""Breakpoints of interpolation and least squares: never above what dynamic programming finds."""

from __future__ import annotations

import pytest
from drives import IPM, RELUCTANCE

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import FitMethod
from dqforge.optimizer.current_reference.fit import find_edges
from dqforge.optimizer.curves.breakpoints import rounded_edges, segment_errors
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve, squared_error_integral
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

SIDE = SideConditions(exact_at_zero=True, continuous=True)


@pytest.mark.parametrize("method", ["lagrange", "least-squares"])
@pytest.mark.parametrize("machine", [IPM, RELUCTANCE], ids=["magnet", "reluctance"])
def test_no_worse_than_dynamic_programming(machine: LinearMachine, method: FitMethod) -> None:
    """Without a magnet the local search alone left 13 times its error: it keeps segments of one per
    cent of the domain, and the best ones near zero are narrower.
    """
    choice = CurrentChoice(machine, "mtpa", machine.i_max)
    end = choice.largest_torque()
    curve = choice.curves(end)["d"]
    settings = FitSettings(form="polynomial", method=method, degree=4, segments=4)

    def cost(edges: FloatArray) -> float:
        return squared_error_integral(curve, fit_curve(curve, edges, 4, method, SIDE))

    best = rounded_edges(segment_errors([curve], 4, SIDE, end).best_edges(4, squared=True))
    found = find_edges({"d": curve}, settings, end)["d"]
    assert cost(found) <= cost(best)
