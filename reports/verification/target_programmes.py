"""The harnesses of the emitted headers on an emulated core: the inputs and results of the host's,
through its files.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.pages.templating import render
from dqforge.reports.verification.cross_tools import build, emulate
from dqforge.reports.verification.host import WARNINGS

if TYPE_CHECKING:
    from dqforge.reports.c_code.harness import Programme

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
    text = render(part.template, {"prefix": prefix, "macro": prefix.upper()} | part.context)
    return f"#define main harness_main\n{text}".encode("ascii")


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
    made["stdio.h"] = render("verification/stdio.h.j2", {}).encode("ascii")
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
        with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
            done.append(_run(files, prefix, part, target, Path(name)))
    return tuple(done)
