"""The values of a data sheet as options of a command: one per entry of the table, in one bundle."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any

from typer import Option

from dqforge.machines.data_sheet.sheet_values import SHEET_VALUES, SheetValue

Sheet = dict[str, str]  # By the dotted key of the design, the text that was given.
_BUNDLE = "sheet"


def with_sheet(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the parameter ``sheet`` of a command by the options of a data sheet.

    The command gets those that were given, as a `Sheet`.
    """

    @wraps(command)
    def bundled(**options: Any) -> None:
        texts = {value.key: options.pop(_name(value)) for value in SHEET_VALUES}
        given = {key: text for key, text in texts.items() if text is not None}
        command(**options, **{_BUNDLE: given})

    signature = inspect.signature(command, eval_str=True)
    own = [entry for entry in signature.parameters.values() if entry.name != _BUNDLE]
    more = [
        inspect.Parameter(
            _name(value),
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, _option(value)],
        )
        for value in SHEET_VALUES
    ]
    parameters = [*own, *more]
    bundled.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    bundled.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return bundled


def _name(value: SheetValue) -> str:
    return value.flag.removeprefix("--").replace("-", "_")


def _option(value: SheetValue) -> Any:
    words = f"{value.what}, e.g. '{value.example}'."
    return Option(value.flag, metavar="TEXT", help=words)
