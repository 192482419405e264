"""Section on tolerances of a design file: how far the drive may be from its data."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import Deviation, Tolerances
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import Between, PartOrTimeRule, Section, ShareRule
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.units.quantities import format_quantity

DeviationKey = Annotated[Quantity | Between, ShareRule()]


PartOrTime = Annotated[Quantity | Between, PartOrTimeRule()]


LowCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, ("peak", "rms"), "peak")]


class TolerancesSection(Section):
    """Tolerances of the drive data: one value for both directions, or {from: -10 %, to:
    30 %}.
    """

    r_s: DeviationKey | None = Field(
        default=None, description="phase resistance (write 30 %); default 0"
    )
    l_d: DeviationKey | None = Field(
        default=None, description="d-axis inductance (write 20 %); default 0"
    )
    l_q: DeviationKey | None = Field(
        default=None, description="q-axis inductance (write 20 %); default 0"
    )
    psi_pm: DeviationKey | None = Field(
        default=None, description="magnet flux linkage (write 5 %); default 0"
    )
    inertia: DeviationKey | None = Field(
        default=None, description="moment of inertia (write 20 %); default 0"
    )
    v_dc: DeviationKey | None = Field(
        default=None,
        description="dc-link voltage against the one that duty cycles are computed with; default 0",
    )
    dead_time: PartOrTime | None = Field(
        default=None,
        description=(
            "error of the dead-time compensation: share of inverter.dead_time (20 %), or a time;"
            " {from: 0 %, to: 100 %} reaches from a perfect compensation to none"
        ),
    )
    low_current: LowCurrent | None = Field(
        default=None,
        description=(
            "smallest phase current at which the loops must hold despite it; default 10 %"
        ),
    )
    thorough: bool = Field(
        default=Tolerances().thorough,
        description="prove the speed loop with fifty times the effort, up to some minutes",
    )


_SECTION = ("control", "tolerances")


_LOW_CURRENT = 0.1  # of the current limit


def read_tolerances(
    section: TolerancesSection | None,
    has_speed_loop: bool,
    machine: Machine,
    inverter: Inverter,
    i_max: float,
    reading: Reading,
) -> Tolerances | None:
    """Tolerances in SI units, None where the file has no such section.

    ``i_max`` is the current limit in A (peak), a tenth of which is the smallest
    current unless the file says.

    Raises:
        InputError: A tolerance has nothing that it could change, or is larger than what it belongs
            to.
    """
    document = reading.document
    if section is None:
        return None
    for key, missing, why in (
        ("psi_pm", machine.psi_pm == 0.0, "the machine has no magnets"),
        (
            "inertia",
            not has_speed_loop,
            "it changes the speed loop alone, and there is none",
        ),
    ):
        if getattr(section, key) is not None and missing:
            raise document.error(
                f"control.tolerances.{key}: {why}; remove the key", (*_SECTION, key), key=True
            )
    dead_time: Deviation = 0.0
    if section.dead_time is not None:
        share = section.dead_time.unit == ""
        if share and inverter.dead_time == 0.0:
            message = (
                "control.tolerances.dead_time is a share of inverter.dead_time, which is 0; write "
                "inverter.dead_time"
            )
            raise document.error(message, (*_SECTION, "dead_time"))
        dead_time = _scaled(section.dead_time, inverter.dead_time if share else 1.0)
    elif section.low_current is not None:
        message = (
            "control.tolerances.low_current goes with dead_time; write dead_time: 20 %, or remove "
            "the key"
        )
        raise document.error(message, (*_SECTION, "low_current"), key=True)
    low_current = 0.0
    if section.low_current is not None:
        low_current = reading.peak(section.low_current, "control.tolerances.low_current")
        if low_current > i_max:
            message = (
                "control.tolerances.low_current is above the current limit "
                f"{format_quantity(i_max, 'A')} peak"
            )
            raise document.error(f"{message}; write less", (*_SECTION, "low_current"))
    elif dead_time not in (0.0, (0.0, 0.0)):
        low_current = _LOW_CURRENT * i_max
        shown = format_quantity(low_current, "A")
        reading.remarks.append(
            f"control.tolerances.low_current is {shown} peak: 10 % of the current limit"
        )
    return Tolerances(
        r_s=_scaled(section.r_s),
        l_d=_scaled(section.l_d),
        l_q=_scaled(section.l_q),
        psi_pm=_scaled(section.psi_pm),
        inertia=_scaled(section.inertia),
        v_dc=_scaled(section.v_dc),
        dead_time=dead_time,
        low_current=low_current,
        thorough=section.thorough,
    )


def _scaled(entry: Quantity | Between | None, scale: float = 1.0) -> Deviation:
    """Deviation in SI units; 0 where the file has none."""
    if entry is None:
        return 0.0
    return (
        (entry.low.si * scale, entry.high.si * scale)
        if isinstance(entry, Between)
        else entry.si * scale
    )
