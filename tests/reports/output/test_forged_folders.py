"""Folders that were forged with care: a file is changed, added, taken away or exchanged, and the
manifest is made again so that every hash is right. `dqforge verify` finds each.
"""

from __future__ import annotations

import io
import json
import random
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.reports.output import recomputation
from dqforge.reports.output.folder import (
    COMMAND,
    RUN,
    SIMULATION,
    VERIFIED,
    Manifest,
    Part,
    files_below,
    find_manifest,
    put_output,
    sha256,
    to_bytes,
)
from dqforge.reports.output.recomputation import recompute
from dqforge.reports.run import RunOutput, run_again
from dqforge.reports.run_folder import INPUT, INPUT_DESIGN, MANIFEST

BENCH = "paper001-pmsm-bench"
BOX = "control:\n  tolerances: {r_s: 30 %, l_d: 20 %, l_q: 20 %, v_dc: 10 %}\n"
CYCLE = "time [s]; speed [rpm]; torque [N m]\n0; 500; 0.2\n2; 2000; 0.4\n5; 3000; -0.1\n9; 0; 0\n"
LANGUAGES = ("c99", "c++11")


def bench(folder: Path) -> Design:
    """With samples."""
    return load_text(catalogue.read_text(BENCH), "design.yaml", folder)


def with_certificate(folder: Path) -> Design:
    text = catalogue.read_text(BENCH).decode().replace("control:\n", BOX, 1)
    return load_text(text[: text.index("simulation:\n")].encode(), "design.yaml", folder)


def with_mission(folder: Path) -> Design:
    """With a file that the design names."""
    text = catalogue.read_text(BENCH).decode()
    text = re.sub(r"  points:\n(    - .*\n)+", "  mission: cycle.csv\n", text)
    (folder / "cycle.csv").write_text(CYCLE)
    (folder / "design.yaml").write_text(text[: text.index("simulation:\n")])
    return load_design(folder / "design.yaml")


KINDS: dict[str, Callable[[Path], Design]] = {
    "samples": bench,
    "certificate": with_certificate,
    "mission": with_mission,
}


@dataclass(frozen=True)
class Made:
    """A folder as a run leaves it, and what the run gives."""

    output: RunOutput
    files: dict[str, bytes]
    part: Part

    def forge(self, folder: Path, changed: dict[str, bytes | None], **altered: object) -> None:
        """Write the folder with other files, and a manifest that fits."""
        shutil.rmtree(folder, ignore_errors=True)
        files = {key: value for key, value in (self.files | changed).items() if value is not None}
        for name, content in files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        unlisted = altered.pop("unlisted", ())
        assert isinstance(unlisted, tuple)
        hashes = {name: sha256(content) for name, content in files.items() if name not in unlisted}
        digest = self.part.digest
        if any(name.startswith(INPUT) for name in changed) and INPUT_DESIGN in files:
            with suppress(DqforgeError):
                base = folder / INPUT / "files"
                digest = load_text(files[INPUT_DESIGN], "design.yaml", base).digest
        part = replace(self.part, files=hashes, digest=digest, **altered)  # type: ignore[arg-type]
        (folder / MANIFEST).write_bytes(to_bytes(Manifest({RUN: part})))


SOLVED: list[Made] = []


@cache
def solved(kind: str, place: Path) -> Made:
    (place / kind).mkdir()
    design = KINDS[kind](place / kind)
    output = run_again(design, LANGUAGES, {})
    out = place / kind / "out"
    options = {COMMAND: "run", VERIFIED: ",".join(LANGUAGES)}
    put_output(out, RUN, output.files, design, options=options)
    manifest = find_manifest(out)
    assert manifest is not None
    names = sorted({*files_below(out)} - {MANIFEST})
    files = {name: (out / name).read_bytes() for name in names}
    SOLVED.append(Made(output, files, manifest.parts[RUN]))
    return SOLVED[-1]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.fixture
def at_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a design gives that lies unchanged in a folder is taken from the run that wrote it;
    another design is really computed again.
    """

    def again(design: Design, languages: tuple[str, ...], there: dict[str, bytes]) -> RunOutput:
        for made in SOLVED:
            same = made.output.solution.design
            unchanged = (same.digest, same.given) == (design.digest, design.given)
            if unchanged and tuple(languages) == LANGUAGES:
                return made.output
        return run_again(design, languages, there)

    monkeypatch.setattr(recomputation, "run_again", again)


Change = tuple[dict[str, bytes | None], dict[str, object]]


def another_digit(content: bytes, chance: random.Random) -> bytes:
    places = [found.start() for found in re.finditer(rb"[0-9]", content)]
    k = chance.choice(places)
    digit = str((int(content[k : k + 1]) + chance.randint(1, 9)) % 10).encode()
    return content[:k] + digit + content[k + 1 :]


def another_byte(content: bytes, chance: random.Random) -> bytes:
    k = chance.randrange(len(content))
    return content[:k] + bytes([content[k] ^ (1 << chance.randrange(8))]) + content[k + 1 :]


def lines_changed(content: bytes, chance: random.Random) -> bytes:
    lines = content.split(b"\n")
    k = chance.randrange(len(lines) - 1)
    return b"\n".join(
        chance.choice(
            (
                lines[:k] + lines[k + 1 :],
                [*lines[:k], lines[k], *lines[k:]],
                [*lines[:k], lines[k] + b" ", *lines[k + 1 :]],
                [*lines[:k], b"/* 3.1 A */", *lines[k:]],
            )
        )
    )


def json_changed(content: bytes, chance: random.Random) -> bytes:
    """A key twice, an entry more, other white space, or a value anywhere, simulation included."""
    text, kind = content.decode(), chance.randrange(5)
    if '\n "header"' not in text:
        # the certificate: a line per cell
        return chance.choice((text.replace("{", '{"more": 1, ', 1), text + " ")).encode()
    if kind == 0:
        key = chance.choice(re.findall(r'\n +"[a-z_]+": [0-9.e-]+,', text))
        return text.replace(key, re.sub(r": .*", ": 1.25,", key) + key, 1).encode()
    if kind == 1:
        key = chance.choice(re.findall(r'\n "[a-z_]+": ', text))
        return text.replace(key, f"{key}null,{key}", 1).encode()
    if kind == 2:
        return text.replace("\n}", ',\n "more": 1\n}').encode()
    if kind == 3:
        return json.dumps(json.loads(text), indent=chance.choice((None, 2))).encode()
    at = text.find('\n "simulation"')
    head, tail = (text[:at], text[at:]) if at > 0 else ("", text)
    return (head.encode()) + another_digit(tail.encode(), chance)


def samples_changed(content: bytes, chance: random.Random) -> bytes:
    """One bit of one sample, an array more or less, a comment of the archive, other compression."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    kind, made = chance.randrange(5), io.BytesIO()
    name = chance.choice([key for key, values in arrays.items() if values.dtype == np.float64])
    if kind == 0:
        place = chance.randrange(arrays[name].size)
        arrays[name].flat[place] = np.nextafter(arrays[name].flat[place], np.inf)
    elif kind == 1:
        del arrays[name]
    elif kind == 2:
        arrays["more"] = np.zeros(3)
    elif kind == 3:
        with zipfile.ZipFile(made := io.BytesIO(content), "a") as archive:
            archive.comment = b"more"
        return made.getvalue()
    np.savez(made, **arrays)
    return made.getvalue()


def forgeries(made: Made, count: int, seed: int) -> Iterator[tuple[str, Change]]:
    """Changes over all files and kinds in turn."""
    chance = random.Random(seed)
    names = sorted(made.files)
    k = 0
    while k < count:
        name = names[k % len(names)]
        content = made.files[name]
        own = name.removeprefix("dqforge-input/") == name
        kinds = ["byte", "digit", "lines", "gone", "exchanged"]
        kinds += ["unlisted", "emptied"] if own else []
        kinds += ["json"] * 3 if name.endswith(".json") else []
        kinds = ["byte", "samples", "samples", "gone", "unlisted"] if b"\0" in content else kinds
        kind = kinds[(k // len(names)) % len(kinds)]
        altered: dict[str, object] = {}
        changed: dict[str, bytes | None] = {name: content}
        if kind == "byte":
            changed[name] = another_byte(content, chance)
        elif kind == "digit":
            changed[name] = another_digit(content, chance)
        elif kind == "lines":
            changed[name] = lines_changed(content, chance)
        elif kind == "json":
            changed[name] = json_changed(content, chance)
        elif kind == "samples":
            changed[name] = samples_changed(content, chance)
        elif kind == "gone":
            changed[name] = None
        elif kind == "unlisted":
            changed[name] = another_byte(content, chance)
            altered["unlisted"] = (name,)
            if name.endswith((".html", ".npz")):
                altered["options"] = {COMMAND: "export"}
        elif kind == "emptied":
            changed[name] = b""
        else:
            changed[name] = made.files[chance.choice([each for each in names if each != name])]
        now = changed[name]
        plain = None if now is None else now.replace(b"\r\n", b"\n")
        if plain == content and not altered:
            continue
        k += 1
        yield f"{kind} of {name}", (changed, altered)


def refused(folder: Path) -> str:
    try:
        recompute(folder)
    except DqforgeError as error:
        return str(error)
    return ""


@pytest.mark.usefixtures("at_hand")
def test_a_handful_of_forged_folders_is_found(place: Path, tmp_path: Path) -> None:
    """One kind for each file, from another place of the list each time the seed is changed."""
    made = solved("samples", place)
    made.forge(tmp_path / "out", {})
    found = recompute(tmp_path / "out")
    assert (found.listed, found.foreign, found.digits) == ((), (), ())
    assert found.tally.files == len(made.output.files)
    for name, (changed, altered) in forgeries(made, 21, seed=1):
        if INPUT_DESIGN in changed:
            continue  # solved again for each
        made.forge(tmp_path / "out", changed, **altered)
        assert refused(tmp_path / "out"), name


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "count"), [("samples", 84), ("certificate", 63), ("mission", 63)])
@pytest.mark.usefixtures("at_hand")
def test_every_forged_folder_is_found(kind: str, count: int, place: Path, tmp_path: Path) -> None:
    """Two hundred and ten in all, every file in turn."""
    made = solved(kind, place)
    missed = []
    for name, (changed, altered) in forgeries(made, count, seed=count):
        made.forge(tmp_path / "out", changed, **altered)
        if not refused(tmp_path / "out"):
            missed.append(name)
    made.forge(tmp_path / "out", {})
    assert missed == []
    recompute(tmp_path / "out")


@pytest.mark.usefixtures("at_hand")
def test_samples_beside_a_run_are_computed_again(place: Path, tmp_path: Path) -> None:
    """Under the name of the run's: they are the same bytes, and each part stays whole."""
    made, out = solved("samples", place), tmp_path / "out"
    design = made.output.solution.design
    samples = {name: made.files[name] for name in made.files if name.endswith(".npz")}
    options = {COMMAND: "run", VERIFIED: ",".join(LANGUAGES)}
    put_output(out, SIMULATION, samples, design)
    put_output(out, RUN, made.output.files, design, options=options)
    put_output(out, SIMULATION, samples, design)
    recompute(out)
    (name,) = samples
    (out / name).write_bytes(samples_changed(samples[name], random.Random(0)))
    assert name in refused(out)
