"""What is planted by the mutation score, and what is known to change no number."""

from __future__ import annotations

import tomllib

import house
import mutants
import pytest

LISTED = tomllib.loads(mutants.EQUIVALENT.read_text(encoding="utf-8"))["change"]


def test_what_changes_no_number_is_still_there() -> None:
    paths = sorted({entry["path"] for entry in LISTED})
    same = mutants.equivalent(mutants.changes(house.ROOT, paths), LISTED)
    assert len(same) == len(LISTED)
    assert all(reason.endswith(".") for reason in same.values())


def test_an_entry_without_its_line_is_refused() -> None:
    with pytest.raises(ValueError, match=r"no such change: optimizer/loops/gone\.py"):
        mutants.equivalent([], [{**LISTED[0], "path": "optimizer/loops/gone.py"}])


def test_each_kind_of_change_is_planted_and_reads_as_it_should() -> None:
    source = (
        "def f(a, b):\n"
        "    g(a)\n"
        "    a += 1\n"
        "    return h(a, b) if -a < b * 2.0 else max(a, b) + a @ b\n"
    )
    found = {source[start:end] + " -> " + text for start, end, text in mutants._in_python(source)}
    assert found == {
        "g(a) -> pass",
        "a += 1 -> pass",
        "a, b -> b, a",
        "- -> ",
        "< -> >=",
        "* -> /",
        "2.0 -> 2.5",
        "+ -> -",
        "a @ b -> b @ a",
    }


def test_order_of_arguments_that_does_not_matter_is_left() -> None:
    assert not list(mutants._in_python("def f(a, b):\n    return np.maximum(a, math.hypot(b, a))"))


def test_files_that_are_no_emitted_c_are_left() -> None:
    assert mutants.kind_of("reports/simulation/templates/plant.c.j2") == "emitted code"
    assert mutants.kind_of("reports/exploration/templates/pictures.js.j2") is None
    assert mutants.kind_of("optimizer/certificates/ball.py") == "proofs"


def test_counts_come_with_their_interval() -> None:
    """Wilson's formula at 19 of 20, by hand: (0.95 + z^2/40 +- z sqrt(...)) / (1 + z^2/20)."""
    assert mutants.share(19, 20) == "19 of 20, 95 % (76 to 99 %)"
    assert mutants.share(0, 0) == "0 of 0"
