"""What is planted by the mutation score, and what is known to change no number."""

from __future__ import annotations

import tomllib
from pathlib import Path

import callers
import house
import kept_output
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


def test_what_comes_to_a_place_by_name_is_found_over_tables_and_templates(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts = {
        "machines/a.py": "def f():\n    return 1.0\n",
        "machines/b.py": "from dqforge.machines.a import f\nTABLE = {1: f}\n",
        "machines/other.py": "def f():\n    return 2.0\n\ndef g():\n    return f()\n",
        "reports/c.py": "def emitted():\n    return render('room/x.c.j2')\n",
        "reports/room/templates/x.c.j2": '#include "y.c"\n',
        "tests/test_all.py": "def test_one():\n    TABLE[1]()\n\ndef test_two():\n    f()\n\n"
        "def test_three():\n    g()\n\ndef test_four():\n    emitted()\n",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(house, "ROOT", tmp_path)
    for known in (house.modules, house.imports, house.tests, callers.users):
        known.cache_clear()
    try:
        found = callers.cases("machines/a.py", 2, {"machines.a", "machines.b"})
        assert found == {"tests/test_all.py::test_two": 0, "tests/test_all.py::test_one": 1}
        included = callers.cases("reports/room/templates/y.c.j2", 1, {"reports.c"})
        assert included == {"tests/test_all.py::test_four": 2}
    finally:
        for known in (house.modules, house.imports, house.tests, callers.users):
            known.cache_clear()


def test_draws_are_summed_where_they_are_fresh() -> None:
    """Two draws of one seed count once, the first; a survivor that is noticed later is gone."""
    one, two = (
        mutants.Change("proofs", "a.py", 0, 1, "-", "+", line, f"a + {line}", 2) for line in (1, 2)
    )
    page = ""
    for commit, cases, same in (
        ("`a`", {one.key: ""}, {two.key: "a reason."}),
        ("`b`", {one.key: "tests/x.py::y"}, {two.key: "a reason."}),
    ):
        page = mutants.lines_of_evidence(page, [one, two], same, cases, [commit, "`s`"])
        assert ("a + 1" in page) == (commit == "`a`")
    rows = [line for line in page.splitlines() if line.startswith("| ")]
    assert rows[2:4] == [
        "| `a` | `s` | yes | 0 of 0 | 0 of 0 | 0 of 0 | 0 of 1 | 0 of 1 | 1 |",
        "| `b` | `s` | no | 0 of 0 | 0 of 0 | 0 of 0 | 1 of 1 | 1 of 1 | 1 |",
    ]
    assert "| 0 of 1, 0 % (0 to 79 %) | 1 |" in rows[4]


def test_what_is_noticed_when_it_is_tried_again_is_taken_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    still, noticed, gone = (
        mutants.Change("proofs", "a.py", 0, 1, "-", "+", line, f"a + {line}", 2)
        for line in (1, 2, 3)
    )
    page = "".join(
        f"* `{one.path}`: `{one.words}`: `{one.named}` (seed `s`)\n"
        for one in (still, noticed, gone)
    )
    monkeypatch.setattr(mutants, "EVIDENCE", tmp_path / "page.md")
    mutants.EVIDENCE.write_text(page, encoding="utf-8")
    before = mutants.listed(page, [still, noticed])
    assert list(before.values()) == [still, noticed, None]
    mutants.take_out({still.key: "", noticed.key: "tests/x.py::y"}, before)
    assert mutants.EVIDENCE.read_text(encoding="utf-8") == page.splitlines(keepends=True)[0]


@pytest.mark.parametrize("kind", mutants.KINDS)
def test_kept_cases_are_asked_first_of_every_kind(kind: str) -> None:
    names = [name for name in mutants.files(house.ROOT) if mutants.kind_of(name) == kind]
    drawn = mutants.drawn(mutants.changes(house.ROOT, names), 4, "a")
    asked = [mutants.order(change) for change in drawn]
    kept = f"{kept_output.TEST}["
    assert any(cases[0].startswith(kept) for cases in asked)
    assert all(not case.startswith(kept) for cases in asked for case in cases[mutants.FIRST :][:1])
