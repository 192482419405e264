"""The emitted control in the compiled simulation: torque, copper and currents of every topology.

Limits are those that a prototype reached on the same machines: orders of magnitude of what is
right, and far from what a wrong angle, sign or axis would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from phase_drives import near_sinusoidal, plain_control, trapezoidal

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.frame_transforms import thesis_shapes
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import PhaseOpening, PlantErrors, Scenario, constant
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Summary, simulate, simulate_many, simulator

P, Z = near_sinusoidal(192), trapezoidal(192)
PLANT_P, PLANT_Z = near_sinusoidal(720), trapezoidal(720)
SPEEDS = (75.0, 750.0, 1800.0)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def base() -> Solution:
    return solve(catalogue.load("paper002-phase-waveforms"))


def drive_with(base: Solution, plant: PhaseMachine, topology: Topology) -> Drive:
    capacitance = 4e-3 if topology == "split-capacitor" else None
    inverter = replace(base.design.inverter, topology=topology, midpoint_capacitance=capacitance)
    return Drive(base.design.machine, inverter, base.design.control.t_s, 1, plant)


def headers(base: Solution, control: PhaseControl) -> dict[str, bytes]:
    return header_files(base) | phase_control_files(base, control)


def scenarios(
    points: Sequence[tuple[float, float]], duration: float, *, switched: bool, l_d: float = 0.0
) -> list[Scenario]:
    """Torques in N m at mechanical speeds in rpm."""
    return [
        Scenario(
            duration, "torque", constant(torque), shaft=constant(rpm * np.pi / 30.0),
            omega_m=rpm * np.pi / 30.0, inverter="switched" if switched else "averaged",
            dead_time=1e-6 if switched else 0.0, errors=PlantErrors(l_d=l_d),
        )
        for rpm, torque in points
    ]  # fmt: skip


def settled(
    base: Solution,
    control: PhaseControl,
    plant: PhaseMachine,
    points: Sequence[tuple[float, float]],
    *,
    switched: bool = False,
    l_d: float = 0.0,
) -> Summary:
    """Figures of the last 0.4 s, a whole number of periods at 75 rpm and above."""
    duration = 1.4 if switched else 0.8
    drive = drive_with(base, plant, control.topology)
    export = base.design.export
    runs = [
        (drive, scenario, b"")
        for scenario in scenarios(points, duration, switched=switched, l_d=l_d)
    ]
    with simulator(headers(base, control), export.prefix, (), control.topology) as program:
        return simulate_many(program, runs, tail=1.0 - 0.4 / duration)


def percent(values: FloatArray, points: Sequence[tuple[float, float]]) -> FloatArray:
    return np.asarray(100.0 * values / np.array([torque for _, torque in points]))


@pytest.mark.parametrize("topology", ["four-leg", "six-leg", "split-capacitor", "three-wire"])
@pytest.mark.parametrize(
    ("plant", "model", "limits"),
    [(PLANT_P, P, (0.05, 0.05, 0.2)), (PLANT_Z, Z, (0.7, 0.7, 2.1))],
    ids=["P", "Z"],
)
def test_averaged_torque_is_constant(
    topology: Topology,
    plant: PhaseMachine,
    model: PhaseMachine,
    limits: tuple[float, ...],
    base: Solution,
) -> None:
    """Table with the voltage of the references, without harmonic integrators: the instantaneous
    torque at the samples."""
    points = [(rpm, 1.0) for rpm in SPEEDS]
    found = settled(base, plain_control(model, topology, harmonics=None), plant, points)
    assert found.bounded.all()
    assert np.all(percent(found.tail_ripple, points) <= np.array(limits))
    np.testing.assert_allclose(percent(found.tail_torque, points), 100.0, atol=0.1)


_SWITCHED: dict[Topology, tuple[tuple[float, float], tuple[float, float]]] = {
    "four-leg": ((0.8, 0.3), (2.2, 0.9)),
    "six-leg": ((0.8, 0.3), (2.2, 0.9)),
    "three-wire": ((0.4, 0.12), (0.9, 0.6)),
    "six-leg-isolated": ((0.6, 0.2), (1.2, 0.7)),
    "split-capacitor": ((1.8, 0.25), (2.4, 1.1)),
}


@pytest.mark.parametrize("topology", _SWITCHED)
@pytest.mark.parametrize(
    ("plant", "model", "place"), [(PLANT_P, P, 0), (PLANT_Z, Z, 1)], ids=["P", "Z"]
)
def test_switched_torque_with_dead_time(
    topology: Topology, plant: PhaseMachine, model: PhaseMachine, place: int, base: Solution
) -> None:
    """1 us of dead time, harmonic integrators settled: peak to peak of the means per PWM period at
    1 and 3.5 N m, in %; mean torque within half a percent."""
    at_1, at_3 = _SWITCHED[topology][place]
    points = [(rpm, torque) for torque in (1.0, 3.5) for rpm in SPEEDS]
    found = settled(base, plain_control(model, topology), plant, points, switched=True)
    assert found.bounded.all()
    ripple = percent(found.tail_ripple_means, points)
    assert np.max(ripple[:3]) <= at_1
    assert np.max(ripple[3:]) <= at_3
    np.testing.assert_allclose(percent(found.tail_torque, points), 100.0, atol=0.5)


_COMPARED: list[tuple[CurrentFrame, Feedforward, tuple[float, float], tuple[float, float]]] = [
    ("dq", "emf", (2.4, 4.5), (12.0, 17.0)),
    ("dqx", "emf", (1.0, 3.4), (4.0, 11.5)),
    ("dqx", "measured", (0.0, 0.4), (0.5, 4.5)),
    ("dqy", "none", (9.0, 26.0), (45.0, 120.0)),
    ("dqy", "emf", (1.5, 4.6), (5.8, 16.0)),
    ("dqy", "measured", (0.05, 0.5), (0.8, 5.5)),
    ("dqy", "references", (0.0, 0.2), (0.3, 2.1)),
    ("table", "none", (6.0, 19.0), (30.0, 90.0)),
    ("table", "references", (0.0, 0.2), (0.3, 2.1)),
]


@pytest.mark.parametrize(("frame", "feedforward", "of_p", "of_z"), _COMPARED)
def test_controllers_differ_as_the_prototype_found(
    frame: CurrentFrame,
    feedforward: Feedforward,
    of_p: tuple[float, float],
    of_z: tuple[float, float],
    base: Solution,
) -> None:
    """Averaged, 1 N m at 750 and 1800 rpm: ripple in % of all controllers of paper 002."""
    points = [(750.0, 1.0), (1800.0, 1.0)]
    for plant, model, (low, high) in ((PLANT_P, P, of_p), (PLANT_Z, Z, of_z)):
        control = plain_control(model, "four-leg", frame, feedforward, harmonics=None)
        ripple = percent(settled(base, control, plant, points).tail_ripple, points)
        assert low <= ripple[0] <= high
        assert low <= ripple[1] <= high


@pytest.mark.parametrize("topology", ["four-leg", "six-leg"])
def test_copper_loss_of_dqx_over_dqy(topology: Topology, base: Solution) -> None:
    """Paper 002: 1.061 with one phase of half the back-EMF, 1.732 without it, 1.042 trapezoidal."""
    shapes = thesis_shapes(360)
    expected = {
        "one phase at half amplitude": 1.0607, "one phase missing": 1.7318, "trapezoid": 1.0419
    }  # fmt: skip
    found = {}
    for name in expected:
        machine = replace(P, flux=0.2 * shapes[name])
        losses = []
        for frame in ("dqx", "dqy"):
            control = plain_control(machine, topology, frame, harmonics=None)
            run = settled(base, control, machine, [(150.0, 1.0)])
            assert run.tail_torque[0] == pytest.approx(1.0, abs=2e-3)
            losses.append(float((run.tail_copper_a + run.tail_copper_b + run.tail_copper_c)[0]))
        found[name] = losses[0] / losses[1]
    assert found == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("topology", ["four-leg", "six-leg", "split-capacitor"])
def test_an_open_phase_is_borne(topology: Topology, base: Solution) -> None:
    """Phase b opens at 0.3 s and is known 1 ms later: constant torque afterwards, with the peak of
    the other phases twice what it was."""
    drive = drive_with(base, PLANT_P, topology)
    control, export = plain_control(P, topology), base.design.export
    (scenario,) = scenarios([(750.0, 1.0)], 0.8, switched=False)
    scenario = replace(scenario, open_phase=PhaseOpening("b", 0.3, 1e-3))
    with simulator(headers(base, control), export.prefix, (), topology) as program:
        run = simulate(program, drive, scenario)
    assert run.phases is not None
    before, after = (run.t > 0.2) & (run.t < 0.3), run.t > 0.6
    assert np.ptp(run.torque[before]) < 2e-3
    assert np.ptp(run.torque[after]) < 0.02
    assert np.mean(run.torque[after]) == pytest.approx(1.0, abs=5e-3)
    peaks = [np.max(np.abs(run.phases.i_phases[part])) for part in (before, after)]
    assert peaks[1] / peaks[0] == pytest.approx(2.0, abs=0.15)
    assert np.max(np.abs(run.phases.i_phases[after][:, 1])) < 1e-6


def test_harmonic_integrators_learn_what_the_model_does_not_know(base: Solution) -> None:
    """Inductance of the plant 30 % low: ripple of P falls below 0.2 % at 750 and 1800 rpm."""
    points = [(750.0, 1.0), (1800.0, 1.0)]
    with_them, without = (
        settled(base, control, PLANT_P, points, l_d=-0.3)
        for control in (plain_control(P), plain_control(P, harmonics=None))
    )
    assert np.all(percent(without.tail_ripple, points) > np.array([0.5, 1.5]))
    assert np.all(percent(with_them.tail_ripple, points) < 0.25)
