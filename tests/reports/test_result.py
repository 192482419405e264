"""JSON results: every loss row has the numbers of its own labels, computed here by hand."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.losses.solve import solve_losses
from dqforge.reports.losses.map_tables import plain_losses
from dqforge.reports.pages.templating import plain_certificate, to_text


def test_proven_bounds_are_never_rounded_down() -> None:
    """Nine digits to nearest would put every second bound below what is proven."""
    generator = np.random.default_rng(1)
    for value in 10.0 ** generator.uniform(-12.0, 3.0, 200):
        certificate = Certificate("equations", value, value, value, value, None, value, None, 7)
        stated = json.loads(
            to_text("fit", "test", {"certificate": plain_certificate(certificate)})
        )["certificate"]
        assert value <= stated["i_d"] == stated["torque"] <= value * (1.0 + 1.1e-8)
        assert stated["loss"] is None
        assert (stated["model"], stated["intervals"]) == ("equations", 7)


def test_rows_of_the_loss_comparison_at_zero_d_current() -> None:
    """i_q = T/(6 psi).

    Copper 3/2 R i^2, MOSFET 3/2 R_on i^2, switching 3 f E/(I V) v_dc 2 i/pi, half when clamped.
    """
    points = (LoadPoint(130.0, 300.0), LoadPoint(65.0, 300.0))
    comparison = solve_losses(
        replace(make_design(), losses=LossSettings(points, strategies=("id0",)))
    )
    plain = plain_losses(comparison)
    assert plain is not None
    rows = json.loads(to_text("losses", "test", {"losses": plain}))["losses"]["rows"]
    assert [(row["torque_Nm"], row["modulation"]) for row in rows] == [
        (torque, name) for torque in (130.0, 65.0) for name in ("spwm", "svpwm", "ddt-gdpwm")
    ]
    for row in rows:
        current = row["torque_Nm"] / (6.0 * 0.1049)
        assert row["strategy"] == "id0"
        assert row["omega_m_rad_per_s"] == 300.0
        assert row["feasible"] is True
        assert row["copper_W"] == pytest.approx(1.5 * 2e-3 * current**2, rel=1e-8)
        assert row["conduction_W"] == pytest.approx(1.5 * 9.5e-3 * current**2, rel=1e-8)
        psi_d, psi_q = 0.1049, 592e-6 * current
        assert row["voltage_V"] == pytest.approx(
            math.hypot(1200.0 * psi_q, 2e-3 * current + 1200.0 * psi_d), rel=1e-8
        )
        full = 3.0 * 100e3 * 2.0 * 0.86e-3 / 206.5 * 2.0 * current / math.pi
        if row["modulation"] != "ddt-gdpwm":
            assert row["switching_W"] == pytest.approx(full, rel=1e-8)
            assert row["saving_percent"] == pytest.approx(0.0, abs=1e-4)  # the ripple differs
        else:
            assert 0.5 * full * (1.0 - 1e-8) <= row["switching_W"] < 0.634 * full
        others = (
            "ripple_copper_W",
            "iron_W",
            "ripple_iron_W",
            "magnet_W",
            "dead_time_W",
            "capacitor_W",
        )
        assert 0.0 < row["ripple_copper_W"] < 2e-3
        total = (
            row["copper_W"]
            + row["conduction_W"]
            + row["switching_W"]
            + sum(row[name] for name in others)
        )
        assert row["total_W"] == pytest.approx(total, rel=1e-8)
        junction = 64.0 + 0.306 / 6.0 * (row["conduction_W"] + row["switching_W"])
        assert row["junction_degC"] == pytest.approx(junction, rel=1e-8)
