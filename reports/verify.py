"""Proof by execution: the emitted header is compiled as C and as C++, run, and compared bit for bit with the model."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.entries import EntryError
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.identifiers import check_prefix
from dqforge.optimizer.current_reference import Emitted, FloatReference
from dqforge.optimizer.fixed_polynomial import CodeArray
from dqforge.optimizer.fixed_reference import FixedReference
from dqforge.optimizer.single_precision import SingleArray
from dqforge.reports.files import LARGEST_FILE, LARGEST_JSON, read_output
from dqforge.reports.further_headers import SWEEP_POINTS, SWEEP_SEED, programmes
from dqforge.reports.programme import Programme
from dqforge.reports.reference_header import vector_codes, vector_torques
from dqforge.reports.reference_ir import from_plain
from dqforge.reports.templating import render

WARNINGS = (
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Wfloat-conversion",
    "-Werror",
)
"""Warning flags of the header contract (docs/header.md)."""

_TIMEOUT_S = 60


@dataclass(frozen=True, slots=True)
class Compiler:
    """A compiler of the host: language and standard, the program, and the Debian package that brings it."""

    standard: str
    program: str
    language: str
    package: str


COMPILERS = (Compiler("c99", "cc", "c", "gcc"), Compiler("c++11", "c++", "c++", "g++"))


@dataclass(frozen=True, slots=True)
class Check:
    """One language: how many results were compared, or why none was. ``missing`` names the absent Debian package."""

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


def sweep_torques(reference: FloatReference, count: int = SWEEP_POINTS) -> SingleArray:
    """Float32 torques beyond the test vectors: across the domain of both signs, and raw bit patterns of any kind."""
    generator = np.random.default_rng(SWEEP_SEED)
    across = (generator.uniform(-1.1, 1.1, count // 2) * float(reference.torque_max)).astype(np.float32)
    patterns = generator.integers(0, 2**32, count - across.size, dtype=np.uint32).view(np.float32)
    return np.concatenate([across, patterns])


def sweep_codes(reference: FixedReference, count: int = SWEEP_POINTS) -> CodeArray:
    """All codes of 16 bits, or so many random ones of 32 bits, half of them inside the domain."""
    most = 2 ** (reference.width - 1)
    if reference.width <= 16:
        return np.arange(-most, most)
    generator = np.random.default_rng(SWEEP_SEED)
    inside = generator.integers(-reference.end, reference.end + 1, count // 2)
    return np.concatenate([inside, generator.integers(-most, most, count - inside.size)])


def _execute(
    command: list[str], what: str, *, cwd: Path | None = None, content: bytes = b""
) -> subprocess.CompletedProcess[bytes]:
    """Run a program to its end; one that cannot be started or does not end is a failed verification."""
    environment = os.environ | {"LC_ALL": "C"}  # whose messages are searched for "error"
    try:
        return subprocess.run(
            command, cwd=cwd, env=environment, input=content, capture_output=True, timeout=_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(
            f"{what} cannot be started ({error.strerror}); TMPDIR must name a folder whose programs may run"
        ) from error


def _compile(compiler: Compiler, program: str, folder: Path) -> Path:
    target = folder / f"harness-{compiler.language.replace('+', 'x')}"
    command = [
        program,
        "-x",
        compiler.language,
        f"-std={compiler.standard}",
        "-O2",
        "-ffp-contract=off",
        *WARNINGS,
        "-o",
        str(target),
        "harness.c",
        "-lm",
    ]
    done = _execute(command, f"the {compiler.standard} compiler {compiler.program}", cwd=folder)
    if done.returncode != 0:
        lines = done.stderr.decode("utf-8", "replace").splitlines()
        first = next((line for line in lines if "error" in line), "; ".join(lines)[:200])
        raise VerificationError(f"the header does not compile as {compiler.standard} with {compiler.program}: {first}")
    return target


def _run(program: Path, inputs: NDArray[Any], model: NDArray[Any], standard: str) -> NDArray[Any]:
    """Results of the compiled evaluator for inputs of shape (N,) or (N, M), of the shape and type of the model."""
    done = _execute([str(program)], f"the compiled {standard} program", content=inputs.tobytes())
    if done.returncode not in (0, 1) or len(done.stdout) != model.nbytes:
        raise VerificationError(f"the compiled {standard} program stopped with exit code {done.returncode}")
    if done.returncode == 1:
        raise VerificationError(f"compiled as {standard}, the header does not give the results of its test vectors")
    return np.frombuffer(done.stdout, dtype=model.dtype).reshape(model.shape)


def _compare(compiled: NDArray[Any], part: Programme, standard: str) -> None:
    inputs, model = part.inputs, part.model
    bits = np.dtype(f"u{model.dtype.itemsize}")
    differing = np.any(compiled.view(bits) != np.ascontiguousarray(model).view(bits), axis=1)
    if differing.any():
        first = int(np.argmax(differing))
        raise VerificationError(
            f"compiled as {standard}, {int(differing.sum())} of {inputs.shape[0]} results of the {part.name} differ"
            f" from the {model.dtype} model; first at {inputs[first]!s}: C gives {compiled[first].tolist()},"
            f" model {model[first].tolist()}"
        )


def _reference_programme(reference: Emitted, vectors: int) -> tuple[Programme, int]:
    """The harness of the current reference with its inputs, and how many of these are test vectors."""
    if isinstance(reference, FixedReference):
        chosen = vector_codes(reference, vectors)
        codes = np.concatenate([chosen, sweep_codes(reference)])
        number = np.dtype(f"i{reference.width // 8}")
        context = {"width": reference.width, "format": reference.format}
        results = np.stack(reference.codes(codes), axis=1).astype(number)
        return Programme("fixed_harness.c.j2", codes.astype(number), results, context), chosen.size
    special = vector_torques(reference, vectors)
    torque = np.concatenate([special, sweep_torques(reference)])
    return Programme("harness.c.j2", torque, np.stack(reference.currents(torque), axis=1)), special.size


def verify_files(
    files: Mapping[str, bytes],
    prefix: str,
    reference: Emitted,
    vectors: int,
    further: Sequence[Programme] = (),
) -> Verification:
    """Compile a header and its vectors as C99 and as C++11, run both, and compare every bit with the model.

    Parameters
    ----------
    files:
        Contents of the headers and of their vectors by name.
    prefix:
        Checked C identifier.
    reference:
        The model.
    vectors:
        Number of test vectors that were asked for.
    further:
        Harnesses of the further headers.

    Raises
    ------
    VerificationError
        No C compiler is there, the header does not compile, or a result differs.
    """
    programme, chosen = _reference_programme(reference, vectors)
    parts = [programme, *further]
    checks = []
    with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
        folder = Path(name)
        for file_name, content in files.items():
            (folder / file_name).write_bytes(content)
        for compiler in COMPILERS:
            program = shutil.which(compiler.program)
            if program is None:
                checks.append(Check(compiler.standard, 0, compiler.package))
                continue
            for part in parts:
                harness = render(part.template, {"prefix": prefix, "macro": prefix.upper()} | part.context)
                (folder / "harness.c").write_text(harness, encoding="ascii")
                built = _compile(compiler, program, folder)
                compiled = _run(built, part.inputs, part.model, compiler.standard)
                _compare(compiled, part, compiler.standard)
            checks.append(Check(compiler.standard, sum(part.inputs.shape[0] for part in parts)))
    if checks[0].missing:
        raise VerificationError("no C compiler found: install the Debian package gcc, or give --no-verify")
    compared = sum(part.inputs.shape[0] for part in parts)
    return Verification(chosen, compared - chosen, tuple(checks))


def _read(path: Path, most_bytes: int = LARGEST_FILE) -> bytes:
    return read_output(path, "the folder that 'dqforge run' or 'dqforge export' wrote", most_bytes)


def _load_result(path: Path) -> dict[str, Any]:
    """A result that describes a header."""
    content = _read(path, LARGEST_JSON)
    try:
        loaded = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON; run the design again", source=str(path)) from error
    if not isinstance(loaded, dict) or not isinstance(loaded.get("header"), dict):
        raise InputError("holds no header; run the design again", source=str(path))
    return loaded


@dataclass(frozen=True, slots=True)
class WrittenHeaders:
    """What an earlier run wrote: files by name, prefix, model, number of test vectors, harnesses of further headers."""

    files: dict[str, bytes]
    prefix: str
    reference: Emitted
    vectors: int
    further: tuple[Programme, ...] = ()

    @property
    def programmes(self) -> tuple[Programme, ...]:
        """Harnesses of all headers."""
        return (_reference_programme(self.reference, self.vectors)[0], *self.further)


def read_folder(folder: Path) -> WrittenHeaders:
    """Headers and models of an earlier run, by what its ``result.json`` describes.

    Raises
    ------
    InputError
        A file is missing or is not what dqforge writes.
    """
    path = folder / "result.json"
    loaded = _load_result(path)
    header = loaded["header"]
    vectors = header.get("vectors")
    try:
        prefix = check_prefix(str(header.get("prefix", "")))
    except EntryError as error:
        raise InputError(f"header.prefix: {error.message}; run the design again", source=str(path)) from error
    if not isinstance(vectors, int) or not isinstance(header.get("reference"), dict):
        raise InputError("header.vectors or header.reference is missing; run the design again", source=str(path))
    try:
        reference = from_plain(header["reference"])
        kinds, further = programmes(loaded)
    except InputError as error:
        raise InputError(error.message, source=str(path)) from error
    names = [f"{prefix}.h", f"{prefix}_vectors.h"]
    names += [name for kind in kinds.values() for name in kind.files(prefix)]
    return WrittenHeaders({name: _read(folder / name) for name in names}, prefix, reference, vectors, tuple(further))


def verify_written(found: WrittenHeaders) -> Verification:
    """Compile and run what an earlier run wrote; raises VerificationError as `verify_files`."""
    return verify_files(found.files, found.prefix, found.reference, found.vectors, found.further)


def verify_folder(folder: Path) -> Verification:
    """Compile and run what an earlier run wrote into a folder.

    Raises
    ------
    InputError
        As `read_folder`.
    VerificationError
        As `verify_files`.
    """
    return verify_written(read_folder(folder))
