"""Random drives started with the emitted C: rates of every method, and what the plant is."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.from_machine import RandomDrive, random_drive
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.plants.scenario import ElasticBrake, PlantErrors
from dqforge.optimizer.solution import solve
from dqforge.optimizer.start_up.plan import StartUpPlan
from dqforge.optimizer.start_up.solve import StartRate
from dqforge.reports.estimator_comparison.random_starts import (
    RUN_STATE,
    Adjust,
    Blocked,
    Conditions,
    RandomBench,
    duration_of,
    flux_bytes_of,
    plan_for,
    random_bench,
    recorded_starts,
    saturation_table,
    settings_for,
    speed_wanted,
    start_rate,
)
from dqforge.reports.simulation.design_run import controller_files
from dqforge.reports.simulation.plant_input import map_table
from dqforge.reports.start_up.header import start_up_files

EXACT = PlantErrors()

CATCH_STATE, RAMP_STATE = 1.0, 5.0


@pytest.fixture(scope="module")
def bench() -> Iterator[RandomBench]:
    with random_bench(12) as found:
        yield found


@pytest.fixture(scope="module")
def salient() -> Iterator[RandomBench]:
    with random_bench(14, saliency=True) as found:
        yield found


@pytest.fixture(scope="module")
def two_hundred() -> Iterator[RandomBench]:
    with random_bench(200) as found:
        yield found


def named(rate: StartRate, silent: float = 0.0) -> None:
    """Every failure is reported by the drive, but for a share."""
    assert rate.silent <= silent * rate.count


def few(bench: RandomBench, count: int) -> RandomBench:
    """The first drives of a bench."""
    return replace(
        bench, drives=bench.drives[:count], designs=bench.designs[:count], low=bench.low[:count]
    )


@pytest.mark.slow
def test_a_dozen_drives_start_within_the_angle_of_the_hand_over(bench: RandomBench) -> None:
    """At omega_h resistance and dead time turn the observer by 15 deg at most."""
    rate = start_rate(bench, "i-f", 0.3)
    assert rate.succeeded == rate.count
    errors = [abs(one.hand_over_error) for one in rate.verdicts if one.started]
    assert math.radians(1.0) < max(errors) < math.radians(15.0)


@pytest.mark.parametrize(("method", "load"), [("direct", 0.0), ("v-f", 0.3)])
def test_a_dozen_drives_start(bench: RandomBench, method: StartUpMethodName, load: float) -> None:
    rate = start_rate(bench, method, load)
    assert rate.succeeded >= 11, rate.failures
    named(rate)


@pytest.mark.slow
def test_salient_drives_start_by_their_saliency(salient: RandomBench) -> None:
    assert all(drive.saliency >= 1.1 for drive in salient.drives)
    rate = start_rate(salient, "saliency", 0.3)
    assert rate.succeeded >= rate.count - 1
    named(rate)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "load", "least"),
    [
        ("i-f", 0.0, 0.95),
        ("i-f", 0.3, 0.95),
        ("i-f", 0.5, 0.95),
        ("i-f", 0.7, 0.9),
        ("direct", 0.0, 0.93),
        ("v-f", 0.3, 0.95),
    ],
)
def test_two_hundred_drives_start(
    two_hundred: RandomBench, method: StartUpMethodName, load: float, least: float
) -> None:
    rate = start_rate(two_hundred, method, load)
    assert rate.rate >= least, rate.failures
    named(rate, 0.02)


def blocked(drive: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
    """Three times the rated torque, as a friction, once the drive runs."""
    time = running_at(drive, plan)
    return plan, Conditions(blocked=Blocked(time, 3.0 * drive.torque_rated), duration=time + 0.5)


def clamped(drive: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
    """An elastic brake that grips once the drive runs: a rotor held by a spring, lightly damped."""
    time, stiffness = running_at(drive, plan), 5.0 * drive.torque_rated
    damping = 0.2 * math.sqrt(stiffness * (drive.machine.inertia or 1.0))
    return plan, Conditions(brake=ElasticBrake(time, stiffness, damping), duration=time + 0.5)


def running_at(drive: RandomDrive, plan: StartUpPlan) -> float:
    """Time in s at which a start has long ended."""
    speed = speed_wanted(drive, plan) * drive.machine.pole_pairs
    return duration_of(plan, speed, 0.3 * drive.torque_rated) - 0.5


def found_after(bench: RandomBench, adjust: Adjust) -> tuple[int, list[float]]:
    """How many drives ran before something stopped them, and after how many s each said so."""
    rows = recorded_starts(bench, "i-f", 0.3, adjust)
    ran, late = 0, []
    for drive, design, row in zip(bench.drives, bench.designs, rows, strict=True):
        plan = plan_for(design, settings_for("i-f", 0.3 * drive.torque_rated))
        time = running_at(drive, plan)
        ran += bool(row["state"][np.searchsorted(row["t"], time) - 1] == RUN_STATE)
        said = np.flatnonzero((row["t"] >= time) & (row["fault"] != 0.0))
        late += [float(row["t"][said[0]] - time)] if said.size else []
    return ran, late


def test_held_rotor_is_found(bench: RandomBench) -> None:
    """All of them within 0.2 s: no observer goes on turning over a rotor that a spring holds."""
    ran, late = found_after(few(bench, 5), clamped)
    assert ran == len(late) == 5
    assert max(late) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("stop", [blocked, clamped])
def test_every_stopped_rotor_of_two_hundred_is_found(
    two_hundred: RandomBench, stop: Adjust
) -> None:
    ran, late = found_after(two_hundred, stop)
    assert ran >= 190
    assert len(late) == 200
    assert np.median(late) < 0.08


def turning(share: float) -> Adjust:
    """A shaft that turns already at a share of its rated speed, and is looked for."""

    def start(drive: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
        speed = share * (drive.machine.omega_m_max or 0.0)
        return replace(plan, flying=True), Conditions(turning=speed, duration=0.2)

    return start


def caught(bench: RandomBench, share: float) -> tuple[int, list[float]]:
    """How many rotors are caught, and by what angle in rad the observer is then off, where it
    rules at once."""
    found, errors = 0, []
    for rows in recorded_starts(bench, "i-f", 0.0, turning(share)):
        left = np.flatnonzero((rows["state"] != 0.0) & (rows["state"] != CATCH_STATE))
        state = rows["state"][left[0]] if left.size else 0.0
        found += bool(state in (RUN_STATE, RAMP_STATE))
        if state == RUN_STATE:
            gap = rows["theta_e_observed"][left[0]] - rows["theta_e"][left[0]]
            errors.append(abs(float((gap + np.pi) % (2.0 * np.pi) - np.pi)))
    return found, errors


def test_turning_rotors_are_caught(bench: RandomBench) -> None:
    found, errors = caught(bench, -0.6)
    assert found == len(errors) == 12
    assert max(errors) < math.radians(8.0)


@pytest.mark.slow
@pytest.mark.parametrize("share", [1.0, 0.6, 0.3])
def test_two_hundred_turning_rotors_are_caught(two_hundred: RandomBench, share: float) -> None:
    found, errors = caught(two_hundred, share)
    assert found == 200
    assert np.percentile(errors, 95) < math.radians(7.0)


@pytest.mark.slow
def test_salient_ones_of_two_hundred_start() -> None:
    with random_bench(200, saliency=True) as found:
        for load, least in ((0.0, 0.9), (0.3, 0.9), (0.7, 0.97)):
            rate = start_rate(found, "saliency", load)
            assert rate.rate >= least, (load, rate.failures)
            named(rate, 0.02)


def test_saturation_is_the_formula() -> None:
    """The table of one cell against that of a flux map of the same formula."""
    drive = random_drive(3)
    machine = drive.machine
    line = np.linspace(-machine.i_max, machine.i_max, 9)
    i_d, i_q = np.meshgrid(line, line, indexing="ij")
    psi_d = (
        machine.psi_pm
        + machine.l_d * i_d
        - 0.5 * machine.l_d * drive.saturation * i_d**2 / machine.i_max
    )
    mapped = map_table(FluxMap(line, line, psi_d, machine.l_q * i_q))
    rows, columns = int(mapped[0]), int(mapped[1])
    corners, cells = mapped[2 : 2 + rows + columns], mapped[2 + rows + columns :]
    own = saturation_table(drive)[4:].reshape(4, 4, 2)
    for row, column in ((2, 3), (5, 4), (7, 8)):
        cubic = cells.reshape(rows, columns, 4, 4, 2)[row, column]
        x, y = 0.04 * machine.i_max, 0.07 * machine.i_max
        at = (corners[row] + x, corners[rows + column] + y)
        there = np.einsum("qdf,d,q->f", cubic, x ** np.arange(4), y ** np.arange(4))
        formula = np.einsum("qdf,d,q->f", own, at[0] ** np.arange(4), at[1] ** np.arange(4))
        np.testing.assert_allclose(formula, there, rtol=2e-3)


def undamped(drive: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
    """Alignment in one step, long and without damping, from near by."""
    swing = plan.swing_time * math.sqrt(plan.ramp_current / plan.align_current)
    changed = replace(plan, alignment="one-step", align_damping=0.0, align_time=30.0 * swing)
    return changed, Conditions(errors=EXACT, duration=30.0 * swing, dead_time_left=0.0)


def test_rotor_in_a_standing_field_is_the_pendulum_of_the_formula(bench: RandomBench) -> None:
    """omega_n = sqrt(p K_T I/J), K_T by the flux under that current."""
    near = replace(
        bench,
        drives=tuple(replace(drive, theta_e=0.2) for drive in bench.drives),
    )
    checked = 0
    for drive, rows in zip(near.drives, recorded_starts(near, "i-f", 0.0, undamped), strict=True):
        machine = drive.machine
        if drive.saliency > 1.0:
            continue  # its reluctance torque has another form
        flux = machine.psi_pm - 0.5 * drive.saturation * machine.l_d * machine.i_max
        late = rows["t"] > 0.55 * rows["t"][-1]
        angle, time = rows["theta_e"][late], rows["t"][late]
        up = np.flatnonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))
        share = -angle[up] / (angle[up + 1] - angle[up])
        crossings = time[up] + share * (time[up + 1] - time[up])
        omega = 2.0 * math.pi * (crossings.size - 1) / (crossings[-1] - crossings[0])
        torque = 1.5 * machine.pole_pairs * flux * machine.i_max
        expected = math.sqrt(machine.pole_pairs * torque / (machine.inertia or 1.0))
        expected *= 1.0 - float(np.max(np.abs(angle))) ** 2 / 16.0  # of a pendulum that swings far
        assert math.isclose(omega, expected, rel_tol=0.05)
        checked += 1
    assert checked >= 3


def test_alignment_ends_inside_its_dead_band(bench: RandomBench) -> None:
    """|theta| <= asin(T_L/(K_T I)) at the end of the alignment of a rotor that friction holds."""

    def held(_: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
        changed = replace(plan, alignment="one-step", align_time=3.0 * plan.align_time)
        return changed, Conditions(errors=EXACT, duration=2.9 * plan.align_time)

    band, far = math.asin(0.5), 0.0
    for drive, rows in zip(bench.drives, recorded_starts(bench, "i-f", 0.5, held), strict=True):
        if drive.saliency > 1.0:
            continue
        angle = abs(float(rows["theta_e"][-1]))
        assert angle <= band + 0.06 or abs(angle - math.pi) <= band + 0.06
        far = max(far, min(angle, math.pi - angle))
    assert far > 0.2


@pytest.mark.slow
def test_ramp_carries_no_load_beyond_its_current(bench: RandomBench) -> None:
    """T_L = 1.2 K_T I of the ramp: no drive starts, and every one says so."""

    def weak(_: RandomDrive, plan: StartUpPlan) -> tuple[StartUpPlan, Conditions]:
        return replace(plan, ramp_current=0.6 / 1.2 * plan.current_limit), Conditions()

    rate = start_rate(few(bench, 4), "i-f", 0.6, weak)
    assert rate.succeeded == 0
    named(rate)


def test_numbers_of_a_drive_are_in_the_order_of_its_header(salient: RandomBench) -> None:
    """Gains of the injection and of the flux observer as the headers of a design print them."""
    drive, design, low = salient.drives[0], salient.designs[0], salient.low[0]
    settings = replace(settings_for("saliency", 0.0), alignment="two-step")
    solution = solve(replace(design, control=replace(design.control, start_up=settings)))
    assert solution.start_up is not None
    files = controller_files(solution) | start_up_files(solution, solution.start_up)
    for name, instance, own in (
        ("bench_start_observer.h", "BENCH_INJECTION_GAINS", low),
        ("bench_observer.h", "BENCH_FLUX_GAINS", flux_bytes_of(drive)),
    ):
        text = files[name].decode().split(f"{instance} = ")[1].split("};")[0]
        printed = re.findall(r"-?\d[\d.]*(?:e-?\d+)?(?=F)", text)
        numbers = np.array([float(word) for word in printed], dtype=np.float32)
        np.testing.assert_allclose(np.frombuffer(own, dtype=np.float32), numbers, rtol=1e-5)
