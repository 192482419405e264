"""Numerical trouble inside the package as an error of one line, and the
entries that work on a design.

NumPy and SciPy warn on standard error and carry on with infinities and NaN. Nothing here carries
on: within `numerical_errors` an overflow, a division by zero, an invalid operation, and every other
`RuntimeWarning` end in a `NoSolutionError`. What computes with infinities and NaN on purpose says
so with an `numpy.errstate` of its own.
"""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Concatenate, ParamSpec, TypeVar

import numpy as np

from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError, Places, about

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design


_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
_PACKAGE = Path(__file__).parent.parent

# What Python, NumPy and SciPy say in a `ValueError` on a number that is not finite.
_OF_VALUES = (
    "cannot convert float",
    "math domain error",
    "must not contain infs or nans",
    "expected a nonnegative",
)


@contextmanager
def numerical_errors() -> Iterator[None]:
    """Turn numerical trouble in the block into a `NoSolutionError`."""
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            yield
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        refusal = refusal_of(error)
        if refusal is None:
            raise
        raise refusal from error


def refusal_of(error: Exception) -> NoSolutionError | None:
    """What to say of numerical trouble, None for an exception of another kind."""
    if isinstance(error, DqforgeError):
        return None
    if isinstance(error, (ArithmeticError, RuntimeWarning, np.linalg.LinAlgError)):
        return _refusal(error)
    of_values = isinstance(error, ValueError) and any(
        text in str(error).lower() for text in _OF_VALUES
    )
    return _refusal(error) if of_values else None


def _refusal(error: Exception) -> NoSolutionError:
    """One line on what went wrong and in which module."""
    what = " ".join(str(error).split()) or type(error).__name__
    return NoSolutionError(
        f"the numbers leave the range of floating point ({what}{_module(error.__traceback__)}); "
        "check the units and powers of ten of the values that it depends on"
    )


def _module(traceback: TracebackType | None) -> str:
    """Innermost module of this package on the way to an error."""
    found = ""
    while traceback is not None:
        path = Path(traceback.tb_frame.f_code.co_filename)
        if path.parent.parent == _PACKAGE and path.parent.name in (
            "machines",
            "optimizer",
            "reports",
        ):
            found = f", in {path.parent.name}.{path.stem}"
        traceback = traceback.tb_next
    return found


@contextmanager
def located(places: Places | None, section: str) -> Iterator[None]:
    """Block that works on a design: numerical trouble and refusals come with their place in its
    file.
    """
    try:
        with about(section), numerical_errors():
            yield
    except DqforgeError as error:
        if places is not None:
            places.locate(error, section)
        raise


def require_design(given: object) -> None:
    """Refuse what stands where a design must, as from Python.

    Raises:
        InputError: Says how a design is made of it.
    """
    from dqforge.machines.design.design import Design

    if isinstance(given, Design):
        return
    made = "load_design(...) for a file or a drive of the library"
    if not isinstance(given, str | Path):
        made = "make_design(machine, v_dc=..., f_sw=...) for a machine, " + made
    raise InputError(f"design: expected a Design, got {type(given).__name__}; write {made}")


def on_design(
    section: str,
) -> Callable[
    [Callable[Concatenate[Design, _Arguments], _Result]],
    Callable[Concatenate[Design, _Arguments], _Result],
]:
    """Mark a function of a design as an entry: its errors name file, line, column and key,
    ``section`` by default.
    """

    def marked(
        function: Callable[Concatenate[Design, _Arguments], _Result],
    ) -> Callable[Concatenate[Design, _Arguments], _Result]:
        @functools.wraps(function)
        def entry(
            design: Design, /, *arguments: _Arguments.args, **options: _Arguments.kwargs
        ) -> _Result:
            require_design(design)
            with located(design.places, section):
                return function(design, *arguments, **options)

        return entry

    return marked
