"""Header of a position observer: compiled and equal to its model, read back, refused when changed;
design-file keys.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import make_design, on_observer, within_a_percent

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import LEARNED_OBSERVERS
from dqforge.machines.plants.scenario import drive_motion
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.observers import tuning as observer_proof
from dqforge.optimizer.observers.judgement import judge_at
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import observe
from dqforge.optimizer.observers.tuning import PositionObserver, prove
from dqforge.optimizer.steps.step_arithmetic import EXACT, cast
from dqforge.reports.observers.float32_model import observer_inputs, observer_outputs
from dqforge.reports.observers.position_header import (
    emitted,
    observer_files,
    observer_from,
    plain_observer,
)
from dqforge.reports.observers.position_text import (
    plain_position,
    position_parts,
    proof_text,
    rounded_up,
    speed_range_text,
)
from dqforge.reports.pages.templating import to_text
from dqforge.reports.run import export_design, verify_folder

EVERY = pytest.mark.parametrize("name", list(METHODS))


def _design(name: str):  # type: ignore[no-untyped-def]
    design = make_design()
    observer = ObserverSettings(method=name)  # type: ignore[arg-type]
    return on_observer(design, observer)


@cache
def _observer(name: str) -> PositionObserver:
    observer = solve_gains(_design(name)).position
    assert observer is not None
    return observer


def _without_one_number(plain: dict[str, Any]) -> None:
    """Take the first number out of plain gains, however deep it lies."""
    key, value = next(iter(plain.items()))
    if isinstance(value, dict):
        _without_one_number(value)
    else:
        plain[key] = None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "flux",
        *(pytest.param(other, marks=pytest.mark.slow) for other in METHODS if other != "flux"),
    ],
)
def test_run_emits_a_verified_header_that_verify_takes_and_that_fails_when_changed(
    name: str, tmp_path: Path
) -> None:
    output = export_design(within_a_percent(_design(name)), verify=True)
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    assert output.verification.vectors + output.verification.sweep > 35_000
    for file_name, content in output.files.items():
        (tmp_path / file_name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "drive_observer.h"
    text = header.read_text()
    assert f"drive_{METHODS[name].code}_step" in text
    foretold = "_wrap(own + " if name in LEARNED_OBSERVERS else "_wrap(observer->theta_e + "
    assert foretold in text
    header.write_text(text.replace(foretold, foretold.replace("+", "-")))
    with pytest.raises(VerificationError, match="results of the position observer differ"):
        verify_folder(tmp_path)
    loaded = json.loads((tmp_path / "result.json").read_text())
    loaded["observer_header"]["method"] = "other"
    (tmp_path / "result.json").write_text(json.dumps(loaded))
    with pytest.raises(InputError, match="observer_header is not what dqforge writes"):
        verify_folder(tmp_path)


@pytest.mark.thinned
@EVERY
def test_an_observer_reads_back_as_it_was_written(name: str) -> None:
    observer = emitted(_observer(name))
    assert observer is not None
    plain = json.loads(json.dumps(plain_observer(observer)))
    again = observer_from(plain)
    inputs = observer_inputs(observer.method, observer.gains, 2000, 5)
    np.testing.assert_array_equal(
        observer_outputs(again.method, again.gains, inputs),
        observer_outputs(observer.method, observer.gains, inputs),
    )
    _without_one_number(plain["gains"])
    with pytest.raises(InputError, match="run the design again"):
        observer_from(plain)


@pytest.mark.thinned
@EVERY
def test_single_precision_costs_no_angle(name: str) -> None:
    """The firmware's numbers against double precision over a whole run; and
    sequences reach every branch.
    """
    observer = _observer(name)
    method, gains, t_s = observer.method, observer.gains, observer.t_s
    motion = drive_motion(
        observer.machine, t_s, np.full((1500, 2), [1900.0, -1100.0]), np.array([-20 + 80j])
    )
    single = observe(method, gains, motion, maths=SINGLE)
    assert single.theta_e.dtype == np.float32
    expected = np.zeros_like(motion.theta_e)
    if name in LEARNED_OBSERVERS:  # exact data are one drive of the box, and corrected like others
        expected = observe(method, gains, motion).angle_error(motion)
    assert np.max(np.abs(single.angle_error(motion) - expected)[-500:]) < 1e-3
    outputs = observer_outputs(method, gains, observer_inputs(method, gains, 20_000, 3))
    assert np.isfinite(outputs).all()
    assert np.max(np.abs(outputs[:, 1])) * t_s > 0.9


@pytest.mark.thinned
@EVERY
def test_what_is_said_agrees_with_what_was_judged(name: str) -> None:
    observer = _observer(name)
    (title, columns, rows, notes), *_ = position_parts(observer)
    assert "Position observer" in title
    assert all(len(row) == len(columns) for row in rows)
    assert float(rows[-1][0]) == pytest.approx(observer.omega_max / (2.0 * np.pi), rel=1e-3)
    at_top = int(np.flatnonzero(observer.judgement.omega == observer.omega_max)[0])
    column = next(k for k, heading in enumerate(columns) if heading.startswith("L_q"))
    assert float(rows[-1][column]) == pytest.approx(
        np.degrees(observer.judgement.bias["l_q"][at_top]), rel=0.01
    )
    assert speed_range_text(observer) in notes[1]
    plain = json.loads(to_text("tune", "test", {"position": plain_position(observer)}))["position"]
    assert plain["method"] == name
    assert len(plain["poles"]) == len(plain["omega_rad_per_s"])


@pytest.mark.slow
def test_header_is_the_same_bytes_every_time() -> None:
    design = _design("flux")
    first, second = (observer_files(design, solve_gains(design).position) for _ in range(2))  # type: ignore[arg-type]
    assert first == second


@pytest.mark.thinned
@EVERY
def test_not_a_number_does_not_stay(name: str) -> None:
    """A Kalman filter comes back by itself with the next samples; every method does by its start.

    Twelve drives: not a number, infinity and 3e38 in each of the four
    measured values at sample 100.
    """
    observer = _observer(name)
    method, gains = observer.method, cast(observer.gains, SINGLE)
    omega = np.full((400, 1), 1900.0)
    motion = drive_motion(observer.machine, observer.t_s, omega, np.array([-20 + 80j]))
    inputs = np.stack([motion.v_alpha, motion.v_beta, motion.i_alpha, motion.i_beta]).astype(
        np.float32
    )
    inputs = np.repeat(inputs, 12, axis=2)
    for case, (column, bad) in enumerate(product(range(4), (np.nan, np.inf, 3e38))):
        inputs[column, 100, case] = bad
    theta, speed = np.repeat(motion.theta_e, 12, axis=1), np.full(12, 1900.0, dtype=np.float32)
    state = method.start(theta[0].astype(np.float32), speed)
    with np.errstate(all="ignore"):  # as in C
        for k, (v_alpha, v_beta, i_alpha, i_beta) in enumerate(np.moveaxis(inputs, 1, 0)):
            if k == 120 and name != "ekf":
                state = method.start(SINGLE.wrap(theta[k].astype(np.float32)), speed)
            state = method.step(gains, state, (v_alpha, v_beta), (i_alpha, i_beta), SINGLE)
            assert name != "ekf" or (
                np.isfinite(state.theta_e).all() and np.isfinite(state.omega_e).all()
            )
    assert np.max(np.abs(EXACT.wrap(state.theta_e.astype(np.float64) - theta[-1]))) < 2e-3
    np.testing.assert_allclose(state.omega_e, 1900.0, rtol=2e-3)


@pytest.mark.slow
def test_tune_says_what_is_proven_of_the_flux_observer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A contraction no smaller than the largest pole between the ends, in text.

    Of other methods at how many points it was checked.
    """
    design = catalogue.load("paper001-pmsm-bench")
    control = replace(design.control, observer=ObserverSettings(method="flux"))
    observer = solve_gains(replace(design, control=control)).position
    assert observer is not None
    proof = prove(observer)
    assert proof is not None
    assert proof.contraction is not None
    omega = np.linspace(proof.omega_low, proof.omega_high, 30)
    judged = judge_at(
        observer.method,
        observer.gains,
        observer.t_s,
        observer.machine,
        observer.disturbances,
        omega,
    )
    assert np.max(judged.radius) < proof.contraction < 1.0
    assert position_parts(observer, proof)[0][3][-1].startswith(
        f"proven: small errors shrink by {rounded_up(proof.contraction):.5f}"
    )
    assert prove(None) is None
    checked = prove(_observer("extended-emf"))
    assert checked is not None
    assert re.fullmatch(
        r"one norm for all: small errors shrink by 0\.9\d{4} per sample or faster while the speed "
        r"varies in [\d.]+ to [\d.]+ Hz, \|i_q\| up to [\d.]+ A; checked at 20048 points",
        proof_text(checked),
    )
    wild = replace(
        observer, gains=replace(observer.gains, pll=replace(observer.gains.pll, l_1=2.05))
    )
    refused = prove(wild)
    assert refused is not None
    assert refused.contraction is None
    assert "no common Lyapunov function was found" in proof_text(refused)
    for gone in (("cvxpy",), ("clarabel",), ("cvxpy", "clarabel")):
        monkeypatch.setattr(
            observer_proof, "find_spec", lambda name, gone=gone: None if name in gone else name
        )
        missing = prove(observer)
        assert missing is not None
        assert (missing.contraction, missing.searched) == (None, False)
        said = f"the search needs {' and '.join(gone)}; install with: pip install {' '.join(gone)}"
        assert said in position_parts(observer, missing)[0][3][-1]
        assert "\n" not in proof_text(missing)
