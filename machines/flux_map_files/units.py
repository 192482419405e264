"""Units that flux-map files give by kind of quantity, in the spellings that tools use."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Literal

_PREFIXES = {"": 1.0, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3}


def _spellings(symbols: Mapping[str, float], prefixes: str) -> dict[str, float]:
    """Factor to the SI unit of every spelling of some symbols, with and without prefixes.

    All in small letters too.
    """
    known = {
        part + symbol: _PREFIXES[part] * value
        for symbol, value in symbols.items()
        for part in ("", *prefixes)
    }
    return (
        known
        | {symbol.upper(): value for symbol, value in symbols.items()}
        | {k.lower(): known[k] for k in known}
    )


_AMPERES = dict.fromkeys(
    ("A", "Apk", "Apeak", "Arms", "Aeff", "Ampere", "Amperes", "amp", "amps"), 1.0
)

_WEBERS = dict.fromkeys(
    ("Wb", "Vs", "Wbturn", "Wbturns", "Wbt", "Wbpk", "Wbrms", "Vsrms", "Vspk", "Weber"), 1.0
)

_NEWTON_METRES = dict.fromkeys(("Nm", "NewtonMeter", "NewtonMetre", "Newtonmeters", "Nmeter"), 1.0)
_POUND_FOOT, _POUND_INCH, _OUNCE_INCH = 1.3558179483314004, 0.1129848290276167, 0.00706155181422604

_OTHER_TORQUES = {
    "Ncm": 1e-2,
    "ncm": 1e-2,
    "Nmm": 1e-3,
    "nmm": 1e-3,
    "lbfft": _POUND_FOOT,
    "ftlb": _POUND_FOOT,
    "ftlbf": _POUND_FOOT,
    "lbft": _POUND_FOOT,
}


_OTHER_TORQUES |= {
    "inlb": _POUND_INCH,
    "lbin": _POUND_INCH,
    "lbfin": _POUND_INCH,
    "ozin": _OUNCE_INCH,
    "inlbf": _POUND_INCH,
    "ozfin": _OUNCE_INCH,
    "inoz": _OUNCE_INCH,
}


_KILOPOND = 9.80665


_OTHER_TORQUES |= {
    f"{force}{arm}": _KILOPOND * size
    for force in ("kgf", "kp")
    for arm, size in (("m", 1.0), ("cm", 1e-2))
}


_TURN, _MINUTE = 2.0 * math.pi, math.pi / 30.0

# Factor to SI (temperatures as they are) of each kind of quantity, without the signs between the
# parts of a unit.
UNITS: dict[str, dict[str, float]] = {
    "i": _spellings(_AMPERES, "uµμmk"),
    "psi": _spellings(_WEBERS, "uµμm"),
    "l": _spellings({"H": 1.0, "Henry": 1.0}, "uµμm"),
    "torque": _spellings(_NEWTON_METRES, "mck") | _OTHER_TORQUES,
    "angle": _spellings(
        dict.fromkeys(("deg", "degree", "degrees", "°", "Grad", "degr", "edeg"), _TURN / 360.0), ""
    )
    | _spellings(dict.fromkeys(("rad", "radian", "radians", "radel", "radmech"), 1.0), "m"),
    "temperature": _spellings(
        dict.fromkeys(("degC", "C", "°C", "Celsius", "cel", "K", "Kelvin"), 1.0), ""
    ),
    "speed": _spellings(
        dict.fromkeys(("rpm", "1/min", "U/min", "r/min", "rev/min", "min^1", "min1"), _MINUTE), "k"
    )
    | _spellings(dict.fromkeys(("rad/s", "rads"), 1.0), "")
    | _spellings(dict.fromkeys(("rps", "1/s", "Hz"), _TURN), ""),
    "frequency": dict.fromkeys(("Hz", "hz", "1/s"), _TURN)
    | {"kHz": 1e3 * _TURN}
    | _spellings(dict.fromkeys(("rad/s", "rads"), 1.0), ""),
    "v": {
        f"{prefix}{symbol}": _PREFIXES[prefix]
        for symbol in ("V", "Vpk", "Vpeak", "Vrms", "Veff", "Volt", "Volts", "volt", "volts")
        for prefix in ("", "m", "k")
    },
    "r": {
        f"{prefix}{symbol}": _PREFIXES[prefix]
        for symbol in ("Ohm", "ohm", "Ohms", "ohms", "\u03a9", "\u2126")
        for prefix in ("", "u", "m", "k")
    },
    "power": {"W": 1.0, "kW": 1e3, "mW": 1e-3, "MW": 1e6, "watt": 1.0, "watts": 1.0, "Watt": 1.0},
    "share": {"%": 1e-2},
}

EXPECTED = {
    "i": "A, mA or kA",
    "psi": "Wb, mWb, Vs or mVs",
    "l": "H, mH or uH",
    "torque": "N m, mN m or kN m",
    "angle": "deg or rad",
    "temperature": "degC or K",
    "speed": "rpm or rad/s",
    "frequency": "Hz or rad/s",
    "v": "V, mV or kV",
    "r": "Ohm or mOhm",
    "power": "W or kW",
    "share": "%",
}

_BEFORE_UNIT = re.compile(r"[\s_/\[({<|,-]+(?:in\s+)?")
_CLAIM = re.compile(r"(?:[\W_]|(?<=[A-Za-z]))(rms|peak|pk)\W*$", re.IGNORECASE)

_PER_POLE_PAIR = re.compile(
    r"(?:/|per|je|pro|par)[\W_]*(?:pole[\W_]*pair|polpaar|pp(?![^\W_]))|par[\W_]*paire[\W_]*de[\W_]*p[oô]les?|"
    r"per[\W_]*coppia[\W_]*(?:di[\W_]*)?poli|por[\W_]*par[\W_]*de[\W_]*polos",
    re.IGNORECASE,
)

_PER_LENGTH = re.compile(
    r"(?:/|per|je|pro)[\W_]*(?:unit[\W_]*length|l[aä]enge|length|axial|metre|meter|mm?(?![^\W_]))",
    re.IGNORECASE,
)


def plain_unit(unit: str) -> str:
    """A unit without the signs between its parts."""
    return re.sub(r"[\s*·⋅∙•\u00d7.()_-]", "", _PER_POLE_PAIR.sub("", unit))


def is_unit(kind: str, unit: str) -> bool:
    """Whether a unit is one of a kind of quantity."""
    return plain_unit(unit) in UNITS[kind]


def factor(kind: str, unit: str) -> float:
    """Factor to SI of a unit that `is_unit` knows."""
    return UNITS[kind][plain_unit(unit)]


# What a name such as 'Id (Peak)' says of its values, in brackets of its own.
BRACKETED_CLAIM = re.compile(r"\s*[(\[]\s*(?:peak|pk|rms|eff)\.?\s*[)\]]", re.IGNORECASE)


def split_name(name: str) -> tuple[str, str]:
    """Stem and unit of a name such as psi_d_mVs or 'i_d [A]', '' where it has no unit of these."""
    name = BRACKETED_CLAIM.sub("", name)
    for found in _BEFORE_UNIT.finditer(name, 1):
        unit = name[found.end() :].rstrip(" ])}>|")
        if any(is_unit(kind, unit) for kind in UNITS):
            return name[: found.start()].rstrip(" _/[({<|,-"), unit
    return name, ""


def claimed(name: str, unit: str = "") -> Literal["", "peak", "rms"]:
    """'peak' or 'rms' where a name or its unit says so, '' otherwise."""
    for text in (unit, *split_name(name)[::-1], name):
        found = _CLAIM.search(text)
        if found:
            return "rms" if found[1].lower() == "rms" else "peak"
    return "rms" if plain_unit(unit).lower().endswith("eff") else ""


def per_pole_pair(text: str) -> bool:
    """Whether a name or unit of a torque says that it is that of one pole pair."""
    return bool(_PER_POLE_PAIR.search(text))


def per_length(text: str) -> bool:
    """Whether a name or unit of a torque says that it is that of a length of armature."""
    return bool(_PER_LENGTH.search(text))


def whole_torque(text: str) -> str:
    """A name or unit of a torque without what it is a part of: a pole pair, a length."""
    return _PER_LENGTH.sub("", _PER_POLE_PAIR.sub("", text))
