"""What the arrays of a flux-map file stand for: a table of the names that tools give,
and the choice among several.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.map_deviations import MapDeviations
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_formats import NamedArray, listed
from dqforge.machines.names import FluxTorque

# Quantities that an array may stand for, in the order of a message, with the kind of their unit.
KINDS = {
    "i_d": "i",
    "i_q": "i",
    "psi_d": "psi",
    "psi_q": "psi",
    "i": "i",
    "beta": "angle",
    "l_d": "l",
    "l_q": "l",
    "psi_m": "psi",
    "torque": "torque",
    "angle": "angle",
    "temperature": "temperature",
    "speed": "speed",
    "v_d": "v",
    "v_q": "v",
    "frequency": "frequency",
    "resistance": "r",
    "loss": "power",
    "copper_loss": "power",
    "efficiency": "share",
}

FLUXES = ("psi_d", "psi_q")
WANTED = ("i_d", "i_q", *FLUXES)
VOLTAGES = ("v_d", "v_q")
THIRD = ("angle", "temperature", "speed")  # What a map may be resolved over beside its currents.
_LONGEST_NAME = 100
_TAIL = r"s?(?:axis|vec|vector|grid|mesh|map|mat|table|data|values|list)?"
_SIZE = r"(?:amp|amplitude|abs|mag|magnitude|phase|ph|s|1)?"
_FLUX_WORD = r"(?:[ψλφϕ]s?|psis?|lambdas?|lam|phis?|flux(?:linkage)?s?|linkage|f)"

_PATTERNS = (
    (
        "i",
        rf"(?:i[sm]?|curr?i?|currenti?)(dq|d|q){_TAIL}|(d|q)(?:axis)?curr?(?:ent)?(?:ina)?(?:[xy]axis)?",
    ),
    ("psi", rf"{_FLUX_WORD}(dq|d|q){_TAIL}|(d|q)(?:axis)?flux(?:linkage)?(?:values)?(?:inm?vs)?"),
    ("l", rf"(?:l|ind|inductance|lapp|lapparent)(d|q){_TAIL}|(d|q)(?:axis)?inductance"),
    (
        "v",
        rf"(?:[uv][sm]?|volt(?:age)?|spannung|tension)(dq|d|q){_TAIL}|(d|q)(?:axis)?(?:volt(?:age)?|spannung)",
    ),
)

# Quantities of both axes, by their names in small letters without signs.
_AXES = tuple((kind, re.compile(pattern)) for kind, pattern in _PATTERNS)

_SINGLE = {
    "i": rf"i{_SIZE}|(?:wdg|winding|phase|stator)?curr?(?:ent)?{_SIZE}|(?:stator)?currentphase|currentvector",
    "beta": r"(?:angle)?(?:beta|β|gamma|\u03b3)(?:angle)?|(?:current|phase)(?:advance|angle)|anglei(?:up|vs)?|advance",
    "psi_m": rf"{_FLUX_WORD}(?:m|pm|magn?|magnets?|0|r|f)|magnetflux(?:linkage)?",
    "angle": r"(?:angular|rotor|mech(?:anical)?|el(?:ec(?:trical)?)?)*(?:theta|θ|angle|position|pos|rotate|rotation)"
    r"(?:vec|vector|axis|grid|deg|el|mech|r|m)?",
    "temperature": (
        r"(?:magnet|rotor|pm|motor|machine|winding)*(?:temp|temperatures?|tempr|tmag|tpm)"
        r"(?:vec|axis|magnet|pm|grid)?"
    ),
    "speed": r"(?:rotor|shaft|mech(?:anical)?|motor)*(?:speed|rpm|omega|ω|drehzahl)"
    r"(?:vec|axis|m|mech|rpm|grid)?",
    "frequency": r"(?:el(?:ec(?:trical)?)?|fund(?:amental)?|stator|supply)*(?:frequency|freq|frequenz|fel|fe|f|omegae?l?|ω)"
    r"(?:el|elec(?:trical)?|e|s|1|hz)?",
    "resistance": r"(?:stator|phase|winding|armature|copper)*(?:resistance|r|rs|rph|rphase|ra|r1|widerstand)"
    r"(?:phase|s|ph|stator|dc)?",
    "loss": r"(?:total|sum|overall|motor|machine|measured|p)*(?:loss(?:es)?|verlust(?:e|leistung)?|pertes|perdite|pv)"
    r"(?:total|tot|sum|gesamt|ges|motor|machine)?",
    "copper_loss": r"(?:p|stator|winding)*(?:copper|cu|joule|kupfer|winding|ohmic|i2r)(?:loss(?:es)?|verluste)?(?:total|dc)?"
    r"|(?:p|losses|loss|verluste)(?:copper|cu|joule|kupfer|winding)",
    "efficiency": r"(?:motor|machine|total)?(?:efficiency|eff|eta|η|wirkungsgrad|rendement|rendimento)(?:motor|machine|total)?",
}

_ONE = {quantity: re.compile(pattern) for quantity, pattern in _SINGLE.items()}

# Short names that only their unit makes a temperature, a speed or the like.
_BY_UNIT = {
    "temperature": ("t", "tm", "tr", "tw", "θ"),
    "speed": ("n", "nm", "w", "wm", "wr"),
    "frequency": ("we", "ws", "wel"),
}

# What only a torque is called, in the languages of those who measure.
_TORQUE_WORD = re.compile(
    r"torque|moment(?!um|an|ary)|couple(?![dr])|coppia|koppel|tork(?!e)|nyomatek|binario|ροπη|момент"
    r"|转矩|扭矩|轉矩|トルク|토크|^par(?: ?(?:motor|mecanico|electromagnetico|medio))?$"
)

# Signs of torques that need no unit; T and M, which may be much else, are looked at by themselves.
_TORQUE_SIGN = re.compile(
    r"(?:avg|mean)*(?:tau|τ|tq|trq|t(?=.))(?:e|em|el|m|fe|sim|dq|mech|meas|airgap|ag|shaft|out|welle|act|avg|mean|ave|l|load){0,2}"
    r"(?:map|table|data|vec|mat)?|m(?:i|el|em|mech|welle|avg|mean)"
)

_NO_TORQUE = re.compile(
    r"\brip|ripple|^d ?t|\btpp|\bpp\b|p2p|pk ?to ?pk|peak ?to ?peak|\bpuls|cogg|frict|loss|\brated|\bnom|nenn|\bconst"
    r"|^k ?t\b|\blimit|\bmax(?!well)|\bmin|(?:torque|moment|\bt)(?:max|min|rip|nom|rated|const|pp)|\bdens|inert|angle"
    r"|winkel|sensor|per ?amp|error|\brast|\breib|\bkipp|\bhalte|detente"
)

_INNER = re.compile(
    r"electro|airgap|luftspalt|inner|(?:tau|^t|torque|moment)(?:e|em|el|ag)(?:avg|mean)?$|^m(?:i|el|em)$|^(?:em|el)"
)

_SHAFT = re.compile(r"shaft|welle|output|mech|meas|load|albero|arbre|(?:tau|^t)(?:l|out)$")

# Torques that are wanted, or a part of the torque, or computed in another way beside it.
_NOT_OF_THE_DRIVE = re.compile(
    r"ref|cmd|command|soll|set|target|demand|request|reluct|(?<!electro)magnet|maxwell"
)

_MEAN = re.compile(r"(?:avg|mean|ave|average)\s*\((.*)\)\s*", re.IGNORECASE)


# Losses over the currents, of which a loss map is made.
PARTS = ("iron", "hysteresis", "eddy", "magnet", "mechanical")

_LOSS = r"(?:loss(?:es)?|verluste?|verlustleistung)"
_LOSSES = {
    kind: re.compile(rf"(?:p|{_LOSS})*(?:{words})(?:current)?s?{_LOSS}?(?:total|tot|avg|mean)?")
    for kind, words in {
        "iron": "iron|core|fe|eisen|fer",
        "hysteresis": "hysteresis|hyst|hy|hys",
        "eddy": "eddy|ec|wirbelstrom",
        "magnet": "magnets?|pm|mag|magnete?",
        "mechanical": "mechanical|mech|friction|windage|reibung",
    }.items()
}


def recognised(array: NamedArray) -> tuple[str, ...]:
    """Quantities that an array's name stands for: one, both axes of a complex array, or none."""
    if len(array.name) > _LONGEST_NAME:
        return ()
    stem, unit = split_name(array.name)
    unit = unit or array.unit
    for kind, pattern in _AXES:
        for name in (array.name, stem) if is_unit(kind, unit) else (array.name,):
            found = pattern.fullmatch(plain_name(name))
            axes = next(filter(None, found.groups()), "") if found else ""
            if axes and (len(axes) == 1 or np.iscomplexobj(array.values)):
                return tuple(f"{kind}_{axis}" for axis in axes)
    return _single(array, stem, unit)


def loss_named(name: str, unit: str = "") -> str:
    """Which loss over the currents the name of an array stands for, '' for none."""
    stem, in_name = split_name(name)
    unit, plain = unit or in_name, plain_name(stem)
    # Without a unit of power fe and mag are much else.
    if not is_unit("power", unit) and (unit or not re.match(rf"p|.*{_LOSS}", plain)):
        return ""
    return next((kind for kind, pattern in _LOSSES.items() if pattern.fullmatch(plain)), "")


def _single(array: NamedArray, stem: str, unit: str) -> tuple[str, ...]:
    """The quantity without an axis that an array stands for."""
    if _is_torque(array, stem, unit):
        return ("torque",)
    for quantity, pattern in _ONE.items():
        known = is_unit(KINDS[quantity], unit)
        plain = plain_name(stem if known else array.name)
        if (pattern.fullmatch(plain) and (known or not unit)) or (
            known and plain in _BY_UNIT.get(quantity, ())
        ):
            return (quantity,)
    return ()


def _is_torque(array: NamedArray, stem: str, unit: str) -> bool:
    """Whether an array looks like a torque: by its unit or its name, but no ripple, friction or
    rating.

    A word for torque with a unit that nobody knows is one too, to be refused for it.
    """
    if array.values.size < 2:
        return False
    unit = whole_torque(unit)
    known = is_unit("torque", unit)
    name = whole_torque(stem if known else array.name)
    words = _words(name)
    if _NO_TORQUE.search(words):
        return False
    if known:
        return True
    if unit and any(is_unit(kind, unit) for kind in UNITS):
        return False
    if _TORQUE_WORD.search(words):
        return True
    return not unit and (array.name in ("T", "M") or bool(_TORQUE_SIGN.fullmatch(plain_name(name))))


def _torque_rank(array: NamedArray, torque: FluxTorque) -> tuple[bool, bool, bool]:
    """Order of torques in one file, the one to compare first: by what the design says that it is,
    else that of the air gap before the one at the shaft.
    """
    stem, unit = split_name(array.name)
    unit = unit or array.unit
    known = is_unit("torque", unit)
    name = plain_name(stem if known else array.name)
    inner, shaft = bool(_INNER.search(name)), bool(_SHAFT.search(name))
    right, wrong = (shaft, inner) if torque == "shaft" else (inner, shaft)
    other = bool(_NOT_OF_THE_DRIVE.search(name))
    return other or bool(unit and not known), wrong and not right, not right


def plain_name(name: str) -> str:
    """A name in small letters without signs and accents, averages and what it says of peak
    values.
    """
    if found := _MEAN.match(name):
        name = found[1]
    name = BRACKETED_CLAIM.sub("", name)
    name = re.sub(
        r"[\W_]*(?:peak|pk|rms|eff)$", "", name.split(".")[-1].strip(), flags=re.IGNORECASE
    )
    return re.sub(r"^angular(?=flux|curr)", "", _words(name).replace(" ", ""))


def _words(name: str) -> str:
    """A name in small letters without accents, its words parted by single blanks."""
    parts = unicodedata.normalize("NFKD", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).casefold())
    bare = "".join(sign for sign in parts if unicodedata.category(sign) != "Mn")
    return re.sub(r"[\W_]+", " ", unicodedata.normalize("NFC", bare)).strip()


def choose(
    arrays: Sequence[NamedArray],
    columns: Mapping[str, str],
    source: str,
    torque: FluxTorque = "air-gap",
) -> dict[str, NamedArray]:
    """The array of each quantity: what the user named, else the names recognised in one group,
    else in the file.

    Currents may stand as i_d, i_q or as amplitude and angle, flux linkages as psi_d,
    psi_q, as inductances, or as voltages and a speed. ``torque`` is which of several to take.
    """
    if wrong := [key for key in columns if key not in KINDS]:
        raise InputError(
            f"columns: unknown key {wrong[0]!r}; write {', '.join(KINDS)}", source=source
        )
    chosen = {quantity: named_by_user(arrays, name, source) for quantity, name in columns.items()}
    free = [array for array in arrays if not any(array is taken for taken in chosen.values())]
    everywhere: dict[str, list[NamedArray]] = {}
    groups: dict[str, dict[str, list[NamedArray]]] = {}
    for array in free:
        for quantity in recognised(array):
            everywhere.setdefault(quantity, []).append(array)
            groups.setdefault(array.group, {}).setdefault(quantity, []).append(array)
    wanted = [quantity for quantity in _form(chosen, everywhere) if quantity not in chosen]
    complete = [
        group for group, found in groups.items() if all(quantity in found for quantity in wanted)
    ]
    first = min((_rank(group) for group in complete), default=None)
    candidates = [groups[group] for group in complete if _rank(group) == first] or [everywhere]
    if missing := [quantity for quantity in wanted if quantity not in everywhere]:
        message = f"no {' and '.join(missing)} found among {listed(arrays)}"
        raise InputError(f"{message}; write {advice(missing)}", source=source)
    for quantity in wanted:
        chosen[quantity] = _best(
            quantity, [a for group in candidates for a in group.get(quantity, ())], source
        )
    _choose_beside(chosen, candidates, everywhere, torque, source)
    if unused := [key for key in columns if _no_part(key, chosen)]:
        message = f"columns: {unused[0]} is not part of the map, which is read from"
        raise InputError(
            f"{message} {', '.join(wanted_of(chosen))}; remove the key, or name what goes with it",
            source=source,
        )
    return chosen


def _choose_beside(
    chosen: dict[str, NamedArray],
    candidates: Sequence[Mapping[str, Sequence[NamedArray]]],
    everywhere: Mapping[str, Sequence[NamedArray]],
    torque: FluxTorque,
    source: str,
) -> None:
    """Add what stands beside the map: torque, third coordinates, losses, what voltages need."""
    voltages = "v_d" in chosen
    for quantity in ("torque", *THIRD, *(_OF_POINTS if voltages else _OF_LOSSES)):
        found = [
            array
            for group in candidates
            for array in group.get(quantity, ())
            if array.values.size > (0 if voltages else 1) and array.numeric
        ]
        if quantity == "torque" and not found:
            shape = chosen[wanted_of(chosen)[-1]].values.shape
            found = [array for array in everywhere.get("torque", ()) if array.values.shape == shape]
        if quantity in chosen or not found:
            continue
        if quantity == "torque":
            first = min(_torque_rank(array, torque) for array in found)
            found = [array for array in found if _torque_rank(array, torque) == first]
            chosen[quantity] = found[0] if torque == "ignore" else _best(quantity, found, source)
        elif quantity in THIRD:
            chosen[quantity] = _varying(found)
        elif (total := [a for a in found if "tot" in a.name.casefold()] or found) and all(
            _equal(total[0], other) for other in total[1:]
        ):
            chosen[quantity] = total[0]


_OF_POINTS = ("frequency", "resistance", "loss", "copper_loss", "efficiency")
_OF_LOSSES = ("loss", "efficiency")


def wanted_of(chosen: Mapping[str, NamedArray]) -> tuple[str, ...]:
    """Quantities among the chosen ones that make the map."""
    currents = ("i_d", "i_q") if {"i_d", "i_q"} <= set(chosen) else ("i", "beta")
    return (*currents, *next((f for f in _FLUX_FORMS if set(f) <= set(chosen)), FLUXES))


def _no_part(key: str, chosen: Mapping[str, NamedArray]) -> bool:
    """Whether what the user named is of another form of the map than the one that is read."""
    forms = ("i", "beta", "i_d", "i_q", *FLUXES, "l_d", "l_q", "psi_m", *VOLTAGES)
    return (key in forms and key not in wanted_of(chosen)) or (
        key in ("frequency", "resistance", "copper_loss") and "v_d" not in wanted_of(chosen)
    )


def _form(chosen: Mapping[str, NamedArray], found: Iterable[str]) -> tuple[str, ...]:
    """Quantities that make the map: Cartesian or polar currents; flux linkages, inductances or
    voltages.
    """
    known, named = {*chosen, *found}, set(chosen)
    polar = {"i", "beta"} & named or (not {"i_d", "i_q"} <= known and {"i", "beta"} <= known)
    fluxes: tuple[str, ...] = FLUXES
    if set(VOLTAGES) & named:
        fluxes = VOLTAGES
    elif not set(FLUXES) & known:
        if set(_APPARENT) <= known or set(_APPARENT) & named:
            fluxes = _APPARENT
        elif set(VOLTAGES) <= known:
            fluxes = VOLTAGES
        elif {"l_d", "l_q"} <= known:
            fluxes = _APPARENT
    return (*(("i", "beta") if polar else ("i_d", "i_q")), *fluxes)


_APPARENT = ("l_d", "l_q", "psi_m")
_FLUX_FORMS = (FLUXES, _APPARENT, VOLTAGES)


def _best(quantity: str, found: Sequence[NamedArray], source: str) -> NamedArray:
    """The one array among several, if it is plain which: means before angle-resolved,
    peak before r.m.s. values.
    """
    found = [array for array in found if not np.iscomplexobj(array.values)] or found
    found = [array for array in found if not array.name.casefold().startswith("angular")] or found
    found = [array for array in found if claimed(array.name, array.unit) != "rms"] or found
    if all(_equal(found[0], other) for other in found[1:]):
        return found[0]
    message = f"{len(found)} arrays may be {quantity}: {listed(found)}"
    raise InputError(f"{message}; write {advice([quantity])}", source=source)


def _varying(found: Sequence[NamedArray]) -> NamedArray:
    """Of several angles, temperatures or speeds the magnets' one, or the
    first that is no constant.
    """
    return min(
        found, key=lambda array: (np.ptp(array.values) == 0.0, "mag" not in array.name.casefold())
    )


def _equal(one: NamedArray, other: NamedArray) -> bool:
    same = one.unit == other.unit and one.numeric and other.numeric and one.name == other.name
    return same and np.array_equal(one.values, other.values)


def _rank(group: str) -> tuple[bool, int]:
    """Order of groups that hold a whole map: SyR-e's map before its trajectories,
    the root before branches.
    """
    return not re.search(r"fluxmap_dq[./]$", group.lower()), group.count(".") + group.count("/")


def named_by_user(arrays: Sequence[NamedArray], name: str, source: str) -> NamedArray:
    """The array that a user named by its path, by the last part of it, or
    by a heading with its unit.
    """
    wanted = name.strip().lstrip("/")
    labels = (wanted, wanted, "{} [{}]".format(*split_name(wanted)))
    for fold in (str, str.casefold):
        for k, label in enumerate(labels):
            found = [array for array in arrays if fold(array.labels[k]) == fold(label)]
            if len(found) > 1:
                raise InputError(
                    f"columns: {name!r} is the name of {listed(found)}; write one path",
                    source=source,
                )
            if found:
                return found[0]
    raise InputError(
        f"columns: no {name!r} found among {listed(arrays)}; write one of these names",
        source=source,
    )


_PAIRS = re.compile(
    r"(?:number|num|no|n)?(?:of)?(pole?pairs?|polpaar(?:zahl|e)?|pp|np|npp|zp|poles|polenumber|polzahl)"
)

_MOST_PAIRS = 200


def stated_pole_pairs(arrays: Sequence[NamedArray]) -> int:
    """Pole pairs that a file states beside its map, 0 where it states none or several."""
    found = set()
    for array in arrays:
        match = (
            _PAIRS.fullmatch(plain_name(array.name)) if len(array.name) <= _LONGEST_NAME else None
        )
        if (
            match
            and array.numeric
            and array.values.size
            and np.all(array.values == array.values.flat[0])
        ):
            count = float(array.values.flat[0].real)
            found.add(count / 2.0 if match[1] in ("poles", "polenumber", "polzahl") else count)
    count = found.pop() if len(found) == 1 else 0.0
    return int(count) if count.is_integer() and 1.0 <= count <= _MOST_PAIRS else 0


def advice(quantities: Sequence[str]) -> str:
    """What to write for arrays that are not found."""
    return "columns: {" + ", ".join(f"{quantity}: NAME" for quantity in quantities) + "}"


# Units that flux-map files give by kind of quantity, in the spellings that tools use.

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


# Columns of what is not known of the points: standard deviations, and their parts that all share.
_SIGMA = re.compile(r"sigma_([dq])")
_SHARED = re.compile(r"shared_(\d+)_([dq])")


def deviations_beside(
    arrays: Sequence[NamedArray],
    chosen: Mapping[str, NamedArray],
    i_d: FloatArray,
    i_q: FloatArray,
) -> tuple[MapDeviations | None, set[str]]:
    """Standard deviations in columns beside the points, in the file's own axes, and their paths.

    None where there are none, or the points were not taken over one by one.
    """
    size = i_d.size
    fitting = {"i_d", "i_q", "psi_d", "psi_q"} <= chosen.keys() and all(
        chosen[name].values.shape == (size,) for name in ("i_d", "i_q", "psi_d")
    )
    found: dict[str, FloatArray] = {}
    paths = set()
    for array in arrays:
        named = _SIGMA.fullmatch(array.name) or _SHARED.fullmatch(array.name)
        if named and array.numeric and array.values.shape == (size,) and is_unit("psi", array.unit):
            found[array.name] = np.asarray(array.values, np.float64) * factor("psi", array.unit)
            paths.add(array.path)
    if not fitting or not {"sigma_d", "sigma_q"} <= found.keys():
        return None, set()
    numbers = sorted({int(one[1]) for name in found if (one := _SHARED.fullmatch(name))})
    none = np.zeros(size)
    shared = np.reshape(
        [[found.get(f"shared_{number}_{axis}", none) for axis in "dq"] for number in numbers],
        (-1, 2, size),
    )
    whole = np.stack([found["sigma_d"], found["sigma_q"]])
    own = np.sqrt(np.maximum(whole**2 - np.sum(shared**2, axis=0), 0.0))
    if not (np.isfinite(own).all() and np.isfinite(shared).all()):
        return None, set()
    return MapDeviations(i_d, i_q, own, shared), paths
