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


def _place(name: str) -> Path | Traversable:
    """Where the template ``<room>/<file>`` lies: in the folder ``templates`` of its room; a
    template from outside the package is named by its absolute path.
    """
    if Path(name).is_absolute():
        return Path(name)
    room, _, file = name.rpartition("/")
    return resources.files("dqforge.reports").joinpath(room, "templates", file)


def _source(name: str) -> str | None:
    path = _place(name)
    return path.read_text(encoding="utf-8") if path.is_file() else None


def _kept_place(name: str) -> Path | None:
    """File of a template of the package, whose byte code is kept."""
    path = _place(name)
    return path if isinstance(path, Path) and not Path(name).is_absolute() else None


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    from dqforge.reports.pages.compiled_templates import CompiledTemplates

    environment = Environment(
        loader=FunctionLoader(_source),
        bytecode_cache=CompiledTemplates(_kept_place),
        optimized=False,  # what a filter makes of a constant would be kept with the byte code
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
