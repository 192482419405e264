"""The checker of field weakening confirms what is written, and finds what is planted in it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import weakened_drives

from dqforge.checker import check_surface as checker
from dqforge.checker import kit, polynomials
from dqforge.machines.design.catalogue import load
from dqforge.machines.design.settings import WeakeningSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.field_weakening.fit import WeakeningFit, fit_weakening
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files
from dqforge.reports.single_headers.field_weakening import weakening_files
from dqforge.reports.verification.independent import certificate_files

Plain = dict[str, Any]
Change = Callable[[str, Plain], str]
SLOW = pytest.mark.slow


@cache
def fitted(name: str) -> WeakeningFit:
    machine, volts, speed = weakened_drives.CASES[name]
    return fit_weakening(machine, machine.i_max, volts, WeakeningSettings(speed, flash=4000))


@cache
def sound(name: str) -> tuple[str, str, str]:
    """Header of field weakening, constants of the main header, and certificate."""
    fit, design = fitted(name), weakened_drives.weakened_design(name)
    design = replace(design, export=replace(design.export, prefix="d"))
    text = weakening_files(design, fit)["d_weakening.h"].decode("ascii")
    machine = fit.region.machine
    assert isinstance(machine, LinearMachine)
    values = (machine.pole_pairs, machine.r_s, machine.l_d, machine.l_q, machine.psi_pm)
    names = kit.MACHINE
    main = "".join(
        f"#define D_{constant} ({value!r}{'F' if isinstance(value, float) else ''})\n"
        for constant, value in zip(names.values(), values, strict=True)
    )
    said = checker.Surface(text, "d").said
    limits = (fit.region.i_max, fit.domain.v_max, fit.domain.omega_e)
    plain = {
        "machine": dict(zip(names, map(repr, values), strict=True)),
        **dict(zip(checker.LIMITS, map(repr, map(float, limits)), strict=True)),
        "bounds": {each: said[each] for each in checker.BOUNDS},
    }
    return text, main, json.dumps(plain)


def said(
    header: str, main: str, plain: Plain, folder: Path, capsys: pytest.CaptureFixture[str]
) -> str:
    """The last line that the checker prints."""
    (folder / "d_weakening.h").write_text(header)
    (folder / "d.h").write_text(main)
    path = folder / "d_surface.json"
    path.write_text(json.dumps(plain))
    capsys.readouterr()
    code = checker.main([str(path)])
    line = capsys.readouterr().out.splitlines()[-1]
    assert code == (1 if line.startswith("not confirmed: ") else 0)
    return line


def test_the_checker_runs_alone(tmp_path: Path) -> None:
    header, main, certificate = sound("small ipm")
    (tmp_path / "d_weakening.h").write_text(header)
    (tmp_path / "d.h").write_text(main)
    path = tmp_path / "d_surface.json"
    path.write_text(certificate)
    command = [sys.executable, "-I", "-S", checker.__file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert (
        first == "not covered: of the surface torque beyond reach against the largest, copper loss"
    )
    assert second.startswith("confirmed: at most, d_weakening_reference: the phase voltage, ")


def test_halves_have_the_values_of_the_polynomial() -> None:
    """Ranges on boxes of boxes against the polynomial in fractions."""
    poly = polynomials.Poly({(0, 0): Fraction(3), (2, 1): Fraction(-7, 5), (1, 3): Fraction(2, 3)})
    spans = (0, 2 * checker.ONE), (-checker.ONE, checker.ONE)
    rows = [[c for c in row for _ in range(5)] for row in poly.on(spans, (2, 3))]
    boxes = [polynomials.Box(*spans, rows, 0, ())]
    for step in range(6):
        boxes = [half for box in boxes for half in box.cut(step % 2 == 0)]
    for box in boxes:
        low, high = (Fraction(end, checker.ONE) for end in box.ends(0))
        for share in (Fraction(0), Fraction(1, 3), Fraction(1)):
            t, x = (
                Fraction(a, checker.ONE) + share * Fraction(b - a, checker.ONE)
                for a, b in (box.t, box.x)
            )
            value = sum(c * t**i * x**j for (i, j), c in poly.terms.items())
            assert low <= value <= high
        assert high - low < 2


@pytest.mark.parametrize(
    "name", ["small ipm", *(pytest.param(name, marks=SLOW) for name in ("servo", "inverse"))]
)
def test_rounding_is_enclosed(name: str) -> None:
    """What the emitted arithmetic makes of currents, against the polynomials in fractions."""
    fit, (header, _, certificate) = fitted(name), sound(name)
    surface = checker.Surface(header, "d")
    errors = checker.Errors(surface, json.loads(certificate))
    code = surface.curves[0][1]
    _, weak = errors.polynomials(code)
    generator = np.random.default_rng(7)
    reference = fit.step.surface
    for _ in range(20):
        a = np.float32(generator.uniform(float(reference.flux_min), float(reference.flux_max)))
        t = np.float32(generator.uniform(0.0, 1.0) * float(fit.step.torque_max))
        taken = reference.flux.evaluate(np.array([t]))[0]
        delta = np.float32(taken - a)
        if delta <= 0.0:
            continue
        d, q = (float(part[0]) for part in reference.currents(np.array([t]), np.array([a])))
        if reference.limited(np.array([t]), np.array([a]))[0][0] != t:
            continue
        ends = [int(Fraction(float(value)) * checker.ONE) for value in (t, delta)]
        box = polynomials.Box((ends[0], ends[0]), (ends[1], ends[1]), [], 0, ())
        by_d, by_q, by_a = errors.rounding(box, code, weakens=True)
        names = checker.run(
            code + surface.surface, {"t": checker.T, "delta": checker.X}, checker.constant
        )
        for made, exact, room in (
            (Fraction(d), names["i_d"], by_d),
            (Fraction(q), names["i_q"], by_q),
            (Fraction(float(a)), weak[4], by_a),
        ):
            value = sum(
                c * Fraction(float(t)) ** i * Fraction(float(delta)) ** j
                for (i, j), c in exact.terms.items()
            )
            assert abs(made - value) <= Fraction(room, checker.ONE)
            assert Fraction(room, checker.ONE) <= abs(value) * Fraction(1, 2**14)


def literal(place: int, factor: float) -> Change:
    """One of the literals of the step's polynomials, in their order, times a factor."""

    def change(header: str, plain: Plain) -> str:
        start = header.index("const float mtpa_d")
        parts = re.split(r"((?<![\w.])[\d.]+(?:e[-+]?\d+)?F)", header[start:])
        numbers = [k for k in range(1, len(parts), 2) if float(parts[k][:-1]) != 0.0]
        at = numbers[place]
        parts[at] = f"{float(parts[at][:-1]) * factor:.9g}F"
        parts[at] = parts[at] if re.search(r"[.e]", parts[at]) else f"{parts[at][:-1]}.0F"
        return header[:start] + "".join(parts)

    return change


def texts(old: str, new: str) -> Change:
    def change(header: str, plain: Plain) -> str:
        assert old in header
        return header.replace(old, new, 1)

    return change


def scaled(pattern: str, factor: float) -> Change:
    """The number behind a pattern in the header, times a factor."""

    def change(header: str, plain: Plain) -> str:
        def by(found: re.Match[str]) -> str:
            return f"{found[1]}{float(found[2]) * factor:.8e}F"

        changed, count = re.subn(rf"({pattern})([\d.]+(?:e[-+]?\d+)?)F", by, header, count=1)
        assert count == 1
        return changed

    return change


def stated(*names: str, by: float = 1.0, value: str | None = None) -> Change:
    """A number of the certificate times a factor, or another."""

    def change(header: str, plain: Plain) -> str:
        inner = plain
        for name in names[:-1]:
            inner = inner[name]
        inner[names[-1]] = repr(float(inner[names[-1]]) * by) if value is None else value
        return header

    return change


def bound(name: str, words: str, factor: float) -> Change:
    """A smaller bound, in the header and the certificate alike."""

    def change(header: str, plain: Plain) -> str:
        less = f"{float(plain['bounds'][name]) * factor:.4g}"
        old = f"{words}{plain['bounds'][name]} "
        assert old in header
        plain["bounds"][name] = less
        return header.replace(old, f"{words}{less} ", 1)

    return change


def planted() -> dict[str, tuple[Change, str]]:
    """Faults by name, each with what must be said of it."""
    place = r"surface, \w+: not within its bound at .* N m, .* Wb"
    faults: dict[str, tuple[Change, str]] = {}
    for name, words in (
        ("voltage_percent", "exceeds its limit by "),
        ("current_percent", "the current its limit by "),
        ("torque_Nm", "errs by at most "),
        ("torque_percent", " N m, "),
    ):
        faults[f"{name} smaller"] = bound(name, words, 0.6), place
        faults[f"{name} in the certificate alone"] = (
            stated("bounds", name, by=0.99),
            "another bound",
        )
    for name in kit.MACHINE:
        faults[f"{name} of the certificate"] = stated("machine", name, by=1.01), "another|damaged"
    for name in checker.LIMITS:
        faults[f"{name} of the certificate"] = stated(name, by=0.99), f"{name}: the header says"
    for pattern, factor, words in (
        (r"FLUX_MIN_WB \(", 1.3, "leaves less than FLUX_MIN_WB"),
        (r"FLUX_MIN_WB \(", 0.8, place),
        (r"FLUX_MAX_WB \(", 0.3, "range of flux"),
        (r"squared - ", 0.5, place),
        (r"drop = ", 0.9, "another resistance"),
        (r"used \* ", 1.1, "another resistance"),
        (r"\(some < ", 1.1, "torque_max|another d_weakening_reference"),
    ):
        faults[f"{pattern} times {factor}"] = scaled(pattern, factor), words
    for old, new, words in (
        ("TRIALS (14U)", "TRIALS (0U)", "14U|0U|trials|macro"),
        ("taken > a_held", "taken < a_held", "another d_weakening_reference"),
        ("omega * D_WEAK", "omega + D_WEAK", "another d_weakening_flux"),
        ("return limit", "return 2.0F * limit", "another d_weakening_limit"),
        ("(delta * d) +", "(delta * d) -", "another d_weakening_reference"),
        ("(more > flux)", "(more < flux)", "another d_weakening_reference"),
        ("? -drop : drop", "? drop : -drop", "another d_weakening_reference"),
        ("80 % of", "20 % of", place + "|resistance takes|leaves less"),
        ("proven for every", "found for every", "no bounds"),
        ("The phase resistance is 1.1", "The phase resistance is 1.2", "r_s_Ohm"),
        ("41.57 V up to", "41.67 V up to", "v_max_V"),
    ):
        faults[f"{old} {new}"] = texts(old, new), words
    harmless = {(8, 1.1), (13, 1.1), (2, 0.9), (12, 0.9), (14, 0.9), (17, 0.9)}  # as sampled
    for number in range(20):
        for factor in (1.1, 0.9):
            if (number, factor) not in harmless:
                faults[f"literal {number} times {factor}"] = literal(number, factor), place
    return faults


@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=SLOW) for k in range(1, 32))])
def test_planted_faults_are_found(
    part: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, main, certificate = sound("small ipm")
    faults = planted()
    assert len(faults) >= 40
    missed = {}
    for name, (change, words) in list(faults.items())[part::32]:
        plain = json.loads(certificate)
        line = said(change(header, plain), main, plain, tmp_path, capsys)
        if not line.startswith("not confirmed: ") or not re.search(words, line):
            missed[name] = line
    assert missed == {}


@SLOW
@pytest.mark.parametrize("name", ["servo with mtpv", "inverse", "reluctance", "interior"])
def test_other_machines_are_confirmed(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Segments, MTPV with its line, one pass, no magnet; and no bound below what was found."""
    header, main, certificate = sound(name)
    assert said(header, main, json.loads(certificate), tmp_path, capsys).startswith("confirmed: ")
    plain = json.loads(certificate)
    fit = fitted(name)
    less = f"{100.0 * fit.voltage.voltage_excess * 0.99:.5g}"
    header = header.replace(
        f"exceeds its limit by {plain['bounds']['voltage_percent']} ",
        f"exceeds its limit by {less} ",
    )
    plain["bounds"]["voltage_percent"] = less
    line = said(header, main, plain, tmp_path, capsys)
    assert line.startswith("not confirmed: surface, voltage_percent: ")


@SLOW
@pytest.mark.parametrize(
    ("name", "rpm"),
    [
        ("abb-ipmsm-2k2", 1500),
        ("abb-syrm-6k7", 1500),
        ("paper000-ipmsm-100kw", 4500),
        ("paper001-pmsm-bench", 6000),
    ],
)
def test_library_drives_have_their_certificate(name: str, rpm: float, tmp_path: Path) -> None:
    speed = WeakeningSettings(rpm * weakened_drives.RPM, flash=4000)
    solution = solve(replace(load(name), weakening=speed, losses=None))
    files = emitted_files(solution)
    files |= certificate_files(solution, files)
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    path = tmp_path / f"{solution.design.export.prefix}_surface.json"
    assert checker.main([str(path)]) == 0
    assert set(json.loads(path.read_text())["bounds"]) == set(checker.BOUNDS)
