"""What TeX knows of a formula's marks and MathML has to be told: bars that open and close, hats
that sit on their letter, upright capitals of Greek, room around the name of a function.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

_NAMED = r"(a|arc)?(sin|cos|tan|cot)h?|ln|log|exp|arg|min|max"

_THIN = "0.167em"

_OPEN, _CLOSE, _HAT = ("(", "["), (")", "]"), "\u02c6"


def set_spacing(tree: ElementTree.Element, formula: str) -> None:
    """Set marks and spaces of a formula as TeX does.

    Args:
        tree: Its MathML, changed in place.
        formula: In LaTeX, which says of each bar whether it opens or closes.
    """
    _set_bars(tree, formula)
    for leaf in tree.iter():
        if leaf.tag == "mover" and leaf[-1].text == "^":
            leaf[-1].text = _HAT  # the sign of the keyboard would lie in the letter
        if leaf.tag == "mo" and leaf.text != "mod" and re.fullmatch("[A-Za-z]+", leaf.text or ""):
            leaf.tag = "mi"
            leaf.set("class", "function")
            leaf.set("mathvariant", "normal")
        if leaf.tag == "mi" and re.fullmatch("[\u0391-\u03a9]", leaf.text or ""):
            leaf.set("mathvariant", "normal")
    for row in list(tree.iter()):
        if row.tag in ("math", "mrow", "mtd", "mstyle"):
            _set_functions_apart(row)


def _set_bars(tree: ElementTree.Element, formula: str) -> None:
    """A bar is no relation: without its side it would keep the room of one."""
    sides = re.findall(r"\\([lr])[vV]ert(?![A-Za-z])", formula)
    bars = [leaf for leaf in tree.iter("mo") if leaf.text in ("|", "\u2016") and not leaf.attrib]
    if len(sides) == len(bars):
        for bar, side in zip(bars, sides, strict=True):
            bar.set("form", "prefix" if side == "l" else "postfix")
            bar.set("stretchy", "false")


def _set_functions_apart(row: ElementTree.Element) -> None:
    """Thin spaces between the name of a function and what is no bracket or operator beside it."""
    made: list[ElementTree.Element] = []
    for part in list(row):
        before = made[-1] if made else None
        if before is not None and (
            (_is_function(part) and _ends_a_factor(before))
            or (_is_function(before) and _begins_a_factor(part))
        ):
            made.append(ElementTree.Element("mspace", {"width": _THIN}))
        made.append(part)
    row[:] = made


def _is_function(part: ElementTree.Element) -> bool:
    name = part[0] if part.tag in ("msub", "msup", "munder") and len(part) else part
    named = re.fullmatch(_NAMED, name.text or "") is not None
    return name.tag == "mi" and (named or name.get("class") == "function")


def _ends_a_factor(part: ElementTree.Element) -> bool:
    if part.tag == "mo":
        return part.text in _CLOSE or part.get("form") == "postfix"
    return part.tag not in ("mspace", "mtext")


def _begins_a_factor(part: ElementTree.Element) -> bool:
    if part.tag == "mo":
        return part.get("form") == "prefix" and part.text not in _OPEN
    fenced = part.tag == "mrow" and len(part) > 0 and part[0].get("fence") == "true"
    return part.tag not in ("mspace", "mtext") and not fenced
