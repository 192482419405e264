"""Emitted Kalman filter, Matsui's models, third harmonic: compiled,
compared bit for bit with their models.

The models run in double precision as well, where they must be the estimators that were analysed.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import kalman_filter
import numpy as np
import pytest
from drives import IPM

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer import harmonic_trackers as third
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.harmonic_trackers import third_harmonic_gains
from dqforge.optimizer.observers.methods import matsui_model as matsui_models
from dqforge.optimizer.observers.methods.ekf import ekf, ekf_gains, ekf_start, ekf_step
from dqforge.optimizer.observers.methods.matsui_current import (
    current_gains,
    matsui_current_start,
    matsui_current_step,
)
from dqforge.optimizer.observers.methods.matsui_voltage import (
    matsui_voltage_start,
    matsui_voltage_step,
    voltage_gains,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.sampled_machine import CurrentSensor, Trial, simulate, wrapped
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, cast
from dqforge.reports.operating_system.host_compiler import find_compiler
from dqforge.reports.steps.control_types import control_types
from dqforge.reports.steps.observer_text import observer_text, tracker_text
from dqforge.reports.verification.host import COMPILERS, WARNINGS, Compiler

T_S = 1e-4
SPEED = 800.0
SENSOR = CurrentSensor(12, 300.0, 0.2)
PHASES = PhaseMachine.from_harmonics(
    [1, 3], [0.1, 0.02], [0.0, 0.4], pole_pairs=4, r_s=0.5, l_s=1e-3, m_s=-1e-4, i_max=20.0
)
LENGTH = 600

HARNESS = """
#include <math.h>
#include <stdio.h>

{types}
{observer}

int main(void)
{{
    drive_{code}_t observer;
    float row[8];

    drive_{code}_start(&observer, 0.0F, 0.0F);
    while (fread(row, sizeof row, 1U, stdin) == 1U) {{
        const drive_alphabeta_t v = {{ row[3], row[4] }};
        const drive_alphabeta_t i = {{ row[5], row[6] }};
        float out[4] = {{ 0.0F, 0.0F, 0.0F, 0.0F }};

        if (row[0] > 0.0F) {{
            drive_{code}_start(&observer, row[1], row[2]);
        }}
        drive_{code}_step(&DRIVE_{upper}_GAINS, &observer, v, i{more});
        out[0] = observer.theta_e;
        out[1] = observer.omega_e;
        {extra}
        if (fwrite(out, sizeof out, 1U, stdout) != 1U) {{
            return 2;
        }}
    }}
    return 0;
}}
"""


@dataclass(frozen=True)
class Emitted:
    """An emitted observer with its model: ``extra`` are C lines that write more results."""

    code: str
    gains: Any
    start: Callable[..., Any]
    step: Callable[..., Any]
    more: str = ""
    extra: str = ""


def emitted(code: str) -> Emitted:
    if code == "ekf":
        filter_ = ekf(IPM, T_S, 0.5, 2.5e5, SENSOR.variance, 2000.0)
        extra = "out[2] = observer.p_omega_theta; out[3] = observer.i_q;"
        return Emitted(code, ekf_gains(filter_), ekf_start, ekf_step, extra=extra)
    if code.startswith("matsui"):
        observer = matsui_models.matsui(
            IPM, T_S, "voltage" if "voltage" in code else "current", 200.0, omega_max=2000.0
        )
        if observer.kind == "voltage":
            return Emitted(code, voltage_gains(observer), matsui_voltage_start, matsui_voltage_step)
        return Emitted(code, current_gains(observer), matsui_current_start, matsui_current_step)
    gains = third_harmonic_gains(third.third_harmonic(PHASES, T_S, 60.0, omega_max=2000.0))
    return Emitted(
        code,
        gains,
        partial(third.TRACKER.start, gains),
        lambda own, state, v, i, maths, *u: third.TRACKER.step(own, state, v, i, u, maths),
        ", row[7]",
        "out[2] = observer.flux;",
    )


CODES = ("ekf", "matsui_voltage", "matsui_current", "third_harmonic")


def rows(drives: int) -> FloatArray:
    """Sequences (drives, LENGTH, 8) of a drive with noise, and some of nothing but rough
    numbers.
    """
    generator = np.random.default_rng(4)
    trial = simulate(
        IPM,
        T_S,
        np.full((LENGTH, drives), SPEED),
        np.array([-40.0, 80.0]),
        sensor=SENSOR,
        voltage_rms=2.0,
    )
    found = np.zeros((drives, LENGTH, 8))
    found[:, 0, 0] = 1.0
    found[:, 0, 1] = generator.uniform(-0.5, 0.5, drives)
    found[:, 0, 2] = SPEED * generator.uniform(0.8, 1.2, drives)
    found[:, 1:, 3:5] = np.moveaxis(trial.v, 0, 1)
    found[:, :, 5:7] = np.moveaxis(trial.i, 0, 1)
    found[:, 1:, 7] = third.sum_voltage(PHASES, trial.theta, T_S).T
    rough = drives // 4
    found[:rough, :, 3:] = 200.0 * generator.standard_normal((rough, LENGTH, 5))
    found[:rough, 0, 1] = generator.uniform(-9.0, 9.0, rough)
    return found


def modelled(item: Emitted, sequences: FloatArray, maths: Arithmetic) -> Any:
    """Results of the model, shape (drives, LENGTH, 4)."""
    gains, data = cast(item.gains, maths), sequences.astype(np.float32).astype(maths.number)
    state = item.start(maths.wrap(data[:, 0, 1].copy()), data[:, 0, 2].copy())
    found = np.zeros((*data.shape[:2], 4), dtype=maths.number)
    for k in range(data.shape[1]):
        v, i = (
            (data[:, k, 3].copy(), data[:, k, 4].copy()),
            (data[:, k, 5].copy(), data[:, k, 6].copy()),
        )
        more = (data[:, k, 7].copy(),) if item.code == "third_harmonic" else ()
        state = item.step(gains, state, v, i, maths, *more)
        found[:, k, 0], found[:, k, 1] = state.theta_e, state.omega_e
        if item.code == "ekf":
            found[:, k, 2], found[:, k, 3] = state.scalars[2 + 8], state.scalars[1]
        elif item.code == "third_harmonic":
            found[:, k, 2] = state.scalars[0]
    return found


def compiled(item: Emitted, sequences: FloatArray, compiler: Compiler, folder: Path) -> SingleArray:
    """Results of the emitted C, shape (drives, LENGTH, 4)."""
    method = next((own for own in METHODS.values() if own.code == item.code), None)
    observer = (
        tracker_text(third.TRACKER, item.gains, "drive", "DRIVE")
        if method is None
        else observer_text(method, item.gains, "drive", "DRIVE")
    )
    source = HARNESS.format(
        types=control_types("drive", "DRIVE"), observer=observer, code=item.code,
        upper=item.code.upper(),
        more=item.more, extra=item.extra,
    )  # fmt: skip
    (folder / "harness.c").write_text(source, encoding="ascii")
    there = find_compiler(compiler.language)
    if there is None:
        pytest.skip(f"no compiler of {compiler.language}")
    command = [
        *there.command,
        *there.flags,
        "-x",
        compiler.language,
        f"-std={compiler.standard}",
        "-O2",
        "-ffp-contract=off",
        *WARNINGS,
    ]
    # The types bring more functions than one observer uses; in a header their
    # being unused is no warning.
    built = subprocess.run(
        [*command, "-o", "harness", "harness.c", "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    data = np.ascontiguousarray(sequences.astype(np.float32))
    done = subprocess.run(
        [str(folder / "harness")], input=data.tobytes(), capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, dtype=np.float32).reshape(*data.shape[:2], 4)


@pytest.mark.thinned
@pytest.mark.parametrize("compiler", COMPILERS, ids=lambda compiler: compiler.language)
@pytest.mark.parametrize("code", CODES)
def test_c_is_its_model_bit_for_bit(code: str, compiler: Compiler, tmp_path: Path) -> None:
    item, sequences = emitted(code), rows(16)
    with np.errstate(all="ignore"):
        model = modelled(item, sequences, SINGLE)
    found = compiled(item, sequences, compiler, tmp_path)
    same = (found.view(np.uint32) == model.view(np.uint32)) | (np.isnan(found) & np.isnan(model))
    assert np.all(same), np.argwhere(~same)[:3]
    assert np.all(np.isfinite(found[4:]))


@pytest.mark.thinned
@pytest.mark.parametrize("code", CODES)
def test_single_precision_follows_double_precision(code: str) -> None:
    item, sequences = emitted(code), rows(8)[2:]
    single, double = (modelled(item, sequences, maths) for maths in (SINGLE, EXACT))
    assert np.max(np.abs(wrapped(single[..., 0].astype(np.float64) - double[..., 0]))) < 2e-3
    assert np.max(np.abs(single[..., 1] - double[..., 1])) < 2.0


@pytest.mark.slow
def test_models_are_the_estimators_that_were_analysed() -> None:
    sequences = rows(8)[2:]
    trial = simulate(
        IPM,
        T_S,
        np.full((LENGTH, 8), SPEED),
        np.array([-40.0, 80.0]),
        sensor=SENSOR,
        voltage_rms=2.0,
    )
    data = sequences.astype(np.float32).astype(np.float64)
    seen = Trial(
        T_S, np.moveaxis(data[:, 1:, 3:5], 0, 1), np.moveaxis(data[:, :, 5:7], 0, 1),
        trial.theta[:, 2:], trial.omega[:, 2:], trial.i_dq[:, 2:],
    )  # fmt: skip
    away = data[:, 0, 1] - trial.theta[0, 2:], data[:, 0, 2] - SPEED
    filter_ = ekf(IPM, T_S, 0.5, 2.5e5, SENSOR.variance, 2000.0)
    estimates: dict[str, Any] = {"ekf": kalman_filter.run(filter_, seen, *away)}
    for kind in ("voltage", "current"):
        observer = matsui_models.matsui(IPM, T_S, kind, 200.0, omega_max=2000.0)
        estimates[f"matsui_{kind}"] = matsui_models.run(observer, seen, *away)
    tracker = third.third_harmonic(PHASES, T_S, 60.0, omega_max=2000.0)
    estimates["third_harmonic"] = third.run(tracker, data[:, 1:, 7].T, data[:, 0, 1], data[:, 0, 2])
    for code, found in estimates.items():
        model = modelled(emitted(code), sequences, EXACT)
        assert np.max(np.abs(wrapped(model[..., 0].T - found.theta))) < 1e-8, code
        assert np.max(np.abs(model[..., 1].T - found.omega)) < 1e-5, code
