"""The range of a six-step drive, and what is refused, with the number."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from six_step_drives import BENCH, bench

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.six_step.design import (
    SixStepDesign,
    freewheeling_angle,
    solve_six_step,
)

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


METHODS = ("zero-crossing", "diode-conduction", "emf-integration")
# Of the drive below: magnet, pole pairs, resistance, link and period; saliency and mean inductance.
PSI, PAIRS, R, I_MAX, V_DC, T_S = 0.06, 3, 2.35, 6.4, 214.0, 5e-5
DIFFERENCE, MEAN, SECTOR = 1e-4, 1.65e-3, math.pi / 3.0
EMF = PSI * 3.0 * math.sqrt(3.0) / math.pi
TORQUE = 1.5 * PAIRS * PSI * 2.0 / math.sqrt(3.0) * 3.0 / math.pi * 3.2


@cache
def whole(method: str) -> SixStepDesign:
    """A drive with saliency, dead time, a filter where there is a voltage, and a speed loop."""
    filtered = () if method == "diode-conduction" else ("control.six_step={filter_time: 50 us}",)
    found = solve_six_step(
        bench(
            f"control.observer.method={method}",
            "machine.inductance_d=1.6 mH",
            "machine.inductance_q=1.7 mH",
            "inverter.dead_time=1 us",
            *filtered,
        )
    )
    assert found is not None
    return found


@pytest.mark.parametrize("method", METHODS)
def test_each_part_of_an_error_is_that_of_its_formula(method: str) -> None:
    found = whole(method)
    diode, integral = method == "diode-conduction", method == "emf-integration"
    slope, level = PSI, 0.5 * PSI
    step = 1.25 * V_DC / 2**12
    known = found.disturbed
    rate = DIFFERENCE / (math.sqrt(3.0) * MEAN)
    offset = 0.2 / 1.5 if diode else 0.002 * V_DC + 0.5 * step
    assert known.offset == pytest.approx(offset, rel=1e-9)
    assert known.noise == pytest.approx(0.0 if diode else step, rel=1e-9)
    assert known.step == pytest.approx(DIFFERENCE * I_MAX, rel=1e-9)
    kappa = -rate * 2.0 * R * I_MAX if diode else rate * V_DC
    assert known.kappa == pytest.approx(kappa, rel=1e-9)
    assert known.bend == pytest.approx(-rate * EMF if diode else 0.0, rel=1e-4)
    assert known.free == pytest.approx(math.radians(10.0), rel=1e-12)
    omega = 500.0
    errors = found.errors_at(omega)
    steep = 1.0 + (kappa / omega + known.bend) / slope
    x, flat = math.radians(30.0), min(steep, 1.0)
    lag = 0.0 if diode else omega * 50e-6
    missing = lag * math.exp(-math.radians(10.0) / lag) if lag else 0.0
    if integral:
        expected = (
            offset * x / (omega * level),
            step * math.sqrt(x * T_S / omega) / level,
            known.step * x / level + x * abs(1.0 - 1.0 / math.sqrt(steep)),
        )
    else:
        expected = (
            1.375 * offset / (omega * slope * flat),
            known.noise * math.hypot(1.25, 0.25) / (slope * omega * flat),
            known.step / (slope * flat),
        )
    grid = 0.5 * omega * T_S * (1.0 + (1.375 / flat if diode else 0.0)) + missing
    parts = [errors.offset[0], errors.noise[0], errors.saliency[0], errors.grid[0]]
    assert parts == pytest.approx([*expected, grid], rel=2e-3)
    total = expected[0] + 3.0 * expected[1] + expected[2] + grid
    assert errors.largest[0] == pytest.approx(total, rel=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_each_number_of_a_start_is_that_of_its_formula(method: str) -> None:
    found = whole(method)
    low, high = found.limits.low, found.limits.high
    start, inertia = found.start, 200e-6
    swing = math.sqrt(PAIRS * TORQUE / inertia)
    handed = min(1.5 * low, math.sqrt(low * high))
    acceleration = min(PAIRS * 0.2 * TORQUE / inertia, handed * swing / (6.0 * math.pi))
    align = max(0.3, 6.0 * math.pi / swing)
    turned = int(math.radians(140.0) / (high * T_S))
    assert start.current == pytest.approx(3.2)
    assert start.voltage == pytest.approx(2.0 * R * 3.2 + V_DC * 1e-6 / T_S)
    assert start.swing == pytest.approx(swing, rel=1e-4)
    assert start.align == round(0.5 * align / T_S)
    assert start.omega == pytest.approx(handed)
    assert start.rate == pytest.approx(handed * T_S / SECTOR)
    assert start.rise == pytest.approx(acceleration * T_S**2 / SECTOR, rel=1e-4)
    assert start.ramp_time == pytest.approx(handed / acceleration, rel=1e-4)
    assert start.load == pytest.approx(0.6 * TORQUE, rel=1e-4)
    assert start.settle == 2 + math.ceil(4.0 * MEAN * 3.2 / (V_DC * T_S))
    assert start.gap == max(2, min(round(math.radians(20.0) / (handed * T_S)), turned))


@pytest.mark.parametrize("method", METHODS)
def test_what_is_emitted_is_what_was_designed(method: str) -> None:
    found = whole(method)
    diode, low, start = method == "diode-conduction", found.limits.low, found.start
    gains, speed, current = found.gains, found.speed, found.current
    assert speed is not None
    duty, share = 2.0 * 1e-6 / T_S + 0.01, 1.0 - math.exp(-1.0) if not diode else 1.0
    fixed, delay = 1.0 / current.crossover + 5.0 * T_S, 0.5 * math.pi / low
    assert speed.delay == pytest.approx(delay)
    assert speed.scale == pytest.approx(min(max(1.25 + 0.25 * delay / fixed, 1.0), 10.0))
    assert (gains.kp, gains.ki_ts) == (2.0 * current.kp, 2.0 * current.ki_ts)
    assert gains.duty_least == pytest.approx(max(0.02, duty))
    assert gains.emf == pytest.approx(EMF, rel=1e-4)
    assert gains.torque == pytest.approx(TORQUE / 3.2, rel=1e-4)
    assert gains.speed_ki_ts == pytest.approx(speed.ki * 10.0 * T_S)
    assert (gains.omega_low, gains.omega_least) == (low, low / 3.0)
    assert (gains.omega_caught, gains.i_start, gains.v_start) == (
        start.omega,
        start.current,
        start.voltage,
    )
    assert (gains.align, gains.rise, gains.rate) == (start.align, start.rise, start.rate)
    assert (gains.settle, gains.gap, gains.ratio) == (start.settle, start.gap, 10)
    seen = gains.observer
    late = 1.0 if diode else 0.5 + (1.0 - share) / share
    assert seen.latency == pytest.approx(late, rel=0.02)
    assert seen.blank_share == pytest.approx(1.15 * found.limits.freewheeling / SECTOR)
    assert seen.blank_least == (2.5 if diode else 1.5)
    assert seen.delay == pytest.approx((0.5, 0.5), rel=1e-6)
