"""The range of a six-step drive, and what is refused, with the number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from six_step_drives import BENCH, bench

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.six_step.design import freewheeling_angle, solve_six_step

SALIENT = ("machine.inductance_d=1.2 mH", "machine.inductance_q=2.6 mH")


def test_the_range_is_that_of_the_formulas() -> None:
    design = bench("control.six_step={voltage_offset: 0.5 V, voltage_noise: 0.05 V}")
    found = solve_six_step(design)
    assert found is not None
    # Least speed: offset with half a step of 12 bits over 1.25 v_dc, noise three times, half a
    # period, together 10 degrees; or a duty cycle of 2 %.
    dv, sigma = 0.5 + 1.25 * 214.0 / 2**13, 0.05
    needed = (1.375 * dv + 3.0 * math.hypot(1.25, 0.25) * sigma) / 0.06
    limit = math.radians(10.0)
    omega = (limit - math.sqrt(limit**2 - 2.0 * needed * 5e-5)) / 5e-5
    assert found.limits.by_error[0] == pytest.approx(omega, rel=0.03)
    block = 0.06 * 3.0 * math.sqrt(3.0) / math.pi
    assert found.limits.by_duty == pytest.approx(0.02 * 214.0 / block, rel=1e-3)
    assert found.limits.low == max(found.limits.by_error[0], found.limits.by_duty)
    assert found.limits.high == pytest.approx(3.0 * 5420.0 * math.pi / 30.0, rel=0.03)
    assert found.errors_at(found.limits.low).largest[0] <= limit * (1.0 + 1e-9)


def test_the_range_of_a_diode_is_that_of_its_threshold_and_of_the_periods() -> None:
    design = bench(
        "control.observer.method=diode-conduction", "control.six_step={voltage_offset: 3 V}"
    )
    found = solve_six_step(design)
    assert found is not None
    # Off the rail by 1.5 u: 2 V of u. Half a period in the crossing, and half until a leg acts.
    limit, needed, periods = math.radians(10.0), 1.375 * 3.0 / 1.5 / 0.06, 0.5 * (1.0 + 1.375)
    omega = (limit - math.sqrt(limit**2 - 4.0 * needed * periods * 5e-5)) / (2.0 * periods * 5e-5)
    assert found.limits.by_error[0] == pytest.approx(omega, rel=0.03)
    assert found.gains.duty_most == 1.0 - found.gains.duty_least
    with pytest.raises(InputError, match="sees whether a diode conducts, not a voltage"):
        bench("control.observer.method=diode-conduction", "control.six_step={filter_time: 50 us}")


def test_freewheeling_is_that_of_its_circuit() -> None:
    design = bench()
    found = solve_six_step(design)
    assert found is not None
    omega, i = 800.0, 6.4
    applied = 0.06 * 3.0 * math.sqrt(3.0) / math.pi * omega + 2.0 * 2.35 * i
    seconds = 1.675e-3 * i / (applied / 3.0 + 0.5 * 0.06 * omega)
    angle = freewheeling_angle(design, found.shape, np.array([omega]))[0]
    assert angle == pytest.approx(omega * seconds, rel=1e-3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("control.six_step={voltage_offset: 9 V}",), "only up to"),
        ((*SALIENT, "control.observer.method=emf-integration"), "saliency alone 8.5"),
        (("machine.inductance_d=16 mH", "machine.inductance_q=16 mH"), "carries current for|up to"),
    ],
)
def test_what_physics_forbids_is_refused_with_the_number(
    settings: tuple[str, ...], message: str
) -> None:
    with pytest.raises(NoSolutionError, match=message):
        solve_six_step(bench(*settings))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("export.control=float32", "its own control functions"),
        ("export.firmware=vesc", "that firmware runs vector control"),
        ("control.sampling_frequency=10 kHz", "samples once per carrier period"),
        ("control.speed_loop.filter_time=1 ms", "six times per turn"),
        ("control.speed_loop.method=ti", "write symmetrical-optimum or given"),
        ("simulation.encoder={lines: 100}", "it never has an encoder"),
        ("control.tolerances={r_s: 20 %}", "they are not evaluated here"),
    ],
)
def test_keys_without_meaning_are_refused(setting: str, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        bench(setting)
    assert "\n" not in str(caught.value)


def test_the_section_is_for_six_step_drives_alone() -> None:
    with pytest.raises(InputError, match="make a six-step drive"):
        bench("control.observer.method=flux", "control.six_step={voltage_bits: 10}")
    assert solve_six_step(bench("control.observer.method=flux")) is None
    with pytest.raises(InputError, match="no loops in rotor coordinates"):
        solve_gains(bench())


def test_a_start_needs_inertia_and_a_current_within_the_limit() -> None:
    text = BENCH.replace("  inertia: 200e-6 kg m^2\n", "").replace(
        "  speed_loop: {ratio: 10}\n", ""
    )
    with pytest.raises(InputError, match="needs the inertia"):
        solve_six_step(bench(text=text))
    with pytest.raises(InputError, match=r"above the limit of the drive, 6\.4 A"):
        solve_six_step(bench("control.six_step={start_current: 7 A}"))


def test_a_speed_loop_that_is_too_fast_for_six_samples_per_turn_is_refused() -> None:
    with pytest.raises(NoSolutionError, match="write a spread above 2"):
        solve_six_step(bench("control.speed_loop={ratio: 10, spread: 2}"))
    given = "control.speed_loop={method: given, kp: 0.05 N m s/rad, ki: 1 N m/rad}"
    with pytest.raises(NoSolutionError, match=r"where the speed is 18\.2 ms late"):
        solve_six_step(bench(given))
