"""Proof by execution on an emulated Cortex-M: the emitted headers compiled for it, run on their vectors, and costed.

The vectors hold the bits of the float32 model; the emulated core must give them without any difference.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dqforge.machines.errors import InputError, VerificationError
from dqforge.reports.templating import render
from dqforge.reports.verify import WARNINGS

_COMPILER = "arm-none-eabi-gcc"
_EMULATOR = "qemu-system-arm"
_PACKAGES = {
    _COMPILER: "gcc-arm-none-eabi and libnewlib-arm-none-eabi",
    "arm-none-eabi-size": "binutils-arm-none-eabi",
    _EMULATOR: "qemu-system-arm",
}
_TIMEOUT_S = 60
_CALIBRATION = 400
_DIFFERS = {101: "current reference", 102: "phase currents"}
"""Exit codes of the program on the target; the emulator's own failures end with 1."""


@dataclass(frozen=True, slots=True)
class Target:
    """A core with the board that emulates it: compiler flags, QEMU's machine, and where its memories lie."""

    flags: tuple[str, ...]
    machine: str
    flash: int = 0x0
    ram: int = 0x20000000
    ram_size: int = 64


TARGETS: dict[str, Target] = {
    "cortex-m0plus": Target(("-mcpu=cortex-m0plus", "-mfloat-abi=soft"), "microbit", ram_size=16),
    "cortex-m3": Target(("-mcpu=cortex-m3", "-mfloat-abi=soft"), "mps2-an385"),
    "cortex-m4": Target(("-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"), "mps2-an386"),
    "cortex-m7": Target(("-mcpu=cortex-m7", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "mps2-an500"),
    "cortex-m33": Target(
        ("-mcpu=cortex-m33", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"), "mps2-an505", 0x10000000, 0x38000000
    ),
}


@dataclass(frozen=True, slots=True)
class TargetVerification:
    """Outcome on a target that found no difference.

    ``vectors`` were run; ``instructions`` is the mean number retired over them for both currents, beyond a function
    that does nothing; ``flash`` is the code of such a function with its constants in bytes.
    """

    target: str
    vectors: int
    instructions: float
    flash: int


def target_of(name: str) -> Target:
    """The target of a name; raises `InputError` when there is none."""
    if name not in TARGETS:
        raise InputError(f"--target: expected one of {', '.join(TARGETS)}, got '{name}'")
    return TARGETS[name]


def _program(name: str) -> str:
    path = shutil.which(name)
    if path is None:
        raise VerificationError(f"{name} is missing; install the Debian package {_PACKAGES[name]}")
    return path


def _execute(command: list[str], what: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program to its end inside a folder."""
    try:
        return subprocess.run(
            command,
            cwd=folder,
            env=os.environ | {"LC_ALL": "C"},  # whose messages are searched for "error"
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(f"{what} cannot be started ({error.strerror})") from error


def _require_library(target: str, folder: Path) -> None:
    command = [_program(_COMPILER), *TARGETS[target].flags, "-mthumb", "-print-file-name=libnosys.a"]
    found = _execute(command, f"the compiler for {target}", folder).stdout.strip()
    if not Path(found).is_absolute():  # the bare name comes back for what is nowhere
        raise VerificationError(
            f"the C library of {_COMPILER} is missing; install the Debian package libnewlib-arm-none-eabi"
        )


def _compile(arguments: list[str], target: str, folder: Path) -> None:
    # Without -fno-math-errno the compiler guards a square root by a call.
    common = ["-std=c99", "-O2", "-mthumb", "-ffp-contract=off", "-fno-math-errno", *TARGETS[target].flags]
    done = _execute([_program(_COMPILER), *common, *arguments], f"the compiler for {target}", folder)
    if done.returncode != 0:
        lines = done.stderr.splitlines()
        first = next((line for line in lines if "error" in line), "; ".join(lines)[:200])
        raise VerificationError(f"the headers do not compile for {target}: {first}")


def verify_on_target(files: Mapping[str, bytes], prefix: str, target: str) -> TargetVerification:
    """Compile the headers for a target and run all their test vectors on its emulation.

    Parameters
    ----------
    files:
        Contents of the headers and of their vectors by name; those of phase currents are run as well.
    prefix:
        Checked C identifier.
    target:
        One of `TARGETS`.

    Raises
    ------
    InputError
        There is no such target.
    VerificationError
        A tool is missing (its Debian package is named), the headers do not compile, or a result differs.
    """
    board = target_of(target)
    context = {
        "prefix": prefix,
        "macro": prefix.upper(),
        "waveform": f"{prefix}_waveform_vectors.h" in files,
        "flash": board.flash,
        "ram": board.ram,
        "ram_size": board.ram_size,
        "calibration": _CALIBRATION,
        "reference_differs": min(_DIFFERS),
        "phases_differ": max(_DIFFERS),
    }
    emulator, sizer = _program(_EMULATOR), _program("arm-none-eabi-size")
    with tempfile.TemporaryDirectory(prefix="dqforge-") as name:
        folder = Path(name)
        _require_library(target, folder)
        for file_name, content in files.items():
            (folder / file_name).write_bytes(content)
        for template in ("target_start.c", "target_main.c", "target_cost.c", "target.ld"):
            (folder / template).write_text(render(f"{template}.j2", context), encoding="ascii")
        _compile(["-c", "target_start.c"], target, folder)
        _compile([*WARNINGS, "-Wno-overlength-strings", "-c", "target_main.c"], target, folder)
        _compile([*WARNINGS, "-c", "target_cost.c"], target, folder)
        linked = ["-nostartfiles", "-T", "target.ld", "target_start.o", "target_main.o"]
        _compile([*linked, "-lm", "-lc", "-lgcc", "-lnosys", "-o", "target.elf"], target, folder)
        ticks = _run(emulator, target, folder)
        sizes = _execute([sizer, "target_cost.o"], "arm-none-eabi-size", folder).stdout.splitlines()
    known, empty, full, count = ticks
    instructions = (full - empty) * _CALIBRATION / (known - empty)
    return TargetVerification(target, count, instructions, int(sizes[1].split()[0]))


def _run(emulator: str, target: str, folder: Path) -> list[int]:
    """Ticks over the vectors of known instructions, of nothing and of the evaluator, and the number of vectors."""
    # With this shift every instruction takes the same virtual time, which the core's timer counts.
    command = [emulator, "-M", TARGETS[target].machine, "-nographic", "-monitor", "none", "-serial", "none"]
    command += ["-icount", "shift=10", "-semihosting-config", "enable=on,target=native", "-kernel", "target.elf"]
    done = _execute(command, f"the emulated {target}", folder)
    if done.returncode in _DIFFERS:
        which = _DIFFERS[done.returncode]
        raise VerificationError(f"on {target} the {which} do not give the results of their test vectors")
    numbers = [int(line) for line in (done.stdout + done.stderr).split() if line.isdigit()]
    if done.returncode != 0 or len(numbers) != 4 or numbers[0] <= numbers[1]:
        said = next((f": {line}" for line in done.stderr.splitlines() if not line.isdigit()), "")
        raise VerificationError(f"the emulated {target} stopped with exit code {done.returncode}{said}")
    return numbers
