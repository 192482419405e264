"""The control of phase machines in fixed point: compiled, it is its model bit for bit."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any, get_args

import pytest
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit, fit_phase_control
from dqforge.optimizer.solution import solve
from dqforge.reports.main_header.header import header_files
from dqforge.reports.phase_control.fixed_phase_header import (
    phase_fixed_files,
    phase_fixed_programme,
    plain_phase_integers,
)
from dqforge.reports.phase_control.fixed_phase_reading import phase_integers_from
from dqforge.reports.verification.host import verify_files

P, Z = near_sinusoidal(96), trapezoidal(96)


@pytest.fixture(scope="module")
def design() -> Design:
    found = catalogue.load("paper002-phase-waveforms")
    bases = replace(found.control.bases, voltage=300.0, current=8.0)
    return replace(found, control=replace(found.control, bases=bases))


@pytest.fixture(scope="module")
def main_header(design: Design) -> tuple[dict[str, bytes], Any]:
    solution = solve(design)
    return header_files(solution), solution.fit.reference


def fitted(design: Design, machine: PhaseMachine, width: int = 16, **changes: Any) -> FixedPhaseFit:
    return fit_phase_control(design, plain_control(machine, **changes), width)


def _cases() -> list[Any]:
    found = []
    for topology in get_args(Topology):
        for frame in get_args(CurrentFrame):
            if frame == "dqy" and not TOPOLOGIES[topology].neutral:
                continue
            quick = (topology, frame) in (("four-leg", "dqy"), ("split-capacitor", "table"))
            marks = () if quick else (pytest.mark.slow,)
            found.append(pytest.param(topology, frame, "references", 16, marks=marks))
            if frame == "table":
                found.append(pytest.param(topology, frame, "emf", 32, marks=pytest.mark.slow))
    found.append(pytest.param("six-leg", "table", "none", 16, marks=pytest.mark.slow))
    return found


@pytest.mark.parametrize(("topology", "frame", "feedforward", "width"), _cases())
def test_compiled_code_is_the_model(
    design: Design,
    main_header: tuple[dict[str, bytes], Any],
    topology: Topology,
    frame: CurrentFrame,
    feedforward: Feedforward,
    width: int,
) -> None:
    fit = fitted(design, Z, width, topology=topology, frame=frame, feedforward=feedforward)
    files, reference = main_header
    verification = verify_files(
        files | phase_fixed_files(design, fit),
        design.export.prefix,
        reference,
        design.export.vectors,
        [phase_fixed_programme(fit.control)],
    )
    assert verification.languages == ("c99", "c++11")


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
