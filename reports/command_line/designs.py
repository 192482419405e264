"""Designs by what the command line names: a file, a drive of the library, one to be made."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.design.sheet_values import (
    SheetValue,
    as_command,
    missing,
    must_be_answered,
    next_asked,
)
from dqforge.machines.errors import InputError
from dqforge.reports.pages.answer import (
    LOADING,
    OUT,
    QUICK_S,
    Answer,
    Files,
    check_figure_path,
    progress,
    show,
    stage,
    status,
)

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.errors import DqforgeError
    from dqforge.reports.output.folder import Written
    from dqforge.reports.plain_data import PlainData


NEW_DESIGN, NEW_STUDY = "design.yaml", "study.yaml"  # Names of the files that `dqforge new` makes.

# Designs that the command under way has loaded: its refusals name their place in the file.
_loaded: ContextVar[tuple[Design, ...]] = ContextVar("_loaded", default=())


def load(name: str, settings: Sequence[str] | None = None) -> Design:
    """Load a design file, or a library drive where no such file exists and that is its name.

    Args:
        name: File, or name in the library.
        settings: Keys that are set instead of what the file says, such as ``machine.resistance=12
            mOhm``.

    Raises:
        InputError: There is no such design, or it is wrong.
    """
    from dqforge.machines.design import catalogue
    from dqforge.machines.design import catalogue as loader
    from dqforge.reports.pages.answer import stage

    stage("reading the design")
    from_library = not Path(name).exists() and catalogue.is_known(name)
    loaded = (catalogue.load if from_library else loader.load_design)(name, settings or ())
    _loaded.set((*_loaded.get(), loaded))
    return loaded


def new_file(folder: Path, name: str) -> Path:
    """A file to be made in a folder; raises `InputError` where there is one of its name."""
    from dqforge.machines.errors import InputError

    path = folder / name
    if folder.suffix in (".yaml", ".yml"):
        meant = folder.with_suffix("") if folder.parent == Path() else folder.parent
        raise InputError(
            f"{folder}: 'dqforge new' takes the folder, in which it writes {name}; write "
            f"'dqforge new {meant}'"
        )
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: this is a file; name the folder in which {name} is written")
    if path.exists():
        raise InputError(f"{path} exists already and is kept; choose another folder")
    return path


def forget() -> None:
    """Begin a command, of which no design has been loaded."""
    _loaded.set(())


def locate(error: DqforgeError) -> None:
    """Give a refusal its place in the design of the command; of two, each has done so by itself."""
    designs = _loaded.get()
    if len(designs) == 1 and designs[0].places is not None:
        designs[0].places.locate(error)


# A data sheet asked for in a terminal: question after question, each answer judged at once by the
# reader of designs, alone and together with those before it.

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
    from dqforge.machines.design.sheet_judged import read_alone, remarks_so_far

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
        from dqforge.machines.design.sheet_judged import DEFAULT_NAME, frequency_for

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
        from dqforge.machines.design.sheet_judged import read_alone, remarks_so_far

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
        from dqforge.machines.design.sheet_judged import read_alone

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


# The one place where an answer is shown: as tables or JSON on stdout, as a figure,
# and as files.


def respond(
    command: str,
    ask: Callable[[], Answer],
    json: bool = False,
    plot: Path | None = None,
    out: Path | None = None,
    *,
    default: bool = False,
    bar: str = "",
    silent: bool = False,
    sign: str | None = None,
) -> int:
    """Ask, and show the answer; its exit code.

    Args:
        command: Its name, for JSON.
        ask: Reads and computes; names its stages by `dqforge.reports.pages.answer.stage`.
        json: Whether JSON is printed instead of tables.
        plot: File to draw into; refused before anything is computed where it could not be written.
        out: Folder for files, where the command writes any; None for none.
        default: Whether files go into the folder of their design where ``out`` is None.
        bar: Name of what moves a bar, for commands that tell the share that is done; else a spinner
            turns.
        silent: Whether nothing moves.
        sign: Command that signs the list of hashes of the folder.
    """
    if sign is not None:
        from dqforge.reports.output.signatures import command_words

        command_words(sign, "--sign")
    if plot is not None:
        check_figure_path(plot, Path(OUT) if default and out is None else out)
    moving: AbstractContextManager[object]
    moving = progress(bar) if bar else status(LOADING, after=QUICK_S)
    with nullcontext() if silent else moving:
        answer = ask()
        out = _default(answer.files) if default and out is None else out
        written = _write(answer.files, out, sign)
        _draw(answer, plot)
    if json:
        from dqforge.reports.pages.templating import to_text

        listed = _listed(answer.files, out, written)
        sys.stdout.write(to_text(command, answer.name, answer.plain | listed))
    else:
        _print(answer, written, out)
    sys.stdout.flush()
    return answer.exit_code


def _default(files: Files | None) -> Path | None:
    if files is None or files.design is None:
        return None
    from dqforge.reports.output.folder import default_folder

    return default_folder(files.design)


def _write(files: Files | None, out: Path | None, sign: str | None) -> Written | None:
    if files is None or out is None:
        return None
    stage("writing the files")
    from dqforge.reports.output.folder import Written, put_files, put_output

    if files.part:
        return put_output(
            out,
            files.part,
            files.contents,
            files.design,
            options=files.options,
            given=files.given,
            sign=sign,
        )
    if sign is not None:
        raise InputError("--sign: with --into no list of hashes is written; add -o OUT")
    there = tuple(name for name in files.contents if (out / name).exists())
    return Written(put_files(out, files.contents), there)


def _listed(files: Files | None, out: Path | None, written: Written | None) -> PlainData:
    """What was written, with hashes; nothing for commands that write nothing."""
    if files is None or out is None or written is None:
        return {}
    from dqforge.reports.output.folder import sha256

    contents = files.contents.items()
    listed = [{"name": name, "sha256": sha256(content)} for name, content in contents]
    changed = {"replaced": written.replaced, "removed": written.removed, "kept": written.kept}
    named = {key: list(names) for key, names in changed.items() if names}
    return {"out": str(out), "files": listed} | named


def _draw(answer: Answer, plot: Path | None) -> None:
    if plot is None or answer.figure is None:
        return
    from dqforge.reports.operating_system.system import prepare_drawing
    from dqforge.reports.pages.figures_style import save

    stage("drawing")
    prepare_drawing()
    save(answer.figure(), plot)


def _print(answer: Answer, written: Written | None, out: Path | None) -> None:
    show(answer.tables)
    lines = list(answer.notes)
    if written is not None:
        if answer.files is not None and answer.files.named:
            lines.append("written: " + " ".join(str(path) for path in written.paths))
        changed = (
            ("replaced", written.replaced),
            ("removed, as this run does not write it", written.removed),
            ("kept, of the design as it was before", written.kept),
        )
        lines += [f"{what}: {' '.join(names)}" for what, names in changed if names]
        if answer.files is not None and answer.files.follow:
            lines.append(f"next: {answer.files.follow.format(out=out)}")
    sys.stdout.write("".join(f"{line}\n" for line in lines))
