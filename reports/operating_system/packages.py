"""Packages of Python: what each is for, which are here, and what is said where one is missing."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import metadata

from dqforge.machines.errors import InputError

# Packages of Python, and what they are for.
PACKAGES = {
    "casadi": "phase currents of salient machines, Kalman filters of sensorless drives",
    "clarabel": "smoothing of flux maps, proofs of current loops over tolerances",
    "cvxpy": "the proof that a flux observer converges (with clarabel)",
    "daqp": "phase currents of machines with any back-EMF, equal phases",
    "distributed": "dqforge explore on several cores and on clusters",
    "h5py": "HDF5 files, MAT files of version 7.3",
    "jinja2": "headers and reports",
    "matplotlib": "figures",
    "nlopt": "optimised gains of loops and observers, breakpoints of tables, searches of a study",
    "numpy": "arrays",
    "osqp": "phase currents of machines with any back-EMF, solved a second time",
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
EXTRAS = ("h5", "explore", "serve", "cc")


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
