"""The vocabulary of units: which symbols a quantity may use, and which dimensions the program knows."""

from __future__ import annotations

from dataclasses import dataclass

# Own vocabulary instead of the unit library's: there "mh" is a millihour and "Nm" is a metre per tex.
_PREFIXES = {"": "", "p": "pico", "n": "nano", "u": "micro", "µ": "micro", "μ": "micro", "m": "milli"} | {
    "c": "centi",
    "k": "kilo",
    "M": "mega",
    "G": "giga",
}
# symbol: (name in the unit library, prefixes that engineers write in front of it)
_BASES = {
    "Ohm": ("ohm", "nuµμmkM"),
    "Ω": ("ohm", "nuµμmkM"),
    "\N{OHM SIGN}": ("ohm", "nuµμmkM"),
    "H": ("henry", "pnuµμm"),
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
    "rpm": ("revolutions_per_minute", ""),
    "krpm": ("krpm", ""),
    "%": ("percent", ""),
    "ppm": ("ppm", ""),
}
SYMBOLS: dict[str, str] = {
    prefix + symbol: _PREFIXES[prefix] + name
    for symbol, (name, prefixes) in _BASES.items()
    for prefix in ("", *prefixes)
}
# Written as one word on many data sheets; an exponent belongs to the last part ("kgm2", "kgcm^2").
COMPOUNDS: dict[str, tuple[str, str]] = {
    "Nm": ("newton", "meter"),
    "mNm": ("millinewton", "meter"),
    "kNm": ("kilonewton", "meter"),
    "Vs": ("volt", "second"),
    "mVs": ("millivolt", "second"),
    "Ws": ("watt", "second"),
    "mWs": ("milliwatt", "second"),
    "kgm": ("kilogram", "meter"),
    "kgcm": ("kilogram", "centimeter"),
    "gcm": ("gram", "centimeter"),
}
# Names whose presence tells an angular speed from a frequency, which the unit library holds to be the same.
ANGULAR = frozenset({"radian", "milliradian", "kiloradian", "degree", "turn", "revolutions_per_minute", "krpm"})
CYCLIC = frozenset({"hertz", "millihertz", "kilohertz", "megahertz", "gigahertz"})
ENERGETIC = frozenset(prefix + "joule" for prefix in ("", "nano", "micro", "milli", "kilo", "mega"))
RELATIVE = frozenset({"percent", "ppm"})


@dataclass(frozen=True, slots=True)
class Dimension:
    """One physical meaning that a key can have.

    Parameters
    ----------
    name:
        With its article, as it stands in a sentence: ``an inductance``.
    unit:
        Unit of the numbers inside the program, in the spelling of this package.
    base:
        The same unit for the unit library.
    example:
        What a user might write.
    forbidden:
        Names of units that have this dimension on paper and mean something else, with the reason in `reason`.
    reciprocal:
        Whether a value in the reciprocal unit is accepted and inverted.
    cycles:
        Whether a value in hertz counts cycles, so that it is multiplied by 2 pi.
    """

    name: str
    unit: str
    base: str
    example: str
    forbidden: frozenset[str] = frozenset()
    reason: str = ""
    reciprocal: bool = False
    cycles: bool = False


_NO_HZ = "hertz may mean mechanical or electrical revolutions, or cycles; write it with rpm or rad/s"
DIMENSIONS: dict[str, Dimension] = {
    "resistance": Dimension("a resistance", "Ohm", "ohm", "2 mOhm"),
    "inductance": Dimension("an inductance", "H", "henry", "1.61 mH"),
    "flux": Dimension("a flux linkage", "Wb", "weber", "0.06 Wb"),
    "back-emf": Dimension(
        "a back-EMF constant", "V s/rad", "volt*second/radian", "12 V/krpm", CYCLIC, _NO_HZ, reciprocal=True
    ),
    "torque-constant": Dimension("a torque constant", "N m/A", "newton*meter/ampere", "0.6 N m/A"),
    "current": Dimension("a current", "A", "ampere", "12 A"),
    "voltage": Dimension("a voltage", "V", "volt", "48 V"),
    "frequency": Dimension(
        "a frequency", "Hz", "hertz", "10 kHz", ANGULAR, "a frequency counts cycles per second; write it in Hz"
    ),
    "speed": Dimension("a rotational speed", "rad/s", "radian/second", "1800 rpm", CYCLIC, _NO_HZ),
    "bandwidth": Dimension(
        "a bandwidth",
        "rad/s",
        "radian/second",
        "500 Hz",
        frozenset({"revolutions_per_minute", "krpm", "turn"}),
        "a bandwidth is written in Hz (times 2 pi) or rad/s (as is)",
        cycles=True,
    ),
    "time": Dimension("a time", "s", "second", "200 us"),
    "torque": Dimension(
        "a torque", "N m", "newton*meter", "1.5 N m", ENERGETIC, "a torque is written in N m, not in J"
    ),
    "power": Dimension("a power", "W", "watt", "2.2 kW"),
    "energy": Dimension("an energy", "J", "joule", "0.8 mJ"),
    "inertia": Dimension("a moment of inertia", "kg m^2", "kilogram*meter**2", "200e-6 kg m^2"),
    "friction": Dimension("a viscous friction", "N m s/rad", "newton*meter*second/radian", "40e-6 N m s"),
    "temperature": Dimension("a temperature", "degC", "degree_Celsius", "65 degC"),
    "temperature-coefficient": Dimension("a temperature coefficient", "1/K", "1/kelvin", "0.39 %/K"),
    "thermal-resistance": Dimension("a thermal resistance", "K/W", "kelvin/watt", "0.3 K/W"),
    "current-gain": Dimension("a current-controller gain", "V/A", "volt/ampere", "1.1 V/A"),
    "current-integral-gain": Dimension("an integral gain", "V/(A s)", "volt/ampere/second", "32 V/(A s)"),
    "speed-gain": Dimension("a speed-controller gain", "N m s/rad", "newton*meter*second/radian", "0.1 N m s/rad"),
    "speed-integral-gain": Dimension("an integral gain", "N m/rad", "newton*meter/radian", "6 N m/rad"),
    "current-slew": Dimension("a rate of change of a current", "A/s", "ampere/second", "5 kA/s"),
    "angle": Dimension("an angle", "rad", "radian", "30 deg", RELATIVE, "an angle is written in deg or rad"),
    "number": Dimension("a plain number", "", "dimensionless", "0.7", ANGULAR, "this is a number without a unit"),
}
