"""The trackers by name; a line per method, whose module holds its record ``TRACKER``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.names import LoadedByName

if TYPE_CHECKING:
    from dqforge.optimizer.estimators.tracker import Tracker

# The trackers by name.
TRACKERS: LoadedByName[str, Tracker] = LoadedByName(
    {
        "injection": "dqforge.optimizer.saliency.injection:TRACKER",
        "inform": "dqforge.optimizer.saliency.inform:TRACKER",
        "inductance-mapping": "dqforge.optimizer.saliency.inductance_mapping:TRACKER",
        "third-harmonic": "dqforge.optimizer.harmonic_trackers:TRACKER",
    }
)
