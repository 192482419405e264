"""Pages of the documentation on firmware: their worked examples, and the files they come to."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.names import Firmware
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.firmware.firmware_method import asked
from dqforge.reports.firmware.target import TARGETS, FileTitle

DOCS = Path(__file__).parents[1] / "docs"


def page_of(name: Firmware) -> str:
    """The text of the page on a firmware."""
    return (DOCS / "firmware" / f"{name}.md").read_text(encoding="utf-8")


def block(page: str, language: str) -> str:
    """The first block of a page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", page, re.DOTALL)
    assert found is not None
    return found[1]


def settings_of(page: str) -> list[str]:
    """Keys that the command of a page sets in the design of another page."""
    return [found.replace("'", "") for found in re.findall(r"--set ([\w.]+=(?:'[^']*'|\S+))", page)]


def example_files(
    name: Firmware, design_text: str, prefix: str, settings: Sequence[str] = ()
) -> dict[str, str]:
    """Texts of the files, by their names, that a design with its own gains comes to."""
    design = load_text(design_text.encode(), f"{prefix}.yaml", None, settings)
    gains = solve_gains(design)
    target = TARGETS[name]
    held = target.method.configure(asked(design, gains.i_d, gains.i_q, gains.speed))
    files = target.write(held, FileTitle(prefix, design.name, design.digest, "0"), None)
    return {file: content.decode() for file, content in files.items()}


def assert_example(name: Firmware, file: str, language: str, *, least: int) -> None:
    """Every line that the page prints in a language stands in the file that its design gives, and
    those lines are more than `least`. A page without a design has that of VESC and sets keys in it.
    """
    page = page_of(name)
    own = "```yaml" in page
    design, settings = (page, []) if own else (page_of("vesc"), settings_of(page))
    text = example_files(name, block(design, "yaml"), file.partition("_")[0], settings)[file]
    printed = block(page, language).splitlines()
    assert len(printed) > least
    assert [line for line in printed if line not in text.splitlines()] == []
