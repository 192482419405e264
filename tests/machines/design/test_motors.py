"""Motors of the library: their files, and their figures against others of the same motors."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import pytest
from motor_table import PAGE, head, linear, speed_constant, table

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.files.library_files import MOTORS

MOTOR_NAMES = catalogue.motors()
# What their range of speeds is reached with: more than the back-EMF without field weakening.
WEAKENED = {"toyota-prius-2004"}


@pytest.mark.parametrize("name", MOTOR_NAMES)
def test_a_motor_says_where_its_figures_come_from(name: str) -> None:
    text = catalogue.read_text(name).decode("utf-8")
    lines = text.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 150
    said = head(name)
    assert re.search(r"\bSources?: ", said)
    assert "May be off by: " in said
    design = catalogue.load(name)
    for value in design.values:
        # tolerances are what the head says, the margins and bandwidths are first choices
        if value.path.startswith(("machine.", "inverter.")) and value.text:
            assert value.source or value.inferred, f"{value.path} does not say where it comes from"
        if value.inferred:
            assert value.note, f"{value.path} does not say how it was inferred"
    measured = [value.path for value in design.values if value.source and not value.inferred]
    assert "machine.resistance" in measured
    assert any(path.startswith("machine.inductance") for path in measured)
    assert {"machine.kv", "machine.magnet_flux", "machine.back_emf_constant"} & {*measured}


def test_heads_prefixes_and_names() -> None:
    entries = MOTORS.entries()
    assert [entry.key for entry in entries] == MOTOR_NAMES
    for entry in entries:
        assert entry.name
        assert len(entry.about) <= 80
        assert re.search(r"\b\d+ V\b", f"{entry.about} {entry.tags}"), entry.key
        assert len(entry.tags.split(",")) >= 4, entry.key
    prefixes = [catalogue.load(name).export.prefix for name in [*MOTOR_NAMES, *catalogue.names()]]
    assert len({*prefixes}) == len(prefixes)
    assert not {*MOTOR_NAMES} & {*catalogue.names()}


@pytest.mark.parametrize("name", MOTOR_NAMES)
def test_a_motor_is_plausible(name: str) -> None:
    design = catalogue.load(name)
    assert [said for said in design.assumptions if "usual is" in said] == []
    machine = linear(design)
    # electrical time constants of wound machines
    assert 50e-6 < machine.l_d / machine.r_s < 50e-3
    assert machine.l_d <= machine.l_q
    no_load = speed_constant(machine) * design.inverter.v_dc
    if machine.omega_m_max is not None and name not in WEAKENED:
        assert 30.0 / math.pi * machine.omega_m_max <= no_load
    # the current limit leaves the voltage for some speed
    assert machine.r_s * machine.i_max < 0.6 * design.inverter.v_dc / math.sqrt(3.0)


# Figures that the sources state and the designs do not use.


def torque_constant(design: Design) -> float:
    """Torque per ampere of the peak, with the current across the magnets."""
    machine = linear(design)
    return 1.5 * machine.pole_pairs * machine.psi_pm


def torque_per_rms(design: Design) -> float:
    """Torque per ampere r.m.s."""
    return math.sqrt(2.0) * torque_constant(design)


def kv(design: Design) -> float:
    """Speed in rpm per volt of the peak between terminals."""
    return speed_constant(linear(design))


def no_load(design: Design) -> float:
    """Speed in rpm at which the back-EMF reaches the voltage of the link."""
    return kv(design) * design.inverter.v_dc


def volts_per_hertz(design: Design) -> float:
    """Peak of a phase per turn of the shaft in a second."""
    machine = linear(design)
    return 2.0 * math.pi * machine.pole_pairs * machine.psi_pm


def electrical_flux(design: Design) -> float:
    """V/Hz of the electrical frequency, peak of a phase."""
    return 2.0 * math.pi * linear(design).psi_pm


def largest(design: Design) -> float:
    """Largest torque within the current limit, by trying angles."""
    machine = linear(design)
    angles = [math.pi / 2.0 * (1.0 + step / 2000.0) for step in range(2001)]
    currents = ((machine.i_max * math.cos(a), machine.i_max * math.sin(a)) for a in angles)
    return max(
        1.5 * machine.pole_pairs * (machine.psi_pm + (machine.l_d - machine.l_q) * i_d) * i_q
        for i_d, i_q in currents
    )


Relation = Callable[[Design], float]
RELATIONS: list[tuple[str, Relation, float, float]] = [
    ("odrive-botwheel", torque_constant, 0.951, 0.01),  # N m/A, motor table
    ("odrive-d5065-270kv", torque_constant, 0.031, 0.02),
    ("odrive-d6374-150kv", torque_constant, 0.055, 0.01),
    ("odrive-m8325s-100kv", torque_constant, 0.083, 0.01),
    ("mjbots-mj5208", volts_per_hertz, 0.10899, 0.04),  # v_per_hz by spinning, not by the sweep
    ("mad-8318", volts_per_hertz, 0.29212, 0.02),
    ("flipsky-6374", volts_per_hertz, 0.20119, 0.03),
    ("mjbots-mj5208", kv, 330.0, 0.08),  # rpm/V by its maker
    ("cubemars-ak80-9", torque_constant, 0.095, 0.15),
    ("mini-cheetah-motor", torque_constant, 0.075, 0.02),  # KT of the same file
    ("tmotor-v2207-1500kv", torque_constant, 0.00609, 0.11),  # by a torque sensor
    ("br2804-1700kv", kv, 1000.0 / 0.600, 0.03),  # 0.6 V/krpm of another model
    ("gbm2804h-100t", no_load, 12.0 / 10.0 * 1550.0 / 0.866, 0.2),  # sine of 8.66 V, with friction
    ("shinano-la052", no_load, 4000.0, 0.1),  # largest speed of the project
    ("linix-45zwn24-40", torque_constant, 40.0 / (4000.0 * math.pi / 30.0) / 2.34, 0.03),
    ("teknic-m2310p", torque_constant, 0.0393, 0.05),  # Ke of NXP, V s/rad
    ("estun-emj-04apb", electrical_flux, 0.38213, 0.03),  # V/Hz in other files of TI
    ("hurst-dmb0224c10002", no_load, 3125.0, 0.03),  # base speed of the model
    ("hurst-dma0204024b101", kv, 1000.0 / 6.7316, 0.09),  # another release
    ("nanotec-db42m03", no_load, 6000.0, 0.09),  # without load, by the source
    ("kollmorgen-akm44h", torque_per_rms, 1.06, 0.07),  # hot
    ("beckhoff-am8051e", torque_per_rms, 1.77, 0.17),  # hot
    ("brusa-hsm1", lambda design: linear(design).psi_pm, 71.66e-3, 0.09),  # measured map
    ("toyota-prius-2004", largest, 400.0, 0.03),  # rating; measured at standstill 340
]


@pytest.mark.parametrize(
    ("name", "relation", "stated", "within"), RELATIONS, ids=[name for name, *_ in RELATIONS]
)
def test_other_figures_of_the_motor_agree(
    name: str, relation: Relation, stated: float, within: float
) -> None:
    assert relation(catalogue.load(name)) == pytest.approx(stated, rel=within)


def test_the_page_has_the_table_of_the_files() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert "\n".join(table()) in text, "run: python tests/motor_table.py"
