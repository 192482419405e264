"""The choice of the smallest integer reference, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from weakened_drives import CASES, domain, line_fit, weakened_design, weakened_fit

from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.fixed_control.design import dc_link
from dqforge.optimizer.fixed_reference import fit
from dqforge.optimizer.fixed_reference.fit import (
    _even,
    fit_line,
    fit_mesh,
    in_integers,
    line_nodes,
    mesh_nodes,
    row_ways,
    solve_fixed_references,
    weakened_errors,
    weakened_targets,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.steps.integer_arithmetic import Integers


@pytest.mark.slow
def test_a_wider_budget_takes_a_smaller_mesh() -> None:
    design = weakened_design("small ipm")
    assert design.weakening is not None
    loose = replace(design, weakening=replace(design.weakening, torque_error=0.02))
    small = fit_mesh(loose, domain("small ipm"), np.inf, 16, dc_link(design, 16))
    usual = weakened_fit("small ipm", 16)
    assert small.reference.table_bytes < usual.reference.table_bytes < 1000
    assert usual.errors.torque_relative <= 0.005 < small.errors.torque_relative <= 0.02


def test_a_budget_that_nothing_keeps_is_refused_with_what_to_write() -> None:
    design, speed = weakened_design("interior"), CASES["interior"][2]
    narrow = replace(design, weakening=WeakeningSettings(speed, torque_error=1e-6))
    with pytest.raises(NoSolutionError, match=r"16 bits keeps the permitted errors.*torque_error"):
        fit_mesh(narrow, domain("interior"), np.inf, 16, dc_link(design, 16))


def test_a_torque_that_is_lost_in_its_full_scale_is_refused() -> None:
    design = weakened_design("interior")
    bases = replace(design.control.bases, torque=1e6)
    lost = replace(design, control=replace(design.control, bases=bases))
    with pytest.raises(NoSolutionError, match=r"per_unit\.torque.*write torque: 257 N m"):
        fit_mesh(lost, domain("interior"), np.inf, 16, dc_link(design, 16))


def test_halves_of_a_flux_map_have_none() -> None:
    """One mesh cannot serve two halves; the current control is there all the same."""
    design = weakened_design("interior")
    asked = replace(
        design, export=replace(design.export, control=("float32", "q15")), weakening=None
    )
    fit = solve_fit(asked).fit
    assert [found.reference.width for found in solve_fixed_references(asked, fit, None)] == [16]
    both = replace(asked, halves=(design.machine, design.machine))
    assert solve_fixed_references(both, fit, None) == ()


def test_a_full_scale_below_the_largest_torque_ends_the_reference_there() -> None:
    design = weakened_design("interior")
    bases = replace(design.control.bases, torque=100.0)
    short = replace(design, control=replace(design.control, bases=bases))
    most = domain("interior").flux.torque_max
    found = fit_line(short, current_choice(short), most, 0.0, 16)
    assert most > 200.0
    assert found.reference.end == 2**15 - 1
    assert found.errors.torque_relative < 0.0011


def test_errors_of_finer_meshes_fall() -> None:
    """By the square of the cells: twice as many in either direction take at least a third."""
    design, region = weakened_design("inverse"), domain("inverse").flux
    errors = []
    for shape in ((8, 4), (16, 8), (32, 16)):
        nodes = mesh_nodes(region, row_ways(region, region.torque_max), shape)
        mesh = in_integers(design, nodes, 32, dc_link(design, 32))
        targets = weakened_targets(design, mesh, 0.9 * CASES["inverse"][2])
        errors.append(weakened_errors(design, mesh, targets).torque_relative)
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.4 * errors[1]


def test_a_row_lies_at_the_corner_of_the_domain() -> None:
    """The largest torque at the least flux linkage is a row, and no node leaves the limits."""
    region = domain("small ipm").flux
    nodes = mesh_nodes(region, row_ways(region, region.torque_max), (8, 4))
    corner = float(region.largest_torque(np.array([region.flux_min]))[0])
    assert np.min(np.abs(nodes.torque - corner)) < 1e-9 * corner
    assert np.max(np.hypot(nodes.i_d, nodes.i_q)) < region.i_max * (1.0 + 1e-9)
    assert np.min(region.flux(nodes.i_d, nodes.i_q)) > region.flux_min * (1.0 - 1e-6)
    made = region.machine.torque(nodes.i_d, nodes.i_q)
    assert np.max(np.abs(made - nodes.torque[:, np.newaxis])) < 1e-6 * region.torque_max


def test_ways_rise_from_rest_to_their_end_whether_they_turn_a_corner_or_not() -> None:
    """Each part begins where the one before ended, at no current; the lengths rise with it."""
    region = domain("small ipm").flux
    corner = float(region.largest_torque(np.array([region.flux_min]))[0])
    for end, parts in ((0.5 * corner, 1), (region.torque_max, 2)):
        ways = row_ways(region, end)
        assert len(ways.torque) == parts
        torque, length = (np.concatenate(arrays) for arrays in (ways.torque, ways.length))
        assert (torque[0], length[0]) == (0.0, pytest.approx(0.0, abs=1e-9))
        assert torque[-1] == pytest.approx(end, rel=1e-12)
        assert np.min(np.diff(torque)) > -1e-9 * end
        assert float(np.max(torque)) <= end * (1.0 + 1e-12)


def test_ways_are_divided_evenly_and_nodes_keep_apart_where_currents_rest() -> None:
    at = np.linspace(2.0, 10.0, 81)
    assert _even(3.0 * (at - 2.0), at, 4) == pytest.approx([2.0, 4.0, 6.0, 8.0, 10.0], rel=1e-12)
    rests = np.maximum(at - 6.0, 0.0)
    nodes = _even(rests, at, 4)
    assert nodes[[0, -1]] == pytest.approx([2.0, 10.0])
    assert np.all(np.diff(nodes) > 0.0)
    assert nodes[1:] == pytest.approx([7.0, 8.0, 9.0, 10.0], abs=0.01)


def test_rows_crowd_where_currents_rise_like_a_root() -> None:
    """Without magnets the currents go with the root of the torque: even steps of the currents."""
    nodes = line_nodes(lambda t: (np.sqrt(t), np.sqrt(t)), 1.0, 16)
    steps = np.diff(nodes.i_q[:, 0])
    assert np.max(steps) < 1.1 * np.min(steps)
    assert line_fit("reluctance", 16).reference.torque[1] < 2**15 / 300


def test_a_way_is_divided_evenly_where_it_goes_on_and_nodes_stay_apart_where_it_rests() -> None:
    """At rest over the first half of the torque, straight over the second: as a part of the way
    counts a thousandth of the torque, 500 to 1 over each half.
    """
    at = np.linspace(0.0, 4.0, 401)
    nodes = fit._even(np.maximum(at - 2.0, 0.0), at, 12)
    assert np.all(np.diff(nodes) > 0.0)
    assert nodes[[0, -1]] == pytest.approx([0.0, 4.0], abs=1e-12)
    straight = np.diff(nodes[nodes >= 2.0])
    np.testing.assert_allclose(straight, 2.0 / 12.0 * 1.001 / 1.0005, rtol=1e-9)
    np.testing.assert_allclose(fit._even(0.0 * at, at, 4), [0.0, 1.0, 2.0, 3.0, 4.0], atol=1e-12)


def test_squared_voltages_are_those_of_the_nodes_rounded_upwards() -> None:
    """At the last node of each row and speeds of both signs, per unit, within the codes that flux,
    speed and drop are rounded by.
    """
    design, region = weakened_design("small ipm"), domain("small ipm").flux
    nodes = mesh_nodes(region, row_ways(region, region.torque_max), (8, 4))
    for width in (16, 32):
        mesh = in_integers(design, nodes, width, dc_link(design, width))
        assert mesh.voltage is not None
        bases, machine, one = design.control.bases, design.machine, 2 ** (width - 1)
        row, along = (
            part.ravel()
            for part in np.meshgrid(
                np.arange(9), np.rint(np.linspace(-0.9, 0.9, 7) * one).astype(int)
            )
        )
        square = -(-(along**2) // one)
        found = (
            mesh.reference_end(Integers(), row, square, along) / one**2 * 2.0**mesh.voltage.shift
        )
        place = row * mesh.columns + mesh.columns - 1
        i_d, i_q = (np.array(part)[place] * bases.current / one for part in (mesh.d, mesh.q))
        omega_m, torque = along * bases.speed / one, np.array(mesh.torque)[row] * bases.torque / one
        psi = np.hypot(*machine.flux(i_d, i_q))
        parts = (
            (machine.pole_pairs * omega_m * psi) ** 2,
            (machine.r_s * np.hypot(i_d, i_q)) ** 2,
            2.0 * machine.r_s * omega_m * torque / 1.5,
        )
        away = found - sum(parts) / bases.voltage**2
        code = 2.0**mesh.voltage.shift / one
        assert np.min(away) > -0.1 * code
        assert np.max(away) < 3.0 * code


def test_squared_voltages_are_shifted_as_little_as_their_sums_permit() -> None:
    """Twice the induced one, four times the heat and twice the drop stay below full scale."""
    for parts in ((0.3, 0.01, 0.02), (0.5, 0.2, 0.1), (0.51, 0.0, 0.0), (3.0, 0.6, 40.0)):
        shift = fit._shift(*parts)
        most = max(2.0 * parts[0], 4.0 * parts[1], 2.0 * parts[2])
        assert most <= 2.0**shift
        assert shift == 0 or most > 2.0 ** (shift - 1)
    assert fit._shift(0.0, 0.26, 0.0) == 1
    assert fit._shift(0.0, 0.0, 2.0**19) == 20
    with pytest.raises(NoSolutionError, match="more than a thousand times"):
        fit._shift(0.0, 0.0, 1.01 * 2.0**19)


def test_a_drop_that_is_too_small_to_count_is_none_and_one_too_large_is_refused() -> None:
    assert fit._drop_gain(0.7, 16).realised == pytest.approx(0.7, rel=1e-4)
    assert fit._drop_gain(1e-12, 16) == FixedGain(0, 0, 1e-12)
    with pytest.raises(NoSolutionError):
        fit._drop_gain(1e9, 16)
