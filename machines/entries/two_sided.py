"""Deviations of a design file: one value for both ways, or ``{from: ..., to: ...}``."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from dqforge.machines.entries.rules import (
    EntryError,
    Quantity,
    QuantityRule,
    Rule,
    spoken,
    unknown_key,
)
from dqforge.machines.records import dataclass

_SHARE = QuantityRule("number", 0.0, 0.9)


_SIDE = QuantityRule("number", -0.9, 4.0)


_PART = QuantityRule("number", 0.0, 1.0)


_SIDE_PART = QuantityRule("number", -1.0, 1.0)


_TIME = QuantityRule("time", 0.0, 1e-5)


_SIDE_TIME = QuantityRule("time", -1e-5, 1e-5)


_ORIGIN_KEYS = ("source", "inferred", "note")


@dataclass(frozen=True, slots=True)
class Between:
    """A deviation whose two sides differ: from ``low``, zero or negative, to ``high``,
    zero or positive.
    """

    low: Quantity
    high: Quantity

    @property
    def unit(self) -> str:
        """Unit of both sides."""
        return self.high.unit


@dataclass(frozen=True, slots=True)
class TwoSidedRule(Rule):
    """How a deviation is read; what one side may be is left to the kinds of deviations."""

    def read(self, raw: object) -> Any:
        """One `Quantity` for both ways, or a `Between`; raises `EntryError` when it is neither."""
        if isinstance(raw, dict) and ("from" in raw or "to" in raw):
            return self._between(raw)
        return self.both_ways(raw)

    def _between(self, raw: dict[str, object]) -> Between:
        for key in raw:
            if key not in ("from", "to", *_ORIGIN_KEYS):
                raise EntryError(unknown_key(key, ("from", "to", *_ORIGIN_KEYS)), key, at_key=True)
        for key, other in (("from", "to"), ("to", "from")):
            if key not in raw:
                raise EntryError(
                    f"the key '{key}' is missing beside '{other}'; write {{from: -10 %, to: 30 %}}"
                )
        origin = {key: raw[key] for key in _ORIGIN_KEYS if key in raw}
        low, high = (self._side(raw, key, origin) for key in ("from", "to"))
        if low.unit != high.unit:
            raise EntryError(
                "one side is a share and the other a time; write both in % or both in us", "to"
            )
        if low.si > 0.0:
            raise EntryError(
                f"{low.text} leaves the data themselves out; write a value of 0 or below", "from"
            )
        if high.si < 0.0:
            raise EntryError(
                f"{high.text} leaves the data themselves out; write a value of 0 or above", "to"
            )
        return Between(low, high)

    def _side(self, raw: dict[str, object], key: str, origin: dict[str, object]) -> Quantity:
        try:
            return self.one_way(
                {"value": raw[key]} | origin, {"from": raw["to"], "to": raw["from"]}[key]
            )
        except EntryError as error:
            raise EntryError(error.message, key if error.key == "value" else error.key) from None

    @abstractmethod
    def both_ways(self, raw: object) -> Quantity:
        """Entry for a value that holds both ways."""

    @abstractmethod
    def one_way(self, entry: dict[str, object], other: object) -> Quantity:
        """Entry for one side, which may be negative.

        ``other`` is what the file has for the other side.
        """

    def json_schema(self) -> dict[str, Any]:
        """JSON Schema of an entry: one value, or both sides."""
        schema = self.one_schema()
        side = {"type": ["number", "string"]}
        texts = {
            "source": {"type": "string"},
            "inferred": {"type": "boolean"},
            "note": {"type": "string"},
        }
        sides = {
            "type": "object",
            "properties": {"from": side, "to": side} | texts,
            "required": ["from", "to"],
            "additionalProperties": False,
        }
        return schema | {"anyOf": [*schema["anyOf"], sides]}

    @abstractmethod
    def one_schema(self) -> dict[str, Any]:
        """JSON Schema of one value."""


@dataclass(frozen=True, slots=True)
class ShareRule(TwoSidedRule):
    """A relative deviation: at most 90 % both ways; one side from -90 % to 400 %."""

    def both_ways(self, raw: object) -> Quantity:
        """Entry for a share that holds both ways."""
        return _SHARE.read(raw)

    def one_way(self, entry: dict[str, object], other: object) -> Quantity:
        """Entry for one side."""
        del other
        return _SIDE.read(entry)

    def one_schema(self) -> dict[str, Any]:
        """JSON Schema of a share."""
        return _SHARE.json_schema()


@dataclass(frozen=True, slots=True)
class PartOrTimeRule(TwoSidedRule):
    """A share in per cent, or a time with its unit; `Quantity.unit` tells which."""

    def both_ways(self, raw: object) -> Quantity:
        """Entry for a share or a time that holds both ways."""
        value = raw.get("value") if isinstance(raw, dict) else raw
        if isinstance(value, str):
            return (_PART if value.strip().endswith("%") else _TIME).read(raw)
        raise EntryError(
            f"expected a share such as '20 %' or a time such as '0.2 us', got {spoken(value)}",
            "value",
        )

    def one_way(self, entry: dict[str, object], other: object) -> Quantity:
        """Entry for one side; a bare zero has the unit of the other side."""
        value = entry["value"]
        if (
            isinstance(value, (int, float))
            and not isinstance(value, bool)
            and value == 0
            and isinstance(other, str)
        ):
            value = "0 %" if other.strip().endswith("%") else "0 s"
        if not isinstance(value, str):
            raise EntryError(
                f"expected a share such as '100 %' or a time such as '0.2 us', got {spoken(value)}",
                "value",
            )
        return (_SIDE_PART if value.strip().endswith("%") else _SIDE_TIME).read(
            entry | {"value": value}
        )

    def one_schema(self) -> dict[str, Any]:
        """JSON Schema of a share or a time."""
        schema = _TIME.json_schema()
        texts = [choice for choice in schema["anyOf"] if choice["type"] != "number"]
        return {"anyOf": texts, "examples": ["20 %", "0.2 us"]}
