"""Profiles, and the section ``simulation`` of a design file with its faults."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import Drift, Profile, Scenario, constant

BASE = """\
dqforge: 1
name: Bench motor
machine:
  pole_pairs: 3
  resistance: 2.35 Ohm
  inductance_d: 1.61 mH
  inductance_q: 1.74 mH
  magnet_flux: 0.06 Wb
  max_current: 6.4 A
  inertia: 200e-6 kg m^2
inverter:
  v_dc: 180 V
  switching_frequency: 5 kHz
control:
  speed_loop: {ratio: 10}
simulation:
"""


def read(*lines: str, base: str = BASE) -> Scenario:
    text = base + "".join(f"  {line}\n" for line in lines)
    scenario = load_text(text.encode(), "drive.yaml").simulation
    assert scenario is not None
    return scenario


def test_profiles_hold_join_and_swing() -> None:
    time = np.array([-1.0, 0.5, 1.0, 1.5, 2.0, 3.0])
    np.testing.assert_array_equal(
        Profile((0.5, 2.0), (1.0, 4.0)).at(time), [1.0, 1.0, 1.0, 1.0, 4.0, 4.0]
    )
    np.testing.assert_allclose(
        Profile((0.5, 2.0), (1.0, 4.0), "linear").at(time), [1.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    )
    sine = Profile(amplitude=2.0, frequency=0.25)
    np.testing.assert_allclose(sine.at(np.array([0.0, 1.0, 3.0])), [0.0, 2.0, -2.0], atol=1e-12)
    assert sine.largest == 2.0
    np.testing.assert_allclose(
        Profile((0.0,), (1.0,), amplitude=2.0, frequency=1.0).scaled(3.0).at(np.array(0.25)), 9.0
    )
    for times, values in (
        ((), ()),
        ((0.0, 0.0), (1.0, 2.0)),
        ((0.0,), (math.nan,)),
        ((0.0,), (1.0, 2.0)),
    ):
        with pytest.raises(InputError):
            Profile(times, values)


def test_without_a_section_there_is_no_simulation() -> None:
    assert load_text(BASE.replace("simulation:\n", "").encode(), "drive.yaml").simulation is None


def test_everything_is_read_in_si_units() -> None:
    scenario = read(
        "duration: 400 ms",
        "speed: {points: [{time: 0 s, speed: 0 rpm}, {time: 0.1 s, speed: 1200 rpm}], shape: "
        "linear, amplitude: 60 rpm, frequency: 2 Hz}",
        "load: {points: [{time: 0.2 s, torque: 0.3 N m}]}",
        "v_dc: {amplitude: 5 V, frequency: 300 Hz}",
        "inverter: switched",
        "dead_time: 2 us",
        "encoder: {lines: 1024, speed: exact, misalignment: 3 deg}",
        "current_sensor: {bits: 12, full_scale: 10 A, noise: 5 mA, offset: [10 mA, 0 A, -20 mA],"
        " gain_error: [1 %, 0, 0]}",
        (
            "errors: {resistance: 20 %, inductance_q: -10 %, magnet_flux: 2 %, inertia: 0.5, v_dc: "
            "-5 %}"
        ),
        "initial: {speed: -300 rpm, angle: 90 deg}",
        "seed: 7",
        "steps: 12",
    )
    turn = 2.0 * math.pi / 60.0
    assert scenario.duration == 0.4
    assert scenario.mode == "speed"
    assert scenario.reference.values == pytest.approx((0.0, 1200.0 * turn))
    assert (scenario.reference.shape, scenario.reference.frequency) == ("linear", 2.0)
    assert scenario.reference.amplitude == pytest.approx(60.0 * turn)
    assert (scenario.load.times, scenario.load.values) == ((0.2,), (0.3,))
    assert scenario.v_dc == Profile((0.0,), (180.0,), amplitude=5.0, frequency=300.0)
    assert (scenario.inverter, scenario.dead_time, scenario.shaft) == ("switched", 2e-6, None)
    assert scenario.encoder.lines == 1024
    assert scenario.encoder.misalignment == pytest.approx(math.radians(3.0))
    assert scenario.sensor.offset == (0.01, 0.0, -0.02)
    assert scenario.sensor.gain_error == (0.01, 0.0, 0.0)
    assert (scenario.errors.r_s, scenario.errors.l_d, scenario.errors.l_q) == (0.2, 0.0, -0.1)
    assert (scenario.errors.psi_pm, scenario.errors.inertia, scenario.errors.v_dc) == (
        0.02,
        0.5,
        -0.05,
    )
    assert scenario.omega_m == pytest.approx(-300.0 * turn)
    assert (scenario.seed, scenario.sub_steps) == (7, 12)


def test_a_load_that_is_there_before_its_first_point_is_remarked_on() -> None:
    """Whoever writes one point at 0.2 s means a step from nothing, which it is not."""
    remark = (
        "simulation.load is 0.3 N m from the start on, since its first point holds before 200 ms "
        "too; begin with {time: 0 s, ...} for another value until then"
    )
    lines = "  duration: 1 s\n  speed: {points: [{time: 0.1 s, speed: 0 rpm}]}\n  load: "
    for load, expected in (
        ("{points: [{time: 200 ms, torque: 0.3 N m}]}", [remark]),
        ("{points: [{time: 0 s, torque: 0 N m}, {time: 200 ms, torque: 0.3 N m}]}", []),
        ("{points: [{time: 0 s, torque: 0.3 N m}]}", []),
    ):
        design = load_text(f"{BASE}{lines}{load}\n".encode(), "drive.yaml")
        assert [line for line in design.assumptions if "simulation" in line] == expected


def test_control_without_encoder_has_a_band() -> None:
    base = BASE.replace(
        "  speed_loop: {ratio: 10}\n", "  speed_loop: {ratio: 10}\n  observer: {method: flux}\n"
    )
    turn = math.pi / 30.0
    both = read(
        "duration: 1 s", SPEED, "sensorless: {above: 300 rpm, below: 200 rpm}", base=base
    ).sensorless
    assert both is not None
    assert (both.above, both.below) == pytest.approx((300.0 * turn, 200.0 * turn))
    usual = read("duration: 1 s", SPEED, "sensorless: {above: 300 rpm}", base=base).sensorless
    assert usual is not None
    assert (usual.above, usual.below) == pytest.approx((300.0 * turn, 240.0 * turn))
    assert read("duration: 1 s", SPEED, base=base).sensorless is None
    for entry, column, phrase in (
        ("{above: -300 rpm}", 23, "is negative"),
        ("{above: 300 rpm, below: 301 rpm}", 39, "exceeds above = 300 rpm"),
        ("{below: 300 rpm}", 3, "needs the key 'above'"),
        ("{above: 0,3 rad/s}", 25, "'0,3 rad/s' has a decimal comma; write 0.3 rad/s"),
    ):
        with pytest.raises(InputError) as caught:
            read("duration: 1 s", SPEED, f"sensorless: {entry}", base=base)
        assert phrase in caught.value.message
        assert (caught.value.line, caught.value.column) == (20, column)


def test_currents_and_torques_are_references_too() -> None:
    currents = read(
        "duration: 1 s", "current: {points: [{time: 0 s, i_d: -1 A, i_q: 2 A}]}", "shaft: {}"
    )
    assert (currents.mode, currents.reference, currents.reference_d) == (
        "current",
        constant(2.0),
        constant(-1.0),
    )
    assert currents.shaft == constant(0.0)
    assert read(
        "duration: 1 s", "torque: {points: [{time: 0 s, torque: -0.2 N m}]}"
    ).reference == constant(-0.2)


@pytest.mark.parametrize(
    ("key", "value", "long"),
    [
        ("speed", "750 rpm", "speed"),
        ("torque", "-0.2 N m", "torque"),
        ("load", "0.1 N m", "torque"),
        ("shaft", "200 rad/s", "speed"),
        ("v_dc", "200 V", "voltage"),
    ],
)
def test_a_value_alone_is_a_profile_that_stays(key: str, value: str, long: str) -> None:
    rest = () if key in ("speed", "torque") else (SPEED,)
    short = read("duration: 1 s", *rest, f"{key}: {value}")
    assert short == read(
        "duration: 1 s", *rest, f"{key}: {{points: [{{time: 0 s, {long}: {value}}}]}}"
    )
    with pytest.raises(InputError, match="expected a") as caught:
        read("duration: 1 s", *rest, f"{key}: 3 kg")
    assert caught.value.line == 18 + len(rest)


SPEED = "speed: {points: [{time: 0 s, speed: 1000 rpm}]}"


@pytest.mark.parametrize(
    ("lines", "line", "column", "phrase"),
    [
        (("speed: {}",), 16, 1, "needs the key 'duration'"),
        (("duration: 1 s",), 16, 1, "needs one of speed, torque and current as its reference, none is given"),
        (("duration: 1 s", SPEED, "torque: {}"), 16, 1, "speed and torque are given"),
        (("duration: -1 s", SPEED), 17, 13, "must be positive"),
        (("duration: 1 kg", SPEED), 17, 13, "expected a time"),
        (("duration: 9999 s", SPEED), 17, 13, "more than 10000000 samples"),
        (("duration: 1 s", "speed: {points: []}"), 18, 19, "at least 1"),
        (("duration: 1 s", "speed:", "  points:", "    - {time: 1 s, speed: 0 rpm}", "    - {time: 1 s, speed: 9 rpm}"),
         21, 16, "does not lie after 1 s"),
        (("duration: 1 s", "speed: {amplitude: 60 rpm}"), 18, 3, "amplitude and frequency belong together"),
        (("duration: 1 s", SPEED, "inverter: switchd"), 19, 13, "did you mean 'switched'"),
        (("duration: 1 s", SPEED, "encoder: {speed: observer}"), 19, 20, "needs control.observer"),
        (("duration: 1 s", SPEED, "sensorless: {above: 1 rpm}"), 19, 3, "needs an observer of the position"),
        (("duration: 1 s", SPEED, "encoder: {lines: yes}"), 19, 20, "whole number"),
        (("duration: 1 s", SPEED, "current_sensor: {bits: 12}"), 19, 26, "bits need full_scale"),
        (("duration: 1 s", SPEED, "current_sensor: {offset: [1 mA]}"), 19, 28, "at least 3"),
        (("duration: 1 s", SPEED, "errors: {resistance: 30}"), 19, 24, "outside"),
        (("duration: 1 s", SPEED, "laod: {}"), 19, 3, "did you mean 'load'"),
        (("duration: 1 s", SPEED, "seed: -1"), 19, 9, "at least 0"),
    ],
)  # fmt: skip
def test_faults_are_named_with_their_place(
    lines: tuple[str, ...], line: int, column: int, phrase: str
) -> None:
    with pytest.raises(InputError) as caught:
        read(*lines)
    assert phrase in caught.value.message
    assert (caught.value.line, caught.value.column) == (line, column)


@pytest.mark.parametrize(
    ("old", "new", "lines", "phrase"),
    [
        (
            "  speed_loop: {ratio: 10}\n",
            "  current_loop: {}\n",
            (SPEED,),
            "needs control.speed_loop",
        ),
        ("  inertia: 200e-6 kg m^2\n", "", ("torque: {}",), "needs machine.inertia"),
        (
            "control:\n",
            "control:\n  sampling_frequency: 7 kHz\n",
            (SPEED, "inverter: switched"),
            "one or two times",
        ),
    ],
)
def test_what_the_rest_of_the_design_lacks(
    old: str, new: str, lines: tuple[str, ...], phrase: str
) -> None:
    assert BASE.count(old) == 1
    base = BASE.replace(old, new)
    if "inertia" in old:
        base = base.replace("  speed_loop: {ratio: 10}\n", "  current_loop: {}\n")
    with pytest.raises(InputError, match=phrase) as caught:
        read("duration: 1 s", *lines, base=base)
    assert caught.value.line is not None


def test_a_drift_is_a_line_between_its_instants() -> None:
    drift = Drift(0.2, 0.6, r_s=0.3)
    found = drift.share(np.array([[-1.0, 0.0, 0.2], [0.3, 0.5, 0.6], [0.7, 9.0, 0.4]]))
    expected = [[0.0, 0.0, 0.0], [0.25, 0.75, 1.0], [1.0, 1.0, 0.5]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    Drift(0.0, 1e-9)
    for begin, end in ((0.6, 0.6), (-1e-9, 1.0), (0.1, np.inf), (0.3, 0.2)):
        with pytest.raises(InputError, match="write a later end"):
            Drift(begin, end)
