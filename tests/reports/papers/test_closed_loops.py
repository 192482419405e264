"""The closed loops of paper 002 with the emitted C: what the circuit of the thesis carries, and
what circuits with a path for the neutral current do.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from dqforge.machines.plants.scenario import constant
from dqforge.reports.papers.paper002_bench_currents import bench_curves, bench_machine
from dqforge.reports.papers.paper002_closed_loops import (
    CASES,
    STEADY,
    LoopRun,
    diode_path,
    loop_ratios,
    run_case,
    run_led,
    run_loops,
)
from dqforge.reports.papers.paper002_tables import plot_led, plot_loops, plot_step
from dqforge.reports.papers.transients import RPM

# In % of 1 N m: averaged, and means over PWM periods with 1 us of dead time.
RIPPLES = {
    "diodes_pi": (12.9, 22.0),
    "diodes_decoupled": (3.2, 12.4),
    "diodes_dqx": (0.0, 1.4),
    "legs_pi": (10.1, 12.6),
    "legs_decoupled": (0.1, 2.5),
    "legs_table": (0.0, 0.5),
    "open_decoupled": (0.1, 3.5),
    "isolated_dqx": (0.0, 2.5),
    "star_table": (0.0, 0.3),
}


@pytest.mark.parametrize("torque", [1.0, -1.0])
@pytest.mark.parametrize("rpm", [75.0, 750.0, 1800.0])
def test_the_voltages_of_dqy_let_no_neutral_current_through_the_diodes(
    rpm: float, torque: float
) -> None:
    path = diode_path(bench_machine(), torque, rpm * RPM)
    assert path.share == 0.0
    assert path.short > 0.0
    assert path.neutral_rms == pytest.approx(0.365, abs=1e-3)


def test_a_path_is_found_where_there_is_one() -> None:
    """A braked machine whose third harmonic exceeds its fundamental lets the current through."""
    machine = bench_machine()
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    third = np.broadcast_to(-np.sin(3.0 * theta), machine.flux.shape)
    shaped = type(machine)(2, 1.0, 7e-3, -1e-3, 0.2 * third + 0.02 * machine.flux, 6.0)
    assert diode_path(shaped, -0.001, 750.0 * RPM).share > 0.3
    assert diode_path(shaped, 0.001, 750.0 * RPM).share == 0.0


def test_the_loop_of_the_bench_carries_no_neutral_current() -> None:
    """Figure 4.2 on Figure 5.4: the first case, which every run of the tests closes."""
    run = run_case(CASES[0])
    assert (run.case.plant, run.case.frame, run.case.feedforward) == (
        "diode-neutral",
        "dqy",
        "none",
    )
    assert run.torque == pytest.approx(1.0, abs=5e-3)
    assert run.ripple_means == pytest.approx(0.22, abs=0.02)
    assert run.neutral_rms < 0.03
    assert run.asked[1] > run.asked[0] + 3.0


@pytest.fixture(scope="module")
def runs() -> dict[str, LoopRun]:
    return {run.case.name: run for run in run_loops().runs}


@pytest.mark.slow
def test_torque_and_its_ripple(runs: dict[str, LoopRun]) -> None:
    assert list(runs) == [case.name for case in CASES] == list(RIPPLES)
    for name, (averaged, means) in RIPPLES.items():
        run = runs[name]
        assert run.torque == pytest.approx(1.0, abs=5e-3), name
        assert 100.0 * run.ripple_averaged == pytest.approx(averaged, abs=0.15), name
        assert 100.0 * run.ripple_means == pytest.approx(means, rel=0.1, abs=0.1), name
    assert runs["legs_table"].ripple == pytest.approx(0.13, abs=0.02)
    assert runs["star_table"].ripple == pytest.approx(0.119, abs=0.02)


@pytest.mark.slow
def test_the_neutral_current_flows_where_both_ends_of_a_link_are_in_reach(
    runs: dict[str, LoopRun],
) -> None:
    """0.365 A are wanted; on diodes the PWM leaves 0.025 A, whatever the controller asks for."""
    for name in ("diodes_pi", "diodes_decoupled", "diodes_dqx"):
        assert runs[name].neutral_rms == pytest.approx(0.024, abs=0.003), name
    assert runs["legs_table"].neutral_rms == pytest.approx(0.38, abs=0.02)
    assert runs["legs_table"].zero_third == pytest.approx(0.298, abs=0.01)
    for name in ("star_table", "isolated_dqx"):
        assert runs[name].neutral_rms < 1e-12
    for name in ("legs_pi", "legs_decoupled", "open_decoupled"):
        assert 0.25 < runs[name].neutral_rms < 0.35, name


@pytest.mark.slow
def test_the_zero_sequence_integral_winds_up_on_diodes(runs: dict[str, LoopRun]) -> None:
    for name in ("diodes_pi", "diodes_decoupled"):
        early, late = runs[name].asked
        assert abs(late) > abs(early) + 3.0, name
    for name in ("legs_pi", "legs_decoupled", "legs_table"):
        early, late = runs[name].asked
        assert abs(late - early) < 0.02, name


@pytest.mark.slow
def test_currents_of_the_table_are_those_of_the_definitions(runs: dict[str, LoopRun]) -> None:
    """Figures 6.9 to 6.16 on four legs, within the ripple that the dead time leaves."""
    curves, found = bench_curves(), runs["legs_table"].curves
    at = np.concatenate([curves.stationary, curves.stationary[:, :1]], axis=1)
    degrees = np.degrees(found.theta)
    for row, (measured, wanted) in enumerate(zip(found.stationary, at, strict=True)):
        expected = np.interp(degrees, np.arange(361.0), wanted)
        assert np.max(np.abs(measured - expected)) < 0.06, row
    assert np.max(np.abs(found.dqy[1] - curves.i_qy)) < 0.02
    far = runs["diodes_pi"].curves.dqy[1]
    assert np.ptp(far) > 0.3


@pytest.mark.slow
def test_a_load_step_slows_every_drive_alike(runs: dict[str, LoopRun]) -> None:
    """T/J e^-1 2/omega_c = 93.7 rpm after 2/omega_c = 40 ms, whatever controls the currents."""
    for name, run in runs.items():
        assert run.dip / RPM == pytest.approx(93.7, abs=3.0), name
        assert 0.030 < run.dip_after < 0.045, name
    dips = [run.dip for run in runs.values()]
    assert np.ptp(dips) < 0.05 * np.mean(dips)


@pytest.mark.slow
def test_loops_are_drawn(runs: dict[str, LoopRun]) -> None:
    whole = tuple(runs.values())
    drawn = (plot_loops(whole, bench_curves()), plot_step(whole))
    assert all(isinstance(figure, Figure) for figure in drawn)
    assert [len(figure.axes) for figure in drawn] == [18, 5]


@pytest.mark.slow
def test_without_an_encoder_the_fifth_and_seventh_harmonic_swing_the_angle() -> None:
    """In rotor coordinates both are of order 6: 150 Hz at 750 rpm with two pole pairs."""
    led = run_led()
    for run in led:
        assert run.mean == pytest.approx(1.0, abs=5e-3)
        assert run.ripple < (0.01 if run.led_by == "encoder" else 0.15)
        last = run.time >= run.time[-1] - 0.08
        lines = np.abs(np.fft.rfft(run.angle_error[last] - np.mean(run.angle_error[last])))
        step = run.time[1] - run.time[0]
        found = (np.argmax(lines[5:]) + 5) / (np.count_nonzero(last) * step)
        assert found == pytest.approx(150.0, abs=7.0)
    assert led[0].dip / RPM == pytest.approx(93.7, abs=3.0)
    assert led[1].dip > 1.1 * led[0].dip
    assert len(plot_led(led).axes) == 3


@pytest.mark.slow
@pytest.mark.parametrize("circuit", ["four-leg", "six-leg"])
def test_copper_losses_of_dqx_over_dqy_in_the_loop(circuit: str) -> None:
    """At the same constant torque; one phase missing a little below root 3."""
    expected = {
        "one phase at half amplitude": 1.0607,
        "one phase missing": 1.7318,
        "trapezoid": 1.0419,
        "shipped drive": 1.0137,
    }
    rows = loop_ratios("four-leg" if circuit == "four-leg" else "six-leg")
    assert {row.shape for row in rows} == set(expected)
    for row in rows:
        assert row.ratio == pytest.approx(expected[row.shape], abs=2e-4), row.shape
        assert row.torques == pytest.approx((1.0, 1.0), abs=1e-4), row.shape


@pytest.mark.slow
@pytest.mark.parametrize("circuit", ["four-leg", "six-leg"])
def test_copper_losses_with_every_switching_instant(circuit: str) -> None:
    """At 3 N m, where the ripple of the PWM weighs little, with 1 us of dead time."""
    expected = {
        "one phase at half amplitude": 1.0607,
        "one phase missing": 1.7318,
        "trapezoid": 1.0419,
        "shipped drive": 1.0137,
    }
    scenario = replace(STEADY, reference=constant(3.0))
    rows = loop_ratios("four-leg" if circuit == "four-leg" else "six-leg", scenario)
    for row in rows:
        assert row.ratio == pytest.approx(expected[row.shape], rel=1.5e-3), row.shape
        assert row.torques == pytest.approx((3.0, 3.0), rel=5e-3), row.shape
