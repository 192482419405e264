"""The control of phase machines in fixed point: compiled, it is its model bit for bit."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, get_args

import pytest
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.errors import InputError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit, fit_phase_control
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.emitted_integers import (
    phase_fixed_files,
    phase_fixed_programme,
    plain_phase_integers,
)
from dqforge.reports.phase_control.fixed_phase_model import (
    phase_integers_from,
    phase_outputs,
    phase_results,
    phase_rows,
)
from dqforge.reports.verification.host import verify_files

P, Z = near_sinusoidal(96), trapezoidal(96)

TORQUE_BASE = 6.0  # N m; asks for more current than the base, so that references reach both ends


@pytest.fixture(scope="module")
def design() -> Design:
    found = catalogue.load("paper002-phase-waveforms")
    bases = replace(found.control.bases, voltage=300.0, current=8.0, torque=TORQUE_BASE)
    speed_loop = SpeedLoopSettings(ratio=7, filter_time=5e-4)
    return replace(found, control=replace(found.control, bases=bases, speed_loop=speed_loop))


@pytest.fixture(scope="module")
def solution(design: Design) -> Solution:
    return solve(design)


def fitted(
    design: Design,
    machine: PhaseMachine,
    width: int = 16,
    speed: tuple[LoopGains, LoopGains] | None = None,
    **changes: Any,
) -> FixedPhaseFit:
    return fit_phase_control(design, plain_control(machine, **changes), width, speed)


def speed_gains(solution: Solution) -> tuple[LoopGains, LoopGains]:
    """Gains of the speed loop, and of the current loop below it."""
    assert solution.gains.speed is not None
    return solution.gains.speed, solution.gains.i_q


def _cases() -> list[Any]:
    found = []
    for topology in get_args(Topology):
        for frame in get_args(CurrentFrame):
            if frame == "dqy" and not TOPOLOGIES[topology].neutral:
                continue
            quick = (topology, frame) == ("four-leg", "dqy")
            marks = () if quick else (pytest.mark.slow,)
            found.append(pytest.param(topology, frame, "references", 16, marks=marks))
            if frame == "table":
                marks = () if topology == "three-wire" else (pytest.mark.slow,)
                found.append(pytest.param(topology, frame, "emf", 32, marks=marks))
    found.append(pytest.param("six-leg", "table", "none", 16, marks=pytest.mark.slow))
    return found


@pytest.mark.parametrize(("topology", "frame", "feedforward", "width"), _cases())
def test_compiled_code_is_the_model(
    design: Design,
    solution: Solution,
    topology: Topology,
    frame: CurrentFrame,
    feedforward: Feedforward,
    width: int,
) -> None:
    changes: Any = {"topology": topology, "frame": frame, "feedforward": feedforward}
    fit = fitted(design, Z, width, speed_gains(solution), **changes)
    verification = verify_files(
        header_files(solution) | phase_fixed_files(design, fit),
        design.export.prefix,
        solution.fit.reference,
        design.export.vectors,
        [phase_fixed_programme(fit.control)],
    )
    assert verification.languages == ("c99", "c++11")


@pytest.mark.parametrize("width", [16, 32])
def test_rows_reach_both_ends_of_what_a_torque_asks_for(
    design: Design, solution: Solution, width: int
) -> None:
    """Else a limit that model and C set differently would pass unseen."""
    control = fitted(design, Z, width, speed_gains(solution), topology="three-wire").control
    assert control.current_per_torque.value > 1.0
    results = phase_results(control, phase_rows(control, 2000, 1))
    asked = results[:, phase_outputs(control).index("sinusoid_q")]
    assert (asked.min(), asked.max()) == (-control.top - 1, control.top)


@pytest.mark.parametrize("unequal", [False, True])
def test_integers_are_read_back(design: Design, unequal: bool) -> None:
    machine = replace_phase(P) if unequal else P
    fit = fitted(design, machine, topology="split-capacitor")
    assert len(fit.control.shape) == (3 if unequal else 1)
    assert phase_integers_from(plain_phase_integers(fit.control), 16) == fit.control


def replace_phase(machine: PhaseMachine) -> PhaseMachine:
    """The machine with phase b at half its back-EMF."""
    flux = machine.flux.copy()
    flux[1] *= 0.5
    return PhaseMachine(
        machine.pole_pairs, machine.r_s, machine.l_s, machine.m_s, flux, machine.i_max
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("frame", "dqz"),
        ("shape", [[1, 2, 3]]),
        ("turns", 0),
        ("width", 32),
        ("harmonic_fraction", 40),
        ("bases", [1.0]),
        ("d", None),
        ("fade_end", True),
    ],
)
def test_foreign_data_are_refused(design: Design, key: str, value: Any) -> None:
    plain = copy.deepcopy(plain_phase_integers(fitted(design, P).control))
    plain[key] = value
    with pytest.raises(InputError, match="not what dqforge writes"):
        phase_integers_from(plain, 16)


def test_data_that_overflow_are_refused(design: Design) -> None:
    plain = copy.deepcopy(plain_phase_integers(fitted(design, P).control))
    plain["d"]["inductance"] = {"mantissa": 32767, "shift": 0, "value": 32767.0}
    with pytest.raises(InputError, match="not what dqforge writes"):
        phase_integers_from(plain, 16)
