"""Proof by execution: the emitted header is compiled as C and as C++, run,
and compared bit for bit with the model.
"""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.reports.current_reference.plain import reference_programme
from dqforge.reports.operating_system.host_compiler import (
    NO_COMPILER,
    Language,
    compile_program,
    find_compiler,
)

if TYPE_CHECKING:
    from dqforge.optimizer.current_reference.forms import Emitted
    from dqforge.reports.c_code.harness import Programme

# Warning flags of the header contract (docs/reference/header.md).
WARNINGS = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wfloat-conversion",
    "-Werror",
)

# Where an invalid operation gives the same not-a-number in C and in numpy; on other processors one
# is as good as another.
_FLAGS = ("-ffp-contract=off", *WARNINGS)
_TIMEOUT_S = 60
_OF_X86 = platform.machine().lower() in ("x86_64", "amd64")


@dataclass(frozen=True, slots=True)
class Compiler:
    """A compiler that is wanted of the host: language and standard, the Debian package that
    brings one, and how it optimises: the bits are the same either way, and one of both shows it.
    """

    standard: str
    language: Language
    package: str
    optimisation: str


COMPILERS = (Compiler("c99", "c", "gcc", "-O2"), Compiler("c++11", "c++", "g++", "-O0"))


@dataclass(frozen=True, slots=True)
class Check:
    """One language: how many results were compared, or why none was. ``missing`` names
    the absent Debian package.
    """

    standard: str
    compared: int
    missing: str = ""


@dataclass(frozen=True, slots=True)
class Verification:
    """Outcome of a verification that found no difference: one check per language."""

    vectors: int
    sweep: int
    checks: tuple[Check, ...]

    @property
    def languages(self) -> tuple[str, ...]:
        """Standards that were really compiled and run."""
        return tuple(check.standard for check in self.checks if not check.missing)


def _execute(program: Path, what: str, content: bytes) -> subprocess.CompletedProcess[bytes]:
    """Run a program to its end.

    One that cannot be started or does not end is a failed verification.
    """
    try:
        return subprocess.run(
            [str(program)],
            input=content,
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(
            f"{what} cannot be started ({error.strerror}); TMPDIR must name a folder whose "
            "programs may run"
        ) from error


def _run(program: Path, part: Programme, standard: str) -> None:
    """Run a compiled harness on its inputs and compare what it gives with the model."""
    done = _execute(program, f"the compiled {standard} program", part.inputs.tobytes())
    found = part.results(done.stdout)
    if done.returncode not in (0, 1) or found is None:
        raise VerificationError(
            f"the compiled {standard} program stopped with exit code {done.returncode}"
        )
    if done.returncode == 1:
        raise VerificationError(
            f"compiled as {standard}, the header does not give the results of its test vectors"
        )
    part.require_model(
        found, f"compiled as {standard},", "C", f"{part.model.dtype} ", any_nan=not _OF_X86
    )


def stated_verification(
    reference: Emitted, vectors: int, further: Sequence[Programme], languages: Sequence[str]
) -> Verification:
    """What `verify_files` gives that succeeded in these standards; nothing is compiled."""
    programme, chosen = reference_programme(reference, vectors)
    compared = sum(part.inputs.shape[0] for part in (programme, *further))
    checks = tuple(
        Check(each.standard, compared)
        if each.standard in languages
        else Check(each.standard, 0, each.package)
        for each in COMPILERS
    )
    return Verification(chosen, compared - chosen, checks)


def verify_files(
    files: Mapping[str, bytes],
    prefix: str,
    reference: Emitted,
    vectors: int,
    further: Sequence[Programme] = (),
) -> Verification:
    """Compile a header and its vectors as C99 and as C++11, run both, and compare
    every bit with the model.

    Args:
        files: Contents of the headers and of their vectors by name.
        prefix: Checked C identifier.
        reference: The model.
        vectors: Number of test vectors that were asked for.
        further: Harnesses of the further headers.

    Raises:
        VerificationError: No C compiler is there, the header does not compile, or a result differs.
    """
    programme, chosen = reference_programme(reference, vectors)
    parts = [programme, *further]
    checks = []
    with scratch_folder() as folder:
        for file_name, content in files.items():
            (folder / file_name).write_bytes(content)
        for compiler in COMPILERS:
            there = find_compiler(compiler.language)
            if there is None:
                checks.append(Check(compiler.standard, 0, compiler.package))
                continue
            for part in parts:
                harness = part.harness.source(prefix)
                (folder / "harness.c").write_text(harness, encoding="ascii", newline="\n")
                program = compile_program(
                    there,
                    (f"-std={compiler.standard}", compiler.optimisation, *_FLAGS),
                    "harness.c",
                    folder,
                    f"harness-{compiler.language.replace('+', 'x')}",
                    f"the header does not compile as {compiler.standard}",
                )
                _run(program, part, compiler.standard)
            checks.append(Check(compiler.standard, sum(part.inputs.shape[0] for part in parts)))
    if checks[0].missing:
        raise VerificationError(NO_COMPILER)
    compared = sum(part.inputs.shape[0] for part in parts)
    return Verification(chosen, compared - chosen, tuple(checks))
