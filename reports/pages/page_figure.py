"""A figure as a page has it: the drawing, its data to be taken away, and what a pointer needs to
tell them.
"""

from __future__ import annotations

import base64
import html
import json
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from dqforge.machines.records import dataclass
from dqforge.reports.figure_data.figure_sheet import read_figure
from dqforge.reports.pages.figures_style import to_svg

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

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
