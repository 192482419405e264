"""Labels of axes and legends in plain words: what is meant, and its unit."""

from __future__ import annotations

import re

from dqforge.machines.records import dataclass

_LETTERS = {
    "\u00b5": "u",
    "\u03bc": "u",
    "\u00b0": " deg",
    "\u03b1": "alpha",
    "\u03b2": "beta",
    "\u03b8": "theta",
    "\u03c3": "sigma",
    "\u03c4": "tau",
    "\u03c6": "phi",
    "\u03c8": "psi",
    "\u03c9": "omega",
    "\u03a9": "Ohm",
    "\u2212": "-",
    "\u2013": "-",
    "\u00b7": " ",
    "\u00b2": "^2",
    "\u202f": " ",
    "\u00a0": " ",
}

_SIMPLE = r"[pnumkM]?(?:Ohm|Hz|Wh|Wb|VA|rad|kg|A|V|W|H|N|F|J|s|m|K)(?:\^?[23])?"
_UNIT = rf"(?:%|ppm|ppb|rpm|dB|deg(?: ?C)?|{_SIMPLE}(?:[ /]{_SIMPLE})*)(?!\w)"
_SHARE = rf"{_UNIT} of .*"
NO_UNIT = "1"  # Unit of what has none.


@dataclass(frozen=True, slots=True)
class Quantity:
    """What an axis shows.

    Attributes:
        name: Its name, empty where the label is a unit alone.
        unit: Its unit, "1" where it has none.
    """

    name: str
    unit: str


def plain(text: str) -> str:
    """Text of a figure in plain letters: subscripts after a low line, Greek letters by name.

    Args:
        text: As it is drawn, such as ``$L_{dd}$``.
    """
    text = text.replace("$", "").replace("{", "").replace("}", "").replace("\n", " ")
    for letter, word in _LETTERS.items():
        text = text.replace(letter, word)
    text = re.sub(r"\bdegrees\b", "deg", text)
    return " ".join(text.replace("deg C", "degC").split())


def quantity(label: str) -> Quantity:
    """Name and unit that a label of an axis holds.

    Args:
        label: Such as ``$i_d$ error in mA``, ``Turn (rad)``, ``machines [%]`` or ``A``.
    """
    text = plain(label)
    alone = re.fullmatch(rf"({_SHARE}|{_UNIT})(?: \(.*\))?", text)
    if alone is not None:
        return Quantity("", alone.group(1))
    found = re.search(rf"(?:^| )(?:in|by) ({_SHARE})$", text)
    found = found or re.search(rf"(?:^| )(?:in|by) ({_UNIT})", text)
    found = found or re.search(rf" ?[\[(]({_UNIT}[^\])]*)[\])]", text)
    if found is None:
        return Quantity(text, NO_UNIT)
    name = f"{text[: found.start()]}{text[found.end() :]}"
    return Quantity(" ".join(name.split()).strip(", "), found.group(1))
