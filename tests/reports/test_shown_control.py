"""What tables and report show of loops, observers and fixed-point control can be made
from the JSON result alone.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache
from itertools import count
from typing import Any

import pytest
from drives import IPM, make_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, Tolerances
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.loops.loop_gains import step_response
from dqforge.optimizer.observers.reduced_order import errors_at_loads
from dqforge.reports.control.fixed_header import (
    control_fixed_files,
    control_fixed_tables,
    plain_fixed_evidence,
)
from dqforge.reports.loops.capability import loop_table
from dqforge.reports.loops.proven_text import gains_tables, plain_gains
from dqforge.reports.observers.position_header import speed_tables
from dqforge.reports.observers.position_text import position_parts
from dqforge.reports.pages.html_text import NARROW, number, quantity, share
from dqforge.reports.pages.templating import to_text

RPM = 30.0 / math.pi


def _read(key: str, plain: Any) -> Any:
    """What stands in the JSON text, numbers of nine digits."""
    return json.loads(to_text("test", "test", {key: plain}))[key]


@cache
def _solved() -> tuple[Design, GainSet]:
    design = make_design()
    formats = replace(design.control.current_loop, q_formats=(10, 15))
    design = replace(
        design,
        control=replace(
            design.control, current_loop=formats, tolerances=Tolerances(r_s=(-0.3, 0.3))
        ),
    )
    return design, solve_gains(design)


def test_rows_of_tune_are_in_the_result() -> None:
    """Every cell of a loop's row, written again from the JSON."""
    design, gains = _solved()
    plain, table = _read("gains", plain_gains(design, gains)), gains_tables(design, gains)[0]
    units = {"i_d": "V/A", "i_q": "V/A", "speed": "N m s/rad"}
    for row in table.rows:
        of = plain[row[0]]
        scaled = f"{of['kp_pu']:.5g}, {of['ki_ts_pu']:.4g}"
        if "kp_q" in of:
            scaled = ", ".join(
                f"{of[name]} (Q{bits})"
                for name, bits in zip(("kp_q", "ki_ts_q"), of["q_formats"], strict=True)
            )
        assert row == (
            row[0],
            of["method"],
            f"{of['kp']:.5g} {units[row[0]]}",
            f"{of['ki']:.5g}",
            scaled,
            f"{of['crossover_rad_per_s'] / (2.0 * math.pi):.4g}",
            f"{math.degrees(of['phase_margin_rad']):.1f}" + ("" if of["stable"] else " (unstable)"),
            f"{20.0 * math.log10(of['gain_margin']):.1f}",
            f"{of['delay_margin_s'] * 1e6:.3g}",
            f"{of['max_sensitivity']:.2f}",
        )
    assert {row[0] for row in table.rows} == {"i_d", "i_q", "speed"}
    assert "(Q10)" in table.rows[0][4]


def test_answers_to_disturbances_and_delays_are_in_the_result() -> None:
    """Delay margin in samples, largest deviation and settling time of the current loops.

    Null on an observer.
    """
    design, gains = _solved()
    plain = _read("gains", plain_gains(design, gains))
    rows = {str(row.cells[0]): row.cells[1:] for row in loop_table(gains).rows}
    for column, name in enumerate(("i_d", "i_q", "speed")):
        samples = number(plain[name]["delay_margin_samples"], 3)
        assert f"({samples} samples)" in rows["delay margin"][column]
        assert plain[name]["delay_margin_samples"] == pytest.approx(
            plain[name]["delay_margin_s"] / plain[name]["t_s"]
        )
    shown = rows["largest deviation after a unit disturbance"]
    for column, name in enumerate(("i_d", "i_q")):
        peak, settled = plain[name]["disturbance_peak"], plain[name]["disturbance_settling_s"]
        assert shown[column] == f"{number(peak, 3)} A per V, settled in {quantity(settled, 's', 3)}"
        found = step_response(gains.i_q if name == "i_q" else gains.i_d, 4.0 * settled)
        assert max(abs(found.disturbance)) == pytest.approx(
            peak, rel=1e-3
        )  # not every sample is a point
    assert plain["speed"]["disturbance_peak"] is None
    assert "observed" in plain["speed"]


def test_errors_of_the_speed_observer_are_in_the_result() -> None:
    """Slopes of the terminal and errors at loads of the report; T_L/(J g) and -0.3 R g/(g p psi),
    see test_tables.
    """
    design, gains = _solved()
    assert gains.observer is not None
    errors = errors_at_loads(design.machine, gains.observer, 471.0, (0.0, 60.0))
    plain = _read("gains", plain_gains(design, gains, errors))["observer_errors"]
    assert plain["load_rad_per_s_per_Nm"] == pytest.approx(1.0 / (0.05 * 500.0), rel=1e-6)
    assert plain["resistance_rad_per_s_per_A"] == pytest.approx(
        -0.3 * 2e-3 / (4 * 0.1049), rel=1e-6
    )
    notes = gains_tables(design, gains)[-1].notes
    assert f"by {plain['load_rad_per_s_per_Nm'] * RPM:.3g} rpm" in notes[1]
    assert f"{100.0 * plain['resistance_error']:.0f} % too high" in notes[2]
    assert f"by {plain['resistance_rad_per_s_per_A'] * RPM:.3g} rpm" in notes[2]
    rows = speed_tables(gains.observer, errors)[1].rows
    for row, found in zip(rows, plain["steady"], strict=True):
        cells = [quantity(found["load_Nm"], "N m")]
        for error in (found["exact"], found["resistance_too_high"]):
            rest = f"{quantity(error['speed_rad_per_s'], 'rpm', 3)} ({share(error['relative'], 2)})"
            cells.append(f"0{NARROW}rpm" if abs(error["relative"]) < 1e-9 else rest)
        assert row.cells[1:] == tuple(cells)
        assert found["omega_m_rad_per_s"] == 471.0
    assert "observer_errors" not in plain_gains(
        design, replace(gains, observer=None, observer_slopes=None)
    )


def test_errors_of_a_position_observer_at_the_shown_speeds_are_in_the_result() -> None:
    design = make_design()
    control = replace(design.control, observer=ObserverSettings(method="flux"), speed_loop=None)
    gains = solve_gains(replace(design, control=control))
    assert gains.position is not None
    shown = _read("gains", plain_gains(design, gains))["position"]["shown"]
    (_, columns, rows, _), (_, _, speeds, _) = position_parts(gains.position)
    assert len(shown["omega_rad_per_s"]) == len(rows) == 5
    for k, row in enumerate(rows):
        assert row[0] == f"{shown['omega_rad_per_s'][k] / (2.0 * math.pi):.4g}"
        found = {"noise r.m.s.": "noise_rad", "steady": "steady_rad", "together": "total_rad"}
        for heading, key in found.items():
            assert row[columns.index(heading)] == f"{math.degrees(shown[key][k]):.3g}"
        assert row[columns.index("acceleration")] == f"{math.degrees(shown['lag_rad'][k]):+.3g}"
        assert row[columns.index("largest pole")] == f"{shown['largest_pole'][k]:.5f}"
        degrees = [math.degrees(values[k]) for values in shown["bias_rad"].values()]
        biases = [f"{round(angle, 4) + 0.0:+.3g}" for angle in degrees]
        assert list(row[1 : 1 + len(biases)]) == biases
        together = round(100.0 * shown["speed_total_rad_per_s"][k] / shown["omega_rad_per_s"][k], 2)
        assert speeds[k][-1] == f"{together:.3g}"


@cache
def three_decimals() -> FixedControlFit:
    design = make_design(replace(IPM, omega_m_max=942.0))
    gains = solve_gains(design)
    return fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, 16)


def test_rows_of_fixed_point_control_are_in_the_result() -> None:
    fit = three_decimals()
    plain, table = _read("control", plain_fixed_evidence(fit)), control_fixed_tables([fit])[0]
    assert {row[0] for row in table.rows} == {"i_d", "i_q", "speed"}
    for row in table.rows:
        of = plain["loops"][row[0]]
        errors = [f"{of[key]:+.1e}" for key in ("kp_error", "ki_ts_error", "velocity_ki_error")]
        assert [row[2], row[4], row[5]] == errors
        assert row[6] == ("-" if of["largest_pole"] is None else f"{of['largest_pole']:.6f}")
        assert row[7] == (
            "-" if of["phase_margin_rad"] is None else f"{math.degrees(of['phase_margin_rad']):.2f}"
        )
        assert list(row[9:]) == [f"{of['dead_band_codes']}", f"{of['dead_band_in_one_word_codes']}"]
        mantissa, shift = of["ki_ts"]["mantissa"], of["ki_ts"]["shift"]
        half = 1 << shift >> 1
        moved = [
            next(e for e in count(1) if (sign * mantissa * e + half) >> shift) for sign in (1, -1)
        ]
        assert of["dead_band_in_one_word_codes"] == max(moved)
    one_code = plain["one_code"]
    told = f"one code is {one_code['current_A']:.3g} A, or {one_code['speed_rad_per_s']:.3g} rad/s"
    assert told in " ".join(table.notes)
    header = control_fixed_files(make_design(), fit)["drive_control_q15.h"].decode("ascii")
    assert f"a dc link below {plain['dc_least_V']:.4g} V counts" in header
    fullest = plain["fullest"]
    assert f"'{fullest['name']}' reaches {fullest['share']:.3%}" in table.notes[0]
    assert fullest["share"] == pytest.approx(
        max(
            max(abs(reach["low"]), abs(reach["high"])) / 2.0 ** (reach["bits"] - 1)
            for reach in plain["ranges"]
        )
    )
