"""What `dqforge doctor` answers: what this machine has, what it is for, and how to get the rest."""

from __future__ import annotations

from dqforge.reports.operating_system.packages import (
    COMPILERS,
    LEAST_FREE,
    WAYS,
    Machine,
    Package,
    Program,
    Trial,
    look,
)
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.plain_data import PlainData

_NAMES = {"c": "C compiler", "c++": "C++ compiler"}


def answer_doctor() -> Answer:
    """Look at this machine; the exit code is 1 where the main job cannot be done on it."""
    stage("trying the compilers")
    machine = look()
    tables = (_about(machine), _programs(machine), _packages(machine))
    broken = machine.broken
    notes = broken or ("everything that dqforge run needs is installed",)
    return Answer("", tables, _plain(machine), notes=notes, exit_code=1 if broken else 0)


def _about(machine: Machine) -> Table:
    terminal = machine.terminal
    free = f"{machine.free_bytes / 1e9:.1f} GB free"
    scarce = "; make room" if machine.free_bytes < LEAST_FREE else ""
    where = f"{terminal.columns} columns" if terminal.interactive else "none: a pipe or a file"
    rows = (
        ("dqforge", machine.version),
        ("Python", f"{machine.python} ({machine.executable})"),
        ("system", f"{machine.system}, {machine.processor}, {machine.cores} cores"),
        ("temporary files", f"{machine.temporary}, {free}{scarce}"),
        ("terminal", f"{where}, {terminal.encoding}"),
    )
    return Table("This machine", ("", ""), rows)


def _tried(trial: Trial) -> tuple[str, ...]:
    name, use, get = _NAMES[trial.language], COMPILERS[trial.language], WAYS[trial.language].here()
    if not trial.compiler:
        return (name, "no", use, get)
    if trial.failure:
        return (name, f"{trial.path} fails: {trial.failure}", use, get)
    return (name, f"works: {trial.compiler}, {trial.path}", use, "")


def _found(program: Program) -> tuple[str, ...]:
    if not program.path:
        return (program.name, "no", program.use, program.get)
    there = " ".join(word for word in (program.version, program.path) if word)
    if program.lacks:
        return (program.name, f"{there}; {program.lacks}", program.use, program.get)
    return (program.name, there, program.use, "")


def _programs(machine: Machine) -> Table:
    rows = (*map(_tried, machine.trials), *map(_found, machine.programs))
    return Table("Programs", ("program", "here", "for", "how to get it"), rows)


def _row(package: Package) -> tuple[str, ...]:
    get = "" if package.version else package.get
    return (package.name, package.version or "no", package.use, get)


def _packages(machine: Machine) -> Table:
    rows = tuple(_row(package) for package in machine.packages)
    return Table("Packages of Python", ("package", "here", "for", "how to get it"), rows)


def _plain(machine: Machine) -> PlainData:
    terminal = machine.terminal
    return {
        "ready": not machine.broken,
        "broken": list(machine.broken),
        "machine": {
            "system": machine.system,
            "processor": machine.processor,
            "cores": machine.cores,
            "python": machine.python,
            "executable": machine.executable,
            "temporary": machine.temporary,
            "free_bytes": machine.free_bytes,
            "terminal": {
                "interactive": terminal.interactive,
                "encoding": terminal.encoding,
                "columns": terminal.columns,
            },
        },
        "compilers": [
            {
                "language": trial.language,
                "name": trial.compiler or None,
                "path": trial.path or None,
                "works": not trial.failure,
                "failure": trial.failure or None,
                "for": COMPILERS[trial.language],
                "get": WAYS[trial.language].here(),
            }
            for trial in machine.trials
        ],
        "programs": [
            {
                "name": program.name,
                "path": program.path or None,
                "version": program.version or None,
                "lacks": program.lacks or None,
                "for": program.use,
                "get": program.get,
            }
            for program in machine.programs
        ],
        "packages": [
            {
                "name": package.name,
                "version": package.version or None,
                "needed": package.needed,
                "for": package.use,
                "get": package.get,
            }
            for package in machine.packages
        ],
    }
