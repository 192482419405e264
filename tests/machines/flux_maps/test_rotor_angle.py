"""Maps over the rotor angle against a machine whose co-energy is known: its flux linkages, torque
and cogging come back from the file at every angle and current.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import turning_machine as machine
from turning_machine import AXIS_Q, PAIRS, TITLES, rows, text

from dqforge.machines.dq_machines.flux_map import FluxRipple
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import FluxMapReading, build_flux_map
from dqforge.machines.flux_maps.map_files import read_flux_points

SIXTY = np.arange(0.0, 60.0, 2.5)
RNG = np.random.default_rng(3)
AT = RNG.uniform(-28.0, 8.0, 60), RNG.uniform(-38.0, 38.0, 60), RNG.uniform(-9.0, 9.0, 60)


def built(content: bytes, **options: Any) -> FluxMapReading:
    points = read_flux_points(content, "map.csv")
    return build_flux_map(points, pole_pairs=PAIRS, **options)


def ripple_of(reading: FluxMapReading) -> FluxRipple:
    found = reading.flux_map.ripple
    assert found is not None
    return found


def is_the_machine(reading: FluxMapReading, zero: float = 0.0, cogging: bool = True) -> None:
    """Flux linkages and torque at any current and angle are those of the machine, whose angle is
    the file's less ``zero`` deg.
    """
    i_d, i_q, theta = AT
    true = theta - np.radians(zero)
    found = ripple_of(reading)
    mean = reading.flux_map.flux(i_d, i_q)
    beside = found.flux(i_d, i_q, theta)
    psi = [part + more for part, more in zip(mean, beside, strict=True)]
    np.testing.assert_allclose(psi, machine.flux(i_d, i_q, true), atol=1e-8)
    series = found.coefficients(i_d, i_q)
    turns = np.outer(found.orders, theta)
    ripple = np.sum(series[:, 0] * np.cos(turns) + series[:, 1] * np.sin(turns), axis=0)
    torque = PAIRS * (1.5 * (mean[0] * i_q - mean[1] * i_d) + ripple)
    wanted = machine.torque(i_d, i_q, true)
    if not cogging:
        zero_current = np.zeros(1)
        wanted -= machine.torque(zero_current, zero_current, true)
    np.testing.assert_allclose(torque, wanted, atol=2e-6)


@pytest.mark.parametrize(
    ("angles", "axis_q"),
    [
        (SIXTY, AXIS_Q),
        (np.append(SIXTY, 60.0), AXIS_Q),
        (np.arange(0.0, 360.0, 10.0) + 3.0, AXIS_Q),
        (np.arange(0.0, 180.5, 5.0), np.linspace(-40.0, 40.0, 17)),
        (SIXTY, -AXIS_Q),
    ],
    ids=["sector", "closed", "turn", "both halves", "lower half"],
)
def test_the_machine_comes_back_from_its_file(angles: Any, axis_q: Any) -> None:
    reading = built(text(rows(angles, np.sort(axis_q)), TITLES))
    is_the_machine(reading)
    assert ripple_of(reading).orders == (6.0, 12.0)
    said = " ".join(reading.findings)
    assert "taken as electrical: " in said
    assert "orders 6, 12 per electrical turn kept" in said


def test_cogging_and_the_agreement_of_torque_and_flux_linkages_are_told() -> None:
    reading = built(text(rows(SIXTY), TITLES))
    zero, theta = np.zeros(720), np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    cogging = float(np.ptp(machine.torque(zero, zero, theta)))
    said = next(finding for finding in reading.findings if "co-energy" in finding)
    assert f"cogging {cogging:.3g} N m" in said
    assert "warning" not in said
    wrong = list(rows(SIXTY))
    wrong[5] = wrong[5] + 3.0 * np.sin(np.radians(6.0 * wrong[2])) * wrong[1] / 40.0
    said = next(
        finding for finding in built(text(wrong, TITLES)).findings if "co-energy" in finding
    )
    assert said.startswith("warning: ")


def test_without_a_torque_all_but_cogging_follows_from_the_flux_linkages() -> None:
    reading = built(text(rows(SIXTY)[:5], TITLES[:5]))
    is_the_machine(reading, cogging=False)
    assert any("less cogging" in finding for finding in reading.findings)


@pytest.mark.parametrize("title", ["theta_mech [deg]", "theta [deg]", "theta [rad]"])
def test_a_mechanical_angle_by_its_name_or_by_the_torque(title: str) -> None:
    columns = list(rows(np.arange(0.0, 360.0, 7.5)))
    columns[2] = columns[2] / PAIRS
    if "rad" in title:
        columns[2] = np.radians(columns[2])
    reading = built(text(columns, (*TITLES[:2], title, *TITLES[3:])))
    is_the_machine(reading)
    said = next(finding for finding in reading.findings if "taken as" in finding)
    assert "mechanical" in said
    assert ("as the torque shows" in said) == ("mech" not in title)


def test_a_table_with_decimal_commas() -> None:
    is_the_machine(built(text(rows(SIXTY), TITLES, ";")))


def test_the_zero_of_the_angle_is_found_where_a_half_is_mirrored() -> None:
    reading = built(text(rows(SIXTY, zero=11.0), TITLES))
    is_the_machine(reading, zero=11.0)
    assert any("mirrored about the angle 11 deg" in finding for finding in reading.findings)


def test_axes_of_reluctance_machines_turn_the_angle_too() -> None:
    i_d, i_q, theta, psi_d, psi_q, torque = rows(SIXTY, np.linspace(-40.0, 40.0, 17))
    columns = (i_q, -i_d, (theta + 90.0) % 60.0, psi_q, -psi_d, torque)
    is_the_machine(built(text(columns, TITLES), axes="reluctance"))


def test_the_ripple_of_the_torque_at_constant_currents() -> None:
    i_d, i_q = np.array([-10.0, 0.0]), np.array([20.0, 0.0])
    found = ripple_of(built(text(rows(SIXTY), TITLES))).torque_ripple(PAIRS, i_d, i_q)
    theta = np.linspace(0.0, np.pi / 3.0, 720, endpoint=False)
    course = machine.torque(i_d[:, None], i_q[:, None], theta)
    np.testing.assert_allclose(found.peak_to_peak, np.ptp(course, axis=1), rtol=1e-4)
    waves = np.abs(np.fft.rfft(course, axis=1))[:, 1:3] * 2.0 / theta.size
    np.testing.assert_allclose(found.amplitudes, waves.T, rtol=1e-5)


def test_a_missing_angle_uneven_steps_and_no_whole_period_are_refused_in_one_line() -> None:
    columns = rows(SIXTY)
    gone = tuple(np.delete(part, 100) for part in columns)
    with pytest.raises(
        InputError, match=r"23 rotor angles at i_d = -30 A, i_q = 20 A, elsewhere 24"
    ):
        built(text(gone, TITLES))
    uneven = np.where(SIXTY == 20.0, 21.0, SIXTY)
    with pytest.raises(InputError, match=r"not evenly spaced: 3\.5 deg after 17\.5 deg, 2\.5 deg"):
        built(text(rows(uneven), TITLES))
    with pytest.raises(
        InputError, match=r"span 45 deg \(electrical\), no whole multiple of 60 deg"
    ):
        built(text(rows(np.arange(0.0, 46.0, 5.0)), TITLES))
    other = list(columns)
    other[2] = np.where((other[0] == 0.0) & (other[1] == 5.0), other[2] + 1.0, other[2])
    with pytest.raises(InputError, match="i_d = 0 A, i_q = 5 A are not those of the first point"):
        built(text(other, TITLES))


def test_without_an_angle_a_map_has_no_ripple() -> None:
    columns = rows(np.array([0.0]))
    titles = [title for k, title in enumerate(TITLES) if k != 2]
    content = text([part for k, part in enumerate(columns) if k != 2], titles)
    reading = build_flux_map(
        read_flux_points(content, "map.csv", torque="ignore"), pole_pairs=PAIRS
    )
    assert reading.flux_map.ripple is None


@pytest.mark.parametrize("name", ["theta", "theta_el", "rotor angle"])
@pytest.mark.parametrize("last", [60.0, 180.0, 360.0])
def test_degrees_without_a_unit_are_read_and_told(name: str, last: float) -> None:
    """As radians they would be many turns of the shaft."""
    content = text(rows(np.arange(0.0, last, 5.0)), (*TITLES[:2], name, *TITLES[3:]))
    reading = built(content)
    is_the_machine(reading)
    assert any(f"{name} has no unit and was read in degrees" in one for one in reading.findings)


@pytest.mark.parametrize(
    ("name", "last"), [("theta [rad]", 60.0), ("theta_mech", 3600.0), ("theta [deg]", 3600.0)]
)
def test_angles_of_more_than_a_turn_are_refused_with_what_to_write(name: str, last: float) -> None:
    content = text(rows(np.arange(0.0, last, 5.0)), (*TITLES[:2], name, *TITLES[3:]))
    with pytest.raises(InputError, match=r"more than a turn of the shaft; name their unit") as told:
        built(content)
    assert "\n" not in str(told.value)


def test_a_whole_turn_of_the_shaft_is_no_more_than_one() -> None:
    angles = np.arange(0.0, 360.0 * PAIRS + 1.0, 10.0)
    is_the_machine(built(text(rows(angles), (*TITLES[:2], "theta_el [deg]", *TITLES[3:]))))
