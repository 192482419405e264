"""What lies in an output folder, held against what the designs in it give when
everything is computed again.
"""

from __future__ import annotations

import posixpath
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import field
from pathlib import Path
from typing import get_args

from dqforge import __version__
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import MAX_FILE_BYTES, Design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.optimizer.solution import Solution
from dqforge.reports.firmware.design_simulation import simulate_with_firmware
from dqforge.reports.firmware.target import decoded_file
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
    files_below,
    input_root,
    named_in_folder,
)
from dqforge.reports.output.line_comparison import (
    BOUND,
    Tally,
    changed_sample,
    changed_value,
    first_difference,
    tally,
)
from dqforge.reports.output.manifest import Manifest, Part, computed_with, read_manifest, sha256
from dqforge.reports.pages.answer import read_output
from dqforge.reports.pages.console import stage
from dqforge.reports.run import export_design, run_again, solved_files
from dqforge.reports.run_folder import INPUT, MANIFEST, REPORT, RESULT
from dqforge.reports.simulation.design_run import simulation_files

_AGAIN = "run the design again"
_DESIGN = "design.yaml"
_HEAD = 2048  # Bytes at the head of a text in which it says what made it.


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
    with tempfile.TemporaryDirectory(prefix="dqforge-") as copy:
        for name, content in inputs.items():
            path = Path(copy) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        source = str(folder / root / _DESIGN)
        design = load_text(inputs[_DESIGN], source, Path(copy) / "files")
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
            f"a run was cut off while it put its files in place; {_AGAIN}", source=str(folder)
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
