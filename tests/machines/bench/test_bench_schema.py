"""The schema of the bench file: complete, described, and in step with what is read."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from bench_files import bench_text

from dqforge.machines.bench.bench_file import BENCH_SCHEMA_ID, BenchFile, bench_json_schema
from dqforge.machines.bench.log_columns import KINDS

METHOD = Path(__file__).parents[3] / "docs" / "methods" / "identification.md"


def test_every_key_is_described() -> None:
    schema = bench_json_schema()
    for section in (schema, *schema["$defs"].values()):
        for name, value in section["properties"].items():
            assert value.get("description") or "$ref" in value, name
    assert list(schema["properties"]) == list(BenchFile.model_fields)
    assert schema["required"] == ["dqforge_bench", "name", "machine", "runs"]
    assert schema["additionalProperties"] is False
    assert schema["$id"] == BENCH_SCHEMA_ID
    assert "null" not in json.dumps(schema)


def test_the_documented_file_is_within_it() -> None:
    import jsonschema

    text = METHOD.read_text().split("## The bench file\n")[1]
    lines = [line[4:] for line in text.splitlines()[1:]]
    written = yaml.safe_load("\n".join(lines[: lines.index("", 1)]))
    jsonschema.validate(written, bench_json_schema())
    kinds = bench_json_schema()["$defs"]["RunSection"]["properties"]["kind"]["enum"]
    assert kinds == list(KINDS)


@pytest.mark.parametrize(
    ("run", "word"),
    [
        ("- {name: a, kind: constant-speeds, file: a.csv}", "constant-speeds"),
        ("- {name: a, kind: spin-down, fil: a.csv}", "fil"),
        ("- {name: a, kind: spin-down, columns: {time: {colum: t}}}", "colum"),
    ],
)
def test_a_slip_is_seen(run: str, word: str) -> None:
    import jsonschema

    with pytest.raises(jsonschema.ValidationError, match=word):
        jsonschema.validate(yaml.safe_load(bench_text(run)), bench_json_schema())
