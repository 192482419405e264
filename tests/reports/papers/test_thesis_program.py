"""The integer program of paper 001 in the loop, against the same program written down once more,
and against what the thesis states.
"""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.plants.scenario import Profile
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.papers import paper001_emitted_control as program_figures
from dqforge.reports.papers import paper001_emitted_control as program_runs
from dqforge.reports.papers import paper001_tables as program_tables
from dqforge.reports.papers.paper001_bench_transients import (
    PRINTED_INTEGERS,
    Program,
    Reproduction,
    bench_design,
)
from dqforge.reports.papers.paper001_emitted_control import (
    LISTED_LINE,
    Constants,
    dead_band,
    held_rpm,
    program_bench,
    program_files,
    reference_code,
)
from dqforge.reports.papers.transients import RPM
from dqforge.reports.simulation.recorded_run import Simulation


@pytest.fixture(scope="module")
def found(reproduced: Reproduction) -> Program:
    return reproduced.program


def test_the_integers_are_those_of_table_8_1() -> None:
    constants = Constants()
    assert {
        "speed kp": constants.kp_w,
        "speed ki h": constants.kih_w,
        "current kp": constants.kp_iq,
        "current ki h": constants.kih_iq,
    } == PRINTED_INTEGERS
    assert (constants.max_w, constants.max_iq) == (32000, 13000)
    assert int(32767 * 200e-6 * 3.967285) == LISTED_LINE.kih_iq
    assert (
        constants.content()
        == np.array([20000, 2500, 136, 26, 32000, 13000, 0], dtype=np.int32).tobytes()
    )


def test_references_lose_what_the_integer_division_cuts() -> None:
    assert reference_code(1200.0) == 1200 * (2**20 // 6750) // 32
    assert held_rpm(1200.0) == pytest.approx(1200.0 * 155 / 155.3445, rel=2e-4)


def _sine(angle: int) -> int:
    table = np.rint(32767.0 * np.sin(2.0 * np.pi * np.arange(257) / 256.0)).astype(int)
    place, rest = (angle % 32768) >> 7, angle % 128
    return int(table[place] + (((table[place + 1] - table[place]) * rest) >> 7))


def _thesis_start(constants: Constants, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Speeds in rpm and currents i_q in A of a start to 1200 rpm with an ideal inverter.

    The integers of the program by Python's own, which never wrap; legs by the largest and the least
    phase; the speed from the exact time between lines; the machine by small Euler steps.
    """
    r, l_d, l_q, psi, p, inertia, friction = 2.35, 1.61e-3, 1.74e-3, 0.06, 3, 200e-6, 40e-6
    i_d = i_q = omega = theta = 0.0
    dk_w = ek1_w = dk_iq = ek1_iq = w_ref = delta = captured = 0
    pending, acting = 0j, 0j
    speeds, currents = [], []
    fine, step = 200, 1e-6
    for k in range(round(seconds / 2e-4)):
        count = int(np.floor(theta / (2.0 * np.pi) * 4096.0))
        angle = p * theta
        alpha, beta = (
            i_d * np.cos(angle) - i_q * np.sin(angle),
            i_d * np.sin(angle) + i_q * np.cos(angle),
        )
        phases = (alpha, -0.5 * alpha + np.sqrt(0.75) * beta)
        i_a, i_b = (32 * int(np.clip(np.floor(i / 12.8 * 1024.0 + 0.5), -512, 511)) for i in phases)
        i_beta = ((i_a + 2 * i_b) * 18919) >> 15
        sine, cosine = _sine(24 * count), _sine(24 * count + 8192)
        i_q_code = (i_beta * cosine - i_a * sine) >> 15
        if k % 10 == 9:
            ek = w_ref - (2**23 // delta if delta else 0)
            dk_w += ((20000 * (ek - ek1_w)) >> 10) + ((2500 * ek) >> 10)
            dk_w, ek1_w = max(-constants.max_w, min(constants.max_w, dk_w)), ek
        ek = dk_w - i_q_code
        dk_iq += ((constants.kp_iq * (ek - ek1_iq)) >> 10) + ((constants.kih_iq * ek) >> 15)
        dk_iq, ek1_iq = max(-constants.max_iq, min(constants.max_iq, dk_iq)), ek
        w_ref = reference_code(1200.0)
        v_alpha, v_beta = -(dk_iq * sine) / 2**30, dk_iq * cosine / 2**30
        legs = np.array(
            [v_alpha, -0.5 * v_alpha + 0.75**0.5 * v_beta, -0.5 * v_alpha - 0.75**0.5 * v_beta]
        )
        legs = 2.0 / np.sqrt(3.0) * (legs - 0.5 * (legs.max() + legs.min()))
        duty = (np.floor(legs * 1474.0) + 1474.0) / 2949.0 * 214.0
        volts = (2.0 * duty[0] - duty[1] - duty[2]) / 3.0 + 1j * (duty[1] - duty[2]) / np.sqrt(3.0)
        acting, pending = pending, volts
        for j in range(fine):
            angle = p * theta
            v = acting * np.exp(-1j * angle)
            slope_d = (v.real - r * i_d + p * omega * l_q * i_q) / l_d
            slope_q = (v.imag - r * i_q - p * omega * (l_d * i_d + psi)) / l_q
            torque = 1.5 * p * (psi + (l_d - l_q) * i_d) * i_q
            line = np.floor(theta / (2.0 * np.pi) * 1024.0)
            omega += step * (torque - friction * omega) / inertia
            i_d, i_q, theta = i_d + step * slope_d, i_q + step * slope_q, theta + step * omega
            beyond = theta / (2.0 * np.pi) * 1024.0 - line
            if beyond >= 1.0:
                late = (beyond - 1.0) / (omega * 1024.0 / (2.0 * np.pi))
                now = int(((k * fine + j + 1) * step - late) * 29.4912e6) % 65536
                delta, captured = (now - captured) % 65536, now
        speeds.append(omega / RPM)
        currents.append(i_q)
    return np.array(speeds), np.array(currents)


def test_the_program_in_c_gives_the_start_of_the_program_in_python() -> None:
    """Both are quantised alike; the machine is integrated by other steps."""
    constants = replace(Constants(), max_w=program_runs.codes_of(4.0))
    with program_bench(bench_design()) as place:
        run = place.run(0.12, Profile((0.0,), (1200.0 * RPM,)), constants, dead_time=0.0)
    speeds, currents = _thesis_start(constants, 0.12)
    here = run.omega_m[1:] / RPM
    size = min(here.size, speeds.size)
    assert np.max(np.abs(here[:size] - speeds[:size])) < 6.0
    assert np.max(np.abs(run.i_q[1 : size + 1] - currents[:size])) < 0.05
    assert speeds[size - 1] > 800.0


def test_the_program_runs_on_its_estimator_and_errs_by_what_the_dead_time_takes() -> None:
    """The hypothetical d axis sees v_d of the dead time's square waves, 4/pi of their height along
    the current, as back-EMF; without a dead time codes and counts are all that is left.
    """
    with program_bench(bench_design()) as place:
        reference = Profile((0.0,), (1500.0 * RPM,))
        ideal, lossy = (
            place.run(0.9, reference, dead_time=time, encoderless=True) for time in (0.0, 4.88e-6)
        )
    for run, lag, tolerance in ((ideal, 0.0, 0.15), (lossy, _lag_of_dead_time(lossy), 1.0)):
        late = run.t > 0.7
        gap = np.degrees(np.angle(np.exp(1j * (run.theta_e - run.theta_e_observed)[late])))
        assert np.all(run.sensorless[late] == 1.0)
        assert np.mean(gap) == pytest.approx(lag, abs=tolerance)
    last = ideal.t > 0.7
    apart = np.mean((ideal.omega_m_observed - ideal.omega_m)[last]) / RPM
    assert abs(apart) < 6750.0 / 32768.0 * 2.0


def _lag_of_dead_time(run: Simulation) -> float:
    """Degrees by which no d voltage is left: v_q of the dead time turns the back-EMF's direction.

    At no load the current is small and in quadrature parts: the whole voltage that the dead time
    takes has the current's direction, whose angle the run tells.
    """
    late = run.t > 0.7
    lost = 4.0 / np.pi * 214.0 * 4.88e-6 / 200e-6
    current = np.mean((run.i_d + 1j * run.i_q)[late])
    drop = lost * current / abs(current)
    emf = 3.0 * float(np.mean(run.omega_m[late])) * 0.06
    whole = 1j * emf + drop
    return float(np.degrees(-np.angle(whole / 1j)))


@pytest.mark.slow
def test_the_speed_is_that_between_two_lines_of_the_encoder() -> None:
    """Within a count of 33.9 ns in the time between lines, below 26 rpm not at all."""
    with program_bench(bench_design()) as place:
        run = place.run(1.0, Profile((0.0,), (1200.0 * RPM,)))
    steady = np.mean(run.omega_m[run.t > 0.8]) / RPM
    delta = 60.0 * 29.4912e6 / (1024.0 * held_rpm(1200.0))
    assert steady == pytest.approx(held_rpm(1200.0), rel=1.0 / delta)


@pytest.mark.slow
def test_start_and_reversal_beside_the_printed_time(found: Program) -> None:
    rows = {(row.name, row.origin): row for row in found.transients}
    for row in found.transients:
        chosen = "program" in row.origin or "the same" in row.origin
        assert row.seconds < 0.2 if chosen else row.seconds == pytest.approx(0.4, rel=0.21)
    # with a limit of its own each takes the printed time
    assert rows["start", "chosen for the printed time"].seconds == pytest.approx(0.4, rel=0.05)
    assert rows["reversal", "chosen for it"].seconds == pytest.approx(0.4, rel=0.05)
    # duty cycles as voltages are enough: the instants of switching change little
    for name in ("start", "reversal"):
        switched = rows[name, "the same, every switching instant"].seconds
        assert switched == pytest.approx(rows[name, "program: 32000 in Q15"].seconds, rel=0.07)
    # a dead band that a small limit hardly leaves brings start and reversal together
    start, reversal = rows["start", "one for both"], rows["reversal", "one for both"]
    assert reversal.seconds / start.seconds < 1.5


def _value(found: Program, numbers: str, name: str) -> float:
    (finding,) = (row for row in found.findings if row.numbers == numbers)
    return next(q.value for q in finding.found if q.name == name)


@pytest.mark.slow
def test_the_current_stays_below_its_reference_by_the_dead_band(found: Program) -> None:
    error = _value(found, "8.8, 8.9", "i_q reference less i_q, mean")
    assert found.dead_band == pytest.approx(12.8 / 26.0)
    assert dead_band(LISTED_LINE) == pytest.approx(12.8 / 25.0)
    assert error == pytest.approx(found.dead_band, abs=0.02)
    # friction alone: 40e-6 N m s at 125.7 rad/s over 0.27 N m/A
    assert _value(found, "8.6", "i_q, mean") == pytest.approx(40e-6 * 125.4 / 0.27, rel=0.1)


@pytest.mark.slow
def test_what_the_figures_state_in_words(found: Program) -> None:
    assert _value(found, "8.3", "steady") == pytest.approx(found.held, abs=0.5)
    # 8.10: back-EMF, friction and the dead time's loss; the voltage vector turns with the rotor
    assert _value(found, "8.10", "v_alpha, fundamental") == pytest.approx(
        3 * 0.06 * 125.4, rel=0.03
    )
    assert _value(found, "8.11", "electrical turn") == pytest.approx(60e3 / 3 / 1197.2, rel=2e-3)
    # 8.12, 8.13: humps in the phase, none between phases
    assert _value(found, "8.12", "third harmonic") > 40.0
    size = _value(found, "8.13", "difference, fundamental")
    assert _value(found, "8.13", "rest r.m.s.") < 0.01 * size
    assert _value(found, "8.14", "without") == pytest.approx(held_rpm(2700.0), rel=1e-3)
    assert 2200.0 < _value(found, "8.14", "with 13000") < 2600.0
    assert _value(found, "8.27", "amplitude") == pytest.approx(200.0, rel=0.06)
    assert _value(found, "8.27", "frequency") == pytest.approx(2.0, rel=0.01)
    assert _value(found, "8.28", "within 2 % after at most") < 0.5


@pytest.mark.slow
def test_every_figure_is_found_or_named(found: Program) -> None:
    numbers = {
        part.strip().removeprefix("8.") for row in found.findings for part in row.numbers.split(",")
    }
    assert numbers == {str(number) for number in range(1, 29)}
    assert [row.numbers for row in found.findings if not row.found] == ["8.1, 8.2"]


@pytest.mark.slow
def test_tables_plain_data_and_figures_show_it(found: Program) -> None:
    first, explained, shown = program_tables.program_tables(found)
    assert len(first.rows) == len(found.transients)
    assert found.explanation.winner.assumed in explained.rows[0]
    assert {row[0] for row in shown.rows} == {row.numbers for row in found.findings}
    plain = program_tables.plain_program(found)
    assert plain["figures"][1]["found"][0]["value"] == found.transients[0].seconds
    for plot in (
        program_figures.plot_at_1200,
        program_figures.plot_climbs,
        program_figures.plot_reversal,
    ):
        assert "<svg" in to_svg(plot(found.runs))


def test_the_program_never_overflows_where_the_figures_are(tmp_path: Path) -> None:
    """Largest products of its longs at the largest errors that references up to 2700 rpm make."""
    most = 2 * reference_code(2700.0)
    assert 20000 * 2 * most < 2**31
    assert 136 * 4 * 32768 < 2**31
    for name, content in program_files(bench_design()).items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "only.c").write_text(
        '#include "thesis_control.h"\n#include "thesis_observer.h"\nint main(void) { return 0; }\n'
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wno-unused-function", "-Werror", "-fsyntax-only"]
    subprocess.run(["cc", *flags, "only.c"], cwd=tmp_path, check=True)
