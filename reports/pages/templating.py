"""The one Jinja2 environment: strict about names, silent about nothing, plain in white space."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dqforge.reports.c_code.numbers import (
    addend,
    comment_text,
    float_literal,
    hexadecimal_word,
    int32_addend,
    int32_literal,
    int64_literal,
)
from dqforge.reports.pages.html_text import symbols

if TYPE_CHECKING:
    from jinja2 import Environment


def _source(name: str) -> str | None:
    """Text of the template ``<room>/<file>``, which lies in the folder ``templates`` of its room;
    of a template from outside the package, which is named by its absolute path, that of the file.
    """
    if Path(name).is_absolute():
        path: Path | Traversable = Path(name)
    else:
        room, _, file = name.rpartition("/")
        path = resources.files("dqforge.reports").joinpath(room, "templates", file)
    return path.read_text(encoding="utf-8") if path.is_file() else None


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_source),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=lambda name: name is not None and ".html" in name,
    )
    from dqforge.reports.pages.figures_style import DARK

    environment.globals["figure_colours"] = DARK
    environment.filters.update(
        f32=float_literal,
        addend=addend,
        comment=comment_text,
        word=hexadecimal_word,
        int32=int32_literal,
        int32_addend=int32_addend,
        int64=int64_literal,
        symbols=symbols,
    )
    return environment


def render(template: str, context: Mapping[str, Any]) -> str:
    """Render a template of the package; an unknown name in it is an error, not an empty string."""
    return _environment().get_template(template).render(context)
