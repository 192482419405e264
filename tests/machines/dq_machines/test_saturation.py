"""The saturation model against its own definition, a measured map, and the values that its
authors' software prints.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from saturated import PM_SYRM

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.saturation import SaturationModel
from dqforge.machines.errors import InputError

RELUCTANCE = SaturationModel(
    a_d0=17.4, a_dd=373.0, s=5, a_q0=52.1, a_qq=658.0, t=1, a_dq=1120.0, u=1, v=0
)
MAGNETS = PM_SYRM


def test_currents_are_the_printed_formula() -> None:
    """psi = (0.5, -0.1) by hand."""
    i_d, i_q = RELUCTANCE.currents(np.array([0.5]), np.array([-0.1]))
    assert i_d[0] == pytest.approx(
        (17.4 + 373.0 * 0.5**5 + 1120.0 / 2 * 0.5 * 0.1**2) * 0.5, rel=1e-14
    )
    assert i_q[0] == pytest.approx(-(52.1 + 658.0 * 0.1 + 1120.0 / 3 * 0.5**3) * 0.1, rel=1e-14)
    i_d, i_q = MAGNETS.currents(np.array([0.4]), np.array([0.6]))
    width = np.sqrt(0.404**2 + 0.1 * 0.6**2)
    bridge = 81.75 * width**2 / (1.0 + width**2)
    cross = 41.5 / 3 * 0.4 * 0.6**3
    assert i_d[0] == pytest.approx((3.96 + 28.5 * 0.4**4 + cross) * 0.4 - bridge * 0.404, rel=1e-14)
    own = 5.89 + 2.67 * 0.6**6 + 41.5 / 3 * 0.4**3 * 0.6
    assert i_q[0] == pytest.approx((own + 0.1 * bridge) * 0.6, rel=1e-14)


@pytest.mark.parametrize("model", [RELUCTANCE, MAGNETS], ids=["reluctance", "magnets"])
def test_fluxes_are_found_in_steps_of_newton(
    model: SaturationModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slopes are those of the currents by differences; with them errors fall with the square:
    some five evaluations for each of the thirteen currents on the way out.
    """
    generator = np.random.default_rng(4)
    psi_d, psi_q, h = *generator.uniform(-0.9, 0.9, (2, 60)), 1e-6
    high, low = model.currents(psi_d + h, psi_q), model.currents(psi_d - h, psi_q)
    by_d = [(a - b) / (2.0 * h) for a, b in zip(high, low, strict=True)]
    high, low = model.currents(psi_d, psi_q + h), model.currents(psi_d, psi_q - h)
    by_q = [(a - b) / (2.0 * h) for a, b in zip(high, low, strict=True)]
    slope_d, slope_q, mixed = model._inverse_inductances(psi_d, psi_q)
    for found, expected in zip(
        (slope_d, slope_q, mixed, mixed), (by_d[0], by_q[1], by_d[1], by_q[0]), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=2e-5, atol=1e-4 * np.max(np.abs(expected)))
    currents, calls = SaturationModel.currents, []

    def counted(self: SaturationModel, d: FloatArray, q: FloatArray) -> tuple[FloatArray, ...]:
        calls.append(d.size)
        return currents(self, d, q)

    i_d, i_q = currents(model, 0.7 * psi_d, 0.7 * psi_q)
    monkeypatch.setattr(SaturationModel, "currents", counted)
    model.fluxes(i_d, i_q)
    assert len(calls) <= 150


@pytest.mark.parametrize("model", [RELUCTANCE, MAGNETS], ids=["reluctance", "magnets"])
def test_fluxes_invert_the_currents(model: SaturationModel) -> None:
    generator = np.random.default_rng(1)
    psi_d, psi_q = generator.uniform(-0.9, 0.9, 500), generator.uniform(-1.2, 1.2, 500)
    back_d, back_q = model.fluxes(*model.currents(psi_d, psi_q))
    np.testing.assert_allclose(back_d, psi_d, atol=1e-9)
    np.testing.assert_allclose(back_q, psi_q, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "i_max"), [(RELUCTANCE, 33.0), (MAGNETS, 20.0)], ids=["reluctance", "magnets"]
)
def test_map_is_the_model_and_holds_energy(model: SaturationModel, i_max: float) -> None:
    flux_map = model.flux_map(i_max)
    generator = np.random.default_rng(2)
    i_d, i_q = generator.uniform(-i_max, i_max, (2, 400))
    exact_d, exact_q = model.fluxes(i_d, i_q)
    psi_d, psi_q = flux_map.flux(i_d, i_q)
    # |psi|^t with t = 1 bends at zero, where a spline is less exact.
    np.testing.assert_allclose(psi_d, exact_d, atol=2e-3 * np.max(np.abs(exact_d)))
    np.testing.assert_allclose(psi_q, exact_q, atol=2e-3 * np.max(np.abs(exact_q)))
    assert np.sqrt(np.mean((psi_d - exact_d) ** 2)) < 3e-4 * np.max(np.abs(exact_d))
    jet = flux_map.jet(i_d, i_q)
    assert np.sqrt(np.mean((jet.l_dq - jet.l_qd) ** 2)) < 0.02 * np.sqrt(np.mean(jet.l_dd**2))


def test_model_of_the_measured_machine_lies_on_its_measured_map(shared_data: Path) -> None:
    """Its authors fitted it to this map.

    Within the rated current it is 20 to 30 mWb off (r.m.s.), of up to 1.1 Wb.
    """
    with np.load(shared_data / "fluxmaps" / "baldor_400rpm_map.npz") as data:
        current, flux = data["i_s_dq"], data["psi_s_dq"]
    inside = np.abs(current) <= 12.45
    psi_d, psi_q = MAGNETS.fluxes(current.real[inside], current.imag[inside])
    assert np.sqrt(np.mean((psi_d - flux.real[inside]) ** 2)) < 0.02
    assert np.sqrt(np.mean((psi_q - flux.imag[inside]) ** 2)) < 0.03


def test_impossible_coefficients_are_refused() -> None:
    with pytest.raises(InputError, match="a_d0 and a_q0 above zero"):
        replace(RELUCTANCE, a_d0=0.0)
    with pytest.raises(InputError, match="a_dq zero or positive, got -1"):
        replace(RELUCTANCE, a_dq=-1.0)
    for name in ("a_d0", "a_q0"):
        assert getattr(replace(RELUCTANCE, **{name: 1e-6}), name) == 1e-6
        for value in (0.0, -1e-6, np.nan):
            with pytest.raises(InputError, match="a_d0 and a_q0 above zero"):
                replace(RELUCTANCE, **{name: value})
    for name in set(RELUCTANCE.__dataclass_fields__) - {"a_d0", "a_q0"}:
        assert getattr(replace(MAGNETS, **{name: 0.0}), name) == 0.0
        with pytest.raises(InputError, match=f"{name} zero or positive"):
            replace(MAGNETS, **{name: -1e-6})
