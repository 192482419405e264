"""Emitted texts, and what functions of physics return, are as they were when last accepted
(`kept_output`).
"""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import house
import kept_drives
import kept_output
import kept_values
import numpy as np
import pytest

SHOWN = 12
TEXT = """/* A table. */
static const float table[2] = { 0.5F, 1.23456F };

static inline float half(float x)
{
    return 0.5F * x + 1.23456F;
}
"""


@pytest.mark.parametrize("case", kept_output.cases())
def test_it_is_as_it_was_kept(case: str) -> None:
    found = kept_output.all_differences(case)
    how = f"where it is meant: python tests/kept_output.py --update {case}"
    assert not found, "\n".join([f"{case}: {len(found)} differences", *found[:SHOWN], how])


@pytest.mark.parametrize("template", kept_drives.templates())
def test_template_is_rendered_for_a_kept_text(template: str) -> None:
    assert kept_output.making(template), f"no case of kept_drives renders {template}"


def test_each_file_is_of_a_case_and_all_are_small() -> None:
    files = list(kept_output.KEPT.iterdir())
    assert {path.stem for path in files} == kept_output.cases().keys()
    assert sum(path.stat().st_size for path in files) < 800_000


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
    for case in kept_output.cases():
        missing = [
            name
            for name in kept_output.kept_of(case)["made by"]
            if not (house.ROOT / name).is_file()
        ]
        assert not missing, case


def record_of(words: str) -> kept_values.Record:
    """What is recorded of a function of physics with these words."""
    names: dict[str, Any] = {"np": np, "Fraction": Fraction}
    source = f"def found():\n    {words}\n\ndef run():\n    found()\n"
    exec(compile(source, f"{kept_values.ROOT}optimizer/curves/fitting.py", "exec"), names)
    record = kept_values.Record()
    record.of(names["run"])
    return record


def kept_of(record: kept_values.Record, **changed: float) -> dict[str, str]:
    others = {key: total + changed.get(key[1], 0.0) for key, total in record.sums.items()}
    return kept_values.kept_form(record.sums, others, [])


VALUE = "return {'a': (1.5e6, None, True), 'b': [np.array([1e-3, 2.0, -3e-9]), 2j, Fraction(1, 3)]}"


@pytest.mark.parametrize(
    ("was", "now"),
    [
        *[("1.5e6", "1.501e6"), ("None", "1e-11"), ("True", "False"), ("2j", "-2j")],
        *[("1e-3", "1.1e-3"), ("2.0, -3e-9", "-3e-9, 2.0"), ("-3e-9", "np.nan")],
        *[("-3e-9", "-3e-3"), ("Fraction(1, 3)", "Fraction(1, 4)"), ("'b': [", "'b': ['d', ")],
        *[("return", "yield"), ("(1.5e6, None,", "(None, 1.5e6,")],
    ],
)
def test_a_function_that_returns_something_else_is_named(was: str, now: str) -> None:
    kept = kept_of(record_of(VALUE))
    assert not list(kept_values.differences(record_of(VALUE), kept))
    (line,) = kept_values.differences(record_of(VALUE.replace(was, now)), kept)
    assert line.startswith("optimizer/curves/fitting.py: found finds something else: ")


@pytest.mark.parametrize(
    ("was", "now"), [("1.5e6", "1.5000001e6"), ("-3e-9", "-3.0001e-9"), ("'a'", "'what is meant'")]
)
def test_last_digits_and_words_are_no_change(was: str, now: str) -> None:
    kept = kept_of(record_of(VALUE))
    assert not list(kept_values.differences(record_of(VALUE.replace(was, now)), kept))


def test_what_other_kernels_give_differently_or_an_earlier_case_has_is_not_kept() -> None:
    record = record_of(VALUE)
    kept = kept_of(record)
    assert len(kept["optimizer/curves/fitting.py"].split()) == 4
    assert len(kept_of(record, found=1e-3)["optimizer/curves/fitting.py"].split()) == 2
    assert not kept_values.kept_form(record.sums, record.sums, [kept])


def test_a_function_that_is_no_longer_called_is_named_and_one_that_is_gone_is_not() -> None:
    record = record_of("return 1.0")
    name = next(iter(kept_values.functions("optimizer/curves/fitting.py").values()))
    letters = kept_values.in_short(name)
    kept = {"optimizer/curves/fitting.py": f"{letters} 1.0 none 1.0", "optimizer/gone.py": "a 1.0"}
    (line,) = kept_values.differences(record, kept)
    assert line == f"optimizer/curves/fitting.py: {name} is no longer called"


def test_functions_around_a_line_are_those_that_hold_it() -> None:
    path = "optimizer/curves/fitting.py"
    lines = (house.ROOT / path).read_text(encoding="utf-8").splitlines()
    line = next(k for k, text in enumerate(lines, 1) if "self.objective[-1] = 1.0" in text)
    assert kept_values.around(path, line)[-1] == "MinimaxProgramme.__init__"
