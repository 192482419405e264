"""The page on moteus: its worked example, and its table of keys."""

from __future__ import annotations

import re
from pathlib import Path

from dqforge.machines.design.loader import load_design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.asked import asked
from dqforge.optimizer.firmware.targets.moteus import MOTEUS
from dqforge.reports.firmware.moteus.writer import write
from dqforge.reports.firmware.target import FileTitle

DOCS = Path(__file__).parents[4] / "docs"
PAGE = (DOCS / "firmware-moteus.md").read_text(encoding="utf-8")


def block(page: str, language: str) -> str:
    """The first block of a page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", page, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_worked_example_gives_what_the_page_prints(tmp_path: Path) -> None:
    path = tmp_path / "hub.yaml"
    path.write_text(block(PAGE, "yaml"), encoding="utf-8")
    design = load_design(path)
    gains = solve_gains(design)
    held = MOTEUS.configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    (content,) = write(held, FileTitle("motor", design.name, design.digest, "0"), None).values()
    assert content.decode() == block(PAGE, "text")


def test_the_table_names_every_key_that_is_written() -> None:
    lines = block(PAGE, "text").splitlines()[:-1]
    table = PAGE.partition("## Keys")[2].partition("## Loops")[0]
    for key in (line.split()[2] for line in lines):
        ends = [f"`{key[start:]}`" for start in range(len(key)) if key[start] in "._"]
        assert any(end in table for end in (f"`{key}`", *ends)), key
