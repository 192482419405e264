"""Study files with a key changed, left out or cut, by the hundred: each is a study, or one line."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import yaml
from broken_studies import BASE
from design_changes import key_paths

from dqforge.machines.design import catalogue as designs
from dqforge.machines.errors import InputError
from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import row_count, study_of_text

WRONG: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    "word",
    "all",
    "design",
    "1 furlong",
    "1,5 kHz",
    1e300,
    "5 %",
    [],
    {},
    [1, 2, 3],
    [[]],
    ["", {}],
    {"values": [1]},
    {"range": {"from": 1, "to": 2, "count": 2}},
    {"files": "*"},
    {"normal": "5 %"},
    {"together": {}},
    "nan",
    "../x",
)
STUDIES = {"base": BASE.encode()} | {name: catalogue.read_text(name) for name in catalogue.names()}


def mutations(text: bytes) -> Iterator[bytes]:
    base: Any = yaml.safe_load(text)
    for path in key_paths(base):
        for value in (*WRONG, "left out"):
            changed = copy.deepcopy(base)
            inner = changed
            for part in path[:-1]:
                inner = inner[part]
            if value == "left out":
                del inner[path[-1]]
            else:
                inner[path[-1]] = value
            yield yaml.safe_dump(changed, sort_keys=False).encode()


def refusal_of(ask: Callable[[], object]) -> InputError | None:
    """How a question is refused, None where it is answered."""
    try:
        ask()
    except InputError as error:
        return error
    return None


def judged(text: bytes) -> bool:
    """Whether a study is sound; a refusal of any other form fails."""
    found: list[Study] = []
    refusal = refusal_of(lambda: found.append(study_of_text(text, "study.yaml")))
    if refusal is not None:
        assert "\n" not in str(refusal)
        assert refusal.exit_code == 2
        assert ".yaml:" in str(refusal)
        assert len(refusal.message) > 10
        return False
    study = found[0]
    # What is called sound has a row that is a design.
    assert row_count(study) >= 1
    first = {
        key: value
        for axis in study.axes
        for key, value in zip(axis.keys, axis.steps[0], strict=True)
    }
    assert refusal_of(lambda: design_of(study, first)) is None or row_count(study) > 1
    return True


def counted(texts: list[bytes]) -> tuple[int, int]:
    found = [judged(text) for text in texts]
    return found.count(True), found.count(False)


def test_a_mutated_study_is_sound_or_one_line() -> None:
    sound, refused = counted(random.Random(5).sample(list(mutations(STUDIES["base"])), 30))
    assert sound > 0
    assert refused > 12


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_mutated_studies_are_sound_or_one_line(name: str) -> None:
    cases = list(mutations(STUDIES[name]))
    sound, refused = counted(random.Random(3).sample(cases, min(300, len(cases))))
    assert sound > 20
    assert refused > 150


def test_a_cut_or_scrambled_file_is_one_line() -> None:
    draw = random.Random(7)
    for text in STUDIES.values():
        for _ in range(6):
            place = draw.randrange(len(text))
            judged(
                text[:place]
                + draw.choice([b"", b"\t", b"{", b": ", b"\xff", b"'"])
                + text[place + draw.randrange(4) :]
            )


def test_every_drive_of_the_library_has_rows() -> None:
    """Voltage and current limit vary in every drive, whatever its machine."""
    for name in designs.names():
        text = (
            f"dqforge_study: 1\nname: a\ndesign: {name}\n"
            "tolerances: {machine.resistance: {normal: 2 %}, inverter.v_dc: {uniform: 1 %}}\n"
            "draw: {count: 3, seed: 1}\n"
        )
        assert judged(text.encode())
