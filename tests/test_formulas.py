"""What a handbook states in a sentence stands in one module; docs/project/decisions.md names it."""

from __future__ import annotations

import re

import pytest
from house import ROOT, modules

_NAME = r"[\w.\[\]\"]*"
# Formulas as they are written, their homes, and modules where the letters mean something else: the
# factors by which units are told, and hints at a unit that was forgotten.
HOMES = {
    "rpm": (r"30\.0 / (np|math)\.pi", ["machines.transforms"]),
    "linear voltage": (r"v_dc\)? / (np|math)\.sqrt\(3(\.0)?\)", ["machines.transforms"]),
    "torque per ampere": (
        rf"1\.5 \* (float\()?{_NAME}pairs{_NAME}\)* \* (float\()?{_NAME}(psi|flux)",
        ["machines.dq_machines.synchronous"],
    ),
    "dead time": (r"4\.0 / (np|math)\.pi \* [\w.]*f_sw", ["machines.devices.inverter"]),
    "delay": (r"1\.5 \* (\w+ \* )?[\w.]*\b(t_s|step)\b", []),
}
OTHERS = {"machines.units.quantities", "machines.design.design"}
NAMES = ["torque_per_ampere", "linear_voltage", "in_rpm", "CURRENT_DELAY", "lost_per_dead_time"]


@pytest.mark.parametrize("name", HOMES)
def test_a_formula_stands_once(name: str) -> None:
    formula, homes = HOMES[name]
    having = {
        module
        for module, path in modules().items()
        for line in path.read_text("utf-8").splitlines()
        if re.search(formula, line.partition("#")[0])
    }
    assert sorted(having - OTHERS) == homes


@pytest.mark.parametrize("name", NAMES)
def test_the_page_says_where(name: str) -> None:
    page = (ROOT / "docs/project/decisions.md").read_text("utf-8")
    assert re.search(rf"`(\w+\.)?{name}`", page)
