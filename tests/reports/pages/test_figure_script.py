"""The script of the figures in a real browser: what it tells is what stands in the data, to a
pointer, to keys and to a finger; figures follow the dark page and print on white.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Tab, open_page, until_there
from figure_pages import page_tables
from matplotlib.image import imread

from dqforge.machines.design import catalogue
from dqforge.optimizer.solution import solve
from dqforge.reports.pages.figures_style import DARK, PAPER
from dqforge.reports.report import render_report
from dqforge.reports.run_folder import FIGURES, page_scripts

pytestmark = pytest.mark.slow

FIGURE = "document.querySelector('figure:has(a[download=\"{}\"])')"
TOLD = (
    "[document.querySelector('.told').style.display, "
    "document.querySelector('.told strong')?.textContent, "
    "...[...document.querySelectorAll('.told > span')].map((line) => line.textContent)]"
)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    design = catalogue.load("paper000-ipmsm-100kw")
    solution = solve(replace(design, fit=replace(design.fit, breakpoints=(76.4,))))
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(render_report(solution, None), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def tab(page: Path) -> Iterator[Tab]:
    with open_page(page, page.parent) as opened:
        yield opened
        assert opened.complaints == []


def panels(tab: Tab, name: str) -> list[dict[str, Any]]:
    figure = FIGURE.format(name)
    tab.show(figure)
    found: list[dict[str, Any]] = tab.value(f"JSON.parse({figure}.dataset.panels)")
    return found


def window(tab: Tab, name: str, panel: dict[str, Any], x: float, y: float) -> tuple[float, float]:
    """Where the values of a panel stand in the window."""
    place = []
    for axis, value, (low, high) in (
        (panel["x"], x, panel["box"][::2]),
        (panel["y"], y, panel["box"][:0:-2]),
    ):
        ends = np.array([axis["from"], axis["to"], value], dtype=np.float64)
        start, end, at = np.log(ends) if "log" in axis else ends
        place.append(low + (at - start) / (end - start) * (high - low))
    left, top = tab.value(
        f"(() => {{ const svg = {FIGURE.format(name)}.querySelector('svg');"
        f"const point = new DOMPoint({place[0]}, {place[1]}).matrixTransform(svg.getScreenCTM());"
        "return [point.x, point.y]; })()"
    )
    return float(left), float(top)


def told(tab: Tab) -> list[str]:
    found: list[str] = tab.value(TOLD)
    assert found[0] == "block", "nothing is told"
    return found[1:]


def spaced(text: str) -> str:
    return re.sub(r"\s+", " ", text).replace("\u2212", "-").replace("e-0", "e-")


def test_a_pointer_at_a_known_argument_is_told_the_values_of_the_data(page: Path, tab: Tab) -> None:
    table = page_tables(page.read_text(encoding="utf-8"))["ipm100-loops.csv"]
    magnitude = panels(tab, "ipm100-loops.csv")[2]
    hertz = [float(cell) for cell in table["Frequency: i_d [Hz]"]]
    for at in (3, len(hertz) // 2, len(hertz) - 4):
        tab.move(*window(tab, "ipm100-loops.csv", magnitude, hertz[at], -20.0))
        heading, *lines = told(tab)
        assert spaced(heading) == f"Frequency {table['Frequency: i_d [Hz]'][at]} Hz"
        assert spaced(lines[0]) == f"id {table['Magnitude: i_d [dB]'][at]} dB"
    tab.move(5, 5)
    assert tab.value(TOLD)[0] == "none"


def test_values_of_two_axes_follow_one_another(page: Path, tab: Tab) -> None:
    table = page_tables(page.read_text(encoding="utf-8"))["ipm100-errors.csv"]
    torque = float(table["Torque: Extra copper loss in W [N m]"][200])
    panel = panels(tab, "ipm100-errors.csv")[1]
    assert panel["y"]["log"] == 1
    tab.move(*window(tab, "ipm100-errors.csv", panel, torque, 1e-9))
    heading, line, *_ = told(tab)
    assert spaced(heading) == f"Torque {table['Torque: Extra copper loss in W [N m]'][200]} N m"
    assert float(spaced(line).split()[-2]) == float(table["Extra copper loss [W]"][200])
    hairs = tab.value("document.querySelectorAll('.hair line').length")
    assert hairs == 3, "one hair through the three panels that share the torque"


def test_bars_and_cells_tell_their_names(page: Path, tab: Tab) -> None:
    tables = page_tables(page.read_text(encoding="utf-8"))
    bars = panels(tab, "ipm100-losses.csv")[0]
    tab.move(*window(tab, "ipm100-losses.csv", bars, 100.0, bars["drawn"][0]["places"][2]))
    heading, first, *_ = told(tab)
    table = tables["ipm100-losses.csv"]
    assert spaced(heading).replace("id", "i_d") == table["alternative"][2]
    assert spaced(first) == f"copper {table['Loss: copper [W]'][2]} W"
    cells, title = tables["ipm100-choice.csv"], "Modulator with the least loss"
    middle = [
        0.5 * (float(cells[f"{title}, {axis} from [{unit}]"][0])
               + float(cells[f"{title}, {axis} to [{unit}]"][0]))
        for axis, unit in (("Speed", "rpm"), ("Torque", "N m"))
    ]  # fmt: skip
    panel = panels(tab, "ipm100-choice.csv")[0]
    tab.move(*window(tab, "ipm100-choice.csv", panel, *middle))
    heading, first, *_ = told(tab)
    assert spaced(first) == f"{title} {cells[title][0]}"
    assert heading.startswith(f"Speed {middle[0]:.4g}"[:8])


def test_keys_walk_through_a_figure_and_are_read_aloud(page: Path, tab: Tab) -> None:
    table = page_tables(page.read_text(encoding="utf-8"))["ipm100-fit.csv"]
    panels(tab, "ipm100-fit.csv")
    tab.value(f"{FIGURE.format('ipm100-fit.csv')}.querySelector('.card').focus()")
    assert tab.value("document.activeElement.getAttribute('aria-describedby')") == "figure-keys"
    tab.press("ArrowRight")
    tab.press("ArrowLeft")
    tab.press("Home")
    heading, *lines = told(tab)
    assert spaced(heading) == f"Torque {next(iter(table.values()))[0]} N m"
    assert len(lines) == 4
    spoken = tab.value("document.querySelector('[aria-live=polite]').textContent")
    assert spoken.startswith("Torque 0 N m; exact i_d 0 A")
    assert tab.value("document.querySelector('.told').getAttribute('aria-hidden')") == "true"
    tab.press("PageDown")
    tab.press("End")
    assert spaced(told(tab)[0]).endswith(f"{table['Torque: i_d error [N m]'][-1]} N m")
    assert spaced(told(tab)[1]) == f"id error {table['i_d error [mA]'][-1]} mA"
    tab.press("Escape")
    assert tab.value(TOLD)[0] == "none"


def test_a_finger_is_told_too_and_may_still_scroll(tab: Tab) -> None:
    panel = panels(tab, "ipm100-fit.csv")[1]
    tab.call("Emulation.setTouchEmulationEnabled", enabled=True)
    tab.tap(*window(tab, "ipm100-fit.csv", panel, 100.0, 0.0))
    assert told(tab)[0].startswith("Torque ")
    tab.tap(20, 20)
    assert tab.value(TOLD)[0] == "none"
    tab.call("Emulation.setTouchEmulationEnabled", enabled=False)
    assert tab.value("getComputedStyle(document.querySelector('.card')).touchAction") == "auto"


def test_the_link_gives_the_file(page: Path, tab: Tab) -> None:
    figure = FIGURE.format("ipm100-losses.csv")
    tab.show(f"{figure}.querySelector('a[download]')")
    box = tab.value(
        f"(() => {{ const link = {figure}.querySelector('a[download]');"
        "const box = link.getBoundingClientRect();"
        "return [box.x + box.width / 2, box.y + box.height / 2]; })()"
    )
    tab.click(*box)
    content = until_there(page.parent / "ipm100-losses.csv").decode()
    assert content.startswith("alternative,Loss: copper [W]")


def _pixels(tab: Tab, clip: dict[str, float]) -> np.ndarray[Any, np.dtype[np.int64]]:
    shot = tab.call(
        "Page.captureScreenshot",
        format="png",
        captureBeyondViewport=True,
        clip={**clip, "scale": 1},
    )
    picture = imread(io.BytesIO(base64.b64decode(shot["data"])))
    return np.asarray(np.round(255.0 * np.asarray(picture)[..., :3]), dtype=np.int64)


def _ground(tab: Tab) -> str:
    """The colour that most of the first figure has."""
    clip = tab.value(
        "(() => { const box = document.querySelector('.drawing .card').getBoundingClientRect();"
        "return {x: box.x + scrollX, y: box.y + scrollY, width: box.width, "
        "height: box.height}; })()"
    )
    colours, counts = np.unique(_pixels(tab, clip).reshape(-1, 3), axis=0, return_counts=True)
    return "#" + "".join(f"{part:02x}" for part in colours[np.argmax(counts)].tolist())


def test_figures_follow_the_dark_page_and_print_on_white(tab: Tab) -> None:
    def media(kind: str, scheme: str) -> None:
        scheme_feature = {"name": "prefers-color-scheme", "value": scheme}
        tab.call("Emulation.setEmulatedMedia", media=kind, features=[scheme_feature])

    media("screen", "light")
    assert _ground(tab) == PAPER
    media("screen", "dark")
    assert _ground(tab) == DARK[PAPER]
    media("print", "dark")
    assert _ground(tab) == PAPER
    media("", "")


def test_without_script_the_page_has_all_figures_and_data(page: Path, tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert all(text.count(script) == 1 for script in page_scripts(FIGURES).texts)
    still = tmp_path / "still.html"
    still.write_text(re.sub(r"script-src [^\"]*", "script-src 'none'", text, count=1), "utf-8")
    with open_page(still, tmp_path) as opened:
        assert opened.value("document.querySelector('.told') === null")
        figures = opened.value("document.querySelectorAll('figure[data-panels] svg').length")
        assert figures == opened.value("document.querySelectorAll('a.data').length") == 6
        assert any("Content Security Policy" in text for text in opened.complaints)
