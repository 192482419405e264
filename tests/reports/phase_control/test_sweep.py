"""Random machines on every topology, the emitted control in the loop: each one settles, or was
refused with a reason that holds.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from phase_sweep import (
    KINDS,
    Refusal,
    SweptDrive,
    decays,
    permitted,
    program,
    run,
    sampled_torque,
    swept,
)
from random_phase_drives import BASE, random_machine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.names import Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.simulation.recorded_run import Summary

MACHINES = 500
SOME = 2  # Drives of every program that are tried in further ways.
Groups = dict[tuple[Any, ...], list[SweptDrive]]


@pytest.fixture(scope="module")
def solution() -> Solution:
    return solve(catalogue.load(BASE))


@pytest.fixture(autouse=True)
def coarse_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few nodes of the torque limit's table: drives ask for the torque at their own speed."""
    room = "dqforge.optimizer.phase_control.phase_controller"
    for name, value in (("SPEEDS", 3), ("LINKS", (0.0, 1.0)), ("_SCAN", 9), ("_FINE", (1, 1))):
        monkeypatch.setattr(f"{room}.{name}", value)


def sorted_out(seeds: Iterable[int], topology: Topology) -> tuple[Groups, list[Refusal]]:
    """Accepted drives by the program that they need, and refused ones."""
    groups: Groups = defaultdict(list)
    refused: list[Refusal] = []
    for seed in seeds:
        found = swept(random_machine(seed), topology)
        if isinstance(found, Refusal):
            refused.append(found)
        else:
            groups[found.key].append(found)
    return groups, refused


def torque_errors(drives: list[SweptDrive], figures: Summary) -> FloatArray:
    """Mean torque over that of currents that meet their references at the samples, less 1."""
    wanted = np.array([sampled_torque(drive) for drive in drives])
    return np.asarray(figures.tail_torque / wanted - 1.0)


def balances(figures: Summary) -> FloatArray:
    """Energy that is neither turned into heat or work nor stored, over that which is turned."""
    scale = figures.e_copper + np.abs(figures.e_shaft)
    stored = figures.e_magnetic + figures.e_midpoint
    kept = figures.e_in - figures.e_copper - figures.e_shaft
    return np.asarray(np.abs(kept - stored) / scale)


def allowed(drive: SweptDrive) -> float:
    """Error of the mean torque: below 16 samples per period nothing learns most of the harmonics
    of phases that differ.
    """
    samples = 2.0 * np.pi / abs(drive.omega_e * drive.drawn.t_s)
    return 0.03 if samples < 16.0 and drive.drawn.winding == "unlike" else 5e-3


def faults(drives: list[SweptDrive], figures: Summary) -> list[str]:
    """What is wrong with each drive that does not settle on its torque, or loses energy."""
    errors, lost = torque_errors(drives, figures), balances(figures)
    return [
        f"machine {drive.drawn.seed}, {drive.control.frame}: torque off by {error:.2g}, energy "
        f"by {energy:.1g}, {'bounded' if bounded else 'beyond all bounds'}"
        for drive, error, energy, bounded in zip(drives, errors, lost, figures.bounded, strict=True)
        if not (bounded and abs(error) < allowed(drive) and energy < 1e-6)
    ]


def pulses_are_small(drive: SweptDrive, neutral: float) -> bool:
    """Whether pulses leave the mean alone: none drive a current (r.m.s.), beside that of the load,
    through the diodes of a neutral, none meet the resonance of a split link with L_0 above a
    fortieth of the sampling.
    """
    inverter, t_s = drive.design.inverter, drive.drawn.t_s
    if TOPOLOGIES[inverter.topology].diodes:
        return neutral < 0.01 * abs(drive.drawn.share) * drive.design.i_max
    if inverter.midpoint_capacitance is None:
        return True
    square = drive.control.inductances[2] * inverter.midpoint_capacitance / 3.0
    return t_s < 2.0 * math.pi * math.sqrt(square) / 40.0


QUICK = ("four-leg",)


@pytest.mark.thinned
@pytest.mark.parametrize(
    "topology",
    [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in TOPOLOGIES],
)
def test_ten_machines_settle(topology: Topology, solution: Solution) -> None:
    groups, refused = sorted_out((0, 1, 2, 5, 6, 7, 10, 11, 12, 30), topology)
    assert sum(map(len, groups.values())) + len(refused) == 10
    most = max(groups.values(), key=len)
    assert len(most) >= 4
    with program(solution, most[0]) as compiled:
        assert faults(most, run(solution, compiled, most)) == []


@pytest.mark.slow
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_machine_settles_or_was_refused(
    topology: Topology, solution: Solution, tmp_path: Path
) -> None:
    """Mean torque and energy of all; of some of every program the decay in time against the
    radius, ripple that does not grow, and the switched inverter against the averaged one.
    """
    groups, refused = sorted_out(range(MACHINES), topology)
    kinds = Counter(found.kind for found in refused)
    found: list[str] = []
    for place, drives in enumerate(groups.values()):
        with program(solution, drives[0]) as compiled:
            figures = run(solution, compiled, drives)
            found += faults(drives, figures)
            some = drives[:SOME]
            later = run(solution, compiled, some, lengths=8)
            switched = run(solution, compiled, some, "switched")
        (tmp_path / str(place)).mkdir()
        left = decays(tmp_path / str(place), solution, drives[::4])
        found += [
            f"machine {drive.drawn.seed}: radius {decay.radius:.4f}, in time {decay.in_time:.4f}"
            for drive, decay in zip(drives[::4], left, strict=True)
            if not decay.agrees
        ]
        for row, drive in enumerate(some):
            torque = figures.tail_torque[row]
            if later.tail_ripple[row] > 1.05 * figures.tail_ripple[row] + 1e-3 * abs(torque):
                found.append(f"machine {drive.drawn.seed}: its ripple grows")
            off = abs(switched.tail_torque[row] - torque) > 0.01 * abs(torque)
            if off and pulses_are_small(drive, switched.tail_neutral_rms[row]):
                found.append(
                    f"machine {drive.drawn.seed}: {switched.tail_torque[row] / torque - 1:.2g} "
                    "when switched"
                )
    assert found == [], kinds
    assert sum(map(len, groups.values())) + len(refused) == MACHINES
    assert len(refused) < (0.5 if TOPOLOGIES[topology].midpoint else 0.3) * MACHINES, kinds


@pytest.mark.slow
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_refusals_hold(topology: Topology, solution: Solution, tmp_path: Path) -> None:
    """What is refused as unstable does not decay; a torque well beyond the link's is not made.

    The limit of the torque is the least of either sign and sense; only those count that ask for
    more voltage than there is with their own.
    """
    _, refused = sorted_out(range(0, MACHINES, 5), topology)
    drives = {
        kind: [found.drive for found in refused if found.drive and found.kind == kind]
        for kind in KINDS
    }
    for place, drive in enumerate(drives["unstable"][:5]):
        (tmp_path / str(place)).mkdir()
        (decay,) = decays(tmp_path / str(place), solution, [drive], slowest=True)
        assert decay.in_time > 1.0 - 1e-3
    beyond: Groups = defaultdict(list)
    for drive in drives["torque"]:
        if excess(drive) > 1.05 and drive.drawn.load > 1.05:
            beyond[drive.key].append(drive)
    assert beyond
    for some in beyond.values():
        with program(solution, some[0]) as compiled:
            errors = torque_errors(some, run(solution, compiled, some))
        assert np.all(np.abs(errors) > 5e-3)


def excess(drive: SweptDrive) -> float:
    """Torque over the largest that the whole region would permit."""
    return abs(drive.torque) / max(permitted(drive, 0.0), 1e-9)
