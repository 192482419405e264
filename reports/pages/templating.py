"""The one Jinja2 environment: strict about names, silent about nothing, plain in white space."""

from __future__ import annotations

import base64
import html
import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from importlib.util import cache_from_source
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np
from jinja2 import __version__ as version_of_jinja
from jinja2.bccache import Bucket, BytecodeCache
from numpy.typing import NDArray

from dqforge import __version__
from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.current_reference import Certificate
from dqforge.optimizer.field_weakening.certificate import SurfaceCertificate
from dqforge.reports.c_code.numbers import (
    addend,
    comment_text,
    float_literal,
    hexadecimal_word,
    int32_addend,
    int32_literal,
    int64_literal,
    rounded_up,
)
from dqforge.reports.pages.figure_sheet import read_figure
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.pages.html_text import symbols
from dqforge.reports.plain_data import PlainData
from dqforge.reports.steps.control_types import control_types

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _place(name: str) -> Path | Traversable:
    """Where the template ``<room>/<file>`` or ``<room>/<subject>/<file>`` lies: in the folder
    ``templates`` of its room; one from outside the package is named by its absolute path.
    """
    if Path(name).is_absolute():
        return Path(name)
    room, _, file = name.partition("/")
    return resources.files("dqforge.reports").joinpath(room, "templates", file)


def _source(name: str) -> str | None:
    path = _place(name)
    return path.read_text(encoding="utf-8") if path.is_file() else None


def resource(name: str) -> str:
    """The text of ``<room>/<file>`` that lies among the templates of the package and takes no
    values.
    """
    return _place(name).read_text(encoding="utf-8")


def _kept_place(name: str) -> Path | None:
    """File of a template of the package, whose byte code is kept."""
    path = _place(name)
    return path if isinstance(path, Path) and not Path(name).is_absolute() else None


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_source),
        bytecode_cache=CompiledTemplates(_kept_place),
        optimized=False,  # what a filter makes of a constant would be kept with the byte code
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=lambda name: name is not None and ".html" in name,
    )
    from dqforge.reports.pages.figures_style import DARK

    environment.globals["figure_colours"] = DARK
    environment.globals["control_types"] = control_types
    environment.filters.update(
        f32=float_literal,
        addend=addend,
        comment=comment_text,
        word=hexadecimal_word,
        int32=int32_literal,
        int32_addend=int32_addend,
        int64=int64_literal,
        symbols=symbols,
    )
    return environment


def render(template: str, context: Mapping[str, Any]) -> str:
    """Render a template of the package; an unknown name in it is an error, not an empty string."""
    return _environment().get_template(template).render(context)


# A figure as a page has it: the drawing, its data to be taken away, and what a pointer needs to
# tell them.

# Signs that may stand as they are in the data of a link, beside letters and digits.
_PLAIN = ",.;:!*()/-_+="


@dataclass(frozen=True, slots=True)
class PageFigure:
    """What the template of a figure is given.

    Attributes:
        svg: The drawing.
        about: One sentence on it.
        panels: Where its panels lie and which columns of the data each thing in them has, as JSON
            for an attribute in single quotes.
        data: Its data.
    """

    svg: Markup
    about: str
    panels: Markup
    data: DataFile


@dataclass(frozen=True, slots=True)
class DataFile:
    """A table that lies in the link to it.

    Attributes:
        name: Its file name.
        link: The table in the link.
    """

    name: str
    link: str


def page_figure(figure: Figure, name: str) -> PageFigure:
    """A figure for a page.

    Args:
        figure: As it was drawn by `dqforge.reports.pages.figures_style.new_figure`.
        name: Of the file of its data, without the ending.
    """
    from markupsafe import Markup

    svg = to_svg(figure)
    sheet = read_figure(figure)
    about = str(figure.get_label()).partition("|")[2]
    return PageFigure(
        Markup(svg), about, panels_text(sheet.frames()), data_file(f"{name}.csv", sheet.csv())
    )


def panels_text(panels: Any) -> Markup:
    """Plain data for an attribute in single quotes.

    Args:
        panels: Numbers, texts, lists and mappings.
    """
    from markupsafe import Markup

    text = json.dumps(panels, separators=(",", ":"), allow_nan=False)
    return Markup(html.escape(text, quote=False).replace("'", "&#39;"))


def data_file(name: str, text: str) -> DataFile:
    """A table in a link, in the shorter of the two ways to write it.

    Args:
        name: Its file name.
        text: Comma-separated.
    """
    content = text.encode("utf-8")
    percent = f"data:text/csv;charset=utf-8,{quote(content, safe=_PLAIN)}"
    coded = f"data:text/csv;charset=utf-8;base64,{base64.b64encode(content).decode('ascii')}"
    return DataFile(name, min(percent, coded, key=len))


# Maps over torque and speed as figures draw them.

WINNERS = ("#9ec5e8", "#f0b36b", "#8fc9b9", "#d9a0c7", "#e6dc8c", "#b8aee0", "#c4a484", "#9fb0bd")


OTHERS = "#dfe3e8"


def cell_edges(values: FloatArray) -> FloatArray:
    """Borders of cells around ascending values."""
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate(
        [[1.5 * values[0] - 0.5 * values[1]], middle, [1.5 * values[-1] - 0.5 * values[-2]]]
    )


def _blocks(code: NDArray[np.int64]) -> list[tuple[int, int, int, int, int]]:
    """Rectangles (code, first row, end row, first column, end column) of equal cells.

    Rows join where they repeat.
    """
    found: list[tuple[int, int, int, int, int]] = []
    growing: dict[tuple[int, int, int], int] = {}
    for i in range(code.shape[0] + 1):
        runs: set[tuple[int, int, int]] = set()
        if i < code.shape[0]:
            bounds = [0, *(np.flatnonzero(np.diff(code[i])) + 1).tolist(), code.shape[1]]
            runs = {(int(code[i, a]), a, b) for a, b in pairwise(bounds) if code[i, a] >= 0}
        found += [
            (run[0], start, i, run[1], run[2]) for run, start in growing.items() if run not in runs
        ]
        growing = {run: growing.get(run, i) for run in sorted(runs)}
    return found


def draw_cells(
    axes: Axes,
    code: NDArray[np.int64],
    speed: FloatArray,
    torque: FloatArray,
    colours: Sequence[str] = (*WINNERS, OTHERS),
    names: Sequence[str] = (),
) -> None:
    """Cells in the colours of their codes, none where negative, as few rectangles.

    Borders in rpm and N m. ``names`` are those of the codes in the data, where no legend says them.
    """
    from matplotlib.patches import Rectangle

    for kind, low, high, left, right in _blocks(code):
        size = (float(speed[right] - speed[left]), float(torque[high] - torque[low]))
        corner = (float(speed[left]), float(torque[low]))
        # A thin line of the same colour closes the seams between rectangles.
        axes.add_patch(
            Rectangle(
                corner,
                *size,
                facecolor=colours[kind],
                edgecolor=colours[kind],
                linewidth=0.4,
                label=f"_{names[kind]}" if names else "",
            )
        )


def inside(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[int, int]:
    """The cell of a region farthest from its border, by shrinking it as long as anything is
    left.
    """
    rest = mask.copy()
    while True:
        padded = np.pad(rest, 1)
        less = rest & padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
        if not np.any(less):
            break
        rest = less
    rows, columns = np.nonzero(rest)
    middle = int(np.argmin(np.hypot(rows - np.mean(rows), columns - np.mean(columns))))
    return int(rows[middle]), int(columns[middle])


# Words for what is proven of a current reference, alike in header, terminal and report.

# What the ``model`` of a certificate is called.
AGAINST = {
    "equations": "the equations of the machine",
    "splines": "the splines through its flux map",
}

JSON_DIGITS = 9  # Significant digits of numbers in JSON documents.
_CURRENTS_AND_TORQUE = (("i_d", "A"), ("i_q", "A"), ("torque", "N m"))


def proof_title(certificate: Certificate) -> str:
    """Against what the bounds hold, and for what."""
    return f"proven for every torque, rounding included, against {AGAINST[certificate.model]}"


def _bound(value: float | None, unit: str, digits: int) -> str:
    return "not bounded" if value is None else f"{rounded_up(value, digits)} {unit}"


def _share(value: float | None, digits: int) -> str:
    return _bound(
        None if value is None else math.nextafter(100.0 * value, math.inf) if value else 0.0,
        "%",
        digits,
    )


def proven_text(certificate: Certificate, digits: int = 2) -> str:
    """All bounds in one line."""
    parts = [
        f"i_d {_bound(certificate.i_d, 'A', digits)}",
        f"i_q {_bound(certificate.i_q, 'A', digits)}",
        f"torque {_share(certificate.torque_relative, digits)}",
        f"copper loss +{_share(certificate.loss_relative, digits)}",
    ]
    if certificate.voltage_excess is not None:
        parts.append(f"voltage +{_share(certificate.voltage_excess, digits)}")
    return ", ".join(parts)


def header_lines(certificate: Certificate, strategy: str) -> list[str]:
    """Bounds as lines of at most 110 characters for the comment of the evaluator."""
    voltage = certificate.voltage_excess
    i_d, i_q, torque = (
        _bound(getattr(certificate, name), unit, 3) for name, unit in _CURRENTS_AND_TORQUE
    )
    torque_share, loss_share = (
        _share(value, 3) for value in (certificate.torque_relative, certificate.loss_relative)
    )
    return [
        f"Bounds of the errors, {proof_title(certificate)}:",
        f"i_d {i_d}, i_q {i_q} against the exact {strategy} currents;",
        f"torque {torque} ({torque_share} of the largest torque);",
        (
            f"copper loss {_bound(certificate.loss, 'W', 3)} above the least ({loss_share} from 5 "
            "% torque up)."
        ),
        *(
            []
            if voltage is None
            else [f"phase voltage at most {_share(voltage, 3)} above its limit."]
        ),
    ]


def plain_certificate(certificate: Certificate | SurfaceCertificate | None) -> PlainData | None:
    """Bounds as plain data, rounded up to the digits that the document keeps.

    None where nothing is proven.
    """
    if certificate is None:
        return None
    plain = asdict(certificate).items()
    return {
        name: float(rounded_up(value, JSON_DIGITS)) if isinstance(value, float) else value
        for name, value in plain
    }


# Byte code of templates, kept beside them as Python keeps that of modules.


class CompiledTemplates(BytecodeCache):
    """Where nothing can be read or written, a template is compiled in each process.

    Args:
        place: File of a template by its name; None for one whose byte code is not kept.
    """

    def __init__(self, place: Callable[[str], Path | None]) -> None:
        self._place = place

    def get_cache_key(self, name: str, filename: str | None = None) -> str:  # noqa: ARG002
        """The file of the byte code; empty where none is kept."""
        path = self._place(name)
        if path is None or sys.implementation.cache_tag is None:
            return ""
        return cache_from_source(str(path), optimization="jinja")

    def get_source_checksum(self, source: str) -> str:
        """What the byte code depends on: text and compilers."""
        return super().get_source_checksum(f"{__version__}\n{version_of_jinja}\n{source}")

    def load_bytecode(self, bucket: Bucket) -> None:
        """Read what is there; what is broken or of another text counts as nothing."""
        try:
            content = Path(bucket.key).read_bytes() if bucket.key else b""
            bucket.bytecode_from_string(content)
        except Exception:
            bucket.reset()

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Write a file whole or not at all, and not where Python is to write none."""
        if not bucket.key or sys.dont_write_bytecode:
            return
        path = Path(bucket.key)
        written = path.with_suffix(f".{os.getpid()}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            written.write_bytes(bucket.bytecode_to_string())
            written.replace(path)
        except OSError:
            with suppress(OSError):
                written.unlink()


# The frame of every JSON output: format, command and name.

FORMAT = 1  # Version of the layout; it rises when a key is renamed or removed.


def _clean(value: Any) -> Any:
    """Plain data with nine significant digits: enough to read back a float32,
    few enough to be the same everywhere.

    Infinite and undefined numbers become null, which JSON can hold.
    """
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, np.generic):
        return _clean(value.item())
    if isinstance(value, float):
        return float(f"{value:.{JSON_DIGITS}g}") if math.isfinite(value) else None
    return value


def to_text(command: str, name: str, result: PlainData) -> str:
    """The JSON document of a command: an envelope with the versions around the result;
    ends with a line feed.
    """
    envelope = {
        "dqforge": __version__,
        "format": FORMAT,
        "command": command,
        "design": name,
        **result,
    }
    return json.dumps(_clean(envelope), indent=1, ensure_ascii=True, allow_nan=False) + "\n"


# The chapters of the report and their order; capabilities write the parts of them.


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter of the report.

    Args:
        id, title: Its anchor, and its name in the contents.
        opening: Paragraph that stands before its parts, whoever writes them; empty where its only
            part opens it.
        folded: Whether it is closed at first: what few readers want, or want last.
    """

    id: str
    title: str
    opening: str = ""
    folded: bool = False


REFERENCE = Chapter("reference", "Current reference")
ERRORS = Chapter("errors", "Torque error and loss", folded=True)
LOOPS = Chapter(
    "loops",
    "Control loops",
    "The loops are evaluated as sampled systems: one period of computation delay, zero-order hold, "
    "exact discretisation. The axes are taken as decoupled and the inverter as linear.",
)
LOSSES = Chapter(
    "losses",
    "Loss comparison",
    "Every loss of the drive in the steady state, by kind: copper and what the current ripple adds "
    "to it, iron (and what switching adds) and magnets where the design specifies them, "
    "conduction, dead time and switching of the inverter, DC link. Kinds below 0.01 % are not "
    "shown, but counted. Junction temperatures are solved together with the losses that depend on "
    "them; the field is weakened as far as each modulator needs it. Friction, which no alternative "
    "changes, is not part of the total.",
)
MODULATION = Chapter("modulation", "Modulator and frequency")
CURRENT_FEEDBACK = Chapter("current-feedback", "Current-feedback PWM")
WAVEFORMS = Chapter("waveforms", "Phase currents")
WEAKENING = Chapter("weakening", "Field weakening")
SIMULATION = Chapter("simulation", "Simulation")

# In the order of the report; a chapter that is not listed follows them.
CHAPTERS = (
    *(REFERENCE, ERRORS, LOOPS, LOSSES, MODULATION),
    *(CURRENT_FEEDBACK, WAVEFORMS, WEAKENING, SIMULATION),
)


# JSON as dqforge writes it, read so that no two readers take it for different things.


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number of JSON")


def strict_json(content: str | bytes) -> Any:
    """Plain data of a document.

    Raises:
        ValueError: It is no JSON, a key stands twice in one object, or a number is not finite.
        RecursionError: It is nested too deeply.
    """
    return json.loads(content, object_pairs_hook=_unique, parse_constant=_constant)
