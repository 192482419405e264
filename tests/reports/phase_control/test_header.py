"""The emitted control of phase machines: bit for bit its model, in every frame and topology."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, PhaseShape, TorqueLimit
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.emitted_integers import (
    phase_control_inputs,
    phase_control_programme,
    phase_control_results,
)
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.header import (
    phase_control_files,
    phase_control_from,
    plain_solution_control,
)
from dqforge.reports.run import plain_solution
from dqforge.reports.verification.host import verify_files

P, Z = near_sinusoidal(96), trapezoidal(96)


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(catalogue.load("paper002-phase-waveforms"))


@pytest.fixture(scope="module")
def document(solution: Solution) -> dict[str, Any]:
    return plain_solution(solution)


def model_of(
    solution: Solution, document: dict[str, Any], control: PhaseControl
) -> PhaseControlModel:
    return phase_control_from(plain_solution_control(solution, control), document)


def prove(solution: Solution, document: dict[str, Any], control: PhaseControl) -> None:
    """Compile the header and compare every bit with its model."""
    model, export = model_of(solution, document, control), solution.design.export
    files = header_files(solution) | phase_control_files(solution, control)
    verification = verify_files(
        files, export.prefix, solution.fit.reference, export.vectors,
        [phase_control_programme(model)],
    )  # fmt: skip
    assert verification.languages == ("c99", "c++11")


def _cases() -> list[tuple[Topology, CurrentFrame, Feedforward]]:
    """Every pair of topology and frame, with the ways to feed forward in turn."""
    ways: tuple[Feedforward, ...] = ("references", "emf", "none")
    pairs = [
        (topology, frame)
        for topology in get_args(Topology)
        for frame in get_args(CurrentFrame)
        if frame != "dqy" or TOPOLOGIES[topology].neutral
    ]
    return [(*pair, ways[place % len(ways)]) for place, pair in enumerate(pairs)]


@pytest.mark.slow
@pytest.mark.parametrize(("topology", "frame", "feedforward"), _cases())
def test_compiled_control_equals_the_model_bit_for_bit(
    topology: Topology,
    frame: CurrentFrame,
    feedforward: Feedforward,
    solution: Solution,
    document: dict[str, Any],
) -> None:
    prove(solution, document, plain_control(P, topology, frame, feedforward))


@pytest.mark.slow
def test_vectors_visit_every_mode(solution: Solution, document: dict[str, Any]) -> None:
    """Voltages that are made and that are shortened, all duties, open phases, bad samples."""
    model = model_of(solution, document, plain_control(P))
    inputs = phase_control_inputs(model)
    results = phase_control_results(model, inputs)
    duties = results[:, :4]
    assert np.all((duties >= 0.0) & (duties <= 1.0))
    assert np.ptp(duties, axis=0) == pytest.approx(1.0, abs=0.02)
    spans = np.ptp(duties, axis=1)
    assert 0.1 < np.mean(spans > 0.999) < 0.7  # shortened
    assert np.mean((spans > 0.01) & (spans < 0.99)) > 0.2
    assert set(np.unique(inputs[:, 10])) == {-1.0, 0.0, 1.0, 2.0, 3.0, 4.0}
    assert np.isnan(inputs[:, 1:10]).any(axis=0).all()


@pytest.mark.thinned
@pytest.mark.parametrize("topology", ["four-leg", "three-wire"])
def test_rows_turns_limits_and_no_harmonics(
    topology: Topology, solution: Solution, document: dict[str, Any]
) -> None:
    """Three rows over two electrical periods, a torque limit, no harmonic integrators."""
    flux = np.concatenate([Z.flux, 0.9 * Z.flux], axis=1)
    limit = TorqueLimit(
        np.array([100.0, 300.0, 600.0]), np.array([150.0, 220.0]),
        np.array([[4.0, 4.5], [2.0, 3.0], [0.0, 1.0]]),
    )  # fmt: skip
    control = plain_control(
        Z, topology, shape=PhaseShape(flux, 2), torque_limit=limit, harmonics=None
    )
    prove(solution, document, control)
    one_voltage = replace(limit, v_dc=limit.v_dc[:1], torque=limit.torque[:, :1])
    model = model_of(solution, document, replace(control, torque_limit=one_voltage))
    measured = np.array([[0, 0, 0, 0, 100.0, 300.0]], dtype=np.float32)  # 200 rad/s electrical
    limited = model.limited_torque(np.array([5.0], dtype=np.float32), measured)
    assert limited[0] == pytest.approx(3.0)


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("frame", "feedforward"), [("dq", "references"), ("dq", "measured"), ("table", "references")]
)
def test_saliency_in_rotor_coordinates(
    frame: CurrentFrame, feedforward: Feedforward, solution: Solution, document: dict[str, Any]
) -> None:
    control = plain_control(P, "six-leg", frame, feedforward)
    prove(solution, document, replace(control, inductances=(5e-3, 11e-3, 5e-3)))


def test_what_is_not_emitted_is_refused(solution: Solution) -> None:
    with pytest.raises(InputError, match=r"dqy needs a zero-sequence current.*write dqx or table"):
        plain_solution_control(solution, plain_control(P, "three-wire", "dqy"))
    with pytest.raises(InputError, match="dqx is for machines without saliency; write table or"):
        plain_solution_control(
            solution, plain_control(P, frame="dqx", inductances=(5e-3, 9e-3, 5e-3))
        )
    with pytest.raises(InputError, match="multiples of 3"):
        plain_solution_control(solution, plain_control(P, shape=PhaseShape(P.flux[:1, :64])))


@pytest.mark.slow
def test_the_limit_of_a_design_is_read_at_equal_load(
    solution: Solution, document: dict[str, Any]
) -> None:
    """At 0.8 of the nominal link it is read at 1.25 of the speed; without a link no torque."""
    limit = TorqueLimit(
        np.array([0.0, 250.0, 500.0]), np.array([0.0, 220.0]),
        np.array([[0.0, 4.0], [0.0, 3.0], [0.0, 0.0]]), 220.0,
    )  # fmt: skip
    control = plain_control(P, torque_limit=limit, harmonics=None)
    prove(solution, document, control)
    measured = np.array(
        [[0, 0, 0, 0, 100.0, 176.0], [0, 0, 0, 0, 100.0, 0.0], [0, 0, 0, 0, 0.0, 1e-40]],
        dtype=np.float32,
    )
    torque = np.full(3, 5.0, dtype=np.float32)
    limited = model_of(solution, document, control).limited_torque(torque, measured)
    assert limited == pytest.approx([0.8 * 3.0, 0.0, 0.0], abs=1e-6)
