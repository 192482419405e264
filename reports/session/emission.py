"""A design solved whole, its C headers as texts or in a folder, and their proof."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer import solution as solved
from dqforge.reports.output.folder import RUN, write_output
from dqforge.reports.output.line_comparison import first_difference
from dqforge.reports.output.recomputation import Recomputation, read_listed, recompute
from dqforge.reports.plain_data import PlainData
from dqforge.reports.result import plain_solution
from dqforge.reports.run import export_design
from dqforge.reports.run_folder import INPUT_DESIGN
from dqforge.reports.session.control import Tuning
from dqforge.reports.session.losses import Losses
from dqforge.reports.session.result import Result
from dqforge.reports.session.waveforms import Waveforms
from dqforge.reports.verification.host import Verification
from dqforge.reports.written_headers import verify_folder


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Solution(Result):
    """Everything that a design asks for; ``found`` holds all of it, with the evidence."""

    found: solved.Solution

    @property
    def design(self) -> Design:
        """What was solved."""
        return self.found.design

    @property
    def tuning(self) -> Tuning | None:
        """The gains, None where there are none."""
        found = self.found
        return None if found.loops is None else Tuning(found.design, found.loops, found.fixed)

    @property
    def losses(self) -> Losses | None:
        """The loss comparison, None where the design asks for none."""
        return None if self.found.losses is None else Losses(self.design, self.found.losses)

    @property
    def waveforms(self) -> Waveforms | None:
        """Phase currents, None for a sinusoidal back-EMF."""
        return None if self.found.waveforms is None else Waveforms(self.found.waveforms)

    def plain(self) -> PlainData:
        """By the keys of ``result.json``."""
        return plain_solution(self.found)


def solve(design: Design) -> Solution:
    """Solve everything that a design asks for, as `dqforge run` does before it emits.

    Args:
        design: A design file, a library drive, or one made of a machine.

    Raises:
        InputError, NoSolutionError: What it asks for is contradictory, or cannot be had; the
            message names the section.
    """
    return Solution(solved.solve(design))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Emission(Result):
    """What is emitted of a design: ``files`` by name, the headers, their test vectors and
    ``result.json`` as texts.
    """

    design: Design
    files: Mapping[str, str]

    @property
    def header(self) -> str:
        """Text of the header with the current reference and the gains."""
        return self.files[f"{self.design.export.prefix}.h"]

    def plain(self) -> PlainData:
        """Prefix, digest of the design, and the texts by name."""
        design = self.design
        return {"prefix": design.export.prefix, "digest": design.digest, "files": dict(self.files)}

    def write(self, folder: str | Path) -> list[Path]:
        """Put all files into a folder at once, with the design that they come from, for `verify`.

        Raises:
            InputError: The folder cannot be written; it is as it was.
        """
        contents = {name: text.encode("utf-8") for name, text in self.files.items()}
        return write_output(Path(folder), RUN, contents, self.design)

    def _repr_html_(self) -> str:
        from dqforge.reports.session.result import html_table

        lines = {name: f"{text.count(chr(10))} lines" for name, text in self.files.items()}
        return html_table("Emission", {"prefix": self.design.export.prefix, **lines})


def emit(design: Design, folder: str | Path | None = None) -> Emission:
    """The C headers of a design, their test vectors, and the result that describes them.

    Args:
        design: A design file, a library drive, or one made of a machine.
        folder: Where to put them as well; None for texts alone.

    Returns:
        The same texts every time; `verify` proves them.

    Raises:
        InputError, NoSolutionError: As `solve`.
    """
    files = export_design(design, verify=False).files
    made = Emission(design, {name: content.decode("utf-8") for name, content in files.items()})
    if folder is not None:
        made.write(folder)
    return made


@dataclass(frozen=True, slots=True)
class Verified(Result):
    """Outcome of a verification that found no difference.

    ``compiled`` says what was compiled, run and compared bit for bit; ``computed_again`` what
    equals the design when it is solved again, None for an emission, which is compared text by text,
    and for a folder without its design.
    """

    compiled: Verification
    computed_again: Recomputation | None

    @property
    def compared(self) -> int:
        """Results that equal the model bit for bit."""
        return self.compiled.vectors + self.compiled.sweep

    @property
    def languages(self) -> tuple[str, ...]:
        """Standards that were compiled and run: c99, c++11."""
        return self.compiled.languages

    def plain(self) -> PlainData:
        """Counts, standards, and whether the design was solved again."""
        return {
            "compared": self.compared,
            "languages": self.languages,
            "computed_again": self.computed_again is not None,
        }


def verify(emitted: Emission | str | Path) -> Verified:
    """Compute what was emitted again from its design, compile the C, run it,
    and compare every value and every bit.

    Args:
        emitted: What `emit` gave, or a folder that it or ``dqforge run`` wrote.

    Raises:
        InputError: The folder is not what dqforge writes.
        VerificationError: Something differs, or no C compiler is there; the message names the first
            difference.
    """
    if isinstance(emitted, Emission):
        return Verified(_verified(emitted.design, emitted.files), None)
    folder = Path(emitted)
    manifest, _ = read_listed(folder)
    part = manifest.parts.get(RUN)
    again = None if part is not None and INPUT_DESIGN not in part.files else recompute(folder)
    return Verified(verify_folder(folder), again)


@on_design("export")
def _verified(design: Design, files: Mapping[str, str]) -> Verification:
    """Compare texts with those of the design, and compile and run them."""
    wanted = {
        name: content.decode("utf-8")
        for name, content in export_design(design, verify=False).files.items()
    }
    if set(files) != set(wanted):
        names = sorted(set(files) ^ set(wanted))
        raise VerificationError(
            f"the files are not those that the design gives: {', '.join(names)}"
        )
    for name, text in wanted.items():
        difference = first_difference(files[name], text)
        if difference is not None:
            raise VerificationError(f"{name}:{difference}")
    with tempfile.TemporaryDirectory(prefix="dqforge-") as place:
        for name, text in files.items():
            (Path(place) / name).write_text(text, encoding="utf-8", newline="")
        return verify_folder(Path(place))
