"""What a design says of a correction, and what it leaves open."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.learned_correction.assessment import training_drives
from dqforge.optimizer.learned_correction.correction_frame import CorrectionFrame, frame_of
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.training import TrainingBox

# Time constant of the filter of the correction in s where the design names none.
FILTER_TIME = 0.02


def frame_for(
    gains: FluxGains, machine: LinearMachine, settings: ObserverSettings, box: TrainingBox
) -> CorrectionFrame:
    """What the correction is told; its limit is the largest error of the training where the design
    names none.

    Args:
        gains: Of the flux observer.
        settings: The observer of the design.
    """
    drives = training_drives(gains, machine, box)
    time = FILTER_TIME if settings.correction_filter is None else settings.correction_filter
    limit = settings.correction_limit
    if limit is None:
        limit = float(np.max(np.abs(drives.error)))
    share = float(-np.expm1(-gains.path.t_s / time))
    return frame_of(drives, box, share, limit)
