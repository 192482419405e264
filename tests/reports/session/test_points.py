"""Operating points asked for in Python, against closed forms and against the command line."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import dqforge
from dqforge import cli
from dqforge.reports.pages.templating import to_text

P, R_S, L_D, L_Q, PSI = 4, 0.02, 350e-6, 592e-6, 0.1049
MACHINE = dqforge.LinearMachine(pole_pairs=P, r_s=R_S, l_d=L_D, l_q=L_Q, psi_pm=PSI, i_max=300.0)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    """What a command prints with --json."""
    with pytest.raises(SystemExit) as end:
        cli.main([*arguments, "--json"])
    assert end.value.code == 0
    return json.loads(capsys.readouterr().out)


def rounded(plain: dict[str, Any]) -> Any:
    """Plain data as --json prints them."""
    return json.loads(to_text("", "", {"found": plain}))["found"]


def test_mtpa_is_the_closed_form() -> None:
    """Paper 000: per unit i_d = 1 - sqrt(1 + i_q^2) and T = i_q (2 - i_d);
    far below the voltage limit.
    """
    i_base = PSI / (2.0 * (L_Q - L_D))
    torque_base = 0.75 * P * PSI * i_base
    i_q = np.linspace(-1.2, 1.2, 25)
    i_d = 1.0 - np.sqrt(1.0 + i_q**2)
    points = dqforge.operating_points(MACHINE, torque_base * i_q * (2.0 - i_d), 10.0, v_dc=500.0)
    assert np.all(points.reached)
    np.testing.assert_allclose(points.i_d, i_base * i_d, rtol=1e-9, atol=1e-9 * i_base)
    np.testing.assert_allclose(points.i_q, i_base * i_q, rtol=1e-9, atol=1e-9 * i_base)
    np.testing.assert_allclose(
        points.copper_loss, 1.5 * R_S * i_base**2 * (i_d**2 + i_q**2), rtol=1e-9, atol=1e-9
    )


def test_beyond_the_base_speed_the_voltage_is_at_its_limit() -> None:
    """Voltage and torque worked out here from the currents; svpwm gives v_dc / sqrt(3)."""
    omega_m = np.array([600.0, 800.0, 1000.0])
    points = dqforge.operating_points(MACHINE, 60.0, omega_m, v_dc=400.0, margin=0.1)
    psi_d, psi_q = PSI + L_D * points.i_d, L_Q * points.i_q
    omega_e = P * omega_m
    amplitude = np.hypot(R_S * points.i_d - omega_e * psi_q, R_S * points.i_q + omega_e * psi_d)
    assert points.held_by.tolist() == ["voltage"] * 3
    np.testing.assert_allclose(amplitude, 0.9 * 400.0 / np.sqrt(3.0), rtol=1e-9)
    np.testing.assert_allclose(1.5 * P * (psi_d * points.i_q - psi_q * points.i_d), 60.0, rtol=1e-9)
    power = 60.0 * omega_m
    np.testing.assert_allclose(points.efficiency, power / (power + points.copper_loss), rtol=1e-12)


def test_arrays_have_the_common_shape() -> None:
    torque, omega_m = np.linspace(10.0, 90.0, 5), np.linspace(0.0, 900.0, 4)
    grid = dqforge.operating_points(MACHINE, torque[:, None], omega_m[None, :], v_dc=400.0)
    assert grid.i_d.shape == grid.held_by.shape == grid.efficiency.shape == (5, 4)
    one = dqforge.operating_points(MACHINE, float(torque[3]), float(omega_m[2]), v_dc=400.0)
    assert one.i_d.shape == ()
    assert one.i_d == grid.i_d[3, 2]
    assert dqforge.operating_points(MACHINE, [], v_dc=400.0).i_d.shape == (0,)


def test_a_flux_map_of_a_linear_machine_is_that_machine() -> None:
    i_d, i_q = np.linspace(-320.0, 20.0, 18), np.linspace(0.0, 320.0, 17)
    grid_d, grid_q = np.meshgrid(i_d, i_q, indexing="ij")
    flux_map = dqforge.make_flux_map(i_d, i_q, PSI + L_D * grid_d, L_Q * grid_q)
    machine = dqforge.SaturatedMachine(pole_pairs=P, r_s=R_S, flux_map=flux_map, i_max=300.0)
    torque, omega_m = np.linspace(5.0, 120.0, 6)[:, None], np.array([100.0, 500.0, 800.0])
    found = dqforge.operating_points(machine, torque, omega_m, v_dc=400.0)
    expected = dqforge.operating_points(MACHINE, torque, omega_m, v_dc=400.0)
    np.testing.assert_array_equal(found.held_by, expected.held_by)
    np.testing.assert_allclose(found.i_d, expected.i_d, atol=1e-6)
    np.testing.assert_allclose(found.i_q, expected.i_q, atol=1e-6)
    limits = dqforge.characteristics(machine, v_dc=400.0)
    assert limits.torque_max == pytest.approx(
        dqforge.characteristics(MACHINE, v_dc=400.0).torque_max, rel=1e-9
    )


def test_limits_that_are_given_count_in_place_of_the_designs() -> None:
    design = dqforge.make_design(MACHINE, v_dc=500.0, f_sw=10e3)
    as_design = dqforge.operating_points(design, 80.0, [100.0, 700.0], v_dc=400.0, i_max=200.0)
    alone = dqforge.operating_points(MACHINE, 80.0, [100.0, 700.0], v_dc=400.0, i_max=200.0)
    np.testing.assert_array_equal(as_design.i_d, alone.i_d)
    assert as_design.limit.v_dc == 400.0
    np.testing.assert_array_less(np.hypot(as_design.i_d, as_design.i_q), 200.0 * (1.0 + 1e-9))


def test_points_are_those_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    name = "thor-pmsyrm-5k"
    arguments = (
        "--speed",
        "400 rad/s",
        "--torque",
        "12 N m",
        "--modulation",
        "spwm",
        "--margin",
        "5 %",
    )
    said = printed(capsys, "mtpa", name, *arguments)["operating_points"]
    points = dqforge.operating_points(
        dqforge.load_design(name), [12.0], 400.0, modulation="spwm", margin=0.05
    )
    found = rounded(points.plain())
    assert found["limit"] == said["limit"]
    assert found["points"].items() <= said["points"].items()
    assert found["losses"].items() <= said["losses"].items()
    assert found["efficiency"] == said["efficiency"]
    assert found["power_W"] == said["power_W"]


def test_the_map_is_that_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    name = "abb-ipmsm-2k2"
    said = printed(capsys, "mtpa", name, "--map", "4x5", "--objective", "total")["operating_map"]
    chart = dqforge.operating_map(dqforge.load_design(name), 4, 5, objective="total")
    assert rounded(chart.plain()) == said
    assert chart.points.i_d.shape == chart.efficiency.shape == (4, 5)
    np.testing.assert_array_equal(chart.points.torque_request[:, 0], chart.torque)


_AXIS = np.linspace(-10.0, 10.0, 5)
_D, _Q = np.meshgrid(_AXIS, _AXIS, indexing="ij")
FALLING = dqforge.FluxMap(_AXIS, _AXIS, 0.1 + 1e-3 * _D, -1e-3 * _Q)


REFUSALS: list[tuple[dict[str, Any], str]] = [
    ({"torque": "50 N m"}, "torque: expected numbers in N m, got '50 N m'"),
    (
        {"torque": [1.0, float("nan")]},
        r"torque: expected finite numbers in N m, got nan at index \(1,\)",
    ),
    ({"omega_m": float("inf")}, "omega_m: expected finite numbers in rad/s, got inf"),
    (
        {"torque": [1.0, 2.0], "omega_m": [1.0, 2.0, 3.0]},
        r"write torque\[:, None\] and omega_m\[None, :\]",
    ),
    ({"v_dc": None}, "v_dc: a machine alone has no voltage limit"),
    ({"v_dc": -400.0}, "v_dc: expected a positive number in V, got -400.0"),
    ({"i_max": 0.0}, "i_max: expected a positive number in A"),
    ({"modulation": "svm"}, "modulation: expected one of spwm"),
    ({"margin": 0.95}, "margin: expected a share"),
    ({"objective": "iron"}, "objective: expected copper or total, got 'iron'"),
    ({"drive": "ipm"}, "drive: expected a Design, a LinearMachine or a SaturatedMachine, got str"),
    (
        {"drive": dqforge.SaturatedMachine(4, 0.02, FALLING, 10.0)},
        "l_q: expected a positive number in SI units, got -0.001",
    ),
]


@pytest.mark.parametrize(("changes", "message"), REFUSALS)
def test_refusals_are_one_line(changes: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {
        "drive": MACHINE,
        "torque": 10.0,
        "omega_m": 10.0,
        "v_dc": 400.0,
    } | changes
    with pytest.raises(dqforge.InputError, match=message) as error:
        dqforge.operating_points(given.pop("drive"), given.pop("torque"), **given)
    assert "\n" not in str(error.value)


def test_a_map_needs_a_grid_that_can_be() -> None:
    given: list[Any] = [(1, 5), (5, 2001), (2.5, 5), (True, 5)]
    for sizes in given:
        with pytest.raises(dqforge.InputError, match="expected a whole number from 2 to 2000"):
            dqforge.operating_map(MACHINE, *sizes, v_dc=400.0)
    with pytest.raises(dqforge.NoSolutionError, match="even at standstill"):
        dqforge.operating_map(MACHINE, 3, 3, v_dc=1.0)


def test_a_design_with_another_strategy_is_refused_at_its_place() -> None:
    design = dqforge.make_design(MACHINE, v_dc=400.0, f_sw=10e3, operation={"strategy": "id0"})
    with pytest.raises(
        dqforge.InputError, match=r"design made in Python:\d+:\d+: operation.strategy"
    ):
        dqforge.operating_points(design, 10.0)
