"""The template's drive with observers that learned, trained once for all tests."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.observers.tuning import PositionObserver


def observed_template(method: ObserverMethodName, **keys: object) -> Design:
    """The template with an observer and its keys, without a speed loop."""
    design = load_text(catalogue.template(), "template.yaml")
    observer = ObserverSettings(method=method, **keys)  # type: ignore[arg-type]
    control = replace(design.control, observer=observer, speed_loop=None)
    return replace(design, losses=None, control=control)


@cache
def learned_observer(method: ObserverMethodName) -> PositionObserver:
    """The observer of the template."""
    _, found = solve_observer(observed_template(method))
    assert found is not None
    return found
