"""The page on TI: its worked example, and its table of keys."""

from __future__ import annotations

from firmware_pages import assert_example, page_of

from dqforge.optimizer.firmware.targets.ti import KEYS

PAGE = page_of("ti")


def short(name: str) -> str:
    """A macro as the page names it: those of the motor without their prefix."""
    return name.removeprefix("USER_MOTOR1_")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    assert_example("ti", "scooter_user_mtr1.h", "c", least=10)


def test_the_table_names_every_key() -> None:
    assert [name for name in KEYS if f"`{short(name)}`" not in PAGE] == []
