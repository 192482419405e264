"""The library of designs: all load, their origin is stated, and the papers' numbers are in them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import largest_torque
from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import format_quantity

ANGLE = np.linspace(0.0, np.pi, 20_001)


def test_names() -> None:
    assert catalogue.names() == [
        "abb-ipmsm-2k2",
        "abb-syrm-6k7",
        "abb-syrm-6k7-saturated",
        "baldor-pmsyrm-5k6",
        "paper000-ipmsm-100kw",
        "paper001-pmsm-bench",
        "paper002-phase-waveforms",
        "paper002-pmsm-nonsinusoidal",
        "salient-phase-waveforms",
        "thor-pmsyrm-5k",
        "vdyno-trampa-6340",
    ]


@pytest.mark.parametrize("name", catalogue.names())
def test_each_value_of_the_drive_has_an_origin(name: str) -> None:
    design = catalogue.load(name)
    for value in design.values:
        if value.path.startswith(("machine.", "inverter.")):
            assert value.source or value.inferred, f"{value.path} does not say where it comes from"
        if value.inferred:
            assert value.note, f"{value.path} does not say how it was inferred"


@pytest.mark.thinned
@pytest.mark.parametrize("name", catalogue.names())
def test_designs_have_different_prefixes_and_reachable_points(name: str) -> None:
    design = catalogue.load(name)
    others = [catalogue.load(other).export.prefix for other in catalogue.names() if other != name]
    assert design.export.prefix not in others
    machine = design.machine
    largest = np.max(machine.torque(*(design.i_max * np.array([np.cos(ANGLE), np.sin(ANGLE)]))))
    assert design.fit.torque_max is None or design.fit.torque_max <= largest
    for point in design.losses.points if design.losses else ():
        assert abs(point.torque) <= largest


@pytest.mark.parametrize(
    "name", ["paper00", "paper001-pmsm-bensh", "../library/template", "template", "", "a/b", "x\n"]
)
def test_unknown_name(name: str) -> None:
    with pytest.raises(InputError) as caught:
        catalogue.read_text(name)
    assert str(caught.value).isprintable()
    assert "in the library" in caught.value.message


def test_unknown_name_suggests_a_known_one() -> None:
    with pytest.raises(InputError, match="did you mean paper001-pmsm-bench"):
        catalogue.load("paper001-pmsm-bensh")
    with pytest.raises(InputError, match="did you mean abb-ipmsm-2k2"):
        catalogue.load("abb")


def test_templates() -> None:
    general = catalogue.template()
    assert load_text(general, "template.yaml").export.prefix == "motor1"
    assert all(line == line.rstrip() and len(line) <= 120 for line in general.decode().splitlines())
    assert catalogue.template("paper001-pmsm-bench") == catalogue.read_text("paper001-pmsm-bench")
    with pytest.raises(InputError):
        catalogue.template("nothing")


def test_commented_alternatives_of_the_template_are_valid() -> None:
    text = catalogue.template().decode()
    for old, new in (
        ("  # back_emf_constant:", "  back_emf_constant:"),
        ("  # torque_constant:", "  torque_constant:"),
        ("    # power: 246 W", "    power: 246 W"),
        ("    # frequency: 250 Hz", "    frequency: 250 Hz"),
        ("    method: magnitude-optimum ", "    method: given "),
        ("    # kp:", "    kp:"),
        ("    # ki:", "    ki:"),
        ("    # q_formats:", "    q_formats:"),
        ("    # on_voltage:", "    on_voltage:"),
        ("    # diode_voltage:", "    diode_voltage:"),
        ("    # diode_resistance:", "    diode_resistance:"),
        ("    # reverse_recovery_energy:", "    reverse_recovery_energy:"),
        ("  # per_unit:", "  per_unit:"),
        ("  segments: 1 ", "  segments: 2 "),
        ("  # max_torque:", "  max_torque:"),
        ("  # breakpoints:", "  breakpoints:"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    assert load_text(text.encode(), "t").fit.breakpoints == (0.7,)


@pytest.fixture(scope="module")
def bench() -> Design:
    return catalogue.load("paper001-pmsm-bench")


def test_paper001_gains_are_the_integers_of_its_program(bench: Design) -> None:
    control, bases = bench.control, bench.control.bases
    current, speed = control.current_loop, control.speed_loop
    assert speed is not None
    for gain in (current.kp, current.ki, speed.kp, speed.ki):
        assert gain is not None
    per_ohm = bases.current / bases.voltage
    per_gain = bases.speed / bases.torque
    h = control.t_s * speed.ratio
    assert h == pytest.approx(2e-3)
    # Table 8.1 in the program's formats: 136 (Q10), 26 (Q15), 20000 (Q10), 2500 (Q10).
    assert (current.kp or 0.0) * per_ohm * 2**10 == pytest.approx(136.0, rel=1e-9)
    assert (current.ki or 0.0) * control.t_s * per_ohm * 2**15 == pytest.approx(26.0, rel=1e-9)
    assert (speed.kp or 0.0) * per_gain * 2**10 == pytest.approx(20000.0, rel=1e-9)
    assert (speed.ki or 0.0) * h * per_gain * 2**10 == pytest.approx(2500.0, rel=1e-9)
    assert (current.q_formats, speed.q_formats) == ((10, 15), (10, 10))


def test_paper001_machine(bench: Design) -> None:
    # Tables A.1 and A.2 of the thesis.
    machine = bench.machine
    assert (machine.pole_pairs, machine.r_s, machine.l_d, machine.l_q) == (
        3,
        2.35,
        1.61e-3,
        1.74e-3,
    )
    assert (machine.psi_pm, machine.inertia, machine.friction) == (0.06, 200e-6, 40e-6)
    assert bench.control.bases.current == 12.8
    assert bench.control.bases.speed == pytest.approx(6750.0 * math.pi / 30.0, rel=1e-14)
    assert bench.strategy == "id0"


def test_paper000() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    machine, device = design.machine, design.inverter.device
    assert (machine.pole_pairs, machine.r_s, machine.psi_pm) == (4, 2e-3, 0.1049)
    assert machine.saliency == pytest.approx(242e-6, rel=1e-12)
    assert device is not None
    # 328 W of switching loss in the first column of table 4: 3 f E (2/pi) (I/I_ref)
    # (V/V_ref) at 130 N m, i_d = 0.
    current = 130.0 / machine.torque_per_ampere
    relative = current / device.reference_current * design.inverter.v_dc / device.reference_voltage
    loss = 3.0 * design.inverter.f_sw * device.switching_energy * 2.0 / math.pi * relative
    assert loss == pytest.approx(328.0, abs=0.1)
    assert design.losses is not None
    assert [(p.torque, p.omega_m) for p in design.losses.points] == [(130.0, 300.0)]
    assert any("684.96 V" in sentence for sentence in design.assumptions)


def test_paper002() -> None:
    design = catalogue.load("paper002-pmsm-nonsinusoidal")
    # Table 6.1: 0.75 kW at 1800 rpm is 3.979 N m, and the rated current makes it.
    assert design.machine.pole_pairs == 2
    assert format_quantity(design.machine.torque_per_ampere * design.i_max, "N m", 4) == "3.979 N m"


def test_library_follows_the_source_of_public_machines() -> None:
    # Rated torque of the ABB machine is 14 N m at 4.3 A (r.m.s.):
    # the linear model gives it within a few percent.
    machine = catalogue.load("abb-ipmsm-2k2").machine
    torque = largest_torque(
        machine.pole_pairs, machine.psi_pm, machine.saliency, 4.3 * math.sqrt(2.0)
    )
    assert torque == pytest.approx(14.0, rel=0.1)
