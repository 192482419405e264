"""The list of what dqforge wrote into a folder: every file with its SHA-256,
by the command that made it.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import zlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import field
from functools import cache
from importlib import metadata
from pathlib import Path, PurePosixPath
from typing import Any

from dqforge import __version__
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.records import dataclass
from dqforge.reports.operating_system.host_compiler import find_compiler
from dqforge.reports.operating_system.system import KERNEL
from dqforge.reports.pages.answer import LARGEST_JSON, read_output
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.run_folder import MANIFEST

LAYOUT = 2


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


_WRITTEN = "the folder that 'dqforge run', 'export' or 'simulate' wrote"


@dataclass(frozen=True, slots=True)
class Part:
    """What one command wrote: the digest of its design, and the SHA-256 of each file
    by its name in the folder.

    ``version`` wrote it, ``computed_with`` the processor and the libraries of then. ``design`` is
    the name of the design with its prefix, empty where there is none; ``options`` are those of the
    command on which its files depend, with the command itself.
    """

    digest: str
    files: dict[str, str]
    version: str = __version__
    computed_with: dict[str, str] = field(default_factory=dict)
    design: str = ""
    options: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Manifest:
    """All parts of a folder by name."""

    parts: dict[str, Part]

    @property
    def files(self) -> dict[str, str]:
        """SHA-256 of every file by name."""
        return {name: digest for part in self.parts.values() for name, digest in part.files.items()}


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


def sha256(content: bytes) -> str:
    """SHA-256 in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def part_of(
    digest: str,
    files: Mapping[str, bytes],
    design: str = "",
    options: Mapping[str, str] | None = None,
) -> Part:
    """The part that files make here and now; arguments as of `Part`."""
    hashes = {name: sha256(content) for name, content in sorted(files.items())}
    return Part(
        digest, hashes, computed_with=computed_with(), design=design, options=dict(options or {})
    )


def _sealed(plain: dict[str, Any]) -> str:
    """SHA-256 over the list itself, so that a change of the list is seen as well."""
    return sha256(json.dumps(plain, sort_keys=True).encode("ascii"))


def to_bytes(manifest: Manifest) -> bytes:
    """The file: the same bytes for the same content."""
    parts = {
        name: {
            "dqforge": part.version,
            "computed_with": dict(sorted(part.computed_with.items())),
            "design": part.design,
            "design_sha256": part.digest,
            "options": dict(sorted(part.options.items())),
            "files": dict(sorted(part.files.items())),
        }
        for name, part in sorted(manifest.parts.items())
    }
    plain: dict[str, Any] = {"layout": LAYOUT, "parts": parts}
    return (json.dumps(plain | {"sha256": _sealed(plain)}, indent=1) + "\n").encode("ascii")


def _is_name(name: object) -> bool:
    """Whether a name stays inside the folder."""
    if not isinstance(name, str) or not name or "\\" in name or "\0" in name:
        return False
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and str(path) == name


def _texts(value: object) -> bool:
    return isinstance(value, dict) and all(isinstance(entry, str) for entry in value.values())


def _read_part(value: object) -> Part:
    """A part of plain data; raises ValueError where it is none."""
    if (
        not isinstance(value, dict)
        or not _texts(value.get("computed_with"))
        or not _texts(value.get("files"))
        or not _texts(value.get("options"))
    ):
        raise ValueError("no manifest")
    files, version, digest = value["files"], value.get("dqforge"), value.get("design_sha256")
    design = value.get("design")
    if (
        not isinstance(version, str)
        or not isinstance(digest, str)
        or not isinstance(design, str)
        or not all(_is_name(name) for name in files)
    ):
        raise ValueError("no manifest")
    return Part(
        digest, dict(files), version, dict(value["computed_with"]), design, dict(value["options"])
    )


def from_bytes(content: bytes) -> Manifest:
    """A list as `to_bytes` wrote it.

    Raises:
        ValueError: It is none, or it was changed.
    """
    try:
        loaded = strict_json(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    if not isinstance(loaded, dict) or loaded.get("layout") != LAYOUT:
        raise ValueError("no manifest")
    seal = loaded.pop("sha256", None)
    parts = loaded.get("parts")
    if not isinstance(parts, dict) or seal != _sealed(loaded):
        raise ValueError("no manifest, or changed")
    found = Manifest({name: _read_part(part) for name, part in parts.items()})
    if to_bytes(found) != content.replace(b"\r\n", b"\n"):
        raise ValueError("not as it was written")
    return found


def read_manifest(folder: Path) -> Manifest:
    """The list of a folder.

    Raises:
        InputError: There is none, or it is not what dqforge wrote.
    """
    path = folder / MANIFEST
    content = read_output(path, _WRITTEN, LARGEST_JSON)
    try:
        return from_bytes(content)
    except ValueError as error:
        raise InputError(
            "is not what dqforge wrote; run the design again", source=str(path)
        ) from error


def find_manifest(folder: Path) -> Manifest | None:
    """The list of a folder, None where there is none that can be trusted."""
    try:
        return from_bytes(read_regular_file(folder / MANIFEST, LARGEST_JSON))
    except (InputError, ValueError):
        return None
