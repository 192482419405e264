"""What this machine has of all that dqforge can use, and what each is for."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from dqforge import __version__
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import NO_COMPILER
from dqforge.reports.operating_system.packages import Package, packages
from dqforge.reports.operating_system.system import processors
from dqforge.reports.operating_system.trial import Trial, try_compiler
from dqforge.reports.operating_system.ways_to_get import WAYS

_TIMEOUT_S = 20

# Bytes of temporary files below which a remark is worth it: zig's libraries take 50 MB, a large
# study's keys some hundred.
LEAST_FREE = 500_000_000

# Programs beside the compilers of the host, and what they are for.
PROGRAMS = {
    "arm-none-eabi-gcc": "dqforge verify --target; cycles and bytes on Cortex-M",
    "arm-none-eabi-objdump": "cycles on Cortex-M",
    "arm-none-eabi-size": "bytes on Cortex-M",
    "qemu-system-arm": "dqforge verify --target; cycles on Cortex-M",
    "cppcheck": "static checks of the emitted C of your own; no command calls it",
}

COMPILERS = {
    "c": "run, export, verify (C99); simulate; estimators --starts",
    "c++": "run, export, verify (C++11)",
}


@dataclass(frozen=True, slots=True)
class Program:
    """A program, or why it is of no use; ``path`` is empty where it is not there."""

    name: str
    use: str
    get: str
    path: str = ""
    version: str = ""
    lacks: str = ""


@dataclass(frozen=True, slots=True)
class Terminal:
    """Where stdout goes."""

    interactive: bool
    encoding: str
    columns: int


@dataclass(frozen=True, slots=True)
class Machine:
    """All of it."""

    system: str
    processor: str
    cores: int
    python: str
    executable: str
    version: str
    temporary: str
    free_bytes: int
    terminal: Terminal
    trials: tuple[Trial, ...]
    programs: tuple[Program, ...]
    packages: tuple[Package, ...]

    @property
    def broken(self) -> tuple[str, ...]:
        """What keeps dqforge from its main job, a sentence each; empty where nothing does."""
        first = self.trials[0]
        failure = f"C compiler: {first.failure}" if first.compiler else NO_COMPILER
        lost = [each for each in self.packages if each.needed and not each.version]
        return (
            *((failure,) if first.failure else ()),
            *(f"{each.name} is missing: {each.get}" for each in lost),
        )


def _first_line(command: list[str]) -> str:
    """What a program says first; empty where it says nothing."""
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    lines = (done.stdout or done.stderr).decode("utf-8", "replace").splitlines()
    return lines[0].strip() if lines and done.returncode == 0 else ""


def _version(path: str) -> str:
    """What a program calls its version, not what a distribution adds in parentheses."""
    said = re.sub(r"\([^)]*\)", "", _first_line([path, "--version"]))
    found = re.search(r"\d+(?:\.\d+)+", said)
    return "" if found is None else found[0]


def _newlib_lacks(path: str) -> str:
    """What a cross compiler lacks of its C library; empty where that is there."""
    said = _first_line([path, "-mcpu=cortex-m4", "-mthumb", "-print-file-name=libnosys.a"])
    return "" if Path(said).is_absolute() else "its C library newlib is missing"


def _program(name: str) -> Program:
    get, path = WAYS[name].here(), shutil.which(name)
    if path is None:
        return Program(name, PROGRAMS[name], get)
    lacks = _newlib_lacks(path) if name == "arm-none-eabi-gcc" else ""
    return Program(name, PROGRAMS[name], get, path, _version(path), lacks)


def _terminal() -> Terminal:
    stream = sys.stdout
    encoding = (getattr(stream, "encoding", None) or "").lower()
    return Terminal(stream.isatty(), encoding, shutil.get_terminal_size().columns)


def look() -> Machine:
    """Look at this machine; compilers are tried."""
    folder = tempfile.gettempdir()
    return Machine(
        system=f"{platform.system()} {platform.release()}",
        processor=platform.machine(),
        cores=processors(),
        python=platform.python_version(),
        executable=sys.executable,
        version=__version__,
        temporary=folder,
        free_bytes=shutil.disk_usage(folder).free,
        terminal=_terminal(),
        trials=(try_compiler("c"), try_compiler("c++")),
        programs=tuple(_program(name) for name in PROGRAMS),
        packages=packages(),
    )
