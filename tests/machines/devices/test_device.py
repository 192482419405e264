"""Device tables: at their points, between them, beyond them, and as the simple device."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from dqforge.machines.devices.inverter import (
    Curve,
    DeviceModel,
    EnergyTable,
    Family,
    Lookup,
    SwitchDevice,
    line,
)
from dqforge.machines.errors import InputError

COLD = Curve((0.0, 10.0, 100.0), (0.7, 1.0, 2.0))
HOT = Curve((0.0, 20.0, 90.0), (0.5, 1.0, 2.4))
CHANNEL = Family((25.0, 150.0), (COLD, HOT))
ON = EnergyTable(
    (600.0,),
    (
        Family(
            (25.0, 125.0),
            (Curve((0.0, 50.0, 100.0), (1e-3, 4e-3, 9e-3)), Curve((0.0, 100.0), (2e-3, 14e-3))),
        ),
    ),
    1.3,
    2.0,
    Family((25.0,), (Curve((1.0, 4.0), (3e-3, 6e-3)),), "hold"),
)
OFF = EnergyTable(
    (300.0, 600.0),
    tuple(Family((25.0,), (Curve((0.0, 100.0), (0.0, top)),)) for top in (2e-3, 5e-3)),
    1.0,
)
IGBT = DeviceModel(
    "made up", "igbt", CHANNEL, ON, OFF, None, Family((25.0,), (line(100.0, 0.8, 5e-3),))
)


def test_points_of_the_tables_are_given_back() -> None:
    for temperature, curve in zip(CHANNEL.parameters, CHANNEL.curves, strict=True):
        found = IGBT.on_voltage(curve.x, temperature)
        assert found.value == pytest.approx(curve.y, rel=1e-15)
        assert not found.outside.any()
    for temperature, curve in zip(ON.tables[0].parameters, ON.tables[0].curves, strict=True):
        assert IGBT.turn_on_energy(curve.x, 600.0, temperature).value == pytest.approx(
            curve.y, rel=1e-15
        )


def test_between_temperatures_and_outside() -> None:
    found = IGBT.on_voltage([10.0, 10.0, 10.0, 10.0], [25.0, 87.5, 150.0, 200.0])
    assert found.value == pytest.approx([1.0, 0.5 * (1.0 + 0.75), 0.75, 0.75], rel=1e-14)
    assert found.outside.tolist() == [False, False, False, True]
    beyond = IGBT.on_voltage([95.0, 110.0, 95.0], [25.0, 25.0, 30.0])
    assert beyond.value[1] == pytest.approx(2.0 + 10.0 * (1.0 / 90.0), rel=1e-14)
    # At 30 degC the hot curve counts, and it ends at 90 A.
    assert beyond.outside.tolist() == [False, True, True]


def test_sign_of_the_current_does_not_matter() -> None:
    assert IGBT.on_voltage(-50.0, 25.0).value == IGBT.on_voltage(50.0, 25.0).value
    assert IGBT.turn_on_energy(-50.0, 600.0, 25.0).value == pytest.approx(4e-3)


def test_voltage_scaling() -> None:
    """One voltage: a power law; two: linear in between, the power law beyond."""
    assert IGBT.turn_on_energy(50.0, [300.0, 900.0], 25.0).value == pytest.approx(
        [4e-3 * 0.5**1.3, 4e-3 * 1.5**1.3], rel=1e-14
    )
    assert IGBT.turn_off_energy(100.0, [300.0, 450.0, 600.0, 750.0], 25.0).value == pytest.approx(
        [2e-3, 3.5e-3, 5e-3, 5e-3 * 1.25], rel=1e-14
    )
    assert IGBT.turn_on_energy(50.0, [299.0, 300.0, 900.0, 901.0], 25.0).outside.tolist() == [
        True,
        False,
        False,
        True,
    ]


def test_gate_resistance() -> None:
    """Energy over r_g: 3 mJ at 1 Ohm, 6 mJ at 4 Ohm, so 4 mJ at the 2 Ohm of the table."""
    for wanted, factor, outside in (
        (2.0, 1.0, False),
        (4.0, 1.5, False),
        (1.0, 0.75, False),
        (9.0, 1.5, True),
    ):
        found = IGBT.turn_on_energy(50.0, 600.0, 25.0, wanted)
        assert found.value == pytest.approx(4e-3 * factor, rel=1e-14)
        assert bool(found.outside) is outside
    unknown = IGBT.turn_off_energy(50.0, 600.0, 25.0, 3.0)
    assert unknown.value == pytest.approx(2.5e-3)
    assert bool(unknown.outside)


def test_arrays_give_what_single_points_give() -> None:
    rng = np.random.default_rng(3)
    current, voltage, kelvin = (
        rng.uniform(0, 120, (40, 1)),
        rng.uniform(200, 900, 30),
        rng.uniform(0, 200, 30),
    )
    whole = IGBT.turn_on_energy(current, voltage, kelvin, 3.0)
    assert whole.value.shape == whole.outside.shape == (40, 30)
    for row, column in ((0, 0), (7, 29), (39, 11)):
        one = IGBT.turn_on_energy(current[row, 0], voltage[column], kelvin[column], 3.0)
        assert one.value == pytest.approx(whole.value[row, column], rel=1e-14)
        assert bool(one.outside) is bool(whole.outside[row, column])
    assert IGBT.recovery_energy(current, voltage, kelvin).value.shape == (40, 30)


def test_a_falling_curve_is_not_carried_on_below_zero() -> None:
    assert Curve((0.0, 1.0), (1.0, 0.1)).at(np.array([1.0, 5.0]), "extend") == pytest.approx(
        [0.1, 0.0]
    )


SWITCHES = st.builds(
    SwitchDevice,
    kind=st.sampled_from(["mosfet", "igbt"]),
    on_resistance=st.floats(1e-4, 1e-1),
    turn_on_energy=st.floats(1e-6, 1e-1),
    turn_off_energy=st.floats(1e-6, 1e-1),
    reference_current=st.floats(1.0, 1e3),
    reference_voltage=st.floats(10.0, 3e3),
    thermal_resistance=st.floats(1e-2, 5.0),
    reverse_recovery_energy=st.floats(0.0, 1e-2),
    on_resistance_temperature_coefficient=st.floats(-2e-3, 1e-2),
    diode_voltage=st.floats(0.0, 3.0),
    diode_resistance=st.floats(1e-4, 1e-1),
)


@given(SWITCHES, st.floats(1.0, 500.0), st.floats(20.0, 1500.0), st.floats(25.0, 170.0))
def test_simple_device_there_and_back(
    switch: SwitchDevice, current: float, voltage: float, kelvin: float
) -> None:
    """In another point of operation the same lines come out; energies refer to that point."""
    model = DeviceModel.from_switch_device(switch)
    factor = 1.0 + switch.on_resistance_temperature_coefficient * (kelvin - 25.0)
    assert model.on_resistance(current, kelvin).value == pytest.approx(
        switch.on_resistance * factor, rel=1e-9
    )
    share = current * voltage / (switch.reference_current * switch.reference_voltage)
    assert model.turn_on_energy(current, voltage, kelvin).value == pytest.approx(
        switch.turn_on_energy * share, rel=1e-9
    )
    back = model.switch_device(current, voltage, kelvin)
    assert back.switching_energy == pytest.approx(switch.switching_energy * share, rel=1e-9)
    warm = back.on_resistance * (1.0 + back.on_resistance_temperature_coefficient * (kelvin - 25.0))
    assert warm == pytest.approx(switch.on_resistance * factor, rel=1e-6)
    assert back.thermal_resistance == switch.thermal_resistance
    assert back.diode_voltage == pytest.approx(switch.diode_voltage, abs=1e-6)


@pytest.mark.parametrize("temperature", [25.0, 28.0, 90.0, 150.0])
def test_linear_igbt_has_the_losses_of_the_tables(temperature: float) -> None:
    """Averages over half a period against adaptive quadrature of the tables."""
    switch = IGBT.switch_device(80.0, 600.0, temperature, 0.2)

    def average(function: str) -> float:
        def loss(angle: float) -> float:
            current = 80.0 * np.sin(angle)
            if function == "on":
                return float(IGBT.turn_on_energy(current, 600.0, temperature).value)
            family = IGBT.on_voltage if function == "channel" else IGBT.diode_voltage
            return float(family(current, temperature).value * current)

        return float(
            quad(loss, 0.0, np.pi, limit=200, points=np.arcsin([10 / 80, 20 / 80, 50 / 80]))[0]
            / np.pi
        )

    mean, square = 80.0 * 2.0 / np.pi, 80.0**2 / 2.0
    warm = 1.0 + switch.on_resistance_temperature_coefficient * (temperature - 25.0)
    assert switch.on_voltage * mean + switch.on_resistance * warm * square == pytest.approx(
        average("channel"), rel=1e-5
    )
    assert switch.diode_voltage * mean + switch.diode_resistance * square == pytest.approx(
        average("diode"), rel=1e-5
    )
    assert switch.turn_on_energy / 80.0 * mean == pytest.approx(average("on"), rel=1e-5)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        ((0.0, 1.0), (1.0,), "write pairs"),
        ((0.0, 2.0, 1.0), (0.0, 1.0, 2.0), "abscissa 2 is 1, not above 2"),
        ((0.0, 1.0), (0.0, -1e-3), "ordinate 1 is -0.001"),
        ((0.0, np.nan), (0.0, 1.0), "abscissa 1 is nan"),
        ((0.0, 1.0), (0.0, np.inf), "ordinate 1 is inf"),
    ],
)
def test_broken_curves(x: tuple[float, ...], y: tuple[float, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        Curve(x, y)


def test_broken_tables() -> None:
    family = Family((25.0,), (COLD,))
    with pytest.raises(InputError, match="ascending, each once"):
        Family((25.0, 25.0), (COLD, HOT))
    with pytest.raises(InputError, match="must be positive and ascend"):
        EnergyTable((0.0,), (family,), 1.0)
    with pytest.raises(InputError, match="needs the data of its diode"):
        DeviceModel("x", "igbt", family, ON, OFF)
    with pytest.raises(InputError, match="no data for the diode"):
        DeviceModel("x", "mosfet", family, ON, OFF).diode_voltage(1.0, 25.0)
    with pytest.raises(InputError, match=r"write thermal_resistance: 0.3 K/W"):
        IGBT.switch_device(10.0, 100.0, 25.0)
    with pytest.raises(InputError, match="must be positive"):
        IGBT.switch_device(0.0, 100.0, 25.0, 1.0)


def test_lookups_add_their_marks() -> None:
    left = Lookup(np.array([1.0, 2.0]), np.array([True, False]))
    right = Lookup(np.array([3.0, 4.0]), np.array([False, False]))
    assert left.plus(right).value.tolist() == [4.0, 6.0]
    assert left.times(right).outside.tolist() == [True, False]
