"""The page on moteus: its worked example, and its table of keys."""

from __future__ import annotations

from firmware_pages import block, example_files, page_of

PAGE = page_of("moteus")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    (text,) = example_files("moteus", block(PAGE, "yaml"), "motor").values()
    assert text == block(PAGE, "text")


def test_the_table_names_every_key_that_is_written() -> None:
    lines = block(PAGE, "text").splitlines()[:-1]
    table = PAGE.partition("## Keys")[2].partition("## Loops")[0]
    for key in (line.split()[2] for line in lines):
        ends = [f"`{key[start:]}`" for start in range(len(key)) if key[start] in "._"]
        assert any(end in table for end in (f"`{key}`", *ends)), key
