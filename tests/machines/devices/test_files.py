"""Device files: real ones give their own numbers back, planted faults
are named with their place.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.devices.files import MAX_BYTES, read_device
from dqforge.machines.errors import InputError

FUJI, UNITED = "Fuji_2MBI300XBE120-50.json", "UnitedSiC_UF3SC065007K4S.json"
PLECS = """<?xml version="1.0" encoding="ISO-8859-1"?>
<SemiconductorLibrary xmlns="http://www.plexim.com/xml/semiconductors/" version="1.1">
  <Package class="MOSFET with Diode" vendor="Maker" partnumber="X1">
    <Variables/>
    <SemiconductorData type="MOSFET with Diode">
      <TurnOnLoss>
        <ComputationMethod>Table only</ComputationMethod>
        <CurrentAxis>-100 0 50 100</CurrentAxis>
        <VoltageAxis>0 400</VoltageAxis>
        <TemperatureAxis>25 150</TemperatureAxis>
        <Energy scale="0.001">
          <Temperature><Voltage>0 0 0 0</Voltage><Voltage>0 0.1 1 2.5</Voltage></Temperature>
          <Temperature><Voltage>0 0 0 0</Voltage><Voltage>0 0.2 1.5 3.5</Voltage></Temperature>
        </Energy>
      </TurnOnLoss>
      <TurnOffLoss>
        <ComputationMethod>Table only</ComputationMethod>
        <CurrentAxis>-100 -50 0 50 100</CurrentAxis>
        <VoltageAxis>400</VoltageAxis>
        <TemperatureAxis>25</TemperatureAxis>
        <Energy scale="0.001"><Temperature><Voltage>0.6 0.4 0 0.8 1.8</Voltage></Temperature></Energy>
      </TurnOffLoss>
      <ConductionLoss gate="on">
        <ComputationMethod>Table only</ComputationMethod>
        <CurrentAxis>-100 0 100</CurrentAxis>
        <TemperatureAxis>25 150</TemperatureAxis>
        <VoltageDrop scale="1"><Temperature>-1 0 1</Temperature><Temperature>-1.6 0 1.6</Temperature></VoltageDrop>
      </ConductionLoss>
      <ConductionLoss gate="off">
        <ComputationMethod>Table only</ComputationMethod>
        <CurrentAxis>-100 -1 0</CurrentAxis>
        <TemperatureAxis>25</TemperatureAxis>
        <VoltageDrop scale="1"><Temperature>-4.5 -2.5 0</Temperature></VoltageDrop>
      </ConductionLoss>
    </SemiconductorData>
    <ThermalModel><Branch type="Cauer">
      <RCElement R="0.05" C="0.01"/><RCElement R="0.1" C="0.2"/>
    </Branch></ThermalModel>
  </Package>
</SemiconductorLibrary>
"""


def small() -> dict[str, Any]:
    """A made-up IGBT of a few points in the form of transistordatabase."""

    def energy(scale: float) -> dict[str, Any]:
        return {
            "dataset_type": "graph_i_e",
            "v_supply": 600,
            "v_g": 15,
            "t_j": 125,
            "r_g": 2,
            "graph_i_e": [[0, 100, 300], [1e-3 * scale, 5e-3 * scale, 2e-2 * scale]],
            "graph_r_e": None,
            "i_x": None,
            "e_x": None,
        }

    channel = [{"t_j": t, "v_g": 15, "graph_v_i": [[0, 0.8, 2.0], [0, 0, 300]]} for t in (25, 125)]
    foster = {
        "r_th_total": 0.08,
        "r_th_vector": [0.03, 0.05],
        "tau_vector": [0.01, 0.1],
        "tau_total": None,
    }
    return {
        "name": "made up",
        "type": "IGBT",
        "i_abs_max": 600,
        "v_abs_max": 1200,
        "switch": {
            "t_j_max": 175,
            "channel": channel,
            "e_on": [energy(1.0)],
            "e_off": [energy(1.2)],
            "thermal_foster": foster,
        },
        "diode": {
            "channel": copy.deepcopy(channel),
            "e_rr": [energy(0.5)],
            "thermal_foster": copy.deepcopy(foster),
        },
    }


def encoded(data: object) -> bytes:
    return json.dumps(data).encode()


@pytest.mark.parametrize("name", [FUJI, UNITED])
def test_real_files_give_their_own_points_back(shared_data: Path, name: str) -> None:
    content = (shared_data / "devices" / name).read_bytes()
    device, raw = read_device(content, name), json.loads(content)
    for key, method in (("e_on", device.turn_on_energy), ("e_off", device.turn_off_energy)):
        for entry in raw["switch"][key]:
            if entry["dataset_type"] == "graph_i_e":
                current, energy = entry["graph_i_e"]
                found = method(current, entry["v_supply"], entry["t_j"])
                assert found.value == pytest.approx(energy, rel=1e-13)
                assert not found.outside.any()
    for entry in raw["diode"]["e_rr"]:
        if entry["dataset_type"] == "graph_i_e":
            current, energy = entry["graph_i_e"]
            assert device.recovery_energy(
                current, entry["v_supply"], entry["t_j"]
            ).value == pytest.approx(energy)
    for entry in raw["switch"]["channel"]:
        if entry["v_g"] == 15:
            volt, current = map(np.array, entry["graph_v_i"])
            conducting = current > 0.0
            found = device.on_voltage(current[conducting], entry["t_j"])
            assert found.value == pytest.approx(volt[conducting], rel=1e-13)


def test_real_files_against_figures_read_by_hand(shared_data: Path) -> None:
    """Figures from the notes that were made when the files were collected."""
    united = read_device((shared_data / "devices" / UNITED).read_bytes(), UNITED)
    fuji = read_device((shared_data / "devices" / FUJI).read_bytes(), FUJI)
    assert united.turn_on_energy(108.6, 400.0, 25.0).value == pytest.approx(1.151e-3, rel=1e-3)
    found = fuji.turn_on_energy(594.0, 600.0, [25.0, 125.0, 150.0]).value
    assert found == pytest.approx([43.4e-3, 74.1e-3, 82.3e-3], rel=0.01)
    assert (fuji.kind, united.kind) == ("igbt", "mosfet")
    assert fuji.thermal is not None
    assert fuji.thermal.resistance == pytest.approx(0.08, rel=1e-3)
    # An IGBT of 1200 V and 300 A drops some one and a half volts at its rated current.
    assert 1.3 < float(fuji.on_voltage(300.0, 25.0).value) < 1.7
    # Energies over gate resistance at 300 A: from 1.8 to 10 Ohm turn-on more than doubles.
    ratio = (
        fuji.turn_on_energy(300.0, 600.0, 125.0, 10.0).value
        / fuji.turn_on_energy(300.0, 600.0, 125.0).value
    )
    entry = json.loads((shared_data / "devices" / FUJI).read_bytes())["switch"]["e_on"][5]
    assert ratio == pytest.approx(
        np.interp(10.0, *entry["graph_r_e"]) / np.interp(1.8, *entry["graph_r_e"]), rel=1e-12
    )


def test_upstream_defects_are_found_and_named(shared_data: Path) -> None:
    """The turn-off energies over gate resistance of this file are those of turn-on,
    at ten times the current.
    """
    findings = read_device((shared_data / "devices" / UNITED).read_bytes(), UNITED).findings
    assert any(text.startswith("switch.e_off[1].graph_r_e does not agree") for text in findings)
    assert any("the parts make 0.19105 K/W, r_th_total is 0.15" in text for text in findings)
    assert not any("e_on" in text for text in findings)


def set_at(*path: str | int, value: object) -> Callable[[dict[str, Any]], None]:
    def change(data: Any) -> None:
        for part in path[:-1]:
            data = data[part]
        data[path[-1]] = value

    return change


CURVE = ("graph_i_e",)
FAULTS: list[tuple[str, Callable[[dict[str, Any]], None], str, str]] = [
    (
        "negative energy",
        set_at("switch", "e_on", 0, "graph_i_e", 1, 1, value=-1e-3),
        "switch.e_on[0].graph_i_e",
        "negative",
    ),
    (
        "no voltage",
        set_at("switch", "e_off", 0, "v_supply", value=None),
        "switch.e_off[0]",
        "write v_supply",
    ),
    (
        "descending",
        set_at("switch", "e_on", 0, "graph_i_e", 0, 2, value=50),
        "switch.e_on[0].graph_i_e",
        "ascending",
    ),
    (
        "millijoule",
        set_at("switch", "e_on", 0, "graph_i_e", 1, value=[1, 5, 20]),
        "switch.e_on[0].graph_i_e",
        "mJ",
    ),
    (
        "microjoule",
        set_at("switch", "e_on", 0, "graph_i_e", 1, value=[1e3, 5e3, 2e4]),
        "switch.e_on[0].graph_i_e",
        "uJ",
    ),
    ("kelvin", set_at("diode", "e_rr", 0, "t_j", value=398.15), "diode.e_rr[0].t_j", "kelvin"),
    (
        "kelvin channel",
        set_at("switch", "channel", 0, "t_j", value=298),
        "switch.channel[0].t_j",
        "kelvin",
    ),
    (
        "milliampere",
        set_at("switch", "e_on", 0, "graph_i_e", 0, value=[0, 1e5, 3e5]),
        "switch.e_on[0].graph_i_e",
        "mA",
    ),
    (
        "millivolt",
        set_at("switch", "channel", 1, "graph_v_i", 0, value=[0, 800, 2000]),
        "switch.channel[1].graph_v_i",
        "mV",
    ),
    (
        "falling drop",
        set_at("switch", "channel", 1, "graph_v_i", value=[[0, 2.0, 0.8], [0, 100, 300]]),
        "switch.channel[1].graph_v_i",
        "falls to 0.8 V from 2 V",
    ),
    ("no diode", set_at("diode", "channel", value=[]), "diode.channel", "no data for the diode"),
    ("diode null", set_at("diode", value=None), "diode.channel", "no data for the diode"),
    (
        "not finite",
        set_at("switch", "e_on", 0, "graph_i_e", 1, 2, value=float("nan")),
        "graph_i_e[1][2]",
        "not finite",
    ),
    (
        "infinite",
        set_at("switch", "e_on", 0, "t_j", value=float("inf")),
        "switch.e_on[0].t_j",
        "not finite",
    ),
    (
        "text",
        set_at("switch", "e_on", 0, "v_supply", value="600 V"),
        "switch.e_on[0].v_supply",
        "without quotes",
    ),
    (
        "lengths",
        set_at("switch", "e_on", 0, "graph_i_e", 1, value=[1e-3]),
        "switch.e_on[0].graph_i_e",
        "as many",
    ),
    ("type", set_at("type", value="Diode"), "type", "no switch"),
    (
        "dataset",
        set_at("switch", "e_on", 0, "dataset_type", value="graph"),
        "switch.e_on[0].dataset_type",
        "graph_i_e",
    ),
    ("no energies", set_at("switch", "e_on", value=[]), "switch.e_on", "no switching energies"),
    ("no channel", set_at("switch", "channel", value=None), "switch.channel", "no on-state curve"),
    (
        "foster",
        set_at("switch", "thermal_foster", "r_th_vector", 0, value=-1),
        "thermal_foster.r_th_vector[0]",
        "K/W",
    ),
    (
        "tau",
        set_at("switch", "thermal_foster", "tau_vector", value=[0.1]),
        "switch.thermal_foster",
        "one of each",
    ),
    ("list", set_at("switch", "e_on", value={"a": 1}), "switch.e_on", "expected a list"),
    ("object", set_at("switch", value=[1]), "switch", "expected an object"),
    ("long", set_at("switch", "e_on", value=[{}] * 500), "switch.e_on", "at most 200"),
]


def test_made_up_device_is_read() -> None:
    device = read_device(encoded(small()), "d.json")
    assert device.turn_on_energy(100.0, 600.0, 125.0).value == pytest.approx(5e-3)
    assert device.on_voltage(0.0, 25.0).value == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("name", "change", "path", "words"), FAULTS, ids=[fault[0] for fault in FAULTS]
)
def test_planted_faults_in_json(
    name: str, change: Callable[[Any], None], path: str, words: str
) -> None:
    data = small()
    change(data)
    with pytest.raises(InputError) as caught:
        read_device(encoded(data), "d.json")
    text = str(caught.value)
    assert text.startswith("d.json: ")
    assert path in text
    assert words in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("content", "name", "words"),
    [
        (b"{", "d.json", "d.json:1:2: not JSON"),
        (b'{"a": 1,\n}', "d.json", "d.json:2:1: not JSON"),
        (b"\xff\xfe", "d.json", "not UTF-8"),
        (b"[" * 100_000, "d.json", "d.json"),
        (b'{"type": ' + b"9" * 10_000 + b"}", "d.json", "too many digits"),
        (b"[1]", "d.json", "expected an object"),
        (b"x" * (MAX_BYTES + 1), "d.json", "more than 5 MB"),
        (b"", "d.xml", "d.xml:1"),
        (b"{}", "d.txt", "write .json"),
        (b"<a><b></a>", "d.xml", "d.xml:1:9: not XML: mismatched tag"),
        (b"<a/>", "d.xml", "no PLECS description"),
        (b'<?xml version="1.0" encoding="nonsense"?><a/>', "d.xml", "d.xml:1"),
        (b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "d.xml", "document type"),
        (b"<a>" * 100, "d.xml", "32 levels"),
        (b"a: 1", "d.yaml", "d.yaml:1:1"),
    ],
)
def test_files_of_no_format(content: bytes, name: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_device(content, name)
    assert words in str(caught.value)


def test_plecs_points() -> None:
    device = read_device(PLECS.encode("latin-1"), "x.xml")
    assert device.name == "Maker X1"
    assert device.turn_on_energy([0.0, 50.0, 100.0], 400.0, 150.0).value == pytest.approx(
        [2e-4, 1.5e-3, 3.5e-3]
    )
    # The row at 0 V makes it linear in the voltage.
    assert device.turn_on_energy(100.0, 200.0, 25.0).value == pytest.approx(1.25e-3)
    assert device.turn_off_energy([50.0, 100.0], 400.0, 25.0).value == pytest.approx(
        [0.8e-3, 1.8e-3]
    )
    assert device.recovery_energy([50.0, 100.0], 400.0, 25.0).value == pytest.approx(
        [0.4e-3, 0.6e-3]
    )
    assert device.on_resistance(100.0, [25.0, 150.0]).value == pytest.approx([1e-2, 1.6e-2])
    assert device.diode_voltage([1.0, 100.0], 25.0).value == pytest.approx([2.5, 4.5])
    assert device.thermal is not None
    assert device.thermal.resistance == pytest.approx(0.15)


def test_plecs_formula_beside_a_table_is_said_to_be_left_out() -> None:
    text = PLECS.replace("Table only</", "Table and formula</", 1).replace(
        "<Current", "<Formula>E*Rg/5</Formula><Current", 1
    )
    assert any(
        "the formula 'E*Rg/5' is ignored" in finding
        for finding in read_device(text.encode(), "x.xml").findings
    )


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("0 0.1 1 2.5", "0 0.1 -1 2.5", 12, "negative"),
        ("0 0.1 1 2.5", "0 0.1 1", 12, "3 values for 4 currents"),
        ("0 0.1 1 2.5", "0 0.1 nan 2.5", 12, "not finite"),
        ("0 0.1 1 2.5", "0 0.1 one 2.5", 12, "not a number"),
        ('<Energy scale="0.001">\n', '<Energy scale="1">\n', 12, "look like mJ"),
        ("<VoltageAxis>400<", "<VoltageAxis>0<", 19, "reference voltage is missing"),
        ("<VoltageAxis>400<", "<VoltageAxis>-400<", 19, "reference voltage is missing"),
        ("-100 0 50 100", "-100 50 0 100", 8, "ascending"),
        ("-100 0 50 100", "-100000 0 50000 100000", 12, "mA"),
        ("<TemperatureAxis>25 150<", "<TemperatureAxis>298 423<", 10, "kelvin"),
        ("<TemperatureAxis>25 150<", "<TemperatureAxis>25<", 11, "1 values of TemperatureAxis"),
        ("<Temperature>-1 0 1<", "<Temperature>-1 2 1<", 27, "falls to 1 V from 2 V while the current rises to 100 A"),
        ("<Temperature>-4.5 -2.5 0<", "<Temperature>-2.5 -4.5 0<", 33, "falls to 2.5 V from 4.5 V"),
        ('type="MOSFET with Diode"', 'type="Diode"', 5, "no switch"),
        ('R="0.05"', 'R="x"', 37, "not a number"),
        ('R="0.05"', 'R="-0.05"', 37, "K/W"),
        ('type="Cauer"', 'type="Ladder"', 36, "Foster or Cauer"),
        ('gate="off"', 'gate="on"', 29, "a second table"),
        ("Table only<", "Formula only<", 6, "Table only"),
        ('scale="1"><Temperature>-1 ', 'scale="0"><Temperature>-1 ', 27, "scale"),
        ("</Package>", "</Package><Package/>", 39, "one is needed"),
    ],
)  # fmt: skip
def test_planted_faults_in_xml(old: str, new: str, line: int, words: str) -> None:
    assert old in PLECS
    with pytest.raises(InputError) as caught:
        read_device(PLECS.replace(old, new, 1).encode(), "x.xml")
    assert words in str(caught.value)
    assert str(caught.value).startswith(f"x.xml:{line}: ")


def test_igbt_without_diode_in_xml() -> None:
    text = PLECS.replace('type="MOSFET with Diode"', 'type="IGBT"').replace(
        "<CurrentAxis>-100 -1 0<", "<CurrentAxis>0 1 2<"
    )
    with pytest.raises(InputError, match=r"x\.xml:5: .*no data for the diode"):
        read_device(text.replace("-4.5 -2.5 0", "0 1 1").encode(), "x.xml")


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.just([]),
    st.just({}),
    st.just([[1], [2]]),
)


@given(st.lists(st.tuples(st.integers(0, 10_000), JUNK), min_size=1, max_size=3))
def test_damaged_values_are_named_or_harmless(damage: list[tuple[int, Any]]) -> None:
    """Any value of the tree replaced by anything: an error of one line, or a device;
    nothing else.
    """
    data = small()
    for where, junk in damage:
        spots = list(_spots(data))
        parent, key = spots[where % len(spots)]
        parent[key] = copy.deepcopy(junk)
    _read(encoded(data), "d.json")


def _spots(node: Any) -> Any:
    items = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    )
    for key, value in list(items):
        yield node, key
        yield from _spots(value)


@settings(max_examples=200)
@given(
    st.integers(0, len(PLECS) - 1),
    st.integers(0, 40),
    st.binary(max_size=6),
    st.sampled_from(["x.xml", "x.json", "x.yaml"]),
)
def test_damaged_bytes_are_named_or_harmless(
    start: int, length: int, junk: bytes, name: str
) -> None:
    whole = PLECS.encode() if name == "x.xml" else encoded(small())
    start %= len(whole)
    _read(whole[:start] + junk + whole[start + length :], name)


def _read(content: bytes, name: str) -> None:
    try:
        device = read_device(content, name)
    except InputError as error:
        text = str(error)
    else:
        text = name
        assert np.isfinite(device.turn_on_energy(50.0, 400.0, 80.0, 5.0).value)
        assert np.isfinite(device.on_voltage(50.0, 80.0).value)
    assert text.startswith(name)
    assert "\n" not in text
