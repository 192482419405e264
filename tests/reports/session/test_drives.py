"""Designs loaded from Python, with keys set instead of what their file says."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest
from drives import IPM

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


def of_a_design() -> list[str]:
    """Public functions whose first argument is a design."""
    found = []
    for name in dqforge.__all__:
        public = getattr(dqforge, name)
        if inspect.isfunction(public):
            first = next(iter(inspect.signature(public).parameters), "")
            found += [name] if first in {"design", "asked"} else []
    return found


@pytest.mark.parametrize("name", of_a_design())
@pytest.mark.parametrize("given", ["abb-ipmsm-2k2", IPM, None], ids=["text", "machine", "nothing"])
def test_what_is_no_design_is_refused_with_the_way_to_one(name: str, given: object) -> None:
    more = {"firmware": "vesc"} if name == "export_for" else {}
    wanted = "load_design" if isinstance(given, str) else "make_design.*load_design"
    with pytest.raises(dqforge.InputError, match=f"design: expected a Design, got .*{wanted}"):
        getattr(dqforge, name)(given, **more)


def test_every_answer_to_a_design_is_tried() -> None:
    assert len(of_a_design()) >= 10
