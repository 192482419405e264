"""Every spelling that the vocabulary of units can form, for every dimension,
against factors worked out here.

The tables below are the test's own: SI values of the units, their dimensions as powers of (kg, m,
s, A, K), and how many plane angles they count. Nothing is taken from the program but the names of
its symbols and dimensions.
"""

from __future__ import annotations

import itertools
import math

import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import parse_quantity, read_quantity
from dqforge.machines.units.registry import DIMENSIONS, SYMBOLS

TURN = 2.0 * math.pi
_PREFIX = {
    "p": 1e-12,
    "n": 1e-9,
    "u": 1e-6,
    "µ": 1e-6,
    "μ": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
# name: (SI value, powers of (kg, m, s, A, K), plane angles)
_UNIT: dict[str, tuple[float, tuple[int, ...], int]] = {
    "Ohm": (1.0, (1, 2, -3, -2, 0), 0),
    "Ω": (1.0, (1, 2, -3, -2, 0), 0),
    "\N{OHM SIGN}": (1.0, (1, 2, -3, -2, 0), 0),
    "H": (1.0, (1, 2, -2, -2, 0), 0),
    "F": (1.0, (-1, -2, 4, 2, 0), 0),
    "Wb": (1.0, (1, 2, -2, -1, 0), 0),
    "V": (1.0, (1, 2, -3, -1, 0), 0),
    "A": (1.0, (0, 0, 0, 1, 0), 0),
    "Hz": (1.0, (0, 0, -1, 0, 0), 0),
    "s": (1.0, (0, 0, 1, 0, 0), 0),
    "min": (60.0, (0, 0, 1, 0, 0), 0),
    "h": (3600.0, (0, 0, 1, 0, 0), 0),
    "J": (1.0, (1, 2, -2, 0, 0), 0),
    "W": (1.0, (1, 2, -3, 0, 0), 0),
    "N": (1.0, (1, 1, -2, 0, 0), 0),
    "m": (1.0, (0, 1, 0, 0, 0), 0),
    "g": (1e-3, (1, 0, 0, 0, 0), 0),
    "K": (1.0, (0, 0, 0, 0, 1), 0),
    "degC": (1.0, (0, 0, 0, 0, 1), 0),
    "°C": (1.0, (0, 0, 0, 0, 1), 0),
    "rad": (1.0, (0, 0, 0, 0, 0), 1),
    "deg": (math.pi / 180.0, (0, 0, 0, 0, 0), 1),
    "°": (math.pi / 180.0, (0, 0, 0, 0, 0), 1),
    "rev": (TURN, (0, 0, 0, 0, 0), 1),
    "U": (TURN, (0, 0, 0, 0, 0), 1),
    "r": (TURN, (0, 0, 0, 0, 0), 1),
    "tr": (TURN, (0, 0, 0, 0, 0), 1),
    "rpm": (TURN / 60.0, (0, 0, -1, 0, 0), 1),
    "RPM": (TURN / 60.0, (0, 0, -1, 0, 0), 1),
    "krpm": (1e3 * TURN / 60.0, (0, 0, -1, 0, 0), 1),
    "kRPM": (1e3 * TURN / 60.0, (0, 0, -1, 0, 0), 1),
    "rps": (TURN, (0, 0, -1, 0, 0), 1),
    "%": (1e-2, (0, 0, 0, 0, 0), 0),
    "ppm": (1e-6, (0, 0, 0, 0, 0), 0),
    "gf": (9.80665e-3, (1, 1, -2, 0, 0), 0),
    "kgf": (9.80665, (1, 1, -2, 0, 0), 0),
}
# Words, in small letters, with a capital and in capitals.
_WORDS: dict[str, tuple[float, tuple[int, ...], int]] = {
    "ohm": _UNIT["Ohm"],
    "ohms": _UNIT["Ohm"],
    "volt": _UNIT["V"],
    "volts": _UNIT["V"],
    "amp": _UNIT["A"],
    "amps": _UNIT["A"],
    "ampere": _UNIT["A"],
    "amperes": _UNIT["A"],
    "sec": _UNIT["s"],
    "rpm": _UNIT["rpm"],
    "krpm": _UNIT["krpm"],
    "oz": (0.45359237 / 16.0, (1, 0, 0, 0, 0), 0),
    "lb": (0.45359237, (1, 0, 0, 0, 0), 0),
    "lbs": (0.45359237, (1, 0, 0, 0, 0), 0),
    "ozf": (0.45359237 / 16.0 * 9.80665, (1, 1, -2, 0, 0), 0),
    "lbf": (0.45359237 * 9.80665, (1, 1, -2, 0, 0), 0),
    "in": (0.0254, (0, 1, 0, 0, 0), 0),
    "ft": (0.3048, (0, 1, 0, 0, 0), 0),
}
_UNIT |= {
    spelling: unit
    for word, unit in _WORDS.items()
    for spelling in (word, word.upper(), word.capitalize())
}
_DIMENSION: dict[str, tuple[int, ...]] = {
    "resistance": (1, 2, -3, -2, 0),
    "inductance": (1, 2, -2, -2, 0),
    "capacitance": (-1, -2, 4, 2, 0),
    "flux": (1, 2, -2, -1, 0),
    "back-emf": (1, 2, -2, -1, 0),
    "speed-constant": (-1, -2, 2, 1, 0),
    "torque-constant": (1, 2, -2, -1, 0),
    "current": (0, 0, 0, 1, 0),
    "voltage": (1, 2, -3, -1, 0),
    "frequency": (0, 0, -1, 0, 0),
    "speed": (0, 0, -1, 0, 0),
    "bandwidth": (0, 0, -1, 0, 0),
    "time": (0, 0, 1, 0, 0),
    "torque": (1, 2, -2, 0, 0),
    "power": (1, 2, -3, 0, 0),
    "energy": (1, 2, -2, 0, 0),
    "inertia": (1, 2, 0, 0, 0),
    "friction": (1, 2, -1, 0, 0),
    "temperature": (0, 0, 0, 0, 1),
    "temperature-coefficient": (0, 0, 0, 0, -1),
    "thermal-resistance": (-1, -2, 3, 0, 1),
    "current-gain": (1, 2, -3, -2, 0),
    "current-integral-gain": (1, 2, -4, -2, 0),
    "speed-gain": (1, 2, -1, 0, 0),
    "speed-integral-gain": (1, 2, -2, 0, 0),
    "torque-slope": (1, 2, -3, 0, 0),
    "current-slew": (0, 0, -1, 1, 0),
    "angle": (0, 0, 0, 0, 0),
    "number": (0, 0, 0, 0, 0),
}
_FORMS = {
    "{}": 1,
    "1/{}": -1,
    "{}^-1": -1,
    "{}\u207b\u00b9": -1,
    "per {}": -1,
    "1 / {}": -1,
    "{}**-1": -1,
}


def unit_of(symbol: str) -> tuple[float, tuple[int, ...], int]:
    """SI value, dimension and plane angles of a symbol, with its prefix."""
    if symbol in _UNIT:
        return _UNIT[symbol]
    value, powers, angles = _UNIT[symbol[1:]]
    return _PREFIX[symbol[0]] * value, powers, angles


def expected_value(symbol: str, sign: int, dimension: str) -> float | None:
    """SI value of one of a unit or of its reciprocal as a dimension, None
    where it must be refused.
    """
    value, powers, angles = unit_of(symbol)
    if dimension == "speed-constant" and symbol == "kV" and sign > 0:
        return 1.0  # the name of the constant: 190 kV are 190 rpm/V
    if tuple(sign * power for power in powers) != _DIMENSION[dimension]:
        return None
    value = value**sign
    hertz, minutes = symbol.endswith("Hz"), symbol in ("min", "h")
    own: dict[str, float | None] = {
        # Pure reciprocals of a time are revolutions.
        "speed": None if hertz else value if angles else TURN * value,
        # Hertz are cycles, 1/s is rad/s, and 1/min could be either.
        "bandwidth": None if angles or minutes else TURN * value if hertz else value,
        # 3000 1/min may be the frequency of the shaft.
        "frequency": None if angles or minutes else value,
        "angle": value if angles and sign > 0 else None,
        # 1/Hz may be a period or a time constant.
        "time": None if hertz or angles else value,
        # Wb is a flux linkage, neither of the constants that it implies.
        "back-emf": None,
        "speed-constant": None,
        "torque-constant": None,
        "torque": None if symbol.endswith("J") else value,
        "speed-integral-gain": None,
        "torque-slope": None,
    }
    return own.get(dimension, None if angles else value)


SINGLE = list(itertools.product(SYMBOLS, _FORMS, DIMENSIONS))


def test_the_tables_here_know_every_symbol_and_dimension() -> None:
    assert set(_DIMENSION) == set(DIMENSIONS)
    for symbol in SYMBOLS:
        unit_of(symbol)


def test_every_symbol_in_every_form_as_every_dimension() -> None:
    wrong = []
    for symbol, form, dimension in SINGLE:
        text = f"3 {form.format(symbol)}"
        one = expected_value(symbol, _FORMS[form], dimension)
        kelvin = dimension == "temperature" and symbol.endswith("K")
        wanted = None if one is None else 3.0 * one - (273.15 if kelvin else 0.0)
        try:
            found: float | None = parse_quantity(text, dimension)
        except InputError:
            found = None
        if (found is None) != (wanted is None) or (
            found is not None and not math.isclose(found, wanted or 0.0)
        ):
            wrong.append((text, dimension, found, wanted))
    assert not wrong, wrong[:20]
    assert len(SINGLE) > 10_000


# One of each as rad/s.
REVOLUTIONS = {
    "rpm": TURN / 60.0,
    "RPM": TURN / 60.0,
    "krpm": 1e3 * TURN / 60.0,
    "kRPM": 1e3 * TURN / 60.0,
    "rps": TURN,
    "1/min": TURN / 60.0,
    "min^-1": TURN / 60.0,
    "min**-1": TURN / 60.0,
    "min-1": TURN / 60.0,
    "min\u207b\u00b9": TURN / 60.0,
    "min\N{MINUS SIGN}1": TURN / 60.0,
    "min\N{EN DASH}1": TURN / 60.0,
    "min^(-1)": TURN / 60.0,
    "min^{-1}": TURN / 60.0,
    "per min": TURN / 60.0,
    "1/s": TURN,
    "s^-1": TURN,
    "s-1": TURN,
    "s\u207b\u00b9": TURN,
    "per s": TURN,
    "1/ms": 1e3 * TURN,
    "1/h": TURN / 3600.0,
} | {
    f"{turn}{per}{time}": TURN / seconds
    for turn in ("U", "r", "tr", "rev")
    for per in ("/", " / ", " per ")
    for time, seconds in (("min", 60.0), ("s", 1.0), ("h", 3600.0))
}
ANGULAR = {
    "rad/s": 1.0,
    "rad s^-1": 1.0,
    "rad\N{MIDDLE DOT}s\u207b\u00b9": 1.0,
    "rad per s": 1.0,
    "rad/min": 1.0 / 60.0,
    "rad min^-1": 1.0 / 60.0,
    "krad/s": 1e3,
    "deg/s": math.pi / 180.0,
    "°/s": math.pi / 180.0,
    "rev s^-1": TURN,
    "U min^-1": TURN / 60.0,
}
SPEEDS = REVOLUTIONS | ANGULAR


@pytest.mark.parametrize("spelling", SPEEDS)
def test_speeds(spelling: str) -> None:
    assert parse_quantity(f"3000 {spelling}", "speed") == pytest.approx(
        3000.0 * SPEEDS[spelling], rel=1e-12
    )
    assert (
        parse_quantity(
            f"-3000{spelling}" if spelling[0].isalpha() else f"-3000 {spelling}", "speed"
        )
        < 0.0
    )


def _per(spelling: str) -> list[str]:
    """Ways to write "per" a speed: in parentheses, and bare where no second
    division makes that unclear.
    """
    forms = [f"/({spelling})"] if not spelling.startswith("per") else []
    if not any(sign in spelling for sign in ("/", " ", "·", "per")):
        forms += [
            f"/{spelling}",
            f" / {spelling}",
            f" per {spelling}",
            f"/1000 {spelling}",
            f" per 1000 {spelling}",
        ]
        forms += [f"/1000{spelling}", f"/(1000 {spelling})"]
    elif not spelling.startswith("per") and " " not in spelling and "·" not in spelling:
        forms += [f"/(1000 {spelling})"]
    return forms


CONSTANTS = {"back-emf": ("V", 1.0), "friction": ("N m", 1.0), "speed-gain": ("Nm", 1.0)}


@pytest.mark.parametrize("dimension", CONSTANTS)
@pytest.mark.parametrize("prefix", ["", "m", "k"])
def test_constants_per_speed(dimension: str, prefix: str) -> None:
    unit, _ = CONSTANTS[dimension]
    checked = 0
    for spelling, size in SPEEDS.items():
        for form in _per(spelling):
            number = 12.22 * {"": 1.0, "m": 1e-3, "k": 1e3}[prefix]
            wanted = number / size / (1000.0 if "1000" in form else 1.0)
            text = f"12.22 {prefix}{unit}{form}"
            assert parse_quantity(text, dimension) == pytest.approx(wanted, rel=1e-12), text
            checked += 1
    assert checked > 150


@pytest.mark.parametrize("spelling", [s for s in SPEEDS if not s.startswith("per")])
def test_speed_per_volt(spelling: str) -> None:
    texts = [f"190 ({spelling})/V"] + ([f"190 {spelling}/V"] if " per " not in spelling else [])
    for text in texts:
        reading = read_quantity(text, "back-emf")
        assert reading.inverted
        assert reading.si == pytest.approx(1.0 / (190.0 * SPEEDS[spelling]), rel=1e-12), text


def test_the_constant_of_a_german_data_sheet() -> None:
    # 12.22 mV/min^-1 between terminals (peak) of a machine of 10 poles: 12.22e-3 60/(2
    # pi)/sqrt(3)/5 = 13.47 mWb; as phase peak of 11 pole pairs 10.61 mWb. What matters here is
    # 60/(2 pi) = 9.5493.
    assert parse_quantity("12.22 mV/min^-1", "back-emf") == pytest.approx(
        12.22e-3 * 9.549296585513721, rel=1e-14
    )


# (text, dimension, SI value or what the refusal must say)
TWO_WAYS = [
    ("12 V min", "back-emf", "114.592 V s/rad"),
    ("12 V min", "back-emf", "720 V s/rad"),
    ("0.2 N m min", "friction", "N m s/rad"),
    ("0.2 N m min", "speed-gain", "N m s/rad"),
    ("50 Hz", "speed", "write it with rpm or rad/s"),
    ("0.4 V/Hz", "back-emf", "write it with rpm or rad/s"),
    ("0.4 N m/Hz", "friction", "write it with rpm or rad/s"),
    ("0.4 N m/Hz", "speed-gain", "write it with rpm or rad/s"),
    ("0.4 N m/kHz/s", "speed-integral-gain", "write it with rpm or rad/s"),
    ("30 V/A Hz", "current-integral-gain", "parentheses"),
    ("30 Ohm Hz", "current-integral-gain", "V/(A s)"),
    ("30 A kHz", "current-slew", "A/s"),
    ("300 1/min", "bandwidth", "Hz (times 2 pi) or rad/s"),
    ("300 rev/s", "bandwidth", "Hz (times 2 pi) or rad/s"),
    ("10 krpm", "frequency", "Hz"),
    ("3000 1/min", "frequency", "write it in Hz"),
    ("10 rad/s", "frequency", "Hz"),
    ("12 V/krpm", "flux", "back_emf_constant"),
    ("12 mV/min^-1", "flux", "back_emf_constant"),
    ("12 mV/s^-1", "flux", "back_emf_constant"),
    ("12 V min", "flux", "back_emf_constant"),
    ("0.6 N m/A", "flux", "torque_constant"),
    ("0.6 N m/A", "back-emf", "torque_constant"),
    ("0.6 J/A", "flux", "torque_constant"),
    ("0.6 V s/rad", "torque-constant", "N m/A"),
    ("0.6 V s", "torque-constant", "N m/A"),
    ("0.6 Wb", "torque-constant", "N m/A"),
    ("0.6 Wb", "back-emf", "magnet_flux"),
    ("3 rad rad/s", "speed", "rotational speed"),
    ("3 1/(rad s)", "speed", "rotational speed"),
    ("3 V s rad", "back-emf", "back-EMF constant"),
    ("3 N m/rad", "torque", "a torque"),
    ("3 N m rpm", "power", "a power"),
    ("3 N m min^-1", "power", "a power"),
    ("3 N m/min", "power", "a power"),
    ("3 s/rad", "time", "a time"),
    ("3 s Hz", "number", "a plain number"),
    ("0.6 N m/Arms", "torque-constant", "write '0.6 N m/A'"),
    ("12 A rms", "current", "write '12 A'"),
    ("230 V AC", "voltage", "write '230 V'"),
    ("48 Vdc", "voltage", "write '48 V'"),
    ("12 V line-to-line", "voltage", "'line-to-line' states the kind"),
    ("0 P\u200b", "voltage", "is not a unit"),
    ("5 100 V", "voltage", "not complete"),
    ("5 1 V", "voltage", "not complete"),
    ("5 1000 rpm", "speed", "not complete"),
]


@pytest.mark.parametrize(("text", "dimension", "phrase"), TWO_WAYS)
def test_what_can_be_taken_two_ways_is_refused_with_what_to_write(
    text: str, dimension: str, phrase: str
) -> None:
    with pytest.raises(InputError) as caught:
        parse_quantity(text, dimension)
    assert phrase in caught.value.message
    assert "\n" not in caught.value.message


READ = [
    ("0.1 V s", "back-emf", 0.1),
    ("40e-6 N m s", "friction", 40e-6),
    ("6 N m/rad", "speed-integral-gain", 6.0),
    ("6 N m", "speed-integral-gain", 6.0),
    ("6 N m/rev", "speed-integral-gain", 6.0 / TURN),
    ("6 N m/(rpm s)", "speed-integral-gain", 6.0 * 60.0 / TURN),
    ("6 N m/min^-1/s", "speed-integral-gain", 6.0 * 60.0 / TURN),
    ("0.02 N m s^2/rad", "inertia", 0.02),
    ("0.02 N m s^2", "inertia", 0.02),
    ("0.02 N m s/rpm", "inertia", 0.02 * 60.0 / TURN),
    ("8 1/s", "frequency", 8.0),
    ("8 s\u207b\u00b9", "frequency", 8.0),
    ("8 ms^-1", "frequency", 8000.0),
    ("400 s^-1", "bandwidth", 400.0),
    ("400 per s", "bandwidth", 400.0),
    ("400 Hz", "bandwidth", 400.0 * TURN),
    ("3 A/ms", "current-slew", 3000.0),
    ("2 kg m\u00b2", "inertia", 2.0),
    ("0.3 K W\u207b\u00b9", "thermal-resistance", 0.3),
    ("0.39 % K^-1", "temperature-coefficient", 3.9e-3),
    ("0.39 % per K", "temperature-coefficient", 3.9e-3),
    ("0.5 V per krpm", "back-emf", 0.5 * 60.0 / TURN / 1e3),
    ("\N{EN DASH}20 degC", "temperature", -20.0),
]


@pytest.mark.parametrize(("text", "dimension", "wanted"), READ)
def test_what_has_one_meaning_is_read(text: str, dimension: str, wanted: float) -> None:
    assert parse_quantity(text, dimension) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(("prefix", "size"), [("", 1.0), ("m", 1e-3), ("k", 1e3)])
@pytest.mark.parametrize("form", ["V/Hz", "V per Hz", "V Hz^-1", "V Hz\u207b\u00b9", "V/(Hz)"])
def test_volts_per_electrical_hertz_are_two_pi_flux_linkages(
    prefix: str, size: float, form: str
) -> None:
    # e = omega_e psi = 2 pi f_e psi, so that V/Hz is 2 pi psi; the 0.0385 V/Hz of a
    # data sheet are 6.1275 mWb.
    reading = read_quantity(f"0.0385 {prefix}{form}", "flux")
    assert reading.si == pytest.approx(size * 0.0385 / TURN, rel=1e-12)
    assert "electrical hertz" in reading.remark
    assert read_quantity(f"0.0385 {prefix}V/kHz", "flux").si == pytest.approx(
        size * 0.0385e-3 / TURN, rel=1e-12
    )


@pytest.mark.parametrize(
    ("text", "dimension", "phrase"),
    [
        ("50 1/s", "speed", "revolutions per second"),
        ("50 s^-1", "speed", "revolutions per second"),
        ("3 V/s^-1", "back-emf", "revolutions per second"),
        ("0.1 V s", "back-emf", "rad/s"),
        ("400 1/s", "bandwidth", "rad/s"),
        ("0.1 V s/rad", "flux", "electrical"),
        ("3000 1/min", "speed", "revolutions per minute"),
        ("1500 rpm", "speed", ""),
        ("0.1 V s", "flux", ""),
    ],
)
def test_what_a_spelling_leaves_open_is_said(text: str, dimension: str, phrase: str) -> None:
    remark = read_quantity(text, dimension).remark
    assert (phrase in remark) if phrase else not remark
