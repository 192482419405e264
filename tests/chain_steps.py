"""The steps of a drive's chain in float32, for the cost table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from control_chain import Step, current_rows
from drives import IPM, make_design
from numpy.typing import NDArray

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings, ObserverSettings, WeakeningSettings
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.reduced_order_step import ReducedOrderGains
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import control_files
from dqforge.reports.main_header import header_files
from dqforge.reports.observers.float32_model import (
    observer_inputs,
    speed_observer_inputs,
)
from dqforge.reports.observers.position_header import observer_files, speed_observer_files
from dqforge.reports.single_headers.field_weakening import weakening_files

COUNT = 300

SPEED_MAX = 200.0

MEASURED = (
    "measured.i.a = r[0]; measured.i.b = r[1]; measured.i.c = r[2]; measured.theta_e = r[3];"
    " measured.omega_m = r[4]; measured.v_dc = r[5];"
)

STATE = "static drive_control_t state; static drive_measured_t measured;"

START = "drive_control_start(&state);"


def design_of(modulation: ModulationName = "svpwm", **changes: Any) -> Design:
    """A machine of 100 kW at 500 V, sampled at 100 kHz."""
    base = make_design(IPM, fit=FitSettings(degree=4, torque_max=200.0))
    operation = replace(base.operation, modulation=modulation)
    export = replace(base.export, control=("float32", "q15", "q31"))
    bases = replace(base.control.bases, speed=1000.0)
    control = replace(base.control, bases=bases)
    made = replace(base, control=control, operation=operation, export=export, losses=None)
    return replace(made, **changes)


@cache
def solution() -> Solution:
    return solve(design_of())


@cache
def drive_rows() -> NDArray[np.float32]:
    v_dc = solution().design.inverter.v_dc
    rows: NDArray[np.float32] = current_rows(COUNT, 0.5 * v_dc, IPM.i_max, SPEED_MAX, v_dc)
    return rows


def _files(found: Solution) -> dict[str, bytes]:
    return header_files(found) | control_files(found)


def torque_reference() -> Step:
    torque = np.random.default_rng(1).uniform(-210.0, 210.0, (COUNT, 1)).astype(np.float32)
    return Step(
        "torque reference", "float32", header_files(solution()), "drive.h",
        "float torque, float *i_d, float *i_q",
        "drive_current_reference(torque, i_d, i_q);",
        "r[0], &i_d, &i_q", torque, state="float i_d; float i_q;",
    )  # fmt: skip


def weakening_reference() -> Step:
    found = solve(design_of(weakening=WeakeningSettings(900.0)))
    assert found.weakening is not None
    generator = np.random.default_rng(2)
    columns = [
        generator.uniform(-1.0, 1.0, COUNT) * 200.0,
        generator.uniform(0.5, 0.58, COUNT) * 500.0,
        generator.uniform(-1.0, 1.0, COUNT) * 900.0 * IPM.pole_pairs,
    ]
    rows = np.stack(columns, axis=1).astype(np.float32)
    files = header_files(found) | weakening_files(found.design, found.weakening)
    return Step(
        "torque reference with field weakening", "float32", files, "drive_weakening.h",
        "float torque, float v_max, float omega_e, float *i_d, float *i_q",
        "drive_weakening_reference(torque, v_max, omega_e, i_d, i_q);",
        "r[0], r[1], r[2], &i_d, &i_q", rows, state="float i_d; float i_q;",
    )  # fmt: skip


def current_control() -> Step:
    return Step(
        "current control", "float32", _files(solution()), "drive_control.h",
        "const drive_control_gains_t *gains, drive_control_t *state,"
        " const drive_measured_t *measured, drive_dq_t reference",
        "return drive_current_control(gains, state, measured, reference);",
        "&DRIVE_CONTROL_GAINS, &state, &measured, reference", drive_rows(),
        "drive_abc_t", STATE + " drive_dq_t reference;", START,
        MEASURED + " reference.d = r[6]; reference.q = r[7];"
        " state.d.integral = r[8]; state.q.integral = r[9];",
    )  # fmt: skip


def speed_loop() -> Step:
    return Step(
        "speed loop, mean over its samples", "float32", _files(solution()), "drive_control.h",
        "const drive_control_gains_t *gains, drive_control_t *state, float omega_m,"
        " float reference",
        "return drive_speed_loop(gains, state, omega_m, reference);",
        "&DRIVE_CONTROL_GAINS, &state, r[4], 0.9F * r[4]", drive_rows(),
        "float", "static drive_control_t state;", START,
    )  # fmt: skip


def speed_control() -> Step:
    return Step(
        "speed control, the whole step", "float32", _files(solution()), "drive_control.h",
        "const drive_control_gains_t *gains, drive_control_t *state,"
        " const drive_measured_t *measured, float reference",
        "return drive_speed_control(gains, state, measured, reference);",
        "&DRIVE_CONTROL_GAINS, &state, &measured, 0.9F * r[4]", drive_rows(),
        "drive_abc_t", STATE, START,
        MEASURED + " state.d.integral = r[8]; state.q.integral = r[9];",
    )  # fmt: skip


def modulators() -> Iterator[Step]:
    """Duty cycles of voltages within the linear range, and of currents that lag them."""
    generator = np.random.default_rng(3)
    angle, lag = generator.uniform(-np.pi, np.pi, (2, COUNT))
    amplitude = generator.uniform(0.05, 1.0, COUNT)
    for name in MODULATORS:
        changed = replace(solution(), design=design_of(name))
        size = amplitude * MODULATORS[name].linear_limit * 500.0
        columns = [
            size * np.cos(angle), size * np.sin(angle), np.full(COUNT, 500.0),
            200.0 * np.cos(angle - lag), 200.0 * np.sin(angle - lag),
        ]  # fmt: skip
        yield Step(
            f"modulator {name}", "float32", _files(changed), "drive_control.h",
            "drive_alphabeta_t voltage, float v_dc, drive_alphabeta_t i",
            "return drive_duties(voltage, v_dc, i);", "voltage, r[2], i",
            np.stack(columns, axis=1).astype(np.float32), "drive_abc_t",
            "drive_alphabeta_t voltage; drive_alphabeta_t i;", "",
            "voltage.alpha = r[0]; voltage.beta = r[1]; i.alpha = r[3]; i.beta = r[4];",
        )  # fmt: skip


@cache
def position_observers() -> dict[str, tuple[Design, PositionObserver]]:
    """Position observers by method, each with the design that asks for it."""
    design, found = design_of(), {}
    for name in METHODS:
        settings = replace(design.control, observer=ObserverSettings(method=name))  # type: ignore[arg-type]
        chosen = replace(design, control=settings)
        _, position = solve_observer(chosen)
        assert position is not None
        found[name] = (chosen, position)
    return found


def observers() -> Iterator[Step]:
    """One step each of the speed observer and of every position observer, from their start on."""
    design = design_of()
    found = solution().gains.observer
    assert found is not None
    gains = ReducedOrderGains.of(design.machine, found)
    files = speed_observer_files(design, found)
    rows = speed_observer_inputs(gains, COUNT, 5)
    yield _observer("reduced-order", "reduced_order", "drive_speed_observer.h", files, rows)
    for name, (chosen, position) in position_observers().items():
        method = METHODS[name]
        files = observer_files(chosen, position)
        rows = observer_inputs(method, position.gains, COUNT, 5)
        yield _observer(name, method.code, "drive_observer.h", files, rows)


def _observer(
    name: str, code: str, header: str, files: dict[str, bytes], rows: NDArray[np.float32]
) -> Step:
    angle = code == "reduced_order"
    return Step(
        f"{'speed' if angle else 'position'} observer {name}", "float32", files, header,
        f"const drive_{code}_gains_t *gains, drive_{code}_t *state, drive_alphabeta_t v,"
        f" drive_alphabeta_t i{', float theta_e' if angle else ''}",
        f"drive_{code}_step(gains, state, v, i{', theta_e' if angle else ''});",
        f"&DRIVE_{code.upper()}_GAINS, &state, v, i{', r[7]' if angle else ''}", rows, "void",
        f"static drive_{code}_t state; drive_alphabeta_t v; drive_alphabeta_t i;", "",
        f"if (r[0] > 0.0F) {{ drive_{code}_start(&state, r[1], r[2]); }}"
        " v.alpha = r[3]; v.beta = r[4]; i.alpha = r[5]; i.beta = r[6];",
    )  # fmt: skip
