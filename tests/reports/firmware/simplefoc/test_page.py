"""The page on SimpleFOC: its worked example, and its table of members."""

from __future__ import annotations

from firmware_pages import assert_example, page_of

from dqforge.optimizer.firmware.targets.simplefoc import MEMBERS

PAGE = page_of("simplefoc")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    assert_example("simplefoc", "scooter_simplefoc.h", "cpp", least=8)


def test_the_table_names_every_member_and_its_line() -> None:
    for name, member in MEMBERS.items():
        head, _, tail = name.partition(".")
        assert f"`{name}`" in PAGE or (f"`{head}." in PAGE and f"`.{tail}`" in PAGE), name
        assert not member.command or f"`M{member.command}`" in PAGE, name
