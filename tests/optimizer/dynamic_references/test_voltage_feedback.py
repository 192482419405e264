"""Field weakening by voltage feedback: its loop against a simulation of its equations, and what it
needs of a drive that is off its map.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    ReferenceSettings,
    SpeedLoopSettings,
    Tolerances,
    VoltageFeedbackSettings,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.dynamic_references import (
    VoltageFeedback,
    current_of_no_flux,
    dynamic_references,
    feedback_matrices,
    limit_points,
    require_feedback,
    voltage_feedback,
)
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, inductance_range
from dqforge.optimizer.loops.robustness import drive_box

T_S = 1e-4
OMEGA = 2400.0  # electrical
FLOW = np.array([0.3e-3, 0.7e-3])
MACHINE = LinearMachine(
    pole_pairs=4, r_s=0.05, l_d=0.3e-3, l_q=0.7e-3, psi_pm=0.06, i_max=100.0, omega_m_max=800.0
)


def designed(
    bandwidth: float, tolerances: Tolerances | None = None, current: float | None = None
) -> Design:
    base = make_design(MACHINE)
    references = ReferenceSettings(
        voltage_feedback=VoltageFeedbackSettings(bandwidth=bandwidth, current=current)
    )
    control = replace(
        base.control,
        t_s=T_S,
        current_loop=CurrentLoopSettings("magnitude-optimum"),
        speed_loop=None,
        observer=None,
        references=references,
        tolerances=tolerances,
    )
    return replace(base, control=control, inverter=Inverter(300.0, 1.0 / T_S), losses=None)


def judged(design: Design) -> VoltageFeedback:
    gains = solve_gains(design)
    box = drive_box(design, *inductance_range(design.machine, design.i_max))
    return voltage_feedback(design, box, (gains.i_d, gains.i_q), design.v_max)


def test_operating_points_take_all_of_the_voltage_and_no_more() -> None:
    design = designed(500.0)
    points = limit_points(MACHINE, 100.0, design.v_max, 800.0)
    omega = 4.0 * points.omega_m
    v_d = 0.05 * points.i_d - omega * 0.7e-3 * points.i_q
    v_q = 0.05 * points.i_q + omega * (0.06 + 0.3e-3 * points.i_d)
    np.testing.assert_allclose(np.hypot(v_d, v_q), design.v_max, rtol=1e-6)
    assert points.torque.size > 40
    assert (np.sign(points.torque).min(), np.sign(points.torque).max()) == (-1.0, 1.0)


PARTS = 20


def slope(held: FloatArray, current: FloatArray, place: float) -> FloatArray:
    """Slope of the currents under a voltage that rests in the stator, at a place of its period."""
    turn = OMEGA * T_S * (0.5 - place / PARTS)
    c, s = math.cos(turn), math.sin(turn)
    back = np.array([0.7e-3 * current[1], -0.3e-3 * current[0] - 0.06])
    v = np.array([c * held[0] - s * held[1], s * held[0] + c * held[1]])
    return np.asarray((v - 0.05 * current + OMEGA * back) / FLOW)


def stepped(gain: float, steps: int) -> FloatArray:
    """Currents, voltages asked for, and what the feedback adds, shape (steps, 5)."""
    omega, i = OMEGA, np.array([-80.0, 40.0])
    v_0 = np.array(
        [0.05 * i[0] - omega * 0.7e-3 * i[1], 0.05 * i[1] + omega * (0.06 + 0.3e-3 * i[0])]
    )
    kp, ki = FLOW / (3.0 * T_S), np.array([0.05, 0.05]) / 3.0
    limit = float(np.hypot(*v_0))
    reference = i + np.array([1.0, 0.0])  # the map asks for one ampere too little
    current, acting, asked = i.copy(), v_0.copy(), v_0.copy()
    integral = v_0 - np.array([-omega * 0.7e-3 * i[1], omega * (0.3e-3 * i[0] + 0.06)])
    added, found = 0.0, []
    for _ in range(steps):
        added = min(0.0, added + gain * (limit**2 - asked @ asked) / (2.0 * limit))
        error = reference + np.array([added, 0.0]) - current
        feed = omega * np.array([-0.7e-3 * current[1], 0.3e-3 * current[0] + 0.06])
        held, acting = acting, kp * error + integral + ki * error + feed
        integral = integral + ki * error
        asked = acting
        for place in range(PARTS):
            half = current + 0.5 * slope(held, current, place) * T_S / PARTS
            current = current + slope(held, half, place + 0.5) * T_S / PARTS
        found.append([*current, *asked, added])
    return np.array(found)


def test_the_sampled_loop_is_that_of_its_equations() -> None:
    """The decay of a simulation of the nonlinear equations is the slowest pole of the matrix."""
    gain = 2.0 * math.pi * 40.0 * T_S / (2400.0 * 0.3e-3)
    omega = OMEGA
    i = np.array([-80.0, 40.0])
    v_0 = np.array(
        [0.05 * i[0] - omega * 0.7e-3 * i[1], 0.05 * i[1] + omega * (0.06 + 0.3e-3 * i[0])]
    )
    one = np.ones(1)
    machines = TurningMachines(0.05 * one, 0.3e-3 * one, 0.7e-3 * one, one, omega * one)
    control = CurrentControl(
        (0.3e-3 / (3.0 * T_S), 0.7e-3 / (3.0 * T_S)),
        (0.05 / 3.0, 0.05 / 3.0),
        0.3e-3,
        0.7e-3,
        1.5 * T_S,
        T_S,
    )
    matrix = feedback_matrices(machines, control, (v_0 / np.hypot(*v_0))[None], gain)[0]
    run = stepped(gain, 2200)
    # it takes away what was too little: the voltage asked for comes to its limit
    assert np.max(np.hypot(run[:50, 2], run[:50, 3])) > 1.0001 * float(np.hypot(*v_0))
    assert math.hypot(*run[-1, 2:4]) == pytest.approx(float(np.hypot(*v_0)), rel=1e-6)
    away = run[:, 4] - run[-1, 4]
    slowest = np.sort(np.abs(np.linalg.eigvals(matrix)))[::-1]
    shares = away[850:900] / away[849:899]
    assert float(np.median(shares)) == pytest.approx(float(slowest[0]), abs=2e-5)


def test_gain_margin_is_where_the_equations_oscillate() -> None:
    """Just below and just above the gain at which the matrix has a pole on the unit circle."""
    found = judged(designed(2.0 * math.pi * 20.0))
    assert 0.9 < found.largest_pole < 1.0
    assert found.bandwidth[1] <= 2.0 * math.pi * 20.0 * (1.0 + 1e-9)
    assert 3.0 < found.gain_margin < math.inf
    with pytest.raises(NoSolutionError, match="bandwidth"):
        judged(designed(2.0 * math.pi * 20.0 * 1.05 * found.gain_margin))
    assert judged(designed(2.0 * math.pi * 20.0 * 0.95 * found.gain_margin)).largest_pole < 1.0


def test_an_unstable_bandwidth_names_one_that_holds() -> None:
    with pytest.raises(NoSolutionError, match=r"voltage_feedback\.bandwidth: ") as refused:
        judged(designed(2.0 * math.pi * 2000.0))
    advice = re.search(r"write bandwidth: ([0-9.e+]+) Hz", str(refused.value))
    assert advice is not None
    found = judged(designed(2.0 * math.pi * float(advice[1])))
    assert found.largest_pole < 1.0
    assert 1.0 < found.gain_margin < 1.2  # not needlessly slow


def test_a_stronger_magnet_lacks_voltage_and_more_current_gives_it_back() -> None:
    found = judged(designed(100.0, Tolerances(psi_pm=0.05, l_q=0.1))).worst
    assert found is not None
    assert "psi_pm +5 %" in found.text
    omega = 4.0 * found.omega_m
    points = limit_points(MACHINE, 100.0, designed(100.0).v_max, 800.0)
    place = np.flatnonzero((points.omega_m == found.omega_m) & (points.torque == found.torque))[0]
    i_d, i_q = float(points.i_d[place]), float(points.i_q[place])
    l_q = 0.7e-3 * (1.1 if "l_q +10 %" in found.text else 0.9)

    def voltage(i_d: float, i_q: float) -> float:
        return math.hypot(
            0.05 * i_d - omega * l_q * i_q, 0.05 * i_q + omega * (0.063 + 0.3e-3 * i_d)
        )

    v_max = designed(100.0).v_max
    assert voltage(i_d, i_q) - v_max == pytest.approx(found.missing, rel=1e-6)
    assert found.missing > 3.0
    d = i_d - found.current
    q = math.copysign(min(abs(i_q), math.sqrt(100.0**2 - d * d)), i_q)
    assert voltage(d, q) <= v_max * (1.0 + 1e-9)
    assert voltage(d + 0.02 * found.current, i_q) > v_max * 0.999
    assert 0.5 < found.kept <= 1.05


def test_a_current_that_turns_the_flux_is_refused() -> None:
    with pytest.raises(InputError, match=r"weakest magnet.*write current: "):
        judged(designed(100.0, Tolerances(psi_pm=0.05), current=2000.0))


def test_what_is_refused_is_refused_without_any_gains() -> None:
    with pytest.raises(InputError, match=r"weakest magnet.*write current: "):
        require_feedback(designed(100.0, Tolerances(psi_pm=0.05), current=2000.0))
    with pytest.raises(InputError, match="limits nothing"):
        require_feedback(replace(designed(100.0), machine=replace(MACHINE, omega_m_max=50.0)))
    require_feedback(designed(100.0))


def test_all_that_the_limit_leaves_does_not_turn_the_flux() -> None:
    design = designed(100.0, Tolerances(psi_pm=0.05))
    machine = replace(MACHINE, i_max=250.0, omega_m_max=300.0)
    found = judged(replace(design, machine=machine))
    assert 0.95 * MACHINE.psi_pm - MACHINE.l_d * 250.0 < 0.0, "the limit alone would turn it"
    mapped = float(np.min(limit_points(machine, 250.0, design.v_max, 300.0).i_d))
    assert found.current > 1.0
    assert 0.95 * MACHINE.psi_pm + MACHINE.l_d * (mapped - found.current) > 0.0


def test_a_voltage_that_limits_nothing_is_refused() -> None:
    slow = replace(MACHINE, omega_m_max=50.0)
    design = designed(100.0)
    with pytest.raises(InputError, match="limits nothing"):
        judged(replace(design, machine=slow))


@pytest.mark.parametrize("torque_slope", [None, 400.0, 9e4])
@pytest.mark.parametrize("current_slope", [None, 5e3])
def test_the_numbers_of_moving_references_are_those_of_their_slopes(
    torque_slope: float | None, current_slope: float | None
) -> None:
    """The largest torque by brute force on the limit circle; the answered step by the speed loop
    written out here with the torque on its slope.
    """
    design = designed(200.0)
    wanted = ReferenceSettings(torque_slope, current_slope)
    loop = SpeedLoopSettings(ratio=4)
    machine = replace(MACHINE, inertia=2e-3, friction=1e-3)
    control = replace(design.control, references=wanted, speed_loop=loop)
    design = replace(design, control=control, machine=machine)
    gains = solve_gains(design)
    assert gains.speed is not None
    box = drive_box(design, *inductance_range(design.machine, design.i_max))
    found = dynamic_references(design, box, (gains.i_d, gains.i_q), gains.speed)
    if torque_slope is None and current_slope is None:
        assert found is None
        return
    assert found is not None
    angle = np.linspace(0.5 * np.pi, np.pi, 20_001)
    i_d, i_q = 100.0 * np.cos(angle), 100.0 * np.sin(angle)
    most = float(np.max(1.5 * 4.0 * (0.06 + (0.3e-3 - 0.7e-3) * i_d) * i_q))
    assert found.settings == wanted
    assert found.torque_step == (np.inf if torque_slope is None else torque_slope * T_S)
    assert found.current_step == (np.inf if current_slope is None else current_slope * T_S)
    expected = 0.0 if torque_slope is None else most / torque_slope
    assert found.torque_time == pytest.approx(expected, rel=1e-6)
    assert found.slope_at_rest == pytest.approx(design.v_max / 0.7e-3, rel=1e-9)
    assert found.feedback is None
    if torque_slope is None:
        assert np.isnan(found.speed_step)
        return

    def settles(step: float, slope: float) -> bool:
        """The linear drive with a limited torque that moves along its slope."""
        speed, omega, torque, before, integral, away = gains.speed, 0.0, 0.0, 0.0, 0.0, 0.0
        assert speed is not None
        periods = int((30.0 / speed.crossover + 4.0 * 800.0 * 2e-3 / most) / speed.t_s) + 1
        for k in range(periods):
            error = step - omega
            integral += speed.ki_ts * error
            asked = speed.kp * error + integral
            given = min(max(asked, torque - slope * speed.t_s), torque + slope * speed.t_s)
            given = min(max(given, -most), most)
            integral += speed.anti_windup * speed.t_s * (given - asked)
            middle, before, torque = 0.5 * (before + torque), torque, given
            omega += speed.t_s / 2e-3 * (middle - 1e-3 * omega)
            if k > periods - 10.0 / (speed.crossover * speed.t_s):
                away = max(away, abs(omega - step))
        return away < 0.05 * step

    assert settles(0.98 * found.speed_step, torque_slope)
    steps = np.geomspace(1e-3, 1.0, 41) * 800.0
    lost = [step for step in steps if settles(step, np.inf) and not settles(step, torque_slope)]
    if lost:
        assert found.speed_step <= lost[0] * 1.001
        assert found.speed_step >= 0.8 * lost[0]
    else:
        assert found.speed_step == pytest.approx(800.0)


WIDE = Tolerances(l_d=0.1, l_q=0.2, psi_pm=0.05, v_dc=0.04)


def simply_judged(design: Design) -> VoltageFeedback:
    """With the gains of the data, whatever the tolerances do to their margins."""
    gains = solve_gains(designed(100.0))
    box = drive_box(design, (0.3e-3, 0.7e-3), (0.3e-3, 0.7e-3))
    return voltage_feedback(design, box, (gains.i_d, gains.i_q), design.v_max)


def corners() -> list[tuple[float, ...]]:
    """Factors of l_d, l_q, psi_pm and v_dc, and the data themselves."""
    sides = [(1.0 - x, 1.0 + x) for x in (0.1, 0.2, 0.05, 0.04)]
    return [*itertools.product(*sides), (1.0,) * 4]


def test_the_feedback_is_judged_at_every_point_and_corner() -> None:
    """Bandwidths from the slope of the voltage over i_d, poles of every drive at every operating
    point, one by one."""
    bandwidth = 2.0 * math.pi * 30.0
    design = designed(bandwidth, WIDE)
    found = simply_judged(design)
    points = limit_points(MACHINE, 100.0, design.v_max, 800.0)
    omega = 4.0 * points.omega_m
    assert found.gain == pytest.approx(bandwidth * T_S / (3200.0 * 0.3e-3))
    assert (found.i_max, found.voltage) == (100.0, design.v_max)
    v = np.column_stack(
        [
            0.05 * points.i_d - omega * 0.7e-3 * points.i_q,
            0.05 * points.i_q + omega * (0.06 + 0.3e-3 * points.i_d),
        ]
    )
    h = 1e-6
    further = np.hypot(
        v[:, 0] - 0.05 * h, v[:, 1] - omega * 0.3e-3 * h
    )  # of the reactance alone below
    size = np.hypot(*v.T)
    slope = np.abs(omega * 0.3e-3 * v[:, 1] / size)
    assert np.allclose((size - further) / h, slope, rtol=0.2)
    rates = found.gain * slope / T_S
    assert found.bandwidth == pytest.approx((rates.min(), rates.max()), rel=1e-9)
    loops = solve_gains(designed(100.0))
    control = CurrentControl(
        (loops.i_d.kp, loops.i_q.kp), (loops.i_d.ki_ts, loops.i_q.ki_ts), 0.3e-3, 0.7e-3,
        1.5 * T_S, T_S,
    )  # fmt: skip
    one = np.ones(omega.size)
    matrices = [
        TurningMachines(0.05 * one, 0.3e-3 * d * one, 0.7e-3 * q * one, link * one, omega)
        for d, q, psi, link in corners()
        if psi <= 1.0
    ]

    def largest(gain: float) -> float:
        return max(
            float(
                np.max(
                    np.abs(
                        np.linalg.eigvals(feedback_matrices(m, control, v / size[:, None], gain))
                    )
                )
            )
            for m in matrices
        )

    assert found.largest_pole == pytest.approx(largest(found.gain), abs=1e-9)
    assert largest(found.gain * found.gain_margin / 1.011) < 1.0
    assert largest(found.gain * found.gain_margin * 1.011) > 1.0


def test_the_drive_that_lacks_most_voltage_is_sought_among_all() -> None:
    """Every corner and operating point; more d current until the voltage is enough, the q current
    on the circle, and what is left of the torque."""
    design = designed(100.0, WIDE, current=12.0)
    found = simply_judged(design)
    assert found.current == 12.0
    points = limit_points(MACHINE, 100.0, design.v_max, 800.0)
    omega = 4.0 * points.omega_m
    added = np.linspace(0.0, 12.0, 101)[:, None]
    d = points.i_d - added
    q = np.sign(points.i_q) * np.minimum(np.abs(points.i_q), np.sqrt(np.maximum(1e4 - d * d, 0.0)))
    most: tuple[float, ...] = (-np.inf,)
    for l_d, l_q, psi, link in corners():
        flux_d, flux_q = psi * 0.06 + l_d * 0.3e-3 * d, l_q * 0.7e-3 * q
        v = np.hypot(0.05 * d - omega * flux_q, 0.05 * q + omega * flux_d)
        lacks = v - link * design.v_max
        place = int(np.argmax(lacks[0]))
        if lacks[0, place] > most[0]:
            torque = 6.0 * (flux_d * q - flux_q * d)[:, place]
            enough = np.flatnonzero(lacks[:, place] <= 0.0)
            k = int(enough[0]) if enough.size else -1
            most = (
                float(lacks[0, place]),
                float(points.torque[place]),
                float(points.omega_m[place]),
                float(added[k, 0]) if enough.size else math.nan,
                float(torque[k] / torque[0]) if torque[0] else 1.0,
            )
    worst = found.worst
    assert worst is not None
    got = worst.missing, worst.torque, worst.omega_m, worst.current, worst.kept
    assert got == pytest.approx(most, rel=1e-9, nan_ok=True)
    assert simply_judged(designed(100.0)).worst is None


def test_the_current_leaves_the_weakest_magnet_some_flux() -> None:
    """All that the limit leaves where the flux stays, else nine tenths of the way to none."""
    assert simply_judged(designed(100.0)).current == pytest.approx(
        100.0 + float(np.min(limit_points(MACHINE, 100.0, designed(100.0).v_max, 800.0).i_d))
    )
    machine = replace(MACHINE, i_max=250.0, omega_m_max=300.0)
    design = replace(designed(100.0, Tolerances(psi_pm=0.05)), machine=machine)
    least = float(np.min(limit_points(machine, 250.0, design.v_max, 300.0).i_d))
    assert simply_judged(design).current == pytest.approx(
        0.9 * (least + 0.95 * 0.06 / 0.3e-3), rel=1e-6
    )
    assert current_of_no_flux(MACHINE, 0.95) == pytest.approx(-190.0)
