"""The smooth co-energy behind noisy flux maps: against machines that are known,
and by what must hold of any.
"""

from __future__ import annotations

import numpy as np
import pytest
from saturated import PM_SYRM, ArctanMachine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.flux_maps.checks import energy_misfit
from dqforge.machines.flux_maps.evidence import (
    FluxNoise,
    inductance_noise,
    noise_of_grid,
    noise_of_neighbours,
    noise_of_repeats,
    noise_of_symmetry,
)
from dqforge.machines.flux_maps.fit import (
    LEAST_SHARE,
    CoEnergy,
    FluxData,
    fit_flux,
    smooth_co_energy,
)

TRUTH = ArctanMachine()
AXIS_D, AXIS_Q = np.linspace(-120.0, 120.0, 21), np.linspace(-120.0, 120.0, 25)
AT_D, AT_Q = (part.ravel() for part in np.meshgrid(AXIS_D, AXIS_Q, indexing="ij"))
EXACT = np.stack(TRUTH.flux(AT_D, AT_Q))
SIZE = 1e-3


def noisy(seed: int, size: float = SIZE) -> FloatArray:
    return np.asarray(EXACT + size * np.random.default_rng(seed).standard_normal(EXACT.shape))


def fitted(psi: FloatArray, noise: FluxNoise | None, *, even: bool = True) -> CoEnergy:
    return smooth_co_energy(AT_D, AT_Q, psi, noise, even=even)


@pytest.mark.parametrize("known", [True, False])
def test_noise_is_averaged_out(known: bool) -> None:
    """What is left of the noise is near its share that the effective parameters can follow."""
    found = fitted(noisy(1), FluxNoise(SIZE, SIZE, "repeats") if known else None)
    left = np.sqrt(np.mean((found.flux_at(AT_D, AT_Q) - EXACT) ** 2))
    assert left < 2.0 * SIZE * np.sqrt(found.freedom / EXACT.size)
    assert left < 0.4 * SIZE
    assert found.noise.largest == pytest.approx(SIZE, rel=0.15)


def test_clean_points_are_met() -> None:
    found = fitted(EXACT, FluxNoise(0.0, 0.0, "repeats"))
    assert np.max(np.abs(found.flux_at(AT_D, AT_Q) - EXACT)) < 2e-5


@pytest.mark.parametrize(
    "machine",
    [LinearMachine(3, 0.1, 1e-3, 2e-3, 0.1, 100.0), LinearMachine(3, 0.1, 5e-3, 1e-3, 0.0, 9.0)],
)
def test_constant_inductances_come_out_of_any_noise(machine: LinearMachine) -> None:
    """Constant inductances pay no penalty: least squares of three constants,
    known from textbooks.
    """
    psi = np.stack(machine.flux(AT_D, AT_Q)) + SIZE * np.random.default_rng(4).standard_normal(
        EXACT.shape
    )
    found = fitted(psi, FluxNoise(SIZE, SIZE, "repeats"))
    l_dd, l_dq, l_qq = found.inductances(
        np.linspace(-120.0, 120.0, 9), np.linspace(-120.0, 120.0, 9)
    )
    sigma = SIZE / np.sqrt(np.sum(AT_D**2))
    assert np.max(np.abs(l_dd - machine.l_d)) < 20.0 * sigma
    assert np.max(np.abs(l_qq - machine.l_q)) < 20.0 * sigma
    assert np.max(np.abs(l_dq)) < 20.0 * sigma


def test_there_is_no_curl_and_the_halves_are_mirror_images() -> None:
    found = fitted(noisy(2, 5e-3), FluxNoise(5e-3, 5e-3, "repeats"))
    i_d, i_q, step = np.linspace(-110.0, 110.0, 12), np.linspace(-110.0, 110.0, 13), 1e-3
    by_q = (found.flux(i_d, i_q + step)[0] - found.flux(i_d, i_q - step)[0]) / (2.0 * step)
    by_d = (found.flux(i_d + step, i_q)[1] - found.flux(i_d - step, i_q)[1]) / (2.0 * step)
    scale = np.max(np.abs(found.inductances(i_d, i_q)))
    np.testing.assert_allclose(by_q, by_d, atol=1e-6 * scale)
    here, there = found.flux(i_d, i_q), found.flux(i_d, -i_q)
    np.testing.assert_allclose(here[0], there[0], atol=1e-12)
    np.testing.assert_allclose(here[1], -there[1], atol=1e-12)


@pytest.mark.thinned
@pytest.mark.parametrize("seed", range(4))
def test_inductances_are_positive_definite_between_the_places_where_that_is_asked(
    seed: int,
) -> None:
    """A map that falls over a whole band, which no smoothing alone mends:
    eigenvalues by NumPy on other places.
    """
    psi = noisy(seed, 2e-3)
    band = (AT_D > 20.0) & (AT_D < 80.0)
    psi[0, band] -= 1.5e-3 * (AT_D[band] - 20.0)
    found = fitted(psi, FluxNoise(2e-3, 2e-3, "repeats"))
    assert found.cuts > 0
    l_dd, l_dq, l_qq = found.inductances(
        np.linspace(-120.0, 120.0, 173), np.linspace(-120.0, 120.0, 167)
    )
    least = np.linalg.eigvalsh(np.moveaxis(np.array([[l_dd, l_dq], [l_dq, l_qq]]), (0, 1), (2, 3)))[
        ..., 0
    ]
    assert np.min(least) > 0.2 * LEAST_SHARE * min(TRUTH.l_d, TRUTH.l_q)


def test_the_smoothed_table_keeps_what_the_co_energy_has() -> None:
    psi = noisy(5, 5e-3)
    noise = FluxNoise(5e-3, 5e-3, "repeats")
    data = FluxData(AXIS_D, AXIS_Q, psi.reshape(2, 21, 25), AT_D, AT_Q, psi, noise, is_grid=True)
    flux_map, fit = fit_flux(data, "smooth", "map.csv")
    assert fit.used == "smooth"
    assert energy_misfit(flux_map) < 1e-3
    i_d, i_q = np.meshgrid(
        np.linspace(-120.0, 120.0, 151), np.linspace(-120.0, 120.0, 151), indexing="ij"
    )
    jet = flux_map.jet(i_d, i_q)
    assert np.min(jet.l_dd) > 0.0
    assert np.min(jet.l_qq) > 0.0
    assert np.min(jet.l_dd * jet.l_qq - (0.5 * (jet.l_dq + jet.l_qd)) ** 2) > 0.0
    found = smooth_co_energy(AT_D, AT_Q, psi, noise)
    apart = found.flux_at(AT_D, AT_Q) - psi
    assert fit.residual_rms == pytest.approx(np.sqrt(np.mean(apart**2, axis=1)), rel=1e-6)
    assert fit.residual_largest == pytest.approx(np.max(np.abs(apart), axis=1), rel=1e-6)
    torque = 1.5 * (apart[0] * AT_Q - apart[1] * AT_D)
    assert fit.torque_largest == pytest.approx(np.max(np.abs(torque)), rel=1e-6)
    assert fit.torque_rms == pytest.approx(np.sqrt(np.mean(torque**2)), rel=1e-6)


def test_both_halves_are_kept_where_that_is_asked() -> None:
    """Both flux linkages lean by 2e-5 H over the other current, as those of a co-energy
    with a term in i_d i_q do.
    """
    leaning = 2e-5 * np.stack([AT_Q, AT_D])
    found = smooth_co_energy(
        AT_D, AT_Q, EXACT + leaning, FluxNoise(1e-5, 1e-5, "repeats"), even=False
    )
    np.testing.assert_allclose(found.flux_at(AT_D, AT_Q), EXACT + leaning, atol=5e-5)


@pytest.mark.parametrize("share", [2e-3, 1e-2])
def test_noise_is_found_by_each_of_its_signs(share: float) -> None:
    psi = noisy(9, share).reshape(2, 21, 25)
    for found in (noise_of_symmetry(AXIS_D, AXIS_Q, psi), noise_of_neighbours(AXIS_D, AXIS_Q, psi)):
        assert found is not None
        assert found.d == pytest.approx(share, rel=0.25)
        assert found.q == pytest.approx(share, rel=0.25)
    repeated = np.repeat(EXACT[:, :40], 6, axis=1) + share * np.random.default_rng(
        1
    ).standard_normal((2, 240))
    told = noise_of_repeats(np.repeat(AT_D[:40], 6), np.repeat(AT_Q[:40], 6), repeated, 1e-4)
    assert told is not None
    assert told.source == "repeats"
    assert told.d == pytest.approx(share, rel=0.2)
    assert noise_of_repeats(AT_D, AT_Q, EXACT, 1e-4) is None


def test_a_smooth_asymmetry_is_no_noise() -> None:
    psi = (EXACT + np.stack([2e-4 * AT_Q, 5e-3 + 1e-4 * AT_D])).reshape(2, 21, 25)
    found = noise_of_grid(AXIS_D, AXIS_Q, psi)
    assert found is not None
    assert found.largest < 5e-4


def test_computed_machines_look_clean() -> None:
    """Curvature of a strongly saturated machine is no noise above the limit
    from which maps are smoothed.
    """
    i_d, i_q = np.linspace(-19.0, 19.0, 21), np.linspace(-19.0, 19.0, 27)
    found = PM_SYRM.flux_map(18.7)
    psi = np.stack(found.flux(i_d[:, None], i_q))
    noise = noise_of_grid(i_d, i_q, psi)
    assert noise is not None
    assert inductance_noise(noise, i_d, i_q, psi) < 0.03
    half = i_q >= 0.0
    noise = noise_of_grid(i_d, i_q[half], psi[:, :, half])
    assert noise is not None
    assert inductance_noise(noise, i_d, i_q[half], psi[:, :, half]) < 0.03


def test_scattered_points_need_no_grid() -> None:
    random = np.random.default_rng(3)
    i_d, i_q = random.uniform(-120.0, 120.0, (2, 500))
    exact = np.stack(TRUTH.flux(i_d, i_q))
    found = smooth_co_energy(i_d, i_q, exact + 2e-3 * random.standard_normal(exact.shape), None)
    assert found.noise.largest == pytest.approx(2e-3, rel=0.15)
    assert np.sqrt(np.mean((found.flux_at(i_d, i_q) - exact) ** 2)) < 1e-3
