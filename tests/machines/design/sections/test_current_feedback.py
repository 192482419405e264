"""Keys of current-feedback PWM, and what does not go with it."""

from __future__ import annotations

import math

import pytest
from current_feedback_design import feedback_design

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError

LOOP = "control.current_loop"


def test_keys_are_read() -> None:
    loop = feedback_design(
        "look-up-table", f"{LOOP}.band=1.5 A", f"{LOOP}.outer_band=3 A", f"{LOOP}.sampling=50 kHz"
    ).control.current_loop
    assert loop.switches
    assert (loop.band, loop.outer_band, loop.sampling) == (1.5, 3.0, 50e3)
    ramp = feedback_design(
        "ramp-comparison",
        f"{LOOP}.kp=3 V/A",
        f"{LOOP}.ki=100 V/(A s)",
        f"{LOOP}.carrier=5 kHz",
        f"{LOOP}.comparator_band=2 V",
    ).control.current_loop
    assert (ramp.kp, ramp.ki, ramp.carrier, ramp.comparator_band) == (3.0, 100.0, 5e3, 2.0)
    for volts in (0.0, 0.5):
        loop = feedback_design(
            "ramp-comparison", f"{LOOP}.comparator_band={volts} V"
        ).control.current_loop
        assert loop.comparator_band == volts
    assert feedback_design("trajectory", f"{LOOP}.pulses=9").control.current_loop.pulses == 9
    assert not catalogue.load("paper001-pmsm-bench").control.current_loop.switches


@pytest.mark.parametrize(
    ("method", "setting", "words"),
    [
        ("magnitude-optimum", f"{LOOP}.band=1 A", "write method: hysteresis or look-up-table"),
        ("magnitude-optimum", f"{LOOP}.carrier=5 kHz", "write method: ramp-comparison"),
        ("hysteresis", f"{LOOP}.carrier=5 kHz", "does not use 'carrier'"),
        ("circle", f"{LOOP}.min_phase_margin=20 deg", "does not use 'min_phase_margin'"),
        ("predictive", f"{LOOP}.band=1 A", "does not use 'band'"),
        ("hysteresis", f"{LOOP}.kp=1 V/A", "does not use 'kp'"),
        ("trajectory", f"{LOOP}.pulses=8", "write 7 or 9"),
        ("circle", f"{LOOP}.sampling=5 kHz", "too slow to switch by"),
        ("hysteresis", "control.observer.method=flux", "control.observer needs PI current loops"),
        ("hysteresis", "control.tolerances.r_s=10 %", "control.tolerances needs PI current loops"),
        ("hysteresis", "export.control=q15", "write float32, which has the speed loop"),
        ("hysteresis", "inverter.topology=split-capacitor", "works on topology: three-wire"),
    ],
)
def test_refused(method: str, setting: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        feedback_design(method, setting)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_outer_band_below_the_band_is_refused() -> None:
    with pytest.raises(InputError, match="write band or more"):
        feedback_design("look-up-table", f"{LOOP}.band=2 A", f"{LOOP}.outer_band=1 A")


@pytest.mark.parametrize(
    "method",
    ["hysteresis", "ramp-comparison", "look-up-table", "circle", "predictive", "trajectory"],
)
def test_a_simulation_is_read(method: str) -> None:
    scenario = feedback_design(method, simulated=True).simulation
    assert scenario is not None
    assert scenario.reference.values == pytest.approx((1000.0 * math.pi / 30.0,))


@pytest.mark.parametrize(
    ("method", "setting", "words"),
    [
        ("circle", "simulation.inverter=averaged", "write switched, or remove it"),
        ("circle", "simulation.sensorless.above=100 rpm", "has no position observer"),
        ("hysteresis", "simulation.current_sensor.bits=12", "before any converter"),
        ("ramp-comparison", "simulation.current_sensor.noise=10 mA", "that of samples"),
    ],
)
def test_what_a_simulation_cannot_have(method: str, setting: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        feedback_design(method, setting, simulated=True)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
