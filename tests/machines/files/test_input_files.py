"""Files that a user names: regular ones are read whole, everything else is
refused in one line and at once.
"""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file

DESIGN = """dqforge: 1
name: Map
machine:
    model: flux-map
    pole_pairs: 2
    resistance: 0.2 Ohm
    max_current: 10 A
    flux_map: {file: map.csv}
inverter: {v_dc: 310 V, switching_frequency: 10 kHz}
"""


def test_a_file_comes_back_whole_up_to_the_limit(tmp_path: Path) -> None:
    place = tmp_path / "a.bin"
    place.write_bytes(bytes(range(256)))
    assert read_regular_file(place, 256) == bytes(range(256))
    (tmp_path / "link").symlink_to(place)
    assert read_regular_file(tmp_path / "link", 256) == bytes(range(256))
    with pytest.raises(InputError, match=r"at most 0\.000255 MB can be read"):
        read_regular_file(place, 255)


def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "one").symlink_to(tmp_path / "two")
    (tmp_path / "two").symlink_to(tmp_path / "one")
    refused = {
        tmp_path / "pipe": "a named pipe",
        tmp_path / "one": "lead in a circle",
        tmp_path: "a folder",
        tmp_path / "none": "there is no such file",
        tmp_path / "none" / "below": "there is no such file",
        Path("/dev/zero"): "a device",
        tmp_path / ("x" * 5000): "cannot be read",
        tmp_path / "nul\0": "not a file name",
    }
    for place, phrase in refused.items():
        with pytest.raises(InputError, match=phrase) as caught:
            read_regular_file(place, 10, "shown")
        assert caught.value.source == "shown"
        assert "\n" not in str(caught.value)


def test_files_that_state_no_size_are_read_up_to_the_limit() -> None:
    content = read_regular_file("/proc/self/status", 100_000)
    assert b"VmRSS" in content
    with pytest.raises(InputError, match="more than"):
        read_regular_file("/proc/self/status", 20)


@pytest.mark.parametrize("kind", ["loop", "pipe", "folder", "none", "loop outside"])
def test_a_design_names_only_regular_files(tmp_path: Path, kind: str) -> None:
    home = tmp_path / "design"
    home.mkdir()
    place, other = home / "map.csv", home / "other.csv"
    if kind.startswith("loop"):
        other = tmp_path / "other.csv" if kind == "loop outside" else other
        place.symlink_to(other)
        other.symlink_to(place)
    elif kind == "pipe":
        os.mkfifo(place)
    elif kind == "folder":
        place.mkdir()
    with pytest.raises(InputError) as caught:
        load_text(DESIGN.encode(), "design.yaml", home)
    assert str(caught.value).startswith("design.yaml:8:")
    assert "map.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_folder_that_windows_may_not_open_is_called_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise PermissionError(errno.EACCES, "Permission denied")

    (tmp_path / "file").write_bytes(b"")
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(InputError, match="this is a folder"):
        read_regular_file(tmp_path, 10)
    with pytest.raises(InputError, match="may not be read"):
        read_regular_file(tmp_path / "file", 10)
