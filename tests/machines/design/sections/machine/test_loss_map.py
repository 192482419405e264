"""Designs with a loss map: the same budgets and currents as by the formula that made it, and what
is told of the two beside each other.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.reports.answers.losses import LossRequest, answer_losses

TEXT = """\
dqforge: 1
name: Mapped
machine:
  pole_pairs: 4
  resistance: 50 mOhm
  inductance_d: 0.3 mH
  inductance_q: 0.7 mH
  magnet_flux: 80 mWb
  max_current: 150 A
  LOSS
inverter:
  v_dc: 400 V
  switching_frequency: 10 kHz
  device: {kind: mosfet, on_resistance: 5 mOhm, turn_on_energy: 1 mJ, turn_off_energy: 1 mJ,
    reference_current: 100 A, reference_voltage: 400 V, thermal_resistance: 0.3 K/W}
export: {prefix: m}
"""
FORMULA = "iron_loss: {frequency: 100 Hz, flux: 100 mWb, hysteresis: 300 W, eddy: 200 W}"
MAP = "loss_map: {file: fe.csv}"


def made(folder: Path, loss: str, *, extra: float = 0.0) -> Design:
    """The design, beside a map of the formula plus a share that grows with i_d^2."""
    i_d, i_q = np.meshgrid(np.linspace(-160.0, 160.0, 9), np.linspace(0.0, 160.0, 5))
    square = (0.08 + 0.3e-3 * i_d) ** 2 + (0.7e-3 * i_q) ** 2
    rows = ["i_d [A],i_q [A],frequency [Hz],P_fe [W]"]
    for f in (100.0, 400.0):
        part = f / 100.0
        watts = (300.0 * part + 200.0 * part**2) * (square / 0.01 + extra * (i_d / 100.0) ** 2)
        rows += [
            f"{a:.15g},{b:.15g},{f:.15g},{c:.15g}"
            for a, b, c in zip(i_d.ravel(), i_q.ravel(), watts.ravel(), strict=True)
        ]
    (folder / "fe.csv").write_text("\n".join(rows) + "\n", encoding="ascii")
    text = TEXT.replace("LOSS", loss)
    if "delta" in loss:
        text = text.replace("150 A", "{value: 150 A, kind: line peak}")
    (folder / "m.yaml").write_text(text, encoding="ascii")
    return load_design(folder / "m.yaml")


def told(design: Design) -> str:
    return " | ".join(design.assumptions)


@pytest.mark.slow
def test_a_map_of_the_formula_makes_the_same_budgets(tmp_path: Path) -> None:
    torque, omega_m = (
        part.ravel() for part in np.meshgrid([-40.0, 5.0, 30.0, 60.0], [-300.0, 50.0, 400.0])
    )
    totals = []
    for loss in (MAP, FORMULA):
        design = made(tmp_path, loss)
        found = compare_drives(
            design.machine,
            design.inverter,
            torque,
            omega_m,
            Alternatives(("mtpa", "least-loss"), ("svpwm",), (10e3,)),
            i_max=design.i_max,
            options=budget_options(design),
        )
        budget = found.budget
        totals.append(np.stack([budget.copper, budget.iron, budget.ripple_iron, budget.total]))
    np.testing.assert_allclose(totals[0], totals[1], rtol=1e-8)


def test_the_formula_is_held_against_the_map(tmp_path: Path) -> None:
    exact = made(tmp_path, MAP)
    compared = exact.machine_loss.mapped.compared if exact.machine_loss.mapped else None
    assert compared is not None
    assert (compared.misfit, compared.below, compared.fitted) == (0.0, 0, True)
    by_formula = made(tmp_path, FORMULA).machine_loss
    assert exact.machine_loss.eddy == pytest.approx(by_formula.eddy, rel=1e-9)
    assert exact.machine_loss.hysteresis == pytest.approx(by_formula.hysteresis, rel=1e-9)
    assert "(fitted to the map) differs from the map by 0.0% r.m.s." in told(exact)
    # Twice the formula of the design is in the map: it misses half; half of it: it is too much.
    halved = FORMULA.replace("300 W", "150 W").replace("200 W", "100 W")
    less = made(tmp_path, f"{MAP}\n  {halved}")
    assert "(of machine.iron_loss) differs from the map by 50.0% r.m.s." in told(less)
    assert "below zero" not in told(less)
    doubled = FORMULA.replace("300 W", "600 W").replace("200 W", "400 W")
    more = made(tmp_path, f"{MAP}\n  {doubled}")
    assert "differs from the map by 100.0% r.m.s." in told(more)
    assert "below zero at" in told(more)
    (value,) = (v for v in more.values if v.path == "machine.loss_map.flux_misfit")
    assert value.si == pytest.approx(1.0, rel=1e-9)


def test_a_loss_that_is_no_square_of_the_flux_is_named(tmp_path: Path) -> None:
    design = made(tmp_path, MAP, extra=2.0)
    mapped = design.machine_loss.mapped
    assert mapped is not None
    assert mapped.compared is not None
    assert mapped.compared.misfit > 0.2
    assert mapped.compared.below > 5
    assert "least " in told(design)


@pytest.mark.parametrize(
    ("loss", "message"),
    [
        ("loss_map: {file: fe.csv, frequency: 200 Hz}", "has a column for it"),
        ("loss_map: {file: fe.csv, exponent: 1.5}", "several frequencies"),
        ("loss_map: {file: fe.csv, columns: {iron: Pfe}}", "no 'Pfe' found"),
        ("loss_map: {file: none.csv}", "there is no file 'none.csv'"),
        (
            f"{MAP}\n  magnet_loss: {{loss: 9 W, frequency: 200 Hz, current: 50 A}}",
            "the loss of the magnets is that of machine.loss_map",
        ),
        (
            f"{MAP}\n  connection: delta",
            "does not go with connection: delta",
        ),
    ],
)
def test_faults_are_refused_with_their_place(tmp_path: Path, loss: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        made(tmp_path, loss)
    assert raised.value.line is not None


def test_losses_tell_the_formula_beside_the_map(tmp_path: Path) -> None:
    design = made(tmp_path, MAP, extra=2.0)
    found = answer_losses(
        design,
        LossRequest(points="30 N m 3000 rpm", modulations="svpwm"),
        choice=False,
    )
    assert "fe.csv: the iron loss by |psi|^2 (fitted to the map) differs" in found.notes[-1]
    plain = found.plain["iron_loss_map"]
    assert plain["frequency_Hz"] == pytest.approx(400.0)
    assert plain["misfit"] > 0.2
    assert plain["least"]["left_W"] < 0.0
    # The worst point, by the map's own numbers.
    i_d, i_q = plain["least"]["i_d_A"], plain["least"]["i_q_A"]
    square = (0.08 + 0.3e-3 * i_d) ** 2 + (0.7e-3 * i_q) ** 2
    omega = 2.0 * np.pi * 400.0
    by_map = (300.0 * 4.0 + 200.0 * 16.0) * (square / 0.01 + 2.0 * (i_d / 100.0) ** 2)
    by_formula = (plain["hysteresis"] * omega + plain["eddy"] * omega**2) * square
    assert plain["least"]["left_W"] == pytest.approx(by_map - by_formula, rel=1e-9)
