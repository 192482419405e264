"""A data sheet asked for in a terminal: question after question, each answer judged at once by the
reader of designs, alone and together with those before it.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from dqforge.machines.data_sheet.sheet_values import (
    SheetValue,
    as_command,
    missing,
    must_be_answered,
    next_asked,
)
from dqforge.machines.errors import InputError
from dqforge.reports.command_line.designs import NEW_DESIGN, new_file

_INTRODUCTION = """\
A design from a data sheet. Answer with a number and its unit; Enter leaves out what may be
left out, ? explains, < goes back, Ctrl-C ends with nothing written.
(Without questions: dqforge new DIR --template writes a template with all keys.)"""

_BACK = "<"
_HELP = "?"


def asked_sheet(folder: Path, given: Mapping[str, str], *, asking: bool) -> dict[str, str]:
    """What the data sheet says: what was given, and what is asked for where that does not do.

    Args:
        folder: For which the design is made.
        given: By the dotted key, texts of options; where there are any, only what is needed is
            asked for.
        asking: Whether questions may be asked.

    Raises:
        InputError: An option says what its key cannot be.
        KeyboardInterrupt: The person has left.
    """
    if not asking or (given and not missing(given)) or not _is_terminal():
        return dict(given)
    from dqforge.machines.data_sheet.judged import read_alone, remarks_so_far

    new_file(folder, NEW_DESIGN)
    for key, text in given.items():
        read_alone(key, text)
    remarks_so_far(given)
    dialogue = Dialogue(_ask, _tell, dict(given), needed_only=bool(given))
    try:
        values = dialogue.run()
    except KeyboardInterrupt:
        _tell("\nnothing is written")
        raise
    _tell(f"\nthe same without questions:\n  {shlex.join(as_command(str(folder), values))}\n")
    return values


def _is_terminal() -> bool:
    """Whether a person can be asked: questions and answers both go to a terminal."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def _ask(prompt: str) -> str:
    with suppress(ImportError):  # lines that can be edited, where the system has that
        import readline  # noqa: F401
    try:
        return input(prompt)
    except EOFError:
        raise KeyboardInterrupt from None


def _tell(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


@dataclass(slots=True)
class Dialogue:
    """Questions and what has been answered.

    Args:
        ask: Shows a prompt, returns the answer.
        tell: Shows a line.
        values: By the dotted key, what is known; answers are added.
        needed_only: Whether what may be left out is not asked for.
    """

    ask: Callable[[str], str]
    tell: Callable[[str], None]
    values: dict[str, str]
    needed_only: bool = False
    _skipped: list[str] = field(default_factory=list)
    _asked: list[str] = field(default_factory=list)
    _told: set[str] = field(default_factory=set)

    def run(self) -> dict[str, str]:
        """Ask until nothing is left; what is known then."""
        self.tell(_INTRODUCTION)
        while value := next_asked(self.values, self._skipped, needed_only=self.needed_only):
            self._one(value)
        return self.values

    def _one(self, value: SheetValue) -> None:
        """One question, until its answer is accepted, left out or taken back."""
        self.tell(f"\n{value.what} - {value.where}")
        while True:
            text = self.ask(self._prompt(value)).strip()
            if text == _HELP:
                self._explain(value)
            elif text == _BACK:
                if self._asked:
                    self._forget(self._asked.pop())
                    return
                self.tell("  this is the first question")
            elif not text:
                if not must_be_answered(value, self.values, self._skipped):
                    self._skipped.append(value.key)
                    break
                self.tell(f"  a design needs it; e.g. {value.example}")
            elif accepted := self._accepted(value, text):
                self.values[value.key] = accepted
                break
        self._asked.append(value.key)

    def _prompt(self, value: SheetValue) -> str:
        empty = "" if must_be_answered(value, self.values, self._skipped) else self._empty(value)
        return f"  {value.label} (e.g. {value.example}){empty}: "

    def _empty(self, value: SheetValue) -> str:
        return f" [{self._default(value) or 'none'}]"

    def _default(self, value: SheetValue) -> str:
        """What is taken where a value is left out."""
        from dqforge.machines.data_sheet.design_text import DEFAULT_NAME, frequency_for

        if value.key == "inverter.switching_frequency":
            return frequency_for(self.values)[0]
        return {"name": DEFAULT_NAME, "machine.friction": "0"}.get(value.key, "")

    def _explain(self, value: SheetValue) -> None:
        for line in (value.convention, f"Use: {value.use}." if value.use else ""):
            if line:
                self.tell(f"  {line}")
        for kind, meaning in value.kinds:
            self.tell(f"    {kind}: {meaning}")

    def _forget(self, key: str) -> None:
        self.values.pop(key, None)
        if key in self._skipped:
            self._skipped.remove(key)

    def _accepted(self, value: SheetValue, text: str) -> str:
        """The text, with its convention; empty where it is refused, or taken back."""
        from dqforge.machines.data_sheet.judged import read_alone, remarks_so_far

        try:
            text = self._with_kind(value, text)
            read_alone(value.key, text)
            remarks = remarks_so_far(self.values | {value.key: text})
        except InputError as error:
            self.tell(f"  {error.message}")
            return ""
        fresh = [sentence for sentence in remarks if sentence not in self._told]
        for sentence in fresh:
            self.tell(f"  {sentence}")
        if fresh and self.ask("  keep it? [Y/n]: ").strip().lower().startswith("n"):
            return ""
        self._told.update(fresh)
        return text

    def _with_kind(self, value: SheetValue, text: str) -> str:
        """The text with the convention that it leaves open, once that has been asked for.

        Raises `InputError` where it is no value of its key with any convention.
        """
        from dqforge.machines.data_sheet.judged import read_alone

        if not value.kinds:
            return text
        usual = value.kinds[0][0]
        try:
            found = read_alone(value.key, text)
        except InputError:
            read_alone(value.key, f"{text} {usual}")  # the same complaint where it is another
            found = None
        if found is not None and found.kind_given:
            return text
        self.tell("  which is meant?")
        for number, (kind, meaning) in enumerate(value.kinds, 1):
            self.tell(f"    {number} {kind}: {meaning}")
        return f"{text} {self._kind_of(value)}"

    def _kind_of(self, value: SheetValue) -> str:
        kinds = [kind for kind, _ in value.kinds]
        by_answer = {str(number): kind for number, kind in enumerate(kinds, 1)}
        by_answer |= {kind: kind for kind in kinds} | {"": kinds[0]}
        while (answer := self.ask("    number [1]: ").strip()) not in by_answer:
            self.tell(f"    expected a number from 1 to {len(kinds)}")
        return by_answer[answer]
