"""The trackers by name; a line per method, whose module holds its record ``TRACKER``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType

from dqforge.optimizer.estimators.tracker import Tracker

_MODULES: dict[str, str] = {
    "injection": "saliency.injection",
    "inform": "saliency.inform",
    "inductance-mapping": "saliency.inductance_mapping",
    "third-harmonic": "harmonic_trackers.sum_voltage",
}


def _record(module: str) -> Tracker:
    record: Tracker = import_module(f"dqforge.optimizer.{module}").TRACKER
    return record


TRACKERS: Mapping[str, Tracker] = MappingProxyType(
    {name: _record(module) for name, module in _MODULES.items()}
)

"""The trackers by name."""
