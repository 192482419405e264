"""Six-step drives in the time domain: instants against the formula, currents against circuits that
are integrated here, start, faults.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from six_step_drives import BENCH, bench

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.six_step.control import FAULT, RAMP, RUNNING
from dqforge.optimizer.six_step.design import solve_six_step
from dqforge.reports.simulation.recorded_run import Simulation
from dqforge.reports.six_step.drive_run import commutations, simulate_six_step

METHODS = ("zero-crossing", "emf-integration", "diode-conduction")
SALIENT = (
    ("zero-crossing", 1.5, 1.85, -1),
    ("emf-integration", 1.5, 1.85, -1),
    ("zero-crossing", 1.85, 1.5, 1),
)
WAVES = """
  model: waveform
  pole_pairs: 2
  resistance: 1 Ohm
  self_inductance: 3 mH
  back_emf:
    harmonics:
      - {order: 1, amplitude: {value: 0.1 Wb, kind: peak}}
      - {order: 3, share: 15 %}
      - {order: 5, share: 4 %}
  max_current: {value: 8 A, kind: peak}
  max_speed: 3000 rpm
  inertia: 4e-4 kg m^2
"""


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("method", "way"), [("zero-crossing", 1), ("emf-integration", -1), ("diode-conduction", -1)]
)
def test_a_turning_rotor_is_caught_and_commutated_as_designed(method: str, way: int) -> None:
    design = bench(
        f"control.observer.method={method}",
        f"simulation.torque.points[0].torque={0.5 * way} N m",
        f"simulation.shaft.points[0].speed={1500 * way} rpm",
    )
    found = simulate_six_step(design)
    figures = found.six_step
    assert figures is not None
    assert figures.started is not None
    assert figures.started < 0.02
    assert (figures.stage, figures.fault) == ("running", "none")
    assert figures.commutations > 20
    assert figures.error_largest is not None
    assert figures.predicted is not None
    assert figures.error_largest <= figures.predicted
    blocks = found.run.blocks
    assert blocks is not None
    settled = found.run.t > 0.06
    # Not with the electrical torque of a dq controller: blocks of 0.5 N m have 13.8 % of ripple.
    assert np.mean(found.run.torque[settled]) == pytest.approx(0.5 * way, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "l_d", "l_q", "way"), SALIENT)
def test_saliency_shifts_the_instants_within_the_formula(
    method: str, l_d: float, l_q: float, way: int
) -> None:
    quiet = "control.six_step={voltage_offset: 1 mV, voltage_noise: 1 mV, voltage_bits: 16}"
    found = simulate_six_step(
        bench(
            quiet,
            f"control.observer.method={method}",
            f"machine.inductance_d={l_d} mH",
            f"machine.inductance_q={l_q} mH",
            "simulation.duration=60 ms",
            "simulation.torque.points[0].torque=1.2 N m",
            "simulation.shaft.points[0].speed=4000 rpm",
        )
    )
    figures = found.six_step
    assert figures is not None
    assert figures.error_mean is not None
    assert figures.error_largest is not None
    assert figures.predicted is not None
    assert figures.error_largest <= figures.predicted
    # With L_q the larger one the voltage that the current induces brings the crossing forward.
    assert way * figures.error_mean > 0.3 * 0.35e-3 * 4.0 / 0.06


@pytest.mark.slow
def test_an_offset_shows_in_the_instants_as_the_formula_says() -> None:
    settings = (
        "control.six_step={voltage_offset: 1.2 V, voltage_noise: 1 mV, voltage_bits: 16}",
        "control.observer.method=emf-integration",
    )
    design = bench(*settings)
    found = simulate_six_step(design)
    made = solve_six_step(design)
    assert made is not None
    _, late = commutations(made, found.run)
    omega = 3.0 * math.pi * 1500.0 / 30.0
    shift = math.pi / 3.0 * 1.2 / (0.06 * omega)
    grid = 0.5 * omega * 5e-5
    assert np.max(np.abs(late)) == pytest.approx(shift, abs=1.1 * grid)
    assert abs(np.mean(late)) < 0.5 * grid


DEVICE = """inverter.device={kind: mosfet, on_resistance: 50 mOhm, diode_voltage: 3 V,
 diode_resistance: 0 Ohm, turn_on_energy: 1 mJ, turn_off_energy: 1 mJ, reference_current: 10 A,
 reference_voltage: 300 V, thermal_resistance: 1 K/W}""".replace("\n", "")


@pytest.mark.thinned
@pytest.mark.parametrize("wrong", [0.0, 1.0, -1.0])
def test_the_threshold_of_a_diode_is_compensated_but_for_its_error(wrong: float) -> None:
    """Conduction begins (V_F + dV)/(1.5 psi omega) behind the crossing; V_F is known, and what is
    not known shifts crossing and, by a delay counted from both, nothing else.
    """
    design = bench(
        "control.observer.method=diode-conduction",
        f"control.six_step={{voltage_offset: {abs(wrong)} V}}",
        DEVICE if wrong >= 0.0 else DEVICE.replace("3 V", "1 V"),
        "simulation.shaft.points[0].speed=600 rpm",
        "simulation.duration=0.2 s",
    )
    made = solve_six_step(design)
    assert made is not None
    if wrong < 0.0:  # the design counts on more than there is
        counted = 3.0 * made.gains.observer.late if made.gains.observer.late else 0.0
        made = replace(
            made,
            gains=replace(made.gains, observer=replace(made.gains.observer, late=counted)),
            disturbed=replace(made.disturbed, offset=1.0 / 1.5),
        )
    run = simulate_six_step(design, found=made).run
    omega = 3.0 * math.pi * 600.0 / 30.0
    _, late = commutations(made, run)
    per_volt = 1.0 / (1.5 * 0.06 * omega)
    volts = {0.0: 0.0, 1.0: 1.0, -1.0: 1.0 + 1.0 - 3.0}[wrong]
    assert late.size > 10
    assert np.mean(late) == pytest.approx(volts * per_volt, abs=1.1 * omega * 5e-5)


def _potentials(high: float, low: float, fed: int, back: int) -> list[float | None]:
    v: list[float | None] = [None, None, None]
    v[fed], v[back] = high, low
    return v


class _Circuit:
    """Three phases in star, equal R and L, sine EMF at a constant speed, ideal switches and diodes.

    ``v`` are the potentials of the terminals in V, None where a leg rests.
    """

    def __init__(self, r: float, inductance: float, psi: float, omega: float, v_dc: float) -> None:
        self.r, self.inductance, self.psi, self.omega, self.v_dc = r, inductance, psi, omega, v_dc

    def emf(self, theta: float) -> FloatArray:
        lag = theta - 2.0 * np.pi / 3.0 * np.arange(3)
        return np.asarray(-self.psi * self.omega * np.sin(lag))

    def slopes(self, i: FloatArray, theta: float, v: list[float | None]) -> FloatArray:
        push = np.array([(v[k] or 0.0) - self.r * i[k] for k in range(3)]) - self.emf(theta)
        on = np.array([value is not None for value in v])
        push -= np.mean(push[on])
        return np.where(on, push / self.inductance, 0.0)

    def open_end(self, i: FloatArray, theta: float, v: list[float | None], k: int) -> float:
        """Potential of a terminal without current."""
        e = self.emf(theta)
        on = [n for n in range(3) if v[n] is not None]
        star = np.mean([(v[n] or 0.0) - self.r * i[n] - e[n] for n in on])
        return float(star + e[k])

    def run(self, i: FloatArray, theta: float, v: list[float | None], time: float) -> FloatArray:
        """Currents after a time under fixed switches; the diodes choose by themselves."""
        i, now = i.copy(), 0.0
        resting = [k for k in range(3) if v[k] is None]
        while time - now > 1e-15:
            held = list(v)
            for k in resting:
                if abs(i[k]) > 1e-9:
                    held[k] = 0.0 if i[k] > 0.0 else self.v_dc
                else:
                    i[k] = 0.0
                    end = self.open_end(i, theta + self.omega * now, held, k)
                    held[k] = (
                        0.0 if end < -1e-9 else (self.v_dc if end > self.v_dc + 1e-9 else None)
                    )
            k = resting[0]
            begun = now

            def watched(
                t: float,
                y: FloatArray,
                held: list[float | None] = held,
                begun: float = begun,
                k: int = k,
            ) -> float:
                if held[k] is not None:
                    return float(y[k]) if t > 1e-9 else 1.0
                end = self.open_end(y, theta + self.omega * (begun + t), held, k)
                return min(end + 2e-9, self.v_dc + 2e-9 - end)

            def changed(
                t: float, y: FloatArray, held: list[float | None] = held, begun: float = begun
            ) -> FloatArray:
                return self.slopes(y, theta + self.omega * (begun + t), held)

            watched.terminal = True  # type: ignore[attr-defined]
            done = solve_ivp(
                changed, (0.0, time - now), i, events=watched, rtol=1e-9, atol=1e-10, max_step=5e-6
            )
            i = done.y[:, -1]
            now += done.t[-1]
            if done.status == 1 and held[k] is not None:
                i[k] = 0.0
                rest = [n for n in range(3) if n != k]
                i[rest] -= np.mean(i[rest])
        return i


def _replayed(run: Simulation, first: int, periods: int, r: float, inductance: float) -> FloatArray:
    """Currents at the samples, from those of the first on, by the legs that the run recorded."""
    record = run.phases
    assert record is not None
    omega = 3.0 * math.pi * 1500.0 / 30.0
    circuit = _Circuit(r, inductance, 0.06, omega, 214.0)
    t_s, i = 5e-5, record.i_phases[first].copy()
    found = [i]
    for k in range(first, first + periods):
        duty, theta = run.duty[k], float(run.theta_e[k])
        fed = int(np.nanargmax(duty))
        back = next(n for n in range(3) if n != fed and np.isfinite(duty[n]))
        d = float(duty[fed])
        off, on = 0.5 * (1.0 - d) * t_s, d * t_s
        i = circuit.run(i, theta, _potentials(0.0, 0.0, fed, back), off)
        i = circuit.run(i, theta + omega * off, _potentials(214.0, 0.0, fed, back), on)
        i = circuit.run(i, theta + omega * (off + on), _potentials(0.0, 0.0, fed, back), off)
        found.append(i)
    return np.array(found)


@pytest.mark.slow
def test_currents_are_those_of_the_circuit_that_conducts() -> None:
    found = simulate_six_step(bench("simulation.duration=60 ms"))
    blocks, record = found.run.blocks, found.run.phases
    assert blocks is not None
    assert record is not None
    running = np.flatnonzero((found.run.t > 0.04) & (blocks.stage == RUNNING))
    changed = running[np.flatnonzero(np.diff(blocks.sector[running]) != 0.0)[2]]
    first, periods = (
        int(changed) - 3,
        45,
    )  # a commutation with its freewheeling, and most of a block
    mine = _replayed(found.run, first, periods, 2.35, 1.675e-3)
    theirs = record.i_phases[first : first + periods + 1]
    assert np.max(np.abs(theirs)) > 1.0
    assert np.max(np.abs(mine - theirs)) < 2e-3 * np.max(np.abs(theirs))
    # The phase that is switched off dies out and floats; below the crossing its diode leaks.
    assert np.any(np.all(np.abs(theirs) > 0.1, axis=1))
    assert np.any(np.min(np.abs(theirs), axis=1) == 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("share", "starts"), [(0.95, True), (2.5, False)])
def test_the_largest_load_of_a_start_is_the_one_stated(share: float, starts: bool) -> None:
    made = solve_six_step(bench())
    assert made is not None
    load = share * made.start.load
    text = BENCH[: BENCH.index("simulation:")]
    text += f"""
simulation:
  duration: 0.6 s
  speed: {{points: [{{time: 0 s, speed: 800 rpm}}]}}
  load: {{kind: friction, points: [{{time: 0 s, torque: {load:.4f} N m}}]}}
  initial: {{angle: 100 deg}}
export: {{prefix: six}}
"""
    found = simulate_six_step(bench(text=text))
    assert found.six_step is not None
    assert (found.six_step.started is not None) == starts
    assert found.six_step.fault == ("none" if starts else "no start")


@pytest.mark.parametrize(
    "method",
    [
        "zero-crossing",
        pytest.param("emf-integration", marks=pytest.mark.slow),
        pytest.param("diode-conduction", marks=pytest.mark.slow),
    ],
)
def test_a_drive_starts_from_standstill_and_carries_its_load(method: str) -> None:
    text = BENCH[: BENCH.index("simulation:")]
    text += """
simulation:
  duration: 1.1 s
  speed: {points: [{time: 0 s, speed: 600 rpm}, {time: 0.5 s, speed: 1500 rpm}], shape: linear}
  load: {points: [{time: 0 s, torque: 0 N m}, {time: 0.8 s, torque: 0.15 N m}]}
  initial: {angle: 200 deg}
export: {prefix: six}
"""
    found = simulate_six_step(bench(f"control.observer.method={method}", text=text))
    figures, blocks = found.six_step, found.run.blocks
    assert figures is not None
    assert blocks is not None
    assert figures.started is not None
    assert np.any(blocks.stage == RAMP)
    assert (figures.stage, figures.fault) == ("running", "none")
    assert figures.error_largest is not None
    assert figures.predicted is not None
    assert figures.error_largest <= 1.3 * figures.predicted  # it accelerates
    end = found.run.omega_m[found.run.t > 1.05]
    assert np.mean(end) == pytest.approx(math.pi * 1500.0 / 30.0, rel=0.1)


@pytest.mark.slow
def test_a_blocked_rotor_ends_in_a_named_fault() -> None:
    found = simulate_six_step(
        bench(
            "simulation.duration=0.75 s",
            "simulation.shaft.points[0].speed=0 rpm",
            "control.six_step.align_time=50 ms",
        )
    )
    figures, blocks = found.six_step, found.run.blocks
    assert figures is not None
    assert blocks is not None
    assert (figures.stage, figures.fault, figures.started) == ("fault", "no start", None)
    dead = found.run.t > found.run.t[np.flatnonzero(blocks.stage == FAULT)[0]] + 0.01
    record = found.run.phases
    assert record is not None
    assert np.all(record.i_phases[dead] == 0.0)


@pytest.mark.slow
def test_a_rotor_that_is_stopped_while_it_runs_is_lost() -> None:
    design = bench("simulation.duration=0.2 s")
    scenario = design.simulation
    assert scenario is not None
    assert scenario.shaft is not None
    shaft = replace(scenario.shaft, times=(0.0, 0.1), values=(157.0, 0.0))
    found = simulate_six_step(replace(design, simulation=replace(scenario, shaft=shaft)))
    assert found.six_step is not None
    assert (found.six_step.stage, found.six_step.fault) == ("fault", "lost")


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_waveform_with_harmonics_commutates_by_its_own_threshold(method: str) -> None:
    a, b = BENCH.index("\n  model:"), BENCH.index("inverter:")
    text = BENCH[:a] + WAVES + BENCH[b:]
    design = bench(f"control.observer.method={method}", text=text)
    found = simulate_six_step(design)
    assert found.six_step is not None
    assert found.six_step.error_largest is not None
    assert found.six_step.predicted is not None
    assert found.six_step.error_largest <= found.six_step.predicted
    assert abs(found.six_step.error_mean or 1.0) < 0.01


def test_designs_without_a_six_step_drive_are_refused() -> None:
    with pytest.raises(NoSolutionError, match="no six-step drive"):
        simulate_six_step(bench("control.observer.method=flux"))
