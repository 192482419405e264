"""Tables of the HTML report: results become cells of text here; the template only lays them out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.settings import Core, QFormats
from dqforge.machines.synchronous import FloatArray, LinearMachine, copper_loss
from dqforge.optimizer.current_choice import OperatingPoints
from dqforge.optimizer.current_reference import ReferenceErrors
from dqforge.optimizer.fit_alternatives import Alternative
from dqforge.optimizer.fit_choice import Trial
from dqforge.optimizer.fixed_gains import pi_integers
from dqforge.optimizer.gains import LoopGains, per_unit
from dqforge.optimizer.observer import ObserverError, steady_state_error
from dqforge.optimizer.observer_tuning import PositionObserver
from dqforge.optimizer.point_losses import LossComparison
from dqforge.optimizer.reference_fit import ReferenceFit
from dqforge.optimizer.solution import Curves, GainSet
from dqforge.reports.c_numbers import rounded_up
from dqforge.reports.html_text import NARROW, decibel, degrees, number, quantity, raised, share, symbols, unit_text
from dqforge.reports.labels import (
    MODULATION_LABELS,
    WITHOUT_BRIDGE,
    core_name,
    friction_text,
    obstacle,
    part_label,
    point_text,
    shown_parts,
    watts,
)
from dqforge.reports.observed_text import observed_notes
from dqforge.reports.observer_text import position_parts
from dqforge.reports.reference_ir import PlainData

if TYPE_CHECKING:
    from markupsafe import Markup

STRATEGY_TEXT = {"mtpa": "MTPA", "id0": "i_d = 0", "least-loss": "least loss"}
LOOP_TEXT = {"i_d": "i_d", "i_q": "i_q", "speed": "speed"}
_KP_UNITS = {"i_d": "V/A", "i_q": "V/A", "speed": f"N{NARROW}m{NARROW}s/rad"}
_KI_UNITS = {"i_d": "V/(A s)", "i_q": "V/(A s)", "speed": f"N{NARROW}m/rad"}
_SHARES_OF_TORQUE = (0.1, 0.25, 0.5, 0.75, 1.0)
R_ERROR = 0.3
"""Relative error of the resistance for which the observer's speed error is stated."""

_ROUNDING = 1e-9
"""Relative speed error that is nothing but rounding."""


@dataclass(frozen=True, slots=True)
class Row:
    """Cells of one row; ``mark`` is ``best``, ``chosen`` or ``muted``, or empty."""

    cells: tuple[str | Markup, ...]
    mark: str = ""


@dataclass(frozen=True, slots=True)
class HtmlTable:
    """A table with a caption; the first ``text_columns`` columns are text, the others are set as numbers."""

    caption: str | Markup
    columns: tuple[str | Markup, ...]
    rows: tuple[Row, ...]
    text_columns: int = 1


def _headings(*texts: str) -> tuple[Markup, ...]:
    return tuple(symbols(text) for text in texts)


def fact_rows(design: Design) -> list[tuple[Markup, str]]:
    """The drive in one glance: label and value."""
    machine, inverter, control = design.machine, design.inverter, design.control
    rest = "" if isinstance(machine, LinearMachine) else " at zero current"
    facts = [
        ("pole pairs", f"{machine.pole_pairs}"),
        ("phase resistance R_s", quantity(machine.r_s, "Ohm")),
        (f"inductance L_d{rest}", quantity(machine.l_d, "H")),
        (f"inductance L_q{rest}", quantity(machine.l_q, "H")),
        ("magnet flux \u03c8_PM (peak)", quantity(machine.psi_pm, "Wb")),
        ("current limit (peak)", quantity(design.i_max, "A")),
        ("dc link", quantity(inverter.v_dc, "V")),
        ("switching frequency", quantity(inverter.f_sw, "Hz")),
        ("current control every", quantity(control.t_s, "s")),
    ]
    if machine.inertia is not None:
        facts.append(("inertia", quantity(machine.inertia, "kg m^2")))
    if machine.omega_m_max is not None:
        facts.append(("largest speed", quantity(machine.omega_m_max, "rpm")))
    if design.operation.omega_m is not None:
        facts.append(("speed of the references", quantity(design.operation.omega_m, "rpm")))
    return [(symbols(label), value) for label, value in facts]


def value_rows(design: Design) -> list[PlainData]:
    """Every value of the input file; all text of it is left to the template to escape."""
    return [
        {
            "path": value.path,
            "text": value.text,
            "si": f"{number(value.si, 6)}{NARROW}{unit_text(value.unit)}".rstrip(),
            "source": value.source,
            "inferred": value.inferred,
            "note": value.note,
        }
        for value in design.values
    ]


def other_assumptions(design: Design) -> list[str]:
    """Assumptions that the table of values does not tell already."""
    told = tuple(f"{value.path} is inferred" for value in design.values if value.inferred)
    return [sentence for sentence in design.assumptions if not sentence.startswith(told or ("\0",))]


def losses_of(design: Design, points: OperatingPoints) -> FloatArray:
    """Copper loss in W of operating points, shape (N,)."""
    return copper_loss(design.machine.r_s, points.i_d, points.i_q)


def differs_from_id0(design: Design) -> bool:
    """Whether the design's strategy is anything else than i_d = 0."""
    return design.strategy != "id0" and design.machine.saliency != 0.0


def operating_table(design: Design, curves: Curves) -> HtmlTable:
    """Currents and copper loss at a few torques, beside those of i_d = 0."""
    chosen, id0 = curves.chosen, curves.id0 if differs_from_id0(design) else None
    loss = losses_of(design, chosen)
    loss_id0 = None if id0 is None else losses_of(design, id0)
    rows = []
    for part in _SHARES_OF_TORQUE:
        k = round(part * (chosen.torque.size - 1))
        cells = [number(chosen.torque[k]), number(chosen.i_d[k]), number(chosen.i_q[k])]
        cells += [number(float(np.hypot(chosen.i_d[k], chosen.i_q[k]))), watts(float(loss[k]))]
        if id0 is not None and loss_id0 is not None:
            if id0.limited[k]:
                cells += ["beyond the limit", "\u2013"]
            else:
                cells += [watts(float(loss_id0[k])), share(1.0 - float(loss[k] / loss_id0[k]), 3)]
        rows.append(Row(tuple(cells)))
    columns = ["Torque N m", "i_d A", "i_q A", "|i| A", "copper loss"]
    columns += [] if id0 is None else ["copper loss at i_d = 0", "saved"]
    return HtmlTable("Operating points, exact (currents are peak of phase)", _headings(*columns), tuple(rows), 0)


def _power_text(power: int) -> str:
    unit = ("A", "A/(N m)")[power] if power < 2 else f"A/(N m){raised(power)}"
    return f"x{raised(power)}, {unit}" if power > 1 else ("constant, A" if power == 0 else f"x, {unit}")


def _integer_table(segments: Sequence[PlainData], headings: Sequence[str]) -> HtmlTable:
    """Integers of each step of Horner's rule as the firmware holds them, one column per segment and axis."""
    rows = [Row(("start with", *(f"{row['leading']}" for row in segments)))]
    for step in range(max(len(row["steps"]) for row in segments)):
        cells = [row["steps"][step] if step < len(row["steps"]) else None for row in segments]
        texts = ["" if cell is None else f"{cell[0]:+d}, >> {cell[1]}" for cell in cells]
        rows.append(Row((f"step {step + 1}: times x", *texts)))
    return HtmlTable("Integers; x is the code of the torque minus the start", _headings("", *headings), tuple(rows))


def coefficient_table(plain: PlainData) -> HtmlTable | None:
    """Coefficients as the firmware holds them, highest power last, one column per segment and axis."""
    segments = [(axis, index, row) for axis in ("d", "q") for index, row in enumerate(plain.get(axis) or ())]
    if not segments:
        return None
    is_float, headings = plain["format"] == "float32", []
    for axis, index, row in segments:
        following = plain[axis][index + 1 :]
        end = following[0]["start"] if following else plain["torque_max"]
        domain = f"{number(row['start'])} to {number(end)} N m" if is_float else f"codes {row['start']} to {end}"
        headings.append(f"i_{axis}: {domain}")
    if not is_float:
        return _integer_table([row for _, _, row in segments], headings)
    lists = [row["coefficients"] for _, _, row in segments]
    rows = tuple(
        Row((_power_text(power), *(number(row[power], 9) if power < len(row) else "" for row in lists)))
        for power in range(max(len(row) for row in lists))
    )
    return HtmlTable(
        "Coefficients in single precision; x is the torque minus the start of the segment, in N m",
        _headings("Factor of", *headings),
        rows,
    )


def constant_rows(plain: PlainData) -> list[tuple[str, str]]:
    """Constants of the form beside its polynomials: meaning and value."""
    meanings = {
        "gain": ("gain", "A/(N m)" if plain["form"] == "proportional" else "A^2/(N m)"),
        "magnet": ("magnet torque per ampere, 3/2 p \u03c8_PM", "N m/A"),
        "slope": ("its slope over i_d, 3/2 p (L_d - L_q)", "N m/A^2"),
        "base": ("base current \u03c8_PM / (2 |L_q - L_d|)", "A"),
    }
    return [
        (symbols(text), f"{number(plain[key], 9)}{NARROW}{unit_text(unit)}")
        for key, (text, unit) in meanings.items()
        if key in plain
    ]


def ceiling(error: float, digits: int = 3) -> float:
    """A largest error with ``digits`` significant digits, rounded up."""
    return float(rounded_up(error, digits))


def _error_cells(errors: ReferenceErrors) -> tuple[str, ...]:
    return (
        quantity(ceiling(errors.torque), "N m", 3),
        share(ceiling(errors.torque_relative), 3),
        quantity(ceiling(errors.i_d), "A", 3),
        quantity(ceiling(errors.i_q), "A", 3),
        quantity(ceiling(errors.loss), "W", 3),
        share(ceiling(errors.loss_relative), 3),
        quantity(ceiling(errors.step_at_zero), "A", 3),
    )


def alternatives_table(fit: ReferenceFit, alternatives: Sequence[Alternative]) -> HtmlTable:
    """The reference that was chosen and what one change at a time would give."""
    chosen = Row(("this design", *_error_cells(fit.errors)), "chosen")
    rows = tuple(Row((row.label, *_error_cells(row.errors))) for row in alternatives)
    columns = ("", "torque error", "of largest", "i_d error", "i_q error", "extra loss", "extra loss", "step at zero")
    return HtmlTable("The price of each option: largest errors found", _headings(*columns), (chosen, *rows))


def trials_table(trials: Sequence[Trial], core: Core) -> HtmlTable:
    """The forms tried for a budget in order of cost; the last is the chosen one."""
    columns = ("", "format", "degree", "segments", "cycles", "constants", "torque error", "extra loss")
    rows = tuple(
        Row(
            (
                trial.form + (" (quick fit)" if trial.quick else ""),
                trial.format,
                f"{trial.degree}",
                f"{trial.segments}",
                f"{trial.cycles:.0f}",
                f"{trial.flash} B",
                share(ceiling(trial.errors.torque_relative), 3),
                share(ceiling(trial.errors.loss_relative), 3),
            ),
            "chosen" if trial is trials[-1] else "",
        )
        for trial in trials
    )
    return HtmlTable(f"Forms tried for the budget, by estimated cycles on {core_name(core)}", _headings(*columns), rows)


def _loop_cells(gains: LoopGains, bases: tuple[float, float], q_formats: QFormats | None) -> tuple[str, ...]:
    kp, ki_ts = per_unit(gains, *bases)
    per_unit_text = f"{number(kp, 5)}, {number(ki_ts, 5)}"
    integers = pi_integers(kp, ki_ts, q_formats)
    if integers is not None:
        per_unit_text += " = " + ", ".join(f"{found.mantissa} in Q{found.shift}" for found in integers)
    poles = ", ".join(_pole_text(complex(pole)) for pole in gains.poles)
    delay = f"{quantity(gains.delay_margin, 's', 3)} ({number(gains.delay_margin_samples, 3)} samples)"
    return (
        gains.method,
        quantity(gains.t_s, "s"),
        f"{number(gains.kp, 6)}{NARROW}{_KP_UNITS[gains.loop]}",
        f"{number(gains.ki, 6)}{NARROW}{_KI_UNITS[gains.loop]}",
        quantity(gains.t_i, "s", 5),
        ", ".join(number(value, 6) for value in gains.velocity),
        per_unit_text,
        quantity(gains.crossover / (2.0 * math.pi), "Hz"),
        degrees(gains.phase_margin) if gains.stable else f"{degrees(gains.phase_margin)} (unstable)",
        decibel(gains.gain_margin),
        delay,
        number(gains.max_sensitivity, 3),
        _disturbance_text(gains),
        poles,
        symbols("; ".join(observed_notes(gains))),
    )


def _pole_text(pole: complex) -> str:
    if abs(pole.imag) < 1e-9:
        return number(pole.real, 5)
    sign = "+" if pole.imag > 0.0 else "\u2212"
    return f"{number(pole.real, 4)}{NARROW}{sign}{NARROW}j{number(abs(pole.imag), 4)}"


def _disturbance_text(gains: LoopGains) -> str:
    response = gains.disturbance
    if gains.observed is not None:
        return "not computed with the observer"
    unit = "A per V" if gains.loop != "speed" else "rad/s per N m"
    finite = math.isfinite(response.settling_time)
    settled = f"settled in {quantity(response.settling_time, 's', 3)}" if finite else "settles later than was computed"
    return f"{number(response.peak, 3)} {unit}, {settled}"


def loop_table(design: Design, gains: GainSet) -> HtmlTable:
    """Gains, margins and poles, one column per loop."""
    control = design.control
    current = (control.bases.current, control.bases.voltage)
    columns = [_loop_cells(loop, current, control.current_loop.q_formats) for loop in (gains.i_d, gains.i_q)]
    names = ["i_d loop", "i_q loop"]
    if gains.speed is not None and control.speed_loop is not None:
        bases = (control.bases.speed, control.bases.torque)
        columns.append(_loop_cells(gains.speed, bases, control.speed_loop.q_formats))
        names.append("speed loop")
    labels = _headings(
        "method",
        "sampled every",
        "proportional gain k_p",
        "integral gain k_i",
        "integral time T_i of the series form",
        "velocity form: q_0, q_1",
        "per unit: k_p, k_i T_s",
        "crossover",
        "phase margin",
        "gain margin",
        "delay margin",
        "largest sensitivity M_s",
        "largest deviation after a unit disturbance",
        "closed-loop poles in z",
        "speed from",
    )
    rows = tuple(Row((label, *cells)) for label, *cells in zip(labels, *columns, strict=True) if any(cells))
    return HtmlTable("Gains and margins of the sampled loops", ("", *_headings(*names)), rows)


def observer_tables(design: Design, gains: GainSet, torque_max: float) -> list[HtmlTable]:
    """Coefficients of the speed observer; its steady speed error with and without load and error of the resistance."""
    observer, machine = gains.observer, design.machine
    if observer is None:
        return [] if gains.position is None else _position_tables(gains.position)
    coefficients = (
        ("A", f"{number(observer.a, 8)}", "pole in the z plane"),
        ("B_u", f"{number(observer.b_u, 8)}{NARROW}rad/(s V)", "factor of the voltage u_q"),
        ("B_i", f"{number(observer.b_i, 8)}{NARROW}rad/(s A)", "factor of the current i_q"),
        ("C", f"{number(observer.c, 8)}{NARROW}rad/(s A)", "current taken off the estimate"),
    )
    first = HtmlTable(
        symbols(
            "Speed observer: \u03c9\u0302[k] = \u03b6[k] \u2212 C i_q[k], "
            "\u03b6[k+1] = A \u03b6[k] + B_u u_q[k] + B_i i_q[k]"
        ),
        ("", "", "value"),
        tuple(Row((symbols(name), symbols(text), value)) for name, value, text in coefficients),
        2,
    )
    speed = 0.5 * design.control.bases.speed
    rows = []
    for label, load in (("no load", 0.0), ("half the largest torque", 0.5 * torque_max)):
        errors = [
            steady_state_error(machine, observer.g, observer.t_s, speed, torque_load=load, r_error=r_error)
            for r_error in (0.0, R_ERROR)
        ]
        cells = [_speed_error_text(error) for error in errors]
        rows.append(Row((label, quantity(load, "N m"), *cells)))
    caption = f"Steady speed error at {quantity(speed, 'rpm')}, half the base speed, with an unknown load at i_d = 0"
    columns = ("", "load torque", "exact values", f"resistance {100.0 * R_ERROR:.0f} % too large")
    return [first, HtmlTable(symbols(caption), _headings(*columns), tuple(rows))]


def _position_tables(position: PositionObserver) -> list[HtmlTable]:
    return [
        HtmlTable(symbols(f"{title}: {'; '.join(notes)}"), _headings(*columns), tuple(Row(cells) for cells in rows))
        for title, columns, rows, notes in position_parts(position)
    ]


def _speed_error_text(error: ObserverError) -> str:
    if abs(error.relative) < _ROUNDING:
        return f"0{NARROW}rpm"
    return f"{quantity(error.total, 'rpm', 3)} ({share(error.relative, 2)})"


def _known(*values: tuple[float, str]) -> list[str]:
    """Values with their units, a dash for those that are not known."""
    return [
        (f"{number(value, 3)}{NARROW}{unit}" if unit == "\u00b0C" else quantity(value, unit, 3))
        if math.isfinite(value)
        else "\u2013"
        for value, unit in values
    ]


def loss_tables(comparison: LossComparison) -> list[HtmlTable]:
    """One table per operating point."""
    budget = comparison.budget
    kinds = shown_parts(budget)
    columns = ("", *(part_label(kind) for kind in kinds), "total", "saved", "junction", "phase voltage")
    tables = []
    for p, point in enumerate(comparison.points):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                best = (comparison.best_strategy[p], comparison.best_modulation[p]) == (s, m)
                label = f"{STRATEGY_TEXT[strategy]}, {MODULATION_LABELS[modulation]}"
                reason = obstacle(comparison, index)
                parts = (*(getattr(budget, kind) for kind in kinds), budget.total)
                cells = (
                    symbols(f"{label}: {reason}" if reason else label),
                    *(watts(float(part[index])) if math.isfinite(part[index]) else "\u2013" for part in parts),
                    f"{comparison.saving[index] + 0.0:.1f}{NARROW}%"
                    if math.isfinite(comparison.saving[index])
                    else "\u2013",
                    *_known(
                        (float(budget.junction_temperature[index]), "\u00b0C"), (float(budget.voltage[index]), "V")
                    ),
                )
                rows.append(Row(cells, "muted" if reason else "best" if best else ""))
        notes = [point_text(point), friction_text(comparison, p), "" if comparison.scope == "drive" else WITHOUT_BRIDGE]
        title = ". ".join(note for note in notes if note)
        tables.append(HtmlTable(title, _headings(*columns), tuple(rows)))
    return tables
