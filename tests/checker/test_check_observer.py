"""The checker of the flux observer confirms what is written, and finds what is planted in it."""

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
from drives import make_design

from dqforge.checker import check_observer as checker
from dqforge.machines.design.catalogue import load
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.observers.methods.flux import METHOD
from dqforge.optimizer.observers.parts import steady_observer
from dqforge.optimizer.observers.tuning import PositionObserver, tune_position_observer
from dqforge.optimizer.solution import solve
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import certificate_files

MACHINE = LinearMachine(pole_pairs=3, r_s=0.5, l_d=2e-3, l_q=3e-3, psi_pm=0.1, i_max=20.0)
T_S, RANGE, CURRENT = 2e-4, (300.0, 1500.0), 8.0
# What `certify_flux_observer` finds for it.
MATRIX = [3.156, -0.1815, -0.7533, -8.752, 3.678, -0.9738, 1.575, 1.851, -5.496, 404.8]
Plain = dict[str, Any]
Change = Callable[[str, Plain], str]


@cache
def observer() -> PositionObserver:
    settings = ObserverSettings(
        method="flux", bandwidth=200.0, pll_bandwidth=250.0, damping=1.0, speed_gain=0.2
    )
    return tune_position_observer(MACHINE, settings, T_S, 300.0, RANGE[1])


@cache
def sound() -> tuple[str, str]:
    """Header and certificate."""
    (header,) = observer_files(make_design(MACHINE), observer()).values()
    text = header.decode("ascii")
    prefix = re.findall(r"(\w+)_flux_gains_t;", text)[0]
    text = text.replace(f"{prefix}_", "d_").replace(f"{prefix.upper()}_", "D_")
    plain = {
        "omega_e": list(RANGE),
        "i_q": CURRENT,
        "contraction": 1.0 - 1e-5,
        "matrix": MATRIX,
    }
    return text, json.dumps(plain)


def said(header: str, plain: Plain, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The last line that the checker prints."""
    (folder / "d_observer.h").write_text(header)
    path = folder / "d_observer.json"
    path.write_text(json.dumps(plain))
    capsys.readouterr()
    code = checker.main([str(path)])
    line = capsys.readouterr().out.splitlines()[-1]
    assert code == (1 if line.startswith("not confirmed: ") else 0)
    return line


def test_the_checker_runs_alone(tmp_path: Path) -> None:
    header, certificate = sound()
    (tmp_path / "d_observer.h").write_text(header)
    path = tmp_path / "d_observer.json"
    path.write_text(certificate)
    command = [sys.executable, "-I", "-S", checker.__file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert first.startswith("not covered: rounding of the observer")
    assert second.startswith("confirmed: small errors of d_flux_step")


@pytest.mark.parametrize(("omega", "i_q"), [(300.0, 8.0), (700.0, 0.0), (1500.0, -8.0)])
def test_the_matrix_has_the_poles_of_the_emitted_step(omega: float, i_q: float) -> None:
    """Against differences of the observer's step about its steady state, on a sampled machine."""
    header, _ = sound()
    known = checker.Observer(header, "d")
    x = omega * T_S
    corner = [np.cos(x), np.sin(x), float(known.alpha_0 + known.alpha_1 * Fraction(x))]
    corner.append((MACHINE.l_d - MACHINE.l_q) * i_q / MACHINE.psi_pm)
    rows = checker.error_matrix(known, tuple(map(Fraction, corner)))
    found = np.linalg.eigvals(np.array([[float(entry) for entry in row] for row in rows]))
    steady = steady_observer(
        METHOD,
        observer().gains,
        T_S,
        plants(MACHINE),
        np.array([1j * i_q]),
        np.array([omega]),
    )
    expected = np.linalg.eigvals(steady.jacobian[0])
    expected = expected[np.argsort(-np.abs(expected))][:4]
    for pole in found:
        assert np.min(np.abs(expected - pole)) < 1e-5


def test_turns_are_enclosed() -> None:
    for x in (0.0, 0.01, 0.5, 1.5):
        for span, value in zip(checker.turned_by(Fraction(x)), (np.cos(x), np.sin(x)), strict=True):
            low, high = (float(end) for end in span)
            assert low - 1e-16 <= value <= high + 1e-16
            assert span[1] - span[0] < Fraction(1, 2**120)


def number(place: int, factor: float) -> Change:
    """One of the header's numbers, in their order, times a factor."""

    def change(header: str, plain: Plain) -> str:
        front, rest = header.split("FLUX_GAINS = {")
        parts = re.split(r"(-?[\d.]+(?:e[-+]?\d+)?F)", rest)
        parts[2 * place + 1] = f"{float(parts[2 * place + 1][:-1]) * factor:.9g}F"
        return f"{front}FLUX_GAINS = {{{''.join(parts)}"

    return change


def texts(old: str, new: str) -> Change:
    def change(header: str, plain: Plain) -> str:
        assert old in header
        return header.replace(old, new, 1)

    return change


def stated(name: str, value: Any) -> Change:
    def change(header: str, plain: Plain) -> str:
        plain[name] = value(plain[name]) if callable(value) else value
        return header

    return change


def planted() -> dict[str, tuple[Change, str]]:
    """Faults by name, each with what must be said of it."""
    faults: dict[str, tuple[Change, str]] = {}
    for place in (0, 1, 2, 4, 6, 11):
        faults[f"number {place}"] = number(place, 1.001), "contradict"
    for place, factor in ((9, -20.0), (10, 20.0)):
        faults[f"number {place} times {factor}"] = number(place, factor), "rad/s|positive"
    for place, factor in ((8, -50.0), (9, 10.0), (12, 30.0), (13, 30.0), (13, -1.0)):
        faults[f"number {place} times {factor}"] = number(place, factor), "observer, "
    faults["flux linkage negative"] = number(7, -1.0), "not positive"
    faults["inductances apart"] = number(5, 100.0), "rad/s: its matrix"
    for place in range(10):
        turn = stated("matrix", lambda held, k=place: [*held[:k], -held[k], *held[k + 1 :]])
        faults[f"entry {place}"] = turn, "observer, |its matrix"
    for name, value, words in (
        ("omega_e", lambda held: [held[0], 6.0 * held[1]], "its range is none"),
        ("omega_e", lambda held: [held[1], held[0]], "its range is none"),
        ("omega_e", lambda held: [-held[0], held[1]], "its range is none"),
        ("omega_e", lambda held: [1e-6, held[1]], "rad/s: its matrix"),
        ("i_q", lambda held: 1000.0 * held, "rad/s: its matrix"),
        ("i_q", lambda held: -held, "its range is none"),
        ("contraction", 1.0, "do not shrink"),
        ("contraction", 0.5, "rad/s: its matrix"),
        ("matrix", lambda held: held[1:], "as many entries"),
        ("matrix", "none", "as many entries"),
    ):
        faults[f"{name} as {words} {len(faults)}"] = stated(name, value), words
    for old, new, words in (
        ("l_q * i.alpha)", "l_q * i.beta)", "another d_flux_error"),
        ("+ (gains->pll.l_1 * error)", "- (gains->pll.l_1 * error)", "another d_flux_step"),
        ("- (x * turning.beta)", "+ (x * turning.beta)", "another d_flux_of_voltage"),
        ("l_q * current.q", "l_d * current.q", "another d_flux_of_current"),
        (
            "(x.beta * turn.cosine) - (x.alpha",
            "(x.beta * turn.cosine) + (x.alpha",
            "another d_park",
        ),
        ("known.alpha - drawn.alpha", "drawn.alpha - known.alpha", "another d_flux_step"),
        ("float alpha_0; ", "float alpha_2; ", "another d_flux_gains_t"),
        ("float half_drop;", "float other;", "another d_flux_path_t"),
        ("D_FLUX_GAINS = {", "D_FLUX_GAIN = {", "not one D_FLUX_GAINS"),
    ):
        faults[f"{old} {new}"] = texts(old, new), words
    return faults


@pytest.mark.parametrize("part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2))])
def test_planted_faults_are_found(
    part: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = sound()
    assert said(header, json.loads(certificate), tmp_path, capsys).startswith("confirmed: ")
    faults = planted()
    assert len(faults) >= 40
    missed = {}
    for name, (change, words) in list(faults.items())[part::3]:
        plain = json.loads(certificate)
        line = said(change(header, plain), plain, tmp_path, capsys)
        if not line.startswith("not confirmed: ") or not re.search(words, line):
            missed[name] = line
    assert missed == {}


@pytest.mark.slow
def test_a_design_has_its_certificate(tmp_path: Path) -> None:
    design = load("paper001-pmsm-bench")
    settings = ObserverSettings(method="flux")
    control = replace(design.control, observer=settings, speed_loop=None)
    solution = solve(replace(design, control=control, losses=None))
    files = emitted_files(solution)
    files |= certificate_files(solution, files)
    path = tmp_path / f"{solution.design.export.prefix}_observer.json"
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
    assert checker.main([str(path)]) == 0
    assert solution.observer_proof is not None
    assert solution.observer_proof.contraction is not None
    claimed = json.loads(path.read_text())["contraction"]
    assert 0.0 <= claimed - solution.observer_proof.contraction <= 1e-5
