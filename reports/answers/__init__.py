"""What the commands answer: one module each, loaded when its command is given."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.reports.answers import (
        bemf,
        check,
        compare,
        dqy,
        explain,
        export,
        fit,
        library,
        losses,
        mtpa,
        reproduce,
        run,
        simulate,
        tune,
        verify,
    )

__all__ = [
    "bemf",
    "check",
    "compare",
    "dqy",
    "explain",
    "export",
    "fit",
    "library",
    "losses",
    "mtpa",
    "reproduce",
    "run",
    "simulate",
    "tune",
    "verify",
]


def __getattr__(name: str) -> ModuleType:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.{name}")
