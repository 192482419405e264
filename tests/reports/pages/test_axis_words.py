"""Labels in plain words: name and unit."""

from __future__ import annotations

import pytest

from dqforge.reports.pages.scaled import Quantity, plain, quantity


@pytest.mark.parametrize(
    ("label", "name", "unit"),
    [
        ("Torque in N m", "Torque", "N m"),
        ("$i_d$ in A (peak)", "i_d (peak)", "A"),
        ("$i_q$ error in mA", "i_q error", "mA"),
        ("Torque error in \u00b5N m", "Torque error", "uN m"),
        ("Mean loss in W over the 82 % of the map that all drive",
         "Mean loss over the 82 % of the map that all drive", "W"),
        ("Torque error in % of the largest", "Torque error", "% of the largest"),
        ("% of the fundamental", "", "% of the fundamental"),
        ("A (peak)", "", "A"),
        ("mV s/rad", "", "mV s/rad"),
        ("Angle in deg r.m.s.", "Angle r.m.s.", "deg"),
        ("Phase in degrees", "Phase", "deg"),
        ("Junction in \u00b0C", "Junction", "degC"),
        ("Turn per sample (rad)", "Turn per sample", "rad"),
        ("machines [%]", "machines", "%"),
        ("Speed off by %", "Speed off", "%"),
        ("Crossover in Hz", "Crossover", "Hz"),
        ("i_q in A along the MTPA locus", "i_q along the MTPA locus", "A"),
        ("Response per unit step", "Response per unit step", "1"),
        ("duty cycles", "duty cycles", "1"),
        ("Order", "Order", "1"),
        ("$\u03c8_d$ in Wb", "psi_d", "Wb"),
        ("$L_{dd}$ in mH", "L_dd", "mH"),
    ],
)  # fmt: skip
def test_a_label_gives_name_and_unit(label: str, name: str, unit: str) -> None:
    assert quantity(label) == Quantity(name, unit)


def test_plain_text_has_no_markup_and_no_letter_that_a_spreadsheet_would_break() -> None:
    text = plain("$\u03c9_{e}$, \u22123 \u00b5Wb\n at 20 \u00b0C")
    assert text == "omega_e, -3 uWb at 20 degC"
    assert text.isascii()
