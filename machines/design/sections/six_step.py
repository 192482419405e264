"""The section ``control.six_step``: a drive whose blocks of 120 degrees are commutated by the
voltage of the phase that floats.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.design.settings import SixStepSettings, settings_from
from dqforge.machines.entries.kinds import Drop, FilterTime, PhaseCurrent, Section
from dqforge.machines.names import SIX_STEP_METHODS

_SETTINGS = SixStepSettings()


class SixStepSection(Section):
    """Six-step drive; only with the observers zero-crossing and emf-integration."""

    voltage_offset: Drop | None = Field(
        default=None,
        description="of the measured voltage of the floating phase (V); default 0.2 % of v_dc",
    )
    voltage_noise: Drop | None = Field(
        default=None,
        description="of that voltage, standard deviation (V); default one step of its converter",
    )
    voltage_bits: Annotated[int, Field(ge=8, le=16)] = Field(
        default=_SETTINGS.voltage_bits, description="of its converter, over 1.25 v_dc"
    )
    filter_time: FilterTime | None = Field(
        default=None, description="first-order filter on that voltage (s); default 0"
    )
    start_current: PhaseCurrent | None = Field(
        default=None, description="of alignment and forced start; default half of the limit"
    )
    align_time: FilterTime | None = Field(
        default=None, description="whole time of the alignment (s); default by the inertia"
    )


def read_six_step(section: SixStepSection | None, method: str | None) -> SixStepSettings | None:
    """The settings of a six-step drive, None for other drives.

    Args:
        section: ``control.six_step``, None where the file has none.
        method: ``control.observer.method``, None without an observer.
    """
    if method not in SIX_STEP_METHODS:
        return None
    return settings_from(SixStepSettings, section or SixStepSection())
