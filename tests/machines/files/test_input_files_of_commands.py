"""Every option and key that takes a file, with everything a file can be
that is none of its kind.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from dqforge import cli
from dqforge.machines.back_emf import columns as bemf_files
from dqforge.machines.design import catalogue
from dqforge.machines.design import design as reading
from dqforge.machines.devices import files as device_files
from dqforge.machines.files import positioned_yaml as yaml_source
from dqforge.machines.losses import machine_budget as mission
from dqforge.reports.pages import answer as files

DRIVE = "paper000-ipmsm-100kw"  # A library drive, for options that need a design beside their file.

MAP = """dqforge: 1
name: Map
machine:
    model: flux-map
    pole_pairs: 2
    resistance: 0.2 Ohm
    max_current: 10 A
    flux_map: {{{keys}}}
inverter: {{v_dc: 310 V, switching_frequency: 10 kHz}}
"""
WAVE = """dqforge: 1
name: Wave
machine:
    model: waveform
    pole_pairs: 2
    resistance: 0.2 Ohm
    self_inductance: 8 mH
    max_current: 10 A
    back_emf: {{{keys}}}
inverter: {{v_dc: 310 V, switching_frequency: 10 kHz}}
"""
DEVICE = """dqforge: 1
name: Device
machine:
    model: linear
    pole_pairs: 2
    resistance: 0.2 Ohm
    inductance_d: 8 mH
    inductance_q: 8 mH
    magnet_flux: 0.2 Wb
    max_current: 10 A
inverter:
    v_dc: 310 V
    switching_frequency: 10 kHz
    dead_time: 1 us
    device: {{{keys}}}
{further}
"""


@dataclass(frozen=True)
class Entry:
    """A way for a file into the program: its name beside the design, the command line, the design,
    and the limit.

    The command line and the design have {file} where the name stands;
    a design names only files beside it.
    """

    file: str
    words: tuple[str, ...]
    limit: int
    design: str = ""


def by_key(design: str, keys: str, file: str, limit: int, further: str = "") -> Entry:
    text = design.format(keys=keys.replace("FILE", file), further=further.replace("FILE", file))
    return Entry(file, ("check", "holder.yaml"), limit, text)


COMMANDS = ("check", "run", "export", "mtpa", "fit", "tune", "losses", "dqy", "simulate")
_DESIGN, _TABLE, _OUTPUT = yaml_source.MAX_BYTES, reading.MAX_FILE_BYTES, files.LARGEST_FILE
ENTRIES = {
    f"{command} DESIGN": Entry("x.yaml", (command, "{file}"), _DESIGN) for command in COMMANDS
} | {
    "compare A": Entry("x.yaml", ("compare", "{file}", DRIVE), _DESIGN),
    "compare B": Entry("x.yaml", ("compare", "good.h", "{file}"), _DESIGN),
    "compare result": Entry("result.json", ("compare", "{file}", DRIVE), files.LARGEST_JSON),
    "compare header": Entry("x.h", ("compare", "{file}", DRIVE), _OUTPUT),
    "losses --mission": Entry(
        "x.csv", ("losses", DRIVE, "--mission", "{file}"), mission.MOST_BYTES
    ),
    "bemf FILE": Entry("x.csv", ("bemf", "{file}"), bemf_files.MOST_BYTES),
    "bemf packed": Entry("x.csv.gz", ("bemf", "{file}"), bemf_files.MOST_BYTES),
    "bemf matlab": Entry("x.mat", ("bemf", "{file}"), bemf_files.MOST_BYTES),
    "bemf FILE FILE": Entry("x.csv", ("bemf", "good.csv", "{file}"), bemf_files.MOST_BYTES),
    "flux_map.file": by_key(MAP, "file: FILE", "x.csv", _TABLE),
    "flux_map.file npz": by_key(MAP, "file: FILE", "x.npz", _TABLE),
    "flux_map.file xlsx": by_key(MAP, "file: FILE", "x.xlsx", _TABLE),
    "flux_map.file mat": by_key(MAP, "file: FILE", "x.mat", _TABLE),
    "flux_map.file h5": by_key(MAP, "file: FILE", "x.h5", _TABLE),
    "flux_map.psi_q_file": by_key(MAP, "file: FILE, psi_q_file: FILE", "x.csv", _TABLE),
    "back_emf.file": by_key(WAVE, "file: FILE", "x.csv", _TABLE),
    "back_emf.files": by_key(WAVE, "files: [good.csv, FILE]", "x.csv", _TABLE),
    "device.file json": by_key(DEVICE, "file: FILE", "x.json", device_files.MAX_BYTES),
    "device.file xml": by_key(DEVICE, "file: FILE", "x.xml", device_files.MAX_BYTES),
    "device.file yaml": by_key(DEVICE, "file: FILE", "x.yaml", device_files.MAX_BYTES),
    "losses.mission": by_key(
        DEVICE, "name: infineon-ff200r12ke3", "x.csv", mission.MOST_BYTES, "losses: {mission: FILE}"
    ),
}
HEADER = f"/* g.h - controller coefficients for a drive */\n/* SHA-256 {'0' * 64} */\n#ifndef G_H\n"
GOOD = "t_s,u_V\n" + "".join(f"{k}e-3,{k % 7}\n" for k in range(40))


def pipe(place: Path) -> None:
    os.mkfifo(place)


def zeros_without_end(place: Path) -> None:
    place.symlink_to("/dev/zero")


def folder(place: Path) -> None:
    place.mkdir()


def circle(place: Path) -> None:
    other = place.with_name("other")
    place.symlink_to(other)
    other.symlink_to(place)


def missing(_: Path) -> None:
    pass


def empty(place: Path) -> None:
    place.write_bytes(b"")


def nul_bytes(place: Path) -> None:
    place.write_bytes(bytes(1000))


KINDS: tuple[Callable[[Path], None], ...] = (
    pipe,
    zeros_without_end,
    folder,
    circle,
    missing,
    empty,
    nul_bytes,
)


def refused(
    entry: Entry, home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> str:
    """The one line that is said of the file."""
    monkeypatch.chdir(home)
    (home / "good.csv").write_text(GOOD, encoding="utf-8")
    (home / "good.h").write_text(HEADER, encoding="utf-8")
    (home / "holder.yaml").write_text(entry.design, encoding="utf-8")
    start = time.monotonic()
    with pytest.raises(SystemExit) as ended:
        cli.main([word.format(file=entry.file) for word in entry.words])
    shown = capsys.readouterr()
    assert ended.value.code == 2, shown.out + shown.err
    assert shown.out == ""
    assert shown.err.startswith("dqforge: ")
    assert shown.err.count("\n") == 1
    assert time.monotonic() - start < 30.0  # it does not wait for a writer
    return shown.err


@pytest.mark.thinned
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("name", ENTRIES)
def test_what_is_no_such_file_is_refused_in_one_line(
    name: str,
    kind: Callable[[Path], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    entry = ENTRIES[name]
    kind(tmp_path / entry.file)
    assert entry.file in refused(entry, tmp_path, monkeypatch, capsys)


@pytest.mark.thinned
@pytest.mark.parametrize("name", ENTRIES)
def test_what_exceeds_the_limit_is_refused_before_it_is_read(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = ENTRIES[name]
    with (tmp_path / entry.file).open("wb") as stream:
        stream.truncate(entry.limit + 1)
    said = refused(entry, tmp_path, monkeypatch, capsys)
    assert f"at most {entry.limit / 1e6:.4g} MB" in said
    assert entry.file in said


@pytest.mark.parametrize("name", ENTRIES)
def test_what_may_not_be_read_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = ENTRIES[name]
    (tmp_path / entry.file).write_bytes(b"1,2\n3,4\n")
    opened = os.open

    def guarded(
        place: Any, *options: Any, **more: Any
    ) -> int:  # a test that runs as root may read everything
        if str(place).endswith(entry.file):
            raise PermissionError(errno.EACCES, "Permission denied", str(place))
        return opened(place, *options, **more)

    monkeypatch.setattr(os, "open", guarded)
    assert "may not be read" in refused(entry, tmp_path, monkeypatch, capsys)


def padded(content: bytes, line: bytes, size: int) -> bytes:
    """A file that is in order, made larger by whole lines."""
    return content + line * (-(-(size + 1 - len(content)) // len(line)))


LONG: dict[str, Callable[[int], bytes]] = {
    "check DESIGN": lambda size: padded(catalogue.read_text(DRIVE), b"# a comment\n", size),
    "losses --mission": lambda size: padded(b"t,n,M\n0,0,0\n", b"# a comment of a line\n", size),
    "bemf FILE": lambda size: padded(
        b"t_s,a_V,b_V,c_V\n0,1,2,3\n1,2,3,4\n", b"# a comment\n", size
    ),
}


@pytest.mark.parametrize("name", LONG)
def test_a_file_in_order_is_refused_beyond_the_limit_and_never_cut(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = ENTRIES[name]
    limit = min(entry.limit, 2_000_000)
    for module, constant in (
        ("machines.files.positioned_yaml", "MAX_BYTES"),
        ("reports.answers.losses", "MOST_BYTES"),
        ("reports.back_emf", "MOST_BYTES"),
    ):
        monkeypatch.setattr(f"dqforge.{module}.{constant}", limit)
    (tmp_path / entry.file).write_bytes(LONG[name](limit))
    assert "at most" in refused(entry, tmp_path, monkeypatch, capsys)


# Commands that read a folder, and the file of it that they read first.
FOLDERS = ((("verify", "out"), "dqforge-manifest.json"), (("compare", "out", DRIVE), "result.json"))


@pytest.mark.thinned
@pytest.mark.parametrize("content", [b"", b"\0" * 1000, b"[" * 100_000, b"{}"])
def test_a_folder_that_holds_no_result_is_refused(
    content: bytes,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "out").mkdir()
    for words, name in FOLDERS:
        (tmp_path / "out" / name).write_bytes(content)
        assert name in refused(Entry("out", words, 0), tmp_path, monkeypatch, capsys)


@pytest.mark.thinned
@pytest.mark.parametrize("kind", KINDS[:4], ids=lambda kind: kind.__name__)
def test_a_folder_whose_result_is_no_file_is_refused(
    kind: Callable[[Path], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "out").mkdir()
    for words, name in FOLDERS:
        kind(tmp_path / "out" / name)
        assert name in refused(Entry("out", words, 0), tmp_path, monkeypatch, capsys)
        place = tmp_path / "out" / "other"
        place.unlink(missing_ok=True)
