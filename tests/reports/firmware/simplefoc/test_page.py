"""The page on SimpleFOC: its worked example, and its table of members."""

from __future__ import annotations

import re
from pathlib import Path

from dqforge.machines.design.loader import load_design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.asked import asked
from dqforge.optimizer.firmware.simplefoc_format.simplefoc_keys import MEMBERS
from dqforge.optimizer.firmware.targets.simplefoc import configure
from dqforge.reports.firmware.simplefoc.writer import write
from dqforge.reports.firmware.target import FileTitle

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "firmware-simplefoc.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The first block of the page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_worked_example_gives_what_the_page_prints(tmp_path: Path) -> None:
    path = tmp_path / "scooter.yaml"
    path.write_text(block("yaml"), encoding="utf-8")
    design = load_design(path)
    gains = solve_gains(design)
    held = configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    title = FileTitle("scooter", design.name, design.digest, "0")
    text = write(held, title, None)["scooter_simplefoc.h"].decode()
    printed = block("cpp").splitlines()
    assert len(printed) > 8
    assert [line for line in printed if line not in text.splitlines()] == []


def test_the_table_names_every_member_and_its_line() -> None:
    for name, member in MEMBERS.items():
        head, _, tail = name.partition(".")
        assert f"`{name}`" in PAGE or (f"`{head}." in PAGE and f"`.{tail}`" in PAGE), name
        assert not member.command or f"`M{member.command}`" in PAGE, name
