"""Loci of scaled flux maps against brute force over the angle, and against the single path."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.optimizer.exploration import sensitivities as module
from dqforge.optimizer.exploration.sensitivities import ScaledLoci, currents_on_loci, scaled_loci
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

DRIVES = ("baldor-pmsyrm-5k6", "abb-syrm-6k7-saturated")


@cache
def found(name: str) -> tuple[ScaledMachines, ScaledLoci]:
    """100 maps with every scale up to 20 % off, below the end of the data."""
    nominal = catalogue.load(name).machine
    assert isinstance(nominal, SaturatedMachine)
    rng = np.random.default_rng(5)
    names = ("magnet", "inductance_d", "inductance_q", "current")
    columns = {key: rng.uniform(0.8, 1.2, 100) for key in names}
    columns["i_max"] = nominal.i_max * rng.uniform(0.6, 0.8, 100)
    machines = ScaledMachines.varied(nominal, 100, columns)
    return machines, scaled_loci(machines)


def most_torque(machines: ScaledMachines, current: FloatArray) -> FloatArray:
    """Largest torque over all angles of currents (N,), by ever finer grids."""
    centre, width = np.full(machines.count, 0.5 * np.pi), 0.5 * np.pi
    for count in (721, 41, 41, 41, 41):
        angle = centre + np.linspace(-width, width, count)[:, np.newaxis]
        torque = machines.torque(current * np.cos(angle), current * np.sin(angle))
        best = np.argmax(torque, axis=0)
        centre, width = angle[best, np.arange(machines.count)], 3.0 * width / (count - 1)
    return np.asarray(np.max(torque, axis=0))


@pytest.mark.parametrize("name", DRIVES)
def test_no_angle_makes_more_torque_than_the_locus(name: str) -> None:
    machines, loci = found(name)
    assert np.all(loci.solved)
    assert loci.current.shape == (32, 100)
    assert np.max(loci.last_step) < 1e-12
    np.testing.assert_allclose(np.hypot(loci.i_d, loci.i_q), loci.current, rtol=1e-13)
    for level in (0, 5, 17, 31):
        ratio = most_torque(machines, loci.current[level]) / loci.torque[level]
        assert np.max(np.abs(ratio - 1.0)) < 1e-12


def test_steps_are_six_at_most() -> None:
    assert module._STEPS <= 6


@pytest.mark.parametrize("name", DRIVES)
def test_limits_and_currents_are_those_of_the_single_path(name: str) -> None:
    machines, loci = found(name)
    torque = np.linspace(0.0, 1.0, 8)[:, np.newaxis] * loci.torque_max
    i_d, i_q = currents_on_loci(machines, loci, torque)
    for row in (0, 41, 99):
        own = machines.machine(row)
        choice = CurrentChoice(own, "mtpa", own.i_max)
        assert loci.torque_max[row] == pytest.approx(choice.largest_torque(), rel=1e-12)
        single = choice.currents(torque[:, row])
        close = 1e-10 * own.i_max
        np.testing.assert_allclose(i_d[:, row], single[0], rtol=0.0, atol=close)
        np.testing.assert_allclose(i_q[:, row], single[1], rtol=0.0, atol=close)


@pytest.mark.parametrize("name", DRIVES)
def test_currents_make_their_torque_and_turn_with_its_sign(name: str) -> None:
    machines, loci = found(name)
    share = np.array([1e-4, 0.01, 0.2, 0.63, 1.0])[:, np.newaxis]
    i_d, i_q = currents_on_loci(machines, loci, share * loci.torque_max)
    made = machines.torque(i_d, i_q) / loci.torque_max
    np.testing.assert_allclose(made, np.broadcast_to(share, made.shape), rtol=0.0, atol=1e-10)
    other_d, other_q = currents_on_loci(machines, loci, -share * loci.torque_max)
    assert other_d.tobytes() == i_d.tobytes()
    assert other_q.tobytes() == (-i_q).tobytes()
    beyond = currents_on_loci(machines, loci, 1.01 * loci.torque_max[np.newaxis])
    assert np.all(np.isnan(beyond))


@pytest.mark.parametrize(("share", "kept"), [(0.5, True), (2.0, False)])
def test_a_torque_that_is_missed_by_more_than_rounding_is_none(share: float, *, kept: bool) -> None:
    """By 1e-10 of the limit torque; a machine that makes a little more than its jet says."""
    machines, loci = found(DRIVES[0])
    more = share * 1e-10 * loci.torque[-1]
    beside: Any = SimpleNamespace(
        count=machines.count,
        pole_pairs=machines.pole_pairs,
        jet=machines.jet,
        torque=lambda i_d, i_q: machines.torque(i_d, i_q) + more,
    )
    currents = currents_on_loci(beside, loci, 0.3 * loci.torque_max[np.newaxis])
    assert np.all(np.isfinite(currents) == kept)


def test_a_machine_has_the_same_bytes_in_any_batch() -> None:
    machines, loci = found(DRIVES[0])
    for row in (0, 50, 99):
        alone = scaled_loci(machines.taken(np.array([row])))
        for name in ("i_d", "i_q", "torque"):
            whole = np.ascontiguousarray(getattr(loci, name)[:, row])
            assert whole.tobytes() == getattr(alone, name).tobytes()


def test_a_locus_that_leaves_the_data_is_left_to_the_single_path() -> None:
    """Half the saturation current reaches twice as far into the map."""
    nominal = found(DRIVES[0])[0].nominal
    machines = ScaledMachines.varied(nominal, 2, {"current": [1.0, 0.5]})
    loci = scaled_loci(machines)
    assert loci.solved.tolist() == [True, False]
    assert np.isnan(loci.torque_max[1])
    assert loci.torque_max[0] > 0.0
    assert np.all(np.isnan(np.array(currents_on_loci(machines, loci, np.ones((1, 2))))[..., 1]))
