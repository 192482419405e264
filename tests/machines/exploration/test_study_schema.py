"""The schema of the study file: complete, described, plain JSON."""

from __future__ import annotations

import json

import yaml
from broken_studies import BASE

from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.study import STUDY_SCHEMA_ID, StudyFile, study_json_schema


def test_every_key_is_described() -> None:
    schema = study_json_schema()
    for section in (schema, *schema["$defs"].values()):
        for name, value in section["properties"].items():
            assert value.get("description") or "$ref" in value, name
    assert list(schema["properties"]) == list(StudyFile.model_fields)
    assert schema["required"] == ["dqforge_study", "name", "design"]
    assert schema["additionalProperties"] is False
    assert schema["$id"] == STUDY_SCHEMA_ID
    assert "null" not in json.dumps(schema)


def test_the_keys_of_the_shipped_studies_are_in_it() -> None:
    schema = study_json_schema()
    texts = [BASE, *(catalogue.read_text(name).decode() for name in catalogue.names())]
    for text in texts:
        assert set(yaml.safe_load(text)) <= set(schema["properties"])
