"""The steps of a drive's chain in fixed point, for the cost table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
from chain_steps import COUNT, design_of, drive_rows, position_observers, solution
from control_chain import Step
from drives import IPM
from numpy.typing import NDArray

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.names import ModulationName, NumberFormat
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.fixed_control.codes import FIXED_MODULATORS
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FIXED_METHODS,
    solve_fixed_observers,
)
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.solution import solve
from dqforge.reports.control.fixed_header import control_fixed_files
from dqforge.reports.fixed_observers.fixed_observer_header import fixed_observer_files
from dqforge.reports.main_header import header_files
from dqforge.reports.single_headers.fixed_reference import reference_files


def _width(number_format: str) -> int:
    return 16 if number_format == "q15" else 32


def _number(number_format: str) -> str:
    return f"int{_width(number_format)}_t"


@cache
def control_in_integers(number_format: NumberFormat) -> dict[str, bytes]:
    """Headers of the control and of the references that it calls."""
    found, width = solution(), _width(number_format)
    references = {fit.reference.width: fit for fit in found.fixed_references}
    controls = {fit.control.width: fit for fit in found.fixed if isinstance(fit, FixedControlFit)}
    return control_fixed_files(found.design, controls[width]) | reference_files(
        found.design, references[width]
    )


def _codes(values: NDArray[np.float64], number_format: str) -> NDArray[np.int32]:
    """Shares of full scale as codes, held within them."""
    full = 2.0 ** (_width(number_format) - 1)
    return np.asarray(np.clip(np.round(values * full), -full, full - 1.0), dtype=np.int32)


def _angles(theta: NDArray[np.float64], number_format: str) -> NDArray[np.int32]:
    """Angles in rad as codes of a turn."""
    width = _width(number_format)
    turns = np.round(theta / (2.0 * np.pi) * 2.0**width).astype(np.int64) % 2**width
    return np.asarray(turns.astype(np.uint32).view(np.int32), dtype=np.int32)


@cache
def fixed_rows(number_format: NumberFormat) -> NDArray[np.int32]:
    """The rows of the float32 control in codes: currents, angle, speed, DC link and references."""
    bases, rows = solution().design.control.bases, drive_rows().astype(np.float64)
    assert bases is not None
    scales = np.array(
        [*[bases.current] * 3, 1.0, bases.speed, 2.0 * bases.voltage, *[bases.current] * 2]
    )
    codes = _codes(rows[:, :8] / scales, number_format)
    codes[:, 3] = _angles(rows[:, 3], number_format)
    return codes


def one_torque_reference(number_format: NumberFormat) -> Step:
    """The reference of the main header, a function of the torque alone."""
    fit = FitSettings(
        degree=4, format=number_format, torque_max=200.0, full_scale=(240.0, IPM.i_max)
    )
    design = design_of(fit=replace(fit, form="polynomial"))
    found = solve(replace(design, export=replace(design.export, control=())))
    reference, number = found.fit.reference, _number(number_format)
    assert isinstance(reference, FixedReference)
    torque = np.random.default_rng(1).uniform(-210.0, 210.0, COUNT).astype(np.float32)
    codes = reference.nearest(torque).astype(np.int32)[:, None]
    return Step(
        "torque reference", number_format, header_files(found), "drive.h",
        f"{number} torque, {number} *i_d, {number} *i_q",
        f"drive_current_reference_{number_format}(torque, i_d, i_q);",
        f"({number})r[0], &i_d, &i_q", codes, state=f"{number} i_d; {number} i_q;",
    )  # fmt: skip


def torque_mesh(number_format: NumberFormat) -> Step:
    """The reference of the integer control: torque, DC link and speed."""
    f, number = number_format, _number(number_format)
    torque = np.random.default_rng(6).uniform(-0.9, 0.9, COUNT)
    rows = np.column_stack([fixed_rows(f), _codes(torque, f)])
    return Step(
        "torque reference of the control", f, control_in_integers(f), f"drive_reference_{f}.h",
        f"{number} torque, {number} v_dc, {number} omega_m",
        f"return drive_reference_{f}(torque, v_dc, omega_m);",
        f"({number})r[8], ({number})r[5], ({number})r[4]", rows, f"drive_dq_{f}_t",
    )  # fmt: skip


def _controlled(
    label: str, f: NumberFormat, function: str, argument: str, parameter: str, prepare: str = ""
) -> Step:
    number, angle = _number(f), f"u{_number(f)}"
    members = ("i.a", "i.b", "i.c", "theta_e", "omega_m", "v_dc")
    measured = " ".join(
        f"measured.{member} = ({angle if member == 'theta_e' else number})r[{k}];"
        for k, member in enumerate(members)
    )
    reference = f" drive_dq_{f}_t reference;" if prepare else ""
    return Step(
        label, f, control_in_integers(f), f"drive_control_{f}.h",
        f"const drive_control_gains_{f}_t *gains, drive_control_{f}_t *state,"
        f" const drive_measured_{f}_t *measured, {parameter} reference",
        f"return drive_{function}_{f}(gains, state, measured, reference);",
        f"&DRIVE_CONTROL_GAINS_{f.upper()}, &state, &measured, {argument}", fixed_rows(f),
        f"drive_duties_{f}_t",
        f"static drive_control_{f}_t state; static drive_measured_{f}_t measured;{reference}",
        f"drive_control_start_{f}(&state);", f"{measured} {prepare}",
    )  # fmt: skip


def fixed_current_control(f: NumberFormat) -> Step:
    prepare = f"reference.d = ({_number(f)})r[6]; reference.q = ({_number(f)})r[7];"
    return _controlled(
        "current control", f, "current_control", "reference", f"drive_dq_{f}_t", prepare
    )


def fixed_speed_control(f: NumberFormat) -> Step:
    number = _number(f)
    return _controlled(
        "speed control, the whole step", f, "speed_control", f"({number})(r[4] / 2)", number
    )


def fixed_speed_loop(f: NumberFormat) -> Step:
    number = _number(f)
    return Step(
        "speed loop, mean over its samples", f, control_in_integers(f), f"drive_control_{f}.h",
        f"const drive_control_gains_{f}_t *gains, drive_control_{f}_t *state, {number} omega_m,"
        f" {number} reference",
        f"return drive_speed_loop_{f}(gains, state, omega_m, reference);",
        f"&DRIVE_CONTROL_GAINS_{f.upper()}, &state, ({number})r[4], ({number})(r[4] / 2)",
        fixed_rows(f), number, f"static drive_control_{f}_t state;",
        f"drive_control_start_{f}(&state);",
    )  # fmt: skip


def fixed_modulators(f: NumberFormat) -> Iterator[Step]:
    """Duty cycles of voltages within half the range, and of any currents."""
    number, gains = _number(f), solution().gains
    names: list[ModulationName] = list(FIXED_MODULATORS)
    for name in names:
        design = design_of(name)
        fit = fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, _width(f))
        yield Step(
            f"modulator {name}", f, control_fixed_files(design, fit), f"drive_control_{f}.h",
            f"drive_alphabeta_{f}_t v, {number} v_dc, drive_abc_{f}_t i",
            f"return drive_duties_{f}(v, v_dc, i);", f"v, ({number})r[5], i", fixed_rows(f),
            f"drive_duties_{f}_t", f"drive_alphabeta_{f}_t v; drive_abc_{f}_t i;", "",
            f"v.alpha = ({number})(r[0] / 2); v.beta = ({number})(r[1] / 2);"
            f" i.a = ({number})r[0]; i.b = ({number})r[1]; i.c = ({number})r[2];",
        )  # fmt: skip


def fixed_speed_observer(f: NumberFormat) -> Step:
    number = _number(f)
    return Step(
        "speed observer reduced-order", f, control_in_integers(f), f"drive_control_{f}.h",
        f"const drive_reduced_order_gains_{f}_t *gains, drive_reduced_order_{f}_t *state,"
        f" drive_dq_{f}_t v, drive_dq_{f}_t i",
        f"drive_reduced_order_step_{f}(gains, state, v, i);",
        f"&DRIVE_REDUCED_ORDER_GAINS_{f.upper()}, &state, v, i", fixed_rows(f), "void",
        f"static drive_reduced_order_{f}_t state; drive_dq_{f}_t v; drive_dq_{f}_t i;", "",
        f"v.d = ({number})r[0]; v.q = ({number})r[1]; i.d = ({number})r[6]; i.q = ({number})r[7];",
    )  # fmt: skip


def turning_rows(f: NumberFormat) -> NDArray[np.int32]:
    """Three drives of a hundred samples each: first or not, angle, speed, voltages, currents."""
    design, count = solution().design, 100
    bases = design.control.bases
    assert bases is not None
    found = []
    for share in (0.1, -0.4, 0.7):
        omega_e = share * bases.speed * IPM.pole_pairs
        theta = 0.3 + omega_e * design.control.t_s * np.arange(count, dtype=np.float64)
        voltage = omega_e * IPM.psi_pm / bases.voltage
        sizes = ((voltage, 1.6), (voltage, 0.03), (0.3, 1.5), (0.3, -0.1))
        seen = [size * np.cos(theta + shift) for size, shift in sizes]
        found.append(
            np.column_stack(
                [np.arange(count) == 0, _angles(theta, f), _codes(np.full(count, share), f)]
                + [_codes(np.clip(one, -0.95, 0.95), f) for one in seen]
            ).astype(np.int32)
        )
    return np.concatenate(found)


def fixed_observers(f: NumberFormat) -> Iterator[Step]:
    """One step of every position observer that there is in integers."""
    number, every = _number(f), position_observers()
    for name in FIXED_METHODS:
        design, position = every[name]
        code = METHODS[name].code
        fit = next(
            one for one in solve_fixed_observers(design, position) if one.observer.format == f
        )
        yield Step(
            f"position observer {name}", f, fixed_observer_files(design, fit),
            f"drive_observer_{f}.h",
            f"const drive_{code}_gains_{f}_t *gains, drive_{code}_{f}_t *state,"
            f" drive_alphabeta_{f}_t v, drive_alphabeta_{f}_t i",
            f"drive_{code}_step_{f}(gains, state, v, i);",
            f"&DRIVE_{code.upper()}_GAINS_{f.upper()}, &state, v, i", turning_rows(f), "void",
            f"static drive_{code}_{f}_t state; drive_alphabeta_{f}_t v; drive_alphabeta_{f}_t i;",
            "",
            f"if (r[0] != 0) {{ drive_{code}_start_{f}(&state, (u{number})r[1], ({number})r[2]); }}"
            f" v.alpha = ({number})r[3]; v.beta = ({number})r[4];"
            f" i.alpha = ({number})r[5]; i.beta = ({number})r[6];",
        )  # fmt: skip
