"""Tables of pages say what is made of what `export` emits: a table drawn per commit, all of them in
the campaign.
"""

from __future__ import annotations

import os
import re
import shutil

import pytest
from page_numbers import DOCS, NUMBERS, made, said

from dqforge.optimizer.phase_control.design import RIPPLE

NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")


@pytest.mark.thinned
@pytest.mark.parametrize("name", NUMBERS)
def test_the_page_says_what_is_made(name: str) -> None:
    for program in ("arm-none-eabi-gcc", "qemu-system-arm") if name.endswith("-cost") else ("cc",):
        if shutil.which(program) is None and not os.environ.get("CI"):
            pytest.skip(f"{program} is not installed")
        assert shutil.which(program) is not None
    page, now = said(name), made(name)
    assert [NUMBER.sub("", line) for line in page] == [NUMBER.sub("", line) for line in now]
    for before, after in zip(page, now, strict=True):
        numbers = [[float(x) for x in NUMBER.findall(line)] for line in (before, after)]
        assert numbers[0] == pytest.approx(numbers[1], rel=NUMBERS[name].within, abs=0.011)


def test_every_table_that_a_page_marks_is_made() -> None:
    marked = {
        name: str(page.relative_to(DOCS))
        for page in DOCS.rglob("*.md")
        for name in re.findall(r"^<!-- numbers: (.+) -->$", page.read_text("utf-8"), re.MULTILINE)
    }
    assert marked == {name: numbers.page for name, numbers in NUMBERS.items()}


def test_the_emitted_nodes_keep_the_ripple_that_is_stated() -> None:
    """As the page has it, at 750 rpm with an averaged inverter, on every topology."""
    rows = said("phase-ripple")[2:]
    assert len(rows) == 5
    for row in rows:
        middle = float(row.split("|")[2].split("/")[1])
        assert middle <= 100.0 * RIPPLE
    emitted = next(row for row in said("phase-nodes") if "emitted" in row)
    assert float(emitted.split("|")[3].split()[0]) <= 100.0 * RIPPLE


def test_steps_over_the_angle_cost_what_they_do() -> None:
    """By the page, on the M4F: less without harmonic integrators and more along the back-EMF; below
    a tenth of the period at 10 kHz and 168 MHz."""
    rows = {row.split("|")[1].strip(): row.split("|")[2] for row in said("phase-cost")[2:]}
    whole, bare, follows = (
        [float(x) for x in NUMBER.findall(rows[name])]
        for name in ("four-leg", "four-leg, `harmonic_integrators=false`", "four-leg, `frame=dqy`")
    )
    assert bare[0] < whole[0] < follows[0]
    assert whole[2] < 1680.0
    assert whole[3] < 8000.0


def test_the_whole_interrupt_costs_more_than_its_parts() -> None:
    """And a voltage that is shortened more than one within its limit."""
    cells = [row.split("|")[2] for row in said("interrupt-cost")[2:]]
    mean = [float(NUMBER.findall(cell)[0]) for cell in cells]
    assert mean[0] < mean[1] < mean[2]
    assert mean[3] < mean[4] < mean[5]
    assert all(short > plain for plain, short in zip(mean[:3], mean[3:], strict=True))
