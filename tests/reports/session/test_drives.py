"""Designs loaded from Python, with keys set instead of what their file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dqforge

NAME = "paper000-ipmsm-100kw"


def test_a_library_drive_and_its_file_are_the_same(tmp_path: Path) -> None:
    assert NAME in dqforge.library()
    drive = dqforge.load_design(NAME)
    assert drive.given is not None
    file = tmp_path / "design.yaml"
    file.write_bytes(drive.given.text)
    assert dqforge.load_design(file) == drive
    assert dqforge.load_design(str(file)).digest == drive.digest


def test_keys_are_set_in_si_units(tmp_path: Path) -> None:
    changes = {
        "fit.degree": np.int64(3),
        "inverter.v_dc": 1300.0 / 3.0,
        "machine.resistance": 1e-5 * np.pi,
        "losses.modulations": ["svpwm"],
    }
    design = dqforge.load_design(NAME, changes)
    assert design.fit.degree == 3
    assert design.inverter.v_dc == 1300.0 / 3.0
    assert design.machine.r_s == 1e-5 * np.pi
    assert design.losses is not None
    assert design.losses.modulations == ("svpwm",)
    assert design.digest != dqforge.load_design(NAME).digest
    assert design.given is not None
    (tmp_path / "design.yaml").write_bytes(design.given.text)
    assert dqforge.load_design(tmp_path / "design.yaml") == design
    assert dqforge.load_design(NAME, {}) == dqforge.load_design(NAME)


def test_refusals_name_the_key() -> None:
    with pytest.raises(dqforge.InputError, match="degre"):
        dqforge.load_design(NAME, {"fit.degre": 3})
    with pytest.raises(dqforge.InputError, match=r"fit\.degree: expected a number of at most 6"):
        dqforge.load_design(NAME, {"fit.degree": 99})
    with pytest.raises(dqforge.InputError, match="no-such-drive"):
        dqforge.load_design("no-such-drive")
