"""Everything that a design can ask for, in the order of ``result.json``."""

from __future__ import annotations

from typing import Any

from dqforge.reports.capability import Capability
from dqforge.reports.current_reference.capability import (
    CURRENT_REFERENCE,
    NEGATIVE_POINTS,
    NEGATIVE_REFERENCE,
)
from dqforge.reports.dynamic_references import DYNAMIC_REFERENCES
from dqforge.reports.firmware.written_files import FIRMWARE
from dqforge.reports.fixed_observers.fixed_observer_header import FIXED_OBSERVER
from dqforge.reports.loops.capability import GAIN_SCHEDULE, LOOPS, NO_LOOPS, STABILITY
from dqforge.reports.losses.map_figures import LOSSES, MISSION
from dqforge.reports.modulation_choice.figures import MODULATION_CHOICE
from dqforge.reports.observers.commissioning import COMMISSIONING
from dqforge.reports.observers.online_estimation import ONLINE_ESTIMATION
from dqforge.reports.observers.position_header import (
    OBSERVER_PROOF,
    POSITION_OBSERVER,
    SPEED_OBSERVER,
)
from dqforge.reports.operating_points.figures import OPERATING_POINTS
from dqforge.reports.phase_control.emitted_integers import FIXED_CONTROL, FLOAT32_CONTROL
from dqforge.reports.simulation.tables import FORMATS_NOT_SIMULATED, SIMULATION
from dqforge.reports.single_headers.application import APPLICATION
from dqforge.reports.single_headers.current_feedback import CURRENT_FEEDBACK
from dqforge.reports.single_headers.field_weakening import WEAKENING
from dqforge.reports.single_headers.fixed_reference import FIXED_REFERENCE
from dqforge.reports.single_headers.frame_tables import FRAME_TABLES
from dqforge.reports.single_headers.overmodulation import OVERMODULATION
from dqforge.reports.single_headers.speed_measurement import SPEED_MEASUREMENT
from dqforge.reports.six_step.header import SIX_STEP
from dqforge.reports.start_up.tables import START_UP
from dqforge.reports.waveforms.tables import PHASE_REFERENCE, WAVEFORMS

CAPABILITIES: tuple[Capability[Any], ...] = (
    OPERATING_POINTS,
    CURRENT_REFERENCE,
    NEGATIVE_POINTS,
    NEGATIVE_REFERENCE,
    LOOPS,
    NO_LOOPS,
    STABILITY,
    CURRENT_FEEDBACK,
    DYNAMIC_REFERENCES,
    LOSSES,
    MISSION,
    WAVEFORMS,
    PHASE_REFERENCE,
    FRAME_TABLES,
    WEAKENING,
    FIXED_REFERENCE,
    FLOAT32_CONTROL,
    FIXED_CONTROL,
    MODULATION_CHOICE,
    OVERMODULATION,
    GAIN_SCHEDULE,
    POSITION_OBSERVER,
    OBSERVER_PROOF,
    FIXED_OBSERVER,
    SPEED_OBSERVER,
    SIX_STEP,
    START_UP,
    SPEED_MEASUREMENT,
    ONLINE_ESTIMATION,
    COMMISSIONING,
    APPLICATION,
    FIRMWARE,
    FORMATS_NOT_SIMULATED,
    SIMULATION,
)
