"""North from south: the probability of a wrong decision, the plan from the flux map, the C."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.saliency.inform import (
    WRONG,
    PolarityGains,
    PolarityPlan,
    peak_difference,
    plan_polarity,
    polarity_start,
    polarity_step,
    wrong_decision,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic
from dqforge.reports.c_code.harness import SINGLE
from dqforge.reports.pages.templating import render
from dqforge.reports.steps.control_types import control_types

BALDOR = "baldor-pmsyrm-5k6"
GAINS = PolarityGains(voltage=1.0, periods=1.0, pause=5.0, pulses=1.0, sign=1.0)


def _decide(
    gains: PolarityGains, current: FloatArray, flux: FloatArray, sigma: float, south: FloatArray
) -> FloatArray:
    """Decisions (1: turned) of a winding with a flux over current along the magnet, per volt
    second of ``gains``; ``south`` is -1 where the assumed d axis points against the magnet.
    """
    generator, count = np.random.default_rng(11), len(south)
    state, linked, acting = polarity_start(count, EXACT), np.zeros(count), np.zeros(count)
    for _ in range(400):
        i = south * np.interp(south * linked, flux, current)
        state = polarity_step(gains, state, i + sigma * generator.standard_normal(count), EXACT)
        linked = linked + acting
        acting = np.asarray(state.voltage, dtype=np.float64)
        if state.done:
            return np.asarray(state.turned, dtype=np.float64)
    raise AssertionError("the pulses do not end")


@pytest.mark.parametrize(("s", "share", "pulses"), [(0.05, 0.5, 1), (0.1, 0.35, 1), (0.2, 0.2, 4)])
def test_wrong_decisions_are_as_rare_as_the_formula_says(
    s: float, share: float, pulses: int
) -> None:
    """L_dd = 1 - s i of a winding with the largest current 1, 10,000 trials at 0.5 % of noise."""
    current = np.linspace(-1.2, 1.2, 4001)
    flux = current - 0.5 * s * current**2
    gains = replace(GAINS, voltage=share, pulses=float(pulses))
    trials = 10_000
    south = np.where(np.arange(trials) % 2 == 0, 1.0, -1.0)
    found = _decide(gains, current, flux, 0.005, south)
    wrong = float(np.mean(found != (south < 0.0)))
    expected = wrong_decision(s * share**2, 0.005, pulses)
    assert 0.01 < expected < 0.2
    assert wrong == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("s", [0.1, -0.1])
def test_without_noise_no_decision_is_wrong(s: float) -> None:
    current = np.linspace(-1.2, 1.2, 4001)
    gains = replace(GAINS, voltage=0.1, periods=5.0, sign=float(np.sign(s)))
    south = np.array([1.0, -1.0])
    found = _decide(gains, current, current - 0.5 * s * current**2, 0.0, south)
    np.testing.assert_array_equal(found, [0.0, 1.0])


def _plan() -> PolarityPlan:
    return plan_polarity(catalogue.load(BALDOR))


def test_the_plan_is_the_least_current_that_the_flux_map_permits() -> None:
    design, plan = catalogue.load(BALDOR), _plan()
    assert plan.wrong <= WRONG
    assert plan.i_peak < 0.25 * design.i_max
    assert plan.difference == pytest.approx(abs(peak_difference(design.machine, plan.i_peak)))
    less = peak_difference(design.machine, plan.i_peak - 0.05 * design.i_max)
    assert wrong_decision(abs(less), plan.sigma, int(plan.gains.pulses)) > WRONG
    # of this map the peak against the magnet is the larger
    assert plan.gains.sign == -1.0


def test_the_plan_decides_rightly_on_the_flux_map() -> None:
    design, plan = catalogue.load(BALDOR), _plan()
    current = np.linspace(-18.0, 18.0, 2001)
    flux = design.machine.flux(current, 0.0 * current)[0]
    flux = (flux - np.interp(0.0, current, flux)) / design.control.t_s
    south = np.where(np.arange(4000) % 2 == 0, 1.0, -1.0)
    found = _decide(plan.gains, current, flux, plan.sigma, south)
    assert np.mean(found != (south < 0.0)) <= 1e-3
    assert plan.duration < 0.02


def test_a_d_axis_that_does_not_saturate_is_refused_with_the_numbers() -> None:
    with pytest.raises(NoSolutionError, match=r"s = 0 at 9\.122 A, .* differ by 0 A, and 0\.228 A"):
        plan_polarity(catalogue.load("abb-ipmsm-2k2"))


def test_not_a_number_takes_no_side() -> None:
    state = polarity_start(1, EXACT)
    for _ in range(40):
        state = polarity_step(GAINS, state, np.array([np.nan]), EXACT)
    assert state.done
    assert state.total[0] == 0.0
    assert state.turned[0] == 0.0


HARNESS = """
#include <math.h>
#include <stdio.h>

{types}
{polarity}

int main(void)
{{
    drive_polarity_t state;
    float i_d;

    drive_polarity_start(&state);
    while (fread(&i_d, sizeof i_d, 1U, stdin) == 1U) {{
        float out[3];

        drive_polarity_step(&DRIVE_POLARITY_GAINS, &state, i_d);
        out[0] = state.voltage;
        out[1] = state.total;
        out[2] = (float)(2 * state.done + state.turned);
        if (fwrite(out, sizeof out, 1U, stdout) != 1U) {{
            return 2;
        }}
    }}
    return 0;
}}
"""


def _modelled(gains: PolarityGains, currents: SingleArray, maths: Arithmetic) -> SingleArray:
    state, rows = polarity_start(1, maths), []
    for i_d in currents:
        state = polarity_step(gains, state, np.array([i_d]), maths)
        flags = 2.0 * state.done + state.turned[0]
        rows.append((state.voltage[0], state.total[0], flags))
    return np.array(rows, dtype=np.float32)


def test_c_is_its_model_bit_for_bit(tmp_path: Path) -> None:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("cc is not installed")
    plan = _plan()
    gains = replace(plan.gains, pulses=4.0)
    names = {"prefix": "drive", "macro": "DRIVE"}
    source = HARNESS.format(
        types=control_types("drive", "DRIVE"),
        polarity=render("observers/polarity.j2", names | {"polarity": asdict(gains)}),
    )
    (tmp_path / "harness.c").write_text(source, encoding="ascii")
    command = [compiler, "-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    command += ["-Wno-unused-function", "-o", "harness", "harness.c", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    generator = np.random.default_rng(5)
    currents = generator.standard_normal(300).astype(np.float32)
    currents[[7, 29, 30]] = [np.nan, np.inf, -np.inf]
    done = subprocess.run(
        [str(tmp_path / "harness")], input=currents.tobytes(), capture_output=True, check=True
    )
    found = np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 3)
    model = _modelled(gains, currents, SINGLE)
    assert model[-1, 2] >= 2.0
    np.testing.assert_array_equal(found.view(np.uint32), model.view(np.uint32))
