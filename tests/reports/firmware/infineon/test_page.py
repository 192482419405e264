"""The page on Infineon: its worked example, and its table of keys."""

from __future__ import annotations

from firmware_pages import assert_example, page_of

from dqforge.optimizer.firmware.infineon_format import KEYS

PAGE = page_of("infineon")


def short(name: str) -> str:
    """A member as the page names it."""
    return name.removeprefix("params.")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    assert_example("infineon", "scooter_params.h", "c", least=10)


def test_the_table_names_every_key() -> None:
    assert [name for name in KEYS if f"`{short(name)}`" not in PAGE] == []
