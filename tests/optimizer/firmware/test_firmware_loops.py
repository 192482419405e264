"""Gains chosen within the structure of a firmware: what is asked where it holds, else the fastest
that does, and refusals that say what would hold.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache

import pytest
from toy_firmware import rounded, toy_method

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import FirmwareSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.firmware.firmware_method import FirmwareMethod, FreeGains, judge
from dqforge.optimizer.firmware.gain_search import FirmwareLoop, FirmwareLoops, firmware_loops
from dqforge.optimizer.loops.integer_gains import inductance_range
from dqforge.optimizer.loops.robustness import drive_box

DRIVE = """\
dqforge: 1
name: hub
machine:
  model: linear
  pole_pairs: 15
  resistance: {value: 100 mOhm, kind: line-to-line}
  inductance_d: {value: 200 uH, kind: line-to-line}
  inductance_q: {value: INDUCTANCE_Q, kind: line-to-line}
  back_emf_constant: {value: 60 rpm/V, kind: line-to-line peak}
  max_current: {value: 40 A, kind: rms}
  inertia: 0.002 kg m^2
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control:
  current_loop: {CURRENT}
  speed_loop: {ratio: 20, SPEED}
"""
THOUSAND, THIRTY = "method: bandwidth, bandwidth: 1000 Hz", "method: bandwidth, bandwidth: 30 Hz"
BOX = "  tolerances: {r_s: 30 %, l_d: 20 %, l_q: 20 %, inertia: 20 %}\n"
SLOW_PLL = (2000.0, 30000.0)


@cache
def own_gains(text: str) -> GainSet:
    """Gains of a design's own structure, found once."""
    return solve_gains(load_text(text.encode(), "hub"))


def design(current: str, speed: str, l_q: str = "200 uH") -> str:
    return DRIVE.replace("CURRENT", current).replace("SPEED", speed).replace("INDUCTANCE_Q", l_q)


def solve(
    text: str, method: FirmwareMethod, pll: tuple[float, float] | None = None, more: str = ""
) -> tuple[GainSet, FirmwareLoops]:
    """The design's own gains, and what the firmware makes of them, within what ``more`` says."""
    gains, found = own_gains(text), load_text((text + more).encode(), "hub")
    named = replace(found, control=replace(found.control, firmware=FirmwareSettings("vesc", pll)))
    box = drive_box(named, *inductance_range(found.machine, found.i_max))
    loops = firmware_loops(named, box, (gains.i_d, gains.i_q, gains.speed), {"vesc": method})
    assert loops is not None
    return gains, loops


def advised(message: str) -> float:
    """The bandwidth in rad/s that a refusal names."""
    found = re.search(r"bandwidth = ([0-9.]+) rad/s", message)
    assert found is not None
    return float(found[1])


def loop_of(found: FirmwareLoops, name: str) -> FirmwareLoop:
    return next(loop for loop in found.loops if loop.loop == name)


def test_what_holds_in_the_structure_is_taken_as_it_is() -> None:
    gains, found = solve(design(THOUSAND, THIRTY), toy_method(pll=None))
    assert gains.speed is not None
    constant = 1.5 * 15 * 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * 15 * 60.0)
    assert found.changes == ()
    assert loop_of(found, "i_q").gains.kp == rounded(gains.i_q.kp)
    assert loop_of(found, "speed").gains.kp == rounded(gains.speed.kp / constant)
    assert loop_of(found, "speed").own.kp == gains.speed.kp
    assert loop_of(found, "i_d").neutral.phase_margin == pytest.approx(gains.i_d.phase_margin)
    # The same structure but for the rule of the speed controller: nearly the same margins.
    assert loop_of(found, "i_d").judged.phase_margin == pytest.approx(
        gains.i_d.phase_margin, abs=1e-5
    )
    assert loop_of(found, "speed").judged.phase_margin == pytest.approx(
        gains.speed.phase_margin, abs=0.03
    )


def test_without_the_key_nothing_is_judged() -> None:
    assert own_gains(design(THOUSAND, THIRTY)).firmware is None


def test_a_phase_locked_loop_that_is_too_slow_is_set_faster() -> None:
    _, found = solve(design(THOUSAND, THIRTY), toy_method(pll=SLOW_PLL))
    assert found.profile.speed is not None
    feedback = found.profile.speed.feedback
    assert (feedback.kp, feedback.ki) == (2000.0, 1e6)
    assert (
        "the PLL gets kp 2000 and ki 1e+06: with its own gains the speed loop is unstable"
        in (found.changes[0])
    )
    assert loop_of(found, "speed").judged.phase_margin > math.radians(45.0)


def test_a_given_phase_locked_loop_is_judged_as_it_is_given() -> None:
    with pytest.raises(NoSolutionError) as caught:
        solve(design(THOUSAND, THIRTY), toy_method(), SLOW_PLL)
    message = str(caught.value)
    assert message.startswith(
        "control.speed_loop: as vesc toy runs it with a PLL of 2000/30000, the speed loop by "
        "method 'bandwidth' is unstable"
    )
    assert "write pll_ki: 1e+06 (kp^2/4)" in message
    limit = advised(message)
    # What is advised holds, and a little more does not.
    _, found = solve(
        design(THOUSAND, f"method: bandwidth, bandwidth: {limit} rad/s"), toy_method(), SLOW_PLL
    )
    assert loop_of(found, "speed").judged.phase_margin >= math.radians(30.0)
    with pytest.raises(NoSolutionError):
        solve(
            design(THOUSAND, f"method: bandwidth, bandwidth: {1.02 * limit} rad/s"),
            toy_method(),
            SLOW_PLL,
        )


def test_a_named_bandwidth_that_does_not_hold_is_refused_with_one_that_does() -> None:
    with pytest.raises(NoSolutionError) as caught:
        solve(design("method: bandwidth, bandwidth: 1500 Hz", THIRTY), toy_method(delay=2.0))
    message = str(caught.value)
    assert (
        "control.current_loop: as vesc toy runs it, by method 'bandwidth' the i_d loop" in message
    )
    limit = advised(message)
    _, found = solve(
        design(f"method: bandwidth, bandwidth: {limit} rad/s", THIRTY), toy_method(delay=2.0)
    )
    assert math.degrees(loop_of(found, "i_q").judged.phase_margin) == pytest.approx(30.0, abs=0.3)


def test_a_formula_without_a_number_is_slowed_down() -> None:
    found_design = design("method: magnitude-optimum", THIRTY)
    gains, found = solve(found_design, toy_method(delay=2.0, filter_time=1e-4))
    loop = loop_of(found, "i_q")
    assert found.changes[0].startswith("slowed down: the current loops, to 0.85")
    assert loop.gains.kp < 0.9 * gains.i_q.kp
    assert math.degrees(loop.judged.phase_margin) == pytest.approx(30.0, abs=0.1)


@pytest.mark.thinned
@pytest.mark.parametrize("free", ["axes", "one-pair", "bandwidth"])
def test_optimised_gains_use_the_bound_and_no_more(free: FreeGains) -> None:
    method = toy_method(free, delay=0.5, rule="trapezoid", pll=None)
    _, found = solve(design("method: optimised", "method: optimised", l_q="240 uH"), method)
    largest = max(loop_of(found, axis).judged.max_sensitivity for axis in ("i_d", "i_q"))
    assert 1.59 < largest <= 1.6 + 1e-9
    assert 1.59 < loop_of(found, "speed").judged.max_sensitivity <= 1.6 + 1e-9
    d, q = loop_of(found, "i_d").gains, loop_of(found, "i_q").gains
    if free == "one-pair":
        assert d == q
    elif free == "bandwidth":
        assert q.kp / d.kp == pytest.approx(1.2, rel=1e-5)
        assert q.ki == d.ki
    else:
        assert q.kp / d.kp == pytest.approx(1.2, rel=1e-2)


def test_optimised_gains_beat_those_of_the_header_where_the_firmware_is_quicker() -> None:
    gains, found = solve(design("method: optimised", THIRTY), toy_method(delay=0.5, pll=None))
    assert loop_of(found, "i_q").gains.ki > 1.3 * gains.i_q.ki


def test_every_corner_of_the_tolerances_keeps_what_is_asked() -> None:
    method = toy_method("one-pair", delay=1.5, pll=(4000.0, 4e6))
    _, found = solve(design("method: optimised", "method: optimised"), method, (4000.0, 4e6), BOX)
    for loop in found.loops:
        assert loop.worst is not None
        assert loop.worst.max_sensitivity.value <= 1.6 + 1e-9
        assert loop.worst.max_sensitivity.value > loop.judged.max_sensitivity
        assert loop.worst.phase_margin.value >= math.radians(30.0)
    # The worst corner is that of the loop itself on that machine.
    speed = loop_of(found, "speed")
    assert speed.worst is not None
    assert "inertia -20 %" in speed.worst.max_sensitivity.at
    shares = dict(part.rsplit(" ", 2)[:2] for part in speed.worst.max_sensitivity.at.split(", "))
    values = found.asked.drive
    there = replace(
        values,
        r_s=(values.r_s or 0.0) * (1.0 + 0.01 * float(shares["r_s"])),
        l_q=(values.l_q or 0.0) * (1.0 + 0.01 * float(shares["l_q"])),
        inertia=(values.inertia or 0.0) * (1.0 + 0.01 * float(shares["inertia"])),
    )
    again = judge(found.profile, there).speed
    assert again is not None
    assert again.max_sensitivity == pytest.approx(speed.worst.max_sensitivity.value, rel=1e-5)


@pytest.mark.slow
def test_the_same_question_has_the_same_answer() -> None:
    drive, method = design("method: optimised", "method: optimised"), toy_method("bandwidth")
    one, two = (solve(drive, method, (4000.0, 4e6))[1] for _ in range(2))
    assert one.configuration == two.configuration


def test_a_firmware_without_a_speed_controller_says_so() -> None:
    method = toy_method()
    silent = replace(method, profile=lambda found: replace(method.profile(found), speed=None))
    _, found = solve(design(THOUSAND, THIRTY), silent)
    assert [loop.loop for loop in found.loops] == ["i_d", "i_q"]
    assert found.changes == ("vesc toy has no such speed controller: none is evaluated",)


def test_an_unknown_firmware_and_gains_out_of_range_are_refused() -> None:
    with pytest.raises(InputError, match="pll_ki: too large"):
        solve(design(THOUSAND, THIRTY), toy_method(), (1e5, 1e9))
    text = design(THOUSAND, THIRTY)
    found, gains = load_text(text.encode(), "hub"), own_gains(text)
    named = replace(found, control=replace(found.control, firmware=FirmwareSettings("st")))
    box = drive_box(named, *inductance_range(found.machine, found.i_max))
    with pytest.raises(InputError, match=r"control\.firmware"):
        firmware_loops(named, box, (gains.i_d, gains.i_q, gains.speed), {"vesc": toy_method()})
