"""How docstrings and signatures of the package are shown.

Docstrings have Google's sections. Signatures have the annotations as they stand in the source
(``ArrayLike``, not what it is made of); results, which nobody makes by hand, have none, and a list
of their fields instead.
"""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import GoogleDocstring

from dqforge.machines.design.design import Design
from dqforge.reports.session.result import Result

if TYPE_CHECKING:
    from sphinx.application import Sphinx


_SECTIONS: Any = Config(napoleon_use_rtype=False)


def signature(_app: Sphinx, _what: str, _name: str, found: Any, *_more: Any) -> Any:
    """Signature and result of a name, annotations as they were written."""
    if _made_by_functions(found):
        return "", None
    try:
        whole = inspect.signature(found)
    except (TypeError, ValueError):
        return None
    given = [
        each.replace(annotation=_written(each.annotation))
        for each in whole.parameters.values()
        if each.name not in ("self", "cls")
    ]
    arguments = str(whole.replace(parameters=given, return_annotation=whole.empty))
    result = whole.return_annotation
    shown = None if inspect.isclass(found) or result is whole.empty else str(_written(result))
    return arguments, shown


def docstring(
    app: Sphinx, what: Any, name: str, found: Any, options: Any, lines: list[str]
) -> None:
    """Sections as fields; the fields of a result behind its text."""
    if what in ("class", "exception", "function", "method"):
        made = GoogleDocstring(list(lines), _SECTIONS, app, what, name, found, options)
        lines[:] = made.lines()
    if what == "class" and is_dataclass(found) and _made_by_functions(found):
        listed = [f"* ``{each.name}``: ``{_written(each.type)}``" for each in fields(found)]
        lines += ["", "Fields:", "", *listed, ""]


def _made_by_functions(found: Any) -> bool:
    return inspect.isclass(found) and issubclass(found, (Result, Design))


class _Written:
    """An annotation that is printed without quotes."""

    def __init__(self, text: str) -> None:
        self.text = text

    def __repr__(self) -> str:
        return self.text

    __str__ = __repr__


def _written(annotation: Any) -> Any:
    return _Written(annotation) if isinstance(annotation, str) else annotation


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to autodoc."""
    app.setup_extension("sphinx.ext.autodoc")
    app.connect("autodoc-process-signature", signature)
    app.connect("autodoc-process-docstring", docstring)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
