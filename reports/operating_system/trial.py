"""A trial of the compiler that would be taken: a small program is compiled, run and believed only
if its results are those of numpy.
"""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from dqforge.machines.errors import VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import (
    Language,
    compile_program,
    require_compiler,
)
from dqforge.reports.pages.templating import render

_TIMEOUT_S = 60

_FLAGS = ("-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")

_STANDARDS: dict[Language, str] = {"c": "c99", "c++": "c++11"}


@dataclass(frozen=True, slots=True)
class Trial:
    """What came of it.

    Args:
        language: What was compiled.
        compiler, path: Name and place of the compiler; empty without one.
        failure: What went wrong, in one line; empty where nothing did.
    """

    language: Language
    compiler: str
    path: str
    failure: str = ""


def _inputs() -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Rows of three numbers, among them the bytes that text streams of Windows change."""
    draws = np.random.default_rng(1).standard_normal((64, 3)).astype(np.float32)
    draws[0] = np.array([0x0A1A0D0A, 0x1A1A1A1A, 0x0D0A0D0A], dtype=np.uint32).view(np.float32)
    return draws


def _run(program: Path) -> None:
    inputs = _inputs()
    try:
        done = subprocess.run(
            [str(program)],
            input=inputs.tobytes(),
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"its program did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(
            f"its program cannot be started ({error.strerror}); TMPDIR must name a folder whose "
            "programs may run"
        ) from error
    wanted = inputs[:, 0] * inputs[:, 1] + inputs[:, 2]
    if done.returncode != 0 or done.stdout != wanted.tobytes():
        raise VerificationError("its program gives other results than numpy in float32")


def try_compiler(language: Language) -> Trial:
    """Compile and run a program with the compiler that would be taken."""
    name, path = "", ""
    try:
        compiler = require_compiler(language)
        name, path = compiler.name, compiler.command[0]
        with tempfile.TemporaryDirectory(prefix="dqforge-") as place:
            folder = Path(place)
            source = render("operating_system/trial.c.j2", {})
            (folder / "trial.c").write_text(source, encoding="ascii", newline="\n")
            flags = (f"-std={_STANDARDS[language]}", *_FLAGS)
            _run(
                compile_program(
                    compiler, flags, "trial.c", folder, "trial", "a program does not compile"
                )
            )
    except VerificationError as error:
        return Trial(language, name, path, str(error))
    except OSError as error:
        return Trial(language, name, path, f"the folder for temporary files: {error.strerror}")
    return Trial(language, name, path)
