"""The page on odrive: its worked example, and its table of keys."""

from __future__ import annotations

from firmware_pages import block, example_files, page_of

from dqforge.optimizer.firmware.targets.odrive import KINDS

PAGE = page_of("odrive")


def test_the_worked_example_gives_what_the_page_prints() -> None:
    (text,) = example_files("odrive", block(page_of("moteus"), "yaml"), "motor").values()
    assert text == block(PAGE, "json")


def test_the_table_names_every_property_that_is_written() -> None:
    unwritten = {
        "controller.config.vel_ramp_rate",
        "controller.config.input_mode",
        "encoder.config.mode",
    }
    for key in set(KINDS) - unwritten:
        assert f"`{key}`" in PAGE or f"`{key.rpartition('.')[2]}`" in PAGE, key
