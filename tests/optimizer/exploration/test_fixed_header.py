"""A header as it is emitted."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design
from six_step_drives import bench

from dqforge.machines.errors import InputError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.exploration.yields import FixedLoop, nominal_header


def test_a_nominal_header_is_the_fit_and_the_gains_of_the_design_in_single_precision() -> None:
    design = make_design()
    header, gains = nominal_header(design), solve_gains(design)
    fit = solve_fit(design).fit
    torque = np.linspace(0.0, fit.torque_max, 97)
    found, expected = header.reference.currents(torque), fit.reference.currents(torque)
    assert np.array_equal(found[0], expected[0])
    assert np.array_equal(found[1], expected[1])
    assert header.i_d is not None
    assert header.i_q is not None
    for loop, single in ((header.i_d, gains.i_d), (header.i_q, gains.i_q)):
        assert loop.kp == float(np.float32(single.kp))
        assert loop.ki_ts == float(np.float32(single.ki_ts))
        assert loop.ki == pytest.approx(single.ki, rel=1e-7)
        assert loop.t_s == single.t_s
    assert header.v_dc == design.inverter.v_dc
    assert header.torque_max == pytest.approx(fit.torque_max, rel=1e-7)
    assert header.digest == design.digest


def test_gains_are_rounded_as_the_header_rounds_them() -> None:
    loop = FixedLoop.emitted(0.1, 0.01, 1e-4)
    assert loop.kp == float(np.float32(0.1)) != 0.1
    assert loop.ki == float(np.float32(0.01)) / 1e-4


def test_a_header_is_small_on_its_way_to_a_worker() -> None:
    header = nominal_header(make_design())
    content = pickle.dumps(header)
    assert len(content) < 2000
    again = pickle.loads(content)
    torque = np.array([7.0])
    found, expected = again.reference.currents(torque), header.reference.currents(torque)
    assert np.array_equal(found[0], expected[0])


def test_a_loop_that_switches_the_bridge_leaves_the_reference_alone() -> None:
    design = make_design()
    loop = replace(design.control.current_loop, method="hysteresis", band=1.0)
    header = nominal_header(replace(design, control=replace(design.control, current_loop=loop)))
    assert header.i_d is header.i_q is None


def test_a_six_step_drive_has_no_header_to_hold_fixed() -> None:
    with pytest.raises(InputError, match="six-step drive has no reference over the torque"):
        nominal_header(bench())
