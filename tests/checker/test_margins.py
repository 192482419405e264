"""Margins that the header states of its loops are confirmed, and worse ones are found."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from typing import Any

import numpy as np
import pytest
from drawn_machines import factors
from drives import INVERSE_SALIENT, IPM, SURFACE, make_design

from dqforge.checker import check_speed, kit, margins
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import certificate_files

Plain = dict[str, Any]


@cache
def sound(number: int = 0, observed: bool = False) -> tuple[GainSet, str, Plain]:
    """Loops, header and claim of a design; those after the first are drawn."""
    random = np.random.default_rng(number)
    base = (INVERSE_SALIENT, IPM, SURFACE)[number % 3]
    inductances = {"l_d": base.l_d, "l_q": base.l_q}
    if number:
        drawn = factors(3, 0.4, random)
        inductances = {"l_d": base.l_d * drawn[0], "l_q": base.l_q * drawn[0]}
        base = replace(base, r_s=base.r_s * float(drawn[1]), inertia=3e-3 * float(drawn[2]))
    machine = LinearMachine(
        base.pole_pairs,
        r_s=base.r_s,
        psi_pm=base.psi_pm,
        i_max=base.i_max,
        inertia=base.inertia,
        **{name: float(value) for name, value in inductances.items()},
    )
    design = make_design(machine)
    if not observed:
        design = replace(design, control=replace(design.control, observer=None))
    solution = solve(replace(design, losses=None))
    files = emitted_files(solution)
    certificate = json.loads(certificate_files(solution, files)["drive_certificate.json"])
    assert solution.loops is not None
    (claim,) = (each for each in certificate["claims"] if each["name"] == "margins")
    return solution.loops, files["drive.h"].decode("ascii"), claim


def said(header: str, claim: Plain) -> list[str]:
    """What is confirmed, or the fault."""
    stated = kit.plain(json.dumps(claim))
    try:
        return list(margins.check_margins(stated, kit.Header(header, "drive"), ""))
    except kit.Fault as fault:
        return [f"fault: {fault}"]


@pytest.mark.parametrize(
    "number", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 13))]
)
def test_all_loops_are_confirmed_on_the_poles_of_other_code(number: int) -> None:
    loops, header, claim = sound(number)
    lines = said(header, claim)
    assert [line.split(":")[0] for line in lines] == ["i_d", "i_q", check_speed.SPEED]
    read = kit.Header(header, "drive")
    found = [margins.current_loop(read, axis) for axis in "dq"]
    found.append(margins.speed_loop(read, kit.plain(json.dumps(claim["speed"])), "")[0])
    assert loops.speed is not None
    for own, other in zip(found, (loops.i_d, loops.i_q, loops.speed), strict=True):
        poles = np.sort_complex(np.roots([float(x) for x in own.closed[::-1]]))
        expected = np.sort_complex(np.asarray(other.poles))
        np.testing.assert_allclose(np.prod(1.2 - poles), np.prod(1.2 - expected), rtol=1e-6)
        assert np.abs(poles).max() == pytest.approx(np.abs(expected).max(), abs=1e-6)


def test_polynomials_on_the_circle() -> None:
    random = np.random.default_rng(1)
    for _ in range(20):
        a, b = ([Fraction(x) for x in random.normal(size=n)] for n in (6, 4))
        z = np.exp(1j * random.uniform(-np.pi, np.pi))
        value = np.polyval([float(x) for x in a[::-1]], z)
        value *= np.conj(np.polyval([float(x) for x in b[::-1]], z))
        r, q = ([float(x) for x in each[::-1]] for each in margins.on_circle(a, b))
        assert np.polyval(r, z.real) == pytest.approx(value.real)
        assert z.imag * np.polyval(q, z.real) == pytest.approx(value.imag)
        largest = np.abs(np.roots([float(x) for x in a[::-1]])).max()
        for radius, within in ((largest * 1.001, True), (largest * 0.999, False)):
            scaled = [x * Fraction(radius) ** i for i, x in enumerate(a)]
            assert margins.inside(scaled) is within


def shown(pattern: str, change: Callable[[float], float]) -> Callable[[str, int], str]:
    """Another number where a header states one, of the loop with a number."""

    def made(header: str, loop: int) -> str:
        place = [found.span(1) for found in re.finditer(pattern, header)][loop]
        text = header[slice(*place)].rstrip(".")
        digits = len(text.partition(".")[2])
        new = f"{change(float(text)):.{digits}f}"
        assert new != text
        return header[: place[0]] + new + header[place[0] + len(text) :]

    return made


FAULTS = {
    "phase": shown(r", phase margin ([\d.]+) deg", lambda x: x + 0.2),
    "gain": shown(r", gain margin ([\d.]+) dB", lambda x: x + 0.2),
    "pole": shown(r"largest pole ([\d.]+)", lambda x: x - 2e-6),
    "M_s": shown(r", M_s ([\d.]+)", lambda x: x - 0.02),
    "gain of the controller": shown(r"_KP_[VN]\w+ \(([\d.]+)F", lambda x: x * 1.05),
    "gain of the integral": shown(r"_KI_TS_[VN]\w+ \(([\d.]+)F", lambda x: x * 0.5),
}


@pytest.mark.parametrize("loop", [0, 1, 2])
@pytest.mark.parametrize("name", FAULTS)
def test_planted_faults_are_found(name: str, loop: int) -> None:
    _, header, claim = sound()
    places = {0: "i_d", 1: "i_q", 2: "the speed|inputs, "}
    (line,) = said(FAULTS[name](header, loop), claim)[-1:]
    assert re.match(rf"fault: ({places[loop]}|inputs, k)", line)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("r_s", [9.0, 9.0], "another R_S_OHM"),
        ("inertia", [0.7 * float(INVERSE_SALIENT.inertia or 0.0)] * 2, "the speed"),
        ("gain", [1.1, 1.1], "without deviations"),
        ("torque", [0.9, 1.1], "without deviations"),
        ("back_emf", [0.1, 0.1], "without deviations"),
        ("ratio", 3, "another SPEED_RATIO"),
        ("speed_scale", 1e6, "units"),
        ("filter_time", 0.01, "the speed"),
    ],
)
def test_another_drive_is_not_confirmed(name: str, value: Any, words: str) -> None:
    _, header, claim = sound()
    (line,) = said(header, claim | {"speed": claim["speed"] | {name: value}})[-1:]
    assert line.startswith("fault: ")
    assert words in line


OBSERVED = 5  # of the drawn designs


@pytest.mark.parametrize("number", [0, OBSERVED])
def test_the_speed_observer_is_that_of_the_machine(number: int) -> None:
    loops, header, claim = sound(number, observed=True)
    *_, line = said(header, claim)
    assert loops.observer is not None
    assert line.startswith(f"errors of the speed observer shrink to {loops.observer.a:.6g} of ")


@pytest.mark.parametrize("name", ["A", "C_RAD_PER_AS", "B_I_RAD_PER_AS", "B_U_RAD_PER_VS"])
@pytest.mark.parametrize("factor", [1.01, -1.0])
def test_another_observer_is_not_confirmed(name: str, factor: float) -> None:
    _, header, claim = sound(observed=True)
    (value,) = re.findall(rf"OBSERVER_{name} \((\S+)F\)", header)
    changed = header.replace(
        f"OBSERVER_{name} ({value}F)", f"OBSERVER_{name} ({float(value) * factor:.9g}F)"
    )
    (line,) = said(changed, claim | {"axes": []})[-1:]
    assert line.startswith("fault: speed observer: ")


@pytest.mark.parametrize(
    ("name", "value"), [("inertia", 0.9e-3), ("inertia", -1.0), ("friction", 1.0)]
)
def test_an_observer_of_another_shaft_is_not_confirmed(name: str, value: float) -> None:
    _, header, claim = sound(observed=True)
    shaft = claim["observer"] | {name: value}
    (line,) = said(header, claim | {"axes": [], "observer": shaft})[-1:]
    assert line.startswith("fault: speed observer: ")
