"""Units as data sheets print them: every word, order, sign of multiplication and case, against
factors worked out here.

One inch is 25.4 mm, one pound 0.45359237 kg of sixteen ounces, and weighs 9.80665 m/s^2.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import parse_quantity, read_quantity

POUND, G, INCH, FOOT = 0.45359237, 9.80665, 0.0254, 0.3048
OUNCE = POUND / 16.0
RPM = 0.10471975511965977
WEIGHTS = {"oz": OUNCE * G, "ozf": OUNCE * G, "lb": POUND * G, "lbs": POUND * G, "lbf": POUND * G}
LENGTHS = {"in": INCH, "ft": FOOT}
SIGNS = ("-", " ", "*", "·", "⋅", ".", ". ", ".-", " - ", "\N{NON-BREAKING HYPHEN}")


def cases(text: str) -> set[str]:
    return {text, text.upper(), text.title()}


def torques() -> Iterator[tuple[str, float]]:
    """Every way to write an imperial torque, with its newton metres."""
    for (weight, force), (length, metres) in itertools.product(WEIGHTS.items(), LENGTHS.items()):
        for sign in SIGNS:
            for text in (f"{weight}{sign}{length}", f"{length}{sign}{weight}"):
                for spelling in cases(text):
                    yield spelling, force * metres
    for text, value in (
        ("ozin", OUNCE * G * INCH),
        ("inoz", OUNCE * G * INCH),
        ("ozfin", OUNCE * G * INCH),
        ("lbin", POUND * G * INCH),
        ("inlb", POUND * G * INCH),
        ("lbfin", POUND * G * INCH),
        ("lbft", POUND * G * FOOT),
        ("ftlb", POUND * G * FOOT),
        ("oz.-in.", OUNCE * G * INCH),
        ("in.oz.", OUNCE * G * INCH),
        ("kgf cm", G / 100.0),
        ("kg-cm", G / 100.0),
        ("kgcm", G / 100.0),
        ("kgfcm", G / 100.0),
        ("gf cm", G * 1e-5),
        ("N-m", 1.0),
        ("N.m", 1.0),
        ("mN-m", 1e-3),
        ("mN.m", 1e-3),
        ("N-cm", 1e-2),
        ("Ncm", 1e-2),
        ("Nmm", 1e-3),
        ("uNm", 1e-6),
        ("µNm", 1e-6),
    ):
        yield text, value


def test_an_ounce_inch_is_what_catalogues_say() -> None:
    assert parse_quantity("1 oz-in", "torque") == pytest.approx(7.0615518e-3, rel=1e-8)
    assert parse_quantity("1 lb-in", "torque") == pytest.approx(0.11298483, rel=1e-8)
    assert parse_quantity("1 lb-ft", "torque") == pytest.approx(1.3558179, rel=1e-7)


def test_torques_and_what_is_made_of_them() -> None:
    tried = 0
    for unit, factor in torques():
        for text, dimension, wanted in (
            (f"5 {unit}", "torque", 5.0 * factor),
            (f"5{unit}", "torque", 5.0 * factor),
            (f"5 {unit}/A", "torque-constant", 5.0 * factor),
            (f"5 {unit}/Amp", "torque-constant", 5.0 * factor),
            (f"5 {unit} / kA", "torque-constant", 5e-3 * factor),
            (f"5 {unit}/krpm", "friction", 5.0 * factor / (1e3 * RPM)),
            (f"5 ({unit})/(rad/s)", "friction", 5.0 * factor),
            (f"5 {unit}/rad/s", "friction", 5.0 * factor),
        ):
            assert parse_quantity(text, dimension) == pytest.approx(wanted, rel=1e-12), text
            tried += 1
    assert tried > 2000


def test_inertias_by_weight_and_by_mass() -> None:
    tried = 0
    signs = ("-", " ", "*", "·")
    for (weight, force), (length, metres) in itertools.product(WEIGHTS.items(), LENGTHS.items()):
        for sign, second, square in itertools.product(signs, ("s", "sec"), ("^2", "2", "²", "**2")):
            text = f"{weight}{sign}{length}{sign}{second}{square}"
            for spelling in (text, text.title() if second == "sec" else text):
                assert parse_quantity(f"3 {spelling}", "inertia") == pytest.approx(
                    3.0 * force * metres, rel=1e-12
                ), text
                tried += 1
    for mass, size in {"oz": OUNCE, "lb": POUND, "kg": 1.0, "g": 1e-3}.items():
        for length, metres in {**LENGTHS, "m": 1.0, "cm": 1e-2, "mm": 1e-3}.items():
            for sign, square in itertools.product((*signs, "."), ("^2", "2", "²", "**2", "^{2}")):
                text = f"3 {mass}{sign}{length}{square}"
                wanted = 3.0 * size * metres**2
                assert parse_quantity(text, "inertia") == pytest.approx(wanted, rel=1e-12), text
                tried += 1
    for text, wanted in (
        ("kgm2", 1.0),
        ("kgm²", 1.0),
        ("kgcm2", 1e-4),
        ("gcm²", 1e-7),
        ("gcm^2", 1e-7),
        ("kgmm2", 1e-6),
        ("kgf m s^2", G),
        ("kgf cm s^2", G / 100.0),
    ):
        assert parse_quantity(f"3 {text}", "inertia") == pytest.approx(3.0 * wanted, rel=1e-12)
    assert tried > 700


# One of each in rad/s.
SPEEDS = {
    "rpm": RPM,
    "RPM": RPM,
    "Rpm": RPM,
    "r.p.m.": RPM,
    "krpm": 1e3 * RPM,
    "KRPM": 1e3 * RPM,
    "kRPM": 1e3 * RPM,
    "1000rpm": 1e3 * RPM,
    "1000 rpm": 1e3 * RPM,
    "1,000 rpm": 1e3 * RPM,
    "1000 RPM": 1e3 * RPM,
    "1000 r.p.m.": 1e3 * RPM,
    "1000 min^-1": 1e3 * RPM,
    "1000min-1": 1e3 * RPM,
    "1000 1/min": 1e3 * RPM,
    "1000 U/min": 1e3 * RPM,
    "1000 r/min": 1e3 * RPM,
    "1000 tr/min": 1e3 * RPM,
    "1000 rev/min": 1e3 * RPM,
    "U/min": RPM,
    "r/min": RPM,
    "rad/s": 1.0,
    "rad/sec": 1.0,
    "(rad/s)": 1.0,
    "(1000 U/min)": 1e3 * RPM,
}


def test_constants_per_speed_of_two_divisions() -> None:
    volts = {"V": 1.0, "mV": 1e-3, "volts": 1.0, "Volts": 1.0, "VOLTS": 1.0, "volt": 1.0}
    for (volt, size), (speed, radians) in itertools.product(volts.items(), SPEEDS.items()):
        for form in (f"{volt}/{speed}", f"{volt} / {speed}", f"{volt} per {speed}"):
            if speed.startswith("(") and "per" in form:
                continue
            found = read_quantity(f"12.2 {form}", "back-emf")
            assert found.si == pytest.approx(12.2 * size / radians, rel=1e-12), form
    for volt, size in volts.items():
        text = f"190 rpm/{volt}"
        assert parse_quantity(text, "speed-constant") == pytest.approx(190.0 / size, rel=1e-12)
    for text in ("0.1 V-s/rad", "0.1 V.s/rad", "0.1 V-sec/rad", "0.1 V·s/rad", "0.1 Vs/rad"):
        assert parse_quantity(text, "back-emf") == pytest.approx(0.1, rel=1e-14)


@pytest.mark.parametrize("prefix", ["", "m", "u", "µ", "μ", "k"])
def test_ohms_in_words(prefix: str) -> None:
    size = {"": 1.0, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "k": 1e3}[prefix]
    for word in ("Ohm", "ohm", "ohms", "Ohms", "OHM", "OHMS", "Ω", "\N{OHM SIGN}"):
        for gap in ("", " "):
            found = parse_quantity(f"4.7{gap}{prefix}{word}", "resistance")
            assert found == pytest.approx(4.7 * size, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "dimension", "phrase"),
    [
        ("5 oz", "torque", "expected a torque"),
        ("5 lb/in", "torque", "expected a torque"),
        ("5 oz-in/A", "flux", "per ampere a torque_constant"),
        ("5 oz-in/A", "back-emf", "N m/A a torque_constant"),
        ("5 oz-in", "inertia", "which is a torque"),
        ("5 kg cm^2", "torque", "which is a moment of inertia"),
        ("5 oz-inn", "torque", "unknown unit 'inn'"),
        ("5 MOHM", "resistance", "did you mean 'MOhm' or 'mOhm'?"),
        ("5 N m/A-s", "torque-constant", "with parentheses"),
        ("5 V/1.000 U/min", "back-emf", "is not understood"),
    ],
)
def test_what_is_refused(text: str, dimension: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_quantity(text, dimension)
    assert phrase in caught.value.message
    assert "\n" not in caught.value.message


MEASURED = {
    "12.3 V at 500 rpm": ("back-emf", 12.3 / (500.0 * RPM)),
    "12.3 V @ 500 rpm": ("back-emf", 12.3 / (500.0 * RPM)),
    "12.3 V @500 U/min": ("back-emf", 12.3 / (500.0 * RPM)),
    "8700 mV at 31.4 rad/s": ("back-emf", 8.7 / 31.4),
    "0.42 N m at 10 A": ("torque-constant", 0.042),
    "42 oz-in at 2 A": ("torque-constant", 42.0 * OUNCE * G * INCH / 2.0),
    "1200 rpm at 24 V": ("speed-constant", 50.0),
}


@pytest.mark.parametrize("text", MEASURED)
def test_what_was_measured_at_something_is_their_quotient(text: str) -> None:
    dimension, expected = MEASURED[text]
    assert read_quantity(text, dimension).si == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    "text", ["12.3 Vrms at 500 rpm line-to-line", "12.3 V at 500 rpm line-to-line rms"]
)
def test_kinds_stand_beside_either_number(text: str) -> None:
    found = read_quantity(text, "back-emf", kinds=True)
    assert found.text == "12.3 V at 500 rpm"
    assert found.kind is not None
    assert {found.kind.place, found.kind.measure} == {"line-to-line", "rms"}
    assert read_quantity(found.text, "back-emf").si == found.si


@pytest.mark.parametrize(
    "text", ["12.3 V at 500", "12.3 at 500 rpm", "12.3 V at 0 rpm", "12 V at -"]
)
def test_half_a_measurement_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"write|expected"):
        read_quantity(text, "back-emf")
    with pytest.raises(InputError):
        read_quantity("12.3 V at 500 rpm", "resistance")
