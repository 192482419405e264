"""The options of the command line: how they are written, and what the help says of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Exit, Option, echo

from dqforge import __version__


def _text(flag: str, metavar: str, words: str) -> Any:
    return Option(flag, metavar=metavar, help=words)


def _argument(metavar: str, words: str) -> Any:
    return Argument(metavar=metavar, help=words)


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


Design = Annotated[str, _argument("DESIGN", _DRIVE)]


Folder = Annotated[Path, _argument("DIR", "Folder to make; it gets a file design.yaml.")]


Written = Annotated[Path, _argument("OUT", "Folder that 'dqforge run' or 'export' wrote.")]


SideA = Annotated[str, _argument("A", _SIDE)]


SideB = Annotated[str, _argument("B", "The same; differences are those of B against A.")]


Captures = Annotated[list[Path], _argument("FILE...", _CAPTURE)]


Paper = Annotated[str, _argument("PAPER", "Number of the paper: 000, 001 or 002.")]


Drive = Annotated[str | None, _argument("NAME", "Print this drive's design file.")]


Set = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}.")]


SetOfB = Annotated[list[str] | None, _text("--set", "KEY=VALUE", f"{_SET}; of B.")]


Json = Annotated[bool, Option("--json", help="Print the result as JSON.")]


Plot = Annotated[Path | None, _text("--plot", "FILE", "Draw into an .svg, .png or .pdf file.")]


Out = Annotated[Path, Option("-o", "--out", metavar="OUT", help="Folder to write into.")]


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
        "-o", "--out", metavar="OUT", help="Folder to write into; default out, or that of --into."
    ),
]


Explained = Annotated[
    list[Path],
    _argument("FILE...", "Configuration of other firmware, or header or result of ours."),
]


OnMachine = Annotated[
    str | None, _text("--machine", "DESIGN", "Judge it on the machine of this design.")
]


Template = Annotated[str | None, _text("--machine", "NAME", "Start from a library drive.")]


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
