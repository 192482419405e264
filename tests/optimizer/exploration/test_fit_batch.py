"""References of columns against those of the single path, machine by machine."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from dataclasses import replace
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from batch_trials import linear_machines

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitBudget, FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import FitForm, FitMethod
from dqforge.optimizer.current_reference.fit import ReferenceFit, fit_reference
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial, SinglePolynomial
from dqforge.optimizer.exploration.batch_currents import (
    ReferenceBatch,
    fit_references,
    rounded_in_turn,
    why_not_in_batch,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

SALIENT = linear_machines(200, seed=11, all_kinds=False)
MIXED = linear_machines(40, seed=4)


def single(machine: LinearMachine, settings: FitSettings) -> ReferenceFit:
    return fit_reference(CurrentChoice(machine, "mtpa", machine.i_max), settings)


def bends(machine: LinearMachine, torque_max: float) -> float:
    """tau: the end of the domain in units of the base torque."""
    if machine.psi_pm == 0.0:
        return np.inf
    base = machine.psi_pm / (2.0 * abs(machine.saliency))
    return torque_max / (0.75 * machine.pole_pairs * machine.psi_pm * base)


def ratios(machines: list[LinearMachine], settings: FitSettings) -> FloatArray:
    """Largest error of the fitted currents over that of the single path, above tau = 0.3."""
    many = fit_references(MachineBatch.of(machines), settings).errors
    names = {"torque-exact": ("i_d",), "closed-form": ("i_q",)}.get(settings.form, ("i_d", "i_q"))
    found = []
    for row, machine in enumerate(machines):
        one = single(machine, settings)
        if machine.saliency != 0.0 and bends(machine, one.torque_max) > 0.3:
            worst = max(getattr(one.errors, name) for name in names)
            found.append(max(float(getattr(many, name)[row]) for name in names) / worst)
    return np.array(found)


@pytest.mark.slow
def test_errors_of_200_random_machines_are_those_of_the_single_path() -> None:
    found = ratios(SALIENT, FitSettings())
    assert found.size >= 180
    assert 0.99 < np.median(found) < 1.02
    assert np.percentile(found, 99) < 1.15
    assert np.max(found) < 1.25
    assert np.min(found) > 0.9


CASES: dict[str, dict[str, Any]] = {
    "torque-exact": {},
    "polynomial": {"form": "polynomial"},
    "own": {"form": "polynomial", "degree": 3, "breakpoint_mode": "own"},
    "even-odd": {"form": "even-odd"},
    "closed-form": {"form": "closed-form", "degree": 3},
    "line": {"degree": 1},
    "degree-5": {"degree": 5},
    "one-segment": {"segments": 1},
    "flat": {"flat_at_zero": True},
    "steps": {"continuous": False, "degree": 3},
    "free": {"exact_at_zero": False, "degree": 3},
    "least-squares": {"method": "least-squares", "degree": 3},
}


@pytest.mark.thinned
@pytest.mark.parametrize("name", list(CASES))
def test_every_form_errs_as_in_the_single_path(name: str) -> None:
    settings = FitSettings(**CASES[name])
    machines = [one for one in MIXED[:10] if one.psi_pm > 0.0 or settings.form == "polynomial"]
    found = ratios(machines, settings)
    assert found.size >= 5
    assert np.median(found) < 1.05
    assert np.max(found) < 1.25
    # Where floats round more than the fit errs, samples find part of the rounding.
    assert np.min(found) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("degree", range(1, 8))
@pytest.mark.parametrize("segments", [1, 2])
@pytest.mark.parametrize("form", ["torque-exact", "polynomial"])
def test_every_degree_errs_as_in_the_single_path(form: FitForm, segments: int, degree: int) -> None:
    settings = FitSettings(form=form, segments=segments, degree=degree)
    machines = SALIENT[:20]
    found = ratios(machines, settings)
    assert np.median(found) < 1.05
    # From degree 6 on the rounding of floats is as large as the error of many fits.
    assert np.max(found) < (1.25 if degree < 6 else 1.6)


@pytest.mark.thinned
@pytest.mark.parametrize("method", ["minimax", "least-squares"])
def test_domains_and_the_errors_of_torque_are_those_of_the_single_path(method: FitMethod) -> None:
    """A minimax fit of one axis leaves freedom where it does not bind, which the torque sees: the
    linear programme takes a corner of it, reweighting its middle.
    """
    machines = SALIENT[:5]
    settings = FitSettings(form="polynomial", degree=3, method=method)
    many = fit_references(MachineBatch.of(machines), settings)
    least = 0.98 if method == "least-squares" else 0.25
    for row, machine in enumerate(machines):
        one = single(machine, settings)
        assert many.torque_max[row] == pytest.approx(one.torque_max, rel=1e-12)
        most = 1.02 if method == "least-squares" else 2.0
        assert least < many.errors.torque[row] / one.errors.torque < most
        relative = many.errors.torque[row] / many.torque_max[row]
        assert many.errors.torque_relative[row] == pytest.approx(relative, rel=1e-6)


def test_polynomials_keep_their_side_conditions_and_their_errors() -> None:
    """The coefficients, evaluated by the single path's class, err by what is reported."""
    machines = SALIENT[:10]
    many = fit_references(MachineBatch.of(machines), FitSettings())
    for row, machine in enumerate(machines):
        fit = many.piecewise("d", row)
        torque = np.linspace(0.0, many.torque_max[row], 4001)
        exact = CurrentChoice(machine, "mtpa", machine.i_max).currents(torque)[0]
        assert fit.coefficients[0, 0] == 0.0
        assert abs(fit.jumps()[0]) < 1e-12 * machine.i_max
        error = float(np.max(np.abs(fit(torque) - exact)))
        assert many.errors.i_d[row] == pytest.approx(error, rel=0.05, abs=3e-7 * machine.i_max)


def test_given_breakpoints_and_ends_are_taken() -> None:
    machine = replace(SALIENT[0], i_max=SALIENT[0].i_max)
    end = CurrentChoice(machine, "mtpa", machine.i_max).largest_torque()
    batch = MachineBatch.varied(machine, 3, {"psi_pm": machine.psi_pm * np.array([1.0, 0.2, 1.1])})
    settings = FitSettings(torque_max=0.9 * end, breakpoints=(0.3 * end,))
    found = fit_references(batch, settings)
    assert found.solved.tolist() == [True, False, True]  # a weak magnet does not make that torque
    assert found.edges["d"][:, 0].tolist() == [0.0, 0.3 * end, 0.9 * end]
    assert np.all(np.isnan(found.coefficients["d"][..., 1]))
    assert np.isnan(found.torque_max[1])
    one = single(machine, settings)
    assert found.errors.i_d[0] == pytest.approx(one.errors.i_d, rel=0.1)
    beyond = fit_references(batch, replace(settings, breakpoints=(0.95 * end,)))
    assert not np.any(beyond.solved)


def test_exact_forms_err_by_rounding_alone() -> None:
    surface = LinearMachine(3, 1.0, 2e-3, 2e-3, 0.06, 12.8)
    reluctance = LinearMachine(2, 0.5, 5e-3, 40e-3, 0.0, 15.0)
    batch = MachineBatch.of([surface, reluctance, SALIENT[0]])
    for settings in (FitSettings(form="closed-form"), FitSettings()):
        found = fit_references(batch, settings)
        assert found.solved[0]
        assert found.solved[1] == (settings.form == "closed-form")
        for row, machine in enumerate((surface, reluctance)):
            if found.solved[row]:
                one = single(machine, settings).errors
                assert found.errors.i_q[row] < 2e-7 * machine.i_max
                assert found.errors.torque[row] == pytest.approx(one.torque, rel=0.6)
    at_zero = fit_references(batch.taken(np.array([0, 2])), FitSettings(), "id0")
    assert np.all(at_zero.errors.i_d == 0.0)
    assert np.all(at_zero.errors.i_q < 2e-7 * 400.0)


def everything(found: ReferenceBatch) -> bytes:
    parts = [found.torque_max, *found.edges.values(), *found.coefficients.values()]
    errors = found.errors
    parts += [errors.i_d, errors.i_q, errors.torque, errors.torque_relative]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


@pytest.mark.parametrize("name", ["torque-exact", "polynomial", "least-squares"])
def test_a_machine_has_the_same_bytes_in_any_batch(name: str) -> None:
    settings, batch = FitSettings(**CASES[name]), MachineBatch.of(SALIENT)
    batch = batch.taken(np.arange(1100) % 200)
    whole = fit_references(batch, settings)

    @cache
    def alone(row: int) -> bytes:
        return everything(fit_references(batch.taken(np.array([row])), settings))

    for row in (0, 3, 199, 511, 512, 1099):
        at = np.array([row])
        cut = ReferenceBatch(
            settings,
            whole.torque_max[at],
            {axis: part[..., at] for axis, part in whole.edges.items()},
            {axis: part[..., at] for axis, part in whole.coefficients.items()},
            type(whole.errors)(
                *(getattr(whole.errors, key)[at] for key in type(whole.errors).__slots__)
            ),
            whole.solved[at],
        )
        assert everything(cut) == alone(row)


PROGRAMME = """
import hashlib
import numpy as np
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial, SinglePolynomial
from dqforge.optimizer.exploration.batch_currents import fit_references
base = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 283.0)
scale = 1.0 + 0.3 * np.linspace(-1.0, 1.0, 37)
batch = MachineBatch.varied(base, 37, {"l_q": base.l_q * scale, "psi_pm": base.psi_pm / scale})
found = fit_references(batch, FitSettings(form="polynomial"))
parts = [found.coefficients["d"], found.coefficients["q"], found.errors.i_d, found.errors.torque]
print(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
"""


# What the tests run on, as the commands do; a process without them takes what its processor has.
KERNELS_OF_TESTS = ("OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES")


def later_instructions() -> list[str]:
    """Instruction sets that numpy takes beyond its least ones where a processor has them."""
    return list(import_module("numpy._core._multiarray_umath").__cpu_dispatch__)


@pytest.mark.slow
def test_another_processor_gives_the_same_bytes() -> None:
    """The instruction sets that numpy and its BLAS use are taken away one after the other."""
    taken, found = later_instructions(), set()
    assert taken or platform.machine() not in ("x86_64", "AMD64")
    own = {key: value for key, value in os.environ.items() if key not in KERNELS_OF_TESTS}
    for without in (
        {},
        {"OPENBLAS_CORETYPE": "Prescott"},
        {"NPY_DISABLE_CPU_FEATURES": " ".join(taken)},
    ):
        run = subprocess.run(
            [sys.executable, "-c", PROGRAMME],
            env=own | without,
            capture_output=True,
            text=True,
            check=True,
        )
        found.add(run.stdout)
    assert len(found) == 1


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        (FitSettings(method="lagrange"), "method lagrange"),
        (FitSettings(segments=3), "3 segments"),
        (FitSettings(format="q15", form="polynomial"), "fixed-point"),
        (FitSettings(budget=FitBudget(torque_error=0.01)), "budget"),
        (FitSettings(form="even-odd", degree=1), "degree 1"),
    ],
)
def test_what_columns_do_not_have_is_left_to_the_single_path(
    settings: FitSettings, what: str
) -> None:
    assert what in str(why_not_in_batch(settings))
    with pytest.raises(InputError, match="not fitted in batches"):
        fit_references(MachineBatch.of(SALIENT[:1]), settings)


@pytest.mark.parametrize("degree", [1, 2, 4, 6])
def test_floats_of_many_machines_are_those_of_each(degree: int) -> None:
    """Rounded in turn, a segment without a power plainly; to the last digit of a float."""
    rng = np.random.default_rng(degree)
    segments, count = 3, 20
    widths = rng.integers(2, 16, (segments, count)) / 8.0  # so that their powers are exact
    sizes = 5.0 ** -np.arange(degree + 1.0)[None, :, None]
    coefficients = rng.standard_normal((segments, degree + 1, count)) * sizes
    coefficients[1, -1, 3] = 0.0
    found = rounded_in_turn(coefficients, widths)
    assert found.dtype == np.float32
    moved = 0
    for n in range(count):
        edges = np.concatenate([[0.0], np.cumsum(widths[:, n])])
        alone = PiecewisePolynomial(edges, coefficients[:, :, n])
        single_floats = SinglePolynomial.from_double(alone).coefficients
        np.testing.assert_array_max_ulp(found[:, :, n], single_floats, 1)
        plain = coefficients[:, :, n].astype(np.float32)
        moved += int(np.count_nonzero(single_floats != plain))
        if n == 3:
            np.testing.assert_array_equal(found[1, :, n], plain[1])
    assert degree < 2 or moved > 3
