"""The options of the command line: how they are written, and what the help says of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option, echo

from dqforge import __version__
from dqforge.reports.command_line.completions import designs, drives, studies


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

_LIMIT = "Whose linear range limits the voltage: spwm, svpwm, dpwm1, ..."
_LOSS = "What is minimised: copper, or total with iron and inverter."

_CHOICE = "Best modulator and frequency over the map, and the rule: modulation_choice."
_CAPTURE = "Capture with time, or angle, and three phases; or a file per channel."


_CORE = "Emulated core, too: cortex-m0plus, -m3, -m4, -m7 or -m33."


Design = Annotated[str, _argument("DESIGN", _DRIVE, designs)]


Folder = Annotated[Path, _argument("DIR", "Folder to make; it gets a file design.yaml.")]


Written = Annotated[Path, _argument("OUT", "Folder that 'dqforge run' or 'export' wrote.")]


SideA = Annotated[str, _argument("A", _SIDE, designs)]


SideB = Annotated[str, _argument("B", "The same; differences are those of B against A.", designs)]


Captures = Annotated[list[Path], _argument("FILE...", _CAPTURE)]


Paper = Annotated[str, _argument("PAPER", "Number of the paper: 000, 001 or 002.")]


Drive = Annotated[str | None, _argument("NAME", "Print this drive's design file.", drives)]


Set = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}.")]


SetOfB = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}; of B.")]


OfStudy = Annotated[bool, Option("--study", help="That of a study of many designs.")]


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


Source = Annotated[
    list[Path] | None,
    _text("--from", "FILE", "Configuration file of other firmware to start from; repeatable."),
]


SetOfNew = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}; with --from.")]


For = Annotated[
    list[str] | None,
    _text("--for", "NAME", "Files of other firmware instead: vesc, simplefoc, ...; repeatable."),
]


Into = Annotated[
    Path | None, _text("--into", "FILE", "With --for: keep what else this file holds.")
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
    _argument("FILE...", "Configuration of other firmware, or header or result of ours."),
]


OnMachine = Annotated[
    str | None, _text("--machine", "DESIGN", "Judge it on the machine of this design.")
]


Template = Annotated[
    str | None,
    Option("--machine", metavar="NAME", help="Start from a library drive.", autocompletion=drives),
]


Blank = Annotated[bool, Option("--template", help="The commented template, without a question.")]


StudyOfNew = Annotated[str | None, _text("--study", "NAME", "A study of the library instead.")]


Yes = Annotated[
    bool, Option("--yes", help="Ask nothing: what may be left out is assumed, and said.")
]


Core = Annotated[str | None, _text("--target", "CORE", _CORE)]


Speed = Annotated[str | None, _text("--speed", "SPEED", "Mechanical speed, e.g. '3000 rpm'.")]


Torque = Annotated[str | None, _text("--torque", "TORQUE", "One torque, e.g. '50 N m'.")]


Map = Annotated[str | None, _text("--map", "NxM", "Map of N torques by M speeds, with its limits.")]


Modulation = Annotated[str, _text("--modulation", "NAME", _LIMIT)]


Margin = Annotated[str, _text("--margin", "SHARE", _MARGIN)]


Objective = Annotated[str, _text("--objective", "LOSS", _LOSS)]


Mission = Annotated[
    Path | None, _text("--mission", "FILE", "Text file with time, speed and torque.")
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


LineToLine = Annotated[bool, Option("--line-to-line", help="The channels are ab, bc and ca.")]


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
    str, _text("--scheduler", "ADDRESS", "Cluster that there is, e.g. tcp://host:8786.")
]


SchedulerFile = Annotated[
    Path | None, _text("--scheduler-file", "FILE", "The same, by the file of its scheduler.")
]


DryRun = Annotated[
    bool, Option("--dry-run", help="Say what it would be: rows, first and last, time, bytes.")
]


Limit = Annotated[
    int | None,
    Option("--limit", metavar="N", min=1, help="Stop after the part that holds the N-th row."),
]


Restart = Annotated[bool, Option("--restart", help="Take away what OUT holds, and begin anew.")]


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


TlsAuthority = Annotated[str, _text("--tls-ca-file", "PEM", "Certificates of a cluster with TLS.")]


TlsCertificate = Annotated[str, _text("--tls-cert", "PEM", "The certificate shown to it.")]


TlsKey = Annotated[str, _text("--tls-key", "PEM", "Its key, where that is a file of its own.")]


TableOf = Annotated[
    str | None, _text("--table", "A,B", "Show columns of a folder, e.g. 'device, losses.total'.")
]


Where = Annotated[
    list[str] | None, _text("--where", "TEST", "Of rows that hold, e.g. 'losses.total < 500 W'.")
]


Sort = Annotated[str, _text("--sort", "A,-B", "In this order; -B: the largest first.")]


First = Annotated[int | None, Option("--first", metavar="N", min=1, help="Only so many rows.")]


CsvOf = Annotated[Path | None, _text("--csv", "FILE", "All rows that hold, with all digits.")]


ExportOf = Annotated[
    str | None,
    _text("--export", "WHICH", "Designs and headers of rows: a number, row:INDEX or front."),
]
