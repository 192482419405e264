"""Emitted texts are what they were when they were last accepted (`kept_output`)."""

from __future__ import annotations

import re

import house
import kept_drives
import kept_output
import pytest

TEXT = """/* A table. */
static const float table[2] = { 0.5F, 1.23456F };

static inline float half(float x)
{
    return 0.5F * x + 1.23456F;
}
"""


@pytest.mark.parametrize("case", kept_drives.CASES)
def test_text_is_as_it_was_kept(case: str) -> None:
    kept = kept_output.kept_of(case)
    with kept_drives.rendered() as names:
        texts = kept_output.texts_of(kept_drives.CASES[case]())
    found = [f"{case}: {line}" for line in kept_output.differences(texts, kept["texts"])]
    assert not found, "\n".join([*found, "where it is meant: python tests/kept_output.py --update"])
    assert {name for name in kept["made by"] if name.endswith(".j2")} == names.keys()


@pytest.mark.parametrize("template", kept_drives.templates())
def test_template_is_rendered_for_a_kept_text(template: str) -> None:
    assert kept_output.making(template), f"no case of kept_drives renders {template}"


def test_each_file_is_of_a_case_and_all_are_small() -> None:
    files = list(kept_output.KEPT.iterdir())
    assert {path.stem for path in files} == kept_drives.CASES.keys()
    assert sum(path.stat().st_size for path in files) < 250_000


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("* x +", "* x -", "half: statement 2 is now: return #F * x - #F;"),
        ("return 0.5F", "return 0.625F", "half: 0.5 is now 0.625"),
        ("+ 1.23456F", "+ 1.236F", "half: 1.23456 is now 1.236"),
        ("{ 0.5F,", "{ 0.50001F,", "table: 0.5 is now 0.50001"),
        ("    return 0.5F * x + 1.23456F;\n", "", "half: statement 2 is now: }"),
        ("A table", "No table", "comments: statement 1 is now: /* No table. */"),
    ],
)
def test_what_changes_is_named(was: str, now: str, said: str) -> None:
    kept = kept_output.kept_form({"a.h": TEXT})
    assert not list(kept_output.differences({"a.h": TEXT}, kept))
    (line,) = kept_output.differences({"a.h": TEXT.replace(was, now)}, kept)
    assert line.startswith(f"a.h: {said}")


def test_noise_of_a_solver_and_other_breaks_of_lines_are_no_change() -> None:
    kept = kept_output.kept_form({"a.h": TEXT})
    other = re.sub(r"1\.23456F", "1.23462F", TEXT).replace("{ 0.5F, ", "{\n    0.50000001F,\n    ")
    assert not list(kept_output.differences({"a.h": other}, kept))


def test_what_is_said_to_be_made_by_is_there() -> None:
    for case in kept_drives.CASES:
        missing = [
            name
            for name in kept_output.kept_of(case)["made by"]
            if not (house.ROOT / name).is_file()
        ]
        assert not missing, case
