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
from sphinx.util import logging

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

_log = logging.getLogger(__name__)

_NAMESPACE = "http://www.w3.org/1998/Math/MathML"

_SPOKEN = {r"\langle": "\u27e8", r"\rangle": "\u27e9", r"\arg": "arg"}
"""What the converter leaves as it stands."""


def mathml(formula: str, *, block: bool) -> str:
    """MathML of a formula in LaTeX.

    Parameters
    ----------
    formula:
        Without dollars.
    block:
        Whether it stands on lines of its own.

    Raises
    ------
    ValueError
        The converter refuses it, or leaves a command as it stands.
    """
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
    set_spacing(tree, formula)
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


def _visit(translator: HTML5Translator, node: nodes.math | nodes.math_block, block: bool) -> None:
    try:
        made = mathml(node.astext(), block=block)
    except ValueError as error:
        _log.warning("formula %r: %s", node.astext(), error, location=node)
        made = f"<code>{translator.encode(node.astext())}</code>"
    if block:
        # Wide formulas scroll on narrow screens, by the keyboard as well.
        made = f'<div class="formula" tabindex="0">{made}</div>\n'
    translator.body.append(made)
    raise nodes.SkipNode


def _inline(translator: HTML5Translator, node: nodes.math) -> None:
    _visit(translator, node, block=False)


def _block(translator: HTML5Translator, node: nodes.math_block) -> None:
    _visit(translator, node, block=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the renderer that conf.py names."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
