"""Section on tolerances of a design file: how far the drive may be from its data."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.entries import Quantity, QuantityRule
from dqforge.machines.schema_entries import Section
from dqforge.machines.two_sided import Between, PartOrTimeRule, ShareRule

Deviation = Annotated[Quantity | Between, ShareRule()]
PartOrTime = Annotated[Quantity | Between, PartOrTimeRule()]
LowCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, ("peak", "rms"), "peak")]


class TolerancesSection(Section):
    """How far the drive may be from its data: both ways by one value, or {from: -10 %, to: 30 %}."""

    r_s: Deviation | None = Field(default=None, description="phase resistance (write 30 %); default 0")
    l_d: Deviation | None = Field(default=None, description="d-axis inductance (write 20 %); default 0")
    l_q: Deviation | None = Field(default=None, description="q-axis inductance (write 20 %); default 0")
    psi_pm: Deviation | None = Field(default=None, description="magnet flux linkage (write 5 %); default 0")
    inertia: Deviation | None = Field(default=None, description="moment of inertia (write 20 %); default 0")
    v_dc: Deviation | None = Field(
        default=None, description="dc-link voltage against the one that duty cycles are computed with; default 0"
    )
    dead_time: PartOrTime | None = Field(
        default=None,
        description="error of the dead-time compensation: share of inverter.dead_time (20 %), or a time;"
        " {from: 0 %, to: 100 %} reaches from a perfect compensation to none",
    )
    low_current: LowCurrent | None = Field(
        default=None, description="smallest phase current at which the loops must hold in spite of it; default 10 %"
    )
