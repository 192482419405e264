"""What is proven of observers in integers holds what runs reach, and faults are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fixed_drives import fitted

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.fixed_observers.fixed_observer_fit import FIXED_METHODS, observer_reaches
from dqforge.optimizer.fixed_observers.kit import TOP
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range
from dqforge.reports.fixed_observers.fixed_observer_header import row_inputs, row_results

EVERY = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name == "ekf" else [])
        for name in FIXED_METHODS
    ],
)


@pytest.mark.thinned
@EVERY
def test_no_run_leaves_the_proven_ranges(name: str) -> None:
    """Random states and inputs, ends of every word, and drives that turn."""
    for width in (16, 32):
        fit = fitted(name, width)
        seen: dict[str, tuple[int, int]] = {}
        row_results(fit.observer, row_inputs(fit.observer, 6000, 5), Integers(seen))
        proven: dict[str, Range] = {}
        for reach in fit.reaches:
            own = reach.name.split(": ", 1)[1]
            proven[own] = reach.range.hull(proven.get(own, reach.range))
        assert len(seen) > 20
        for quantity, (low, high) in seen.items():
            held = proven[quantity]
            assert min(held.low, 0) <= low, quantity  # what was seen always counts zero
            assert high <= max(held.high, 0), quantity


@EVERY
def test_every_quantity_fits_its_word(name: str) -> None:
    for width in (16, 32):
        fit = fitted(name, width)
        assert all(reach.fits for reach in fit.reaches)
        assert {reach.bits for reach in fit.reaches} <= {32, 64}
        assert fit.fullest.share <= 1.0


def test_a_gain_too_large_is_refused_by_name() -> None:
    observer = fitted("flux", 16).observer
    path = observer.gains.path
    broken = replace(observer.gains, path=replace(path, l_q=FixedGain(2**32, 0, 2.0**32)))
    with pytest.raises(NoSolutionError, match=r"fixed point: 'step: .*int64_t ends at"):
        observer_reaches(observer.method, broken, 16)


def test_a_state_that_its_step_leaves_is_refused() -> None:
    """The proof over any past needs ranges that the step does not leave."""
    observer = fitted("flux", 16).observer
    narrow = (Range(-TOP // 2, TOP // 2), *(Range(-TOP - 1, TOP),) * 3)
    method = replace(observer.method, limits=lambda _: narrow)
    with pytest.raises(NoSolutionError, match=r"'psi.alpha' of the observer can reach"):
        observer_reaches(method, observer.gains, 16)


def test_a_floor_of_nothing_is_no_proof() -> None:
    observer = fitted("flux", 16).observer
    with pytest.raises(ZeroDivisionError):
        observer_reaches(observer.method, replace(observer.gains, floor=0), 16)


@pytest.mark.slow
def test_the_covariance_begins_anew_where_it_is_none() -> None:
    """A negative variance in the state: the filter starts again at the angle foretold."""
    fit = fitted("ekf", 16)
    rows = row_inputs(fit.observer, 400, 1)[:200]
    rows = rows[rows[:, 0] == 1]
    names = ["started", "theta", "omega", *(w.name for w in fit.observer.method.words)]
    rows[:, names.index("p[7]")] = -(2**52)
    after = row_results(fit.observer, rows)
    out = ["theta", "omega", *(w.name for w in fit.observer.method.words)]
    assert np.all(after[:, out.index("p[7]")] == fit.observer.gains.p_omega)
    assert np.all(after[:, out.index("omega")] == rows[:, names.index("omega")])
