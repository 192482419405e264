"""What single entries of a design file may be: quantities with plausible ranges, names, counts."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    WithJsonSchema,
    WrapValidator,
)

from dqforge.machines.entries.rules import (
    CountRule,
    EntryError,
    Quantity,
    QuantityRule,
    Rule,
    any_word_of,
    auto_or,
    byte_count,
    check_prefix,
    firmware_names,
    in_other_words,
    not_truth,
    number_formats,
    plain_text,
    spoken,
    unknown_key,
)
from dqforge.machines.errors import KeyPath, shown
from dqforge.machines.names import Firmware, NumberFormat, QFormats
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import DIMENSIONS

_PHASE = ("phase", "line-to-line")


_PEAK = ("peak", "rms")


_PHASE_OR_LINE = ("phase peak", "phase rms", "line-to-line peak", "line-to-line rms")


_LINE_OR_WINDING = (*_PEAK, "line peak", "line rms", "winding peak", "winding rms")


_T = TypeVar("_T")


Listing = Annotated[tuple[_T, ...], Field(strict=False)]  # YAML has lists, the models hold tuples


Version = Annotated[Literal[1], BeforeValidator(not_truth)]


Name = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=80))]


About = Annotated[str, AfterValidator(partial(plain_text, limit=2000))]


Prefix = Annotated[str, AfterValidator(check_prefix)]


FileName = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=200))]


ColumnName = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=80))]


def _text_too(schema: dict[str, Any]) -> None:
    """Let a whole number be written with a unit."""
    schema |= {"type": [schema["type"], "string"], "examples": ["2 KiB"]}


ByteCount = Annotated[int, BeforeValidator(byte_count), Field(json_schema_extra=_text_too)]


Bits = Annotated[int, Field(ge=0, le=31)]


if TYPE_CHECKING:
    GainFormats = QFormats
else:  # not a union, whose complaints would name the alternatives inside the path
    GainFormats = Annotated[
        tuple[Bits, Bits],
        Field(strict=False),
        WrapValidator(auto_or),
        WithJsonSchema(
            {
                "anyOf": [
                    {"const": "auto"},
                    {
                        "type": "array",
                        "minItems": 2,
                        "maxItems": 2,
                        "items": {"type": "integer", "minimum": 0},
                    },
                ]
            }
        ),
    ]


def _one_or_list(names: tuple[str, ...]) -> WithJsonSchema:
    """Schema of a name, or a list of some."""
    name = {"enum": list(names)}
    return WithJsonSchema({"anyOf": [name, {"type": "array", "items": name}]})


ControlFormats = Annotated[
    tuple[NumberFormat, ...],
    Field(strict=False, max_length=3),
    BeforeValidator(number_formats),
    _one_or_list(get_args(NumberFormat)),
]


FirmwareNames = Annotated[
    tuple[Firmware, ...],
    Field(strict=False, max_length=8),
    BeforeValidator(firmware_names),
    _one_or_list(get_args(Firmware)),
]


Resistance = Annotated[Quantity, QuantityRule("resistance", 1e-6, 1e3, _PHASE, "phase")]


Inductance = Annotated[Quantity, QuantityRule("inductance", 1e-9, 10.0, _PHASE, "phase")]


_CHANNELS = ("phase", "line-to-line")
ChannelPlace = Annotated[
    Literal["phase", "line-to-line"],
    BeforeValidator(partial(in_other_words, names=_CHANNELS, words=DIMENSIONS["back-emf"].places)),
    WithJsonSchema(any_word_of(_CHANNELS)),
]


Flux = Annotated[
    Quantity,
    QuantityRule("flux", 1e-6, 20.0, ("peak", "rms", "power-invariant"), "peak", zero=True),
]


BackEmfConstant = Annotated[
    Quantity, QuantityRule("back-emf", 1e-6, 1e3, _PHASE_OR_LINE, zero=True)
]


SpeedConstant = Annotated[
    Quantity, QuantityRule("speed-constant", 1e-3, 1e6, _PHASE_OR_LINE, "line-to-line peak")
]


TorqueConstant = Annotated[
    Quantity, QuantityRule("torque-constant", 1e-6, 1e4, _LINE_OR_WINDING, zero=True)
]


PhaseCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, _PEAK, "peak")]


MachineCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, _LINE_OR_WINDING, "peak")]


Current = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5)]


Voltage = Annotated[Quantity, QuantityRule("voltage", 1.0, 2e4)]


Drop = Annotated[Quantity, QuantityRule("voltage", 0.0, 10.0)]


Speed = Annotated[Quantity, QuantityRule("speed", 0.1, 1e5)]


PointSpeed = Annotated[Quantity, QuantityRule("speed", -1e5, 1e5)]


Torque = Annotated[Quantity, QuantityRule("torque", 1e-6, 1e7)]


PointTorque = Annotated[Quantity, QuantityRule("torque", -1e7, 1e7)]


Power = Annotated[Quantity, QuantityRule("power", 1e-2, 1e8)]


Frequency = Annotated[Quantity, QuantityRule("frequency", 0.1, 1e5)]


Rate = Annotated[Quantity, QuantityRule("frequency", 100.0, 1e7)]


DeadTime = Annotated[Quantity, QuantityRule("time", 0.0, 1e-4)]


SampleInterval = Annotated[Quantity, QuantityRule("time", 1e-10, 1.0)]


FilterTime = Annotated[Quantity, QuantityRule("time", 0.0, 10.0)]


Inertia = Annotated[Quantity, QuantityRule("inertia", 1e-10, 1e5)]


Friction = Annotated[Quantity, QuantityRule("friction", 0.0, 1e4)]


Temperature = Annotated[Quantity, QuantityRule("temperature", -60.0, 200.0)]


Coefficient = Annotated[Quantity, QuantityRule("temperature-coefficient", -0.02, 0.05)]


OnResistance = Annotated[Quantity, QuantityRule("resistance", 1e-6, 100.0, zero=True)]


Energy = Annotated[Quantity, QuantityRule("energy", 1e-10, 100.0, zero=True)]


ThermalResistance = Annotated[Quantity, QuantityRule("thermal-resistance", 1e-4, 1e3)]


Bandwidth = Annotated[Quantity, QuantityRule("bandwidth", 0.01, 1e7)]


PhaseMargin = Annotated[Quantity, QuantityRule("angle", 0.0, 1.5707963267948966)]


TorqueSlope = Annotated[Quantity, QuantityRule("torque-slope", 1e-6, 1e9)]


CurrentGain = Annotated[Quantity, QuantityRule("current-gain", 1e-9, 1e9)]


CurrentIntegralGain = Annotated[Quantity, QuantityRule("current-integral-gain", 0.0, 1e12)]


SpeedGain = Annotated[Quantity, QuantityRule("speed-gain", 1e-12, 1e9)]


SpeedIntegralGain = Annotated[Quantity, QuantityRule("speed-integral-gain", 0.0, 1e12)]


Ratio = Annotated[Quantity, QuantityRule("number", 1.0, 100.0)]


LossExponent = Annotated[Quantity, QuantityRule("number", 1.0, 2.0)]


MapFactor = Annotated[Quantity, QuantityRule("number", 0.2, 5.0)]


ResistanceRatio = Annotated[Quantity, QuantityRule("number", 0.0, 1e4)]


HarmonicShare = Annotated[Quantity, QuantityRule("number", 0.0, 10.0)]


SmallShare = Annotated[Quantity, QuantityRule("number", 1e-6, 0.2)]


MutualInductance = Annotated[Quantity, QuantityRule("inductance", -10.0, 10.0)]


ChokeInductance = Annotated[Quantity, QuantityRule("inductance", 1e-9, 10.0)]


Capacitance = Annotated[Quantity, QuantityRule("capacitance", 1e-8, 10.0)]


Angle = Annotated[Quantity, QuantityRule("angle", -6.2831853071795865, 6.2831853071795865)]


SlewRate = Annotated[Quantity, QuantityRule("current-slew", 1.0, 1e12)]


Uncertainty = Annotated[Quantity, QuantityRule("number", 1e-6, 0.9)]


Share = Annotated[Quantity, QuantityRule("number", 0.0, 0.9)]

PointWeight = Annotated[Quantity, QuantityRule("number", 1e-6, 1e6)]


SixStepShare = Annotated[Quantity, QuantityRule("number", 0.907, 1.0)]


Nonnegative = Annotated[float, Field(ge=0.0, le=1e9, strict=False), BeforeValidator(not_truth)]


Positive = Annotated[float, Field(gt=0.0, le=1e9, strict=False), BeforeValidator(not_truth)]


PolePairs = Annotated[Quantity, CountRule(1, 200, 4)]


Poles = Annotated[Quantity, CountRule(2, 400, 8)]


class Section(BaseModel):
    """A part of the design file: immutable, without unknown keys and without silent conversions."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        arbitrary_types_allowed=True,
        defer_build=True,
    )


def quantities(section: Section, path: KeyPath = ()) -> Iterator[tuple[KeyPath, Quantity]]:
    """All entries of a section with their paths, in the order of the schema."""
    for name in type(section).model_fields:
        value = getattr(section, name)
        parts = enumerate(value) if isinstance(value, tuple) else [(None, value)]
        for index, part in parts:
            inner = (*path, name) if index is None else (*path, name, index)
            if isinstance(part, Quantity):
                yield inner, part
            elif isinstance(part, Between):
                yield from (((*inner, "from"), part.low), ((*inner, "to"), part.high))
            elif isinstance(part, Section):
                yield from quantities(part, inner)


# Deviations of a design file: one value for both ways, or ``{from: ..., to: ...}``.

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


# Two ends in one text, -10..10 % or -5 % / +10 %, and one for both ways, +-10 %.
_ENDS = re.compile(
    r"(?P<low>[-+]?[0-9.]*[0-9])\s*(?P<own>%|[a-zµμ]*s)?\s*(?:\.{2,3}|…|/|to|bis)\s*"
    r"(?P<high>[-+]?[0-9][0-9.]*)\s*(?P<unit>%|[a-zµμ]*s)?"
)
_BOTH_WAYS = re.compile(r"(?:±|\+/-|\+-)\s*(?P<size>[0-9].*)")
_OTHER_ENDS = (("min", "max"), ("low", "high"), ("lower", "upper"), ("minus", "plus"), ("-", "+"))


def _refuse_other_forms(raw: object) -> None:
    """Refuse a deviation in another form with the one that is read; raises `EntryError`."""
    if isinstance(raw, dict):
        for low, high in _OTHER_ENDS:
            if low in raw or high in raw:
                ends = f"{{from: {raw.get(low, '-10 %')}, to: {raw.get(high, '10 %')}}}"
                key = low if low in raw else high
                raise EntryError(f"the ends are 'from' and 'to'; write {ends}", key, at_key=True)
    text = str(raw).strip().translate(_MINUS) if isinstance(raw, str) else ""
    if both := _BOTH_WAYS.fullmatch(text):
        raise EntryError(f"{shown(text)} holds both ways; write '{both['size']}'", "value")
    if sides := _ENDS.fullmatch(text):
        unit = sides["unit"] or sides["own"] or "%"
        low, high = sides["low"], sides["high"].lstrip("+")
        raise EntryError(
            f"{shown(text)} has two ends; write {{from: {low} {unit}, to: {high} {unit}}}", "value"
        )


_MINUS = str.maketrans(dict.fromkeys("\N{MINUS SIGN}\N{EN DASH}", "-"))


@dataclass(frozen=True, slots=True)
class TwoSidedRule(Rule):
    """How a deviation is read; what one side may be is left to the kinds of deviations."""

    def read(self, raw: object) -> Any:
        """One `Quantity` for both ways, or a `Between`; raises `EntryError` when it is neither."""
        if isinstance(raw, dict) and ("from" in raw or "to" in raw):
            return self._between(raw)
        _refuse_other_forms(raw)
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
        if low.si > high.si:
            raise EntryError(
                f"from, {low.text}, lies above to, {high.text}; exchange them: "
                f"{{from: {high.text}, to: {low.text}}}",
                "from",
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
