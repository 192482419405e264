"""Figures of the documentation: one style for all, no markup left raw, white behind them, and those
that are drawn fast are those that the scripts draw today.
"""

from __future__ import annotations

import ast
import re
import xml.etree.ElementTree as ET
from importlib import import_module
from pathlib import Path

import pytest
from browser import open_page
from said_and_came import same_drawing

DOCS = Path(__file__).resolve().parent.parent / "docs"
DRAWING = sorted((DOCS / "drawing").glob("figures_*.py"))
FIGURES = sorted((DOCS / "figures").glob("*.svg"))
REPORTS = DOCS.parent / "reports"
DRAWERS = sorted(path for path in REPORTS.rglob("*.py") if "figures" in path.stem)
SVG = "{http://www.w3.org/2000/svg}"


def test_everything_that_draws_goes_through_the_style() -> None:
    for path in [*DRAWING, *DRAWERS]:
        if path.name == "figures_style.py":
            continue
        calls = {
            node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Call)
        }
        assert calls.isdisjoint({"Figure", "savefig", "rc_context", "subplot_mosaic"}), path
        if "subplots" in calls or "add_subplot" in calls:
            assert {"new_figure", "style"} <= calls, path


def test_the_documentation_has_no_colours_of_its_own() -> None:
    own = re.compile(r"#[0-9a-fA-F]{6}|color=\"(?!none)|\"C\d\"|\"k[-:_.]")
    assert [path.name for path in DRAWING if own.search(path.read_text(encoding="utf-8"))] == []


MARKUP = re.compile(r"[${}\\]|_\{|(?<!\w)[A-Za-z\u03b1-\u03c9]_[a-z\u03b1-\u03c90]{1,2}(?!\w)")


def test_every_figure_is_of_the_style_and_shows_no_markup() -> None:
    """White behind the whole figure: it can be read on a dark page, too."""
    assert FIGURES
    for path in FIGURES:
        root = ET.parse(path).getroot()
        texts = ["".join(found.itertext()) for found in root.iter(f"{SVG}text")]
        assert [text for text in texts if MARKUP.search(text)] == [], path.name
        assert root.get("width") == "504pt", path.name
        assert root.get("aria-label"), path.name
        first = next(root.iter(f"{SVG}path"))
        assert "fill: #ffffff" in (first.get("style") or ""), path.name
        numbers = [float(n) for n in re.findall(r"[\d.]+", first.get("d") or "")]
        assert max(numbers[::2]) == pytest.approx(504.0), path.name
        assert "var(" not in path.read_text(encoding="utf-8"), f"{path.name} does not stand alone"


CUT_OFF = """
[...document.querySelectorAll("svg")].flatMap((svg) => {
  const whole = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("text")].filter((text) => {
    const box = text.getBoundingClientRect();
    return box.left < whole.left - 1 || box.right > whole.right + 1
      || box.top < whole.top - 1 || box.bottom > whole.bottom + 1;
  }).map((text) => svg.getAttribute("aria-label") + ": " + text.textContent);
})
"""


@pytest.mark.slow
def test_no_text_is_cut_off(tmp_path: Path) -> None:
    """As a browser sets it, with the letters that it has."""
    page = tmp_path / "figures.html"
    drawings = [path.read_text(encoding="utf-8").partition("?>")[2] for path in FIGURES]
    page.write_text("<!DOCTYPE html><meta charset=utf-8>" + "<hr>".join(drawings), encoding="utf-8")
    with open_page(page, tmp_path) as tab:
        assert tab.value("document.querySelectorAll('svg').length") == len(FIGURES)
        assert tab.value(CUT_OFF) == []


DRAWN_FAST = (
    "current-loop-step",
    "firmware-moteus",
    "firmware-odrive",
    "hysteresis-frequency",
    "loss-comparison",
    "modulation-family",
    "phase-waveforms",
    "position-observers",
    "simulation",
)


@pytest.mark.slow
@pytest.mark.parametrize("name", DRAWN_FAST)
def test_figures_are_those_of_the_drives_of_today(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drive of the library that changes takes its figures along."""
    monkeypatch.syspath_prepend(str(DOCS / "drawing"))
    drawn = tmp_path / f"{name}.svg"
    import_module("make_figures").FIGURES[name](drawn)
    found = (DOCS / "figures" / drawn.name).read_text(encoding="utf-8")
    assert same_drawing(drawn.read_text(encoding="utf-8"), found)
