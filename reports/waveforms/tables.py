"""Tables and plain data of phase currents."""

from __future__ import annotations

import math
from dataclasses import asdict

from dqforge.machines.design.design import Design
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.optimizer.waveforms.comparison import RuleCurrents, WaveformComparison
from dqforge.optimizer.waveforms.confirmation import Confirmation
from dqforge.optimizer.waveforms.firmware_fit import PhaseFit
from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData

RULE_TEXT = {
    "dq": "dq: sinusoidal",
    "dqx": "dqx: constant torque, no neutral",
    "dqy": "dqy: constant torque, least loss",
    "limited": "within all limits",
}


_MOST_ORDERS = 50


_LISTED = 2e-3


def _row(found: RuleCurrents, base: float) -> tuple[str, ...]:
    values = found.figures
    copper, torque = float(values.copper[0]), float(values.torque[0])
    return (
        RULE_TEXT[found.rule],
        f"{copper:.4g}",
        f"{100.0 * (copper / base - 1.0):+.2f}",
        f"{100.0 * float(values.ripple[0]) / abs(torque):.3g}"
        if values.ripple[0] > 1e-9 * abs(torque)
        else "0",
        f"{float(values.rms[0]):.4g}",
        f"{float(values.peak[0]):.4g}",
        f"{float(values.neutral_rms[0]):.3g}"
        if values.neutral_rms[0] > 1e-9 * values.rms[0]
        else "0",
        f"{float(values.bus[0]):.4g}",
        ", ".join(found.obstacles) or "nothing",
    )


def _harmonic_rows(comparison: WaveformComparison) -> tuple[tuple[str, ...], ...]:
    """Harmonics of phase a by rule, in % of the fundamental."""
    lines, turns = [found.harmonics[0] for found in comparison.rules], comparison.machine.turns
    places = [
        place
        for place in range(2 if turns == 1 else 1, _MOST_ORDERS * turns)
        if place != turns
        and any(place < line.size and line[place] > _LISTED * line[turns] for line in lines)
    ]
    return tuple(
        (
            _order_text(place, turns),
            *(f"{100.0 * line[place] / line[turns]:.2f}" for line in lines),
        )
        for place in places
    )


def _order_text(place: int, turns: int) -> str:
    """An order of the electrical angle, as a fraction where it is not whole."""
    return f"{place // turns}" if place % turns == 0 else f"{place}/{turns}"


def _front_table(comparison: WaveformComparison) -> Table:
    """What smooth torque costs."""
    cheapest = min((loss for _, loss in comparison.front if math.isfinite(loss)), default=math.nan)
    rows = tuple(
        (
            f"{100.0 * ripple:g}",
            f"{loss:.4g}" if math.isfinite(loss) else "none",
            f"{100.0 * (loss / cheapest - 1.0):.2f}" if math.isfinite(loss) else "",
        )
        for ripple, loss in comparison.front
    )
    columns = ("permitted deviation of the torque %", "least copper loss W", "above the last %")
    return Table("The price of smooth torque within all limits", columns, rows)


def _residual(value: float) -> str:
    return f"{value:.1e}" if math.isfinite(value) else "none"


def _confirmation_table(comparison: WaveformComparison) -> Table:
    """Every quadratic programme with the residuals of both solvers."""
    rows = tuple(
        (
            f"{100.0 * entry.ripple / abs(entry.torque):g}" if entry.torque else "0",
            entry.verdict,
            _residual(entry.ours.largest),
            _residual(entry.theirs.largest),
            f"{100.0 * entry.loss_difference:+.0e}"
            if math.isfinite(entry.loss_difference)
            else "none",
            _residual(entry.current_difference),
            f"{entry.iterations}",
        )
        for entry in comparison.confirmations
    )
    columns = (
        "permitted deviation %",
        "by OSQP",
        "residual here",
        "residual of OSQP",
        "loss difference %",
        "current difference A",
        "iterations",
    )
    return Table(
        "The same programmes solved by OSQP: largest residual of the optimality conditions",
        columns,
        rows,
    )


def optimality_note(comparison: WaveformComparison) -> str:
    """What is known of the optimum of a salient machine.

    Empty for others, whose programmes are convex.
    """
    if not isinstance(comparison.machine, SalientPhaseMachine):
        return ""
    if comparison.iterations == 0:
        return "within all limits: the global optimum, since each angle has its own"
    found = f"within all limits: a local optimum (IPOPT, {comparison.iterations} iterations)"
    if not math.isfinite(comparison.floor):
        return found
    copper = float(comparison.rules[-1].figures.copper[0])
    above = 100.0 * (copper / comparison.floor - 1.0)
    return (
        f"{found}; they lose {above:.2g} % more than {comparison.floor:.4g} W, which no constant "
        "torque undercuts"
    )


def waveform_tables(design: Design, comparison: WaveformComparison) -> list[Table]:
    """One row per rule: loss, ripple, currents, demand on the bus, and what it breaks;
    then harmonics of phase a.
    """
    limits = comparison.limits
    base = float(comparison.rules[0].figures.copper[0])
    columns = (
        "",
        "copper W",
        "against the first %",
        "ripple p-p %",
        "rms A",
        "peak A",
        "neutral rms A",
        "bus V",
        "breaks",
    )
    held = f"held by {', '.join(comparison.binding)}" if comparison.binding else "nothing binds"
    where = f"{comparison.torque:.4g} N m at {comparison.omega_m * 30.0 / math.pi:.4g} rpm"
    notes = [
        f"{where}; dc link {limits.v_dc:.4g} V, {limits.topology}, {limits.i_max:.4g} A (peak)",
        f"within all limits: {held}",
        *filter(None, [optimality_note(comparison)]),
        *(f"{rule}: {reason}" for rule, reason in comparison.impossible),
        *_open_phase_notes(comparison),
    ]
    rows = tuple(_row(found, base) for found in comparison.rules)
    tables = [Table(f"{design.name}: phase currents", columns, rows, tuple(notes))]
    tables.append(_front_table(comparison))
    harmonics = _harmonic_rows(comparison)
    if harmonics:
        names = ("order", *(f"{found.rule} %" for found in comparison.rules))
        tables.append(
            Table("Harmonics of the current of phase a, in % of its fundamental", names, harmonics)
        )
    if comparison.confirmations:
        tables.append(_confirmation_table(comparison))
    return tables


def _open_phase_notes(comparison: WaveformComparison) -> list[str]:
    """What constant torque costs without the open phase, against dqy with all three."""
    found = comparison.without_phase
    if found is None:
        return []
    return [
        (
            f"phase {found.phase} open, constant torque: copper {found.copper:.3g} times and phase "
            f"peak {found.peak:.3g} times those of dqy with all three; neutral "
            f"{found.neutral_rms:.3g} A r.m.s., {found.neutral_peak:.3g} A peak, "
            f"{found.neutral:.2g} times the phase peak before"
        ),
        (
            f"phase {found.phase} open: {100.0 * found.torque_at_peak:.0f} % of the torque is left "
            f"with the same phase peak, {100.0 * found.torque_at_copper:.0f} % with the same "
            "copper loss"
        ),
    ]


def _plain_confirmation(entry: Confirmation) -> PlainData:
    return {
        "torque_Nm": entry.torque,
        "omega_m_rad_per_s": entry.omega_m,
        "ripple_Nm": entry.ripple,
        "verdict": entry.verdict,
        "residuals": asdict(entry.ours) | {"largest": entry.ours.largest},
        "residuals_osqp": asdict(entry.theirs) | {"largest": entry.theirs.largest},
        "loss_difference": entry.loss_difference,
        "current_difference_A": entry.current_difference,
        "iterations": entry.iterations,
    }


def plain_phase_fit(fit: PhaseFit) -> PlainData:
    """The forms for the firmware with their errors as fractions, bytes of
    constants and operations.
    """
    return {
        "chosen": fit.chosen.name,
        "torque_max_Nm": fit.torque_max,
        "candidates": [
            {
                "form": entry.name,
                "errors": asdict(entry.errors),
                "constants_B": entry.flash,
                "operations": entry.operations,
            }
            for entry in fit.candidates
        ],
    }


def plain_waveforms(comparison: WaveformComparison) -> PlainData:
    """Operating point, limits and, per rule, currents and torque over the
    angle with their figures.
    """
    limits = comparison.limits
    return {
        "torque_Nm": comparison.torque,
        "omega_m_rad_per_s": comparison.omega_m,
        "limits": {
            "v_dc_V": limits.v_dc,
            "topology": limits.topology,
            "i_max_A": limits.i_max,
            "ripple_Nm": limits.ripple,
            "neutral_A": limits.neutral,
            "open_phase": limits.open_phase,
            "slew_A_per_s": limits.slew,
        },
        "binding": list(comparison.binding),
        "ripple_front": [
            {"deviation": ripple, "copper_W": loss} for ripple, loss in comparison.front
        ],
        "confirmations": [_plain_confirmation(entry) for entry in comparison.confirmations],
        "optimality": {"floor_W": comparison.floor, "iterations": comparison.iterations}
        if isinstance(comparison.machine, SalientPhaseMachine)
        else None,
        "without_phase": None
        if comparison.without_phase is None
        else asdict(comparison.without_phase),
        "impossible": [{"rule": rule, "reason": reason} for rule, reason in comparison.impossible],
        "theta_rad": comparison.machine.theta,
        "turns": comparison.machine.turns,
        "emf_over_omega_Wb": comparison.machine.flux,
        "rules": {
            found.rule: {
                "currents_A": found.currents,
                "torque_Nm": found.torque,
                "harmonics_A": found.harmonics[:, : _MOST_ORDERS * comparison.machine.turns],
                "copper_W": found.figures.copper[0],
                "mean_torque_Nm": found.figures.torque[0],
                "ripple_Nm": found.figures.ripple[0],
                "rms_A": found.figures.rms[0],
                "peak_A": found.figures.peak[0],
                "neutral_rms_A": found.figures.neutral_rms[0],
                "bus_V": found.figures.bus[0],
                "breaks": list(found.obstacles),
            }
            for found in comparison.rules
        },
    }
