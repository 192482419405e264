"""The page on odrive: its worked example, and its table of keys."""

from __future__ import annotations

import re
from pathlib import Path

from dqforge.machines.design.loader import load_design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.asked import asked
from dqforge.optimizer.firmware.one_bandwidth.odrive_keys import KINDS
from dqforge.optimizer.firmware.targets.odrive import ODRIVE
from dqforge.reports.firmware.odrive.writer import write
from dqforge.reports.firmware.target import FileTitle

DOCS = Path(__file__).parents[4] / "docs"
PAGE = (DOCS / "firmware-odrive.md").read_text(encoding="utf-8")


def block(page: str, language: str) -> str:
    """The first block of a page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", page, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_worked_example_gives_what_the_page_prints(tmp_path: Path) -> None:
    path = tmp_path / "hub.yaml"
    other = (DOCS / "firmware-moteus.md").read_text(encoding="utf-8")
    path.write_text(block(other, "yaml"), encoding="utf-8")
    design = load_design(path)
    gains = solve_gains(design)
    held = ODRIVE.configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    (content,) = write(held, FileTitle("motor", design.name, design.digest, "0"), None).values()
    assert content.decode() == block(PAGE, "json")


def test_the_table_names_every_property_that_is_written() -> None:
    unwritten = {
        "controller.config.vel_ramp_rate",
        "controller.config.input_mode",
        "encoder.config.mode",
    }
    for key in set(KINDS) - unwritten:
        assert f"`{key}`" in PAGE or f"`{key.rpartition('.')[2]}`" in PAGE, key
