"""What this machine has of all that dqforge can use, and what each is for."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path

from dqforge import __version__
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import NO_COMPILER
from dqforge.reports.operating_system.system import processors
from dqforge.reports.operating_system.trial import Trial, try_compiler
from dqforge.reports.operating_system.ways_to_get import WAYS

_TIMEOUT_S = 20

LEAST_FREE = 500_000_000
"""Bytes of temporary files below which a remark is worth it: zig's libraries take 50 MB, a large
study's keys some hundred.
"""

PROGRAMS = {
    "arm-none-eabi-gcc": "dqforge verify --target; cycles and bytes on Cortex-M",
    "arm-none-eabi-objdump": "cycles on Cortex-M",
    "arm-none-eabi-size": "bytes on Cortex-M",
    "qemu-system-arm": "dqforge verify --target; cycles on Cortex-M",
    "cppcheck": "static checks of the emitted C of your own; no command calls it",
}
"""Programs beside the compilers of the host, and what they are for."""

COMPILERS = {
    "c": "run, export, verify (C99); simulate; estimators --starts",
    "c++": "run, export, verify (C++11)",
}

PACKAGES = {
    "casadi": "phase currents of salient machines",
    "clarabel": "convex problems of cvxpy",
    "cvxpy": "observers by matrix inequalities, fits with side conditions",
    "daqp": "phase currents of machines with any back-EMF",
    "distributed": "dqforge explore on several cores and on clusters",
    "h5py": "HDF5 files, MAT files of version 7.3",
    "jinja2": "headers and reports",
    "matplotlib": "figures",
    "nlopt": "searches of a few variables",
    "numpy": "arrays",
    "osqp": "a second opinion on phase currents",
    "piqp": "phase currents of machines with any back-EMF",
    "pyarrow": "parts of a study (dqforge explore)",
    "pydantic": "checks of the design file",
    "pymoo": "search.method: nsga2 of a study",
    "python-calamine": "spreadsheets (XLSX, XLS, ODS)",
    "python-flint": "proven error bounds",
    "pyyaml": "design files",
    "rich": "tables in a terminal",
    "scipy": "splines, linear algebra",
    "typer": "the command line",
    "xarray": "to_xarray of results, from Python",
    "ziglang": "a C and C++ compiler where none is installed",
}
"""Packages of Python, and what they are for."""

EXTRAS = ("h5", "explore", "cc")
"""Optional parts that a user installs; the others are for work on dqforge itself."""


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
class Package:
    """A package of Python.

    Parameters
    ----------
    name, use:
        As the package index has it; what it is for.
    version:
        Empty where it is not installed.
    needed:
        Whether dqforge needs it for more than a part of its work.
    get:
        Command that installs it.
    """

    name: str
    use: str
    version: str
    needed: bool
    get: str


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


def _packages() -> tuple[Package, ...]:
    """Those that the installed dqforge says that it needs or can use, and xarray."""
    found: dict[str, tuple[bool, str]] = {"xarray": (False, "python -m pip install xarray")}
    for line in metadata.requires("dqforge") or ():
        name = re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0].lower()
        extra = re.search(r"extra\s*==\s*[\"']([a-z0-9]+)[\"']", line)
        if extra is None:
            found[name] = (True, f"python -m pip install {name}")
        elif extra[1] in EXTRAS and name not in found:
            found[name] = (False, f"python -m pip install 'dqforge[{extra[1]}]'")
    return tuple(
        Package(name, PACKAGES.get(name, ""), _installed(name), needed, get)
        for name, (needed, get) in sorted(found.items())
    )


def _installed(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


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
        packages=_packages(),
    )
