"""The neutral C header and its test vectors: from a solution to text,
through plain data only (docs/header.md).
"""

from __future__ import annotations

import math
import textwrap
from textwrap import wrap
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import QFormats
from dqforge.optimizer.current_reference.forms import Emitted, SignedReference
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.fixed_control.gains import pi_integers
from dqforge.optimizer.loops.gains import LoopGains, per_unit
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.title import title
from dqforge.reports.current_reference.evaluator import (
    reference_context,
    vectors_context,
    vectors_template,
)
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.loops.robustness_text import robust_lines
from dqforge.reports.observers.speed_loop_text import observed_notes
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

_COMMENT_WIDTH = 110


_COMPILING = {
    "float32": (
        (
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
            "errors hold either way."
        ),
        "Plain C99 and C++11; fabsf and sqrtf are the only library functions that may be used.",
    ),
    "fixed": (
        (
            "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign "
            "(checked below)."
        ),
        "No overflow for any torque: proven by interval analysis of every product, sum and result.",
    ),
}


def _entry(name: str, value: float, comment: str) -> PlainData:
    return {"name": name, "value": value, "comment": comment}


def _machine_group(solution: Solution) -> PlainData:
    machine = solution.design.machine
    rest = "" if isinstance(machine, LinearMachine) else "; at zero current, the machine saturates"
    return {
        "title": "Machine (dq quantities are amplitude-invariant: peak of phase)",
        "comment": [],
        "entries": [
            _entry("POLE_PAIRS", machine.pole_pairs, "number of pole pairs"),
            _entry("R_S_OHM", machine.r_s, "phase resistance, Ohm"),
            _entry(
                "L_D_H",
                machine.l_d,
                f"d-axis inductance, H{rest}; decoupling v_q += omega_e (L_D i_d + PSI_PM)",
            ),
            _entry(
                "L_Q_H",
                machine.l_q,
                f"q-axis inductance, H{rest}; decoupling v_d -= omega_e L_Q i_q",
            ),
            _entry("PSI_PM_WB", machine.psi_pm, "magnet flux linkage, Wb (peak)"),
            _entry("CURRENT_MAX_A", solution.design.i_max, "current limit, A (peak)"),
            *_torque_limits(solution.reference),
        ],
    }


def _torque_limits(reference: Emitted) -> list[PlainData]:
    """End of the torque domain, and its code in fixed point.

    Both ends where the signs of the torque differ.
    """
    if isinstance(reference, SignedReference):
        name, end = "TORQUE_MAX_NEGATIVE_NM", shortest(reference.negative.torque_max)
        below = _entry(name, end, "magnitude of its end for negative torques, N m")
        return [*_torque_limits(reference.positive), below]
    if not isinstance(reference, FixedReference):
        return [
            _entry("TORQUE_MAX_NM", shortest(reference.torque_max), "end of the torque domain, N m")
        ]
    name, bits = reference.format.upper(), reference.width - 1
    return [
        _entry("TORQUE_MAX_NM", reference.torque_max, "end of the torque domain, N m"),
        _entry(
            f"TORQUE_MAX_{name}", reference.end, f"the same over BASE_TORQUE_NM, times 2^{bits}"
        ),
    ]


def _operation_group(solution: Solution) -> list[PlainData]:
    """The speed for which the references weaken the field, where there is one."""
    speed = solution.fit.speed
    if speed is None:
        return []
    return [
        {
            "title": "The one speed for which the current references hold",
            "comment": [
                (
                    "Below it they keep the voltage limit with current to spare, above it they "
                    "exceed the limit."
                )
            ],
            "entries": [
                _entry("REFERENCE_SPEED_RAD_PER_S", speed.omega_m, "mechanical speed, rad/s"),
                _entry(
                    "REFERENCE_VOLTAGE_V",
                    speed.v_max,
                    "phase amplitude that is not exceeded there, V",
                ),
            ],
        }
    ]


def _bases_group(solution: Solution) -> PlainData:
    bases = solution.design.control.bases
    return {
        "title": "Bases of the per-unit gains",
        "comment": [],
        "entries": [
            _entry("BASE_CURRENT_A", bases.current, "A"),
            _entry("BASE_VOLTAGE_V", bases.voltage, "V"),
            _entry("BASE_SPEED_RAD_PER_S", bases.speed, "mechanical speed, rad/s"),
            _entry("BASE_TORQUE_NM", bases.torque, "N m"),
        ],
    }


def margin_text(gains: LoopGains) -> list[str]:
    """Two lines that say how good a loop is, in engineering units."""
    gain_margin = (
        20.0 * math.log10(gains.gain_margin) if math.isfinite(gains.gain_margin) else math.inf
    )
    crossover = gains.crossover / (2.0 * math.pi)
    phase_margin = math.degrees(gains.phase_margin)
    pole, delay = abs(gains.poles[0]), gains.delay_margin_samples
    seen = [
        line
        for note in observed_notes(gains)
        for line in wrap(f"{note[0].upper()}{note[1:]}.", 110)
    ]
    return [
        *seen,
        (
            f"Crossover {crossover:.4g} Hz, phase margin {phase_margin:.1f} deg, gain margin "
            f"{gain_margin:.1f} dB,"
        ),
        (
            f"delay margin {delay:.2f} samples, largest pole {pole:.6f}, M_s "
            f"{gains.max_sensitivity:.2f}."
        ),
    ]


def _gain_group(
    gains: LoopGains,
    name: str,
    units: tuple[str, str],
    bases: tuple[float, float],
    q_formats: QFormats | None,
    robust: list[str],
) -> PlainData:
    """Macros of one PI controller.

    ``units`` are those of kp and ki as (macro suffix, text) pairs joined by '|'.

    ``robust`` are the lines on the tolerances.
    """
    kp_suffix, kp_unit = units[0].split("|")
    ki_suffix, ki_unit = units[1].split("|")
    kp_pu, ki_ts_pu = per_unit(gains, *bases)
    entries = [
        _entry(f"{name}_KP_{kp_suffix}", gains.kp, f"proportional gain, {kp_unit}"),
        _entry(f"{name}_KI_{ki_suffix}", gains.ki, f"integral gain, {ki_unit}"),
        _entry(
            f"{name}_KI_TS_{kp_suffix}",
            gains.ki_ts,
            f"integral gain times sampling period, {kp_unit}",
        ),
        _entry(f"{name}_T_I_S", gains.t_i, "integral time kp/ki of the series form, s"),
        _entry(
            f"{name}_Q0_{kp_suffix}",
            gains.velocity[0],
            f"velocity form d[k] = d[k-1] + q0 e[k] + q1 e[k-1], {kp_unit}",
        ),
        _entry(f"{name}_Q1_{kp_suffix}", gains.velocity[1], f"its factor of e[k-1], {kp_unit}"),
        _entry(f"{name}_ANTI_WINDUP_PER_S", gains.anti_windup, "back-calculation gain, 1/s"),
        _entry(f"{name}_KP_PU", kp_pu, "proportional gain, per unit"),
        _entry(f"{name}_KI_TS_PU", ki_ts_pu, "integral gain times sampling period, per unit"),
    ]
    for label, number in zip(
        ("KP", "KI_TS"), pi_integers(kp_pu, ki_ts_pu, q_formats) or (), strict=False
    ):
        bits = number.shift
        entries.append(
            _entry(f"{name}_{label}_PU_Q{bits}", number.mantissa, f"per unit times 2^{bits}")
        )
    titles = {
        "ID": "PI controller of i_d",
        "IQ": "PI controller of i_q",
        "SPEED": "PI controller of the speed (its output is torque)",
    }
    return {
        "title": f"{titles[name]}: method {gains.method}, sampled every {gains.t_s * 1e6:.6g} us",
        "comment": [
            "d[k] = d[k-1] + kp (e[k] - e[k-1]) + ki_ts e[k]",
            *margin_text(gains),
            *robust,
        ],
        "entries": entries,
    }


def _no_gains_group(solution: Solution) -> PlainData:
    """Why there are no controllers, in place of them."""
    why = textwrap.wrap(solution.gains_left_out, _COMMENT_WIDTH)
    return {"title": "No controllers", "comment": why, "entries": []}


def _gain_groups(solution: Solution) -> list[PlainData]:
    control, gains = solution.design.control, solution.loops
    if gains is None:
        return [_no_gains_group(solution)]
    bases = control.bases
    volts = ("V_PER_A|V/A", "V_PER_AS|V/(A s)")
    current = (bases.current, bases.voltage)
    groups = [
        {
            "title": "Sampling",
            "comment": [],
            "entries": [_entry("T_S_S", control.t_s, "sampling period of the current control, s")],
        },
        _gain_group(
            gains.i_d,
            "ID",
            volts,
            current,
            control.current_loop.q_formats,
            robust_lines(gains, "i_d"),
        ),
        _gain_group(
            gains.i_q,
            "IQ",
            volts,
            current,
            control.current_loop.q_formats,
            robust_lines(gains, "i_q"),
        ),
    ]
    if gains.speed is not None and control.speed_loop is not None:
        torque = ("NMS_PER_RAD|N m s/rad", "NM_PER_RAD|N m/rad")
        of_speed, lines = (bases.speed, bases.torque), robust_lines(gains, "speed")
        group = _gain_group(
            gains.speed, "SPEED", torque, of_speed, control.speed_loop.q_formats, lines
        )
        ratio = _entry("SPEED_RATIO", control.speed_loop.ratio, "current samples per speed sample")
        group["entries"].insert(0, ratio)
        groups.append(group)
    return groups


def _observer_group(solution: Solution) -> list[PlainData]:
    observer = None if solution.loops is None else solution.loops.observer
    if observer is None:
        return []
    group = {
        "title": "Reduced-order speed observer (mechanical speed)",
        "comment": [
            "omega_hat[k] = zeta[k] - C i_q[k];  zeta[k+1] = A zeta[k] + B_U u_q[k] + B_I i_q[k]",
            "u_q = v_q - p omega_m L_D i_d, with the voltage that acts from sample k to k+1.",
            f"Continuous pole {observer.continuous_pole:.6g} 1/s; exact for held voltage.",
        ],
        "entries": [
            _entry("OBSERVER_A", observer.a, "pole in the z plane, dimensionless"),
            _entry("OBSERVER_B_U_RAD_PER_VS", observer.b_u, "rad/(s V)"),
            _entry("OBSERVER_B_I_RAD_PER_AS", observer.b_i, "rad/(s A)"),
            _entry("OBSERVER_C_RAD_PER_AS", observer.c, "rad/(s A)"),
        ],
    }
    return [group]


def _drive_text(design: Design) -> str:
    return (
        f"{design.machine.pole_pairs} pole pairs, {design.inverter.v_dc:.6g} V dc link, "
        f"{design.i_max:.6g} A (peak), control sampled every {design.control.t_s * 1e6:.6g} us."
    )


def header_context(solution: Solution) -> PlainData:
    """Everything that the header prints, as plain data.

    The `reference` entry alone rebuilds the evaluator's float32 model (`reference_ir.from_plain`).
    """
    design = solution.design
    plain = to_plain(solution.reference)
    return {
        **title(design),
        "preamble": [
            _drive_text(design),
            "Units stand in the names and comments; angles in rad, dq quantities as peak of phase.",
            *_COMPILING["float32" if plain["format"] == "float32" else "fixed"],
            *(line for evidence in design.flux_evidence for line in evidence.short()),
        ],
        "groups": [
            _machine_group(solution),
            *_operation_group(solution),
            _bases_group(solution),
            *_gain_groups(solution),
            *_observer_group(solution),
        ],
        "reference": reference_context(solution, plain),
    }


def header_files(solution: Solution) -> dict[str, bytes]:
    """Names and bytes of the emitted C files: the header and its test vectors."""
    prefix = solution.design.export.prefix
    contents: dict[str, Any] = {
        f"{prefix}.h": render("main_header/header.h.j2", header_context(solution)),
        f"{prefix}_vectors.h": render(
            vectors_template(solution.reference), vectors_context(solution)
        ),
    }
    return {name: text.encode("ascii") for name, text in contents.items()}
