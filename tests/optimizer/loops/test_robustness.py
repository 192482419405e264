"""Loops over a box of tolerances: corners by brute force, how each tolerance enters,
refusals with what would hold.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings, Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.loops.integer_gains import inductance_range
from dqforge.optimizer.loops.loop_gains import analyse_current_loop, tune_current_loop
from dqforge.optimizer.loops.pi_methods import BatchMargins, current_plants
from dqforge.optimizer.loops.robustness import (
    SAMPLES,
    RobustSet,
    box_points,
    drive_box,
    first_fault,
    summarise,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_at_current

BENCH = LinearMachine(
    pole_pairs=3,
    r_s=2.35,
    l_d=1.61e-3,
    l_q=1.74e-3,
    psi_pm=0.06,
    i_max=6.4,
    inertia=2e-4,
    friction=4e-5,
)


def design(
    tolerances: Tolerances | None,
    machine: LinearMachine = BENCH,
    current: CurrentLoopSettings | None = None,
    speed: SpeedLoopSettings | None = None,
    **keys: Any,
) -> Design:
    made = make_design(machine)
    control = replace(
        made.control,
        t_s=2e-4,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=1200.0)
        if current is None
        else current,
        speed_loop=speed,
        observer=None,
        tolerances=tolerances,
    )
    inverter = replace(made.inverter, v_dc=180.0, f_sw=5e3)
    return replace(made, control=control, inverter=inverter, **keys)


def robust_of(gains: GainSet) -> RobustSet:
    assert gains.robust is not None
    return gains.robust


def test_without_tolerances_nothing_is_added() -> None:
    gains = solve_gains(design(None))
    assert gains.robust is None
    assert (gains.i_q.kp, gains.i_q.ki) == (1200.0 * BENCH.l_q, 1200.0 * BENCH.r_s)


def test_current_loop_corners_are_those_of_single_loops() -> None:
    """Every corner analysed by itself: winding, gain of the voltage, and the
    resistance of the dead time.
    """
    tolerances = Tolerances(r_s=0.3, l_d=0.2, l_q=0.25, v_dc=0.1, dead_time=0.3e-6, low_current=0.8)
    gains = solve_gains(design(tolerances))
    kept = robust_of(gains).i_q
    assert (kept.corners, kept.samples) == (16, SAMPLES + 1)
    found = []
    for r, inductance, v, dead in itertools.product(
        (-0.3, 0.3), (-0.25, 0.25), (-0.1, 0.1), (-0.3e-6, 0.3e-6)
    ):
        voltage = 5e3 * dead * 180.0 * (1.0 + v)
        resistance = BENCH.r_s * (1.0 + r) + 4.0 * voltage / (np.pi * 0.8)
        # A gain g of the voltage is that of both gains; the loop is the same.
        loop = analyse_current_loop(
            resistance,
            BENCH.l_q * (1.0 + inductance),
            2e-4,
            gains.i_q.kp * (1.0 + v),
            gains.i_q.ki * (1.0 + v),
            respond=False,
        )
        found.append(
            (
                loop.phase_margin,
                loop.gain_margin,
                loop.delay_margin,
                loop.max_sensitivity,
                abs(loop.poles[0]),
            )
        )
    margins = np.array(found)
    assert kept.phase_margin.value == pytest.approx(np.min(margins[:, 0]), rel=1e-8)
    assert kept.gain_margin.value == pytest.approx(np.min(margins[:, 1]), rel=1e-8)
    assert kept.delay_margin.value == pytest.approx(np.min(margins[:, 2]), rel=1e-8)
    assert kept.max_sensitivity.value == pytest.approx(np.max(margins[:, 3]), rel=1e-8)
    assert kept.radius.value == pytest.approx(np.max(margins[:, 4]), rel=1e-8)
    assert kept.max_sensitivity.at == "r_s -30 %, l_q -25 %, v_dc +10 %, dead_time -0.3 us"
    assert not kept.inside_worse


def test_dead_time_acts_as_the_resistance_of_its_describing_function() -> None:
    """A voltage of fixed size against each phase current, averaged over a
    period of sinusoidal currents.
    """
    tolerances = Tolerances(dead_time=0.5e-6, low_current=0.7)
    box = drive_box(design(tolerances), (BENCH.l_d, BENCH.l_q), (BENCH.l_d, BENCH.l_q))
    points = box.current_points("i_q")
    theta = np.linspace(0.0, 2.0 * np.pi, 36_000, endpoint=False)
    shift = np.array([0.0, 2.0 * np.pi / 3.0, 4.0 * np.pi / 3.0])[:, np.newaxis]
    phases = (
        5e3 * 0.5e-6 * 180.0 * np.sign(np.cos(theta - shift))
    )  # against the currents 0.7 A cos(theta - shift)
    along_current = np.mean(2.0 / 3.0 * np.sum(phases * np.cos(theta - shift), axis=0))
    expected = BENCH.r_s + np.array([-1.0, 1.0]) * along_current / 0.7
    np.testing.assert_allclose(box.resistance(points)[: points.corners], expected, rtol=1e-6)


def test_points_of_a_box() -> None:
    points = box_points({"r_s": (-0.1, 0.1), "l_q": (0.0, 0.0), "dead_time": (-2e-7, 2e-7)})
    assert points.names == ("r_s", "dead_time")
    assert points.corners == 4
    assert {tuple(row) for row in points.deviations[:4].tolist()} == set(
        itertools.product((-0.1, 0.1), (-2e-7, 2e-7))
    )
    inside = points.deviations[4:-1]
    assert len(inside) == SAMPLES
    assert np.all(np.abs(inside) < (0.1, 2e-7))
    assert not points.deviations[-1].any()
    assert points.text(0) == "r_s -10 %, dead_time -0.2 us"
    assert box_points({}).text(0) == "the data themselves"
    np.testing.assert_array_equal(
        points.deviations, box_points({"r_s": (-0.1, 0.1), "dead_time": (-2e-7, 2e-7)}).deviations
    )


def test_points_at_both_loads_are_those_of_the_box_twice() -> None:
    """Corners without and with the full current, then all others so, the data last of each."""
    limits = {"l_d": (-0.1, 0.2), "psi_pm": (0.0, 0.05)}
    plain, both = box_points(limits), box_points(limits, loads=True)
    rest = len(plain.deviations) - 4
    assert (plain.corners, both.corners, rest) == (4, 8, SAMPLES + 1)
    order = [*range(4), *range(4), *range(4, 4 + rest), *range(4, 4 + rest)]
    np.testing.assert_array_equal(both.deviations, plain.deviations[order])
    np.testing.assert_array_equal(
        both.loaded, np.repeat([False, True, False, True], [4, 4, rest, rest])
    )
    assert not plain.loaded.any()
    assert both.text(0) == "l_d -10 %, psi_pm 0 %"
    assert both.text(7) == "l_d +20 %, psi_pm +5 %, full current"
    assert both.text(8 + rest - 1) == "l_d 0 %, psi_pm 0 %"
    assert box_points({}, loads=True).text(1) == "full current"


@pytest.mark.parametrize("machine", [IPM, INVERSE_SALIENT, RELUCTANCE, SURFACE])
def test_torque_factor_is_that_of_the_changed_machine(machine: LinearMachine) -> None:
    """Torque of the other machine at the currents of the nominal MTPA point,
    over the commanded one.
    """
    tolerances = Tolerances(l_d=0.1, l_q=0.15, psi_pm=0.05 if machine.psi_pm else 0.0)
    made = design(tolerances, machine, speed=SpeedLoopSettings())
    box = drive_box(made, (machine.l_d, machine.l_q), (machine.l_d, machine.l_q))
    points = box.speed_points()
    plants = box.speed_loop_plants(points, (1.0, 100.0))
    assert plants.size == len(points.deviations)
    factor = box.torque_factor(points)
    i_d, i_q = mtpa_at_current(machine, np.array([made.i_max]))
    for row in range(points.corners):
        d, q, psi = (points.of(name)[row] for name in ("l_d", "l_q", "psi_pm"))
        other = replace(
            machine,
            l_d=machine.l_d * (1 + d),
            l_q=machine.l_q * (1 + q),
            psi_pm=machine.psi_pm * (1 + psi),
        )
        full = points.loaded[row] or machine.psi_pm == 0.0
        expected = (other.torque(i_d, i_q) / machine.torque(i_d, i_q))[0] if full else 1.0 + psi
        assert factor[row] == pytest.approx(expected, rel=1e-9)
    assert points.loaded.any() == (machine.saliency != 0.0)


def test_speed_loop_with_another_inertia_and_magnet() -> None:
    """Without saliency, an inertia (1 + j) times as large and torque (1 + f) times as
    large is the gain (1+f)/(1+j).
    """
    tolerances = Tolerances(psi_pm=0.1, inertia=0.3)
    machine = replace(
        SURFACE, inertia=1e-3, friction=0.0, psi_pm=1e-5
    )  # so small that no back-EMF is left over
    speed = SpeedLoopSettings(method="damping", bandwidth=60.0)
    gains = solve_gains(design(tolerances, machine, speed=speed))
    assert gains.speed is not None
    kept = robust_of(gains).speed
    assert kept is not None
    assert kept.corners == 4
    scaled = []
    for psi, inertia in itertools.product((-0.1, 0.1), (-0.3, 0.3)):
        factor = (1.0 + psi) / (1.0 + inertia)
        given = SpeedLoopSettings(
            method="given", kp=gains.speed.kp * factor, ki=gains.speed.ki * factor
        )
        loop = solve_gains(design(None, machine, speed=given)).speed
        assert loop is not None
        scaled.append(loop.max_sensitivity)
    assert kept.max_sensitivity.value == pytest.approx(max(scaled), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "margin"),
    [
        (CurrentLoopSettings("bandwidth", bandwidth=1650.0), 56.0),
        (CurrentLoopSettings("magnitude-optimum"), 56.0),
        (CurrentLoopSettings("damping", bandwidth=1650.0, damping=1.0), 37.0),
        (CurrentLoopSettings("symmetrical-optimum", spread=2.0), 58.0),
        (CurrentLoopSettings("given", kp=2.6, ki=3900.0), 45.0),
    ],
)
def test_a_corner_that_does_not_hold_is_named_with_what_would(
    settings: CurrentLoopSettings, margin: float
) -> None:
    method, settings = settings.method, replace(settings, min_phase_margin=np.radians(margin))
    tolerances = Tolerances(r_s=0.3, l_d=0.2, l_q=0.2, v_dc=0.2)
    tune_current_loop(BENCH.r_s, BENCH.l_d, 2e-4, settings)  # the data themselves hold
    with pytest.raises(
        NoSolutionError, match=r"within control\.tolerances the i_d loop .* at r_s [+-]30 %, l_d"
    ) as refusal:
        solve_gains(design(tolerances, current=settings))
    text = str(refusal.value)
    asked = settings
    if "spread = " in text:
        asked = replace(settings, spread=float(re.findall(r"spread = ([\d.]+)", text)[0]))
    elif "bandwidth = " in text:
        limit = float(re.findall(r"bandwidth = ([\d.]+) rad/s", text)[0])
        asked = replace(
            settings,
            method="bandwidth" if method == "magnitude-optimum" else method,
            bandwidth=limit,
        )
    else:
        factor = float(re.findall(r"by ([\d.]+) or less", text)[0])
        asked = replace(settings, kp=2.6 * factor, ki=3900.0 * factor)
    kept = robust_of(solve_gains(design(replace(tolerances, l_q=0.0), current=asked))).i_d
    assert kept.phase_margin.value >= settings.min_phase_margin
    assert kept.phase_margin.value <= settings.min_phase_margin * 1.02


@pytest.mark.slow
def test_a_speed_loop_that_a_corner_makes_unstable_is_refused() -> None:
    speed = SpeedLoopSettings(method="damping", bandwidth=260.0, min_phase_margin=0.05)
    solve_gains(design(None, speed=speed))
    with pytest.raises(
        NoSolutionError, match=r"the speed loop .* is unstable .* at .*inertia -60 %"
    ):
        solve_gains(design(Tolerances(inertia=0.6, psi_pm=0.2), speed=speed))


def test_too_much_dead_time_compensation_at_a_small_current_is_refused() -> None:
    """4 f_sw t_e V_dc/(pi I) of over 5 Ohm against 0.5 Ohm of kp and 2.35 Ohm of winding."""
    current = CurrentLoopSettings("bandwidth", bandwidth=300.0)
    solve_gains(design(Tolerances(dead_time=0.2e-6, low_current=0.6), current=current))
    with pytest.raises(NoSolutionError, match=r"is unstable .* at dead_time -1 us"):
        solve_gains(design(Tolerances(dead_time=1e-6, low_current=0.2), current=current))


def test_saturation_belongs_to_the_box_of_constant_gains() -> None:
    saturated = catalogue.load("abb-syrm-6k7-saturated")
    control = replace(saturated.control, speed_loop=None, tolerances=Tolerances(r_s=0.1, l_d=0.1))
    made = replace(saturated, control=control)
    least, most = inductance_range(made.machine, made.i_max)
    reach = drive_box(made, least, most).current_points("i_d").of("l_d")
    assert least[0] * (1.0 + np.min(reach)) == pytest.approx(0.9 * least[0])
    assert least[0] * (1.0 + np.max(reach)) == pytest.approx(1.1 * most[0])
    assert most[0] > 4.0 * least[0]
    scheduled = replace(
        made, control=replace(control, current_loop=replace(control.current_loop, schedule=True))
    )
    assert np.max(
        drive_box(scheduled, least, most).current_points("i_d").of("l_d")
    ) == pytest.approx(0.1)


def test_optimised_constant_gains_of_a_saturated_machine_hold_at_every_current() -> None:
    saturated = catalogue.load("abb-syrm-6k7-saturated")
    control = replace(
        saturated.control, speed_loop=None, current_loop=CurrentLoopSettings("optimised")
    )
    loop = solve_gains(replace(saturated, control=control)).i_d
    least, most = inductance_range(saturated.machine, saturated.i_max)
    for inductance in np.geomspace(least[0], most[0], 10).tolist():
        again = analyse_current_loop(
            saturated.machine.r_s, inductance, control.t_s, loop.kp, loop.ki, respond=False
        )
        assert again.max_sensitivity <= 1.6 * (1.0 + 2e-6)


@pytest.mark.slow
def test_optimised_loops_keep_their_bound_in_the_whole_box() -> None:
    tolerances = Tolerances(r_s=0.3, l_d=0.2, l_q=0.2, psi_pm=0.05, inertia=0.2, v_dc=0.05)
    current = CurrentLoopSettings("optimised", max_sensitivity=1.5)
    gains = solve_gains(
        design(
            tolerances, current=current, speed=SpeedLoopSettings("optimised", max_sensitivity=1.7)
        )
    )
    kept = robust_of(gains)
    assert kept.i_d.max_sensitivity.value == pytest.approx(1.5, rel=1e-5)
    assert kept.i_q.max_sensitivity.value == pytest.approx(1.5, rel=1e-5)
    assert kept.speed is not None
    assert kept.speed.max_sensitivity.value == pytest.approx(1.7, rel=1e-5)
    assert [loop.inside_worse for loop in (kept.i_d, kept.i_q, kept.speed)] == [False] * 3


def margins_of(rows: list[list[float]]) -> BatchMargins:
    """Radius, phase, gain and delay margin, and largest sensitivity, point by point."""
    radius, phase, gain, delay, sensitivity = np.array(rows).T
    known = dict.fromkeys(BatchMargins.__dataclass_fields__, np.zeros(radius.size))
    return BatchMargins(
        **known
        | {
            "radius": radius,
            "phase_margin": phase,
            "gain_margin": gain,
            "delay_margin": delay,
            "max_sensitivity": sensitivity,
        }
    )


def test_the_worst_of_each_margin_is_named_and_an_unstable_point_is_worse_than_any() -> None:
    points = box_points({"r_s": (-0.1, 0.2), "dead_time": (-1e-6, 2e-6)})
    fine = [0.9, 1.0, 3.0, 2e-3, 1.3]
    rows = [fine] * len(points.deviations)
    rows[0] = [0.9, -0.8, 3.0, 2e-3, 1.3]
    rows[1] = [0.9, 1.0, 2.5, 2e-3, 1.3]
    rows[2] = [0.9, 1.0, 3.0, 1e-3, 1.3]
    rows[3] = [0.95, 1.0, 3.0, 2e-3, 1.7]
    found = summarise(margins_of(rows), points)
    at = [points.text(k) for k in range(4)]
    assert at[1] == "r_s -10 %, dead_time +2 us"
    assert (found.corners, found.samples, found.inside_worse) == (4, SAMPLES + 1, False)
    assert (found.phase_margin.value, found.phase_margin.at) == (0.8, at[0])
    assert (found.gain_margin.value, found.gain_margin.at) == (2.5, at[1])
    assert (found.delay_margin.value, found.delay_margin.at) == (1e-3, at[2])
    assert (found.max_sensitivity.value, found.max_sensitivity.at) == (1.7, at[3])
    assert (found.radius.value, found.radius.at) == (0.95, at[3])
    assert first_fault(margins_of(rows), points, 0.8) is None
    said = first_fault(margins_of(rows), points, 0.81)
    assert said == f"has a phase margin of 45.8 deg at {at[0]}"
    rows[7] = [0.9, 0.7, 3.0, 2e-3, 1.3]
    inside = summarise(margins_of(rows), points)
    assert (inside.inside_worse, inside.phase_margin.at) == (True, points.text(7))
    rows[7], rows[2] = fine, [1.0, 2.0, 9.0, 9e-3, 1.0]
    unstable = summarise(margins_of(rows), points)
    for name in ("phase_margin", "gain_margin", "delay_margin", "max_sensitivity", "radius"):
        assert getattr(unstable, name).at == at[2]
    said = first_fault(margins_of(rows), points, 0.1)
    assert said == f"is unstable (largest pole modulus 1) at {at[2]}"


def test_the_zero_sequence_moves_as_far_as_the_further_axis() -> None:
    """And every plant and winding is that of its point."""
    tolerances = Tolerances(r_s=0.1, l_d=0.3, l_q=0.2, v_dc=0.05)
    box = drive_box(design(tolerances), (1.61e-3, 1.74e-3), (1.61e-3, 1.74e-3))
    assert box.zero_limits()["l_0"] == pytest.approx((-0.3, 0.3))
    other = drive_box(design(replace(tolerances, l_q=0.4)), (1.6e-3, 1.7e-3), (1.6e-3, 1.7e-3))
    assert other.zero_limits()["l_0"] == pytest.approx((-0.4, 0.4))
    assert set(box.zero_limits()) == {"r_s", "v_dc", "dead_time", "l_0"}
    points = box.zero_points()
    assert points.names == ("r_s", "v_dc", "l_0")
    plants = box.zero_plants(points, 0.9e-3)
    known = current_plants(
        2.35 * (1.0 + points.of("r_s")), 0.9e-3 * (1.0 + points.of("l_0")), 2e-4,
        1.0 + points.of("v_dc"),
    )  # fmt: skip
    np.testing.assert_allclose(plants.a, known.a, rtol=1e-12)
    np.testing.assert_allclose(plants.b, known.b, rtol=1e-12)
    assert box.phase_points(zero=True).names == ("r_s", "l_d", "v_dc", "l_q", "l_0")
    assert box.phase_points(zero=False).names == ("r_s", "l_d", "v_dc", "l_q")
    turning = box.turning_points()
    omega = np.array([-50.0, 0.0, 200.0])
    drives = box.turning_machines(turning, omega)
    for row in (0, 3, 8, 200):
        for place, speed in enumerate(omega):
            k = 3 * row + place
            r, d, q, v = (float(turning.of(name)[row]) for name in ("r_s", "l_d", "l_q", "v_dc"))
            found = [
                float(getattr(drives, name)[k]) for name in ("r_s", "l_d", "l_q", "gain", "omega_e")
            ]
            assert found == pytest.approx(
                [2.35 * (1 + r), 1.61e-3 * (1 + d), 1.74e-3 * (1 + q), 1 + v, speed]
            )
