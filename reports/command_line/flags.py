"""How a process of dqforge ends: one line on stderr and an exit code, whatever went wrong,
and never a traceback.
"""

from __future__ import annotations

import errno
import inspect
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Exit, Option, echo

from dqforge import __version__
from dqforge.machines.design.sheet_values import SHEET_VALUES, SheetValue
from dqforge.machines.errors import DqforgeError
from dqforge.machines.files.library_files import STUDIES, design_names
from dqforge.machines.files.scratch import cleared_up
from dqforge.reports.operating_system import system
from dqforge.reports.operating_system.system import asked_to_end, spell_out
from dqforge.reports.pages.answer import tell

# Faults of a file that are told beside the first.
_MOST_FAULTS = 9

INTERRUPTED = 130

# What the system says of files and disks, and not of connections or processes.
_OF_FILES = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EMFILE)


def exit_code(command: Callable[[], object], locate: Callable[[DqforgeError], None]) -> int:
    """Run a command; what goes wrong becomes a line on stderr and an exit code.

    Args:
        command: What is run; its result is the exit code where it is a number.
        locate: Gives a refusal its place in a design.
    """
    import typer
    from typer.exceptions import TyperException

    _open_streams()
    spell_out()
    asked: Sequence[int] = ()
    try:
        with warnings.catch_warnings():
            # Numerical trouble ends in a message; what libraries remark on
            # themselves is nobody's business.
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            with asked_to_end() as asked, cleared_up():
                code: object = command()
        sys.stdout.flush()
        if code == INTERRUPTED:  # what the parser makes of Ctrl-C
            code = _interrupted(asked)
    except DqforgeError as error:
        code = _refused(error, locate)
    except TyperException as error:
        tell(_usage_line(error))
        code = 2
    except (typer.Abort, KeyboardInterrupt):
        code = _interrupted(asked)
    except (BrokenPipeError, SystemExit) as error:
        left = isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError)
        if not left:
            raise
        code = 0  # the reader of a pipe has left; there is nobody to tell
        _drop_output()
    except ImportError as error:
        from dqforge.reports.operating_system.packages import without_package

        missing = without_package(error)
        if missing is None:
            raise
        tell(str(missing))  # which no place in a design is to blame for
        code = missing.exit_code
    except OSError as error:
        code = 0 if _left_on_windows(error) else 1
        if code:
            tell(_system_line(error))
        _drop_output()
    except (ArithmeticError, RuntimeWarning, ValueError) as error:
        from dqforge.machines.design.numerical import refusal_of

        refusal = refusal_of(error)
        if refusal is None:
            raise
        code = _refused(refusal, locate)
    return code if isinstance(code, int) else 0


def _interrupted(asked: Sequence[int]) -> int:
    tell("ended by SIGTERM" if asked and asked[0] == signal.SIGTERM else "interrupted")
    return 128 + asked[0] if asked else INTERRUPTED


def _left_on_windows(error: OSError) -> bool:
    """Whether this is how Windows says that the reader of a pipe has left."""
    return system.WINDOWS and error.errno == errno.EINVAL and error.filename is None


def _refused(error: DqforgeError, locate: Callable[[DqforgeError], None]) -> int:
    for one in (error, *error.others[:_MOST_FAULTS]):
        locate(one)
        tell(str(one), one)
    if (left := len(error.others) - _MOST_FAULTS) > 0:
        tell(f"and {left} more faults")
    return error.exit_code


def _usage_line(error: Exception) -> str:
    """One line for a wrong command line: what the parser says, and where help is."""
    context = getattr(error, "ctx", None)
    path = "dqforge" if context is None else context.command_path
    message = error.format_message() if hasattr(error, "format_message") else str(error)
    return f"{message.rstrip('.')}; see '{path} --help'"


def _open_streams() -> None:
    """Give closed standard streams somewhere to write, so that no file opened later takes their
    place.
    """
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            setattr(sys, name, os.fdopen(nowhere, "w", encoding="utf-8"))


def _drop_output() -> None:
    """Send what is left in the buffer of stdout nowhere: the interpreter would try, and fail,
    again at its end.
    """
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _system_line(error: OSError) -> str:
    """One line for what the system refused; a stdout that is to blame refuses
    one character more as well.
    """
    reason = error.strerror or str(error)
    try:
        sys.stdout.write("\n")
        sys.stdout.flush()
    except OSError:
        return f"standard output cannot be written: {reason}"
    if error.filename is None and error.errno not in _OF_FILES:
        return f"the system refuses what the command needs: {reason}; give it again"
    named = f" {error.filename!r}" if error.filename is not None else ""
    return (
        f"the system refuses a file{named}: {reason}; is the disk, or the folder that TMPDIR "
        "names, full?"
    )


# The application that the commands join: name, help, and what it says without a command.

GROUPS = {
    "Design": ("new", "check", "run"),
    "Analysis": ("mtpa", "fit", "tune", "losses", "dqy", "simulate", "estimators"),
    "Firmware": ("export", "explain", "verify"),
    "Data": ("bemf", "identify"),
    "Many": ("explore", "compare"),
    "Tools": ("serve", "machines", "schema", "doctor", "reproduce"),
}


class _Grouped(typer.core.TyperGroup):
    """Lists the commands by what they are for."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 - as click calls it
        for title, names in GROUPS.items():
            rows = [(name, self.commands[name].get_short_help_str(60)) for name in names]
            with formatter.section(title):
                formatter.write_dl(rows)


def application() -> typer.Typer:
    """An application without commands, which shows its help where none is given."""
    app = typer.Typer(
        name="dqforge",
        cls=_Grouped,
        help=(
            "Controller coefficients, loss budgets and checked C headers for permanent-magnet "
            "drives."
        ),
        epilog="DESIGN is a design file, or a name that 'dqforge machines' lists.",
        context_settings={"help_option_names": ["-h", "--help"]},
        invoke_without_command=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(_root)
    return app


def _root(context: typer.Context, _version: Version = False) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit


# The values of a data sheet as options of a command: one per entry of the table, in one bundle.

Sheet = dict[str, str]  # By the dotted key of the design, the text that was given.
_BUNDLE = "sheet"


def with_sheet(command: Callable[..., None]) -> Callable[..., None]:
    """Replace the parameter ``sheet`` of a command by the options of a data sheet.

    The command gets those that were given, as a `Sheet`.
    """

    @wraps(command)
    def bundled(**options: Any) -> None:
        texts = {value.key: options.pop(_name(value)) for value in SHEET_VALUES}
        given = {key: text for key, text in texts.items() if text is not None}
        command(**options, **{_BUNDLE: given})

    signature = inspect.signature(command, eval_str=True)
    own = [entry for entry in signature.parameters.values() if entry.name != _BUNDLE]
    more = [
        inspect.Parameter(
            _name(value),
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, _option(value)],
        )
        for value in SHEET_VALUES
    ]
    parameters = [*own, *more]
    bundled.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    bundled.__annotations__ = {entry.name: entry.annotation for entry in parameters}
    return bundled


def _name(value: SheetValue) -> str:
    return value.flag.removeprefix("--").replace("-", "_")


def _option(value: SheetValue) -> Any:
    words = f"{value.what}, e.g. '{value.example}'."
    return Option(value.flag, metavar="TEXT", help=words)


# What a shell offers for a word that is being typed: drives of the library and files near by.
#
# Asked at every press of a key: nothing heavy is imported.

_DESIGNS = (".yaml", ".yml")


def drives(begun: str) -> list[str]:
    """Drives and motors of the library whose names begin so."""
    return [name for name in design_names() if name.startswith(begun)]


def designs(begun: str) -> list[str]:
    """Drives and motors of the library, and design files and folders, whose names begin so."""
    return [*drives(begun), *_near(begun)]


def studies(begun: str) -> list[str]:
    """Studies of the library, and study files and folders, whose names begin so."""
    shipped = [name for name in STUDIES.names() if name.startswith(begun)]
    return [*shipped, *_near(begun)]


def _near(begun: str) -> list[str]:
    """Files that may hold a design, and folders with a mark behind them; no hidden ones."""
    folder, part = os.path.split(begun)
    try:
        entries = sorted(Path(folder or ".").iterdir())
    except OSError:
        return []
    shown = [each for each in entries if each.name.startswith(part) and each.name[0] != "."]
    typed = begun.removesuffix(part)
    named = [(each, f"{typed}{each.name}") for each in shown]
    folders = [f"{name}/" for each, name in named if each.is_dir()]
    files = [name for each, name in named if each.suffix.lower() in _DESIGNS and each.is_file()]
    return [*folders, *files]


# The options of the command line: how they are written, and what the help says of them.


def _text(flag: str, metavar: str, words: str) -> Any:
    return Option(flag, metavar=metavar, help=words)


def _argument(metavar: str, words: str, begun: Callable[[str], list[str]] | None = None) -> Any:
    """An argument; ``begun`` offers the shell what begins like what is typed."""
    return Argument(metavar=metavar, help=words, autocompletion=begun)


def _print_version(value: bool) -> None:
    if value:
        echo(f"dqforge {__version__}")
        raise Exit


Version = Annotated[
    bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
]


_SET = "Set a key of the design, e.g. machine.resistance='12 mOhm'; repeatable"
_DRIVE = "Design file, or the name of a library drive."

_SIDE = "Design, library drive, or what 'dqforge run' wrote."
_MARGIN = "Share of the voltage kept free for control, e.g. '5 %'; mtpa: or dead-time."

_LIMIT = "Modulator whose linear range limits the voltage: spwm, svpwm, dpwm1, ..."
_LOSS = "What is minimised: copper, or total with iron and inverter."

_CHOICE = "Best modulator and frequency over the map, and the rule: modulation_choice."
_CAPTURE = "Capture with time, or angle, and three phases; or a file per channel."


_CORE = "Also on an emulated core: cortex-m0plus, -m3, -m4, -m7 or -m33."


Design = Annotated[str, _argument("DESIGN", _DRIVE, designs)]


Folder = Annotated[Path, _argument("DIR", "Folder to make; it gets a file design.yaml.")]


Served = Annotated[Path, _argument("DIR", "Folder of the design file, made if missing.")]
HERE = Path("design")  # Where none is named.


Port = Annotated[
    int, Option("--port", help="Of 127.0.0.1; a free one by default.", min=0, max=65535)
]


Written = Annotated[Path, _argument("OUT", "Folder that 'dqforge run' or 'export' wrote.")]


SideA = Annotated[str, _argument("A", _SIDE, designs)]


SideB = Annotated[str, _argument("B", "The same; differences are those of B against A.", designs)]


Captures = Annotated[list[Path], _argument("FILE...", _CAPTURE)]


Paper = Annotated[str, _argument("PAPER", "Number of the paper: 000, 001 or 002.")]


Drive = Annotated[str | None, _argument("NAME", "Print this drive's design file.", drives)]


Find = Annotated[
    str | None,
    _text("--search", "WORDS", "List what matches, e.g. hoverboard, gimbal or '48 V'."),
]


Set = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}.")]


SetOfB = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}; of B.")]


OfStudy = Annotated[bool, Option("--study", help="That of a study of many designs.")]


OfBench = Annotated[bool, Option("--bench", help="That of the bench file of identify.")]


OutOfSchema = Annotated[
    Path | None, Option("-o", "--out", metavar="FILE", help="File to write, for editors.")
]


Json = Annotated[bool, Option("--json", help="Print the result as JSON.")]


Plot = Annotated[
    Path | None,
    _text(
        "--plot",
        "FILE",
        "Draw into an .svg, .png or .pdf file; a .csv has the data.",
    ),
]


Out = Annotated[
    Path | None,
    Option("-o", "--out", metavar="OUT", help="Folder to write into; default out/<prefix>."),
]


NoVerify = Annotated[bool, Option("--no-verify", help="Skip compiling and running the header.")]


Sign = Annotated[
    str | None,
    _text("--sign", "COMMAND", "Signs the list of hashes, e.g. 'minisign -Sm {}'."),
]


Signature = Annotated[
    str | None,
    _text("--signature", "COMMAND", "Checks it first, e.g. 'minisign -Vm {} -p key.pub'."),
]


Source = Annotated[
    list[Path] | None,
    _text("--from", "FILE", "Configuration file of other firmware to start from; repeatable."),
]


CaptureOfNew = Annotated[
    list[Path] | None,
    _text("--capture", "FILE", "Capture of the back-EMF, for the magnet flux; repeatable."),
]


MapOfNew = Annotated[
    Path | None, _text("--map", "FILE", "Flux map, instead of magnet flux and inductances.")
]


AxesOfNew = Annotated[
    str | None, _text("--axes", "AXES", "Of the map: magnet-d (default) or reluctance.")
]


SetOfNew = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}.")]


For = Annotated[
    list[str] | None,
    _text("--for", "NAME", "Files of other firmware instead: vesc, simplefoc, ...; repeatable."),
]


Into = Annotated[
    Path | None, _text("--into", "FILE", "With --for: keep the other contents of this file.")
]


OutOfExport = Annotated[
    Path | None,
    Option(
        "-o",
        "--out",
        metavar="OUT",
        help="Folder to write into; default out/<prefix>, or that of --into.",
    ),
]


Explained = Annotated[
    list[Path],
    _argument("FILE...", "Configuration of other firmware, or a header or result of dqforge."),
]


OnMachine = Annotated[
    str | None, _text("--machine", "DESIGN", "Evaluate it on the machine of this design.")
]


Template = Annotated[
    str | None,
    Option("--machine", metavar="NAME", help="Start from a library drive.", autocompletion=drives),
]


Blank = Annotated[bool, Option("--template", help="The commented template, without questions.")]


StudyOfNew = Annotated[str | None, _text("--study", "NAME", "A study of the library instead.")]


Yes = Annotated[bool, Option("--yes", help="Ask nothing: optional values are assumed and listed.")]


Core = Annotated[str | None, _text("--target", "CORE", _CORE)]


Independent = Annotated[
    bool,
    Option("--independent", help="Also confirm the certificates with the independent checkers."),
]


Speed = Annotated[str | None, _text("--speed", "SPEED", "Mechanical speed, e.g. '3000 rpm'.")]


Torque = Annotated[str | None, _text("--torque", "TORQUE", "One torque, e.g. '50 N m'.")]


Map = Annotated[str | None, _text("--map", "NxM", "Map of N torques by M speeds, with its limits.")]


Modulation = Annotated[str, _text("--modulation", "NAME", _LIMIT)]


Margin = Annotated[str, _text("--margin", "SHARE", _MARGIN)]


Objective = Annotated[str, _text("--objective", "LOSS", _LOSS)]


Mission = Annotated[
    Path | None, _text("--mission", "FILE", "Text file with time, speed and torque.")
]


Measured = Annotated[
    Path | None,
    _text("--measured", "FILE", "Measured losses or efficiencies, beside those of the design."),
]


Points = Annotated[
    str | None,
    _text("--points", "POINTS", "Torques and speeds: '130 N m 3000 rpm'; commas between."),
]


Strategies = Annotated[
    str | None, _text("--strategies", "A,B", "mtpa, id0, least-loss; default the design's.")
]


Modulations = Annotated[
    str | None, _text("--modulations", "A,B", "Names, or all; default the design's.")
]


Frequencies = Annotated[
    str | None, _text("--frequencies", "F,F", "Carriers, e.g. '8 kHz, 16 kHz'.")
]


Choice = Annotated[bool, Option("--choice", help=_CHOICE)]


Ripple = Annotated[
    str | None, _text("--ripple", "SHARE", "Permitted deviation of the torque, e.g. '5 %'.")
]


OpenPhase = Annotated[
    str | None, _text("--open-phase", "PHASE", "A phase without current: a, b or c.")
]


Flash = Annotated[
    bool, Option("--flash", help="Compare topologies and controllers, and say what to flash.")
]


Switched = Annotated[bool, Option("--switched", help="Simulate every switching instant.")]


Only = Annotated[
    str | None, _text("--only", "A,B", "Estimators to compare, e.g. flux,injection; default all.")
]


Starts = Annotated[int, _text("--starts", "N", "Try each start-up N times per load.")]


OutOfPair = Annotated[
    Path | None, Option("-o", "--out", metavar="OUT", help="Folder for the headers of the pair.")
]


Bench = Annotated[Path, _argument("BENCH", "Bench file: the runs, their logs and columns.")]


Plan = Annotated[
    bool, Option("--plan", help="BENCH is a design: write the points to run, and what to expect.")
]


OutOfBench = Annotated[
    Path | None,
    Option("-o", "--out", metavar="OUT", help="Folder for design.yaml and result.json."),
]


LineToLine = Annotated[
    bool, Option("--line-to-line", help="The channels are ab, bc and ca, or ab alone.")
]


PolePairs = Annotated[int | None, _text("--pole-pairs", "P", "For constants per mechanical speed.")]


Scale = Annotated[
    str | None, _text("--scale", "A,B,C", "Factors of the channels (probes), e.g. 1,1,10.")
]


Columns = Annotated[str | None, _text("--columns", "T,A,B,C", "Names or numbers of the columns.")]


Harmonics = Annotated[int, _text("--harmonics", "N", "Highest order.")]


Interval = Annotated[str | None, _text("--interval", "TIME", "Between two samples, e.g. '2 us'.")]


Figures = Annotated[
    Path | None, _text("--figures", "OUT", "Folder for the paper's figures and C files.")
]


Study = Annotated[
    str, _argument("STUDY", "Study file, or a folder that this command wrote.", studies)
]


OutOfStudy = Annotated[
    Path | None,
    Option("-o", "--out", metavar="OUT", help="Folder of the study; default out/<its name>."),
]


Workers = Annotated[
    int | None, Option("--workers", metavar="N", min=1, help="Processes; default one per core.")
]


Scheduler = Annotated[
    str, _text("--scheduler", "ADDRESS", "Existing cluster, e.g. tcp://host:8786.")
]


SchedulerFile = Annotated[
    Path | None, _text("--scheduler-file", "FILE", "The same, by the file of its scheduler.")
]


DryRun = Annotated[
    bool, Option("--dry-run", help="Show the plan: rows, first and last, time, bytes.")
]


Limit = Annotated[
    int | None,
    Option("--limit", metavar="N", min=1, help="Stop after the part that holds the N-th row."),
]


Restart = Annotated[bool, Option("--restart", help="Delete the contents of OUT and start again.")]


Reuse = Annotated[
    list[Path] | None,
    _text("--reuse", "OLD", "Take rows from the folder of an earlier study; may be repeated."),
]


Mixed = Annotated[
    bool, Option("--mixed", help="Let CPUs differ: last digits may depend on where a row ran.")
]


TimeLimit = Annotated[
    float | None,
    Option("--time-limit", metavar="S", min=0.1, help="Seconds for a batch; default learned."),
]


TlsAuthority = Annotated[
    str, _text("--tls-ca-file", "PEM", "CA certificates of a cluster with TLS.")
]


TlsCertificate = Annotated[str, _text("--tls-cert", "PEM", "Client certificate for it.")]


TlsKey = Annotated[str, _text("--tls-key", "PEM", "Its key, if in a separate file.")]


TableOf = Annotated[
    str | None, _text("--table", "A,B", "Show columns of a folder, e.g. 'device, losses.total'.")
]


Where = Annotated[
    list[str] | None,
    _text("--where", "TEST", "Only rows that meet it, e.g. 'losses.total < 500 W'."),
]


Sort = Annotated[str, _text("--sort", "A,-B", "Sort by these; -B: the largest first.")]


First = Annotated[int | None, Option("--first", metavar="N", min=1, help="Only so many rows.")]


CsvOf = Annotated[Path | None, _text("--csv", "FILE", "All rows that match, with all digits.")]


ExportOf = Annotated[
    str | None,
    _text("--export", "WHICH", "Designs and headers of rows: a number, row:INDEX or front."),
]
