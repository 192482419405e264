"""What lies in an output folder, held against what the designs in it give when
everything is computed again.
"""

from __future__ import annotations

import io
import json
import posixpath
import re
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from itertools import zip_longest
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge import __version__
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import MAX_FILE_BYTES, Design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_loop_proof import (
    Confirmation,
    confirm,
    confirm_sensitivity,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.firmware.design_simulation import simulate_with_firmware
from dqforge.reports.firmware.target import decoded_file
from dqforge.reports.loops.firmware_text import CERTIFICATE
from dqforge.reports.operating_system.packages import computed_with
from dqforge.reports.output.folder import (
    COMMAND,
    EXISTING,
    FIRMWARE,
    FIRMWARES,
    PENDING,
    RUN,
    SIMULATION,
    SWITCHED,
    VERIFIED,
    Manifest,
    Part,
    files_below,
    input_root,
    named_in_folder,
    read_manifest,
    sha256,
)
from dqforge.reports.pages.answer import LARGEST_JSON, read_output, stage
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.run import export_design, run_again, solved_files
from dqforge.reports.run_folder import INPUT, INPUT_DESIGN, MANIFEST, REPORT, RESULT
from dqforge.reports.simulation.design_run import simulation_files
from dqforge.reports.verification.independent import OBSERVER_SUFFIX, SPEED_SUFFIX, SUFFIX

_AGAIN = "run the design again"
_DESIGN = "design.yaml"
_HEAD = 2048  # Bytes at the head of a text in which it says what made it.

_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


_CHECKSUM = re.compile(r"\b[0-9a-f]{64}\b")


_NUMBER = re.compile(
    r"(?<![A-Za-z0-9_.])(?<![A-Za-z]-)[-+]?(?:0x[0-9A-Fa-f]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[FfUuLl]*\b"
)


_MACRO = re.compile(r"^#define ([A-Za-z_]\w*)[ \t]+(\S.*)$", re.MULTILINE)


_ROW = re.compile(r"^\s*\{.*\},?\s*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Tally:
    """What emitted files hold.

    Macros with a value, literals in code and tables, rows of test vectors, figures in comments,
    checksums of the input, and single values of the result.
    """

    files: int = 0
    macros: int = 0
    literals: int = 0
    vectors: int = 0
    figures: int = 0
    checksums: int = 0
    entries: int = 0

    def __add__(self, other: Tally) -> Tally:
        names = self.__dataclass_fields__
        return Tally(**{name: getattr(self, name) + getattr(other, name) for name in names})


def _leaves(value: Any) -> int:
    if isinstance(value, dict):
        return sum(map(_leaves, value.values()))
    if isinstance(value, list):
        return sum(map(_leaves, value))
    return 1


def tally(name: str, text: str) -> Tally:
    """What a file holds, by its name."""
    if name.endswith(".json"):
        return Tally(files=1, entries=_leaves(json.loads(text)))
    comments = " ".join(_COMMENT.findall(text))
    code = _COMMENT.sub(" ", text)
    checksums = len(_CHECKSUM.findall(comments))
    macros = len(_MACRO.findall(code))
    code = _MACRO.sub("", code)
    rows = _ROW.findall(code) if name.endswith("_vectors.h") else []
    rest = _ROW.sub("", code) if rows else code
    counted = Counter(
        files=1, macros=macros, literals=len(_NUMBER.findall(rest)), vectors=len(rows)
    )
    figures = len(_NUMBER.findall(_CHECKSUM.sub("", comments)))
    return Tally(**counted, figures=figures, checksums=checksums)


@dataclass(frozen=True, slots=True)
class Recomputation:
    """Outcome of a comparison that found no difference.

    ``digest`` is that of the design, ``solution`` what it gives, None where nothing in the folder
    comes of a run. ``tally`` counts what was recomputed; ``listed`` names files that only had to
    have the SHA-256 of the manifest, ``foreign`` those that dqforge did not write, ``line_ends``
    those whose line endings alone were changed. ``digits`` says of files that were made with other
    libraries or on another processor where their last digits first differ, ``stale`` names those of
    another state of the design.
    """

    digest: str
    solution: Solution | None
    tally: Tally
    listed: tuple[str, ...]
    foreign: tuple[str, ...]
    line_ends: tuple[str, ...]
    digits: tuple[str, ...] = ()
    stale: tuple[str, ...] = ()


def _with_line_ends(content: bytes) -> tuple[bytes, ...]:
    """A content, and what it was if an editor or git changed the ends of its lines."""
    plain = content.replace(b"\r\n", b"\n")
    return (content,) if b"\0" in content else (content, plain, plain.replace(b"\n", b"\r\n"))


def _as_listed(content: bytes, digest: str) -> bytes | None:
    """The content that the manifest lists, whatever its line endings are now."""
    return next(
        (variant for variant in _with_line_ends(content) if sha256(variant) == digest), None
    )


def _not_listed(path: Path, content: bytes, digest: str) -> VerificationError:
    return VerificationError(
        f"{path}: the SHA-256 is {sha256(content)}, {MANIFEST} lists {digest}; it was changed or "
        "comes from another run"
    )


def _read_inputs(
    folder: Path, root: str, part: Part, contents: Mapping[str, bytes]
) -> dict[str, bytes]:
    """What a part was made from, as it was then, by names below ``root``."""
    inputs = {}
    for name, digest in part.files.items():
        below = name.removeprefix(f"{root}/")
        if below == name:
            continue
        listed = _as_listed(contents[name], digest)
        if listed is None:
            raise _not_listed(folder / name, contents[name], digest)
        inputs[below] = listed
    if _DESIGN not in inputs:
        raise InputError(f"lists no {root}/{_DESIGN}; {_AGAIN}", source=str(folder / MANIFEST))
    return inputs


def _load(folder: Path, root: str, inputs: Mapping[str, bytes], part: Part) -> Design:
    """The design of a part, read from a copy of what it was read from."""
    with scratch_folder() as copy:
        for name, content in inputs.items():
            path = copy / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        source = str(folder / root / _DESIGN)
        design = load_text(inputs[_DESIGN], source, copy / "files")
    if design.digest != part.digest:
        raise VerificationError(
            f"{folder / MANIFEST}: design_sha256 is {part.digest}, the design in the folder has "
            f"{design.digest}"
        )
    if part.design != named_in_folder(design):
        raise VerificationError(
            f"{folder / MANIFEST}: the design is {part.design}, in the folder it is "
            f"{named_in_folder(design)}"
        )
    given = () if design.given is None else design.given.named
    known = {_DESIGN, part.options.get(EXISTING, _DESIGN)}
    known |= {f"files/{posixpath.normpath(name)}" for name, _ in given}
    for name in inputs:
        if name not in known:
            raise VerificationError(
                f"{folder / root / name}: the design names no such file; {_AGAIN}"
            )
    return design


def _elsewhere(part: Part) -> str:
    """What a difference may come from beside a change: other libraries or another
    processor than the run had.
    """
    now = computed_with()
    other = [
        name
        for name in sorted({*now, *part.computed_with})
        if now.get(name) != part.computed_with.get(name)
    ]
    if not other:
        return ""
    pairs = (
        f"{name} {part.computed_with.get(name, 'none')}, here {now.get(name, 'none')}"
        for name in other
    )
    return f" (the run had {'; '.join(pairs)}: last digits may differ)"


@dataclass(slots=True)
class _Comparison:
    """What was compared so far."""

    folder: Path
    contents: Mapping[str, bytes]
    tally: Tally = field(default_factory=Tally)
    digits: list[str] = field(default_factory=list)
    known: set[str] = field(default_factory=set)

    def hold(self, part: Part, manifest: Manifest, expected: Mapping[str, bytes]) -> None:
        """Compare what a part must hold; raises VerificationError with the first difference."""
        for name, content in expected.items():
            if name not in manifest.files:
                raise VerificationError(
                    f"{self.folder / MANIFEST}: {name} is not listed, the design gives it"
                )
            if name in part.files:
                self._compare(name, content, part)
        for name in part.files:
            if name not in expected and not name.startswith(f"{INPUT}/"):
                raise VerificationError(
                    f"{self.folder / name}: the design gives no such file; {_AGAIN}"
                )
        self.known |= {*expected}

    def _compare(self, name: str, expected: bytes, part: Part) -> None:
        binary = b"\0" in expected
        have = self.contents[name] if binary else self.contents[name].replace(b"\r\n", b"\n")
        if have != expected.replace(b"\r\n", b"\n" if not binary else b"\r\n"):
            self._differs(name, have, expected, part)
        if name not in self.known:
            text = "" if binary or name == REPORT else expected.decode("utf-8", "replace")
            self.tally += tally(name, text) if text else Tally(files=1)

    def _differs(self, name: str, have: bytes, expected: bytes, part: Part) -> None:
        """Raise, unless other libraries or another processor explain what differs."""
        elsewhere, path = _elsewhere(part), self.folder / name
        if b"\0" in expected:
            first = changed_sample(have, expected, exact=True) or ": other bytes of equal samples"
            beyond = changed_sample(have, expected)
        else:
            texts = have.decode("utf-8", "backslashreplace"), expected.decode("utf-8", "replace")
            first = f":{first_difference(*texts)}"
            changed = changed_value(*texts, name)
            beyond = None if changed is None else f":{changed}"
        if not elsewhere:
            raise VerificationError(f"{path}{first}")
        if beyond is not None:
            raise VerificationError(f"{path}{beyond}: changed, beyond {BOUND}{elsewhere}")
        self.digits.append(f"{name}{first}{elsewhere}")


def read_listed(folder: Path) -> tuple[Manifest, dict[str, bytes]]:
    """The manifest of a folder and the contents of all files that it lists.

    Raises:
        InputError: There is no manifest, a file is missing, or a run was cut off while it moved its
            files.
    """
    if (folder / PENDING).exists():
        raise InputError(
            f"a run was interrupted while it put its files in place; {_AGAIN}", source=str(folder)
        )
    manifest = read_manifest(folder)
    wanted = f"the folder that 'dqforge run' or 'dqforge export' wrote, or {_AGAIN}"
    return manifest, {
        name: read_output(folder / name, wanted, MAX_FILE_BYTES) for name in manifest.files
    }


def _check_version(folder: Path, part: Part) -> None:
    if part.version != __version__:
        raise InputError(
            f"written by dqforge {part.version}, this is {__version__}; verify with that version, "
            f"or {_AGAIN}",
            source=str(folder / MANIFEST),
        )


def _check_options(folder: Path, part: Part, known: Mapping[str, Iterable[str]]) -> None:
    """Refuse options that no command writes."""
    for key, value in part.options.items():
        if value not in known.get(key, ()):
            raise VerificationError(
                f"{folder / MANIFEST}: {key} is {value!r}, which no command writes; {_AGAIN}"
            )


def _run(
    folder: Path, part: Part, design: Design, contents: Mapping[str, bytes]
) -> tuple[Solution, dict[str, bytes]]:
    """What `dqforge run`, or `export`, makes of a design."""
    known = {COMMAND: ("run", "export"), VERIFIED: ("", "c99", "c99,c++11")}
    _check_options(folder, part, known)
    if part.options.get(COMMAND) != "run":
        output = export_design(design, verify=False)
    else:
        verified = part.options.get(VERIFIED, "")
        there = {
            name: _as_listed(contents[name], digest) or contents[name]
            for name, digest in part.files.items()
        }
        output = run_again(design, verified.split(",") if verified else (), there)
    return output.solution, output.files


def _simulated(
    folder: Path, part: Part, design: Design, solution: Solution | None
) -> dict[str, bytes]:
    """What `dqforge simulate` makes of a design."""
    _check_options(folder, part, {SWITCHED: ("yes",)})
    switched = SWITCHED in part.options
    stage("simulating")
    found = simulate_with_firmware(design, switched=switched, solution=solution)
    return simulation_files(found, SWITCHED if switched else "")


def _firmware(
    folder: Path, part: Part, design: Design, inputs: Mapping[str, bytes]
) -> dict[str, bytes]:
    """What `dqforge export --for` makes of a design."""
    chosen, into = part.options.get(FIRMWARES, ""), part.options.get(EXISTING)
    _check_options(folder, part, {FIRMWARES: (chosen,), EXISTING: inputs})
    existing = None if into is None else decoded_file(inputs[into], into)
    names = [name for name in get_args(Firmware) if name in chosen.split(",")]
    made = solved_files(design, names, existing)
    return {name: content for _, files in made for name, content in files.items()}


def _refuse_unlisted(folder: Path, foreign: Iterable[str], prefix: str) -> None:
    """Refuse what has the name of a file of dqforge and does not stand in the manifest."""
    for name in foreign:
        own = name in {RESULT, REPORT} or name.startswith(f"{INPUT}/")
        if "/" not in name and name.startswith((f"{prefix}.", f"{prefix}_")):
            own |= name.endswith(".npz") or _claims(folder / name)
        if own:
            raise VerificationError(
                f"{folder / name}: is not in {MANIFEST}, and has the name of a file of dqforge; "
                f"move it elsewhere, or {_AGAIN}"
            )


def _claims(path: Path) -> bool:
    """Whether a text says at its head that dqforge made it."""
    try:
        with path.open("rb") as stream:
            return b"dqforge" in stream.read(_HEAD)
    except OSError:
        return True


def recompute(folder: Path) -> Recomputation:
    """Compute everything in a folder again from the designs that lie in it, and compare.

    Raises:
        InputError: The folder is not what dqforge writes, or another version wrote it.
        VerificationError: Something differs; the message names the first difference with both
            values.
    """
    manifest, contents = read_listed(folder)
    done, solution, digest = _Comparison(folder, contents), None, ""
    prefixes: set[str] = set()
    stale: list[str] = []
    # A run first: its solution serves the others.
    for name, part in sorted(manifest.parts.items(), key=lambda entry: entry[0] != RUN):
        _check_version(folder, part)
        if name not in {RUN, SIMULATION, FIRMWARE}:
            continue
        root = input_root(name)
        inputs = _read_inputs(folder, root, part, contents)
        design = _load(folder, root, inputs, part)
        prefixes.add(design.export.prefix)
        digest = digest or design.digest
        if design.digest != digest:
            stale += [each for each in part.files if not each.startswith(f"{INPUT}/")]
        if name == RUN:
            solution, expected = _run(folder, part, design, contents)
        elif name == SIMULATION:
            same = solution if design.digest == digest else None
            expected = _simulated(folder, part, design, same)
        else:
            expected = _firmware(folder, part, design, inputs)
        done.hold(part, manifest, expected)
        done.known |= {f"{root}/{below}" for below in inputs}
    line_ends = []
    for name, wanted in manifest.files.items():
        if _as_listed(contents[name], wanted) is None:
            raise _not_listed(folder / name, contents[name], wanted)
        if sha256(contents[name]) != wanted:
            line_ends.append(name)
    foreign = sorted({*files_below(folder)} - {*manifest.files, MANIFEST})
    for prefix in sorted(prefixes):
        _refuse_unlisted(folder, foreign, prefix)
    return Recomputation(
        digest,
        solution,
        done.tally,
        tuple(name for name in sorted(manifest.files) if name not in done.known),
        tuple(foreign),
        tuple(line_ends),
        tuple(done.digits),
        tuple(stale),
    )


# Two texts that must be the same: where they first differ, with both values, and what was
# compared, in numbers.

_KEY = re.compile(r'^\s*"([^"]+)": ')


_TOKEN = re.compile(r"\s+|[-+]?(?:0x[0-9A-Fa-f]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\w*|\w+|.")


_LONGEST = 60


@dataclass(frozen=True, slots=True)
class Difference:
    """The first difference of two texts: one-based line, what stands there,
    and what must stand there.
    """

    line: int
    found: str
    expected: str
    name: str = ""

    def __str__(self) -> str:
        named = f"{self.name} is " if self.name else ""
        return f"{self.line}: {named}{self.found}, the design gives {self.expected}"


def _shown(text: str) -> str:
    """A piece of a line for a message, on one line and in quotes where it is
    not a plain word or number.
    """
    if not text:
        return "nothing"
    if re.fullmatch(r"[-+\w.]+", text):
        return text if len(text) <= _LONGEST else text[:_LONGEST] + "..."
    return ascii(text if len(text) <= _LONGEST else text[:_LONGEST] + "...")


def _name_of(line: str) -> str:
    """What a line gives a value to, where it says so."""
    macro = re.match(r"#define ([A-Za-z_]\w*)[ \t]", line)
    key = _KEY.match(line)
    return macro[1] if macro else key[1] if key else ""


def _pieces(found: str, expected: str) -> tuple[str, str]:
    """The first tokens that differ in two lines."""
    pairs = zip_longest(_TOKEN.findall(found), _TOKEN.findall(expected), fillvalue="")
    return next((pair for pair in pairs if pair[0] != pair[1]), ("", ""))


def tokens(line: str) -> list[str]:
    """Numbers, words and single characters of a line."""
    return _TOKEN.findall(line)


def difference_of_lines(number: int, have: str | None, want: str | None) -> Difference:
    """How two lines differ that do; None for one that is not there."""
    if have is None:
        return Difference(number, "no such line", _shown(want or ""))
    if want is None:
        return Difference(number, _shown(have), "its end")
    found, expected = _pieces(have, want)
    return Difference(number, _shown(found), _shown(expected), _name_of(want))


def first_difference(found: str, expected: str) -> Difference | None:
    """Where two texts first differ, None where they do not."""
    lines = zip_longest(found.split("\n"), expected.split("\n"))
    for number, (have, want) in enumerate(lines, 1):
        if have != want:
            return difference_of_lines(number, have, want)
    return None


# What other libraries or another processor make of a file: the same but for the last digits.

# Relative difference of numbers that counts as one of the last digits: eight units of float32.
RELATIVE = 1e-6
NOISE = 1e-12  # Magnitude below which a number is what rounding left of zero.
BOUND = f"the last digits ({RELATIVE:g} of a number, {NOISE:g} of zero)"

# What reading an archive raises that was tampered with.
_DAMAGED = (
    ValueError,
    OSError,
    EOFError,
    KeyError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)

_FRACTION = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+(?=[eE]))(?:[eE][-+]?\d+)?(?=[Ff]?$)")
_CODE = re.compile(r"[-+]?\d+$")
_BITS = re.compile(r"0x([0-9A-F]{8})U$")


def _close(have: float, want: float) -> bool:
    largest = max(abs(have), abs(want))
    return abs(have - want) <= RELATIVE * largest or largest <= NOISE


def _alike(have: str, want: str, *, vectors: bool) -> bool:
    """Whether two tokens are one number but for its last digits."""
    if have == want:
        return True
    first, second = _FRACTION.match(have), _FRACTION.match(want)
    if first and second:
        return _close(float(first[0]), float(second[0]))
    if not vectors:
        return False
    one, other = _BITS.match(have), _BITS.match(want)
    if one and other:
        values = [struct.unpack(">f", bytes.fromhex(bits[1]))[0] for bits in (one, other)]
        return _close(values[0], values[1])
    codes = _CODE.match(have) and _CODE.match(want)
    return bool(codes) and abs(int(have) - int(want)) <= 1


def changed_value(have: str, want: str, name: str) -> Difference | None:
    """Where two texts first differ by more than last digits, None where they do not.

    Args:
        have, want: What lies there, and what was computed.
        name: Of the file: in test vectors, whole numbers are bits of float32 or codes, and may be
            off by one.
    """
    # Last digits of the header cut boxes otherwise and move matrices: a checker confirms them.
    if name.endswith((SUFFIX, SPEED_SUFFIX, OBSERVER_SUFFIX)):
        return None
    vectors = name.endswith("_vectors.h")
    lines = zip_longest(have.split("\n"), want.split("\n"))
    for number, (one, other) in enumerate(lines, 1):
        if one == other:
            continue
        if one is None or other is None:
            return difference_of_lines(number, one, other)
        pairs = zip_longest(tokens(one), tokens(other), fillvalue="")
        if not all(_alike(first, second, vectors=vectors) for first, second in pairs):
            return difference_of_lines(number, one, other)
    return None


def _arrays(content: bytes) -> Mapping[str, NDArray[Any]] | None:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except _DAMAGED:
        return None


def _changed(have: NDArray[Any], want: NDArray[Any], *, exact: bool) -> Iterator[tuple[int, ...]]:
    """Places of samples that differ."""
    if want.dtype.kind != "f":
        same = have == want
    elif exact:
        same = (have == want) | (np.isnan(have) & np.isnan(want))
    else:
        finite = np.abs(want[np.isfinite(want)])
        bound = RELATIVE * float(finite.max(initial=0.0)) + NOISE
        same = np.isclose(have, want, rtol=0.0, atol=bound, equal_nan=True)
    for place in np.argwhere(~same):
        yield tuple(place.tolist())


def changed_sample(have: bytes, want: bytes, *, exact: bool = False) -> str | None:
    """Where two archives of samples first differ by more than last digits, or at all; None where
    they do not. The bound is `RELATIVE` of the largest magnitude of an array.
    """
    found, expected = _arrays(have), _arrays(want)
    if expected is None or found is None or list(found) != list(expected):
        return ": is no archive of the samples that the design gives"
    for name, array in expected.items():
        there = found[name]
        if there.dtype != array.dtype or there.shape != array.shape:
            return f": {name} has another shape or type than the design gives"
        place = next(_changed(there, array, exact=exact), None)
        if place is not None:
            index = ", ".join(map(str, place))
            return f": {name}[{index}] is {there[place]}, the design gives {array[place]}"
    return None


# What `dqforge verify` says of a folder that it computed again.

_NAMED = 4


def _names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


def recomputation_text(found: Recomputation) -> str:
    """What was not computed again, and where last digits differ, where there is such; then a line
    on what was computed again.
    """
    lines = []
    if found.listed:
        lines.append(
            "not computed again, and checked by the SHA-256 of the manifest alone: "
            f"{_names(found.listed)}"
        )
    if found.foreign:
        lines.append(f"not written by dqforge and not checked: {_names(found.foreign)}")
    lines += [
        f"differs by the last digits of another library or processor, within {BOUND}: {each}"
        for each in found.digits
    ]
    if found.stale:
        lines.append(f"of the design in another version than the headers: {_names(found.stale)}")
    if found.line_ends:
        lines.append(f"with other line endings than dqforge writes: {_names(found.line_ends)}")
    count = found.tally
    counts = (
        (count.macros, "macro", "macros"),
        (count.literals, "literal in code and tables", "literals in code and tables"),
        (count.figures, "figure in comments", "figures in comments"),
        (count.checksums, "checksum", "checksums"),
        (count.vectors, "test vector", "test vectors"),
        (count.entries, "entry of result.json", "entries of result.json"),
    )
    if count.files:
        held = ", ".join(f"{n} {one if n == 1 else many}" for n, one, many in counts if n)
        equal = "hold" if found.digits else "equal"
        lines.append(
            f"{count.files} files {equal} what {INPUT_DESIGN} (SHA-256 {found.digest[:12]}) gives "
            f"when it is computed again{f': {held}' if held else ''}"
        )
    return "\n".join(lines)


# The certificate of the current loops that a run stored, checked again in balls.


def check_stored_proof(
    folder: Path, solution: Solution, *, own_inputs: bool = False
) -> Confirmation | None:
    """Whether the certificate of a folder proves what the design in it states.

    None where the run stored no certificate, or the design asks for none.

    Args:
        folder: What 'dqforge run' wrote.
        solution: What the design in the folder gives; the certificate must have its inputs, to the
            bit.
        own_inputs: Whether the certificate is held against its own inputs instead: those of another
            processor, which were compared within their last digits.

    Raises:
        VerificationError: The certificate proves something else, or nothing; says what is wrong.
        InputError: The file cannot be read.
    """
    loops = solution.loops
    proof = None if loops is None or loops.robust is None else loops.robust.proof
    path = folder / f"{solution.design.export.prefix}{CERTIFICATE}"
    if proof is None or proof.certificate is None or not path.is_file():
        return None
    stored = _stored_proof_load(path)
    inputs = stored.get("inputs", {}) if own_inputs else proof.certificate["inputs"]
    confirmation = confirm(stored, inputs)
    if confirmation.fault:
        raise VerificationError(f"{path}: {confirmation.fault}")
    if confirmation.proven != proof.proven:
        raise VerificationError(f"{path}: it leaves open what result.json states as proven")
    bound = None if proof.sensitivity is None else proof.sensitivity.bound
    if bound is not None:
        _check_sensitivity(path, stored, inputs, bound)
    return confirmation


def _check_sensitivity(
    path: Path, stored: Mapping[str, Any], inputs: Mapping[str, Any], bound: float
) -> None:
    """Raises unless the certificate proves the bound of the sensitivity that is stated."""
    own = stored.get("sensitivity")
    tree = own.get("tree") if isinstance(own, Mapping) else None
    found = confirm_sensitivity({"inputs": stored["inputs"], "tree": tree}, inputs, bound)
    if not found.proven:
        raise VerificationError(f"{path}: sensitivity: {found.fault or 'it leaves cells open'}")


def _stored_proof_load(path: Path) -> dict[str, Any]:
    content = read_output(path, "the folder that 'dqforge run' wrote", LARGEST_JSON)
    try:
        loaded = strict_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON; run the design again", source=str(path)) from error
    if not isinstance(loaded, dict):
        raise InputError("is not what dqforge writes; run the design again", source=str(path))
    return loaded


def stored_proof_text(found: Confirmation) -> str:
    """What was checked, in words."""
    matrices = "one matrix" if found.matrices == 1 else f"{found.matrices} matrices"
    parts = f"{matrices}, {found.empty} cells without a drive"
    both, how = "both current loops together", "confirmed in interval arithmetic"
    if found.proven:
        return f"{both}: certificate {how} ({parts})"
    return (
        f"{both}: what the certificate claims is {how} ({parts}); it leaves {found.left_open} "
        "cells open"
    )
