"""What comes back from files of firmware: read again, or printed by a compiled program."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from dqforge.optimizer.firmware.configuration import Configuration

C_FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror")


def kept_of(found: Configuration) -> tuple[object, ...]:
    """What a configuration says, without where it was read."""
    return (
        found.drive,
        found.current_d,
        found.current_q,
        found.speed,
        dict(found.own),
        found.contradictions,
        found.conventions,
    )


def compiler_of(*names: str) -> str:
    """The first compiler that is there; the test is skipped without one."""
    found = next((place for name in names if (place := shutil.which(name)) is not None), None)
    if found is None:
        pytest.skip(f"no {names[0]}")
    return found


def output_of(
    folder: Path, source: str, *, compiler: str | None = None, flags: tuple[str, ...] = C_FLAGS
) -> str:
    """What a program prints that is compiled from a file of a folder.

    Without a compiler of one's own that of C; the test is skipped where there is none.
    """
    chosen = compiler_of("gcc", "cc") if compiler is None else compiler
    program = folder / "main"
    subprocess.run([chosen, *flags, source, "-o", str(program)], cwd=folder, check=True)
    run = subprocess.run([str(program)], check=True, capture_output=True, text=True)
    return run.stdout
