"""The schema of the design file: complete, documented, and in step with the settings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest

from dqforge.machines.design.schema import SCHEMA_ID, DesignFile, json_schema
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    ExportSettings,
    FitBudget,
    FitSettings,
    PerUnitBases,
    SpeedLoopSettings,
    StartUpSettings,
    Tolerances,
)
from dqforge.machines.devices.inverter import SwitchDevice
from dqforge.machines.entries.kinds import Section
from dqforge.machines.entries.rules import (
    KEYWORDS,
    CountRule,
    EntryError,
    QuantityRule,
    check_prefix,
    plain_text,
)
from dqforge.machines.units.registry import words_pattern


def _properties(schema: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    for name, section in {"": schema, **schema["$defs"]}.items():
        forms = section.get("anyOf", [section])  # a word, or a mapping
        mappings = [form["properties"] for form in forms if "properties" in form]
        assert mappings, f"{name} has no keys"
        for key, value in [entry for mapping in mappings for entry in mapping.items()]:
            yield f"{path}{name}.{key}", value


def test_every_key_is_described() -> None:
    for name, value in _properties(json_schema()):
        described = value.get("description") or "$ref" in value
        assert described, f"{name} has no description"


def test_json_schema_is_plain_json_without_null_and_named_once() -> None:
    schema = json_schema()
    text = json.dumps(schema)
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    assert schema["title"] == "dqforge design file"
    assert schema["required"] == ["dqforge", "name", "machine", "inverter"]
    assert schema["additionalProperties"] is False
    assert "null" not in text
    assert schema["$id"] == SCHEMA_ID
    assert text.count('"$id"') == 1
    assert json_schema() == schema


def test_json_schema_shows_choices_and_defaults() -> None:
    definitions = json_schema()["$defs"]
    assert definitions["FitSection"]["properties"]["degree"] == {
        "default": 4,
        "description": "degree of the polynomials",
        "maximum": 6,
        "minimum": 1,
        "type": "integer",
    }
    resistance = definitions["MachineSection"]["properties"]["resistance"]["anyOf"]
    assert [choice["type"] for choice in resistance] == ["number", "string", "object"]
    kind = resistance[2]["properties"]["kind"]
    # Other words for the same are read as well (terminal, phase-to-phase).
    words = {"type": "string", "pattern": words_pattern()}
    assert kind["anyOf"] == [{"enum": ["phase", "line-to-line"]}, words]
    assert kind["default"] == "phase"
    # A bare number has no kind, a text may name it: 12 Vrms/krpm line-to-line.
    constant = definitions["MachineSection"]["properties"]["back_emf_constant"]
    assert [choice["type"] for choice in constant["anyOf"]] == ["string", "object"]
    assert "12 V/krpm line-to-line rms" in constant["examples"]


# Settings that have no key of their own: ``counts_observer`` follows from an open spread.
BESIDE = {"budget", "full_scale", "counts_observer"}

# Keys of the file that differ from the names of the settings.
OTHERWISE = {"torque_max": "max_torque"}


@pytest.mark.parametrize(
    ("section", "settings"),
    [
        ("FitSection", FitSettings),
        ("CurrentLoopSection", CurrentLoopSettings),
        ("SpeedLoopSection", SpeedLoopSettings),
        ("ExportSection", ExportSettings),
        ("PerUnitSection", PerUnitBases),
        ("TolerancesSection", Tolerances),
        ("StartUpWithObserverSection", StartUpSettings),
        ("DeviceSection", SwitchDevice),
    ],
)
def test_each_setting_has_its_key(section: str, settings: type) -> None:
    properties = json_schema()["$defs"][section]["properties"]
    keys = {name for name, entry in properties.items() if not entry.get("deprecated")}
    # A budget's keys stand beside the others of the fit in the file,
    # and in a class of their own in the settings.
    budget = {field.name for field in fields(FitBudget)} if settings is FitSettings else set()
    named = {OTHERWISE.get(field.name, field.name) for field in fields(settings)}
    assert keys - budget == named - BESIDE
    assert budget <= keys


def test_models_are_frozen_and_strict() -> None:
    sections: list[type[Section]] = [DesignFile, *Section.__subclasses__()]
    for model in sections:
        assert model.model_config["frozen"] is True
        assert model.model_config["extra"] == "forbid"
        assert model.model_config["strict"] is True


def test_entry_as_number_text_and_mapping() -> None:
    rule = QuantityRule("inductance", 1e-9, 10.0, ("phase", "line-to-line"), "phase")
    assert (
        rule.read(0.00161).si
        == rule.read("1.61 mH").si
        == rule.read({"value": "1.61 mH"}).si
        == 0.00161
    )
    entry = rule.read(
        {
            "value": "3.22 mH",
            "kind": "line-to-line",
            "source": "p. 3",
            "inferred": True,
            "note": "n",
        }
    )
    assert (entry.kind, entry.kind_given, entry.source, entry.inferred, entry.note) == (
        "line-to-line",
        True,
        "p. 3",
        True,
        "n",
    )
    assert rule.read("1 mH").kind == "phase"
    assert not rule.read("1 mH").kind_given


def test_plausible_limits_are_inclusive() -> None:
    rule = QuantityRule("inductance", 1e-9, 10.0)
    assert rule.read("10 H").si == 10.0
    assert rule.read("1 nH").si == 1e-9
    with pytest.raises(EntryError, match="outside 1 nH to 10 H"):
        rule.read("11 H")
    assert QuantityRule("flux", 1e-6, 20.0, zero=True).read(0).si == 0.0


def test_advice_falls_back_to_the_example() -> None:
    with pytest.raises(EntryError, match=r"write e\.g\. '1\.61 mH'"):
        QuantityRule("inductance", 1e-9, 10.0).read("1e9")


def test_counts_are_whole_numbers() -> None:
    rule = CountRule(1, 200, 4)
    assert rule.read({"value": 4, "source": "s"}).source == "s"
    for raw in (True, 4.0, "4", [4], {"value": 4, "kind": "x"}, {}, 0, 201):
        with pytest.raises(EntryError):
            rule.read(raw)


def test_plain_text_folds_lines() -> None:
    assert plain_text("one\n  two\tthree\n", limit=20) == "one two three"
    assert (
        plain_text("see https://example.org", limit=50, slashes=True) == "see https://example.org"
    )
    for text in ("a\\\n", "a??/b", "a/*b", "*/", "//", "a\u202eb", "x" * 51):
        with pytest.raises(EntryError):
            plain_text(text, limit=50)


@pytest.mark.parametrize("prefix", ["m", "ipm100", "IPM_100", "a" * 31, "int1"])
def test_prefixes_that_are_identifiers(prefix: str) -> None:
    assert check_prefix(prefix) == prefix


@pytest.mark.parametrize(
    "prefix",
    [
        "",
        " ",
        "1a",
        "a b",
        "a-b",
        "_a",
        "a_",
        "a__b",
        "é",
        "a\n",
        "a;",
        "a*/",
        "int",
        "class",
        "std",
        "x" * 32,
        "__",
    ],
)
def test_prefixes_that_are_not(prefix: str) -> None:
    with pytest.raises(EntryError) as caught:
        check_prefix(prefix)
    assert caught.value.message.isprintable()


def test_suggested_prefixes_are_accepted() -> None:
    for prefix in (
        "Motör",
        "my motor",
        "3phase",
        "_x_",
        "a__b",
        "___",
        "%",
        "-int-",
        "é" * 40,
        "a-" * 40,
    ):
        with pytest.raises(EntryError) as caught:
            check_prefix(prefix)
        hint = caught.value.message.rpartition("write e.g. ")[2]
        assert check_prefix(hint) == hint
    assert {"while", "co_await", "restrict"} <= KEYWORDS
