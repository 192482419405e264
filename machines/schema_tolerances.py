"""Section on tolerances of a design file: how far the drive may be from its data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field

from dqforge.machines.entries import EntryError, Quantity, QuantityRule, Rule, spoken
from dqforge.machines.schema_entries import Section

_SHARE = QuantityRule("number", 0.0, 0.9)
_PART = QuantityRule("number", 0.0, 1.0)
_TIME = QuantityRule("time", 0.0, 1e-5)


@dataclass(frozen=True, slots=True)
class PartOrTimeRule(Rule):
    """A share in per cent, or a time with its unit; `Quantity.unit` tells which."""

    def read(self, raw: object) -> Quantity:
        """Entry for a value from the file; raises `EntryError` when it is neither a share in % nor a time."""
        value = raw.get("value") if isinstance(raw, dict) else raw
        if isinstance(value, str):
            return (_PART if value.strip().endswith("%") else _TIME).read(raw)
        raise EntryError(f"expected a share such as '20 %' or a time such as '0.2 us', got {spoken(value)}", "value")

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of an entry: text or mapping."""
        schema = _TIME.json_schema()
        texts = [choice for choice in schema["anyOf"] if choice["type"] != "number"]
        return {"anyOf": texts, "examples": ["20 %", "0.2 us"]}


Deviation = Annotated[Quantity, _SHARE]
PartOrTime = Annotated[Quantity, PartOrTimeRule()]
LowCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, ("peak", "rms"), "peak")]


class TolerancesSection(Section):
    """How far the drive may be from its data, both ways."""

    r_s: Deviation | None = Field(default=None, description="phase resistance (write 30 %); default 0")
    l_d: Deviation | None = Field(default=None, description="d-axis inductance (write 20 %); default 0")
    l_q: Deviation | None = Field(default=None, description="q-axis inductance (write 20 %); default 0")
    psi_pm: Deviation | None = Field(default=None, description="magnet flux linkage (write 5 %); default 0")
    inertia: Deviation | None = Field(default=None, description="moment of inertia (write 20 %); default 0")
    v_dc: Deviation | None = Field(
        default=None, description="dc-link voltage against the one that duty cycles are computed with; default 0"
    )
    dead_time: PartOrTime | None = Field(
        default=None, description="error of the dead-time compensation: share of inverter.dead_time (20 %), or a time"
    )
    low_current: LowCurrent | None = Field(
        default=None, description="smallest phase current at which the loops must hold in spite of it; default 10 %"
    )
