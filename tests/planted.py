"""A run of pytest that collects once, and then answers questions each in a fork of itself.

`tests/mutants.py` writes a question as a line of JSON: which case of the named files is the first
to fail, where the functions of one module are those that its file has now. What reads the file
itself, a template or a command, finds the change there.
"""

from __future__ import annotations

import cProfile
import gc
import json
import os
import resource
import select
import signal
import sys
from collections import defaultdict
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NoReturn

import pytest

# Of one case, on a busy machine; those that run by default take about a second.
SILENT_S = 60.0
WHOLE, TIME, LOADS = "whole", "time", "loads"
EXPRESSION = "not slow and not benchmark"


def _codes(code: CodeType, found: dict[str, list[CodeType]]) -> dict[str, list[CodeType]]:
    """Every function of a compiled module by its qualified name, in the order of the source."""
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            found.setdefault(inner.co_qualname, []).append(inner)
            _codes(inner, found)
    return found


class Forks:
    """Answers questions in place of the loop over the cases."""

    def __init__(self, asked: int, answers: int) -> None:
        self.asked = os.fdopen(asked)
        self.answers = os.fdopen(answers, "w")
        # What runs while modules load cannot be exchanged afterwards.
        self.loading = cProfile.Profile(subcalls=False, builtins=False)
        self.loading.enable()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Try change after change, each in a process that has everything loaded."""
        self.loading.disable()
        self.at_load = {entry.code for entry in self.loading.getstats()}
        gc.unfreeze()
        self.functions = defaultdict(list)
        for thing in gc.get_objects():
            if isinstance(thing, FunctionType):
                self.functions[thing.__code__.co_filename].append(thing)
        gc.freeze()
        self.session = session
        self.cases = defaultdict(list)
        for item in session.items:
            self.cases[item.nodeid.partition("::")[0]].append(item)
            self.cases[item.nodeid.partition("[")[0]].append(item)
            if "[" in item.nodeid:
                self.cases[item.nodeid].append(item)
        for line in self.asked:
            self.answers.write(json.dumps(self._answer(json.loads(line))) + "\n")
            self.answers.flush()
        return True

    def _answer(self, question: dict[str, Any]) -> dict[str, Any]:
        """Which case fails first, "" for none; of how many cases; whether all of them ran, and
        whether what changed runs while modules load.
        """
        unfit = set(question["unfit"])
        named = (item for name in question["tests"] for item in self.cases.get(name, ()))
        items = [item for item in dict.fromkeys(named) if item.nodeid not in unfit]
        mine, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(mine)
            self._run(items, question, theirs)
        os.close(theirs)
        said = b""
        while select.select([mine], [], [], SILENT_S)[0] and (some := os.read(mine, 4096)):
            said += some
        os.close(mine)
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        words = said.decode().split()
        started = [word for word in words if word.isdecimal()]
        fails = started and not {WHOLE, TIME} & set(words)
        return {
            "failed": items[int(started[-1])].nodeid if fails else "",
            "cases": len(items),
            "whole": WHOLE in words,
            "loads": LOADS in words,
        }

    def _run(self, items: list[pytest.Item], question: dict[str, Any], say: int) -> NoReturn:
        """Tell each case that begins, and how it ended: whole, in time, or neither."""
        end = ""
        try:
            os.setsid()
            seconds = 2 * question["seconds"] + int(SILENT_S)
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
            if self._plant(question["path"], question["source"]):
                os.write(say, f"{LOADS}\n".encode())
            before = self.session.testsfailed
            for number, item in enumerate(items):
                if sum(os.times()[:4]) > question["seconds"]:
                    end = TIME
                    break
                os.write(say, f"{number}\n".encode())
                after = items[number + 1] if number + 1 < len(items) else None
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
                if self.session.testsfailed > before:
                    break
            else:
                end = WHOLE
        finally:
            # Nothing of this process may go on with the loop of the other.
            os.write(say, f"{end or 'failed'}\n".encode())
            os._exit(0)

    def _plant(self, path: str, source: str) -> bool:
        """Give the functions of a module the code that its file has now, in place of its source.

        True where that changes nothing of what was made while modules loaded.
        """
        if not path.endswith(".py"):
            return False
        file = str(Path.cwd() / path)
        was = _codes(compile(source, file, "exec"), {})
        now = _codes(compile(Path(file).read_text(encoding="utf-8"), file, "exec"), {})
        loads = False
        for function in self.functions[file]:
            old, name = function.__code__, function.__code__.co_qualname
            lines = [code.co_firstlineno for code in was[name]]
            try:
                new = now[name][lines.index(old.co_firstlineno)]
                if new != old:
                    loads |= old in self.at_load
                    function.__code__ = new
            except (ValueError, IndexError):
                loads = True  # a closure keeps what it no longer needs
        return loads


def main() -> None:
    """Collect what is named, with the two pipes of the driver."""
    asked, answers, *names = sys.argv[1:]
    quiet = ["-q", "-s", "--tb=no", "-p", "no:cacheprovider", "-m", EXPRESSION]
    words = [*quiet, "--continue-on-collection-errors", *names]
    pytest.main(words, plugins=[Forks(int(asked), int(answers))])


if __name__ == "__main__":
    main()
