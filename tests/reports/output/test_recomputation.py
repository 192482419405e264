"""`dqforge verify` computes everything in a folder again: each change by hand is found,
with both values.
"""

from __future__ import annotations

import json
import random
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, InputError, VerificationError
from dqforge.reports.output import recomputation
from dqforge.reports.output.folder import (
    COMMAND,
    FIGURES,
    PENDING,
    RUN,
    Manifest,
    find_manifest,
    part_of,
    put_output,
    sha256,
    to_bytes,
    write_output,
)
from dqforge.reports.output.recomputation import (
    Tally,
    first_difference,
    recomputation_text,
    recompute,
    tally,
)
from dqforge.reports.run import RunOutput, export_design
from dqforge.reports.run_folder import INPUT_DESIGN, MANIFEST

BENCH = "paper001-pmsm-bench"
DRIVES = (
    BENCH,
    "paper000-ipmsm-100kw",
    "paper002-phase-waveforms",
    "abb-syrm-6k7-saturated",
    "thor-pmsyrm-5k",
)
CYCLE = "time [s]; speed [rpm]; torque [N m]\n0; 500; 0.2\n2; 2000; 0.4\n5; 3000; -0.1\n9; 0; 0\n"
_NUMBER = re.compile(rb"(?<![A-Za-z0-9_.])-?(?:0x[0-9A-F]+|\d+\.\d+(?:e-?\d+)?|\d+)")


@cache
def exported(name: str) -> RunOutput:
    return export_design(catalogue.load(name), verify=False)


@dataclass(frozen=True)
class Written:
    """A folder of a library drive whose solution is at hand: only what is
    compared is computed again.
    """

    folder: Path
    files: dict[str, bytes]

    def restore(self) -> None:
        for name, content in self.files.items():
            (self.folder / name).write_bytes(content)


def write(name: str, folder: Path) -> Written:
    output = exported(name)
    put_output(folder, RUN, output.files, output.solution.design, options={COMMAND: "export"})
    return read(folder)


def read(folder: Path) -> Written:
    files = {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }
    return Written(folder, files)


@pytest.fixture
def at_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solution of a design that lies unchanged in a folder is the one that was
    found when it was written.
    """

    def known(design: Design) -> str | None:
        names = (name for name in DRIVES if sha256(catalogue.read_text(name)) == design.digest)
        return next(names, None)

    def export(design: Design, *, verify: bool) -> RunOutput:
        name = known(design)
        return export_design(design, verify=verify) if name is None else exported(name)

    monkeypatch.setattr(recomputation, "export_design", export)


def test_a_folder_of_a_run_is_vouched_for_in_numbers(tmp_path: Path) -> None:
    """Nothing is at hand here: the design is read and solved again."""
    written = write(BENCH, tmp_path / "out")
    found = recompute(written.folder)
    header = written.files["bench001.h"].decode()
    assert found.tally.files == len(exported(BENCH).files)
    assert (
        found.tally.macros
        >= len(re.findall(r"^#define BENCH001_\w+ \(", header, re.MULTILINE))
        > 30
    )
    assert found.tally.vectors == len(
        re.findall(r"^    \{ 0x", written.files["bench001_vectors.h"].decode(), re.M)
    )
    assert found.tally.checksums == 3
    assert found.tally.entries > 500
    assert found.listed == ()
    (written.folder / "notes.txt").write_text("mine")
    put_output(written.folder, FIGURES, {"figure.svg": b"<svg/>"})
    first, second, third = recomputation_text(recompute(written.folder)).split("\n")
    assert first.startswith("not computed again")
    assert first.endswith(": figure.svg")
    assert second.endswith("not checked: notes.txt")
    assert f"{found.tally.macros} macros" in third


@pytest.mark.parametrize(
    ("pattern", "by", "says"),
    [
        (
            r"(_IQ_KP_V_PER_A) \([^)]*\)",
            r"\1 (99.0F)",
            r"BENCH001_IQ_KP_V_PER_A is 99.0F, the design gives [0-9.]+F$",
        ),
        (r"(_POLE_PAIRS) \(3\)", r"\1 (7)", r"BENCH001_POLE_PAIRS is 7, the design gives 3$"),
        (
            r"(_R_S_OHM) \([^)]*\)",
            r"\1 (-5.0F)",
            r"BENCH001_R_S_OHM is .*-.*, the design gives .*2.35F$",
        ),
        (
            r"SHA-256 [0-9a-f]{64}",
            "SHA-256 " + "0" * 64,
            r"0{60}\.\.\., the design gives [0-9a-f]{60}\.\.\.$",
        ),
        (
            r"( i_d | torque )(\d\.\d+e?-?\d*) (A|N m)",
            r"\g<1>9.9 \3",
            r"9.9, the design gives [0-9.e-]+$",
        ),
        (r"\n#endif", "\n\n#endif", r"'#endif'|nothing"),
        (r"static inline void", "static  inline void", r"is|gives"),
    ],
)
@pytest.mark.usefixtures("at_hand")
def test_the_first_difference_has_its_place_and_both_values(
    pattern: str, by: str, says: str, tmp_path: Path
) -> None:
    written = write(BENCH, tmp_path / "out")
    header = written.folder / "bench001.h"
    text = header.read_text()
    changed = re.sub(pattern, by, text, count=1)
    assert changed != text
    header.write_text(changed)
    with pytest.raises(VerificationError, match=rf"^{re.escape(str(header))}:\d+: .*({says})"):
        recompute(written.folder)


def other_number(text: bytes, chance: random.Random) -> bytes:
    """Another number of the same kind."""
    digits = [
        k
        for k in range(len(text))
        if text[k : k + 1].isdigit() and not text[: k + 1].endswith(b"0x")
    ]
    k = chance.choice([place for place in digits if not (text.startswith(b"0x") and place < 2)])
    digit = str((int(text[k : k + 1]) + chance.randint(1, 9)) % 10).encode()
    return text[:k] + digit + text[k + 1 :]


def changes(
    written: Written, count: int, seed: int, drives: tuple[str, ...]
) -> Iterator[tuple[str, bytes]]:
    """Files with one change each: numbers anywhere, lines gone, doubled or exchanged,
    files of another run.
    """
    chance = random.Random(seed)
    names = sorted(written.files)
    other = {name: content for drive in drives for name, content in exported(drive).files.items()}
    kinds = (
        "number",
        "number",
        "number",
        "number",
        "line",
        "twice",
        "order",
        "sign",
        "other",
        "byte",
    )
    made = 0
    while made < count:
        name, kind = chance.choice(names), kinds[made % len(kinds)]
        content = written.files[name]
        lines = content.split(b"\n")
        k = chance.randrange(len(lines) - 1)
        numbers = list(_NUMBER.finditer(content))
        if kind == "number" and numbers:
            hit = chance.choice(numbers)
            changed = content[: hit.start()] + other_number(hit[0], chance) + content[hit.end() :]
        elif kind == "line":
            changed = b"\n".join(lines[:k] + lines[k + 1 :])
        elif kind == "twice":
            changed = b"\n".join([*lines[:k], lines[k], *lines[k:]])
        elif kind == "order":
            changed = b"\n".join([*lines[:k], lines[k + 1], lines[k], *lines[k + 2 :]])
        elif kind == "sign" and numbers:
            hit = chance.choice(numbers)
            sign = hit[0][1:] if hit[0].startswith(b"-") else b"-" + hit[0]
            changed = content[: hit.start()] + sign + content[hit.end() :]
        elif kind == "other":
            changed = chance.choice([entry for entry in other.values() if entry != content])
        else:
            place = chance.randrange(len(content))
            changed = (
                content[:place]
                + bytes([content[place] ^ (1 << chance.randrange(7))])
                + content[place + 1 :]
            )
        if changed != content and changed.replace(b"\r\n", b"\n") != content:
            made += 1
            yield name, changed


def forge(folder: Path) -> None:
    """Make the manifest again for what lies in a folder now."""
    manifest = find_manifest(folder)
    assert manifest is not None
    parts = {}
    for name, part in manifest.parts.items():
        there = {key: (folder / key).read_bytes() for key in part.files if (folder / key).exists()}
        parts[name] = replace(part, files=part_of("", there).files)
    (folder / MANIFEST).write_bytes(to_bytes(Manifest(parts)))


def refused(folder: Path) -> bool:
    try:
        recompute(folder)
    except DqforgeError:
        return True
    return False


def was(written: Written, name: str) -> str:
    return written.files[name].decode("latin1")


@pytest.mark.parametrize(
    ("drive", "count", "drives"),
    [
        (BENCH, 20, (BENCH,)),
        *(pytest.param(name, 100, DRIVES, marks=pytest.mark.slow) for name in DRIVES),
    ],
)
@pytest.mark.usefixtures("at_hand")
def test_every_change_by_hand_is_found(
    drive: str, count: int, drives: tuple[str, ...], tmp_path: Path
) -> None:
    """One hundred for each of five drives; with the manifest forged to fit, those of what is
    computed again as well.
    """
    written = write(drive, tmp_path / "out")
    recompute(written.folder)
    computed = exported(drive).files
    for name, changed in changes(written, count, seed=len(drive), drives=drives):
        (written.folder / name).write_bytes(changed)
        assert refused(written.folder), (
            f"{name}: {first_difference(changed.decode('latin1'), was(written, name))}"
        )
        if name in computed:
            forge(written.folder)
            with pytest.raises(DqforgeError):
                recompute(written.folder)
        written.restore()
    recompute(written.folder)


@pytest.mark.usefixtures("at_hand")
def test_files_of_two_runs_are_found(tmp_path: Path) -> None:
    """Each file alone, and all but one, from a run of the same drive with other settings."""
    written = write(BENCH, tmp_path / "out")
    text = catalogue.read_text(BENCH).replace(b"2.35 Ohm", b"2.36 Ohm")
    other = load_text(text, "design.yaml")
    write_output(tmp_path / "other", RUN, export_design(other, verify=False).files, other)
    differing = [
        name
        for name in written.files
        if (tmp_path / "other" / name).read_bytes() != written.files[name]
    ]
    assert len(differing) > 4
    for name in differing:
        shutil.copy(tmp_path / "other" / name, written.folder / name)
        with pytest.raises(DqforgeError):
            recompute(written.folder)
        for rest in differing:
            if rest != name:
                shutil.copy(tmp_path / "other" / rest, written.folder / rest)
        shutil.copyfile(tmp_path / "out" / name, tmp_path / "kept")
        (written.folder / name).write_bytes(written.files[name])
        with pytest.raises(DqforgeError):
            recompute(written.folder)
        written.restore()


@pytest.mark.usefixtures("at_hand")
def test_line_endings_alone_are_no_difference_but_told(tmp_path: Path) -> None:
    """What git's autocrlf and editors do; blanks are a change."""
    written = write(BENCH, tmp_path / "out")
    for name, content in written.files.items():
        (written.folder / name).write_bytes(content.replace(b"\n", b"\r\n"))
    found = recompute(written.folder)
    assert set(found.line_ends) == set(written.files) - {MANIFEST}
    assert "with other line endings" in recomputation_text(found)
    for before, after in ((b"\n", b" \n"), (b"    ", b"\t"), (b"\n", b"\r")):
        written.restore()
        header = written.folder / "bench001.h"
        header.write_bytes(written.files["bench001.h"].replace(before, after, 1))
        with pytest.raises(VerificationError, match="the design gives"):
            recompute(written.folder)


def test_what_is_missing_or_of_another_version_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = write(BENCH, tmp_path / "out")
    for name in written.files:
        (written.folder / name).unlink()
        with pytest.raises(
            InputError, match=rf"{re.escape(name)}: cannot be read .*; give the folder that"
        ):
            recompute(written.folder)
        written.restore()
    (written.folder / PENDING).mkdir()
    with pytest.raises(
        InputError,
        match="a run was interrupted while it put its files in place; run the design again",
    ):
        recompute(written.folder)
    (written.folder / PENDING).rmdir()
    monkeypatch.setattr(recomputation, "__version__", "9.9.9")
    with pytest.raises(
        InputError,
        match=r"written by dqforge .*, this is 9\.9\.9; verify with that version, or run",
    ):
        recompute(written.folder)


@pytest.mark.usefixtures("at_hand")
def test_other_libraries_are_named_beside_a_difference(tmp_path: Path) -> None:
    written = write(BENCH, tmp_path / "out")
    manifest = find_manifest(written.folder)
    assert manifest is not None
    part = manifest.parts[RUN]
    elsewhere = replace(part, computed_with=part.computed_with | {"numpy": "1.0"})
    (written.folder / MANIFEST).write_bytes(to_bytes(Manifest({RUN: elsewhere})))
    recompute(written.folder)
    header = written.folder / "bench001.h"
    text = header.read_text()
    gain = re.search(r"_IQ_KP_V_PER_A \((.*)F\)", text)
    assert gain is not None
    header.write_text(text.replace(gain[1], f"{float(gain[1]) * (1.0 + 2e-7):.9g}"))
    forge(written.folder)
    (digits,) = recompute(written.folder).digits
    assert re.search(r"KP_V_PER_A is .*F, the design gives .*F \(the run had numpy 1\.0", digits)
    assert "within the last digits" in recomputation_text(recompute(written.folder))
    header.write_text(text.replace(gain[1], f"{float(gain[1]) * (1.0 + 2e-6):.9g}"))
    forge(written.folder)
    with pytest.raises(VerificationError, match=r"changed, beyond .* numpy 1\.0, here .*\)$"):
        recompute(written.folder)
    header.write_text(text.replace("(3)", "(4)"))
    forge(written.folder)
    with pytest.raises(VerificationError, match=r"POLE_PAIRS is 4, .*: last digits may differ\)$"):
        recompute(written.folder)


def test_a_design_with_files_is_computed_again_from_its_copies(tmp_path: Path) -> None:
    """A mission in a folder below the design.

    The copy in the output folder suffices, also with other line endings.
    """
    home = tmp_path / "home"
    (home / "data").mkdir(parents=True)
    (home / "data" / "cycle.csv").write_text(CYCLE)
    points = (
        "  points:\n    - {torque: 0.47 N m, speed: 1200 rpm}\n"
        "    - {torque: 0.47 N m, speed: 5000 rpm}\n"
    )
    text = catalogue.read_text(BENCH).decode()
    assert points in text
    (home / "design.yaml").write_text(text.replace(points, "  mission: data/../data/cycle.csv\n"))
    loaded = load_design(home / "design.yaml")
    out = tmp_path / "out"
    write_output(out, RUN, export_design(loaded, verify=False).files, loaded)
    shutil.rmtree(home)
    copy = out / "dqforge-input/files/data/cycle.csv"
    copy.write_bytes(copy.read_bytes().replace(b"\n", b"\r\n"))
    assert recompute(out).line_ends == ("dqforge-input/files/data/cycle.csv",)
    copy.write_bytes(copy.read_bytes().replace(b"0.2", b"0.3", 1))
    with pytest.raises(
        VerificationError, match=r"cycle\.csv: the SHA-256 is .*, dqforge-manifest\.json lists"
    ):
        recompute(out)
    (out / INPUT_DESIGN).write_text("name: other\n")
    with pytest.raises(VerificationError, match=r"(design\.yaml|cycle\.csv): the SHA-256 is"):
        recompute(out)


def test_first_difference_names_line_and_tokens() -> None:
    assert first_difference("a\nb\n", "a\nb\n") is None
    found = first_difference("a\n#define K (1.5F) /* V */\n", "a\n#define K (2.5F) /* V */\n")
    assert str(found) == "2: K is 1.5F, the design gives 2.5F"
    assert (
        str(first_difference('{\n "kp": 99\n}', '{\n "kp": 5.8\n}'))
        == "2: kp is 99, the design gives 5.8"
    )
    assert str(first_difference("a\n", "a\nb\n")) == "2: nothing, the design gives b"
    assert str(first_difference("a", "a\nb")) == "2: no such line, the design gives b"
    assert str(first_difference("a\nb", "a")) == "2: b, the design gives its end"
    assert str(first_difference("x = y - 1;", "x = y + 1;")) == "1: -, the design gives +"


def test_tally_counts_each_kind() -> None:
    text = (
        "/* SHA-256 "
        + "ab" * 32
        + "; bound 1.5e-3 A, 2 N m */\n#define A (3) /* 4 pairs */\n#define GUARD\n"
        "static const float t[2] = { 1.0F, -2.0e-3F };\nint f(void) { return 0x10U + 7; }\n"
    )
    assert tally("a.h", text) == Tally(files=1, macros=1, literals=5, figures=3, checksums=1)
    vectors = (
        "#define N (2U)\nstatic const v_t v[2] = {\n    { 0x01U, 2U },\n    { 0x03U, 4U },\n};\n"
    )
    assert tally("a_vectors.h", vectors) == Tally(files=1, macros=1, literals=1, vectors=2)
    assert tally("result.json", json.dumps({"a": [1, {"b": None}], "c": "x"})) == Tally(
        files=1, entries=3
    )
