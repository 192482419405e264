"""Go through a page of the documentation as its reader does: type its commands, write its files,
run its Python, all in one empty folder, and compare what comes with what the page says.

As a program, ``python tests/documented_sessions.py PAGE...`` runs pages and prints what each cost;
``--update`` writes what came into the pages, their ``...`` kept. It needs nothing but Python, so
that it can drive the dqforge of another environment (``--programs ENVIRONMENT/bin``).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import NoReturn

from said_and_came import lines_that_came, same_drawing, told, updated
from session_pages import (
    Code,
    Command,
    CopiedFile,
    Figure,
    Page,
    PageError,
    Step,
    WrittenFile,
    read_page,
)

ROOT = Path(__file__).resolve().parent.parent
# Nothing that a page shows takes that long; what hangs ends all the same.
LONGEST_COMMAND = 600.0
# Runs the blocks that come on its first stream in one namespace; what each prints, by Python or by
# a program that it calls, goes back with whether it failed.
_INTERPRETER = """
import json, os, sys, tempfile, traceback
answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
printed = tempfile.TemporaryFile()
os.dup2(printed.fileno(), 1), os.dup2(printed.fileno(), 2)
names = {"__name__": "__main__"}
for asked in sys.stdin:
    name, text = json.loads(asked)
    failed = False
    try:
        exec(compile(text, name, "exec"), names)
    except BaseException:
        failed = True
        traceback.print_exc()
    sys.stdout.flush(), sys.stderr.flush()
    printed.seek(0)
    print(json.dumps([printed.read().decode("utf-8", "replace"), failed]), file=answers, flush=True)
    printed.seek(0), printed.truncate()
"""


class SessionError(Exception):
    """A page whose session goes otherwise than it says."""


def environment(programs: Path | None = None) -> dict[str, str]:
    """Environment of a session: the programs of an installation before those of the machine.

    Args:
        programs: Folder with ``dqforge`` and ``python``; by default that of this interpreter.
    """
    first = Path(sys.executable).parent if programs is None else programs.resolve()
    kept = {name: os.environ[name] for name in ("HOME", "SYSTEMROOT", "TEMP") if name in os.environ}
    path = os.pathsep.join([str(first), os.environ.get("PATH", os.defpath)])
    steady = {"LC_ALL": "C.UTF-8", "PYTHONUTF8": "1", "MPLBACKEND": "Agg"}
    return {**kept, **steady, "PATH": path}


@dataclass
class Session:
    """A page gone through in a folder.

    Attributes:
        changes: Lines that ``--update`` would write into the page: number of the first, how many
            they take the place of, and the lines.
    """

    page: Page
    folder: Path
    environment: Mapping[str, str]
    update: bool = False
    changes: list[tuple[int, int, list[str]]] = field(default_factory=list)
    _here: Path = field(init=False)
    _python: subprocess.Popen[str] | None = None

    def __post_init__(self) -> None:
        self._here = self.folder

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._python is not None:
            self._python.communicate()

    def go(self) -> None:
        """Go through every step.

        Raises:
            SessionError: At the first step that goes otherwise than the page says.
        """
        for step in self.page.steps:
            self._take(step)

    def _take(self, step: Step) -> None:
        match step:
            case Command():
                self._type(step)
            case Code():
                self._execute(step)
            case WrittenFile(name=name, content=content):
                target = self._target(step, name)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(content, encoding="utf-8", newline="\n")
            case CopiedFile(name=name, source=source):
                self._copy(step, name, source)
            case Figure():
                self._look(step)

    def _type(self, command: Command) -> None:
        place = self.folder.parent / f"{self.folder.name}.place"
        text = f"trap 'pwd -P >{place.as_posix()}' EXIT\n{command.text}"
        try:
            done = subprocess.run(
                ["bash", "-c", text],
                cwd=self._here,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                encoding="utf-8",
                errors="replace",
                timeout=LONGEST_COMMAND,
                check=False,
            )
        except subprocess.TimeoutExpired:
            self._fail(command, f"is still running after {LONGEST_COMMAND:.0f} s")
        self._here = Path(place.read_text(encoding="utf-8").strip())
        place.unlink()
        came = lines_that_came(done.stdout)
        if done.returncode != command.exit_code:
            said = f"exit code {done.returncode}, the page says {command.exit_code}"
            self._fail(command, "\n  | ".join([said, *came]))
        if command.expected:
            self._compare(command, command.expected, came, command.under)

    def _execute(self, code: Code) -> None:
        if self._python is None:
            python = shutil.which("python", path=self.environment["PATH"])
            self._python = subprocess.Popen(
                [python or "python", "-u", "-c", _INTERPRETER],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                encoding="utf-8",
            )
        asked = [self.page.path.name, "\n" * (code.line - 1) + code.text]
        assert self._python.stdin is not None
        assert self._python.stdout is not None
        self._python.stdin.write(json.dumps(asked) + "\n")
        self._python.stdin.flush()
        answer = self._python.stdout.readline()
        if not answer:
            self._fail(code, "ended the interpreter")
        printed, failed = json.loads(answer)
        came = lines_that_came(printed)
        if failed:
            self._fail(code, "\n  | ".join(["failed", *came]))
        if code.expected is not None:
            self._compare(code, code.expected, came, code.under)

    def _compare(
        self, step: Command | Code, said: Sequence[str], came: Sequence[str], under: int
    ) -> None:
        difference = told(said, came, under)
        if difference and not self.update:
            self._fail(step, difference)
        if difference:
            self.changes.append((under, len(said), updated(said, came)))

    def _copy(self, step: CopiedFile, name: str, source: str) -> None:
        origin = self.page.path.parent / source
        if not origin.is_file():
            self._fail(step, f"{source} is no file beside the page")
        shutil.copyfile(origin, self._target(step, name))

    def _target(self, step: Step, name: str) -> Path:
        """Place of a file of the session, inside its folder."""
        place = (self._here / name).resolve()
        if not place.is_relative_to(self.folder.resolve()):
            self._fail(step, f"{name} lies outside the folder of the session")
        return place

    def _look(self, figure: Figure) -> None:
        """Hold a figure of the page against that of the session, where it has drawn one."""
        shown = self.page.path.parent / figure.source
        drawn = self._here / shown.name
        if not drawn.is_file():
            return
        came = drawn.read_text(encoding="utf-8")
        if self.update:
            shown.write_text(came, encoding="utf-8", newline="\n")
        elif not shown.is_file():
            self._fail(figure, f"{figure.source} is missing; --update writes it")
        elif not same_drawing(shown.read_text(encoding="utf-8"), came):
            self._fail(figure, f"{figure.source} is not what the session draws; --update writes it")

    def _fail(self, step: Step, what: str) -> NoReturn:
        match step:
            case Command(text=text):
                name = f"$ {text}"
            case Code():
                name = "block of Python"
            case _:
                name = "file"
        path = self.page.path
        where = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
        raise SessionError(f"{where}:{step.line}: {name}\n{what}")


def missing_programs(page: Page, variables: Mapping[str, str]) -> list[str]:
    """Programs that a page needs and that are not on the path of the session."""
    return [name for name in page.requires if not shutil.which(name, path=variables["PATH"])]


def run_page(page: Page, folder: Path, variables: Mapping[str, str]) -> None:
    """Go through a page in an empty folder.

    Raises:
        SessionError: At the first step that goes otherwise than the page says: page, line, what
            differs.
    """
    with Session(page, folder, variables) as session:
        session.go()


def update_page(page: Page, folder: Path, variables: Mapping[str, str]) -> int:
    """Go through a page and write what came into it; returns the number of outputs changed."""
    with Session(page, folder, variables, update=True) as session:
        session.go()
    lines = page.path.read_text(encoding="utf-8").splitlines()
    for under, count, written in reversed(session.changes):
        lines[under - 1 : under - 1 + count] = written
    page.path.write_text("\n".join([*lines, ""]), encoding="utf-8", newline="\n")
    return len(session.changes)


def processor_time() -> float:
    """Processor time in s of all processes started from here that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> int:
    """Run or update the pages named; 1 where one goes otherwise or costs too much."""
    parser = argparse.ArgumentParser(description="Run the sessions of documentation pages.")
    parser.add_argument("pages", nargs="+", type=Path, metavar="PAGE")
    parser.add_argument("--update", action="store_true", help="write what comes into the pages")
    parser.add_argument("--programs", type=Path, help="folder of the dqforge to use")
    parser.add_argument("--limit", type=float, help="most processor time of a page in s")
    asked = parser.parse_args()
    variables = environment(asked.programs)
    failures = []
    say(f"{'page':<28}{'commands':>10}{'processor time':>18}")
    for path in asked.pages:
        try:
            row, spent = _row(read_page(path.resolve()), variables, asked.update)
        except (SessionError, PageError) as error:
            row, spent = f"{path.stem:<28}{'fails':>10}", 0.0
            failures.append(str(error))
        if asked.limit is not None and spent > asked.limit:
            failures.append(f"{path}: {spent:.0f} s of processor time, {asked.limit:.0f} permitted")
        say(row)
    for failure in failures:
        say(f"\n{failure}")
    return 1 if failures else 0


def _row(page: Page, variables: Mapping[str, str], update: bool) -> tuple[str, float]:
    """Run a page; its line of the table, and its processor time in s."""
    if missing := missing_programs(page, variables):
        raise SessionError(f"{page.path}: needs {' and '.join(missing)}")
    before = processor_time()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "session"
        folder.mkdir()
        run = update_page if update else run_page
        changed = run(page, folder, variables)
    spent = processor_time() - before
    count = sum(isinstance(step, Command | Code) for step in page.steps)
    note = f"   {changed} outputs changed" if changed else ""
    return f"{page.path.stem:<28}{count:>10}{spent:>16.1f} s{note}", spent


if __name__ == "__main__":
    sys.exit(main())
