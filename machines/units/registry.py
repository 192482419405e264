"""Units by their symbols, and words that say of which kind a value is."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import field
from functools import cache, lru_cache
from typing import Literal

from dqforge.machines.errors import InputError, shown
from dqforge.machines.records import dataclass

# A vocabulary of engineers, not that of a library of units: there "mh" is a millihour
# and "Nm" is a metre per tex.
_PREFIXES = {
    "": "",
    "p": "pico",
    "n": "nano",
    "u": "micro",
    "µ": "micro",
    "μ": "micro",
    "m": "milli",
} | {
    "c": "centi",
    "k": "kilo",
    "M": "mega",
    "G": "giga",
}

# symbol: (name in full, prefixes that engineers write in front of it)
_BASES = {
    "Ohm": ("ohm", "nuµμmkM"),
    "Ω": ("ohm", "nuµμmkM"),
    "\N{OHM SIGN}": ("ohm", "nuµμmkM"),
    "H": ("henry", "pnuµμm"),
    "F": ("farad", "pnuµμm"),
    "Wb": ("weber", "uµμm"),
    "V": ("volt", "uµμmkM"),
    "A": ("ampere", "nuµμmkM"),
    "Hz": ("hertz", "mkMG"),
    "s": ("second", "pnuµμm"),
    "min": ("minute", ""),
    "h": ("hour", ""),
    "J": ("joule", "nuµμmkM"),
    "W": ("watt", "uµμmkM"),
    "N": ("newton", "uµμmkM"),
    "m": ("meter", "uµμmc"),
    "g": ("gram", "mk"),
    "K": ("kelvin", "m"),
    "degC": ("degree_Celsius", ""),
    "°C": ("degree_Celsius", ""),
    "rad": ("radian", "mk"),
    "deg": ("degree", ""),
    "°": ("degree", ""),
    "rev": ("turn", ""),
    "U": ("turn", ""),
    "r": ("turn", ""),
    "tr": ("turn", ""),
    "kRPM": ("krpm", ""),
    "rps": ("rps", ""),
    "%": ("percent", ""),
    "ppm": ("ppm", ""),
    "gf": ("force_gram", ""),
    "kgf": ("force_kilogram", ""),
}

# Words, also with a capital or in capitals; an ounce and a pound may be a mass or a force (FORCES).
_WORDS = {
    "ohm": ("ohm", "nuµμmk"),
    "ohms": ("ohm", "nuµμmk"),
    "volt": ("volt", ""),
    "volts": ("volt", ""),
    "amp": ("ampere", ""),
    "amps": ("ampere", ""),
    "ampere": ("ampere", ""),
    "amperes": ("ampere", ""),
    "sec": ("second", ""),
    "rpm": ("revolutions_per_minute", ""),
    "krpm": ("krpm", ""),
    "oz": ("ounce", ""),
    "lb": ("pound", ""),
    "lbs": ("pound", ""),
    "ozf": ("force_ounce", ""),
    "lbf": ("force_pound", ""),
    "in": ("inch", ""),
    "ft": ("foot", ""),
}

SYMBOLS: dict[str, str] = {
    prefix + symbol: _PREFIXES[prefix] + name
    for symbol, (name, prefixes) in _BASES.items()
    for prefix in ("", *prefixes)
} | {
    prefix + spelling: _PREFIXES[prefix] + name
    for word, (name, prefixes) in _WORDS.items()
    for spelling in (word, word.upper(), word.capitalize())
    for prefix in ("", *prefixes)
}

# Masses whose names stand for their weight as well: oz-in and kg cm of a torque.
FORCES = {
    "ounce": "force_ounce",
    "pound": "force_pound",
    "kilogram": "force_kilogram",
    "gram": "force_gram",
}

# Written as one word on many data sheets; an exponent belongs to the last part ("kgm2", "kgcm^2").
COMPOUNDS: dict[str, tuple[str, str]] = {
    "Nm": ("newton", "meter"),
    "mNm": ("millinewton", "meter"),
    "kNm": ("kilonewton", "meter"),
    "uNm": ("micronewton", "meter"),
    "µNm": ("micronewton", "meter"),
    "μNm": ("micronewton", "meter"),
    "Ncm": ("newton", "centimeter"),
    "Nmm": ("newton", "millimeter"),
    "kgfcm": ("force_kilogram", "centimeter"),
    "gfcm": ("force_gram", "centimeter"),
    "ozin": ("ounce", "inch"),
    "inoz": ("inch", "ounce"),
    "ozfin": ("force_ounce", "inch"),
    "lbin": ("pound", "inch"),
    "inlb": ("inch", "pound"),
    "lbfin": ("force_pound", "inch"),
    "lbft": ("pound", "foot"),
    "ftlb": ("foot", "pound"),
    "Vs": ("volt", "second"),
    "mVs": ("millivolt", "second"),
    "Ws": ("watt", "second"),
    "mWs": ("milliwatt", "second"),
    "kgm": ("kilogram", "meter"),
    "kgcm": ("kilogram", "centimeter"),
    "gcm": ("gram", "centimeter"),
    "kgmm": ("kilogram", "millimeter"),
    "gmm": ("gram", "millimeter"),
}

# Names whose presence tells an angular speed from a frequency, which have one dimension.
TURNS = frozenset({"turn", "revolutions_per_minute", "krpm", "rps"})
ANGULAR = TURNS | {"radian", "milliradian", "kiloradian", "degree"}
CYCLIC = frozenset({"hertz", "millihertz", "kilohertz", "megahertz", "gigahertz"})
LONG_TIMES = frozenset({"minute", "hour"})
TIMES = LONG_TIMES | {prefix + "second" for prefix in ("", "pico", "nano", "micro", "milli")}
RELATIVE = frozenset({"percent", "ppm"})


def _prefixed(*names: str) -> frozenset[str]:
    """Names of units with every prefix that the vocabulary has."""
    return frozenset(prefix + name for name in names for prefix in _PREFIXES.values())


ENERGETIC = _prefixed("joule")
POWERS = _prefixed("watt") | {"horsepower", "metric_horsepower"}
MECHANICAL = _prefixed("joule", "newton", "gram") | {*FORCES, *FORCES.values()}
ELECTRICAL = _prefixed("volt", "weber", "henry", "farad")
Unnamed = Literal["refused", "radians", "revolutions"]


@dataclass(frozen=True, slots=True)
class Dimension:
    """One physical meaning that a key can have.

    Args:
        name: With its article, as it stands in a sentence: ``an inductance``.
        unit: Unit of the numbers inside the program, in the spelling of this package.
        base: The same unit by the names in full.
        example: What a user might write.
        forbidden: Names of units that have this dimension on paper and mean something else, with
            the reason in `reason`.
        reciprocal: Whether a value in the reciprocal unit is accepted and inverted.
        cycles: Whether a value in hertz counts cycles: 2 pi goes with each.
        angle: Power of the plane angle in the unit, 1 for a speed and -1 for a constant per speed.
            An angle has no dimension, so that angles are counted by their names.
        unnamed: What a unit counts that names no angle although `angle` is not 0: 1/min of a speed
            are revolutions, N m s of a friction is per radian.
        electrical: Whether the angle is electrical, so that revolutions, which are those of the
            shaft, do not belong here.
        told: Whether it is told that the angle was left out.
        places: What a place of `dqforge.machines.units.registry` is called here, where values of
            this dimension have no kind of its name; empty where it goes without saying.
        aliases: Units by other names, in lower case (``kv`` for rpm/V), or as
            only capitals have it (``R`` for Ohm).
    """

    name: str
    unit: str
    base: str
    example: str
    forbidden: frozenset[str] = frozenset()
    reason: str = ""
    reciprocal: bool = False
    cycles: bool = False
    angle: int = 0
    unnamed: Unnamed = "refused"
    electrical: bool = False
    told: bool = False
    places: Mapping[str, str] = field(default_factory=dict)
    aliases: Mapping[str, str] = field(default_factory=dict)


_NO_HZ = (
    "hertz may mean mechanical or electrical revolutions, or cycles; write it with rpm or rad/s"
)

_OF_WINDINGS = {"terminal": "line-to-line", "winding": "phase"}

# The voltage of a line is the one between two of them; its resistance may be either.
_OF_VOLTAGES = _OF_WINDINGS | {"line": "line-to-line"}
_OF_CURRENTS = {"phase": "", "terminal": "line", "line": ""}
_OF_PHASES = {"phase": "", "winding": ""}

DIMENSIONS: dict[str, Dimension] = {
    "resistance": Dimension(
        "a resistance", "Ohm", "ohm", "2 mOhm", places=_OF_WINDINGS, aliases={"R": "Ohm"}
    ),
    "inductance": Dimension("an inductance", "H", "henry", "1.61 mH", places=_OF_WINDINGS),
    "capacitance": Dimension("a capacitance", "F", "farad", "4.7 mF"),
    "flux": Dimension(
        "a flux linkage",
        "Wb",
        "weber",
        "0.06 Wb",
        TURNS | LONG_TIMES | MECHANICAL,
        "a flux linkage is written in Wb or V s; per speed of the shaft it is a back_emf_constant, "
        "per ampere a torque_constant",
        cycles=True,
        angle=-1,
        unnamed="radians",
        electrical=True,
        places=_OF_PHASES,
    ),
    "back-emf": Dimension(
        "a back-EMF constant",
        "V s/rad",
        "volt*second/radian",
        "12 V/krpm",
        CYCLIC | _prefixed("weber") | MECHANICAL,
        "a back-EMF constant is written in V/krpm or V s/rad (hertz may mean mechanical or "
        "electrical revolutions: write it with rpm or rad/s); Wb is a magnet_flux, N m/A a "
        "torque_constant",
        reciprocal=True,
        angle=-1,
        unnamed="radians",
        told=True,
        places=_OF_VOLTAGES,
    ),
    "speed-constant": Dimension(
        "a speed constant",
        "rpm/V",
        "revolutions_per_minute/volt",
        "190 rpm/V",
        CYCLIC | _prefixed("weber") | MECHANICAL,
        "a speed constant is written in rpm/V; V/krpm is a back_emf_constant, Wb a magnet_flux",
        angle=1,
        unnamed="revolutions",
        places=_OF_VOLTAGES,
        aliases={"kv": "rpm/V"},
    ),
    "torque-constant": Dimension(
        "a torque constant",
        "N m/A",
        "newton*meter/ampere",
        "0.6 N m/A",
        ANGULAR | ELECTRICAL,
        "a torque constant is written in N m/A; V s/rad is a back_emf_constant, Wb a magnet_flux",
        places=_OF_CURRENTS,
    ),
    "current": Dimension("a current", "A", "ampere", "12 A", places=_OF_CURRENTS),
    "voltage": Dimension("a voltage", "V", "volt", "48 V"),
    "frequency": Dimension(
        "a frequency",
        "Hz",
        "hertz",
        "10 kHz",
        ANGULAR | LONG_TIMES,
        "a frequency counts cycles per second; write it in Hz",
    ),
    "speed": Dimension(
        "a rotational speed",
        "rad/s",
        "radian/second",
        "1800 rpm",
        CYCLIC,
        _NO_HZ,
        angle=1,
        unnamed="revolutions",
    ),
    "bandwidth": Dimension(
        "a bandwidth",
        "rad/s",
        "radian/second",
        "500 Hz",
        TURNS,
        "a bandwidth is written in Hz (times 2 pi) or rad/s (as is)",
        cycles=True,
        angle=1,
        unnamed="radians",
        told=True,
    ),
    "time": Dimension(
        "a time",
        "s",
        "second",
        "200 us",
        CYCLIC,
        "1/Hz may be a period or a time constant; write it in s",
    ),
    "torque": Dimension(
        "a torque",
        "N m",
        "newton*meter",
        "1.5 N m",
        ENERGETIC,
        "a torque is written in N m, not in J",
    ),
    "power": Dimension(
        "a power",
        "W",
        "watt",
        "2.2 kW",
        LONG_TIMES,
        "a power is written in W, also that of a torque and a speed",
    ),
    "energy": Dimension("an energy", "J", "joule", "0.8 mJ"),
    "inertia": Dimension(
        "a moment of inertia",
        "kg m^2",
        "kilogram*meter**2",
        "200e-6 kg m^2",
        CYCLIC,
        _NO_HZ,
        angle=-1,
        unnamed="radians",
    ),
    "friction": Dimension(
        "a viscous friction",
        "N m s/rad",
        "newton*meter*second/radian",
        "40e-6 N m s",
        CYCLIC,
        _NO_HZ,
        angle=-1,
        unnamed="radians",
    ),
    "temperature": Dimension("a temperature", "degC", "degree_Celsius", "65 degC"),
    "temperature-coefficient": Dimension(
        "a temperature coefficient", "1/K", "1/kelvin", "0.39 %/K"
    ),
    "thermal-resistance": Dimension("a thermal resistance", "K/W", "kelvin/watt", "0.3 K/W"),
    "torque-slope": Dimension(
        "a slope of the torque",
        "N m/s",
        "newton*meter/second",
        "500 N m/s",
        POWERS | ENERGETIC | CYCLIC,
        "a slope of the torque is written in N m/s, not in W",
    ),
    "current-gain": Dimension("a current-controller gain", "V/A", "volt/ampere", "1.1 V/A"),
    "current-integral-gain": Dimension(
        "an integral gain",
        "V/(A s)",
        "volt/ampere/second",
        "32 V/(A s)",
        CYCLIC,
        "write it in V/(A s)",
    ),
    "speed-gain": Dimension(
        "a speed-controller gain",
        "N m s/rad",
        "newton*meter*second/radian",
        "0.1 N m s/rad",
        CYCLIC,
        _NO_HZ,
        angle=-1,
        unnamed="radians",
    ),
    "speed-integral-gain": Dimension(
        "an integral gain",
        "N m/rad",
        "newton*meter/radian",
        "6 N m/rad",
        CYCLIC | ENERGETIC,
        "an integral gain is written in N m/rad; hertz may mean mechanical or electrical "
        "revolutions, or cycles; write it with rpm or rad/s",
        angle=-1,
        unnamed="radians",
    ),
    "current-slew": Dimension(
        "a rate of change of a current", "A/s", "ampere/second", "5 kA/s", CYCLIC, "write it in A/s"
    ),
    "angle": Dimension(
        "an angle",
        "rad",
        "radian",
        "30 deg",
        RELATIVE,
        "an angle is written in deg or rad",
        angle=1,
    ),
    "number": Dimension(
        "a plain number",
        "",
        "dimensionless",
        "0.7",
        ANGULAR | CYCLIC,
        "this is a number without a unit",
    ),
}


# Units that people write a quantity in, and the sizes in the unit of its dimension between which
# one of a drive lies: what a number without a unit may have meant.
USUAL_UNITS: dict[str, tuple[tuple[str, ...], float, float]] = {
    "resistance": (("mOhm", "Ohm", "uOhm"), 1e-3, 200.0),
    "inductance": (("uH", "mH", "H"), 1e-6, 2.0),
    "capacitance": (("uF", "mF"), 1e-6, 1.0),
    "flux": (("mWb", "Wb"), 1e-4, 5.0),
    "back-emf": (("V/krpm", "V s/rad"), 1e-3, 20.0),
    "torque-constant": (("N m/A", "mN m/A"), 1e-3, 50.0),
    "time": (("us", "ns", "ms", "s"), 1e-8, 10.0),
    "speed": (("rpm", "rad/s"), 0.1, 1e5),
    "frequency": (("kHz", "Hz"), 500.0, 5e5),
    "energy": (("mJ", "uJ"), 1e-6, 1.0),
    "inertia": (("kg cm^2", "g cm^2", "kg m^2"), 1e-8, 100.0),
    "friction": (("N m s",), 0.0, 1.0),
    "angle": (("deg",), 0.0, 7.0),
    "temperature-coefficient": (("%/K",), 0.0, 0.02),
    "power": (("kW", "W"), 1.0, 1e7),
}


# What the names of the vocabulary are in SI: factors, and powers of the base units.
#
# Angles, turns and shares are numbers here. Of mass the gram is the base, whose thousand a newton
# brings along: where it stands in both units of a conversion it cancels before anything is
# multiplied. Equal factors cancel, the others are multiplied in the order in which they stand, so
# that a value is the same float on every machine and in every version.

Factors = tuple[tuple[float, int], ...]  # Factors with their powers.
Powers = dict[str, int]

_FACTOR = {
    "pico": 1e-12,
    "nano": 1e-9,
    "micro": 1e-6,
    "milli": 1e-3,
    "centi": 1e-2,
    "kilo": 1e3,
    "mega": 1e6,
    "giga": 1e9,
}
_KILO = ((1e3, 1),)
_TURN = ((2.0, 1), (math.pi, 1))
_RPM = (*_TURN, (60.0, -1))
# A pound has 7000 grains of 64.79891 mg, a yard 0.9144 m.
_POUND = ((7000.0, 1), (64.79891, 1), (1e-3, 1))
_OUNCE = ((0.0625, 1), *_POUND)
_GRAVITY = ((9.80665, 1),)

# Factors; powers of gram, metre, second, ampere, kelvin.
_UNITS: dict[str, tuple[Factors, tuple[int, ...]]] = {
    "dimensionless": ((), (0, 0, 0, 0, 0)),
    "percent": (((1e-2, 1),), (0, 0, 0, 0, 0)),
    "ppm": (((1e-6, 1),), (0, 0, 0, 0, 0)),
    "radian": ((), (0, 0, 0, 0, 0)),
    "degree": (((1.0 / 180.0, 1), (math.pi, 1)), (0, 0, 0, 0, 0)),
    "turn": (_TURN, (0, 0, 0, 0, 0)),
    "second": ((), (0, 0, 1, 0, 0)),
    "minute": (((60.0, 1),), (0, 0, 1, 0, 0)),
    "hour": (((60.0, 2),), (0, 0, 1, 0, 0)),
    "hertz": ((), (0, 0, -1, 0, 0)),
    "revolutions_per_minute": (_RPM, (0, 0, -1, 0, 0)),
    "krpm": ((*_KILO, *_RPM), (0, 0, -1, 0, 0)),
    "rps": (_TURN, (0, 0, -1, 0, 0)),
    "meter": ((), (0, 1, 0, 0, 0)),
    "inch": (((1.0 / 36.0, 1), (0.9144, 1)), (0, 1, 0, 0, 0)),
    "foot": (((1.0 / 3.0, 1), (0.9144, 1)), (0, 1, 0, 0, 0)),
    "gram": ((), (1, 0, 0, 0, 0)),
    "pound": (_POUND, (1, 0, 0, 0, 0)),
    "ounce": (_OUNCE, (1, 0, 0, 0, 0)),
    "newton": (_KILO, (1, 1, -2, 0, 0)),
    "force_gram": (_GRAVITY, (1, 1, -2, 0, 0)),
    "force_kilogram": ((*_GRAVITY, *_KILO), (1, 1, -2, 0, 0)),
    "force_pound": ((*_GRAVITY, *_POUND), (1, 1, -2, 0, 0)),
    "force_ounce": ((*_GRAVITY, *_OUNCE), (1, 1, -2, 0, 0)),
    "joule": (_KILO, (1, 2, -2, 0, 0)),
    "watt": (_KILO, (1, 2, -3, 0, 0)),
    "ampere": ((), (0, 0, 0, 1, 0)),
    "volt": (_KILO, (1, 2, -3, -1, 0)),
    "ohm": (_KILO, (1, 2, -3, -2, 0)),
    "weber": (_KILO, (1, 2, -2, -1, 0)),
    "henry": (_KILO, (1, 2, -2, -2, 0)),
    "farad": (((1e3, -1),), (-1, -2, 4, 2, 0)),
    "kelvin": ((), (0, 0, 0, 0, 1)),
    "degree_Celsius": ((), (0, 0, 0, 0, 1)),
}

ICE_POINT = 273.15  # 0 degC in K.


@cache
def powers_of(base: str) -> Powers:
    """Powers of the names in a product such as ``newton*meter**2/second``."""
    parts = re.findall(r"(/?)([a-zA-Z_]+)(?:\*\*(\d))?", base)
    return {name: (-1 if over else 1) * int(power or 1) for over, name, power in parts}


def dimension_of(powers: Powers) -> tuple[int, ...]:
    """Powers of gram, metre, second, ampere and kelvin."""
    found = [(_unit(name)[1], power) for name, power in powers.items()]
    return tuple(sum(of[k] * power for of, power in found) for k in range(5))


def factor_between(powers: Powers, base: Powers) -> float:
    """How many of ``base`` one of ``powers`` is, where both have one dimension."""
    ratio = dict(powers)
    for name, power in base.items():
        ratio[name] = ratio.get(name, 0) - power
    over: dict[float, int] = {}
    under: dict[float, int] = {}
    for name, power in ratio.items():
        for factor, times in _unit(name)[0]:
            side = under if times * power < 0 else over
            side[factor] = side.get(factor, 0) + abs(times * power)
    product = 1.0
    for side, other, sign in ((over, under, 1), (under, over, -1)):
        for factor, times in side.items():
            product *= factor ** (sign * max(0, times - other.get(factor, 0)))
    return product


@cache
def _unit(name: str) -> tuple[Factors, tuple[int, ...]]:
    if name in _UNITS:
        return _UNITS[name]
    prefix = next(prefix for prefix in _FACTOR if name.startswith(prefix))
    factors, dimension = _UNITS[name.removeprefix(prefix)]
    return ((_FACTOR[prefix], 1), *factors), dimension


# Words that say of which kind a value is: ``line-to-line``, ``phase-to-phase``, ``rms``.
#
# Data sheets write them behind a unit (``100 mOhm phase-to-phase``), within it (``12 Vrms/krpm``)
# or alone, and each in many ways. Here they become two marks: the place that a value belongs to,
# and its measure. Which of them a key may have, the key says (`dqforge.machines.entries.rules`).

_TO = r"[\s_-]*(?:to|2)?[\s_-]*"
_OF = r"(?:(?:per|of|each|one|a|the)[\s_-]+)*"
_BETWEEN = r"between[\s_-]+(?:(?:the|two|any|motor)[\s_-]+)*"
_TWO = rf"(?:{_BETWEEN}|two[\s_-]+(?:motor[\s_-]+)?)"

# What each place is called, where ``phase`` is one phase to the star point.
_PLACES = {
    "line-to-line": (
        rf"(?:motor[\s_-]+)?line{_TO}line|l{_TO}l|phase{_TO}phase|ph{_TO}ph"
        rf"|(?:motor[\s_-]+)?(?:wire{_TO}wire|lead{_TO}lead)|{_TWO}(?:phases|lines|wires|leads)"
    ),
    "terminal": rf"(?:{_TWO}|{_OF})(?:motor[\s_-]+)?terminals?(?:{_TO}terminals?)?|t{_TO}t",
    "phase": rf"(?:line|phase|ph|l){_TO}(?:neutral|n|star[\s_-]*point)|{_OF}phase|{_OF}ph",
    "winding": rf"{_OF}winding",
    "line": rf"{_OF}line",
}

_MEASURES = {
    "rms": r"r\.?m\.?s\.?|eff(?:ective)?",
    "peak": r"(?:zero|0|o)[\s_-]*(?:to[\s_-]*)?(?:peak|pk|p)|peak|pk|p|amplitude|ampl|crest",
    "power-invariant": r"power[\s_-]*invariant",
}

# Words that leave the kind open, and what to say of them.
_OPEN = {
    "peak to peak": (
        rf"(?:peak|pk|p){_TO}(?:peak|pk|p)",
        "is twice the peak; write half of the value, and peak",
    ),
    "largest": (r"max(?:imum)?", "does not say of which kind the value is; write peak or rms"),
    "mean": (r"average|avg|mean", "is none of the kinds that are read; write peak or rms"),
    "direct": (r"dc", "is none of the kinds that are read; write peak or rms"),
    "alternating": (r"ac", "does not say of which kind the value is; write peak or rms"),
}

_PHRASES = [
    *((name, pattern) for name, (pattern, _) in _OPEN.items()),
    *_PLACES.items(),
    *_MEASURES.items(),
]
_PHRASE = "(?:" + "|".join(pattern for _, pattern in _PHRASES) + ")"
_GAP = r"[\s,;_-]*"
# At most six, so that a hostile text is not tried in every way to cut it.
_CHAIN = rf"(?i:{_PHRASE}(?:{_GAP}{_PHRASE}){{0,5}})"
_LETTER = r"A-Za-zµμΩ\N{OHM SIGN}°"
# Units that kinds are glued to: ``Arms``, ``mV_pk``.
_CARRIER = r"[munkµμM]?[AV]|(?i:amp(?:ere)?s?|volts?)"

_FOUND = re.compile(
    rf"(?:(?<![{_LETTER}])(?P<unit>{_CARRIER})|(?<![{_LETTER}])|(?=[\s,;_(\[-])){_GAP}"
    rf"(?:\(\s*(?P<round>{_CHAIN})\s*\)|\[\s*(?P<square>{_CHAIN})\s*\]|(?P<plain>{_CHAIN}))"
    rf"(?![{_LETTER}0-9])"
)

_SINGLE = (
    "lines?|phases?|to|2|l|ph|neutral|n|star|point|between|two|any|the|wires?|leads?|terminals?|t|motor|per|of|each"
    "|one|a|winding|r\\.?m\\.?s\\.?|eff|effective|zero|0|o|peak|pk|p|amplitude|ampl|crest|power"
    "|invariant"
)


def words_pattern() -> str:
    """Regular expression, as editors have it, of what consists of the words of kinds: it refuses
    what none can be, and leaves to the reader which words go together.
    """
    words = re.sub(r"\\.|[a-z]", lambda c: _either_case(c.group()), _SINGLE)
    return rf"^[\s(]*(?:(?:{words})[\s_,;()-]*)+$"


def _either_case(part: str) -> str:
    return part if part.startswith("\\") else f"[{part}{part.upper()}]"


@dataclass(frozen=True, slots=True)
class KindWords:
    """The marks that a text names: `place` and `measure`, empty where it does not say; `text` holds
    its words as they stand there.
    """

    place: str = ""
    measure: str = ""
    text: str = ""


@lru_cache(maxsize=512)
def kind_words(text: str) -> KindWords | None:
    """Marks of a text that consists of such words, None where it holds others.

    Raises:
        InputError: Its words leave the kind open (``max``), or contradict each other.
    """
    names = _phrases(text.strip(" ,;_-()[]"))
    if not names:
        return None
    for name in names:
        if name in _OPEN:
            raise InputError(f"{shown(text)} {_OPEN[name][1]}")
    marks = {}
    for slot, known in (("place", _PLACES), ("measure", _MEASURES)):
        found = dict.fromkeys(name for name in names if name in known)
        if len(found) > 1:
            raise InputError(f"{shown(text)} names two kinds, {' and '.join(found)}; write one")
        marks[slot] = next(iter(found), "")
    return KindWords(**marks, text=text.strip())


def without_kind(unit: str) -> tuple[str, str]:
    """A unit as it is without the words of kinds, and these words.

    Examples:
        >>> without_kind("Vrms/krpm line-to-line") ('V/krpm', 'rms line-to-line')
    """
    words = []

    def lift(match: re.Match[str]) -> str:
        chain = match["round"] or match["square"] or match["plain"]
        lone = chain.casefold() == "p" and not match["unit"]
        if lone or chain in SYMBOLS or chain in COMPOUNDS:  # 5 pH are picohenry
            return match.group()
        words.append(chain)
        return match["unit"] or ""

    plain = _FOUND.sub(lift, unit)
    return (plain.strip(" ,;") if words else unit), " ".join(words)


def _phrases(text: str) -> tuple[str, ...]:
    """Names of the phrases that a text consists of, none where it holds anything else."""
    for name, pattern in _PHRASES:
        match = re.match(f"(?i:{pattern})", text)
        if match is None:
            continue
        rest = text[match.end() :].lstrip(" ,;_-")
        if not rest:
            return (name,)
        if further := _phrases(rest):
            return (name, *further)
    return ()
