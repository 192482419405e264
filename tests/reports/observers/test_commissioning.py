"""Tests that a drive runs on its own machine: the emitted C on a simulated one, its logs read by
`identify`, and the header of the design that follows.
"""

from __future__ import annotations

import ctypes
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, write_table

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.optimizer.commissioning import (
    CommissioningState,
    CommissioningTest,
    solve_commissioning,
)
from dqforge.optimizer.identification.identify import identify
from dqforge.optimizer.solution import solve
from dqforge.reports.identification import design_of
from dqforge.reports.main_header import header_files
from dqforge.reports.observers.commissioning import commissioning_files, gains_read

BENCH = "paper001-pmsm-bench"
WRAPPER = """
#include "{prefix}_commissioning.h"
static {prefix}_commissioning_t state;
static {prefix}_commissioning_row_t rows[{macro}_COMMISSIONING_ROWS];
void begin(int test)
{{
    {prefix}_commissioning_start(&{macro}_COMMISSIONING_GAINS, &state,
        ({prefix}_commissioning_test_t)test);
}}
int sample(float i_d, float i_q, float omega_m, float out[3])
{{
    const {prefix}_dq_t i = {{ i_d, i_q }};
    {prefix}_commissioning_step(&{macro}_COMMISSIONING_GAINS, &state, i, omega_m);
    const {prefix}_dq_t u = {{ state.u_d, state.u_q }};
    {prefix}_commissioning_keep(&state, rows, i, u, omega_m);
    out[0] = state.u_d;
    out[1] = state.u_q;
    out[2] = state.i_q;
    return (int)state.state;
}}
int read(const float **first)
{{
    *first = &rows[0].i_d;
    return (int)state.logged;
}}
int coast(void) {{ return (int)state.coast; }}
"""
# The machine on the bench, which the design does not know: 12 % more L_q, 20 % less R, ...
TRUTH = {
    "resistance": 0.8,
    "inductance_d": 0.9,
    "inductance_q": 1.12,
    "magnet_flux": 0.95,
}
DROP, DRY, VISCOUS = 1.1, 0.05, 2e-4  # V, N m, N m s/rad


def asked(section: str = "{}") -> Design:
    text = catalogue.read_text(BENCH).decode()
    text = text.replace("control:\n", f"control:\n  commissioning: {section}\n", 1)
    return load_text(text.encode(), "design.yaml")


class Firmware:
    """The compiled header on the host."""

    def __init__(self, folder: Path, design: Design) -> None:
        found = solve_commissioning(design)
        assert found is not None
        self.found, prefix = found, design.export.prefix
        for name, content in commissioning_files(design, found).items():
            (folder / name).write_bytes(content)
        text = WRAPPER.format(prefix=prefix, macro=prefix.upper())
        (folder / "wrapper.c").write_text(text)
        flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared"]
        subprocess.run(
            ["cc", *flags, "-o", "wrapper.so", "wrapper.c", "-lm"], cwd=folder, check=True
        )
        self.library = ctypes.CDLL(str(folder / "wrapper.so"))

    def begin(self, test: CommissioningTest) -> None:
        self.library.begin(int(test))

    def sample(
        self, i_d: float, i_q: float, omega_m: float
    ) -> tuple[CommissioningState, list[float]]:
        out = (ctypes.c_float * 3)()
        numbers = (ctypes.c_float(one) for one in (i_d, i_q, omega_m))
        return CommissioningState(self.library.sample(*numbers, out)), list(out)

    def log(self) -> FloatArray:
        first = ctypes.POINTER(ctypes.c_float)()
        count = self.library.read(ctypes.byref(first))
        return np.array(first[: 5 * count], dtype=float).reshape(count, 5)


@pytest.fixture
def firmware(tmp_path: Path) -> Firmware:
    return Firmware(tmp_path, asked())


def truth(design: Design) -> dict[str, float]:
    machine = design.machine
    known = {
        "resistance": machine.r_s,
        "inductance_d": machine.l_d,
        "inductance_q": machine.l_q,
        "magnet_flux": machine.psi_pm,
    }
    return {key: share * known[key] for key, share in TRUTH.items()}


def run_axis(firmware: Firmware, test: CommissioningTest, own: dict[str, float]) -> FloatArray:
    """The log of one axis: voltage 1.5 samples late, the inverter's error, noise of 0.2 %."""
    rng = np.random.default_rng(int(test))
    axis, t_s, parts = "dq"[test], firmware.found.t_s, 6
    r, own_l, h = own["resistance"], own[f"inductance_{axis}"], firmware.found.t_s / parts
    kept, i, fed, state = math.exp(-0.5 * h * r / own_l), 0.0, [0.0, 0.0, 0.0], None
    noise = 0.002 * firmware.found.gains.current
    firmware.begin(test)
    for _ in range(round(2.0 / t_s)):
        seen = [rng.normal(0.0, noise), rng.normal(0.0, noise)]
        seen[test] += i
        state, out = firmware.sample(seen[0], seen[1], 0.0)
        if state in (CommissioningState.DONE, CommissioningState.FAULT):
            break
        fed = [*fed[1:], out[test]]
        for part in range(parts):
            u = fed[0] if part < parts // 2 else fed[1]
            half = kept * i + (1.0 - kept) / r * (u - DROP * i / math.hypot(i, 0.05))
            drop = DROP * half / math.hypot(half, 0.05)
            i = kept**2 * i + (1.0 - kept**2) / r * (u - drop)
    assert state == CommissioningState.DONE
    return firmware.log()


def run_shaft(firmware: Firmware, own: dict[str, float], pairs: int, inertia: float) -> FloatArray:
    t_s, i, omega = firmware.found.t_s, 0.0, 0.0
    rng = np.random.default_rng(5)
    firmware.begin(CommissioningTest.SHAFT)
    state, asked_i = None, firmware.found.gains.current
    while state != CommissioningState.DONE:
        noisy = rng.normal(0.0, [0.01, 0.5])
        state, out = firmware.sample(0.0, i + noisy[0], omega + noisy[1])
        asked_i = out[2]
        i += t_s / 1e-3 * (asked_i - i)
        torque = 1.5 * pairs * own["magnet_flux"] * i - DRY * (omega > 0.0) - VISCOUS * omega
        omega += t_s / inertia * torque
    return firmware.log()


RUNS = """
- name: d axis
  kind: locked-voltage
  file: d.csv
  columns: {time: t, i_d: i_d, u_d: u_d}
  currents: measured
  voltage: reference
- name: q axis
  kind: locked-voltage
  file: q.csv
  columns: {time: t, i_q: i_q, u_q: u_q}
  currents: measured
  voltage: reference
- name: acceleration
  kind: spin-up
  file: up.csv
  columns: {time: t, i_q: i_q, speed: w}
  currents: measured
- name: coasting
  kind: spin-down
  file: down.csv
  columns: {time: t, speed: w}
"""


def write_log(path: Path, rows: FloatArray, step: float) -> None:
    names = ("i_d [A]", "i_q [A]", "u_d [V]", "u_q [V]", "w [rad/s]")
    columns = {"t [s]": step * np.arange(rows.shape[0])}
    write_table(path, columns | dict(zip(names, rows.T, strict=True)))


def test_what_the_drive_logs_becomes_its_design(firmware: Firmware, tmp_path: Path) -> None:
    design = asked()
    own, pairs, inertia = truth(design), design.machine.pole_pairs, 3e-3
    gains, t_s = firmware.found.gains, firmware.found.t_s
    for test in (CommissioningTest.D_AXIS, CommissioningTest.Q_AXIS):
        log = run_axis(firmware, test, own)
        assert log.shape[0] == 8 * gains.hold // gains.every
        largest = float(np.max(np.abs(log[:, test])))
        assert 0.8 * gains.current < largest < 1.3 * gains.current
        write_log(tmp_path / f"{'dq'[test]}.csv", log, gains.every * t_s)
    log = run_shaft(firmware, own, pairs, inertia)
    turn = firmware.library.coast()
    assert 20 < turn < log.shape[0] - 20
    write_log(tmp_path / "up.csv", log[:turn], gains.slowly * t_s)
    write_log(tmp_path / "down.csv", log[turn:], gains.slowly * t_s)
    path = tmp_path / "bench.yaml"
    machine = f"pole_pairs: {pairs}\nmax_current: 6 A\nmagnet_flux: {own['magnet_flux']} Wb"
    path.write_text(bench_text(RUNS, machine, "{v_dc: 300 V, switching_frequency: 10 kHz}"))
    found = identify(read_bench(path))
    for key in ("resistance", "inductance_d", "inductance_q"):
        one = found.of(key)
        assert one is not None
        assert one.status == "identified"
        assert one.value == pytest.approx(own[key], rel=0.02), key
    for key, expected, share in (("inertia", inertia, 0.02), ("friction", VISCOUS, 0.3)):
        one = found.of(key)
        assert one is not None
        assert one.value == pytest.approx(expected, rel=share), key
    text, lacking = design_of(found)
    assert lacking == ""
    assert text is not None
    solution = solve(load_text(text, "design.yaml"))
    assert header_files(solution)


def test_a_current_beyond_the_trip_ends_the_test(firmware: Firmware) -> None:
    gains = firmware.found.gains
    for i_d in (1.6 * gains.current, math.nan):
        firmware.begin(CommissioningTest.D_AXIS)
        assert firmware.sample(0.0, 0.0, 0.0)[0] == CommissioningState.RISE
        state, out = firmware.sample(i_d, 0.0, 0.0)
        assert state == CommissioningState.FAULT
        assert out == [0.0, 0.0, 0.0]


def test_numbers_are_read_back() -> None:
    found = solve_commissioning(asked("{rows: 100, current: 2 A, speed: 500 rpm}"))
    assert found is not None
    from dqforge.reports.observers.float32_model import plain_gains_of

    plain = plain_gains_of(found.gains)
    assert gains_read(plain).rows == 100
    assert gains_read(plain).omega_most == pytest.approx(500.0 * math.pi / 30.0, rel=1e-6)
    for key, value in (("rows", 1.5), ("rows", -1), ("current", None), ("hold", True)):
        with pytest.raises(InputError, match="commissioning_header is not what dqforge writes"):
            gains_read(plain | {key: value})


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("{current: 900 A}", "is above the current limit"),
        ("{rows: 3}", "rows"),
    ],
)
def test_what_is_refused(section: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        asked(section)
