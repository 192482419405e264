"""Breakpoints against the best there are, found by other means: greedy covering with Remez,
a sweep, and evolution.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from drives import IPM, RELUCTANCE
from numpy.polynomial import chebyshev
from saturated import ArctanMachine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, largest_torque
from dqforge.machines.names import FitForm, FitMethod
from dqforge.optimizer.current_reference.fit import find_edges, fit_reference
from dqforge.optimizer.curves.breakpoints import (
    _beside,
    _other_starts,
    level_edges,
    round_significant,
    search,
    segment_errors,
)
from dqforge.optimizer.curves.fitting import (
    Curve,
    SideConditions,
    fit_curve,
    largest_error,
    squared_error_integral,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

DEGREES = (2, 3, 4, 5, 6)


def test_starts_beside_a_segmentation_keep_its_ends_and_rise() -> None:
    edges = np.array([0.0, 40.0, 90.0, 250.0])
    for starts in (_beside(edges), _other_starts(edges)):
        assert len(starts) > 3
        for start in starts:
            assert start[[0, -1]] == pytest.approx([0.0, 250.0], rel=1e-12)
            assert np.all(np.diff(start) > 0.0)
            assert not np.allclose(start, edges)
    wider = [np.diff(start) / np.diff(edges) for start in _other_starts(edges)]
    shares = [float(np.max(widths) / np.min(widths)) for widths in wider]
    assert 2.0 < max(shares) < np.exp(1.6)


def random_machine(generator: np.random.Generator) -> LinearMachine:
    """Any salient machine whose current limit lies at 0.5 to 3 of the MTPA curve's own scale."""
    psi_pm, l_d = 10 ** generator.uniform(-2.0, 0.0), 10 ** generator.uniform(-4.0, -2.0)
    ratio = generator.uniform(1.2, 6.0)
    i_max = generator.uniform(0.5, 3.0) * psi_pm / (l_d * (ratio - 1.0))
    return LinearMachine(3, 0.1, l_d, l_d * ratio, psi_pm, i_max)


def twenty_machines() -> list[LinearMachine]:
    generator = np.random.default_rng(11)
    return [random_machine(generator) for _ in range(20)]


def curves_of(machine: Machine, i_max: float) -> tuple[dict[str, Curve], float]:
    choice = CurrentChoice(machine, "mtpa", i_max)
    end = choice.largest_torque()
    return choice.curves(end), end


def library(name: str) -> tuple[dict[str, Curve], float]:
    design = catalogue.load(name)
    assert not isinstance(design.machine, LinearMachine)
    return curves_of(design.machine, design.machine.i_max)


def found(
    curves: dict[str, Curve], end: float, degree: int, segments: int, side: SideConditions
) -> float:
    """Largest error of the minimax fits of both axes on the breakpoints that the package picks."""
    settings = FitSettings(
        form="polynomial",
        degree=degree,
        segments=segments,
        exact_at_zero=side.exact_at_zero,
        continuous=side.continuous,
    )
    edges = find_edges(curves, settings, end)
    return max(
        largest_error(curve, fit_curve(curve, edges[axis], degree, "minimax", side))
        for axis, curve in curves.items()
    )


def levelled_error(curve: Curve, start: float, end: float, degree: int, *, at_zero: bool) -> float:
    """Lower bound of the minimax error on one segment by Remez' second algorithm.

    The error itself where it converges.

    With ``at_zero`` the polynomial vanishes at the start; what is left of the basis
    satisfies Haar's condition beyond.
    """
    nodes = -np.cos(np.linspace(0.0, np.pi, 24 * (degree + 2) + 1))
    values = curve(start + 0.5 * (end - start) * (nodes + 1.0))
    basis = chebyshev.chebvander(nodes, degree)
    if at_zero:
        basis = basis[:, 1:] - basis[0, 1:]
    skipped, count = int(at_zero), basis.shape[1] + 1
    points = np.linspace(0, nodes.size - 1, count + skipped).round().astype(int)[skipped:]
    level = 0.0
    for _ in range(30):
        system = np.column_stack([basis[points], (-1.0) ** np.arange(count)])
        solution = np.linalg.solve(system, values[points])
        error = values - basis @ solution[:-1]
        level = abs(float(solution[-1]))
        if np.max(np.abs(error)) <= 1.0005 * level:
            break
        changes = np.flatnonzero(error[1:] * error[:-1] < 0.0) + 1
        peaks = [
            run[np.argmax(np.abs(error[run]))] for run in np.split(np.arange(nodes.size), changes)
        ]
        while len(peaks) > count:
            peaks.pop(0 if abs(error[peaks[0]]) < abs(error[peaks[-1]]) else -1)
        if len(peaks) < count or list(peaks) == list(points):
            break
        points = np.array(peaks)
    return level


def level_is_out_of_reach(
    curves: Sequence[Curve], end: float, degree: int, segments: int, level: float, *, at_zero: bool
) -> bool:
    """Whether no segmentation at all has fits with errors up to ``level``, continuity apart.

    The error of a segment rises with its length, so the longest first segment, then the longest
    second one and so on cover the most that any segmentation covers. Without continuity this is
    exact; with it, still a bound.
    """
    from scipy.optimize import brentq

    start = 0.0
    for segment in range(segments):

        def excess(
            stop: float, start: float = start, at_zero: bool = at_zero and segment == 0
        ) -> float:
            error = max(
                levelled_error(curve, start, stop, degree, at_zero=at_zero) for curve in curves
            )
            return float(np.log(max(error / level, 1e-6)))

        shortest = start + 1e-9 * end
        if excess(end) <= 0.0:
            return False
        if excess(shortest) > 0.0:
            return True
        # In the logarithm of the width, in which the error is nearly a power.
        width = brentq(
            lambda w, start=start, excess=excess: excess(start + np.exp(w)),
            np.log(shortest - start),
            np.log(end - start),
            xtol=1e-6,
        )
        start += float(np.exp(width))
    return True


@pytest.mark.thinned
@pytest.mark.parametrize("segments", [2, 3, 4])
@pytest.mark.parametrize("degree", [2, 5])
@pytest.mark.parametrize(
    "machine", [IPM, RELUCTANCE, ArctanMachine()], ids=["ipm", "reluctance", "saturated"]
)
def test_no_segmentation_is_one_percent_better_without_side_conditions(
    machine: Machine, degree: int, segments: int
) -> None:
    curves, end = curves_of(machine, machine.i_max)
    level = (
        found(curves, end, degree, segments, SideConditions(exact_at_zero=False, continuous=False))
        / 1.01
    )
    assert level_is_out_of_reach(list(curves.values()), end, degree, segments, level, at_zero=False)


@pytest.mark.slow
def test_the_bound_is_sharp() -> None:
    """One percent above the error that is reached, greedy covering reaches the end:
    the tests above can fail.
    """
    curves, end = curves_of(IPM, IPM.i_max)
    for degree in DEGREES:
        level = (
            found(curves, end, degree, 3, SideConditions(exact_at_zero=False, continuous=False))
            * 1.01
        )
        assert not level_is_out_of_reach(
            list(curves.values()), end, degree, 3, level, at_zero=False
        )


@pytest.mark.slow
@pytest.mark.parametrize("segments", [2, 3, 4])
@pytest.mark.parametrize("degree", DEGREES)
def test_no_segmentation_of_any_of_20_machines_is_one_percent_better(
    degree: int, segments: int
) -> None:
    cases = [curves_of(machine, machine.i_max) for machine in twenty_machines()]
    cases.append(library("abb-syrm-6k7-saturated"))
    # beyond, the errors come down to the noise of this machine's curves,
    # where Remez does not converge
    if degree < 5:
        cases.append(library("baldor-pmsyrm-5k6"))
    for curves, end in cases:
        level = (
            found(
                curves, end, degree, segments, SideConditions(exact_at_zero=False, continuous=False)
            )
            / 1.01
        )
        assert level_is_out_of_reach(
            list(curves.values()), end, degree, segments, level, at_zero=False
        )


class LowerBound:
    """Least largest error of joined fits that vanish at zero, over points of each segment,
    by one plain programme.
    """

    def __init__(self, degree: int, segments: int, count: int) -> None:
        self.nodes = -np.cos(np.linspace(0.0, np.pi, count))
        self.vander = chebyshev.chebvander(self.nodes, degree)
        size, width = segments * (degree + 1), degree + 1
        basis = np.kron(np.eye(segments), self.vander)
        ones = np.ones((basis.shape[0], 1))
        self.rows = np.vstack([np.hstack([basis, -ones]), np.hstack([-basis, -ones])])
        self.ties = np.zeros((segments, size + 1))
        self.ties[0, :width] = self.vander[0]
        for seam in range(1, segments):
            self.ties[seam, (seam - 1) * width : seam * width] = self.vander[-1]
            self.ties[seam, seam * width : (seam + 1) * width] = -self.vander[0]
        self.objective = np.zeros(size + 1)
        self.objective[-1] = 1.0

    def __call__(self, curves: Sequence[Curve], edges: FloatArray) -> float:
        from scipy.optimize import linprog

        width = np.diff(edges)[:, np.newaxis]
        points = edges[:-1, np.newaxis] + 0.5 * width * (self.nodes + 1.0)
        worst = 0.0
        for curve in curves:
            values = curve(points)
            series = np.linalg.lstsq(self.vander, values.T, rcond=None)[0]
            scale = max(
                float(np.max(np.abs(values - (self.vander @ series).T))),
                1e-12 * float(np.max(np.abs(values))),
            )
            target = values.ravel() / scale
            outcome = linprog(
                self.objective,
                A_ub=self.rows,
                b_ub=np.concatenate([target, -target]),
                A_eq=self.ties,
                b_eq=np.zeros(self.ties.shape[0]),
                bounds=(None, None),
                method="highs-ds",
                options={"presolve": False},
            )
            assert outcome.status == 0
            worst = max(worst, scale * float(outcome.x[-1]))
        return worst


def sweep(curves: Sequence[Curve], end: float, degree: int, positions: int, level: float) -> float:
    """Least error of all of some positions of one breakpoint, of those that can
    go below ``level`` at all.
    """
    bound = LowerBound(degree, 2, 8 * degree + 17)
    best = np.inf
    for seam in end * np.arange(1, positions) / positions:
        first = max(levelled_error(curve, 0.0, seam, degree, at_zero=True) for curve in curves)
        second = max(levelled_error(curve, seam, end, degree, at_zero=False) for curve in curves)
        if max(first, second) < level:
            best = min(best, bound(curves, np.array([0.0, seam, end])))
    return best


def default_is_best_of_one_breakpoint(machine: Machine, degree: int) -> None:
    curves, end = curves_of(machine, machine.i_max)
    reached = found(curves, end, degree, 2, SideConditions(exact_at_zero=True, continuous=True))
    assert reached <= 1.01 * sweep(list(curves.values()), end, degree, 400, reached / 1.01)


@pytest.mark.parametrize("degree", [2, 3])
def test_default_is_within_one_percent_of_400_positions(degree: int) -> None:
    default_is_best_of_one_breakpoint(ArctanMachine(), degree)


def extremes() -> list[LinearMachine]:
    """Of the 20 machines those with the shortest and the longest curve in per unit,
    which is all they differ in.
    """
    machines = twenty_machines()
    machines.sort(key=lambda machine: machine.i_max * machine.saliency / machine.psi_pm)
    return [machines[0], machines[-1]]


@pytest.mark.slow
@pytest.mark.parametrize("degree", DEGREES)
def test_defaults_of_all_machines_are_within_one_percent_of_a_sweep(degree: int) -> None:
    machines: list[Machine] = [*extremes(), IPM, RELUCTANCE, ArctanMachine()]
    for machine in machines:
        default_is_best_of_one_breakpoint(machine, degree)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [3, 4])
@pytest.mark.parametrize("degree", [2, 5])
@pytest.mark.parametrize("machine", [extremes()[1], ArctanMachine()], ids=["linear", "saturated"])
def test_defaults_are_within_one_percent_of_evolution(
    machine: Machine, degree: int, segments: int
) -> None:
    """Differential evolution over the breakpoints, seeded.

    Candidates that the bound excludes cost no programme.
    """
    from scipy.optimize import differential_evolution

    curves, end = curves_of(machine, machine.i_max)
    reached = found(
        curves, end, degree, segments, SideConditions(exact_at_zero=True, continuous=True)
    )
    bound = LowerBound(degree, segments, 5 * degree + 9)

    def cost(position: FloatArray) -> float:
        edges = np.array([0.0, *(end * np.sort(position)), end])
        if np.min(np.diff(edges)) < 1e-3 * end:
            return 1.0
        return bound(list(curves.values()), edges) / reached

    outcome = differential_evolution(
        cost,
        [(0.0, 1.0)] * (segments - 1),
        maxiter=16,
        popsize=6,
        polish=False,
        rng=np.random.default_rng(5),
    )
    best = np.array([0.0, *(end * np.sort(outcome.x)), end])
    assert reached <= 1.01 * LowerBound(degree, segments, 401)(list(curves.values()), best)


def test_dynamic_programming_is_exact_on_the_grid() -> None:
    curves, end = curves_of(IPM, IPM.i_max)
    errors = segment_errors(
        list(curves.values()), 2, SideConditions(exact_at_zero=True, continuous=True), end
    )
    for table, squared, join in (
        (errors.largest, False, np.maximum),
        (errors.squared, True, np.add),
    ):
        edges = errors.best_edges(3, squared=squared)
        first, second = np.searchsorted(errors.grid, edges[1:-1])
        reached = join(join(table[0, first], table[first, second]), table[second, -1])
        assert reached == np.min(join(join(table[0][:, np.newaxis], table), table[:, -1]))


def test_segment_errors_are_near_remez() -> None:
    curves, end = curves_of(IPM, IPM.i_max)
    errors = segment_errors(
        list(curves.values()), 3, SideConditions(exact_at_zero=True, continuous=False), end
    )
    last = errors.grid.size - 1
    for first in (0, last // 2, last - 3):
        best = max(
            levelled_error(curve, errors.grid[first], end, 3, at_zero=first == 0)
            for curve in curves.values()
        )
        assert 0.99 * best <= errors.largest[first, last] <= 1.5 * best


def test_edges_are_even_where_there_is_nothing_to_divide() -> None:
    def line(torque: FloatArray) -> FloatArray:
        return 3.0 * torque

    side = SideConditions(exact_at_zero=True, continuous=True)
    np.testing.assert_allclose(level_edges([line], 2, 4, side, 8.0), [0.0, 2.0, 4.0, 6.0, 8.0])


def test_level_edges_are_repeatable_and_rounded() -> None:
    curves, end = curves_of(ArctanMachine(), 120.0)
    side = SideConditions(exact_at_zero=True, continuous=True)
    first, second = (level_edges(list(curves.values()), 3, 3, side, end) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first[1:-1], [round_significant(edge) for edge in first[1:-1]])


def test_a_start_spares_the_global_search() -> None:
    def cost(edges: FloatArray) -> float:
        return float((edges[1] - 1.0) ** 2 + (edges[2] - 3.0) ** 2)

    def never(edges: FloatArray) -> float:
        raise AssertionError

    found_edges = search(never, cost, 3, 5.0, np.array([0.0, 1.4, 2.5, 5.0]))
    np.testing.assert_allclose(found_edges, [0.0, 1.0, 3.0, 5.0], atol=5e-3)


@pytest.mark.slow
def test_coefficients_of_a_tiny_machine_stay_floats() -> None:
    """Without a magnet the best first segment is 1e-4 of the domain.

    To the power of -6 that is no float any more.
    """
    tiny = LinearMachine(1, 10.0, 1e-3, 3e-3, 0.0, 0.2)
    choice = CurrentChoice(tiny, "mtpa", 0.2)
    fit = fit_reference(choice, FitSettings(form="polynomial", degree=6, segments=4))
    assert fit.torque_max < 1e-4
    assert fit.q is not None
    assert np.max(np.abs(fit.q.coefficients)) < float(np.finfo(np.float32).max)
    assert fit.errors.i_q < 0.02 * 0.2


# Axes that the forms fit, written out here once more.
FORM_AXES: dict[FitForm, tuple[str, ...]] = {
    "polynomial": ("d", "q"),
    "torque-exact": ("d",),
    "closed-form": ("q",),
}


def machine_up_to(ratio: float) -> LinearMachine:
    """Salient machine whose largest torque is a multiple of its base torque 3/4 p psi i_b,
    i_b = psi/(2 (L_q - L_d)).

    In per unit all machines have one curve, so that this ratio is all in which they differ.
    """
    from scipy.optimize import brentq

    pole_pairs, psi_pm, l_d, l_q = 3, 0.1, 1e-3, 3e-3
    base = 0.75 * pole_pairs * psi_pm * psi_pm / (2.0 * (l_q - l_d))

    def excess(i_max: float) -> float:
        return largest_torque(pole_pairs, psi_pm, l_q - l_d, i_max) / base - ratio

    return LinearMachine(
        pole_pairs, 0.1, l_d, l_q, psi_pm, float(brentq(excess, 1e-6, 1e6, xtol=1e-12))
    )


def fitted_error(
    curves: Sequence[Curve], edges: FloatArray, degree: int, method: FitMethod
) -> float:
    """What the breakpoints are chosen by: the largest error of minimax fits,
    the summed squares of the others.
    """
    side = SideConditions(exact_at_zero=True, continuous=True)
    fits = [fit_curve(curve, edges, degree, method, side, exchange=False) for curve in curves]
    if method == "minimax":
        return max(largest_error(curve, fit) for curve, fit in zip(curves, fits, strict=True))
    return float(
        sum(squared_error_integral(curve, fit) for curve, fit in zip(curves, fits, strict=True))
        ** 0.5
    )


def breakpoints_are_best(
    ratio: float, form: FitForm, degree: int, method: FitMethod, positions: int
) -> None:
    """One breakpoint against all positions of a dense sweep.

    Errors below 1e-9 of the curve are noise to a float.
    """
    machine = machine_up_to(ratio)
    every, end = curves_of(machine, machine.i_max)
    chosen = {axis: every[axis] for axis in FORM_AXES[form]}
    curves = list(chosen.values())
    settings = FitSettings(form=form, degree=degree, segments=2, method=method)
    edges = find_edges(chosen, settings, end)[FORM_AXES[form][0]]
    reached = fitted_error(curves, edges, degree, method)
    seams = end * np.arange(1, positions) / positions
    swept = min(fitted_error(curves, np.array([0.0, seam, end]), degree, method) for seam in seams)
    size = max(float(np.max(np.abs(curve(np.array([end]))))) for curve in curves)
    assert reached <= 1.01 * swept + 1e-9 * size * (1.0 if method == "minimax" else end**0.5)


# Largest over base torque, form and degree; the first eight have two segmentations with a worse one
# between them.
HARD: list[tuple[float, FitForm, int]] = [
    (7.24, "torque-exact", 4),
    (6.5, "torque-exact", 4),
    (9.0, "torque-exact", 4),
    (8.85, "torque-exact", 4),
    (9.43, "torque-exact", 4),
    (2.2, "torque-exact", 3),
    (0.76, "closed-form", 4),
    (1.7472, "closed-form", 4),
    (30.0, "torque-exact", 2),
    (30.0, "polynomial", 6),
    (0.05, "polynomial", 4),
]


@pytest.mark.thinned
@pytest.mark.parametrize(("ratio", "form", "degree"), HARD)
def test_breakpoint_is_best_where_several_are_level(
    ratio: float, form: FitForm, degree: int
) -> None:
    breakpoints_are_best(ratio, form, degree, "minimax", 40)


def test_a_low_place_is_left_for_a_lower_one_that_it_hides() -> None:
    """From its one start the levelling ends 5 % above the best."""
    machine = machine_up_to(8.78)
    curves, end = curves_of(machine, machine.i_max)
    side = SideConditions(exact_at_zero=True, continuous=True)
    seam = level_edges([curves["d"]], 4, 2, side, end)[1]
    assert seam / end == pytest.approx(0.268, abs=0.002)
    breakpoints_are_best(8.78, "torque-exact", 4, "minimax", 30)


@pytest.mark.parametrize("method", ["least-squares", "lagrange"])
@pytest.mark.parametrize(("ratio", "form", "degree"), [HARD[0], HARD[6]])
def test_breakpoint_of_other_methods_is_best(
    ratio: float, form: FitForm, degree: int, method: FitMethod
) -> None:
    breakpoints_are_best(ratio, form, degree, method, 80)


@pytest.mark.slow
@pytest.mark.parametrize("degree", [1, *DEGREES])
@pytest.mark.parametrize("form", FORM_AXES)
def test_breakpoint_is_best_from_tiny_to_huge_torques(form: FitForm, degree: int) -> None:
    for ratio in np.geomspace(0.05, 30.0, 6).tolist():
        breakpoints_are_best(ratio, form, degree, "minimax", 50)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["least-squares", "lagrange"])
@pytest.mark.parametrize("form", FORM_AXES)
def test_breakpoint_of_other_methods_is_best_from_tiny_to_huge_torques(
    form: FitForm, method: FitMethod
) -> None:
    for ratio in (0.05, 1.2246, 7.24, 30.0):
        for degree in DEGREES:
            breakpoints_are_best(ratio, form, degree, method, 80)


TORQUES = (0.05, 0.5, 1.2246, 3.5568, 7.24, 10.33, 21.03, 30.0)

# Breakpoints over the domain's end where others ended before; the method below begins there.
VALLEYS: dict[FitForm, tuple[float, float]] = {
    "torque-exact": (0.0837, 0.331),
    "closed-form": (0.2263, 0.4607),
}


def breakpoints_are_best_of_many(
    ratio: float, form: FitForm, degree: int, segments: int, more: Sequence[tuple[float, ...]] = ()
) -> None:
    """More breakpoints against Nelder and Mead's method from segmentations all over the domain."""
    from scipy.optimize import minimize

    machine = machine_up_to(ratio)
    every, end = curves_of(machine, machine.i_max)
    chosen = {axis: every[axis] for axis in FORM_AXES[form]}
    curves = list(chosen.values())
    edges = find_edges(chosen, FitSettings(form=form, degree=degree, segments=segments), end)[
        FORM_AXES[form][0]
    ]
    reached = fitted_error(curves, edges, degree, "minimax")

    def cost(position: FloatArray) -> float:
        tried = np.array([0.0, *(end * np.sort(position)), end])
        if np.min(np.diff(tried)) < 1e-3 * end:
            return 10.0
        return fitted_error(curves, tried, degree, "minimax") / reached

    generator = np.random.default_rng([segments, degree])
    starts = [
        edges[1:-1] / end * np.exp(0.3 * generator.normal(size=segments - 1)) for _ in range(2)
    ]
    starts += [np.array(start) for start in more]
    ends = [
        minimize(cost, np.clip(start, 0.01, 0.98), method="Nelder-Mead", options={"maxfev": 60})
        for start in starts
    ]
    size = max(float(np.max(np.abs(curve(np.array([end]))))) for curve in curves)
    assert reached <= 1.01 * reached * min(found.fun for found in ends) + 1e-9 * size


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "form"), [(30.0, "torque-exact"), (3.5568, "closed-form")])
def test_two_breakpoints_are_best_along_a_flat_valley(ratio: float, form: FitForm) -> None:
    """Degree 4: the best ends of the low places alone are 1.6 % worse."""
    breakpoints_are_best_of_many(ratio, form, 4, 3, [VALLEYS[form]])


@pytest.mark.slow
@pytest.mark.parametrize("segments", [3, 4])
@pytest.mark.parametrize("degree", [1, *DEGREES])
@pytest.mark.parametrize("form", FORM_AXES)
def test_breakpoints_are_best_from_tiny_to_huge_torques(
    form: FitForm, degree: int, segments: int
) -> None:
    """Of eight torques two for each form and number of segments, others for other degrees."""
    place = degree + 2 * segments + 3 * list(FORM_AXES).index(form)
    for ratio in (TORQUES[place % 8], TORQUES[(place + 4) % 8]):
        breakpoints_are_best_of_many(ratio, form, degree, segments)
