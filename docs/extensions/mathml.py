"""Formulas as MathML, written when the site is built: nothing to fetch, no script to run.

A formula that cannot be converted is a warning, which `make docs` takes for an error.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from docutils import nodes
from formula_spacing import set_spacing
from latex2mathml.converter import convert
from sphinx.transforms.post_transforms import SphinxPostTransform
from sphinx.util import logging

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

_log = logging.getLogger(__name__)

_NAMESPACE = "http://www.w3.org/1998/Math/MathML"

_SPOKEN = {r"\langle": "\u27e8", r"\rangle": "\u27e9", r"\arg": "arg"}
"""What the converter leaves as it stands."""

_ENVIRONMENTS = {"{aligned}": "{align*}"}
"""What GitHub knows within two dollars, and what the converter calls it."""

_BEFORE, _AFTER = re.compile(r"[(\[]+$"), re.compile(r"^[.,;:)\]]+")

_CLOSE = ("|", "\u2016", "/")
_SIGNS = ("+", "\u2212", "\u00b1", "\u2213")
_OPENING = tuple("([{,;=<>\u2264\u2265\u2208\u2190\u2192\u2248\u2260\u22c5\u00d7")

_PRIMES = ("\u2032", "\u2033")

_BOLD = {
    "bold": (("A", "Z", 0x1D400), ("a", "z", 0x1D41A), ("0", "9", 0x1D7CE)),
    "bold-italic": (
        ("A", "Z", 0x1D468),
        ("a", "z", 0x1D482),
        ("\u0391", "\u03a9", 0x1D71C),
        ("\u03b1", "\u03c9", 0x1D736),
    ),
}
"""First and last letter of each alphabet, and where its bold one begins in Unicode."""


def mathml(formula: str, *, block: bool) -> str:
    """MathML of a formula in LaTeX.

    Args:
        formula: Without dollars.
        block: Whether it stands on lines of its own.

    Raises:
        ValueError: The converter refuses it, or leaves a command as it stands.
    """
    for known, called in _ENVIRONMENTS.items():
        formula = formula.replace(known, called)
    try:
        made = convert(formula, display="block" if block else "inline")
        tree = ElementTree.fromstring(made.replace(f' xmlns="{_NAMESPACE}"', "", 1))
    except Exception as error:
        raise ValueError(f"{type(error).__name__}: {error}") from error
    for leaf in tree.iter():
        leaf.text = _SPOKEN.get(leaf.text or "", leaf.text)
        _set_labels_upright(leaf)
        if block:
            _put_limits_below(leaf)
        _set_bold(leaf)
    set_spacing(tree, formula)
    for leaf in list(tree.iter()):
        _space_as_in_print(leaf)
        _set_primes(leaf)
    left = re.search(r"\\[A-Za-z]+|&", "".join(tree.itertext()))
    if left:
        raise ValueError(f"{left[0]} is not known to the converter")
    # As HTML has it: no namespace of XML, and no empty elements that close themselves.
    return ElementTree.tostring(tree, encoding="unicode", short_empty_elements=False)


def _set_labels_upright(leaf: ElementTree.Element) -> None:
    """A subscript of several letters is a label, one upright word, and no product."""
    if leaf.tag not in ("msub", "msubsup"):
        return
    row = leaf[1]
    letters = [each.text or "" for each in row]
    plain = all(each.tag == "mi" and not each.attrib and len(each.text or "") == 1 for each in row)
    if row.tag == "mrow" and len(letters) > 1 and plain:
        for each in list(row):
            row.remove(each)
        ElementTree.SubElement(row, "mi").text = "".join(letters)


def _put_limits_below(leaf: ElementTree.Element) -> None:
    """``min`` and its like carry what they run over below them where there is room."""
    first = leaf[0].text if len(leaf) else ""
    if leaf.tag == "msub" and first in ("min", "max", "lim", "sup", "inf"):
        leaf.tag = "munder"


def _set_bold(leaf: ElementTree.Element) -> None:
    """Letters that are bold in Unicode, since browsers know no other variant than that."""
    begins = _BOLD.get(leaf.attrib.get("mathvariant", ""))
    letter = leaf.text or ""
    if begins is None or len(letter) != 1:
        return
    for first, last, bold in begins:
        if first <= letter <= last:
            leaf.text = chr(bold + ord(letter) - ord(first))
            del leaf.attrib["mathvariant"]


def _space_as_in_print(leaf: ElementTree.Element) -> None:
    """Bars that are not asked to grow, and strokes of fractions, are close to what is beside them.

    A sign that follows an operator or a bracket belongs to what comes next.
    """
    before = "("
    for each in leaf:
        text = each.text or ""
        if each.tag == "mo" and text in _CLOSE and "stretchy" not in each.attrib:
            each.attrib.update(lspace="0em", rspace="0em")
            if text != "/":
                each.set("stretchy", "false")
        if each.tag == "mo" and text in _SIGNS and before in _OPENING:
            each.set("form", "prefix")
        if each.tag != "mspace":
            before = text if each.tag == "mo" else ""


def _set_primes(leaf: ElementTree.Element) -> None:
    """A prime is high up by itself: beside its letter, with the subscript behind both."""
    if leaf.tag not in ("msup", "msubsup") or (leaf[-1].text or "") not in _PRIMES:
        return
    parts = list(leaf)
    prime = ElementTree.Element("mo", {"lspace": "0em", "rspace": "0em"})
    prime.text = parts[-1].text
    for part in parts:
        leaf.remove(part)
    if leaf.tag == "msup":
        leaf.tag = "mrow"
        leaf.extend([parts[0], prime])
    else:
        leaf.tag = "msub"
        primed = ElementTree.SubElement(leaf, "mrow")
        primed.extend([parts[0], prime])
        leaf.append(parts[1])


def _visit(translator: HTML5Translator, node: nodes.math | nodes.math_block, block: bool) -> None:
    try:
        made = mathml(node.astext(), block=block)
    except ValueError as error:
        _log.warning("formula %r: %s", node.astext(), error, location=node)
        made = f"<code>{translator.encode(node.astext())}</code>"
    if block:
        # Wide formulas scroll on narrow screens, by the keyboard as well.
        made = f'<div class="formula" tabindex="0">{made}</div>\n'
    elif "before" in node or "after" in node:
        beside = [translator.encode(node.get(name, "")) for name in ("before", "after")]
        made = f'<span class="joined">{beside[0]}{made}{beside[1]}</span>'
    translator.body.append(made)
    raise nodes.SkipNode


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    _visit(translator, node, block=False)


class JoinPunctuation(SphinxPostTransform):
    """No line begins with the full stop, and none ends with the bracket, of a formula within it."""

    default_priority = 900
    formats = ("html",)

    def run(self, **_: Any) -> None:
        """Move what touches a formula into its node."""
        for formula in list(self.document.findall(nodes.math)):
            at, around = formula.parent.index(formula), formula.parent
            for step, name, touching in ((1, "after", _AFTER), (-1, "before", _BEFORE)):
                beside = around[at + step] if 0 <= at + step < len(around) else None
                found = touching.search(beside.astext()) if isinstance(beside, nodes.Text) else None
                if found is not None and isinstance(beside, nodes.Text):
                    formula[name] = found[0]
                    rest = beside.astext()[found.end() :] if step == 1 else beside[: found.start()]
                    around.replace(beside, nodes.Text(rest))


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    _visit(translator, node, block=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the renderer that conf.py names."""
    app.add_post_transform(JoinPunctuation)
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
