"""Proof by execution on an emulated Cortex-M: the emitted headers compiled for it,
run on their vectors, and costed.

The vectors hold the bits of the float32 model; the emulated core must give
them without any difference.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.reports.pages.templating import render, resource
from dqforge.reports.verification.cross_tools import build, emulate, target_of
from dqforge.reports.verification.host import WARNINGS
from dqforge.reports.verification.measured_cost import cost_on_target

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.verification.cross_tools import Span


# Exit code of the program on the target where the current reference differs, one more for each kind
# of header behind it; the emulator's own failures end with 1.
_FIRST_DIFFERS = 101

# Vectors whose instructions are counted; those with special values come first.
_VECTORS = "_vectors.h"
_VECTOR_TORQUE = re.compile(rb"\{ 0x([0-9A-F]{8})U, 0x[0-9A-F]{8}U, 0x[0-9A-F]{8}U \}")
_FIXED = re.compile(rb"_current_reference_(q15|q31)\(")
_VECTOR_CODE = re.compile(rb"\{ (-?[0-9]+|\(-2147483647 - 1\)), [-0-9() ]+, [-0-9() ]+ \}")
_LARGEST_TRACE = 1024

# Bytes of text of the test vectors of one program; the flash of the smallest board holds 256 KiB,
# which are about 900,000 bytes of text.
_LARGEST_BATCH = 600_000


@dataclass(frozen=True, slots=True)
class TargetVerification:
    """Outcome on a target that found no difference.

    ``vectors`` were run. What the reference costs as a called function, both currents stored and
    the return included: ``instructions`` is the mean number executed over the first ``costed``
    vectors, ``cycles`` the mean of the estimated (lo, hi) at zero wait states, ``cycles_largest``
    their largest; ``flash`` is the code with its constants in bytes. ``runs`` are the harnesses
    that gave the bits of their models, ``not_run`` the headers of which nothing was run.
    """

    target: str
    vectors: int
    costed: int
    instructions: float
    cycles: tuple[float, float]
    cycles_largest: Span
    flash: int
    runs: tuple[TargetRun, ...] = ()
    not_run: tuple[str, ...] = ()


def _codes(vectors: bytes, number_format: str) -> NDArray[Any]:
    found = [
        -(2**31) if text.startswith(b"(") else int(text) for text in _VECTOR_CODE.findall(vectors)
    ]
    return np.array(found, dtype=np.int16 if number_format == "q15" else np.int32)


def _torques(vectors: bytes) -> SingleArray:
    words = [int(word, 16) for word in _VECTOR_TORQUE.findall(vectors)]
    return np.array(words, dtype=np.uint32).view(np.float32)


def _batches(files: Mapping[str, bytes], prefix: str, kinds: Sequence[str]) -> list[list[str]]:
    """Kinds of headers whose test vectors fit the flash of a board together, in their order."""
    found: list[list[str]] = [[]]
    text = 0
    for kind in kinds:
        own = len(files[f"{prefix}_{kind}{_VECTORS}"])
        if found[-1] and text + own > _LARGEST_BATCH:
            found.append([])
            text = 0
        found[-1].append(kind)
        text += own
    return found


def _run_vectors(
    files: Mapping[str, bytes], prefix: str, target: str, kinds: Sequence[str]
) -> bytes:
    """Run test vectors on the target, those of the main header and of further kinds; the
    source of the program that did.
    """
    context = {
        "prefix": prefix,
        "kinds": kinds,
        "first": _FIRST_DIFFERS,
    }
    main = render("verification/main.c.j2", context).encode("ascii")
    with scratch_folder() as folder:
        build(
            {**files, "target_main.c": main},
            (*WARNINGS, "-Wno-overlength-strings"),
            target,
            folder,
        )
        code = emulate(target, folder)
    headers = [f"{prefix}.h", *(f"{prefix}_{kind}.h" for kind in kinds)]
    if _FIRST_DIFFERS <= code < _FIRST_DIFFERS + len(headers):
        raise VerificationError(
            f"on {target} the functions of {headers[code - _FIRST_DIFFERS]} do not give the "
            "results of their test vectors"
        )
    return main


def verify_on_target(
    files: Mapping[str, bytes],
    prefix: str,
    target: str,
    programmes: Sequence[Programme] = (),
) -> TargetVerification:
    """Compile the headers for a target, run them on its emulation, and cost the current reference.

    Their test vectors are run, and the harnesses of ``programmes`` on their inputs.

    Args:
        files: Contents of the headers and of their vectors by name.
        prefix: Checked C identifier.
        target: One of `TARGETS`.
        programmes: Harnesses of the headers; what has neither these nor test vectors is named in
            the outcome.

    Raises:
        InputError: There is no such target.
        VerificationError: A tool is missing (its Debian package is named), the headers do not
            compile, or a result differs.
    """
    target_of(target)
    fixed = _FIXED.search(files[f"{prefix}.h"])
    number_format = "" if fixed is None else fixed.group(1).decode("ascii")
    vectors, function = files[f"{prefix}_vectors.h"], f"{prefix}_current_reference"
    torques = _codes(vectors, number_format) if number_format else _torques(vectors)
    if torques.size == 0:
        raise VerificationError(f"{prefix}_vectors.h holds no test vectors; run the design again")
    kinds = sorted(
        name.removeprefix(f"{prefix}_").removesuffix(_VECTORS)
        for name in files
        if name.startswith(f"{prefix}_") and name.endswith(_VECTORS) and name != prefix + _VECTORS
    )
    mains = [_run_vectors(files, prefix, target, batch) for batch in _batches(files, prefix, kinds)]
    runs = run_on_target(files, prefix, programmes, target)
    seen = reached(files, [*mains, *(harness_of(part, prefix) for part in programmes)])
    costed = torques[:_LARGEST_TRACE]
    named = f"{function}_{number_format}" if number_format else function
    cost = cost_on_target(files, f"{prefix}.h", named, target, costed)
    return TargetVerification(
        target,
        torques.size,
        costed.size,
        cost.instructions,
        cost.cycles,
        cost.cycles_largest,
        cost.flash,
        runs,
        tuple(sorted(name for name in files if name.endswith(".h") and name not in seen)),
    )


# The harnesses of the emitted headers on an emulated core: the inputs and results of the host's,
# through its files.

_INCLUDE = re.compile(rb'^#include "([^"]+)"', re.MULTILINE)


_VECTORS_DIFFER = 101


_NO_OUTPUT = 102


_MAIN = f"""int harness_main(void);
int main(void);

int main(void)
{{
    const int code = harness_main();

    return (code == 0) ? 0 : (code == 1) ? {_VECTORS_DIFFER} : {_NO_OUTPUT};
}}
"""


@dataclass(frozen=True, slots=True)
class TargetRun:
    """A harness that ran on a core and gave what its model gives: what it runs, and how many
    results were compared.
    """

    name: str
    compared: int


def harness_of(part: Programme, prefix: str) -> bytes:
    """C source of a harness, its ``main`` renamed."""
    return f"#define main harness_main\n{part.harness.source(prefix)}".encode("ascii")


def reached(files: Mapping[str, bytes], sources: Iterable[bytes]) -> set[str]:
    """Names of the files that sources include, also by way of each other."""
    found: set[str] = set()
    open_ends = list(sources)
    while open_ends:
        names = {name.decode("ascii", "replace") for name in _INCLUDE.findall(open_ends.pop())}
        new = [name for name in names if name in files and name not in found]
        found.update(new)
        open_ends += [files[name] for name in new]
    return found


def _run(
    files: Mapping[str, bytes], prefix: str, part: Programme, target: str, folder: Path
) -> TargetRun:
    made = {"harness.c": harness_of(part, prefix), "target_main.c": _MAIN.encode("ascii")}
    made["stdio.h"] = resource("verification/stdio.h").encode("ascii")
    (folder / "target.in").write_bytes(part.inputs.tobytes())
    build(
        {**files, **made}, (*WARNINGS, "-Wno-overlength-strings", "-isystem", "."), target, folder
    )
    code = emulate(target, folder)
    if code == _VECTORS_DIFFER:
        raise VerificationError(
            f"on {target} the {part.name} do not give the results of their test vectors"
        )
    content = (folder / "target.out").read_bytes() if (folder / "target.out").is_file() else b""
    results = part.results(content)
    if code != 0 or results is None:
        raise VerificationError(
            f"on {target} the harness of the {part.name} stopped with exit code {code}"
        )
    part.require_model(results, f"on {target}", "the core", any_nan=True)
    return TargetRun(part.name, len(results))


def run_on_target(
    files: Mapping[str, bytes], prefix: str, parts: Sequence[Programme], target: str
) -> tuple[TargetRun, ...]:
    """Run harnesses on an emulated core and compare every bit with the model.

    Args:
        files: Contents of the headers and of their vectors by name.
        prefix: Checked C identifier.
        parts: Harnesses with inputs and results.
        target: One of `target_tools.TARGETS`.

    Raises:
        VerificationError: A tool is missing, a harness does not compile, or a result differs.
    """
    done = []
    for part in parts:
        with scratch_folder() as folder:
            done.append(_run(files, prefix, part, target, folder))
    return tuple(done)
