"""What lies in an output folder, held against what the design in it gives when
everything is computed again.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.machines.design.loader import load_text
from dqforge.machines.design.reading import MAX_FILE_BYTES
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.solution import Solution
from dqforge.reports.output.folder import RUN
from dqforge.reports.output.folder_swap import PENDING, files_below
from dqforge.reports.output.line_comparison import Tally, first_difference, tally
from dqforge.reports.output.manifest import Manifest, Part, computed_with, read_manifest, sha256
from dqforge.reports.pages.files import read_output
from dqforge.reports.result import without_simulation
from dqforge.reports.run import export_design
from dqforge.reports.run_folder import INPUT_DESIGN, INPUT_FILES, MANIFEST

RESULT = "result.json"


_AGAIN = "run the design again"


@dataclass(frozen=True, slots=True)
class Recomputation:
    """Outcome of a comparison that found no difference.

    ``solution`` is what the design gives. ``tally`` counts what was recomputed; ``listed`` names
    files that only had to have the SHA-256 of the manifest, ``foreign`` those that dqforge did not
    write, ``line_ends`` those whose line endings alone were changed.
    """

    digest: str
    solution: Solution
    tally: Tally
    listed: tuple[str, ...]
    foreign: tuple[str, ...]
    line_ends: tuple[str, ...]


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


def _read_inputs(folder: Path, part: Part, contents: Mapping[str, bytes]) -> dict[str, bytes]:
    """The design and the files that it names, as they were when the run read them."""
    inputs = {}
    for name, digest in part.files.items():
        if name != INPUT_DESIGN and not name.startswith(f"{INPUT_FILES}/"):
            continue
        listed = _as_listed(contents[name], digest)
        if listed is None:
            raise _not_listed(folder / name, contents[name], digest)
        inputs[name] = listed
    if INPUT_DESIGN not in inputs:
        raise InputError(f"lists no {INPUT_DESIGN}; {_AGAIN}", source=str(folder / MANIFEST))
    return inputs


def _load(folder: Path, inputs: Mapping[str, bytes], part: Part) -> Design:
    """The design in a folder, read from a copy of what it was read from."""
    with tempfile.TemporaryDirectory(prefix="dqforge-") as copy:
        for name, content in inputs.items():
            path = Path(copy) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        design = load_text(
            inputs[INPUT_DESIGN], str(folder / INPUT_DESIGN), Path(copy) / INPUT_FILES
        )
    if design.digest != part.digest:
        raise VerificationError(
            f"{folder / MANIFEST}: design_sha256 is {part.digest}, the design in the folder has "
            f"{design.digest}"
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


def _compare(folder: Path, name: str, content: bytes, expected: bytes, part: Part) -> Tally:
    """Compare one file line by line; raises VerificationError with the first difference."""
    have = content.replace(b"\r\n", b"\n").decode("utf-8", "backslashreplace")
    if name == RESULT:
        have = without_simulation(have)
    want = expected.decode("utf-8")
    difference = first_difference(have, want)
    if difference is not None:
        raise VerificationError(f"{folder / name}:{difference}{_elsewhere(part)}")
    return tally(name, want)


def _part(folder: Path, manifest: Manifest) -> Part:
    part = manifest.parts.get(RUN)
    if part is None:
        raise InputError(f"lists no header; {_AGAIN}", source=str(folder / MANIFEST))
    if part.version != __version__:
        raise InputError(
            f"written by dqforge {part.version}, this is {__version__}; verify with that version, "
            f"or {_AGAIN}",
            source=str(folder / MANIFEST),
        )
    return part


def read_listed(folder: Path) -> tuple[Manifest, dict[str, bytes]]:
    """The manifest of a folder and the contents of all files that it lists.

    Raises
    ------
    InputError
        There is no manifest, a file is missing, or a run was cut off while it moved its files.
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


def recompute(folder: Path) -> Recomputation:
    """Compute everything in a folder again from the design that lies in it, and compare.

    Raises
    ------
    InputError
        The folder is not what dqforge writes, or another version wrote it.
    VerificationError
        Something differs; the message names the first difference with both values.
    """
    manifest, contents = read_listed(folder)
    part = _part(folder, manifest)
    inputs = _read_inputs(folder, part, contents)
    design = _load(folder, inputs, part)
    again = export_design(design, verify=False)
    expected = again.files
    total = Tally()
    for name, content in expected.items():
        if name not in part.files:
            raise VerificationError(
                f"{folder / MANIFEST}: {name} is not listed, the design gives it"
            )
        total += _compare(folder, name, contents[name], content, part)
    line_ends = []
    for name, digest in manifest.files.items():
        if _as_listed(contents[name], digest) is None:
            raise _not_listed(folder / name, contents[name], digest)
        if sha256(contents[name]) != digest:
            line_ends.append(name)
    known = {*expected, *inputs}
    foreign = sorted({*files_below(folder)} - {*manifest.files, MANIFEST})
    listed = tuple(name for name in sorted(manifest.files) if name not in known)
    return Recomputation(
        design.digest, again.solution, total, listed, tuple(foreign), tuple(line_ends)
    )
