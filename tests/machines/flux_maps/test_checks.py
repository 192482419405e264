"""Checks of flux maps: every planted fault is named, sound maps pass,
and maps over temperature meet in between.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from saturated import ArctanMachine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.checks import check_map, check_points, energy_misfit
from dqforge.machines.flux_maps.fit import flux_map_of_maps
from dqforge.machines.flux_maps.flux_points import FluxPoints
from dqforge.machines.names import FluxAxes

AXIS_D = np.linspace(-150.0, 60.0, 22)
AXIS_Q = np.linspace(-130.0, 130.0, 27)


def map_of(machine: ArctanMachine, i_d: FloatArray = AXIS_D, i_q: FloatArray = AXIS_Q) -> FluxMap:
    return FluxMap(i_d, i_q, *machine.flux(i_d[:, np.newaxis], i_q))


def points_of(flux_map: FluxMap) -> FluxPoints:
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij")
    return FluxPoints(
        "map.csv", i_d.ravel(), i_q.ravel(), flux_map.psi_d.ravel(), flux_map.psi_q.ravel()
    )


def half(points: FluxPoints) -> FluxPoints:
    upper = points.i_q >= 0.0
    return FluxPoints(
        "map.csv", *(part[upper] for part in (points.i_d, points.i_q, points.psi_d, points.psi_q))
    )


def on_minus_q(points: FluxPoints) -> FluxPoints:
    """The same machine with its magnets on the negative q axis."""
    return FluxPoints("map.csv", points.i_q, -points.i_d, points.psi_q, -points.psi_d)


SOUND = map_of(ArctanMachine())
POINTS = points_of(SOUND)

Damage = Callable[[FluxPoints], FluxPoints]
FAULTS: dict[str, tuple[Damage, FluxAxes, str]] = {
    "currents exchanged": (
        lambda p: replace(p, i_d=p.i_q, i_q=p.i_d),
        "magnet-d",
        r"psi_d grows with i_q and psi_q with i_d: i_d and i_q are exchanged",
    ),
    "fluxes exchanged": (
        lambda p: replace(p, psi_d=p.psi_q, psi_q=p.psi_d),
        "magnet-d",
        r"psi_d and psi_q are exchanged, or a table is transposed",
    ),
    "without magnets exchanged": (
        lambda p: replace(p, i_d=p.i_q, i_q=p.i_d, psi_d=p.psi_d - 0.12),
        "magnet-d",
        r"i_d and i_q or psi_d and psi_q are exchanged",
    ),
    "currents exchanged on reluctance axes": (
        lambda p: replace(on_minus_q(p), i_d=on_minus_q(p).i_q, i_q=on_minus_q(p).i_d),
        "reluctance",
        r": i_d and i_q are exchanged",
    ),
    "sign of i_d": (
        lambda p: replace(p, i_d=-p.i_d),
        "magnet-d",
        r"psi_d falls as i_d grows; .*negate i_d \(or psi_d",
    ),
    "sign of psi_q": (
        lambda p: replace(p, psi_q=-p.psi_q),
        "magnet-d",
        r"psi_q falls as i_q grows; .*negate i_q",
    ),
    "currents of a generator": (
        lambda p: replace(p, i_d=-p.i_d, i_q=-p.i_q),
        "magnet-d",
        (
            r"psi_d falls as i_d grows and psi_q falls as i_q grows; .*negate i_d and i_q \(or "
            r"psi_d and psi_q\)"
        ),
    ),
    "magnets on -q": (
        on_minus_q,
        "magnet-d",
        r"psi_q = -0\.12 Wb: the magnets lie on the negative q.*axes: reluctance",
    ),
    "magnets on +q": (
        lambda p: FluxPoints("map.csv", -p.i_q, p.i_d, -p.psi_q, p.psi_d),
        "magnet-d",
        r"positive q axis.*negate i_q and psi_q, and write axes: reluctance",
    ),
    "magnets against d": (
        lambda p: replace(p, i_d=-p.i_d, psi_d=-p.psi_d),
        "magnet-d",
        r"the d axis points against the magnet; negate i_d and psi_d$",
    ),
    "magnets on d": (
        lambda p: p,
        "reluctance",
        r"the magnets lie on the positive d axis.*write axes: magnet-d$",
    ),
    "magnets on +q of reluctance axes": (
        lambda p: FluxPoints("map.csv", -p.i_q, p.i_d, -p.psi_q, p.psi_d),
        "reluctance",
        r"positive q axis.*axes: reluctance; negate i_q and psi_q$",
    ),
    "fluxes in mWb": (
        lambda p: replace(p, psi_d=1e3 * p.psi_d, psi_q=1e3 * p.psi_q),
        "magnet-d",
        r"reach \d+\.?\d* Wb; they look like mWb, 1000 times too large: write flux_unit: mWb",
    ),
    "fluxes a million times too small": (
        lambda p: replace(p, psi_d=1e-6 * p.psi_d, psi_q=1e-6 * p.psi_q),
        "magnet-d",
        r"the flux linkages reach only .* 1000 times too small",
    ),
    "currents in mA": (
        lambda p: replace(p, i_d=1e3 * p.i_d, i_q=1e3 * p.i_q),
        "magnet-d",
        r"reach 150000 A; they look like mA.*current_unit: mA",
    ),
    "currents in MA": (
        lambda p: replace(p, i_d=1e-6 * p.i_d, i_q=1e-6 * p.i_q),
        "magnet-d",
        r"reach only 0\.00015 A; they look like kA.*current_unit: kA",
    ),
    "currents too small for the fluxes": (
        lambda p: replace(p, i_d=1e-4 * p.i_d, i_q=1e-4 * p.i_q),
        "magnet-d",
        (
            r"at 0\.015 A would be .* H; one of them looks 1000 times off: write flux_unit: mWb or "
            r"current_unit: kA"
        ),
    ),
    "fluxes too small for the currents": (
        lambda p: replace(p, psi_d=5e-5 * p.psi_d, psi_q=5e-5 * p.psi_q),
        "magnet-d",
        r"at 150 A would be .*e-08 H; one of them looks 1000 times off: write current_unit: mA",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("part", [lambda p: p, half], ids=["full", "half"])
def test_planted_faults_are_named(name: str, part: Damage) -> None:
    damage, axes, phrase = FAULTS[name]
    with pytest.raises(InputError, match=phrase) as caught:
        check_points(damage(part(POINTS)), axes)
    assert str(caught.value).startswith("map.csv: ")
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=phrase):
        build_flux_map(damage(part(POINTS)), axes=axes)


def test_sound_points_pass_in_their_own_convention() -> None:
    for points in (POINTS, half(POINTS), replace(POINTS, i_q=-POINTS.i_q, psi_q=-POINTS.psi_q)):
        check_points(points)
        check_points(on_minus_q(points), "reluctance")
    without = replace(POINTS, psi_d=POINTS.psi_d - 0.12)
    for axes in ("magnet-d", "reluctance"):  # nothing tells where magnets lie that are not there
        check_points(without, axes)


def test_holes_are_counted_and_placed_in_the_numbers_of_the_file() -> None:
    psi_q = on_minus_q(POINTS).psi_q.copy()
    psi_q[[40, 99, 500]] = np.nan
    file = replace(on_minus_q(POINTS), psi_q=psi_q)
    where = (
        rf"psi_q has 3 holes .* first at i_d = {file.i_d[40]:g} A, i_q = {file.i_q[40]:g} A; "
        r"measure them, or remove"
    )
    with pytest.raises(InputError, match=where):
        build_flux_map(file, axes="reluctance", scaling="rms")
    with pytest.raises(InputError, match="i_d has 1 holes"):
        check_points(
            replace(POINTS, i_d=np.where(np.arange(POINTS.i_d.size) == 3, np.inf, POINTS.i_d))
        )


def test_halves_that_are_no_mirror_images_are_refused() -> None:
    signless = replace(POINTS, psi_q=np.where(POINTS.i_q < 0.0, -0.6, 1.0) * POINTS.psi_q)
    with pytest.raises(
        InputError, match=r"no mirror images: they lie .*Wb from their mean.*check the signs"
    ):
        build_flux_map(signless)


@pytest.mark.parametrize("axis", ["d", "q"])
def test_falling_flux_is_placed(axis: str) -> None:
    psi = {name: getattr(SOUND, name).copy() for name in ("psi_d", "psi_q")}
    name = f"psi_{axis}"
    for column in (6, 20):  # both halves, for a symmetric map
        psi[name][9, column] -= 0.3 * np.ptp(psi[name])
    broken = FluxMap(AXIS_D, AXIS_Q, psi["psi_d"], psi["psi_q"])
    place = rf"i_d = {AXIS_D[9]:g} A, i_q = -?{AXIS_Q[20]:g} A"
    with pytest.raises(
        InputError, match=rf"{name} falls as i_{axis} grows, most at {place} .*% of its span"
    ) as caught:
        check_map(broken, "map.csv")
    assert caught.value.source == "map.csv"


def test_small_dips_and_moderate_misfits_are_told() -> None:
    psi_d = SOUND.psi_d.copy()
    step = psi_d[9, :] - psi_d[8, :]
    psi_d[9, :] -= step + 0.004 * np.ptp(psi_d)
    findings = check_map(FluxMap(AXIS_D, AXIS_Q, psi_d, SOUND.psi_q), "map.csv")
    assert [
        f
        for f in findings
        if f.startswith("psi_d does not grow with i_d in 27 places, it falls by up to 0.4")
    ]
    assert check_map(SOUND, "map.csv") == ()


def test_energy_misfit_is_that_of_a_map_with_known_inductances() -> None:
    """L_dd = 1, L_qq = 2, l_dq = 0.1 i_q, l_qd = 0: the misfit follows from the
    sums over the grid by hand.
    """
    i_d, i_q = np.linspace(-3.0, 1.0, 9), np.linspace(-2.0, 2.0, 5)
    for slope in (0.1, 0.6):
        psi_d, psi_q = np.broadcast_arrays(i_d[:, None] + 0.5 * slope * i_q**2 + 3.0, 2.0 * i_q)
        flux_map = FluxMap(i_d, i_q, psi_d, psi_q)
        expected = slope * np.sqrt((4 + 1 + 0 + 1 + 4) / 5) / np.sqrt((1 + 4) / 2)
        assert energy_misfit(flux_map) == pytest.approx(expected, rel=1e-9)
        if expected < 0.5:
            findings = check_map(flux_map, "map.csv")
            assert len(findings) == 1
            assert f"differ by {100 * expected:.0f} %" in findings[0]
        else:
            with pytest.raises(
                InputError, match=rf"differ by {100 * expected:.0f} % .*belong together"
            ):
                check_map(flux_map, "map.csv")
    assert energy_misfit(SOUND) < 2e-3


@pytest.mark.parametrize(
    ("factor", "advice"),
    [
        (1.5**0.5, "scaling: power-invariant"),
        (0.5**0.5, "looks like r.m.s. values; write scaling: rms"),
        (2.0**0.5, "expected value in r.m.s.; write scaling: peak"),
        ((2.0 / 3.0) ** 0.5, "power-invariant does not hold; write scaling: peak"),
        (3.0**0.5, "line-to-line"),
        (2.0, "divide psi_d and psi_q by 2"),
        (0.5, "multiply psi_d and psi_q by 2"),
        (1e3, "flux_unit: mWb"),
        (1e-3, "flux_unit: Wb"),
        (1.1, "check the scaling of the map, or the expected value"),
        (-1.0, "check the scaling of the map, or the expected value"),
    ],
)
def test_scaling_is_told_by_an_expected_magnet_flux(factor: float, advice: str) -> None:
    with pytest.raises(InputError, match=rf"0.12 Wb at zero current.*is expected.*{advice}"):
        check_map(SOUND, "map.csv", 0.12 / factor)


def test_magnet_flux_near_the_expected_one_passes() -> None:
    assert check_map(SOUND, "map.csv", 0.12 / 1.04) == ()
    without = FluxMap(AXIS_D, AXIS_Q, SOUND.psi_d - 0.12, SOUND.psi_q)
    assert check_map(without, "map.csv", 0.0) == ()
    with pytest.raises(InputError, match="is expected"):
        check_map(SOUND, "map.csv", 0.0)


def test_power_invariant_files_pass_once_they_are_declared() -> None:
    factor = 1.5**0.5
    file = FluxPoints(
        "map.csv", *(factor * p for p in (POINTS.i_d, POINTS.i_q, POINTS.psi_d, POINTS.psi_q))
    )
    with pytest.raises(InputError, match="write scaling: power-invariant"):
        build_flux_map(file, expected_psi_pm=0.12)
    assert (
        build_flux_map(file, scaling="power-invariant", expected_psi_pm=0.12).energy_misfit < 2e-3
    )


@pytest.mark.parametrize(
    "name", ["baldor_ecs101m0h7ef4_400rpm_measured", "femag_pm270l8_psidq_losses_50rps"]
)
@pytest.mark.parametrize(
    "fault", ["currents exchanged", "sign of i_d", "sign of psi_q", "magnets against d"]
)
def test_faults_of_real_maps_are_named_as_those_of_the_formula(
    name: str, fault: str, shared_data: Path
) -> None:
    table = np.loadtxt(shared_data / "fluxmaps" / f"{name}.csv", delimiter=",", skiprows=1)
    points = FluxPoints("map.csv", *table.T[:4])
    check_points(points)
    damage, axes, phrase = FAULTS[fault]
    with pytest.raises(InputError, match=phrase):
        check_points(damage(points), axes)


def warm(temperature: float, curve: float = 0.0) -> ArctanMachine:
    """The machine whose magnet flux falls with the temperature, linearly or along a parabola."""
    rise = (temperature - 20.0) / 100.0
    return ArctanMachine(psi_m=0.12 * (1.0 - 0.1 * rise - curve * rise**2))


def test_two_maps_are_joined_linearly_in_any_order() -> None:
    maps = [map_of(warm(120.0)), map_of(warm(20.0))]
    for temperature in (20.0, 45.0, 120.0):
        joined = flux_map_of_maps(np.array([120.0, 20.0]), maps, temperature)
        np.testing.assert_allclose(joined.psi_d, map_of(warm(temperature)).psi_d, atol=1e-14)
        np.testing.assert_allclose(joined.psi_q, SOUND.psi_q, atol=1e-14)
    assert not joined.extrapolate


def test_more_maps_follow_a_monotone_curve() -> None:
    known = np.array([20.0, 60.0, 100.0, 140.0])
    maps = [map_of(warm(t, 0.05)) for t in known]
    zero = np.zeros(1)
    at = {
        t: float(flux_map_of_maps(known, maps, t).flux(zero, zero)[0][0])
        for t in (20.0, 50.0, 80.0, 130.0)
    }
    assert at[20.0] == pytest.approx(0.12, rel=1e-12)
    for temperature, value in at.items():
        exact = warm(temperature, 0.05).psi_m
        chord = np.interp(temperature, known, [warm(t, 0.05).psi_m for t in known])
        assert abs(value - exact) <= 0.4 * abs(chord - exact) + 1e-12  # nearer than straight lines


def test_maps_meet_on_the_rectangle_they_share_with_the_finest_steps() -> None:
    coarse = map_of(warm(20.0), np.linspace(-160.0, 40.0, 21), AXIS_Q)
    fine = map_of(warm(120.0), np.linspace(-150.0, 60.0, 43), np.linspace(-100.0, 100.0, 21))
    joined = flux_map_of_maps(np.array([20.0, 120.0]), [coarse, fine], 70.0)
    np.testing.assert_allclose(joined.i_d, np.linspace(-150.0, 40.0, 39))
    np.testing.assert_allclose(joined.i_q, np.linspace(-100.0, 100.0, 21))
    expected = warm(70.0).flux(joined.i_d[:, None], joined.i_q)
    np.testing.assert_allclose(joined.psi_d, expected[0], atol=2e-5)
    np.testing.assert_allclose(joined.psi_q, expected[1], atol=2e-5)


@pytest.mark.parametrize(
    ("temperatures", "temperature", "phrase"),
    [
        ([20.0, 120.0], 121.0, "121 degC lies outside those of the flux maps, 20 to 120 degC"),
        ([20.0, 120.0], float("nan"), "lies outside"),
        ([20.0, 20.0], 20.0, "same magnet temperature"),
        ([20.0], 20.0, "2 flux maps and 1 temperatures"),
    ],
)
def test_temperatures_that_cannot_be_are_refused(
    temperatures: list[float], temperature: float, phrase: str
) -> None:
    with pytest.raises(InputError, match=phrase):
        flux_map_of_maps(np.array(temperatures), [SOUND, SOUND], temperature)


def test_maps_without_a_common_rectangle_are_refused() -> None:
    left, right = map_of(ArctanMachine(), AXIS_D - 200.0), map_of(ArctanMachine(), AXIS_D)
    with pytest.raises(InputError, match="overlap only from -150 to -140 A"):
        flux_map_of_maps(np.array([20.0, 120.0]), [left, right], 50.0)
