"""Packages of Python and programs that dqforge calls: what each is for, which are here, how the
others are got, and what is said where one is missing.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zlib
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge import __version__
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.files.scratch import scratch_folder
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.host_compiler import (
    NO_COMPILER,
    Language,
    compile_program,
    find_compiler,
    require_compiler,
)
from dqforge.reports.operating_system.system import KERNEL, processors

# What says that a package is missing loads none.
if TYPE_CHECKING:
    import numpy as np

# Packages of Python, and what they are for.
PACKAGES = {
    "asammdf": "MDF logs of a bench",
    "casadi": "phase currents of salient machines, Kalman filters of sensorless drives",
    "clarabel": "smoothing of flux maps, proofs of current loops over tolerances",
    "cvxpy": "the proof that position observers converge (with clarabel)",
    "daqp": "phase currents of machines with any back-EMF, equal phases",
    "distributed": "dqforge explore on several cores and on clusters",
    "h5py": "HDF5 files, MAT files of version 7.3",
    "jinja2": "headers and reports",
    "matplotlib": "figures",
    "nlopt": "optimised gains of loops and observers, breakpoints of tables, searches of a study",
    "nptdms": "TDMS logs of a bench",
    "numpy": "arrays",
    "osqp": "phase currents of machines with any back-EMF, a second opinion",
    "piqp": "phase currents of machines with any back-EMF, unlike phases",
    "pyarrow": "parts of a study (dqforge explore)",
    "pydantic": "checks of the design file",
    "pymoo": "search.method: nsga2 of a study",
    "python-calamine": "spreadsheets (XLSX, XLS, ODS)",
    "python-flint": "proven error bounds",
    "pyyaml": "design files",
    "rich": "tables in a terminal",
    "scipy": "splines, linear algebra",
    "tornado": "dqforge serve",
    "typer": "the command line",
    "xarray": "to_xarray of results, from Python",
    "ziglang": "a C and C++ compiler where none is installed",
}

# Optional parts that a user installs; the others are for work on dqforge itself.
EXTRAS = ("h5", "logs", "explore", "serve", "cc")


@dataclass(frozen=True, slots=True)
class Package:
    """A package of Python.

    Args:
        name, use: As the package index has it; what it is for.
        version: Empty where it is not installed.
        needed: Whether dqforge needs it for more than a part of its work.
        get: Command that installs it.
    """

    name: str
    use: str
    version: str
    needed: bool
    get: str


def packages() -> tuple[Package, ...]:
    """Those that the installed dqforge says that it needs or can use, and xarray."""
    found: dict[str, tuple[bool, str]] = {"xarray": (False, "python -m pip install xarray")}
    for line in _required():
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


def _required() -> list[str]:
    """Lines of what dqforge requires; none where it runs from its folder, not installed."""
    try:
        return metadata.requires("dqforge") or []
    except metadata.PackageNotFoundError:
        return []


def _installed(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ""


# Packages whose modules are called otherwise.
_OTHER_NAMES = {
    "dask": "distributed",
    "flint": "python-flint",
    "pydantic_core": "pydantic",
    "python_calamine": "python-calamine",
    "yaml": "pyyaml",
}


def without_package(error: ImportError) -> InputError | None:
    """What to say where a package of others cannot be imported; None for a module of our own."""
    module = (error.name or "").partition(".")[0]
    name = _OTHER_NAMES.get(module, module.replace("_", "-").lower())
    if not module or module == "dqforge" or name not in PACKAGES:
        return None
    try:
        ways = {package.name: package.get for package in packages()}
    except metadata.PackageNotFoundError:
        ways = {}
    wrong = "is not installed" if isinstance(error, ModuleNotFoundError) else "cannot be loaded"
    get = ways.get(name, f"python -m pip install {name}")
    return InputError(f"the package {name} {wrong}; it is for {PACKAGES[name]}; {get}")


# How the programs that dqforge calls are got: the one table of packages, by who installs them.

EXTRA_CC = "python -m pip install 'dqforge[cc]'"


@dataclass(frozen=True, slots=True)
class Ways:
    """Packages that bring a program.

    Args:
        apt: Of Debian and Ubuntu.
        dnf: Of Fedora.
        brew: Command on macOS.
        winget: Identifier on Windows.
        pip: Command for every system, empty where there is none.
    """

    apt: tuple[str, ...]
    dnf: tuple[str, ...]
    brew: str
    winget: str
    pip: str = ""

    def here(self) -> str:
        """The command for this system; that for every system where none of it is known."""
        if system.WINDOWS:
            own = f"winget install {self.winget}"
        elif system.MACOS:
            own = self.brew
        elif shutil.which("apt-get"):
            own = f"sudo apt-get install {' '.join(self.apt)}"
        elif shutil.which("dnf"):
            own = f"sudo dnf install {' '.join(self.dnf)}"
        else:
            own = "" if self.pip else f"install {' and '.join(self.apt)}"
        return " or ".join(way for way in (self.pip, own) if way)


_GCC_OF_WINDOWS = "BrechtSanders.WinLibs.POSIX.UCRT"
_ARM = Ways(
    ("gcc-arm-none-eabi", "libnewlib-arm-none-eabi"),
    ("arm-none-eabi-gcc-cs", "arm-none-eabi-newlib"),
    "brew install --cask gcc-arm-embedded",
    "Arm.GnuArmEmbeddedToolchain",
)
_ARM_TOOLS = Ways(
    ("binutils-arm-none-eabi",), ("arm-none-eabi-binutils-cs",), _ARM.brew, _ARM.winget
)

# By program; compilers of the host by their language.
WAYS: dict[str, Ways] = {
    "c": Ways(("gcc",), ("gcc",), "xcode-select --install", _GCC_OF_WINDOWS, EXTRA_CC),
    "c++": Ways(("g++",), ("gcc-c++",), "xcode-select --install", _GCC_OF_WINDOWS, EXTRA_CC),
    "arm-none-eabi-gcc": _ARM,
    "arm-none-eabi-size": _ARM_TOOLS,
    "arm-none-eabi-objdump": _ARM_TOOLS,
    "qemu-system-arm": Ways(
        ("qemu-system-arm",),
        ("qemu-system-arm",),
        "brew install qemu",
        "SoftwareFreedomConservancy.QEMU",
    ),
    "cppcheck": Ways(("cppcheck",), ("cppcheck",), "brew install cppcheck", "Cppcheck.Cppcheck"),
}


# What this machine has of all that dqforge can use, and what each is for.

_TRIAL_TIMEOUT_S = 20

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
            timeout=_TRIAL_TIMEOUT_S,
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


# A trial of the compiler that would be taken: a small program is compiled, run and believed only
# if its results are those of numpy.

_TIMEOUT_S = 60

_FLAGS = ("-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror")

_STANDARDS: dict[Language, str] = {"c": "c99", "c++": "c++11"}


def _inputs() -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Rows of three numbers, among them the bytes that text streams of Windows change."""
    import numpy as np

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
        with scratch_folder() as folder:
            source = system.c_source("trial.c")
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


# What the last digits of a result may depend on.

_COMPUTED_WITH = (
    "numpy",
    "scipy",
    "casadi",
    "clarabel",
    "nlopt",
    "daqp",
    "piqp",
    "osqp",
    "python-flint",
    "matplotlib",
    "jinja2",
)


@cache
def _library_versions() -> dict[str, str]:
    found = {}
    for name in _COMPUTED_WITH:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


@cache
def _kernels() -> str:
    """The instructions that numpy and its linear algebra use on this processor."""
    import numpy as np

    core = getattr(np, "_core", None)
    features = getattr(getattr(core, "_multiarray_umath", None), "__cpu_features__", {})
    levels = [name for name in ("X86_V3", "X86_V4", "SVE", "ASIMD") if features.get(name)]
    return " ".join([os.environ.get(KERNEL, "own"), *levels])


@cache
def _compiler() -> str:
    """What the compiler of simulations is called, empty where there is none."""
    try:
        found = find_compiler()
    except VerificationError:
        return ""
    return "" if found is None else found.name


def computed_with() -> dict[str, str]:
    """Processor, its kernels, and versions of the libraries on which the last digits of a result
    may depend.
    """
    machine = {
        "processor": platform.machine(),
        "kernels": _kernels(),
        "python": platform.python_version(),
        "libc": " ".join(platform.libc_ver()),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "compiler": _compiler(),
    }
    return machine | _library_versions()
