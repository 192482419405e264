"""What the arrays of a flux-map file stand for: a table of the names that tools give,
and the choice among several.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.files.named_arrays import NamedArray, listed
from dqforge.machines.flux_map_files.units import BRACKETED_CLAIM, claimed, is_unit, split_name

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
}

"""Quantities that an array may stand for, in the order of a message,
with the kind of their unit."""


FLUXES = ("psi_d", "psi_q")


WANTED = ("i_d", "i_q", *FLUXES)


THIRD = ("angle", "temperature", "speed")

"""What a map may be resolved over beside its currents."""


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
)


_AXES = tuple((kind, re.compile(pattern)) for kind, pattern in _PATTERNS)

"""Quantities of both axes, by their names in small letters without signs."""


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
}


_ONE = {quantity: re.compile(pattern) for quantity, pattern in _SINGLE.items()}


_BY_UNIT = {"temperature": ("t", "tm", "tr", "tw", "ϑ"), "speed": ("n", "nm", "w", "wm", "wr")}

"""Short names that only their unit makes a temperature or a speed."""


_TORQUE = re.compile(
    r"(?:angular|electromagnetic|electrom|airgap|em|el|mech|mechanical|shaft|output|measured|machine|motor|total|avg)*"
    r"(?:torque|drehmoment|moment|couple|coppia|tq|trq|te|tem|tel|tmech|tshaft|mel|mi)"
    r"(?:em|e|el|fe|sim|shaft|mech|meas|avg|mean|map|table|data|vec|mat|ave|perpolepair|electromagnetic)*"
)


_NO_TORQUE = re.compile(
    r"rip|^dt|tpp|pktopk|peaktopeak|puls|cogg|frict|loss|rated|nom|constant|const|^kt|limit|max|min"
)


_MEAN = re.compile(r"(?:avg|mean|ave|average)\s*\((.*)\)\s*", re.IGNORECASE)


def recognised(array: NamedArray) -> tuple[str, ...]:
    """Quantities that an array's name stands for: one, both axes of a complex array, or none."""
    if len(array.name) > _LONGEST_NAME:
        return ()
    stem, unit = split_name(array.name)
    unit = unit or array.unit
    for kind, pattern in _AXES:
        for name in (array.name, stem) if is_unit(kind, unit) else (array.name,):
            found = pattern.fullmatch(_plain(name))
            axes = next(filter(None, found.groups()), "") if found else ""
            if axes and (len(axes) == 1 or np.iscomplexobj(array.values)):
                return tuple(f"{kind}_{axis}" for axis in axes)
    return _single(array, stem, unit)


def _single(array: NamedArray, stem: str, unit: str) -> tuple[str, ...]:
    """The quantity without an axis that an array stands for."""
    if _is_torque(array, stem, unit):
        return ("torque",)
    for quantity, pattern in _ONE.items():
        known = is_unit(KINDS[quantity], unit)
        plain = _plain(stem if known else array.name)
        if (pattern.fullmatch(plain) and (known or not unit)) or (
            known and plain in _BY_UNIT.get(quantity, ())
        ):
            return (quantity,)
    return ()


def _is_torque(array: NamedArray, stem: str, unit: str) -> bool:
    """Whether an array is a torque: by its unit or its name, but no ripple, friction or rating."""
    known = is_unit("torque", unit)
    name = _plain(stem if known else array.name)
    if _NO_TORQUE.search(name) or (unit and not known):
        return False
    # A capital T is SyR-e's torque; of a single number, or in small letters, it may be anything.
    return known or bool(_TORQUE.fullmatch(name)) or (array.name == "T" and array.values.size > 1)


def _plain(name: str) -> str:
    """A name in small letters without signs, averages and what it says of peak values."""
    if found := _MEAN.match(name):
        name = found[1]
    name = BRACKETED_CLAIM.sub("", name)
    name = re.sub(
        r"[\W_]*(?:peak|pk|rms|eff)$", "", name.split(".")[-1].strip(), flags=re.IGNORECASE
    )
    return re.sub(r"^angular(?=flux|curr)", "", re.sub(r"[\W_]", "", name.casefold()))


def choose(
    arrays: Sequence[NamedArray], columns: Mapping[str, str], source: str
) -> dict[str, NamedArray]:
    """The array of each quantity: what the user named, else the names recognised in one group,
    else in the file.

    Currents may stand as i_d, i_q or as amplitude and angle, flux linkages as psi_d,
    psi_q or as inductances.
    """
    if wrong := [key for key in columns if key not in KINDS]:
        raise InputError(
            f"columns: unknown key {wrong[0]!r}; write {', '.join(KINDS)}", source=source
        )
    chosen = {quantity: _named(arrays, name, source) for quantity, name in columns.items()}
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
    for quantity in ("torque", *THIRD):
        found = [
            a
            for group in candidates
            for a in group.get(quantity, ())
            if a.values.size > 1 and a.numeric
        ]
        if quantity not in chosen and found:
            chosen[quantity] = (
                _varying(found) if quantity in THIRD else _best(quantity, found, source)
            )
    return chosen


def _form(chosen: Mapping[str, NamedArray], found: Iterable[str]) -> tuple[str, ...]:
    """Quantities that make the map: Cartesian or polar currents, flux linkages or inductances."""
    known = {*chosen, *found}
    polar = not {"i_d", "i_q"} <= known and (
        {"i", "beta"} <= known or bool({"i", "beta"} & set(chosen))
    )
    apparent = not set(FLUXES) & known and (
        {"l_d", "l_q"} <= known or bool({"l_d", "l_q", "psi_m"} & set(chosen))
    )
    return (
        *(("i", "beta") if polar else ("i_d", "i_q")),
        *(("l_d", "l_q", "psi_m") if apparent else FLUXES),
    )


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


def _named(arrays: Sequence[NamedArray], name: str, source: str) -> NamedArray:
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


def advice(quantities: Sequence[str]) -> str:
    """What to write for arrays that are not found."""
    return "columns: {" + ", ".join(f"{quantity}: NAME" for quantity in quantities) + "}"
