"""The compilers of this machine: which one is taken, and programs that it makes.

Taken is the first of: what ``DQFORGE_CC`` and ``DQFORGE_CXX`` name, a compiler on the PATH, zig on
the PATH, zig from the package index (the extra ``cc``). ``CC`` is left alone: in the terminal of a
firmware engineer it often names a compiler for the target, whose programs do not run here.
"""

from __future__ import annotations

import errno
import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from dqforge.machines.errors import VerificationError, WritingError
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system import system

Language = Literal["c", "c++"]

# Environment variables that name a compiler, with flags if wanted.
VARIABLES: Mapping[Language, str] = {"c": "DQFORGE_CC", "c++": "DQFORGE_CXX"}

_NAMES: Mapping[Language, tuple[str, ...]] = {
    "c": ("cc", "gcc", "clang"),
    "c++": ("c++", "g++", "clang++"),
}

NO_COMPILER = "no C compiler found: python -m pip install 'dqforge[cc]' brings one, or install gcc"
_TIMEOUT_S = 60
_ZIG_TIMEOUT_S = 300  # Its first call on a machine builds the libraries of C, for some ten seconds.
_BINARY_STREAMS = "binary_streams.c"


@dataclass(frozen=True, slots=True)
class HostCompiler:
    """A compiler that is there.

    Args:
        language: What it compiles.
        name: What messages call it.
        command: How it is started.
        zig: Whether it is clang as zig calls it.
    """

    language: Language
    name: str
    command: tuple[str, ...]
    zig: bool = False

    @property
    def for_windows(self) -> bool:
        """Whether its programs are those of Windows."""
        return system.WINDOWS or any("windows" in word for word in self.command)

    @property
    def flags(self) -> tuple[str, ...]:
        """Flags that make it a compiler like the others.

        zig adds traps on undefined behaviour to what is not optimised, and compiles for the very
        processor that it runs on.
        """
        if not self.zig:
            return ()
        own = ("-fno-sanitize=undefined",)
        told = any(word.startswith(("-target", "--target", "-mcpu")) for word in self.command)
        return own if told else (*own, "-mcpu=baseline")

    def environment(self, folder: Path) -> dict[str, str]:
        """The environment that it is started in; what it keeps of a source goes into ``folder``."""
        # C, for its messages are searched for "error"; what one that is killed leaves goes as well
        found = os.environ | {"LC_ALL": "C", "TMPDIR": str(folder)}
        if self.zig:
            found["ZIG_LOCAL_CACHE_DIR"] = str(folder / ".zig-cache")
            found.setdefault("ZIG_GLOBAL_CACHE_DIR", str(_libraries_of_zig(folder)))
        return found


def _libraries_of_zig(folder: Path) -> Path:
    """Where zig keeps the libraries of C that it has built: where it does by itself, unless nothing
    can be written there.
    """
    if system.WINDOWS:
        place = Path(os.environ.get("LOCALAPPDATA", "~"))
    else:
        place = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    try:
        place = place.expanduser() / "zig"
        place.mkdir(parents=True, exist_ok=True)
        if os.access(place, os.W_OK | os.X_OK):
            return place
    except (OSError, RuntimeError):  # there is no home
        pass
    return folder / ".zig-libraries"


def _named(language: Language) -> HostCompiler | None:
    """The compiler that an environment variable names; None where it is not set."""
    variable = VARIABLES[language]
    words = shlex.split(os.environ.get(variable, ""), posix=not system.WINDOWS)
    if not words:
        return None
    first, *others = (word.strip('"') for word in words)
    path = shutil.which(first)
    if path is None:
        raise VerificationError(
            f"{variable} names {first}, which is not there; name a compiler of this machine, or "
            f"unset {variable}"
        )
    zig = Path(first).stem == "zig" or "ziglang" in others
    return HostCompiler(language, " ".join((first, *others)), (path, *others), zig)


def _stands_for_nothing(path: str) -> bool:
    """Whether a compiler of macOS is the one that only asks to install the real one."""
    if not system.MACOS or not path.startswith("/usr/bin/"):
        return False
    asked = shutil.which("xcode-select")
    if asked is None:
        return False
    return subprocess.run([asked, "-p"], capture_output=True, check=False).returncode != 0


def _on_path(language: Language) -> HostCompiler | None:
    for name in _NAMES[language]:
        if system.WINDOWS and name.startswith("clang"):
            continue  # there it needs the libraries of Visual Studio, and knows no -lm
        path = shutil.which(name)
        if path is not None and not _stands_for_nothing(path):
            return HostCompiler(language, name, (path,))
    return None


def packaged_zig() -> Path | None:
    """The program of the extra ``cc``; None where that is not installed."""
    found = find_spec("ziglang")
    for folder in () if found is None else found.submodule_search_locations or ():
        program = Path(folder) / ("zig.exe" if system.WINDOWS else "zig")
        if program.is_file():
            return program
    return None


def _zig(language: Language) -> HostCompiler | None:
    """Zig as a compiler. As one of C++ it would first build that language's library, for most of a
    minute, of which nothing is used here: ``zig cc -x c++`` leaves it out.
    """
    path = shutil.which("zig") or packaged_zig()
    return None if path is None else HostCompiler(language, "zig cc", (str(path), "cc"), zig=True)


def find_compiler(language: Language = "c") -> HostCompiler | None:
    """The compiler that is taken; None where there is none.

    Raises:
        VerificationError: The environment variable names one that is not there.
    """
    return _named(language) or _on_path(language) or _zig(language)


def require_compiler(language: Language = "c") -> HostCompiler:
    """The compiler that is taken; raises `VerificationError` where there is none."""
    found = find_compiler(language)
    if found is None:
        raise VerificationError(NO_COMPILER)
    return found


def program_path(folder: Path, stem: str) -> Path:
    """Where a program lies that is compiled in a folder. Windows starts none without this suffix;
    to others it is a part of the name.
    """
    return folder / f"{stem}.exe"


def compile_program(
    compiler: HostCompiler,
    flags: Sequence[str],
    source: str,
    folder: Path,
    stem: str,
    failed: str,
) -> Path:
    """Compile one source file to a program.

    Args:
        compiler: Of `require_compiler`.
        flags: Standard, optimisation and warnings.
        source: Name of the file in the folder.
        folder: Where the program is written.
        stem: Name of the program, without suffix.
        failed: What the message says where the source does not compile, such as ``the header does
            not compile as c99``.

    Raises:
        VerificationError: The compiler cannot be started, does not end, or finds an error, the
            first of which is told.
    """
    program = program_path(folder, stem)
    sources = [source]
    if compiler.for_windows:
        text = system.c_source("binary_streams.c")
        (folder / _BINARY_STREAMS).write_text(text, encoding="ascii", newline="\n")
        sources.append(_BINARY_STREAMS)
    command = [*compiler.command, "-x", compiler.language, *flags, *compiler.flags]
    limit = _ZIG_TIMEOUT_S if compiler.zig else _TIMEOUT_S
    what = f"the {compiler.language.upper()} compiler {compiler.name}"
    try:
        done = subprocess.run(
            [*command, "-o", str(program), *sources, "-lm"],
            cwd=folder,
            env=compiler.environment(folder),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise VerificationError(f"{what} did not end within {limit} s") from error
    except OSError as error:
        raise VerificationError(f"{what} cannot be started ({error.strerror})") from error
    if done.returncode != 0:
        lines = done.stderr.decode("utf-8", "replace").splitlines()
        first = next((line for line in lines if "error" in line), "; ".join(lines)[:200])
        raise VerificationError(f"{failed} with {compiler.name}: {first}")
    return program


# Folders that one process at a time writes, and names in them that last.
#
# The lock goes with the process, however that ends. Linux and macOS lock the folder itself. Windows
# opens no folders: locked is a file in the folder for temporary files, whose name follows from the
# path.

_LONGEST_WAIT_S = 60.0
_TAKEN = (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)


class FolderTakenError(Exception):
    """Another process has the lock."""


def lock_folder(folder: Path) -> int:
    """Lock a folder; what comes back is closed by `os.close`, which gives the lock back.

    Where a file system knows no locks, nothing keeps two processes apart.

    Args:
        folder: It must exist.

    Raises:
        FolderTakenError: Another process has it.
        OSError: The folder cannot be opened.
    """
    handle = _open_stand_in(folder) if system.WINDOWS else os.open(folder, os.O_RDONLY)
    try:
        _lock(handle)
    except OSError as error:
        if error.errno in _TAKEN:
            os.close(handle)
            raise FolderTakenError from error
    return handle


@contextmanager
def alone(path: Path) -> Iterator[bool]:
    """Keep other runs from the folder in which something is written beside ``path``; the lock goes
    with the process, however that ends.

    Yields whether there is a lock: a folder that cannot be read has none.

    Raises:
        WritingError: Another run has it for a minute.
    """
    handle = _awaited(path)
    try:
        yield handle is not None
    finally:
        if handle is not None:
            os.close(handle)


def _awaited(path: Path) -> int | None:
    end = time.monotonic() + _LONGEST_WAIT_S
    while True:
        try:
            return lock_folder(path.parent)
        except FolderTakenError as error:
            if time.monotonic() > end:
                raise WritingError(
                    f"another run is writing beside {path}; wait for it, or choose another place"
                ) from error
            time.sleep(0.01)
        except OSError:
            return None


def _open_stand_in(folder: Path) -> int:
    real = os.path.normcase(os.path.realpath(folder))
    name = f"dqforge-{hashlib.sha256(real.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}.lock"
    return os.open(Path(tempfile.gettempdir()) / name, os.O_RDWR | os.O_CREAT, 0o600)


def _lock(handle: int) -> None:
    # Each module is there on its own system alone.
    if system.WINDOWS:
        windows = import_module("msvcrt")
        windows.locking(handle, windows.LK_NBLCK, 1)
    else:
        posix = import_module("fcntl")
        posix.flock(handle, posix.LOCK_EX | posix.LOCK_NB)


def flush_folder(folder: Path) -> None:
    """Make new names in a folder last a loss of power; Windows has no call for it."""
    if system.WINDOWS:
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
