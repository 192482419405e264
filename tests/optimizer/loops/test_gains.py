"""PI gains: formulas, vendor numbers, the two-rate loop against a simulated firmware,
refusals and their advice.
"""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    PerUnitBases,
    SpeedLoopSettings,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.loops.integer_gains import to_q
from dqforge.optimizer.loops.loop_gains import (
    LoopGains,
    analyse_current_loop,
    analyse_speed_loop,
    current_step_response,
    decoupling,
    per_unit,
    speed_delay,
    speed_step_response,
    tune_current_loop,
    tune_speed_loop,
)
from dqforge.optimizer.loops.pi_methods import current_pi, speed_pi
from dqforge.optimizer.loops.plants import (
    DisturbanceResponse,
    StepResponse,
    current_loop,
    current_step,
    disturbance_summary,
    speed_loop,
    speed_step,
)

FloatArray = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

# Paper 001: 12.8 A full scale, 180 V bus with space-vector modulation, 6750 rpm;
# torque base 3/2 p psi_pm 12.8 A.
BASES = PerUnitBases(
    current=12.8, voltage=180.0 / np.sqrt(3.0), speed=6750.0 * np.pi / 30.0, torque=0.27 * 12.8
)
BENCH_CURRENT = CurrentLoopSettings(
    method="given",
    kp=0.1328125 * BASES.voltage / BASES.current,
    ki=3.967285 * BASES.voltage / BASES.current,
)
BENCH_SPEED = SpeedLoopSettings(
    method="given",
    kp=19.53125 * BASES.torque / BASES.speed,
    ki=1220.703125 * BASES.torque / BASES.speed,
)


def control_settings(
    t_s: float, current: CurrentLoopSettings, speed: SpeedLoopSettings | None
) -> ControlSettings:
    return ControlSettings(
        t_s=t_s, current_loop=current, speed_loop=speed, observer=None, bases=BASES
    )


def bench_loops(machine: LinearMachine) -> tuple[LoopGains, LoopGains, ControlSettings]:
    settings_ = control_settings(200e-6, BENCH_CURRENT, BENCH_SPEED)
    q_axis = tune_current_loop(machine.r_s, machine.l_q, settings_.t_s, BENCH_CURRENT)
    return q_axis, tune_speed_loop(machine, q_axis, settings_), settings_


# --- formulas -------------------------------------------------------------------------------------


def test_current_loop_formulas() -> None:
    r_s, inductance, t_s = 0.5, 2e-3, 1e-4

    def make(**keys: Any) -> tuple[float, float]:
        return current_pi(r_s, inductance, t_s, CurrentLoopSettings(**keys))

    assert make(method="bandwidth", bandwidth=1000.0) == pytest.approx((2.0, 500.0))
    # characteristic polynomial s^2 + (R + kp)/L s + ki/L = s^2 + 2 xi w s + w^2
    kp, ki = make(method="damping", bandwidth=1000.0, damping=0.8)
    assert ((r_s + kp) / inductance, ki / inductance) == pytest.approx(
        (2 * 0.8 * 1000.0, 1000.0**2)
    )
    kp, ki = make(method="magnitude-optimum")
    assert (kp, ki / kp) == pytest.approx((inductance / (3 * t_s), r_s / inductance))
    kp, ki = make(method="symmetrical-optimum", spread=3.0)
    assert (kp, kp / ki) == pytest.approx((inductance / (4.5 * t_s), 9 * 1.5 * t_s))
    assert make(method="given", kp=1.5, ki=2.5) == (1.5, 2.5)


def test_speed_loop_formulas() -> None:
    inertia, friction, t_sum = 1e-3, 1e-4, 2e-3

    def make(**keys: Any) -> tuple[float, float]:
        return speed_pi(inertia, friction, t_sum, SpeedLoopSettings(**keys))

    kp, ki = make(method="bandwidth", bandwidth=50.0)
    np.testing.assert_allclose(np.roots([inertia, kp, ki]), [-25.0, -25.0], rtol=1e-6)
    kp, ki = make(method="damping", bandwidth=50.0, damping=0.9)
    assert ((friction + kp) / inertia, ki / inertia) == pytest.approx((2 * 0.9 * 50.0, 50.0**2))
    kp, ki = make(method="symmetrical-optimum", spread=3.0)
    assert (kp, kp / ki) == pytest.approx((inertia / (3 * t_sum), 9 * t_sum))
    assert make(method="given", kp=1.5, ki=2.5) == (1.5, 2.5)


def test_symmetrical_optimum_has_its_phase_margin_when_the_delays_are_one_lag() -> None:
    # With L = kp (1 + 1/(T_i s)) / (J s (T s + 1)) the crossover is 1/(a T) and the
    # margin atan(a) - atan(1/a).
    inertia, t_sum, spread = 1e-3, 2e-3, 3.0
    kp, ki = speed_pi(inertia, 0.0, t_sum, SpeedLoopSettings(spread=spread))
    s = 1j / (spread * t_sum)
    loop = (kp + ki / s) / (inertia * s * (t_sum * s + 1.0))
    assert abs(loop) == pytest.approx(1.0)
    assert np.angle(-loop) == pytest.approx(np.arctan(spread) - np.arctan(1 / spread))


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_damping_gives_the_gains_that_nxp_publishes(shared_data: Path) -> None:
    """Kp = 2 xi w0 L - R of 19 published headers (six digits), Ki = w0^2 L Ts times 1 or 1/2."""
    published = rows(shared_data / "vendor_gains" / "nxp_mcat_pairs.csv")
    assert len(published) == 19
    for row in published:
        asked = CurrentLoopSettings(
            method="damping",
            bandwidth=2 * np.pi * float(row["F0_current_Hz"]),
            damping=float(row["xi_current"]),
        )
        fixed = row["number_format"] != "float"
        scale = float(row["Imax_A"]) * np.sqrt(3.0) / float(row["Udcmax_V"]) if fixed else 1.0
        t_s = float(row["Ts_current_s"])
        for axis, inductance in (("D", row["Ld_H"]), ("Q", row["Lq_H"])):
            kp, ki = current_pi(float(row["Rs_ohm"]), float(inductance), t_s, asked)
            assert kp * scale == pytest.approx(float(row[f"{axis}_KP"]), rel=1e-5), row["header"]
            discrete = ki * t_s * float(row["ki_disc_factor"]) * scale
            assert discrete == pytest.approx(float(row[f"{axis}_KI"]), rel=1e-5), row["header"]


def test_bandwidth_gives_the_gains_that_st_publishes(shared_data: Path) -> None:
    """Kp = L w_c and Ki = R w_c: from the published Kp follows w_c, from it the published Ki,
    to a count or 0.3 %.
    """
    published = rows(shared_data / "vendor_gains" / "st_mcsdk_pairs.csv")
    assert len(published) == 6
    for row in published:
        inductance, r_s = float(row["Ls_H(=Lq)"]), float(row["Rs_ohm"])
        asked = CurrentLoopSettings(
            method="bandwidth", bandwidth=float(row["Kp_V_per_A"]) / inductance
        )
        kp, ki = current_pi(r_s, inductance, 1 / float(row["f_ctrl_Hz"]), asked)
        assert kp == pytest.approx(float(row["Kp_V_per_A"]))
        assert ki == pytest.approx(float(row["Ki_V_per_As"]), rel=3e-3), row["project"]


def test_bandwidth_gives_the_gains_that_vesc_detects(shared_data: Path) -> None:
    row = next(
        r for r in rows(shared_data / "vendor_gains" / "vesc_pairs.csv") if "m600" in r["file"]
    )
    asked = CurrentLoopSettings(method="bandwidth", bandwidth=1000.0)
    kp, ki = current_pi(float(row["R_ohm"]), float(row["L_H"]), 5e-5, asked)
    assert (kp, ki) == pytest.approx((float(row["kp"]), float(row["ki"])), rel=2e-4)


# --- the loops ------------------------------------------------------------------------------------


def run_firmware(  # the same drive, integrated in small steps around two velocity-form PIs
    machine: LinearMachine,
    t_s: float,
    ratio: int,
    current: tuple[float, float],
    speed: tuple[float, float],
    filter_time: float,
    reference: float,
    load: float,
    samples: int,
) -> FloatArray:
    inertia, gain, sub = machine.inertia or 0.0, machine.torque_per_ampere, 10
    i_q = omega = filtered = 0.0
    voltage = next_voltage = i_ref = speed_error = current_error = torque = 0.0
    result = np.empty(samples)
    share = 1.0 - float(np.exp(-t_s / filter_time)) if filter_time else 1.0

    def slope(x: FloatArray) -> FloatArray:
        return np.array(
            [
                (voltage - machine.r_s * x[0]) / machine.l_q,
                (gain * x[0] - machine.friction * x[1] - load) / inertia,
            ]
        )

    for k in range(samples):
        result[k] = omega
        voltage = next_voltage  # computed one period ago
        filtered += share * (omega - filtered)
        if k % ratio == 0:
            error = reference - filtered
            torque += speed[0] * (error - speed_error) + speed[1] * ratio * t_s * error
            speed_error, i_ref = error, torque / gain
        error = i_ref - i_q
        next_voltage += current[0] * (error - current_error) + current[1] * t_s * error
        current_error = error
        x, h = np.array([i_q, omega]), t_s / sub
        for _ in range(sub):  # Runge-Kutta 4
            k1 = slope(x)
            k2 = slope(x + 0.5 * h * k1)
            k3 = slope(x + 0.5 * h * k2)
            k4 = slope(x + h * k3)
            x = x + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
        i_q, omega = x
    return result


@pytest.mark.parametrize("filter_time", [0.0, 1e-3])
@pytest.mark.parametrize(("reference", "load"), [(1.0, 0.0), (0.0, 1.0)])
def test_speed_loop_is_what_the_firmware_does(
    bench001: LinearMachine, filter_time: float, reference: float, load: float
) -> None:
    speed = replace(BENCH_SPEED, filter_time=filter_time)
    control_ = control_settings(200e-6, BENCH_CURRENT, speed)
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, BENCH_CURRENT)
    gains = analyse_speed_loop(
        bench001, q_axis, control_, BENCH_SPEED.kp or 0.0, BENCH_SPEED.ki or 0.0
    )
    found = speed_step_response(bench001, q_axis, control_, gains, duration=0.06)
    expected = run_firmware(
        bench001,
        200e-6,
        10,
        (q_axis.kp, q_axis.ki),
        (gains.kp, gains.ki),
        filter_time,
        reference,
        load,
        301,
    )
    assert len(found.times) == 310  # whole periods of the speed controller
    answer = found.reference if reference else found.disturbance
    np.testing.assert_allclose(answer[:301], expected, rtol=1e-6, atol=1e-7)


def test_gains_of_paper_001_are_stable(bench001: LinearMachine) -> None:
    q_axis, speed, _ = bench_loops(bench001)
    assert q_axis.stable
    assert speed.t_s == pytest.approx(2e-3)
    assert abs(speed.poles[0]) == pytest.approx(0.947, abs=1e-3)
    assert np.degrees(speed.phase_margin) == pytest.approx(48.75, abs=0.01)


def test_one_rate_speed_loop_agrees_with_python_control(bench001: LinearMachine) -> None:
    """With ratio 1 the loop is PI x closed current loop x mechanics, which
    python-control can build by itself.
    """
    import control

    inertia = bench001.inertia or 0.0
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, CurrentLoopSettings())
    control_ = control_settings(200e-6, CurrentLoopSettings(), SpeedLoopSettings(ratio=1))
    speed = tune_speed_loop(bench001, q_axis, control_)

    # One continuous plant with the outputs torque and speed, then delay, current PI,
    # and its loop closed.
    a = np.array([[-bench001.r_s / bench001.l_q, 0.0], [1 / inertia, -bench001.friction / inertia]])
    plant = control.c2d(
        control.ss(a, [[1 / bench001.l_q], [0.0]], np.eye(2), np.zeros((2, 1))), 200e-6
    )
    delay = control.tf2ss(control.tf([1.0], [1.0, 0.0], 200e-6))
    pi = control.tf2ss(control.tf([q_axis.kp + q_axis.ki_ts, -q_axis.kp], [1.0, -1.0], 200e-6))
    forward = control.series(pi, delay, plant)
    closed = control.ss(forward.A - forward.B @ forward.C[:1], forward.B, forward.C[1:], 0, 200e-6)
    outer = control.tf2ss(control.tf([speed.kp + speed.ki_ts, -speed.kp], [1.0, -1.0], 200e-6))
    loop = control.series(outer, closed)

    gm, pm, sm, _, crossing, _ = control.stability_margins(loop, method="poly")
    assert np.degrees(speed.phase_margin) == pytest.approx(pm, rel=1e-6)
    assert speed.gain_margin == pytest.approx(gm, rel=1e-6)
    assert speed.max_sensitivity == pytest.approx(1 / sm, rel=1e-6)
    assert speed.crossover == pytest.approx(crossing, rel=1e-6)
    poles = np.sort(np.abs(np.linalg.eigvals(loop.A - loop.B @ loop.C)))[::-1]
    np.testing.assert_allclose(np.abs(speed.poles), poles, rtol=1e-6, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    crossover=st.floats(0.02, 2.0),
    zero=st.floats(0.02, 2.0),
    time_constant=st.floats(3e-4, 0.05),
)
def test_poles_tell_whether_the_simulated_loop_decays(
    crossover: float, zero: float, time_constant: float
) -> None:
    t_s, r_s = 1e-4, 0.4
    inductance = r_s * time_constant
    kp = crossover * inductance / t_s
    gains = analyse_current_loop(r_s, inductance, t_s, kp, kp * zero / t_s)
    radius = abs(gains.poles[0])
    assume(abs(radius - 1.0) > 5e-3)
    phi = np.exp(-t_s / time_constant)
    i_q, voltage, next_voltage, last = 1.0, 0.0, 0.0, 0.0
    trace = []
    for _ in range(4000):
        trace.append(abs(i_q))
        voltage = next_voltage
        next_voltage += kp * (-i_q - last) + gains.ki_ts * -i_q
        last = -i_q
        i_q = phi * i_q + (1 - phi) / r_s * voltage
        if not 1e-9 < abs(i_q) + abs(next_voltage) < 1e9:
            break
    assert gains.stable == (max(trace[-20:]) < 1e-3)


def test_step_responses_settle_where_they_should(bench001: LinearMachine) -> None:
    asked = CurrentLoopSettings(method="bandwidth", bandwidth=1000.0)
    control_ = control_settings(200e-6, asked, SpeedLoopSettings(method="damping", bandwidth=60.0))
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, asked)
    current = current_step_response(bench001.r_s, bench001.l_q, q_axis, 0.02)
    assert current.times[-1] == pytest.approx(0.02)
    assert current.reference[:3] == pytest.approx(
        [0.0, 0.0, (q_axis.kp + q_axis.ki_ts) * 0.1008], rel=1e-3
    )
    assert (current.reference[-1], current.disturbance[-1]) == pytest.approx((1.0, 0.0), abs=1e-6)
    speed = tune_speed_loop(bench001, q_axis, control_)
    motion = speed_step_response(bench001, q_axis, control_, speed, 1.0)
    assert (motion.reference[-1], motion.disturbance[-1]) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert speed.disturbance.peak == pytest.approx(np.max(np.abs(motion.disturbance)))
    late = np.abs(motion.disturbance[motion.times >= speed.disturbance.settling_time])
    assert np.all(late <= 0.02 * speed.disturbance.peak)
    just_before = np.abs(motion.disturbance[motion.times < speed.disturbance.settling_time])[-1]
    assert just_before > 0.02 * speed.disturbance.peak


def test_torque_answers_as_the_current_loop_does_whatever_the_magnet(ipm100: LinearMachine) -> None:
    asked = CurrentLoopSettings()
    q_axis = tune_current_loop(ipm100.r_s, ipm100.l_q, 1e-5, asked)
    control_ = control_settings(1e-5, asked, SpeedLoopSettings())
    speed = tune_speed_loop(ipm100, q_axis, control_)
    stronger = tune_speed_loop(replace(ipm100, psi_pm=0.3), q_axis, control_)
    np.testing.assert_array_equal(speed.poles, stronger.poles)
    assert speed.kp == stronger.kp
    assert speed_delay(q_axis, 1e-5, SpeedLoopSettings(filter_time=1e-3)) == pytest.approx(
        1 / q_axis.crossover + 5e-5 + 1e-3
    )


def test_a_filter_costs_phase_margin(bench001: LinearMachine) -> None:
    poles = []
    for filter_time in (0.0, 1e-5, 2e-3):
        model = speed_loop(
            (bench001.r_s, bench001.l_q),
            (200e-6, 40e-6),
            200e-6,
            (2.9, 3900.0),
            10,
            (0.02, 0.5),
            filter_time,
        )
        poles.append(model.loop.closed.poles)
    assert abs(poles[0][0]) == pytest.approx(abs(poles[1][0]), abs=1e-6)
    assert abs(poles[2][0]) > abs(poles[1][0])
    assert [len(found) for found in poles] == [5, 6, 6]


# --- forms and integers ---------------------------------------------------------------------------


def test_integers_of_paper_001(bench001: LinearMachine) -> None:
    """Table 8.1 and the program: 136 (Q10) and 26 (Q15) per 200 us, 20000 and 2500 (Q10) per 2
    ms.
    """
    q_axis, speed, _ = bench_loops(bench001)
    kp, ki_ts = per_unit(q_axis, BASES.current, BASES.voltage)
    assert (to_q(kp, 10), to_q(ki_ts, 15)) == (136, 26)
    kp, ki_ts = per_unit(speed, BASES.speed, BASES.torque)
    assert (to_q(kp, 10), to_q(ki_ts, 10)) == (20000, 2500)


def test_forms_of_one_controller() -> None:
    gains = analyse_current_loop(0.5, 2e-3, 1e-4, 2.0, 500.0)
    assert (gains.t_i, gains.ki_ts) == pytest.approx((4e-3, 0.05))
    assert gains.velocity == pytest.approx((2.05, -2.0))
    assert gains.anti_windup == pytest.approx(250.0)
    assert analyse_current_loop(0.5, 2e-3, 1e-4, 0.01, 500.0).anti_windup == pytest.approx(
        1e4
    )  # not below one sample
    assert gains.delay_margin_samples == pytest.approx(gains.delay_margin / 1e-4)


@pytest.mark.parametrize(
    ("value", "bits", "expected"),
    [
        (0.5 / 1024, 10, 1),
        (-0.5 / 1024, 10, -1),
        (1.5 / 1024, 10, 2),
        (2.5 / 1024, 10, 3),
        (0.0, 15, 0),
    ],
)
def test_halves_round_away_from_zero(value: float, bits: int, expected: int) -> None:
    assert to_q(value, bits) == expected


def test_integers_that_do_not_fit_are_refused() -> None:
    assert to_q(-1.0, 15) == -32768
    assert to_q(1.0, 15, 32) == 32768
    for value, bits, match in (
        (1.0, 15, "32768 in Q15, which int16_t cannot hold"),
        (1e-9, 15, "rounds to 0 in Q15"),
        (float("nan"), 15, "cannot be written"),
    ):
        with pytest.raises(NoSolutionError, match=match):
            to_q(value, bits)
    with pytest.raises(NoSolutionError, match="int32_t"):
        to_q(2.0, 30 + 1, 32)
    with pytest.raises(InputError, match="0 to 15 fractional bits, got 16"):
        to_q(0.1, 16)


def test_bases_must_be_positive() -> None:
    gains = analyse_current_loop(0.5, 2e-3, 1e-4, 2.0, 500.0)
    with pytest.raises(InputError, match="bases must be positive"):
        per_unit(gains, 0.0, 1.0)


def test_decoupling_values(bench001: LinearMachine) -> None:
    values = decoupling(bench001)
    assert (values.l_d, values.l_q, values.psi_pm) == (1.61e-3, 1.74e-3, 0.06)


# --- refusals -------------------------------------------------------------------------------------


def number_after(key: str, text: str) -> float:
    found = re.search(re.escape(key) + r" = ([0-9.e+-]+)", text)
    assert found, text
    return float(found[1])


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("settings_", "reason"),
    [
        (CurrentLoopSettings(method="bandwidth", bandwidth=8000.0), "unstable"),
        (CurrentLoopSettings(method="bandwidth", bandwidth=3500.0), "phase margin of"),
        (CurrentLoopSettings(method="damping", bandwidth=5000.0), "unstable"),
        (
            CurrentLoopSettings(method="magnitude-optimum", min_phase_margin=1.2),
            "phase margin of 62.0 deg",
        ),
    ],
)
def test_too_fast_a_current_loop_is_refused_with_the_bandwidth_that_holds(
    bench001: LinearMachine, settings_: CurrentLoopSettings, reason: str
) -> None:
    with pytest.raises(NoSolutionError, match=reason) as refusal:
        tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, settings_)
    limit = number_after("control.current_loop.bandwidth", str(refusal.value))
    method = settings_.method if settings_.method != "magnitude-optimum" else "bandwidth"
    advised = replace(settings_, method=method, bandwidth=limit)
    assert tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, advised).stable
    with pytest.raises(NoSolutionError):
        tune_current_loop(
            bench001.r_s, bench001.l_q, 200e-6, replace(advised, bandwidth=1.01 * limit)
        )


def test_too_small_a_spread_is_refused_with_the_spread_that_holds(ipm100: LinearMachine) -> None:
    asked = CurrentLoopSettings(method="symmetrical-optimum", spread=1.2)
    with pytest.raises(NoSolutionError, match="it holds from") as refusal:
        tune_current_loop(ipm100.r_s, ipm100.l_q, 1e-5, asked, "i_d")
    assert "the i_d loop" in str(refusal.value)
    spread = number_after("control.current_loop.spread", str(refusal.value))
    assert tune_current_loop(ipm100.r_s, ipm100.l_q, 1e-5, replace(asked, spread=spread)).stable
    with pytest.raises(NoSolutionError):
        tune_current_loop(ipm100.r_s, ipm100.l_q, 1e-5, replace(asked, spread=0.99 * spread))


def test_given_gains_that_are_too_high_are_refused_with_a_factor(bench001: LinearMachine) -> None:
    asked = CurrentLoopSettings(method="given", kp=20.0, ki=100.0)
    with pytest.raises(NoSolutionError, match="unstable") as refusal:
        tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, asked)
    factor = float(re.search(r"by ([0-9.]+) or less", str(refusal.value))[1])  # type: ignore[index]
    assert tune_current_loop(
        bench001.r_s, bench001.l_q, 200e-6, replace(asked, kp=20 * factor, ki=100 * factor)
    ).stable


def test_no_advice_is_given_where_none_holds(ipm100: LinearMachine) -> None:
    asked = CurrentLoopSettings(method="given", kp=1.0, ki=1e9)
    with pytest.raises(NoSolutionError, match="no smaller gains of this method reach it"):
        tune_current_loop(0.0, ipm100.l_q, 1e-5, asked)


def test_too_fast_a_speed_loop_is_refused_with_the_bandwidth_that_holds(
    bench001: LinearMachine,
) -> None:
    current = CurrentLoopSettings()
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, current)
    asked = SpeedLoopSettings(method="damping", bandwidth=2000.0)
    with pytest.raises(
        NoSolutionError, match="the speed loop by method 'damping' is unstable"
    ) as refusal:
        tune_speed_loop(bench001, q_axis, control_settings(200e-6, current, asked))
    limit = number_after("control.speed_loop.bandwidth", str(refusal.value))
    assert tune_speed_loop(
        bench001, q_axis, control_settings(200e-6, current, replace(asked, bandwidth=limit))
    ).stable


def test_damping_too_slow_for_the_winding_says_the_least_frequency(bench001: LinearMachine) -> None:
    asked = CurrentLoopSettings(method="damping", bandwidth=100.0)
    with pytest.raises(
        NoSolutionError, match=r"kp is positive from control\.current_loop\.bandwidth above 956"
    ):
        tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, asked)  # R/(2 xi L) = 955.0 rad/s


def test_gains_without_resistance_are_refused(ipm100: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match="both must be positive"):
        tune_current_loop(0.0, ipm100.l_q, 1e-5, CurrentLoopSettings())


@pytest.mark.parametrize(
    ("settings_", "key"),
    [
        (CurrentLoopSettings(method="bandwidth"), "control.current_loop.bandwidth is missing"),
        (CurrentLoopSettings(method="damping"), "control.current_loop.bandwidth is missing"),
        (CurrentLoopSettings(method="given", ki=1.0), "control.current_loop.kp is missing"),
        (CurrentLoopSettings(method="given", kp=1.0), "control.current_loop.ki is missing"),
        (
            CurrentLoopSettings(method="bandwidth", bandwidth=-1.0),
            "control.current_loop.bandwidth must be positive",
        ),
        (
            CurrentLoopSettings(method="symmetrical-optimum", spread=0.0),
            "control.current_loop.spread must be positive",
        ),
    ],
)
def test_missing_settings_are_named(settings_: CurrentLoopSettings, key: str) -> None:
    with pytest.raises(InputError, match=re.escape(key)):
        tune_current_loop(1.0, 1e-3, 1e-4, settings_)


def test_speed_loop_needs_inertia_settings_and_a_ratio(bench001: LinearMachine) -> None:
    current = CurrentLoopSettings()
    q_axis = tune_current_loop(bench001.r_s, bench001.l_q, 200e-6, current)
    with pytest.raises(InputError, match=r"needs machine\.inertia"):
        tune_speed_loop(
            replace(bench001, inertia=None),
            q_axis,
            control_settings(200e-6, current, SpeedLoopSettings()),
        )
    with pytest.raises(InputError, match=r"control\.speed_loop is missing"):
        tune_speed_loop(bench001, q_axis, control_settings(200e-6, current, None))
    with pytest.raises(InputError, match="ratio must be 1 or more, got 0"):
        tune_speed_loop(
            bench001, q_axis, control_settings(200e-6, current, SpeedLoopSettings(ratio=0))
        )
    with pytest.raises(InputError, match=r"control\.speed_loop\.bandwidth is missing"):
        tune_speed_loop(
            bench001,
            q_axis,
            control_settings(200e-6, current, SpeedLoopSettings(method="bandwidth")),
        )


def test_gains_too_small_for_any_crossover_are_refused(bench001: LinearMachine) -> None:
    with pytest.raises(NoSolutionError, match="i_q loop has no gain crossover"):
        tune_current_loop(
            bench001.r_s, bench001.l_q, 1e-4, CurrentLoopSettings(method="given", kp=1e-6, ki=1e-6)
        )


def test_a_loop_that_settles_beyond_the_response_has_no_settling_time() -> None:
    times = np.arange(4.0)
    reference = np.zeros(4)
    slow = StepResponse(times, reference, np.array([0.0, 1.0, 0.9, 0.8]))
    assert disturbance_summary(slow) == DisturbanceResponse(peak=1.0, settling_time=np.inf)
    settled = StepResponse(times, reference, np.array([0.0, 1.0, 0.019, 0.02]))
    assert disturbance_summary(settled) == DisturbanceResponse(peak=1.0, settling_time=2.0)


def test_long_step_responses_are_thinned_not_changed(bench001: LinearMachine) -> None:
    """Every third sample of the long response is a point of the thin one,
    for the current as for the speed.
    """
    q_axis, speed, control_ = bench_loops(bench001)
    axis = current_loop(bench001.r_s, bench001.l_q, 200e-6, q_axis.kp, q_axis.ki)
    drive = speed_loop(
        (bench001.r_s, bench001.l_q),
        (bench001.inertia or 0.0, bench001.friction),
        200e-6,
        (q_axis.kp, q_axis.ki),
        10,
        (speed.kp, speed.ki),
    )
    for full, thin, step in (
        (current_step(axis, 61), current_step(axis, 21, 3), 3),
        (speed_step(drive, 61), speed_step(drive, 21, 3), 30),
    ):
        np.testing.assert_allclose(thin.times, full.times[::step][:21], rtol=1e-12)
        np.testing.assert_allclose(thin.reference, full.reference[::step][:21], atol=1e-12)
        np.testing.assert_allclose(thin.disturbance, full.disturbance[::step][:21], atol=1e-12)
    endless = speed_step_response(bench001, q_axis, control_, speed, 1000.0)
    assert len(endless.times) <= 20_001
    assert endless.times[-1] == pytest.approx(1000.0, rel=1e-3)
    assert endless.reference[-1] == pytest.approx(1.0, abs=1e-9)
