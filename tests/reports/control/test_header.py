"""The emitted field-oriented control: bit for bit its model, and the model what
modulators and loops ask for.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings, WeakeningSettings
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import Pair
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.float_control.duties import centred_duties
from dqforge.optimizer.loops.plants import current_loop, current_step
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta
from dqforge.reports.control.header import (
    ControlModel,
    control_files,
    control_from,
    control_inputs,
    control_programme,
    control_results,
    plain_control,
)
from dqforge.reports.main_header import header_files
from dqforge.reports.output.folder import put_files
from dqforge.reports.run import export_design, plain_solution, read_folder, verify_folder
from dqforge.reports.verification.host import verify_files


def bench(modulation: ModulationName = "svpwm", **changes: Any) -> Design:
    loaded = catalogue.load("paper001-pmsm-bench")
    operation = replace(loaded.operation, modulation=modulation)
    return replace(
        loaded, operation=operation, export=replace(loaded.export, control=("float32",)), **changes
    )


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(bench())


def model_of(solution: Solution) -> ControlModel:
    return control_from(plain_control(solution), plain_solution(solution))


def with_modulator(model: ControlModel, name: ModulationName) -> ControlModel:
    gains = {**model.gains, "voltage_share": np.float32(MODULATORS[name].linear_limit)}
    return ControlModel(gains, model.ratio, name, model.reference, model.weakening)


@pytest.mark.thinned
@pytest.mark.parametrize("name", MODULATORS)
def test_compiled_control_equals_the_model_bit_for_bit(
    name: ModulationName, solution: Solution
) -> None:
    changed = replace(solution, design=bench(name))
    plain = plain_solution(changed)
    model = control_from(plain["control_header"], plain)
    assert model.modulation == name
    inputs = control_inputs(model)
    results = control_results(model, inputs)
    duties = results[:, :3]
    assert np.all((duties >= 0.0) & (duties <= 1.0))
    assert np.ptp(duties, axis=0) == pytest.approx(1.0, abs=0.02)  # every rail is reached
    assert (
        np.unique(results, axis=0).shape[0] > 0.9 * results.shape[0] * (inputs[:, 6] > 0.0).mean()
    )
    export = changed.design.export
    files = header_files(changed) | control_files(changed)
    reference = changed.fit.reference
    verification = verify_files(
        files, export.prefix, reference, export.vectors, [control_programme(model)]
    )
    assert verification.languages == ("c99", "c++11")


@pytest.mark.parametrize("name", MODULATORS)
def test_duties_are_those_of_the_modulators(name: ModulationName, solution: Solution) -> None:
    """Against the modulators of the loss budgets, in double precision, within their linear
    range.
    """
    generator = np.random.default_rng(3)
    count, v_dc = 4000, 300.0
    angle, lag = generator.uniform(-np.pi, np.pi, (2, count))
    amplitude = generator.uniform(0.01, 1.0, count) * MODULATORS[name].linear_limit * v_dc
    alpha, beta = amplitude * np.cos(angle), amplitude * np.sin(angle)
    i_alpha, i_beta = 7.0 * np.cos(angle - lag), 7.0 * np.sin(angle - lag)

    def phases(x: FloatArray, y: FloatArray) -> FloatArray:
        half = np.sqrt(0.75)
        return np.stack([x, -0.5 * x + half * y, -0.5 * x - half * y], axis=-1)

    expected = modulate(name, phases(alpha, beta), phases(i_alpha, i_beta), v_dc)
    model = with_modulator(model_of(solution), name)
    single = [
        np.asarray(x, dtype=np.float32)
        for x in (alpha, beta, np.full(count, v_dc), i_alpha, i_beta)
    ]
    found = np.stack(
        model.duties(Pair(single[0], single[1]), single[2], Pair(single[3], single[4])), axis=-1
    )
    away = np.abs(found - expected.duty).max(axis=1)
    # where two phases are as good as equal the floats may let the other one rest
    assert np.mean(away > 1e-5) < 1e-3
    assert np.median(away) < 1e-6
    if name in DISCONTINUOUS:
        assert np.all((np.min(found, axis=1) == 0.0) | (np.max(found, axis=1) > 1.0 - 1e-6))


def test_centred_duties_stay_within_0_and_1_with_every_rounding() -> None:
    """Voltages at the very edge of the hexagon, where rounding decides, and any bits at all."""
    generator = np.random.default_rng(17)
    count = 1_000_000
    v_dc = (10.0 ** generator.uniform(-3.0, 4.0, count)).astype(np.float32)
    angle = generator.uniform(-np.pi, np.pi, count)
    edge = 1.0 / np.sqrt(3.0) / np.cos((angle % (np.pi / 3.0)) - np.pi / 6.0)
    size = v_dc * edge * (1.0 + generator.uniform(-6e-6, 3e-6, count))
    near = Pair(*(size * one(angle) for one in (np.cos, np.sin)))
    any_bits = generator.integers(0, 2**32, (3, count), dtype=np.uint64).astype(np.uint32)
    rough = any_bits.view(np.float32)
    off = ~(rough[2] > 0.0)  # there the voltage is 0, as the current control has it
    bare = AlphaBeta(*(np.where(off, np.float32(0.0), part) for part in rough[:2]))
    with np.errstate(all="ignore"):
        single = AlphaBeta(*(np.asarray(part, dtype=np.float32) for part in near))
        found = [*centred_duties(SINGLE, single, v_dc), *centred_duties(SINGLE, bare, rough[2])]
    assert all(np.all((duty >= 0.0) & (duty <= 1.0)) for duty in found)
    assert 0.2 < np.mean(np.max(found[:3], axis=0) > 0.999999) < 0.8  # both ways are taken


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_two_bad_samples_at_once_leave_numbers_behind(solution: Solution, bad: float) -> None:
    """A DC link that is no number together with a current, a speed or an angle."""
    model = model_of(solution)
    for column in range(5):
        spoilt = np.array([[0.2, -0.1, -0.1, 0.3, 20.0, bad]], dtype=np.float32)
        spoilt[0, column] = bad
        state = model.at_rest(1)
        reference = (np.zeros(1, dtype=np.float32), np.ones(1, dtype=np.float32))
        with np.errstate(all="ignore"):
            duty = np.concatenate(model.current_control(state, spoilt, reference))
        assert np.all((duty >= 0.0) & (duty <= 1.0))
        assert np.all(np.isfinite(np.concatenate([state.d.integral, state.q.integral, *state.v])))


def settled(
    model: ControlModel, solution: Solution, steps: int, reference: tuple[float, float]
) -> FloatArray:
    """i_d, i_q of a linear machine at standstill, exact between samples,
    with one period of delay.
    """
    machine, t_s = solution.design.machine, solution.design.control.t_s
    state = model.at_rest(1)
    decay = np.exp(-machine.r_s * t_s / np.array([machine.l_d, machine.l_q]))
    current, waiting, seen = np.zeros(2), np.zeros(2), []
    for _ in range(steps):
        seen.append(current)
        half = np.sqrt(0.75)
        phases = [
            current[0],
            -0.5 * current[0] + half * current[1],
            -0.5 * current[0] - half * current[1],
        ]
        measured = np.array([[*phases, 0.0, 0.0, 300.0]], dtype=np.float32)
        wanted = tuple(np.array([x], dtype=np.float32) for x in reference)
        model.current_control(state, measured, wanted)
        current = current * decay + waiting * (1.0 - decay) / machine.r_s
        waiting = np.array([float(state.v[0][0]), float(state.v[1][0])])
    return np.array(seen)


def test_the_current_loop_answers_as_the_sampled_loop_says(solution: Solution) -> None:
    machine, gains = solution.design.machine, solution.gains
    found = settled(model_of(solution), solution, 80, (0.5, 1.5))
    for axis, (inductance, loop) in enumerate(((machine.l_d, gains.i_d), (machine.l_q, gains.i_q))):
        response = current_step(
            current_loop(machine.r_s, inductance, loop.t_s, loop.kp, loop.ki), 80
        )
        size = (0.5, 1.5)[axis]
        np.testing.assert_allclose(found[:, axis], size * response.reference[:80], atol=2e-5 * size)


def test_what_the_limit_cuts_off_does_not_wind_up(solution: Solution) -> None:
    """A reference far beyond the voltage: the integrals stay bounded, and afterwards
    the loop is back at once.
    """
    model = model_of(solution)
    state = model.at_rest(1)
    measured = np.array([[0.0, 0.0, 0.0, 0.3, 0.0, 300.0]], dtype=np.float32)
    far = (np.zeros(1, dtype=np.float32), np.full(1, 1e5, dtype=np.float32))
    for _ in range(2000):
        model.current_control(state, measured, far)
        assert np.hypot(*state.v)[0] <= 300.0 / np.sqrt(3.0) * (1.0 + 1e-6)
    # in the steady state of back-calculation ki_ts e = tracking (wanted - limited)
    kp, ki_ts, tracking = (float(x) for x in model.gains["q"])
    bound = 300.0 / np.sqrt(3.0) + (ki_ts / tracking - kp - ki_ts) * 1e5
    assert float(state.q.integral[0]) == pytest.approx(bound, rel=1e-3)


def test_the_speed_loop_works_at_its_own_rate_and_holds_its_limit(solution: Solution) -> None:
    model = model_of(solution)
    state = model.at_rest(1)
    most = float(model.gains["torque_max"])
    seen = [
        float(
            model.speed_loop(
                state, np.zeros(1, dtype=np.float32), np.full(1, 1e4, dtype=np.float32)
            )[0]
        )
        for _ in range(3 * model.ratio)
    ]
    assert max(seen) == most
    changes = [k for k in range(1, len(seen)) if seen[k] != seen[k - 1]]
    assert all(k % model.ratio == 0 for k in changes)


@pytest.mark.parametrize("column", range(6))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_sample_makes_no_voltage_and_is_forgotten(
    solution: Solution, column: int, bad: float
) -> None:
    """Currents, angle, speed or DC link that are no numbers for one sample:
    the next one goes on as if without it.
    """
    model = model_of(solution)
    good = np.array([[0.2, -0.1, -0.1, 0.3, 20.0, 300.0]], dtype=np.float32)
    spoilt = good.copy()
    spoilt[0, column] = bad
    target = np.full(1, 50.0, dtype=np.float32)
    state = model.at_rest(1)
    model.speed_control(state, good, target)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        duty = model.speed_control(state, spoilt, target)
    assert all(np.isfinite(one) and 0.0 <= one <= 1.0 for one in np.concatenate(duty))
    kept = np.concatenate(
        [
            state.d.integral,
            state.q.integral,
            state.speed.integral,
            state.omega_m,
            state.torque,
            *state.v,
        ]
    )
    assert np.all(np.isfinite(kept))
    after = np.concatenate(model.speed_control(state, good, target))
    assert np.all((after > 0.2) & (after < 0.8))


@pytest.mark.slow
def test_a_changed_sign_is_found_and_damage_is_refused(tmp_path: Path) -> None:
    output = export_design(bench(), verify=True)
    put_files(tmp_path, output.files)
    found = read_folder(tmp_path)
    assert f"{found.prefix}_control.h" in found.files
    verify_folder(tmp_path)
    header = tmp_path / f"{found.prefix}_control.h"
    text = header.read_text(encoding="ascii")
    header.write_text(text.replace("x.a - (0.5F", "x.a + (0.5F", 1), encoding="ascii")
    with pytest.raises(VerificationError, match="results of the control functions differ"):
        verify_folder(tmp_path)
    header.write_text(text, encoding="ascii")
    document = json.loads(output.files["result.json"])
    damages: list[Any] = [
        "x",
        {},
        document["control_header"] | {"ratio": 0},
        document["control_header"] | {"d": [1.0]},
    ]
    for damage in damages:
        (tmp_path / "result.json").write_text(
            json.dumps(document | {"control_header": damage}), encoding="ascii"
        )
        with pytest.raises(InputError, match="control_header is not what dqforge writes"):
            read_folder(tmp_path)


@pytest.mark.slow
def test_torque_control_weakens_the_field_where_the_design_does() -> None:
    loaded = catalogue.load("abb-ipmsm-2k2")
    design = replace(
        loaded,
        export=replace(loaded.export, control=("float32",)),
        weakening=WeakeningSettings(300.0),
        losses=None,
    )
    output = export_design(design, verify=True)
    plain = json.loads(output.files["result.json"])
    model = control_from(plain["control_header"], plain)
    state = model.at_rest(2)
    measured = np.array(
        [[0.0, 0.0, 0.0, 0.0, speed, design.inverter.v_dc] for speed in (10.0, 300.0)]
    )
    torque = np.full(2, 0.3 * float(model.gains["torque_max"]), dtype=np.float32)
    model.torque_control(state, measured.astype(np.float32), torque)
    assert state.reference[0][1] < state.reference[0][0] - 0.1


def test_integers_in_the_reference_are_refused(solution: Solution) -> None:
    fixed = solve(bench(fit=FitSettings(form="polynomial", format="q15", full_scale=(2.0, 8.0))))
    with pytest.raises(InputError, match=r"write fit\.format: float32, or export\.control: q15"):
        plain_control(fixed)
