"""What `dqforge schema` answers, and which files `dqforge new` makes."""

from __future__ import annotations

import json
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.exploration.study import study_json_schema
from dqforge.machines.files.library_files import DESIGN_SCHEMA, schema_bytes
from dqforge.reports.answers.library import NewRequest, answer_new, answer_schema


def test_the_command_prints_it() -> None:
    answer = answer_schema(study=True)
    assert answer.plain == {"schema": study_json_schema()}
    assert json.loads(answer.notes[0]) == study_json_schema()
    assert answer_schema().plain != answer.plain


def test_a_schema_goes_into_a_file_and_the_modeline_is_said() -> None:
    answer = answer_schema(out=Path("there") / "mine.json")
    assert answer.files is not None
    assert answer.files.contents == {"mine.json": schema_bytes(DESIGN_SCHEMA)}
    assert "# yaml-language-server: $schema=mine.json" in answer.notes[0]


def test_a_new_design_brings_the_schema_that_it_names(tmp_path: Path) -> None:
    for machine in (None, "paper001-pmsm-bench"):
        answer = answer_new(tmp_path, NewRequest(machine))
        assert answer.files is not None
        design, schema = answer.files.contents.values()
        assert list(answer.files.contents) == ["design.yaml", "design.schema.json"]
        first, _, rest = design.partition(b"\n")
        assert first == b"# yaml-language-server: $schema=design.schema.json"
        assert rest == catalogue.template(machine)
        assert schema == schema_bytes(DESIGN_SCHEMA)
