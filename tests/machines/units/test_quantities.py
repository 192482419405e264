"""Quantities: what is read, what is refused with which help, and how values are written."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.units.quantities import (
    format_quantity,
    parse_quantity,
    read_quantity,
    signed_hundredths,
    signed_percent,
)
from dqforge.machines.units.registry import DIMENSIONS, SYMBOLS

# Expected values follow from the definitions of the units: 1 rpm = 2 pi/60 rad/s, 1 Hz of
# bandwidth = 2 pi rad/s.
READ = [
    ("1.61 mH", "inductance", 1.61e-3),
    ("1.61mH", "inductance", 1.61e-3),
    ("  1.61   mH ", "inductance", 1.61e-3),
    ("242 uH", "inductance", 242e-6),
    ("242 µH", "inductance", 242e-6),
    ("242 \N{GREEK SMALL LETTER MU}H", "inductance", 242e-6),
    ("36 mH", "inductance", 0.036),
    ("1.5 F", "capacitance", 1.5),
    ("4.7 mF", "capacitance", 4.7e-3),
    ("4700 uF", "capacitance", 4.7e-3),
    ("4700 µF", "capacitance", 4.7e-3),
    ("4700 \N{GREEK SMALL LETTER MU}F", "capacitance", 4.7e-3),
    ("470nF", "capacitance", 470e-9),
    ("2 A s/V", "capacitance", 2.0),
    ("2 s/Ohm", "capacitance", 2.0),
    ("2 mOhm", "resistance", 2e-3),
    ("2 mΩ", "resistance", 2e-3),
    ("2 m\N{OHM SIGN}", "resistance", 2e-3),
    ("2 V/A", "resistance", 2.0),
    ("0.063 mWb", "flux", 63e-6),
    ("0.06 V s", "flux", 0.06),
    ("60 mVs", "flux", 0.06),
    ("5 kHz", "frequency", 5000.0),
    ("1 kHz", "bandwidth", 2000.0 * math.pi),
    ("400 rad/s", "bandwidth", 400.0),
    ("400 1/s", "bandwidth", 400.0),
    ("1800 rpm", "speed", 60.0 * math.pi),
    ("1.8 krpm", "speed", 60.0 * math.pi),
    ("30 rev/s", "speed", 60.0 * math.pi),
    ("1800 rev/min", "speed", 60.0 * math.pi),
    ("12 V/krpm", "back-emf", 0.36 / math.pi),
    ("0.1 V s/rad", "back-emf", 0.1),
    ("0.1 V/(rad/s)", "back-emf", 0.1),
    ("0.6 N m/A", "torque-constant", 0.6),
    ("0.6 Nm/A", "torque-constant", 0.6),
    ("130 N·m", "torque", 130.0),
    ("130 N*m", "torque", 130.0),
    ("20 mNm", "torque", 0.02),
    ("2 kg cm^2", "inertia", 2e-4),
    ("2 kgcm2", "inertia", 2e-4),
    ("2 kg m**2", "inertia", 2.0),
    ("2 kgm²", "inertia", 2.0),
    ("40e-6 N m s", "friction", 40e-6),
    ("40e-6 N m s/rad", "friction", 40e-6),
    ("64 degC", "temperature", 64.0),
    ("64 °C", "temperature", 64.0),
    ("300 K", "temperature", 26.85),
    ("0.39 %/K", "temperature-coefficient", 3.9e-3),
    ("0.39 %/degC", "temperature-coefficient", 3.9e-3),
    ("3900 ppm/K", "temperature-coefficient", 3.9e-3),
    ("3.9e-3 1/K", "temperature-coefficient", 3.9e-3),
    ("0.2 %", "number", 2e-3),
    ("0.3 °C/W", "thermal-resistance", 0.3),
    ("32 V/(A s)", "current-integral-gain", 32.0),
    ("32 V/A/s", "current-integral-gain", 32.0),
    ("30 deg", "angle", math.pi / 6.0),
    ("30°", "angle", math.pi / 6.0),
    ("1.7 mWs", "energy", 1.7e-3),
    ("-5 V", "voltage", -5.0),
    ("\N{MINUS SIGN}5 V", "voltage", -5.0),
    ("+.5 V", "voltage", 0.5),
    ("5. V", "voltage", 5.0),
    ("2.1 x 10^-5 kg m^2", "inertia", 2.1e-5),
    ("2.1·10⁻⁵ kgm²", "inertia", 2.1e-5),
    ("2.1*10**-5 kg m^2", "inertia", 2.1e-5),
    ("2.1 \N{MULTIPLICATION SIGN} 10\N{MINUS SIGN}5 kg m^2", "inertia", 2.1e-5),
    ("2.1x10^(-5) kg m^2", "inertia", 2.1e-5),
    ("2 x 10^3", "voltage", 2000.0),
    ("500", "voltage", 500.0),
    (500, "voltage", 500.0),
    (1.5, "torque", 1.5),
]


@pytest.mark.parametrize(("text", "dimension", "expected"), READ)
def test_reads_what_engineers_write(text: str | float, dimension: str, expected: float) -> None:
    assert parse_quantity(text, dimension) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "expected"), [("36 mH", 0.036), ("1.61 mH", 0.00161), ("9.5 mH", 0.0095)]
)
def test_decimal_prefixes_give_the_float_of_the_digits(text: str, expected: float) -> None:
    # 36 times 0.001 is 0.036000000000000004 in floating point; 0.036 is what was written.
    assert parse_quantity(text, "inductance") == expected


def test_speed_per_volt_is_inverted() -> None:
    # 190 rpm/V: 1 V at 190 rpm = 19.8968 rad/s, so 50.259 mV s/rad.
    reading = read_quantity("190 rpm/V", "back-emf")
    assert reading.inverted
    assert reading.si == pytest.approx(1.0 / (190.0 * math.pi / 30.0), rel=1e-14)


def test_reading_says_how_it_was_written() -> None:
    assert read_quantity(" 5 kHz", "frequency").text == "5 kHz"
    assert read_quantity(5000, "frequency").bare
    assert read_quantity("5000", "frequency").bare
    assert not read_quantity("5 kHz", "frequency").bare


REFUSED = [
    (
        "5 kHz",
        "inductance",
        "expected an inductance such as '1.61 mH', got '5 kHz' which is a frequency",
    ),
    ("5 rpm", "inductance", "which is a rotational speed"),
    ("5 V", "current", "which is a voltage"),
    ("5 kg", "current", "got '5 kg'"),
    ("2 mh", "inductance", "did you mean 'mH'?"),
    ("2 KHz", "frequency", "did you mean 'kHz'?"),
    ("2 MOHM", "resistance", "did you mean 'MOhm' or 'mOhm'?"),
    ("2 mOhm ±10 %", "resistance", "write '2 mOhm', and how far it may be off under control.tol"),
    ("2 mOhm +/- 10 %", "resistance", "write '2 mOhm', and how far it may be off"),
    ("2 x 10 mOhm", "resistance", "unknown unit 'x'"),
    ("2 nm", "torque", "did you mean 'Nm'?"),
    ("2 mHz", "inductance", "which is a frequency"),
    ("2 mH", "capacitance", "which is an inductance"),
    ("2 mF", "inductance", "which is a capacitance"),
    ("2 mf", "capacitance", "did you mean 'mF'?"),
    ("2 MF", "capacitance", "did you mean"),
    ("2 mfd", "capacitance", "unknown unit 'mfd'"),
    ("70 degF", "temperature", "unknown unit 'degF'"),
    ("70 °F", "temperature", "got '70 °F'"),
    ("70 F", "temperature", "which is a capacitance"),
    ("2 rPm", "speed", "did you mean 'rpm'?"),
    ("2 furlong", "inductance", "such as '1.61 mH'"),
    ("1,61 mH", "inductance", "write 1.61 mH"),
    ("1,61", "inductance", "write 1.61"),
    ("0,061 Wb", "flux", "write 0.061 Wb"),
    ("5,420 rpm", "speed", "write 5420 rpm, or 5.420 rpm"),
    ("1.234,5 A", "current", "write 1234.5 A"),
    ("1,234.5 A", "current", "write 1234.5 A"),
    ("1,234,567 A", "current", "write 1234567 A"),
    ("inf V", "voltage", "not a finite number"),
    ("-.inf", "voltage", "not a finite number"),
    ("nan", "voltage", "not a finite number"),
    ("1e400 V", "voltage", "not finite"),
    ("", "voltage", "not a number with a unit"),
    ("N m", "torque", "has a unit but no number"),
    ("twelve V", "voltage", "not a number with a unit"),
    ("1 2 V", "voltage", "not a unit"),
    ("1_000 V", "voltage", "not a unit"),
    ("2 1e9**9", "number", "not a unit"),
    ("2 m**9", "inertia", "not a unit"),
    ("2 kg m^22", "inertia", "not a unit"),
    ("2 kg m^2)", "inertia", "')' without its '('"),
    ("2 kg (m^2", "inertia", "'(' without its ')'"),
    ("2 kg ^2^2", "inertia", "not complete"),
    ("2 (", "inertia", "not complete"),
    ("2 V/", "voltage", "not complete"),
    ("2 /s", "bandwidth", "not complete"),
    ("2 V//A", "resistance", "not complete"),
    ("2 N m/A s", "torque-constant", "write N m/(A s) with parentheses"),
    ("2 V/A*s", "torque-constant", "can be read in two ways; write V/(A s)"),
    ("30 Hz", "speed", "write it with rpm or rad/s"),
    ("0.4 V/Hz", "back-emf", "write it with rpm or rad/s"),
    ("1800 rpm", "frequency", "write it in Hz"),
    ("1800 rpm", "bandwidth", "written in Hz (times 2 pi) or rad/s"),
    ("1.8 krpm", "bandwidth", "written in Hz (times 2 pi) or rad/s"),
    ("130 J", "torque", "not in J"),
    ("30 %", "angle", "in deg or rad"),
    ("30 deg", "number", "without a unit"),
    ("0 rpm/V", "back-emf", "got '0 rpm/V'"),
    ("__import__('os').system('x')", "torque", "not a number with a unit"),
    ("1 " + "m" * 100, "torque", "too long"),
    (10**400, "voltage", "not finite"),
    (math.inf, "voltage", "not finite"),
    (math.nan, "voltage", "not finite"),
]


@pytest.mark.parametrize(("text", "dimension", "phrase"), REFUSED)
def test_refuses_with_help(text: str | float, dimension: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_quantity(text, dimension)
    assert phrase in caught.value.message
    assert "\n" not in caught.value.message
    assert caught.value.line is None


def _value_or_message(text: str, dimension: str) -> float | str:
    try:
        return parse_quantity(text, dimension)
    except InputError as error:
        return error.message


@pytest.mark.slow
@given(st.text(max_size=70))
@settings(max_examples=300, deadline=None)
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    for dimension in ("inductance", "back-emf", "temperature"):
        value = _value_or_message(text, dimension)
        assert value.isprintable() if isinstance(value, str) else math.isfinite(value)


@given(
    st.lists(
        st.sampled_from([*SYMBOLS, "(", ")", "/", "*", "^2", "**-1", " ", "1", "²"]), max_size=12
    ).map("".join),
)
@settings(max_examples=300, deadline=None)
def test_any_unit_is_read_or_refused(unit: str) -> None:
    value = _value_or_message(f"1.5 {unit}", "torque")
    assert value.isprintable() if isinstance(value, str) else math.isfinite(value)


@pytest.mark.parametrize("name", DIMENSIONS)
def test_example_of_each_dimension_can_be_read(name: str) -> None:
    assert parse_quantity(DIMENSIONS[name].example, name) > 0.0
    if DIMENSIONS[name].unit:
        assert parse_quantity(f"1 {DIMENSIONS[name].unit}", name) == 1.0


WRITTEN = [
    (0.00161, "H", "1.61 mH"),
    (242e-6, "H", "242 uH"),
    (0.0019999999, "Ohm", "2 mOhm"),
    (999.9999, "V", "1 kV"),
    (500.0, "V", "500 V"),
    (1e5, "Hz", "100 kHz"),
    (2e-7, "s", "200 ns"),
    (120.0, "s", "120 s"),
    (0.06, "Wb", "0.06 Wb"),
    (0.0012, "Wb", "1.2 mWb"),
    (0.47, "N m", "0.47 N m"),
    (1e-15, "H", "0.001 pH"),
    (4.7e-3, "F", "4.7 mF"),
    (4.7e-7, "F", "470 nF"),
    (-3.2e-3, "A", "-3.2 mA"),
    (0.0, "H", "0 H"),
    (2e-4, "kg m^2", "0.0002 kg m^2"),
    (60.0 * math.pi, "rpm", "1800 rpm"),
    (188.4955, "rad/s", "188.5 rad/s"),
    (64.0, "degC", "64 degC"),
    (math.pi / 6.0, "deg", "30 deg"),
    (0.002, "%", "0.2 %"),
    (0.5, "", "0.5"),
    (123456.0, "rpm", "1178900 rpm"),
    (math.nan, "H", "nan H"),
    (math.inf, "H", "inf H"),
]


@pytest.mark.parametrize(("value", "unit", "expected"), WRITTEN)
def test_writes_for_people(value: float, unit: str, expected: str) -> None:
    assert format_quantity(value, unit) == expected


@given(
    st.floats(min_value=1e-9, max_value=1e9),
    st.sampled_from(["H", "F", "Ohm", "Wb", "V", "A", "Hz", "s", "W", "J"]),
)
@settings(deadline=None)
def test_what_is_written_reads_back(value: float, unit: str) -> None:
    dimension = next(name for name, d in DIMENSIONS.items() if d.unit == unit)
    text = format_quantity(value, unit)
    if text.split()[1] in SYMBOLS:
        assert parse_quantity(text, dimension) == pytest.approx(value, rel=1e-4)


def test_shown_is_one_printable_line() -> None:
    assert shown("a\nb\x1b[31m") == "'a\\x0ab\\x1b[31m'"
    assert len(shown("x" * 1000)) == 42


def test_close_matches_prefers_a_difference_of_case() -> None:
    assert close_matches("MH", ["mH", "MHz", "H"]) == ["mH"]
    assert close_matches("resistence", ["resistance", "inertia"]) == ["resistance"]
    assert close_matches("zzz", ["resistance"]) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [(7.11e-15, "0 %"), (-0.0, "0 %"), (0.1, "+10 %"), (-0.2, "-20 %"), (1e-4, "+0.01 %")],
)
def test_changes_of_rounding_alone_are_nought(value: float, text: str) -> None:
    assert signed_percent(value) == text


@pytest.mark.parametrize(
    ("percent", "text"), [(-1e-9, "0"), (0.001, "0"), (-0.02, "-0.02"), (12.3, "+12.30")]
)
def test_hundredths_of_a_percent_have_no_signed_nought(percent: float, text: str) -> None:
    assert signed_hundredths(percent) == text
