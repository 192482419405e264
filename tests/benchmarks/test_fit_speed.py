"""Time of fits and of budgets against the search of breakpoints by DIRECT-L and Nelder-Mead,
in one run.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from drives import IPM, RELUCTANCE
from saturated import ArctanMachine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitBudget, FitSettings
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.current_reference.fit import alternatives, fit_reference
from dqforge.optimizer.current_reference.solve import choose_fit
from dqforge.optimizer.curves.breakpoints import level_edges, search
from dqforge.optimizer.curves.fitting import Curve, SideConditions, fit_curve, largest_error
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

pytestmark = pytest.mark.benchmark

TIED = SideConditions(exact_at_zero=True, continuous=True)
MACHINES: dict[str, Machine] = {"ipm": IPM, "reluctance": RELUCTANCE, "saturated": ArctanMachine()}


def seconds(call: Callable[[], object], repetitions: int = 3) -> float:
    """Shortest of some runs."""
    taken = []
    for _ in range(repetitions):
        start = time.perf_counter()
        call()
        taken.append(time.perf_counter() - start)
    return min(taken)


def searched(curves: list[Curve], degree: int, segments: int, end: float) -> FloatArray:
    """Breakpoints as they were found before: interpolation ranks for DIRECT-L,
    programmes for Nelder-Mead.
    """

    def coarse(edges: FloatArray) -> float:
        return max(
            largest_error(curve, fit_curve(curve, edges, degree, "lagrange", TIED))
            for curve in curves
        )

    def fine(edges: FloatArray) -> float:
        fits = [
            fit_curve(curve, edges, degree, "minimax", TIED, exchange=False) for curve in curves
        ]
        return max(largest_error(curve, fit) for curve, fit in zip(curves, fits, strict=True))

    return search(coarse, fine, segments, end)


def test_breakpoints_against_the_search() -> None:
    for name, machine in MACHINES.items():
        choice = CurrentChoice(machine, "mtpa", machine.i_max)
        end = choice.largest_torque()
        curves = list(choice.curves(end).values())
        for degree, segments in ((2, 2), (4, 2), (3, 3), (6, 4)):
            ways: dict[str, Callable[[], FloatArray]] = {
                "search": lambda d=degree, s=segments, c=curves, e=end: searched(c, d, s, e),  # type: ignore[misc]
                "level": lambda d=degree, s=segments, c=curves, e=end: level_edges(
                    c, d, s, TIED, e
                ),  # type: ignore[misc]
            }
            errors, taken = {}, {}
            for way, call in ways.items():
                start = time.perf_counter()
                edges = call()
                taken[way] = time.perf_counter() - start
                errors[way] = max(
                    largest_error(c, fit_curve(c, edges, degree, "minimax", TIED)) for c in curves
                )
            before, after = taken["search"], taken["level"]
            print(
                "\n"
                f"{name}, degree {degree}, {segments} segments: {1e3 * before:,.0f} ms -> "
                f"{1e3 * after:,.0f} ms, ratio {before / after:.0f}; error "
                f"{errors['level'] / errors['search']:.4f} of what it was",
                end="",
            )


def test_fit_with_its_alternatives() -> None:
    for name, machine in MACHINES.items():
        choice = CurrentChoice(machine, "mtpa", machine.i_max)
        for degree, segments in ((4, 2), (6, 4)):
            settings = FitSettings(form="polynomial", degree=degree, segments=segments)
            fit = fit_reference(choice, settings)
            alone = seconds(lambda c=choice, s=settings: fit_reference(c, s))  # type: ignore[misc]
            table = seconds(lambda c=choice, f=fit: alternatives(c, f))  # type: ignore[misc]
            print(
                "\n"
                f"{name}, degree {degree}, {segments} segments: fit {alone:.3f} s, alternatives "
                f"{table:.3f} s",
                end="",
            )


def test_budgets() -> None:
    for name, machine in MACHINES.items():
        choice = CurrentChoice(machine, "mtpa", machine.i_max)
        for torque_error in (1e-3, 1e-5, 1e-8):
            start = time.perf_counter()
            try:
                found = choose_fit(choice, FitSettings(), FitBudget(torque_error=torque_error))
                tried = f"{len(found.trials)} tried"
            except NoSolutionError:
                tried = "none keeps it"
            print(
                "\n"
                f"{name}, torque error {torque_error:g}: {time.perf_counter() - start:.2f} s, "
                f"{tried}",
                end="",
            )
