"""The cross compiler and the emulator: programs built for an emulated
Cortex-M and run to their end.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.ways_to_get import WAYS
from dqforge.reports.pages.templating import render

# Exit codes by which a program on a target says something; the emulator's own failures end with 1.
_COMPILER = "arm-none-eabi-gcc"
_EMULATOR = "qemu-system-arm"
_TIMEOUT_S = 60
PROGRAM_CODES = range(100, 120)


@dataclass(frozen=True, slots=True)
class Target:
    """A core with the board that emulates it: compiler flags, QEMU's machine,
    and where its memories lie.
    """

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
        ("-mcpu=cortex-m33", "-mfloat-abi=hard", "-mfpu=fpv5-sp-d16"),
        "mps2-an505",
        0x10000000,
        0x38000000,
    ),
}


def target_of(name: str) -> Target:
    """The target of a name; raises `InputError` when there is none."""
    if name not in TARGETS:
        raise InputError(f"--target: expected one of {', '.join(TARGETS)}, got '{name}'")
    return TARGETS[name]


def program(name: str) -> str:
    """Path of a tool; raises `VerificationError` with the Debian package of one that is missing."""
    path = shutil.which(name)
    if path is None:
        packages = " and ".join(WAYS[name].apt)
        raise VerificationError(f"{name} is missing; install the Debian package {packages}")
    return path


def execute(command: list[str], what: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program to its end inside a folder."""
    try:
        return subprocess.run(
            command,
            cwd=folder,
            env=os.environ | {"LC_ALL": "C"},  # whose messages are searched for "error"
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {_TIMEOUT_S} s") from error
    except OSError as error:
        raise VerificationError(f"{what} cannot be started ({error.strerror})") from error


def require_library(target: str, folder: Path) -> None:
    """Raise `VerificationError` where the compiler has no C library for a target."""
    command = [program(_COMPILER), *TARGETS[target].flags, "-mthumb", "-print-file-name=libnosys.a"]
    found = execute(command, f"the compiler for {target}", folder).stdout.strip()
    if not Path(found).is_absolute():  # the bare name comes back for what is nowhere
        raise VerificationError(
            f"the C library of {_COMPILER} is missing; install the Debian package "
            "libnewlib-arm-none-eabi"
        )


def compile_files(arguments: list[str], target: str, folder: Path) -> None:
    """Run the compiler inside a folder with the flags of a target.

    Raises `VerificationError` with its first error.
    """
    # Without -fno-math-errno the compiler guards a square root by a call.
    common = [
        "-std=c99",
        "-O2",
        "-mthumb",
        "-ffp-contract=off",
        "-fno-math-errno",
        *TARGETS[target].flags,
    ]
    done = execute([program(_COMPILER), *common, *arguments], f"the compiler for {target}", folder)
    if done.returncode != 0:
        lines = done.stderr.splitlines()
        first = next((line for line in lines if "error" in line), "; ".join(lines)[:200])
        raise VerificationError(f"the headers do not compile for {target}: {first}")


def build(sources: Mapping[str, bytes], strict: tuple[str, ...], target: str, folder: Path) -> None:
    """Compile C files and link them with the start-up code to ``target.elf``.

    Args:
        sources: Contents of headers and of C files by name.
        strict: Flags for the C files, such as those that turn warnings into errors.
        target: One of `TARGETS`.
        folder: An empty folder, in which the object files stay.

    Raises:
        VerificationError: A tool is missing, or the files do not compile.
    """
    board = target_of(target)
    program(_EMULATOR)  # what is missing is said before anything is compiled
    require_library(target, folder)
    memory = {"flash": board.flash, "ram": board.ram, "ram_size": board.ram_size}
    for name, template in (("target_start.c", "start.c.j2"), ("target.ld", "target.ld.j2")):
        text = render(f"verification/{template}", memory)
        (folder / name).write_text(text, encoding="ascii", newline="\n")
    for name, content in sources.items():
        (folder / name).write_bytes(content)
    compile_files(["-c", "target_start.c"], target, folder)
    modules = [name for name in sources if name.endswith(".c")]
    for name in modules:
        compile_files([*strict, "-c", name], target, folder)
    objects = [f"{Path(name).stem}.o" for name in ("target_start.c", *modules)]
    compile_files(
        [
            "-nostartfiles",
            "-T",
            "target.ld",
            *objects,
            "-lm",
            "-lc",
            "-lgcc",
            "-lnosys",
            "-o",
            "target.elf",
        ],
        target,
        folder,
    )


def emulate(target: str, folder: Path, *options: str) -> int:
    """Run ``target.elf`` on its board and return the exit code of the program.

    Raises:
        VerificationError: The emulator failed (it ends with 1), or the program met a fault.
    """
    command = [
        program(_EMULATOR),
        "-M",
        TARGETS[target].machine,
        "-nographic",
        "-monitor",
        "none",
        "-serial",
        "none",
    ]
    command += [*options, "-semihosting-config", "enable=on,target=native", "-kernel", "target.elf"]
    done = execute(command, f"the emulated {target}", folder)
    if done.returncode not in (0, *PROGRAM_CODES):
        said = "".join(f": {line}" for line in done.stderr.splitlines()[:1])
        raise VerificationError(
            f"the emulated {target} stopped with exit code {done.returncode}{said}"
        )
    return done.returncode
