"""The page on VESC: its worked example, and its table of keys."""

from __future__ import annotations

from firmware_pages import assert_example, page_of

from dqforge.optimizer.firmware.vesc_format import KEYS

PAGE = page_of("vesc")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    assert_example("vesc", "scooter_mcconf.xml", "xml", least=10)


def test_the_table_names_every_key() -> None:
    assert [name for name in KEYS if f"`{name}`" not in PAGE] == []
