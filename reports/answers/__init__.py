"""What the commands answer: one module each, loaded when its command is given."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

from dqforge.reports.pages.answer import LOADING, QUICK_S, stage, status

if TYPE_CHECKING:
    from dqforge.reports.answers import (
        bemf,
        check,
        compare,
        current_feedback,
        doctor,
        dqy,
        estimators,
        explore,
        fit,
        identify,
        library,
        losses,
        machines,
        mtpa,
        reproduce,
        run,
        simulate,
        tune,
        verify,
    )

# fmt: off
__all__ = [
    "bemf", "check", "compare", "current_feedback", "doctor", "dqy", "estimators", "explore", "fit",
    "identify", "library", "losses", "machines", "mtpa", "reproduce", "run", "simulate", "tune",
    "verify",
]
# fmt: on


def __getattr__(name: str) -> ModuleType:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # Numerical libraries take a second or more on a slow disk, before anything else is under way.
    with status(LOADING, after=QUICK_S):
        stage(LOADING)
        return import_module(f"{__name__}.{name}")
