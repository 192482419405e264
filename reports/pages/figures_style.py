"""How every figure looks, and how it becomes bytes: one palette, one style,
the same bytes for the same figure.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.answer import check_figure_path, write_atomically
from dqforge.reports.pages.figure_sheet import read_figure
from dqforge.reports.pages.scaled import tick_in_unit

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.text import Text


# Told apart by readers who see no red or green, and in grey print by their lightness. Every colour
# of a curve or a bar stands out from white and, as `DARK` has it, from the dark page by 3 to 1 at
# least, every colour of text by 4.5 to 1.
INK = "#1b2430"
MUTED = "#5d6875"

# Curves of the second row.
PALE = "#87919d"

# Bands and borders behind the data.
FAINT = "#c3cad3"
GRID = "#e7eaee"
PAPER = "#ffffff"
BLUE = "#1f6fb2"
ORANGE = "#bd540b"
TEAL = "#00796b"
PURPLE = "#8a3f9e"
OLIVE = "#7a6a00"
RED = "#b3263a"
BROWN = "#7d5a3c"
SKY = "#5b93cc"

# Colours of curves in their order.
SERIES = (BLUE, ORANGE, TEAL, PURPLE, OLIVE, RED, BROWN, MUTED, SKY)

# What is written and drawn upon a coloured map, on a dark page too.
MAP_INK = "#1b2431"

# Thin lines upon a coloured map.
MAP_MUTED = "#5d6876"

# Curves upon a coloured map.
MAP_ORANGE = "#bd540c"
AXIS_COLOURS = {"d": BLUE, "q": ORANGE}
LOOP_COLOURS = {"i_d": BLUE, "i_q": ORANGE, "i_0": MUTED, "speed": TEAL}

PART_COLOURS = {
    "copper": "#b5651d",
    "ripple_copper": "#cf8031",
    "iron": "#6b4a30",
    "ripple_iron": "#96765c",
    "magnet": "#8f8170",
    "conduction": "#4f93d2",
    "dead_time": "#2f78bd",
    "switching": "#1d4e89",
    "capacitor": "#7d838d",
}

# Colours on a dark page; one that is not named stays as it is.
DARK = {
    INK: "#e3e8ee",
    MUTED: "#a3afbb",
    FAINT: "#4a5563",
    GRID: "#2c353f",
    PAPER: "#1a2027",
    BLUE: "#5ea9ea",
    ORANGE: "#f08a3c",
    TEAL: "#35b8a6",
    PURPLE: "#c98fdc",
    OLIVE: "#c9b84a",
    RED: "#f27e8b",
    BROWN: "#c9a27f",
    SKY: "#7fb3e6",
    "#b5651d": "#e0904a",
    "#cf8031": "#f0b376",
    "#6b4a30": "#b48a68",
    "#96765c": "#d6b99f",
    "#8f8170": "#bfb3a3",
    "#4f93d2": "#7cb4ea",
    "#2f78bd": "#569bdc",
    "#1d4e89": "#3f7fc4",
}

WIDTH = 7.0  # Width of every figure in inches.

FONT_STACK = (
    "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, 'Liberation Sans', "
    "sans-serif"
)

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.titlepad": 6.0,
    "axes.labelsize": 8.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "legend.title_fontsize": 7.5,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "svg.fonttype": "none",
    "svg.hashsalt": "dqforge",
}

_METADATA: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}

_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "\u00b5"), (1e-9, "n"), (1e-12, "p"))


@contextmanager
def style() -> Iterator[None]:
    """The project's figure style over the library's defaults, whatever the user's own settings.

    Undone on leaving.
    """
    import matplotlib as mpl
    from matplotlib import rcsetup

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE, **{"axes.prop_cycle": rcsetup.cycler(color=SERIES)})
        yield


def new_figure(name: str, height: float, describe: str, *, arranged: bool = False) -> Figure:
    """An empty figure of ``height`` inches.

    ``name`` keeps its identifiers apart from those of others on a page.

    ``describe`` says in one sentence what is to be seen, for readers who cannot see it.

    Panels of an ``arranged`` figure make room for their labels themselves.
    """
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # Room beside the tick labels, which readers' fonts make wider than the layout counts.
    layout = ConstrainedLayoutEngine(w_pad=0.09, h_pad=0.05) if arranged else None
    figure = Figure(figsize=(WIDTH, height), label=f"{name}|{describe}", layout=layout)
    figure.set_facecolor(PAPER)
    return figure


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Factor and unit with which values up to ``largest`` read well, such as (1000,
    "mA") for 0.02 A.
    """
    if not (math.isfinite(largest) and largest > 0.0):
        return 1.0, unit
    scale, prefix = next((p for p in _PREFIXES if largest >= p[0]), _PREFIXES[-1])
    return 1.0 / scale, f"{prefix}{unit}"


def label_in_unit(axis: Axis, label: str, largest: float, unit: str) -> None:
    """Label an axis with its unit in place of ``{}``; where all values lie below one,
    both take a smaller unit.
    """
    factor, small = prefixed(largest, unit)
    axis.set_label_text(label.format(small))
    if factor > 1.0:
        tick_in_unit(axis, factor)


def thinned(
    argument: FloatArray, value: FloatArray, bins: int = 220
) -> tuple[FloatArray, FloatArray]:
    """The extreme values of a dense curve in each of ``bins`` slices of its argument,
    in their order.

    Arrays of shape (N,) in, (at most 2 bins,) out: peaks keep their height,
    smooth curves their shape.
    """
    if argument.size <= 2 * bins:
        return argument, value
    edges = np.linspace(argument[0], argument[-1], bins + 1)
    starts = np.unique(np.searchsorted(argument, edges[:-1]))
    keep = [0, argument.size - 1]
    for start, end in zip(starts, [*starts[1:], argument.size], strict=True):
        keep += [int(start + np.argmin(value[start:end])), int(start + np.argmax(value[start:end]))]
    chosen = np.unique(keep)
    return argument[chosen], value[chosen]


def vertical_marks(axes: Axes, positions: FloatArray, name: str) -> None:
    """Thin vertical lines, for breakpoints; ``name`` is theirs in the data."""
    for position in positions:
        axes.axvline(
            float(position),
            color=MUTED,
            linewidth=0.7,
            linestyle=(0, (1.5, 2.0)),
            zorder=1,
            label=f"_{name}",
        )


def _content(figure: Figure, file_format: str, **options: Any) -> bytes:
    buffer = io.BytesIO()
    with style():
        figure.savefig(buffer, format=file_format, metadata=_METADATA[file_format], **options)
    return buffer.getvalue()


def _texts(artist: Artist) -> Iterator[Text]:
    """Texts within an artist, but those of ticks, which get theirs when they are drawn: making them
    twice took a fifth of the time of a figure.
    """
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    if isinstance(artist, Text):
        yield artist
    inner = (artist.label, artist.offsetText) if isinstance(artist, Axis) else artist.get_children()
    for child in inner:
        yield from _texts(child)


@contextmanager
def _plain_labels(figure: Figure) -> Iterator[None]:
    """Labels such as ``$i_d$`` as ``i_d`` while the figure is drawn.

    The subscripts are set in the SVG itself.
    """
    labels = [(artist, artist.get_text()) for artist in _texts(figure)]
    labels = [(artist, text) for artist, text in labels if "$" in text]
    for artist, text in labels:
        artist.set_text(text.replace("$", ""))
    try:
        yield
    finally:
        for artist, text in labels:
            artist.set_text(text)


def _subscripts(match: re.Match[str]) -> str:
    """One text element with its subscripts as shifted spans, and the line restored behind each."""
    head, body = match.groups()
    parts = re.split("(?<!\\w)([A-Za-z\u03b1-\u03c9])_(\\w+)", re.sub(r"_\{(\w+)\}", r"_\1", body))
    if len(parts) == 1:
        return match.group()
    spans = [parts[0]]
    for letter, index, rest in zip(parts[1::3], parts[2::3], parts[3::3], strict=True):
        spans.append(
            f'<tspan font-style="italic">{letter}</tspan><tspan font-size="72%" '
            f'dy="0.28em">{index}</tspan>'
        )
        spans.append(f'<tspan dy="-0.2016em">{rest}</tspan>' if rest else "")
    return f"{head}{''.join(spans)}</text>"


def _shorter(match: re.Match[str]) -> str:
    """Coordinates with two decimals (1/7200 inch) and no line breaks."""
    return re.sub(r"(\.\d\d)\d+", r"\1", " ".join(match.group().split()))


def _svg(figure: Figure) -> str:
    """The figure as an SVG element: text as text, small, with identifiers that
    begin with the figure's name.
    """
    name, _, describe = str(figure.get_label()).partition("|")
    with _plain_labels(figure):
        text = _content(figure, "svg").decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(
        r"\s*<metadata>.*?</metadata>|\s*<defs>\s*<style.*?</style>\s*</defs>",
        "",
        text,
        flags=re.DOTALL,
    )
    text = re.sub(
        r"<svg [^>]*?(viewBox=\"[^\"]*\")[^>]*>", rf"{_root(figure, describe)} \1>", text, count=1
    )
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    text = re.sub(r'\b(id="|url\(#|href="#)', rf"\g<1>{name}-", text).replace("xlink:href", "href")
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text)
    text = re.sub(r' transform="rotate\(-?0 [^)]*\)"', "", text)
    text = re.sub(r'\b(?:d|x|y|transform)="[^"]*"', _shorter, text)
    text = re.sub(r"(<text[^>]*>)([^<]*_[^<]*)</text>", _subscripts, text)
    return re.sub(r"\n\s*", "\n", text)


def _root(figure: Figure, describe: str) -> str:
    width, height = (72.0 * float(side) for side in figure.get_size_inches())
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" id="figure" role="img" aria-label="{describe}" '
        f'width="{width:g}pt" height="{height:g}pt" font-family="{FONT_STACK}" '
        'stroke-linejoin="round"'
    )


def to_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element to stand in an HTML page: no prolog, no outside reference,
    no date. Its colours are those of the page's style, with those of white paper behind them.
    """
    return re.sub(r"\b(fill|stroke): (#[0-9a-f]{6})\b", _of_the_page, _svg(figure))


def _of_the_page(match: re.Match[str]) -> str:
    colour = match.group(2)
    return f"{match.group(1)}: {page_colour(colour)}" if colour in DARK else match.group()


def page_colour(colour: str) -> str:
    """A colour as the style of a page has it, light or dark.

    Args:
        colour: As ``#rrggbb``.
    """
    return f"var(--fig-{colour[1:]},{colour})" if colour in DARK else colour


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format that the suffix of ``path`` names, whole or not at all,
    without a date; .csv has the data that it shows.

    Raises:
        InputError: The suffix is not .svg, .png, .pdf or .csv, or the file cannot be written.
    """
    formats: dict[str, Callable[[], bytes]] = {
        ".svg": lambda: b'<?xml version="1.0" encoding="utf-8"?>\n' + _svg(figure).encode(),
        ".png": lambda: _content(figure, "png", dpi=200),
        ".pdf": lambda: _content(figure, "pdf"),
        ".csv": lambda: read_figure(figure).csv().encode(),
    }
    check_figure_path(path)
    write_atomically(path, [formats[path.suffix.lower()]()])
