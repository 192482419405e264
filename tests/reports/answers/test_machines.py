"""The library as it is listed: what its files say, without any of them being loaded."""

from __future__ import annotations

import subprocess
import sys

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.reports.answers.machines import answer_machines


def test_the_list_says_what_the_drives_say() -> None:
    table = answer_machines(None).tables[0]
    assert [row[0] for row in table.rows] == catalogue.names()
    for key, name, about in table.rows[:3]:
        design = catalogue.load(key)
        assert (name, about) == (design.name, design.about)
    assert all(name and about for _, name, about in table.rows)


def test_the_motors_are_a_second_table() -> None:
    answer = answer_machines(None)
    assert [row[0] for row in answer.tables[1].rows] == catalogue.motors()
    listed = {kind: answer.plain[kind] for kind in ("machines", "motors")}
    assert [entry["name"] for entry in listed["machines"]] == catalogue.names()
    assert [entry["name"] for entry in listed["motors"]] == catalogue.motors()
    assert all(set(entry) == {"name", "motor", "about"} for entry in listed["motors"])


@pytest.mark.parametrize(
    ("words", "found", "not_found"),
    [
        ("hoverboard", {"hoverboard-hub"}, {"bafang-bbshd"}),
        ("Hoverboard", {"hoverboard-hub"}, {"gbm2804h-100t"}),
        ("gimbal", {"gbm2804h-100t"}, {"hoverboard-hub"}),
        ("servo", {"kollmorgen-akm44h", "estun-emj-04apb"}, {"hoverboard-hub"}),
        ("e-bike", {"bafang-bbshd", "bafang-m600"}, {"teknic-m2310p"}),
        ("ebike", {"bafang-bbshd", "bafang-m600"}, {"teknic-m2310p"}),
        ("48 V", {"bafang-m600", "odrive-d6374-150kv"}, {"hoverboard-hub"}),
        ("48V", {"bafang-m600", "odrive-d6374-150kv"}, {"hoverboard-hub"}),
        ("8 V", set(), {"bafang-m600"}),  # no part of 48 V
        ("skateboard", {"flipsky-6374", "vdyno-trampa-6340"}, {"hoverboard-hub"}),
        ("stm32 gimbal", {"gbm2804h-100t"}, {"br2804-1700kv"}),  # words that stand apart
        ("AK80", {"cubemars-ak80-9"}, {"hoverboard-hub"}),
        ("reluctance", {"abb-syrm-6k7", "thor-pmsyrm-5k"}, {"hoverboard-hub"}),
    ],
)
def test_words_find_drives_and_motors(words: str, found: set[str], not_found: set[str]) -> None:
    try:
        answer = answer_machines(None, words)
    except InputError:
        assert not found
        return
    names = {row[0] for table in answer.tables for row in table.rows}
    assert found <= names
    assert not names & not_found
    assert names == {
        entry["name"] for kind in ("machines", "motors") for entry in answer.plain[kind]
    }
    following = str(answer.plain["next"])
    assert following.rsplit(maxsplit=1)[-1] in names
    assert answer.notes == (f"next: {following}",)


@pytest.mark.parametrize(
    ("words", "phrase"),
    [
        ("hoverbord", "did you mean 'hoverboard'"),
        ("gimball", "did you mean 'gimbal'"),
        ("toaster", "there are .*servo.*and more: 'dqforge machines' lists them"),
        ("", "there are "),
        ("!?", "there are "),
        ("x" * 300, "there are "),
    ],
)
def test_nothing_found_is_one_line_that_says_what_there_is(words: str, phrase: str) -> None:
    with pytest.raises(InputError, match=phrase) as refused:
        answer_machines(None, words)
    assert "\n" not in refused.value.message
    assert len(refused.value.message) < 200


def test_one_asks_for_a_name_or_for_words() -> None:
    with pytest.raises(InputError, match="omit one of them"):
        answer_machines("hoverboard-hub", "hub")


def test_one_motor_is_its_file() -> None:
    assert answer_machines("hoverboard-hub").plain == {
        "text": catalogue.read_text("hoverboard-hub").decode()
    }
    with pytest.raises(InputError, match="did you mean hoverboard-hub"):
        answer_machines("hoverbord-hub")


def test_one_drive_is_its_file() -> None:
    answer = answer_machines("abb-syrm-6k7")
    assert answer.notes == (catalogue.read_text("abb-syrm-6k7").decode().removesuffix("\n"),)
    with pytest.raises(InputError, match="did you mean abb-syrm-6k7"):
        answer_machines("abb-syrm-6k")


def test_a_list_needs_no_numbers() -> None:
    # Numerical libraries and the schema of designs take seconds to import.
    heavy = "numpy", "scipy", "dqforge.machines.design.catalogue", "dqforge.optimizer"
    program = (
        "import sys\nfrom dqforge.cli import main\n"
        "try:\n    main(['machines'])\nexcept SystemExit:\n    pass\n"
        f"sys.exit(' '.join(name for name in {heavy!r} if name in sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.stderr.strip() == ""
    assert "abb-syrm-6k7" in done.stdout
