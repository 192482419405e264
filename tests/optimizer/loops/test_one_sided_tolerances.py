"""Tolerances whose two sides differ: read, kept apart in corners and samples, and told."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.cli import main
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ToleranceName, Tolerances
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.robustness import SAMPLES, drive_box

NAMES: tuple[ToleranceName, ...] = get_args(ToleranceName)
TEXT = catalogue.read_text("paper001-pmsm-bench").decode()
DEAD_TIME = 2e-6
CURRENT = 0.8
SHARES = [
    ("0 %", "100 %", 0.0, 1.0),
    ("-30 %", "0 %", -0.3, 0.0),
    ("-10 %", "25 %", -0.1, 0.25),
    ("0", "0.5", 0.0, 0.5),
]


def text_with(line: str) -> bytes:
    """The bench with one tolerance."""
    text = TEXT.replace("control:\n", f"control:\n  tolerances: {{{line}}}\n", 1)
    if "dead_time:" not in text.split("inverter:")[1].split("control:")[0]:
        text = text.replace("inverter:\n", "inverter:\n  dead_time: 2 us\n", 1)
    assert "tolerances" in text
    return text.encode()


def bench(tolerances: Tolerances | None, *, speed: bool = False) -> Design:
    """The bench with tolerances, with or without its speed loop."""
    made = load_text(text_with("r_s: 1 %"), "f.yaml")
    loop = made.control.speed_loop if speed else None
    return replace(
        made, control=replace(made.control, tolerances=tolerances, speed_loop=loop, observer=None)
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("low", "high", "below", "above"), SHARES)
def test_every_key_can_have_two_sides(
    name: ToleranceName, low: str, high: str, below: float, above: float
) -> None:
    if name == "dead_time" and "%" not in low:
        low, high = "0", "50 %"
    made = load_text(text_with(f"{name}: {{from: {low}, to: {high}}}"), "f.yaml")
    tolerances = made.control.tolerances
    assert tolerances is not None
    scale = made.inverter.dead_time if name == "dead_time" else 1.0
    assert tolerances.limits(name) == pytest.approx((below * scale, above * scale), rel=1e-12)
    assert all(tolerances.limits(other) == (0.0, 0.0) for other in NAMES if other != name)
    given = {value.path: value.si for value in made.values if "tolerances" in value.path}
    assert given == {
        f"control.tolerances.{name}.from": pytest.approx(below),
        f"control.tolerances.{name}.to": pytest.approx(above),
    }


def test_a_dead_time_in_seconds_has_two_sides() -> None:
    for line, wanted in (
        ("from: 0, to: 0.5 us", (0.0, 5e-7)),
        ("from: -100 ns, to: 0.3 us", (-1e-7, 3e-7)),
    ):
        tolerances = load_text(text_with(f"dead_time: {{{line}}}"), "f.yaml").control.tolerances
        assert tolerances is not None
        assert tolerances.limits("dead_time") == pytest.approx(wanted, rel=1e-12)
        assert tolerances.low_current > 0.0


WRONG = [
    ("r_s: {from: 10 %, to: 30 %}", "leaves the data themselves out"),
    ("r_s: {from: -30 %, to: -10 %}", "leaves the data themselves out"),
    ("r_s: {from: -30 %}", "'to' is missing"),
    ("r_s: {to: 30 %}", "'from' is missing"),
    ("r_s: {from: -95 %, to: 30 %}", "outside -0.9 to 4"),
    ("r_s: {from: 0 %, to: 30 %, value: 3 %}", "unknown key 'value'"),
    ("r_s: {from: 0 A, to: 30 %}", "expected a plain number"),
    ("dead_time: {from: 0 %, to: 0.5 us}", "one side is a share and the other a time"),
    ("dead_time: {from: 0 %, to: 150 %}", "outside -100 % to 100 %"),
    ("dead_time: {from: -1, to: 50 %}", "expected a share"),
]


@pytest.mark.parametrize(("line", "phrase"), WRONG)
def test_what_is_no_deviation_is_refused_with_its_place(line: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        load_text(text_with(line), "f.yaml")
    assert phrase in caught.value.message
    assert (caught.value.line or 0) > 1
    assert (caught.value.column or 0) > 20


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("below", "above"), [(0.0, 0.2), (-0.2, 0.0), (-0.05, 0.2)])
def test_corners_and_samples_stay_within_their_sides(
    name: ToleranceName, below: float, above: float
) -> None:
    scale = 1e-6 if name == "dead_time" else 1.0
    sides = (below * scale, above * scale)
    keys: dict[str, Any] = {name: sides}
    tolerances = Tolerances(low_current=CURRENT, **keys)
    design = bench(tolerances, speed=True)
    nominal = (1.61e-3, 1.74e-3)
    box = drive_box(design, nominal, nominal)
    assert box.named_limits() == ((name, *sides),)
    for points in (
        box.current_points("i_d"),
        box.current_points("i_q"),
        box.turning_points(),
        box.speed_points(),
    ):
        if name not in points.names:
            continue
        values = points.of(name)
        np.testing.assert_allclose(np.unique(values[: points.corners]), sides, rtol=1e-12)
        inside = values[points.corners :]
        assert np.all((inside >= sides[0]) & (inside <= sides[1]))
        assert len(inside) % (SAMPLES + 1) == 0
        assert np.ptp(inside) > 0.9 * (sides[1] - sides[0])
    assert any(name in points.names for points in (box.turning_points(), box.speed_points()))


def test_no_compensation_at_all_is_a_box_without_the_corner_compensated_twice() -> None:
    """Resistance from R to R + 4 f_sw t V_dc/(pi I), by the voltage against sinusoidal currents."""
    design = bench(Tolerances(dead_time=(0.0, DEAD_TIME), low_current=CURRENT))
    nominal = (1.61e-3, 1.74e-3)
    box = drive_box(design, nominal, nominal)
    points = box.current_points("i_q")
    theta = np.linspace(0.0, 2.0 * np.pi, 36_000, endpoint=False)
    volts = design.inverter.f_sw * DEAD_TIME * design.inverter.v_dc * np.sign(np.cos(theta))
    added = 2.0 * float(np.mean(volts * np.cos(theta))) / CURRENT
    found: NDArray[np.float64] = box.resistance(points)[: points.corners]
    r_s = design.machine.r_s
    np.testing.assert_allclose(np.sort(found), [r_s, r_s + added], rtol=1e-6)


@pytest.mark.slow
def test_the_loops_that_both_ways_refuse_hold_one_way() -> None:
    # 4 f_sw t V_dc/(pi I) of 2 us at 0.1 A is some 20 Ohm: compensated twice,
    # a loop of a few V/A runs away.
    low = 0.1
    with pytest.raises(NoSolutionError, match=r"dead_time -"):
        solve_gains(bench(Tolerances(dead_time=DEAD_TIME, low_current=low)))
    robust = solve_gains(bench(Tolerances(dead_time=(0.0, DEAD_TIME), low_current=low))).robust
    assert robust is not None
    assert robust.i_q.radius.value < 1.0
    assert robust.limits == (("dead_time", 0.0, DEAD_TIME),)


@pytest.mark.parametrize("speed", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_pair_of_equal_sides_is_the_value_itself(speed: bool) -> None:
    inertia = 0.3 if speed else 0.0
    l_q = 0.1 if speed else 0.0
    one = Tolerances(r_s=0.2, l_q=l_q, inertia=inertia)
    pair = Tolerances(r_s=(-0.2, 0.2), l_q=(-l_q, l_q), inertia=(-inertia, inertia))
    both, sides = (solve_gains(bench(sides, speed=speed)).robust for sides in (one, pair))
    assert both is not None
    assert sides is not None
    assert both.proof is not None
    assert sides.proof is not None
    assert replace(both, proof=None) == replace(sides, proof=None)
    assert both.proof.box == sides.proof.box


@pytest.mark.slow
def test_margins_of_a_one_sided_box_are_those_of_single_drives() -> None:
    of_r, of_v = (0.0, 0.5), (-0.2, 0.05)
    robust = solve_gains(bench(Tolerances(r_s=of_r, v_dc=of_v))).robust
    assert robust is not None
    corners = []
    for r_s, v_dc in itertools.product(of_r, of_v):
        one = solve_gains(bench(Tolerances(r_s=_to(r_s), v_dc=_to(v_dc)))).robust
        assert one is not None
        corners.append(one.i_q.phase_margin.value)
    # Boxes that end at a corner contain it and the data; the least over all of them
    # is that of the whole box.
    assert robust.i_q.phase_margin.value == pytest.approx(min(corners), rel=1e-12)


def _to(side: float) -> tuple[float, float]:
    return (min(side, 0.0), max(side, 0.0))


@pytest.mark.slow
def test_the_box_is_told_on_the_terminal_and_in_the_json(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path_factory.mktemp("box") / "design.yaml"
    path.write_bytes(
        text_with(
            "dead_time: {from: 0 %, to: 100 %}, r_s: {from: -10 %, to: 30 %}, low_current: 3 A"
        )
    )
    with pytest.raises(SystemExit) as caught:
        main(["tune", str(path)])
    assert caught.value.code == 0
    shown = capsys.readouterr().out
    assert "r_s -10 to +30 %, dead_time 0 to +" in " ".join(shown.split())
    with pytest.raises(SystemExit):
        main(["tune", str(path), "--json"])
    limits = json.loads(capsys.readouterr().out)["gains"]["tolerances"]["limits"]
    assert limits["r_s"] == pytest.approx([-0.1, 0.3])
    assert limits["dead_time_s"][0] == 0.0
