"""Files that ship with the package: the schemas are those of the models."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest
import yaml

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.schema import json_schema
from dqforge.machines.errors import InputError
from dqforge.machines.exploration import study_checks as studies
from dqforge.machines.exploration.study import study_json_schema
from dqforge.machines.files.library_files import (
    DESIGN_SCHEMA,
    STUDY_SCHEMA,
    schema_bytes,
    with_modeline,
)


@pytest.mark.parametrize(
    ("name", "schema"),
    [(DESIGN_SCHEMA, json_schema), (STUDY_SCHEMA, study_json_schema)],
    ids=["design", "study"],
)
def test_the_schemas_of_the_package_are_those_of_the_models(
    name: str, schema: Callable[[], dict[str, Any]]
) -> None:
    assert schema_bytes(name) == f"{json.dumps(schema(), indent=1)}\n".encode(), "run: make schemas"


def test_what_ships_keeps_the_schemas() -> None:
    import jsonschema

    designs = [
        catalogue.template(),
        *map(catalogue.read_text, [*catalogue.names(), *catalogue.motors()]),
    ]
    others = map(studies.read_text, studies.names())
    for name, texts in ((DESIGN_SCHEMA, designs), (STUDY_SCHEMA, others)):
        validator = jsonschema.Draft202012Validator(json.loads(schema_bytes(name)))
        for text in texts:
            assert [error.message for error in validator.iter_errors(yaml.safe_load(text))] == []


def test_the_schema_refuses_a_wrong_key_and_a_wrong_word() -> None:
    import jsonschema

    validator = jsonschema.Draft202012Validator(json.loads(schema_bytes(DESIGN_SCHEMA)))
    for old, new, words in (
        ("  resistance:", "  resistence:", "'resistence' was unexpected"),
        ("strategy: mtpa", "strategy: mpta", "'mpta'"),
    ):
        text = catalogue.template().decode().replace(old, new)
        (error, *_) = validator.iter_errors(yaml.safe_load(text))
        messages = [error.message, *(inner.message for inner in error.context or ())]
        assert any(words in message for message in messages)


def test_the_modeline_stands_first_and_is_a_comment() -> None:
    text = catalogue.template()
    told = with_modeline(text, DESIGN_SCHEMA)
    line, _, rest = told.partition(b"\n")
    assert line == b"# yaml-language-server: $schema=design.schema.json"
    assert rest == text
    assert yaml.safe_load(told) == yaml.safe_load(text)


@pytest.mark.parametrize(
    "name", ["paper000", "abb", "thor-pmsyrm", "vdyno-trampa-6430", "hoverboard", "teknic-m2310"]
)
def test_a_name_that_is_nearly_one_of_the_library_is_answered_with_it(name: str) -> None:
    with pytest.raises(InputError, match=rf"no such file; did you mean {name[:4]}"):
        load_design(name)
