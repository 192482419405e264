"""Folders that are forged with care: a file is changed, added, taken away or exchanged, and the
manifest is made again so that every hash is right. `dqforge verify` must find each.

What one is made by is a line, such as ``samples digit bench001.h 4711``: which folder, what is done
to which file, and a number for what is drawn of it. What was not found once is kept in
`tests/corpus/forged`, which `tests/test_corpus.py` tries again.
"""

from __future__ import annotations

import io
import json
import random
import re
import shutil
import sys
import tempfile
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import drawn_cases
import numpy as np
from kept_failures import Campaign

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError
from dqforge.reports.output import recomputation
from dqforge.reports.output.folder import (
    COMMAND,
    RUN,
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

KEPT = Campaign(
    "forged",
    "Forged folders, their list of hashes made again, are found by `verify`",
    "`make forged`, `tests/reports/output/test_forged_folders.py`",
)
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
        unlisted, twice = altered.pop("unlisted", ()), altered.pop("twice", b"")
        assert isinstance(unlisted, tuple)
        assert isinstance(twice, bytes)
        hashes = {name: sha256(content) for name, content in files.items() if name not in unlisted}
        digest = self.part.digest
        if any(name.startswith(INPUT) for name in changed) and INPUT_DESIGN in files:
            with suppress(DqforgeError):
                base = folder / INPUT / "files"
                digest = load_text(files[INPUT_DESIGN], "design.yaml", base).digest
        told = {"digest": digest, **altered}
        part = replace(self.part, files=hashes, **told)  # type: ignore[arg-type]
        listed = to_bytes(Manifest({RUN: part}))
        (folder / MANIFEST).write_bytes(listed.replace(twice, twice + twice, 1))


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


@contextmanager
def at_hand() -> Iterator[None]:
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

    vars(recomputation)["run_again"] = again
    try:
        yield
    finally:
        vars(recomputation)["run_again"] = run_again


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


def refused(folder: Path) -> str:
    try:
        recompute(folder)
    except DqforgeError as error:
        return str(error)
    return ""


def in_part(content: bytes, part: str, chance: random.Random) -> bytes:
    """Another digit in a comment of C, outside of them, or in what a page shows."""
    patterns = {
        "comment": rb"/\*.*?\*/",
        "constant": rb"^#define .*$|^ *\{.*$",
        "shown": rb">[^<]+<",
    }
    found = [
        each
        for each in re.finditer(patterns[part], content, re.DOTALL if part == "comment" else re.M)
        if re.search(rb"[0-9]", each[0])
    ]
    if not found:
        return content
    one = chance.choice(found)
    return content[: one.start()] + another_digit(one[0], chance) + content[one.end() :]


def spaced(content: bytes, chance: random.Random) -> bytes:
    """White space more, less or other."""
    places = [found.start() for found in re.finditer(rb"[ \n]", content)]
    if not places:
        return content + b" "
    k = chance.choice(places)
    other = chance.choice([b"", b"  ", b"\t", b"\n", b"\r"])
    return content[:k] + other + content[k + 1 :]


def repacked(content: bytes, chance: random.Random) -> bytes:
    """The same samples in another archive: date, order, attributes, extra field, comment."""
    made, kind = io.BytesIO(), chance.randrange(6)
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w") as new:
        entries = old.infolist()
        for entry in reversed(entries) if kind == 0 else entries:
            info = zipfile.ZipInfo(entry.filename, entry.date_time)
            info.compress_type, info.external_attr = entry.compress_type, entry.external_attr
            info.create_system = entry.create_system
            if kind == 1:
                info.date_time = (2001, 2, 3, 4, 5, 6)
            elif kind == 2:
                info.external_attr ^= 0o111 << 16
            elif kind == 3:
                info.comment = b"more"
            elif kind == 4:
                info.extra = b"\xfe\xca\x00\x00"
            elif kind == 5:
                info.compress_type = zipfile.ZIP_DEFLATED
            new.writestr(info, old.read(entry))
    return made.getvalue()


CHANGES: dict[str, Callable[[bytes, random.Random], bytes]] = {
    "byte": another_byte,
    "digit": another_digit,
    "lines": lines_changed,
    "json": json_changed,
    "samples": samples_changed,
    "repacked": repacked,
    "space": spaced,
    "comment": lambda content, chance: in_part(content, "comment", chance),
    "constant": lambda content, chance: in_part(content, "constant", chance),
    "shown": lambda content, chance: in_part(content, "shown", chance),
    "emptied": lambda _content, _chance: b"",
    "cut": lambda content, chance: content[: chance.randrange(len(content))],
    "longer": lambda content, chance: (
        content + chance.choice([b"\0", b"\n", b" ", b"/* */\n", b"PK\x05\x06" + bytes(18)])
    ),
}

# What the list of hashes says beside them.
ALTERED: dict[str, Callable[[Made, random.Random], dict[str, object]]] = {
    "options": lambda made, chance: {
        "options": made.part.options
        | chance.choice(
            [
                {COMMAND: "export"},
                {VERIFIED: ""},
                {VERIFIED: "c99"},
                {"more": "yes"},
                {COMMAND: "x"},
            ]
        )
    },
    "version": lambda _made, _chance: {"version": "0.0.1"},
    "digest": lambda made, chance: {
        "digest": another_byte(made.part.digest.encode(), chance).decode("ascii", "replace")
    },
    "name": lambda made, _chance: {"design": made.part.design + "s"},
    "twice": lambda _made, chance: {
        "twice": chance.choice([b' "layout": 2,\n', b'   "dqforge": "'[:0] or b' "layout": 2,\n'])
    },
}
ADDED = ("added.h", "listed.txt", "unlisted.npz", "dqforge-input/more.yaml", "note.txt")


def kinds_of(name: str, content: bytes) -> list[str]:
    """What is done to a file."""
    if b"\0" in content:
        kinds = ["byte", "samples", "repacked", "cut", "longer", "emptied", "exchanged", "renamed"]
    else:
        kinds = ["byte", "digit", "lines", "space", "cut", "longer", "exchanged", "renamed"]
        kinds += ["json"] * 3 if name.endswith(".json") else []
        kinds += ["comment", "constant"] if name.endswith(".h") else []
        kinds += ["shown"] * 3 if name.endswith(".html") else []
        kinds += ["emptied"] if not name.startswith(f"{INPUT}/") else []
    return [*kinds, "gone", *(["unlisted"] if not name.startswith(f"{INPUT}/") else [])]


def lines_drawn(kind: str, made: Made, count: int, seed: str) -> list[str]:
    """Every file with all that is done to it in turn, and the list of hashes itself."""
    chance = random.Random(f"{seed} {kind}")
    todo = [f"{each} {name}" for name in made.files for each in kinds_of(name, made.files[name])]
    todo += [f"{each} {MANIFEST}" for each in ALTERED] + [f"added {name}" for name in ADDED]
    chance.shuffle(todo)
    return [f"{kind} {todo[k % len(todo)]} {chance.randrange(1_000_000)}" for k in range(count)]


def change(line: str, made: Made, others: list[Made]) -> Change:  # noqa: PLR0911 - one for each kind
    """What a line does; nothing where that is by chance no change."""
    _, kind, name, _ = line.split()
    chance = random.Random(line)
    prefix = made.output.solution.design.export.prefix
    if kind in ALTERED:
        return {}, ALTERED[kind](made, chance)
    if kind == "added":
        altered: dict[str, object] = {}
        if not name.startswith(INPUT):
            name = f"{prefix}_{name}" if name != "note.txt" else name
        if "unlisted" in name:
            altered["unlisted"] = (name,)
        return {name: b"/* dqforge */\n#define MORE (1)\n"}, altered
    content = made.files[name]
    if kind == "gone":
        return {name: None}, {}
    if kind == "renamed":
        return {name: None, f"{prefix}_renamed{Path(name).suffix}": content}, {}
    if kind == "exchanged":
        theirs = [*made.files.values(), *(each.files.get(name, b"") for each in others)]
        new = chance.choice([each for each in theirs if each != content])
    elif kind == "unlisted":
        options: dict[str, object] = {"unlisted": (name,)}
        if name.endswith((".html", ".npz")):
            options["options"] = {COMMAND: "export"}
        return {name: another_byte(content, chance)}, options
    else:
        new = CHANGES[kind](content, chance)
    if new.replace(b"\r\n", b"\n") == content.replace(b"\r\n", b"\n"):
        return {}, {}
    return {name: new}, {}


def _others(made: Made) -> list[Made]:
    return [each for each in SOLVED if each is not made]


def found(line: str, place: Path) -> bool:
    """Whether a forged folder is told from one that is not; True where the line changes nothing."""
    kind = line.partition(" ")[0]
    made = solved(kind, place)
    files, altered = change(line, made, _others(made))
    if not files and not altered:
        return True
    made.forge(place / "forged", files, **altered)
    with at_hand():
        return bool(refused(place / "forged"))


def main(words: list[str]) -> int:
    """So many over all folders, drawn by the commit, or the line that is given."""
    again = len(words) == 1 and not words[0].isdigit()
    count = int(words[0]) if words and not again else 100
    missed, tried = [], Counter[str]()
    with tempfile.TemporaryDirectory(prefix="forged-") as folder:
        lines = list(words) if again else []
        whole = {} if again else {kind: solved(kind, Path(folder)) for kind in KINDS}
        for number, (kind, made) in enumerate(whole.items()):
            share = (count + number) // len(KINDS)
            drawn = lines_drawn(kind, made, 2 * share, drawn_cases.seed())
            lines += [line for line in drawn if any(change(line, made, _others(made)))][:share]
        for line in lines:
            tried[line.split()[1]] += 1
            if not found(line, Path(folder)):
                missed.append(line)
                sys.stdout.write(f"{line}: not found\n")
                sys.stdout.flush()
    if not again:
        sys.stdout.write(KEPT.ended(tried, missed))
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
