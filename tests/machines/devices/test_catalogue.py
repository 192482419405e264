"""The devices that ship: every value has its source, and they agree with their data
sheets and with the paper.
"""

from __future__ import annotations

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.catalogue import device_values, read_device_yaml
from dqforge.machines.errors import InputError

NAMES = [
    "fuji-2mbi300xbe120-50",
    "infineon-ff200r12ke3",
    "microchip-mscsm70am10ct3ag",
    "mitsubishi-cm200dy-24t",
    "sirectifier-sii400s12",
    "ti-csd19505ktt",
    "wolfspeed-c2m0045170d",
]


def test_names() -> None:
    assert device_catalogue.names() == NAMES
    with pytest.raises(InputError, match="did you mean ti-csd19505ktt"):
        device_catalogue.load("csd19505ktt")
    with pytest.raises(InputError, match="there are fuji"):
        device_catalogue.load("../template")


@pytest.mark.parametrize("name", NAMES)
def test_each_value_has_an_origin(name: str) -> None:
    values = device_values(device_catalogue.read_text(name), name)
    assert len(values) > 10
    for path, value in values:
        assert value.source or value.inferred, f"{path} does not say where it comes from"
        if value.inferred:
            assert value.note, f"{path} does not say how it was inferred"


def test_igbt_agrees_with_its_saturation_voltages() -> None:
    """V_CEsat 1.9 (2.1) V and V_F 2.0 (1.8) V at 300 A and 25 (125) degC stand in
    the data sheet on their own.
    """
    device = device_catalogue.load("sirectifier-sii400s12")
    assert device.on_voltage(300.0, [25.0, 125.0]).value == pytest.approx([1.9, 2.1])
    assert device.diode_voltage(300.0, [25.0, 125.0]).value == pytest.approx([2.0, 1.8])
    assert device.turn_on_energy(300.0, 600.0, 125.0).value == pytest.approx(32e-3)


def test_module_of_paper_000_has_the_losses_of_its_design() -> None:
    """Made constants at the paper's point it is the inline device of the shipped
    design but for the heat sink.
    """
    inline = catalogue.load("paper000-ipmsm-100kw").inverter.device
    device = device_catalogue.load("microchip-mscsm70am10ct3ag").switch_device(
        206.55, 500.0, 112.32
    )
    assert inline is not None
    assert device.on_resistance == pytest.approx(inline.on_resistance, rel=1e-12)
    assert device.switching_energy == pytest.approx(inline.switching_energy, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "part", "points"),
    [
        (
            "infineon-ff200r12ke3",
            "thermal",
            [
                (2.7496e-3, 0.015116),
                (0.012398, 0.040411),
                (0.046643, 0.08437),
                (0.12009, 0.11025),
                (1.16, 0.11874),
            ],
        ),
        (
            "infineon-ff200r12ke3",
            "diode_thermal",
            [
                (2.9517e-3, 0.027144),
                (0.012071, 0.068975),
                (0.046167, 0.14612),
                (0.11849, 0.18998),
                (1.1442, 0.20419),
            ],
        ),
        (
            "mitsubishi-cm200dy-24t",
            "thermal",
            [
                (9.9893e-4, 0.0104013),
                (5.1577e-3, 0.0284766),
                (0.016956, 0.0498387),
                (0.056511, 0.0611566),
            ],
        ),
        (
            "mitsubishi-cm200dy-24t",
            "diode_thermal",
            [(9.9893e-4, 0.0188214), (0.016956, 0.0901843)],
        ),
        (
            "fuji-2mbi300xbe120-50",
            "thermal",
            [
                (1.1112e-3, 0.0070405),
                (4.6018e-3, 0.018934),
                (0.018878, 0.039805),
                (0.077415, 0.06866),
                (0.31721, 0.080852),
            ],
        ),
    ],
)
def test_networks_make_the_figures_of_their_data_sheets(
    name: str, part: str, points: list[tuple[float, float]]
) -> None:
    """Elements are printed as numbers, the impedance as a figure: two statements,
    agreeing to the width of a line.
    """
    network = getattr(device_catalogue.load(name), part)
    time, impedance = zip(*points, strict=True)
    assert network.step_response(time) == pytest.approx(impedance, rel=0.035)


@pytest.mark.parametrize(
    ("name", "rated", "drops", "forward", "energies", "resistances"),
    [
        (
            "fuji-2mbi300xbe120-50",
            300.0,
            (1.52, 1.95),
            (1.59, 1.60),
            (35e-3, 30e-3, 23.5e-3),
            (0.08, 0.105),
        ),
        (
            "infineon-ff200r12ke3",
            200.0,
            (1.70, 2.00),
            (1.65, 1.65),
            (15e-3, 35e-3, 17e-3),
            (0.12, 0.20),
        ),
        (
            "mitsubishi-cm200dy-24t",
            200.0,
            (1.56, 1.81),
            (1.65, 1.65),
            (15e-3, 23e-3, 14.6e-3),
            (0.063, 0.114),
        ),
    ],
)
def test_modules_at_their_rated_current(
    name: str,
    rated: float,
    drops: tuple[float, float],
    forward: tuple[float, float],
    energies: tuple[float, float, float],
    resistances: tuple[float, float],
) -> None:
    """Figures of cold and hottest curve at the rated current and 600 V, read off again,
    and the steady resistances.
    """
    device = device_catalogue.load(name)
    hot = 125.0 if name.startswith("infineon") else 150.0
    assert device.on_voltage(rated, [25.0, hot]).value == pytest.approx(drops, rel=0.01)
    assert device.diode_voltage(rated, [25.0, hot]).value == pytest.approx(forward, rel=0.015)
    for method, energy in zip(
        (device.turn_on_energy, device.turn_off_energy, device.recovery_energy),
        energies,
        strict=True,
    ):
        assert method(rated, 600.0, hot).value == pytest.approx(energy, rel=0.02)
    assert device.thermal is not None
    assert device.diode_thermal is not None
    found = device.thermal.resistance, device.diode_thermal.resistance
    assert found == pytest.approx(resistances, rel=2e-3)


def test_mosfets() -> None:
    silicon, carbide = (device_catalogue.load(name) for name in NAMES[5:])
    assert carbide.on_resistance(50.0, [25.0, 87.5, 150.0]).value == pytest.approx(
        [45e-3, 67.5e-3, 90e-3]
    )
    assert carbide.turn_on_energy(50.0, 1200.0, 150.0).value == pytest.approx(4.7e-3)
    # The estimate that the head of the file derives, recomputed from the charges.
    charge, gate = (25.0 - 15.0 + 11.0) * 1e-9, 5.0 + 1.4
    plateau = 2.6 + 100.0 / 262.0
    crossing = [0.5 * 40.0 * 100.0 * charge * gate / drive for drive in (10.0 - plateau, plateau)]
    found = silicon.turn_on_energy(100.0, 40.0, 25.0).value
    assert found == pytest.approx(crossing[0] + 40.0 * 214e-9, rel=5e-3)
    assert silicon.turn_off_energy(100.0, 40.0, 25.0).value == pytest.approx(crossing[1], rel=5e-3)


BASE = device_catalogue.read_text("sirectifier-sii400s12").decode()
CONDITION = 'turn_on:\n  voltage: {value: 600 V, source: "data sheet, V_CC"}\n'
RESISTIVE = """    threshold: {value: 1 V, source: "data sheet, V_CE(TO)"}
    resistance: {value: 3 mOhm, source: "data sheet, r_CE"}
"""
POINTS = "    points: [{{current: 50 A, voltage: 1 V}}, {{current: {0}, voltage: {1}}}]\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("32 mJ", "-32 mJ", "turn_on.curves[0].points[0].energy: '-32 mJ' must be zero or positive"),
        ("32 mJ", "32 J", "look like mJ"),
        ("{value: 600 V, source", "{value: 0.1 V, source", "turn_on.voltage"),
        ("{value: 125 degC, source: data sheet}\n", "{value: 25 degC, source: data sheet}\n", "each once"),
        (CONDITION, "turn_on:\n", "turn_on needs the key 'voltage'"),
        (RESISTIVE, POINTS.format(40, 2.0), "abscissa 1 is 40, not above 50"),
        (RESISTIVE, POINTS.format(300, 0.4), "the drop 1 falls to 0.4 V from 1 V while the current rises to 300 A"),
        (RESISTIVE, POINTS.format(300, -2.0), "must be zero or positive"),
        (RESISTIVE, POINTS.format("300 V", 2.0), "current"),
        ("kind: igbt", "kind: thyristor", "expected one of mosfet, igbt"),
        ("recovery:", "recovers:", "did you mean 'recovery'"),
        ("    resistance: {value: 3 mOhm, source: \"data sheet, r_CE\"}\n", "", "write either resistance"),
        ("value: 0.055 K/W", "value: 0.055 kg", "thermal.resistance"),
    ],
)  # fmt: skip
def test_faults_have_a_position(old: str, new: str, words: str) -> None:
    assert old in BASE
    with pytest.raises(InputError) as caught:
        read_device_yaml(BASE.replace(old, new, 1).encode(), "d.yaml")
    assert words in str(caught.value)
    assert caught.value.line is not None


def test_igbt_needs_its_diode() -> None:
    start, end = BASE.index("diode:\n"), BASE.index("turn_on:\n")
    with pytest.raises(InputError, match="no data for the diode; write diode:"):
        read_device_yaml((BASE[:start] + BASE[end:]).encode(), "d.yaml")


def test_points_and_gate_resistance() -> None:
    text = BASE.replace(
        "turn_off:\n",
        """  over_gate_resistance:
    - temperature: 125 degC
      points: [{resistance: 2 Ohm, energy: 20 mJ}, {resistance: 4.7 Ohm, energy: 30 mJ}]
turn_off:
""",
    )
    device = read_device_yaml(text.encode(), "d.yaml")
    assert device.turn_on_energy(300.0, 600.0, 125.0, 2.0).value == pytest.approx(32e-3 * 2.0 / 3.0)
