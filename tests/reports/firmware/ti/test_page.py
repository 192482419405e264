"""The page on TI: its worked example, and its table of keys."""

from __future__ import annotations

import re
from pathlib import Path

from dqforge.machines.design.loader import load_design
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.asked import asked
from dqforge.optimizer.firmware.targets.ti import configure
from dqforge.optimizer.firmware.ti_format.ti_keys import KEYS
from dqforge.reports.firmware.target import FileTitle
from dqforge.reports.firmware.ti.writer import write

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs" / "firmware-ti.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The first block of the page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def short(name: str) -> str:
    """A macro as the page names it: those of the motor without their prefix."""
    return name.removeprefix("USER_MOTOR1_")


def test_the_worked_example_gives_what_the_page_prints(tmp_path: Path) -> None:
    path = tmp_path / "scooter.yaml"
    path.write_text(block("yaml"), encoding="utf-8")
    design = load_design(path)
    gains = solve_gains(design)
    held = configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    title = FileTitle("scooter", design.name, design.digest, "0")
    text = write(held, title, None)["scooter_user_mtr1.h"].decode()
    printed = block("c").splitlines()
    assert len(printed) > 10
    assert [line for line in printed if line not in text.splitlines()] == []


def test_the_table_names_every_key() -> None:
    assert [name for name in KEYS if f"`{short(name)}`" not in PAGE] == []
