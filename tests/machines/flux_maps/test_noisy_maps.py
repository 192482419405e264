"""Noisy flux maps of machines that the test knows: they load, tune, and give
currents as good as their noise.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import make_design
from noisy import NOISE, grid_points, mapped_design, noisy, scattered_points

from dqforge import cli
from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.control_design.gain_set import gains_or_reason, solve_gains
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.solution import solve
from dqforge.reports.main_header import header_context
from dqforge.reports.pages.templating import render
from dqforge.reports.report import other_assumptions, run_tables
from dqforge.reports.run import run_design

SATURATED = catalogue.load("baldor-pmsyrm-5k6").machine
NO_CONTROL = "fit: {form: polynomial}\n"


def least_current(machine: Machine, amplitude: FloatArray) -> FloatArray:
    """Largest torque in N m at current amplitudes in A by trying 7,200 directions:
    no solver of the package.
    """
    angle = np.linspace(0.0, np.pi, 7200)[:, np.newaxis]
    i_d, i_q = amplitude * np.cos(angle), amplitude * np.sin(angle)
    psi_d, psi_q = machine.flux(i_d, i_q)
    return np.asarray(np.max(1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d), axis=0))


def assert_mtpa_within_noise(design: Design, true: Machine) -> None:
    """The currents of the map make nearly the largest torque of the true machine,
    and nearly the one that it says.
    """
    chosen = solve_curves(design).chosen
    part = chosen.torque > 0.05 * chosen.torque[-1]
    i_d, i_q, says = chosen.i_d[part], chosen.i_q[part], chosen.torque[part]
    makes = true.torque(i_d, i_q)
    most = least_current(true, np.hypot(i_d, i_q))
    assert np.max(most - makes) < NOISE * most[-1]
    assert np.max(np.abs(says - makes)) < NOISE * most[-1]


def assert_tuned(design: Design, true: Machine) -> None:
    """Both current loops are tuned for inductances near the true ones."""
    gains = solve_gains(design)
    locus = mtpa_locus(design.machine, design.i_max)
    jet = true.jet(locus.i_d, locus.i_q)
    for loop, least in ((gains.i_d, np.min(jet.l_dd)), (gains.i_q, np.min(jet.l_qq))):
        assert loop.kp > 0.0
        assert loop.stable
        assert loop.inductance == pytest.approx(float(least), rel=0.35)


@pytest.mark.thinned
@pytest.mark.parametrize("name", catalogue.names())
def test_a_map_of_each_library_machine_with_noise_loads_tunes_and_gives_its_mtpa(
    name: str, tmp_path: Path
) -> None:
    true = catalogue.load(name).machine
    design = load_design(mapped_design(tmp_path, true, noisy(grid_points(true), 7)))
    (evidence,) = design.flux_evidence
    assert evidence.fit.used == "smooth"
    assert isinstance(design.machine, SaturatedMachine)
    assert_tuned(design, true)
    assert_mtpa_within_noise(design, true)


@pytest.mark.thinned
@pytest.mark.parametrize("kind", ["half plane", "scattered", "fine", "coarse"])
def test_noise_is_smoothed_whatever_the_layout_of_the_points(kind: str, tmp_path: Path) -> None:
    points = {
        "half plane": lambda: grid_points(SATURATED, (21, 14), half=True),
        "scattered": lambda: scattered_points(SATURATED, 600, 3),
        "fine": lambda: grid_points(SATURATED, (41, 51)),
        "coarse": lambda: grid_points(SATURATED, (15, 17)),
    }[kind]()
    design = load_design(mapped_design(tmp_path, SATURATED, noisy(points, 11)))
    assert design.flux_evidence[0].fit.used == "smooth"
    assert_tuned(design, SATURATED)
    assert_mtpa_within_noise(design, SATURATED)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("name", catalogue.names())
def test_noise_of_many_seeds(name: str, seed: int, tmp_path: Path) -> None:
    true = catalogue.load(name).machine
    design = load_design(mapped_design(tmp_path, true, noisy(grid_points(true), 100 + seed)))
    assert_tuned(design, true)
    assert_mtpa_within_noise(design, true)


def test_without_smoothing_the_same_map_is_refused_and_every_place_is_named_or_counted(
    tmp_path: Path,
) -> None:
    path = mapped_design(
        tmp_path,
        SATURATED,
        noisy(grid_points(SATURATED, (41, 51)), 5, 0.05),
        keys=", fit: interpolate",
    )
    with pytest.raises(
        InputError,
        match=r"it does in \d+ places \((i_d = .* A, i_q = .* A; ){8}and \d+ more\).*fit: smooth",
    ):
        load_design(path)


def test_clean_maps_stay_as_they_are(tmp_path: Path) -> None:
    points = grid_points(SATURATED)
    automatic = load_design(mapped_design(tmp_path, SATURATED, points))
    plain = load_design(mapped_design(tmp_path, SATURATED, points, keys=", fit: interpolate"))
    assert automatic.flux_evidence[0].fit.used == "interpolate"
    assert isinstance(automatic.machine, SaturatedMachine)
    assert isinstance(plain.machine, SaturatedMachine)
    np.testing.assert_array_equal(automatic.machine.flux_map.psi_d, plain.machine.flux_map.psi_d)
    np.testing.assert_array_equal(automatic.machine.flux_map.psi_q, plain.machine.flux_map.psi_q)
    assert [s for s in automatic.assumptions if "smooth" in s] == []


def test_outliers_are_all_named_and_gone_once_they_are_removed(tmp_path: Path) -> None:
    """What is left after the named points are taken out of the file loads:
    nothing is named twice.
    """
    i_d, i_q, psi_d, psi_q = noisy(grid_points(SATURATED), 2)
    wrong = np.array([30, 111, 283, 404, 505])
    psi_q = psi_q.copy()
    psi_q[wrong] += 0.5 * np.max(psi_q)
    with pytest.raises(InputError, match="5 points lie far from the smooth map") as caught:
        load_design(mapped_design(tmp_path, SATURATED, (i_d, i_q, psi_d, psi_q)))
    for index in wrong:
        assert f"i_d = {i_d[index]:.4g} A, i_q = {i_q[index]:.4g} A" in str(caught.value)
    rest = tuple(np.delete(part, wrong) for part in (i_d, i_q, psi_d, psi_q))
    assert_mtpa_within_noise(load_design(mapped_design(tmp_path, SATURATED, rest)), SATURATED)


def dented_points() -> tuple[FloatArray, ...]:
    """A map whose d inductance is negative in one cell of the MTPA locus,
    though psi_d hardly falls anywhere.
    """
    shape = (41, 27)
    i_d, i_q, psi_d, psi_q = grid_points(SATURATED, shape)
    dented = psi_d.copy().reshape(shape)
    for column in (8, 18):
        rise = dented[13, column] - dented[12, column]
        dented[12, column] += 0.56 * rise
        dented[13, column] -= 0.56 * rise
    return i_d, i_q, dented.ravel(), psi_q


def test_a_reference_needs_no_loops(tmp_path: Path) -> None:
    """No gains hold for one negative inductance; without a section control the
    header holds the reference.
    """
    plain = ", fit: interpolate"
    wanted = load_design(mapped_design(tmp_path, SATURATED, dented_points(), keys=plain))
    with pytest.raises(NoSolutionError, match=r"control.current_loop: .* both must be positive"):
        gains_or_reason(wanted)
    unwanted = mapped_design(
        tmp_path, SATURATED, dented_points(), keys=plain, control="control: {gains: false}\n"
    )
    assert gains_or_reason(load_design(unwanted)) == (None, "control.gains is false")
    unasked = mapped_design(tmp_path, SATURATED, dented_points(), keys=plain, control=NO_CONTROL)
    loops, reason = gains_or_reason(load_design(unasked))
    assert loops is None
    assert reason.startswith("no loop was requested and none was found: control.current_loop")


@pytest.mark.slow
def test_a_run_without_loops_says_so_and_holds_the_reference() -> None:
    """A linear machine, for speed, with gains that cannot be.

    The header is compiled and compared as any other.
    """
    design = make_design(prefix="alone")
    loop = replace(design.control.current_loop, method="damping", bandwidth=1.0)
    control = replace(design.control, current_loop=loop, speed_loop=None, observer=None)
    with pytest.raises(NoSolutionError, match="gives the i_d loop kp = -"):
        solve(replace(design, control=control))
    output = run_design(replace(design, control=replace(control, gains="optional")), verify=True)
    header = output.files["alone.h"].decode()
    assert "alone_current_reference(" in header
    assert "_KP_" not in header
    assert "No controllers" in header
    assert "There are no control loops" in output.files["report.html"].decode()
    assert 'id="loops"' not in output.files["report.html"].decode()
    assert '"gains": null' in output.files["result.json"].decode()
    (row,) = (
        row
        for table in run_tables(output.solution, None)
        for row in table.rows
        if row[1].startswith("there are no control loops")
    )
    assert "none was found: control.current_loop" in row[1]
    with pytest.raises(InputError, match="this needs gains"):
        _ = output.solution.gains


def test_a_dent_is_smoothed_by_itself(tmp_path: Path) -> None:
    design = load_design(mapped_design(tmp_path, SATURATED, dented_points()))
    fit = design.flux_evidence[0].fit
    assert fit.used == "smooth"
    assert fit.fault_count > 0
    assert "the plain spline is not admissible" in " ".join(design.assumptions)
    assert solve_gains(design).i_d.kp > 0.0


def test_what_needs_gains_refuses_to_do_without(tmp_path: Path) -> None:
    text = (
        "control: {gains: false, current_loop: {method: bandwidth, bandwidth: 300 Hz, schedule: "
        "true}}\n"
    )
    with pytest.raises(
        InputError, match=r"control.gains is false, but the speed loop, observer, schedule"
    ):
        load_design(mapped_design(tmp_path, SATURATED, grid_points(SATURATED), control=text))


@pytest.mark.slow
def test_the_price_of_smoothing_is_told_everywhere_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = mapped_design(tmp_path, SATURATED, noisy(grid_points(SATURATED), 7))
    design = load_design(path)
    (evidence,) = design.flux_evidence
    price = next(s for s in evidence.sentences() if s.startswith("cost of smoothing"))
    with pytest.raises(SystemExit):
        cli.main(["check", str(path)])
    assert price in " ".join(capsys.readouterr().out.split())
    with pytest.raises(SystemExit):
        cli.main(["check", str(path), "--json"])
    (plain,) = json.loads(capsys.readouterr().out)["input"]["flux_maps"]
    assert plain["fit"]["used"] == "smooth"
    assert plain["fit"]["torque_largest"] == pytest.approx(evidence.torque_residual[1], rel=1e-8)
    solution = solve(design)
    largest = format_quantity(evidence.torque_residual[1], "N m", 3)
    assert f"at most {largest} from that of the plain spline" in render(
        "c_code/main_header.h.j2", header_context(solution)
    )
    (row,) = (
        row
        for table in run_tables(solution, None)
        for row in table.rows
        if "cost of smoothing" in row[1]
    )
    assert price in row[1]
    assert any(price in sentence for sentence in other_assumptions(design))
