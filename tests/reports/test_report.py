"""The report: complete, escaped, self-contained, deterministic, and shown by a real browser."""

from __future__ import annotations

import base64
import hashlib
import html
import itertools
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design, InputValue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.pages.figures_style import BLUE, ORANGE, PART_COLOURS, SKY, TEAL
from dqforge.reports.pages.html_text import count, number, quantity, share, symbols
from dqforge.reports.report import render_report, run_tables
from dqforge.reports.run_folder import ListedFile
from dqforge.reports.verification.host import Check, Verification

SECTIONS = ("summary", "machine", "reference", "errors", "loops", "losses", "header", "conventions")
VERIFIED = Verification(256, 20_000, (Check("c99", 20_256), Check("c++11", 20_256)))
HOSTILE = "A \"drive\" 'x' <script>alert(1)</script> --> */ & $\\x$ {{ 7*7 }}"
VOID = {"meta", "link", "br", "img", "hr", "input", "wbr"}


def _solution(name: str, **changes: object) -> Solution:
    """Solve a design of the library with its breakpoint given, which saves the search."""
    design = catalogue.load(name)
    return solve(replace(design, fit=replace(design.fit, breakpoints=(76.4,)), **changes))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def solution() -> Solution:
    return _solution("paper000-ipmsm-100kw")


@pytest.fixture(scope="module")
def report(solution: Solution) -> str:
    return render_report(solution, VERIFIED)


class Page(HTMLParser):
    """Tags that are balanced, the identifiers, the links and the text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.text: list[str] = []
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        named = dict(attrs)
        self.ids += [named["id"] or ""] if "id" in named else []
        self.links += [value or "" for key, value in attrs if key in ("href", "src")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_all_sections_are_there_and_linked(report: str) -> None:
    page = Page(report)
    assert report.startswith("<!DOCTYPE html>")
    assert len(set(page.ids)) == len(page.ids)
    for section in SECTIONS:
        assert section in page.ids
        assert f"#{section}" in page.links
    inside = [link for link in page.links if not link.startswith("data:text/csv")]
    assert all(link.removeprefix("#") in page.ids for link in inside)


def test_nothing_outside_is_asked_for(report: str) -> None:
    page = Page(report)
    assert "http" not in report.replace('xmlns="http://www.w3.org/2000/svg"', "").replace(
        "http-equiv", ""
    )
    assert page.tags.isdisjoint({"link", "iframe", "img", "object", "base", "form"})
    assert all(link.startswith(("#", "data:text/csv;charset=utf-8")) for link in page.links)
    assert not re.search(r"\bon\w+=|javascript:|@import|url\((?!#)", report)


def test_no_script_but_its_own_is_admitted(report: str) -> None:
    scripts = re.findall(r"<script>(.*?)</script>", report, re.S)
    assert scripts
    assert report.count("<script") == len(scripts)
    hashes = [hashlib.sha256(script.encode()).digest() for script in scripts]
    sources = " ".join(f"'sha256-{base64.b64encode(each).decode()}'" for each in hashes)
    policy = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src {sources}"
    assert f'content="{policy}"' in html.unescape(report)


def test_headings_leave_no_level_out_and_what_is_folded_says_what_it_holds(
    solution: Solution, report: str
) -> None:
    levels = [int(level) for level in re.findall(r"<h(\d)[ >]", report)]
    assert levels[0] == 1
    assert all(below <= above + 1 for above, below in itertools.pairwise(levels))
    parts = re.findall(r"<details[^>]*>\s*<summary>(.*?)</summary>", report, re.S)
    assert len(parts) == report.count("<details")
    assert all(re.search(r'<span class="held">.*\d', part, re.S) for part in parts)
    inferred = sum(value.inferred for value in solution.design.values)
    assert f"{len(solution.design.values)} values, {inferred} inferred" in report
    assert '<details class="chapter" open>' in report
    assert re.search(r'<details class="chapter">\s*<summary><h2>Torque error and loss</h2>', report)


def test_scrolling_boxes_are_reached_by_keyboard_and_have_a_name(report: str) -> None:
    boxes = re.findall(r'<div class="(?:scroll|card|code)"[^>]*>', report)
    assert len(boxes) > 10
    for box in boxes:
        assert all(part in box for part in ('role="group"', 'tabindex="0"', 'aria-label="'))
        assert 'aria-label=""' not in box
    assert not re.search(r"<th[^>]*></th>|<h\d[^>]*></h\d>", report)
    assert all("scope=" in head for head in re.findall(r"<th[ >][^<]*", report))


def test_files_beside_the_report_are_linked(solution: Solution, report: str) -> None:
    files = [
        ListedFile.of("ipm100.h", "the header", b"abc"),
        ListedFile.of('dqforge-input/files/a: b%&"<.csv', HOSTILE, b""),
        ListedFile("dqforge-manifest.json", "the list"),
    ]
    page = Page(render_report(solution, VERIFIED, files=files))
    assert [link for link in page.links if not link.startswith(("#", "data:"))] == [
        "ipm100.h",
        "dqforge-input/files/a%3A%20b%25%26%22%3C.csv",
        "dqforge-manifest.json",
    ]
    text = " ".join(page.text)
    assert hashlib.sha256(b"abc").hexdigest()[:12] in text
    assert HOSTILE in text
    assert "#files" in page.links
    assert "#files" not in Page(report).links


@pytest.mark.slow
def test_the_same_solution_gives_the_same_bytes(solution: Solution, report: str) -> None:
    assert render_report(solution, VERIFIED) == report


def test_no_date_no_path_no_number_gone_wrong(report: str) -> None:
    text = "".join(Page(report).text)
    assert not re.search(r"20\d\d-\d\d-\d\d", text)
    assert str(Path.cwd()) not in report
    assert not re.search(r"\b(nan|inf|None)\b", text)


def test_text_of_the_design_file_is_escaped(solution: Solution) -> None:
    value = InputValue(HOSTILE, HOSTILE, 1.0, "A", HOSTILE, inferred=True, note=HOSTILE)
    design = replace(
        solution.design, name=HOSTILE, about=HOSTILE, values=(value,), assumptions=(HOSTILE,)
    )
    report = render_report(replace(solution, design=design), None)
    page = Page(report)
    assert "<script>alert" not in report
    assert report.count("<script") == 2
    assert (
        "".join(page.text).count(HOSTILE) == 9
    )  # title, heading, about, what to look out for, four cells and one assumption


def test_key_numbers_are_those_of_the_solution(solution: Solution, report: str) -> None:
    saving = solution.curves.saving
    assert saving is not None
    assert 0.0 < saving.relative < 1.0
    assert share(saving.relative, 3) in report
    assert quantity(solution.fit.torque_max, "N m") in report
    assert f"{np.degrees(solution.gains.i_d.phase_margin):.1f}\u00b0" in report
    assert "781\u00a0W" in report
    assert solution.design.digest in report
    assert 'IPM100_R_S_OHM</code></th><td class="n"><code>0.002F' in report
    assert "void ipm100_current_reference(float torque_Nm, float *i_d_A, float *i_q_A);" in report


def test_inferred_values_carry_a_badge(solution: Solution, report: str) -> None:
    inferred = sum(value.inferred for value in solution.design.values)
    assert inferred > 0
    assert report.count('<span class="badge">inferred</span>') == inferred


@pytest.mark.slow
def test_the_outcome_of_the_verification_is_plain(solution: Solution, report: str) -> None:
    assert f"{count(20_256)} results of the compiled evaluator" in report
    assert "C99 and C++11" in report
    skipped = render_report(solution, None)
    assert "Not verified." in skipped
    assert "Verified.</strong>" not in skipped.replace("Not verified.", "")
    partly = replace(VERIFIED, checks=(Check("c99", 20_256), Check("c++11", 0, "g++")))
    assert "C++11 was not tested: it needs the Debian package g++." in render_report(
        solution, partly
    )


def _varied(design: Design, variant: str) -> Design:
    machine, control = linearised(design.machine), design.control
    match variant:
        case "surface":
            return replace(design, machine=replace(machine, l_q=machine.l_d), fit=FitSettings())
        case "inverse":
            return replace(
                design, machine=replace(machine, l_d=machine.l_q, l_q=machine.l_d), losses=None
            )
        case "reluctance":
            plain = replace(control, observer=None, speed_loop=None)
            fit = FitSettings(form="closed-form")
            return replace(
                design, machine=replace(machine, psi_pm=0.0), control=plain, losses=None, fit=fit
            )
        case "own":
            fit = FitSettings(
                form="polynomial", method="lagrange", degree=2, segments=2, breakpoint_mode="own"
            )
            return replace(design, fit=fit, losses=None)
        case _:
            small = replace(machine, i_max=2e-3, psi_pm=1e-3, inertia=1e-9)
            return replace(
                design,
                machine=small,
                control=replace(control, observer=None, speed_loop=None),
                losses=None,
            )


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["surface", "inverse", "reluctance", "own", "tiny"])
def test_other_machines_and_forms_have_a_report(solution: Solution, variant: str) -> None:
    design = replace(solution.design, fit=FitSettings(breakpoints=None, segments=1))
    page = Page(render_report(solve(_varied(design, variant)), None))
    assert ("losses" in page.ids) == (variant == "surface")
    assert "mtpa-figure" in page.ids


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (number(-0.0), "0"),
        (number(-1.5e-7), "\u22121.5\u00b710\u207b\u2077"),
        (number(1234567.0), "1234567"),
        (number(float("nan")), "\u2013"),
        (quantity(3.5e-4, "H"), "350\u202f\u00b5H"),
        (quantity(2e-5, "N m"), "20\u202f\u00b5N\u00a0m"),
        (quantity(1e-5, "s"), "10\u202f\u00b5s"),
        (quantity(0.05, "kg m^2"), "0.05\u202fkg\u00a0m\u00b2"),
        (share(0.215), "22\u202f%"),
        (share(1.9e-5, 3), "19\u202fppm"),
        (share(8.5e-8), "85\u202fppb"),
        (share(1e-14), "below 0.01\u202fppb"),
        (share(0.0), "0\u202f%"),
        (str(symbols("i_d < l_d")), "<i>i</i><sub>d</sub> &lt; l_d"),
        (
            str(symbols("i_0 and u_a, not i_00")),
            "<i>i</i><sub>0</sub> and <i>u</i><sub>a</sub>, not i_00",
        ),
    ],
)
def test_numbers_read_well(text: str, expected: str) -> None:
    assert text == expected


def _chromium() -> str:
    """A headless browser, or a skip that says how to get one; in CI it must be there."""
    program = shutil.which("chromium")
    if program is None:
        message = "no browser: install the Debian package chromium"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return program


def _browse(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [
        _chromium(),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        "--hide-scrollbars",
    ]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += [
        f"--user-data-dir={page.parent / 'profile'}",
        "--enable-logging=stderr",
        "--v=0",
        *options,
    ]
    return subprocess.run(
        [*command, page.as_uri()], capture_output=True, text=True, timeout=120, check=True
    )


@pytest.mark.slow
def test_a_browser_shows_every_figure_without_complaint(report: str, tmp_path: Path) -> None:
    page, picture = tmp_path / "report.html", tmp_path / "report.png"
    page.write_text(report, encoding="utf-8")
    dom = _browse(page, "--dump-dom")
    assert "CONSOLE" not in dom.stderr
    for name in ("mtpa", "fit", "errors", "loops", "losses"):
        assert f'id="{name}-figure"' in dom.stdout
    shown = _browse(page, "--window-size=1100,9500", f"--screenshot={picture}")
    assert "CONSOLE" not in shown.stderr
    pixels = np.round(255.0 * np.asarray(imread(picture))[..., :3]).astype(int)
    parts = {part: PART_COLOURS[part] for part in ("copper", "conduction", "switching")}
    colours = {"mtpa": SKY, "fit": ORANGE, "errors": BLUE, "loops": TEAL, **parts}
    for name, colour in colours.items():
        wanted = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
        assert np.count_nonzero(np.all(pixels == wanted, axis=-1)) > 100, name


def test_what_to_flash_stands_before_its_evidence() -> None:
    solution = solve(catalogue.load("paper000-ipmsm-100kw"))
    assert solution.loops is not None
    page = render_report(solution, None)
    loop = solution.loops.i_q
    order = ('id="summary"', f"kp {loop.kp:.5g}\u202fV/A", "What to look out for", 'id="evidence"')
    places = [page.index(words) for words in order]
    assert places == sorted(places)
    first, second, last = run_tables(solution, None)
    assert any(f"kp {loop.kp:.5g} V/A" in row[1] for row in first.rows)
    assert any("not compiled" in row[1] for row in second.rows)
    assert last.title == "Evidence"


@pytest.mark.parametrize(("name", "number"), [("q15", "int16_t"), ("q31", "int32_t")])
def test_a_report_declares_an_integer_reference_with_its_type(name: str, number: str) -> None:
    page = render_report(solve(catalogue.load("hoverboard-hub", [f"fit.format={name}"])), None)
    declared = re.sub(r"<[^>]+>", "", page)
    assert f"_current_reference_{name}({number} torque, {number} *i_d, {number} *i_q);" in declared
