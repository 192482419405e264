"""Tables and plain data of loss maps and missions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.losses.loss_map import LossMap as MappedLoss
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.optimizer.losses.drive_comparison import Alternatives, MissionComparison, MissionRun
from dqforge.optimizer.losses.measured_comparison import MeasuredComparison
from dqforge.optimizer.losses.phase_comparison import LossComparison, PhaseBudget
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import (
    NOT_COMPARED,
    WITHOUT_BRIDGE,
    friction_text,
    letter,
    obstacle,
    part_label,
    shown_parts,
    three_decimals,
)
from dqforge.reports.plain_data import PlainData, finite

if TYPE_CHECKING:
    from dqforge.optimizer.losses.loss_map import LossMap


_GRID = (10, 12)  # Torques and speeds of the map in the terminal at most.
_MOST_ROWS = 40
_FREQUENCY = "frequency: that of the switching"


def alternative_text(alternatives: Alternatives, index: int, *, plain: bool = True) -> str:
    """An alternative in the words by which it differs from the others: modulator, strategy,
    frequency.
    """
    strategy, modulation, frequency = alternatives.label(index)
    words = [modulation if plain else modulation.upper()]
    if alternatives.shape[0] > 1:
        words.insert(0, strategy)
    if alternatives.shape[2] > 1:
        words.append(format_quantity(frequency, "Hz", 4))
    return ", ".join(words)


def _watt(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.3g}" if 0.0 < abs(value) < 10.0 else f"{value + 0.0:.1f}"


def _shown_parts(values: FloatArray) -> list[int]:
    """Indices of the kinds of loss (rows of `values`) that are not zero everywhere."""
    return [k for k in range(len(PARTS)) if np.any(np.nan_to_num(values[k]) != 0.0)]


def map_tables(design: Design, found: LossMap) -> list[Table]:
    """Alternatives with their mean losses, and a coarse map of the winners."""
    alternatives, usable, means = found.comparison.alternatives, found.usable, found.mean_losses
    kinds = _shown_parts(means)
    hottest, ripple, least = found.hottest_junction, found.largest_ripple, found.least_share
    rows = []
    for k in range(usable.shape[0]):
        strategy, modulation, frequency = alternatives.label(k)
        cells = [_watt(float(means[part, k])) for part in kinds]
        rows.append(
            (
                letter(k),
                strategy,
                modulation,
                format_quantity(frequency, "Hz", 4),
                *cells,
                _watt(float(np.sum(means[:, k]))),
                _watt(float(hottest[k])),
                _watt(float(ripple[k])),
                f"{100.0 * np.mean(usable[k]):.0f}",
                f"{100.0 * least[k]:.0f}" if found.comparison.compared else "-",
            )
        )
    headings = [f"{part_label(PARTS[part])} W" for part in kinds]
    columns = ("", "strategy", "modulator", "frequency", *headings, "total W")
    columns = (*columns, "junction max degC", "ripple max A", "drives %", "least at %")
    title = f"{design.name}: losses over {found.torque.size} torques by {found.omega_m.size} speeds"
    notes = [
        (
            f"mean losses over the {100.0 * np.mean(found.shared):.0f} % of the points that all "
            "alternatives drive"
        ),
        (
            f"{_FREQUENCY}; drives: share of the points that the alternative makes within its "
            "limits; least at: share at which it has the least loss of all"
        ),
    ]
    compared = found.comparison.compared
    notes += _bridge_notes(design, compared=compared) + _dead_time_notes(found.dead_time_share)
    if np.any(~found.comparison.budget.within_tables & found.comparison.usable):
        notes.append("at some points the device tables are extrapolated")
    table = Table(title, columns, tuple(rows), tuple(notes))
    return [table, _winner_table(found)] if compared else [table]


def _bridge_notes(design: Design, *, compared: bool) -> list[str]:
    notes = [] if design.inverter.device is not None else [WITHOUT_BRIDGE]
    return notes if compared else [NOT_COMPARED, *notes]


def _dead_time_notes(taken: tuple[float, float]) -> list[str]:
    """What dead time takes of the voltage, from the least to the most of the alternatives."""
    low, high = (100.0 * share for share in taken)
    if high == 0.0:
        return []
    share = f"{high:.2g} %" if low == high else f"{low:.2g} to {high:.2g} %"
    return [f"dead time is compensated, which takes {share} of the linear range"]


def _winner_table(found: LossMap) -> Table:
    """Letters of the alternatives that lose least, highest torque first."""
    best = found.comparison.best.reshape(found.torque.size, found.omega_m.size)
    places = [
        np.unique(np.linspace(0, size - 1, min(size, most)).round().astype(int))
        for size, most in zip(best.shape, _GRID, strict=True)
    ]
    rows = [
        (
            f"{found.torque[i]:.4g}",
            *(letter(int(best[i, j])) if best[i, j] >= 0 else "." for j in places[1]),
        )
        for i in places[0][::-1]
    ]
    columns = ("N m \\ rpm", *(f"{in_rpm(found.omega_m[j]):.0f}" for j in places[1]))
    seen = np.unique(best[best >= 0])
    alternatives = found.comparison.alternatives
    named = [f"{letter(int(k))} = {alternative_text(alternatives, int(k))}" for k in seen]
    named.append("of alternatives with equal losses the first in the list is named")
    notes = (
        (*named, ". = no alternative makes the torque within its limits")
        if np.any(best < 0)
        else tuple(named)
    )
    return Table(
        "Alternative of least loss, over torque (down) and speed (across)",
        columns,
        tuple(rows),
        notes,
    )


def plain_map(found: LossMap) -> PlainData:
    """Axes, alternatives with totals over the map (torque by speed), and the index of the best."""
    comparison, alternatives = found.comparison, found.comparison.alternatives
    shape = (found.torque.size, found.omega_m.size)
    count, usable, means = comparison.torque.size, found.usable, found.mean_losses
    hottest, ripple, least = found.hottest_junction, found.largest_ripple, found.least_share
    columns = {
        "total_W": comparison.budget.total,
        "junction_degC": comparison.budget.junction_temperature,
        "ripple_current_A": comparison.budget.ripple_current,
        "capacitor_current_A": comparison.budget.capacitor_current,
    }
    rows = []
    for k in range(usable.shape[0]):
        strategy, modulation, frequency = alternatives.label(k)
        row: PlainData = {"strategy": strategy, "modulation": modulation, "frequency_Hz": frequency}
        row["mean_W"] = dict(zip(PARTS, means[:, k].tolist(), strict=True))
        row["mean_total_W"] = float(np.sum(means[:, k]))
        row |= {"junction_max_degC": hottest[k], "ripple_current_max_A": ripple[k]}
        row |= {"usable_share": float(np.mean(usable[k])), "least_share": least[k]}
        row["usable"] = usable[k].reshape(shape)
        row |= {
            name: values.reshape(-1, count)[k].reshape(shape) for name, values in columns.items()
        }
        rows.append(row)
    return {
        "torque_Nm": found.torque,
        "omega_m_rad_per_s": found.omega_m,
        "alternatives": rows,
        "best": comparison.best.reshape(shape),
        "compared": comparison.compared,
        "shared_share": float(np.mean(found.shared)),
        "dead_time_share": list(found.dead_time_share),
        "within_tables": not bool(np.any(~comparison.budget.within_tables & comparison.usable)),
    }


def _energy(joule: float) -> str:
    """Energy in Wh, as missions are counted."""
    return f"{joule / 3600.0 + 0.0:.4g}"


def mission_mark(run: MissionRun, *, best: bool) -> str:
    """Why an alternative cannot be used, or that it is the best, or nothing."""
    if not run.steady:
        return "junction temperature runs away"
    if run.missed.size:
        return "not reached"
    if not run.cool_enough:
        return "junction too hot"
    return "best" if best else ""


def _missed_notes(found: MissionComparison) -> list[str]:
    """For each set of rows that cannot be driven, where it begins and which modulators it stops."""
    groups: dict[tuple[int, ...], list[str]] = {}
    for run in found.runs:
        if run.missed.size:
            names = groups.setdefault(tuple(run.missed.tolist()), [])
            name = f"{run.strategy} {run.modulation}"
            names += [] if name in names else [name]
    return [
        f"{found.mission.source}:{lines[0]}: torque or voltage is out of reach ({len(lines)} row"
        f"{'' if len(lines) == 1 else 's'}) with {', '.join(names)}; the largest possible is used"
        for lines, names in groups.items()
    ]


def mission_tables(design: Design, found: MissionComparison) -> list[Table]:
    """Energy by kind of loss, and the junctions, of every alternative."""
    mission = found.mission
    energies = np.array([[run.energy[part] for run in found.runs] for part in PARTS])
    kinds = _shown_parts(energies)
    rows = []
    for k, run in enumerate(found.runs[:_MOST_ROWS]):
        cells = [_energy(run.energy[PARTS[part]]) if run.steady else "-" for part in kinds]
        total = (
            [_energy(run.total), _watt(run.junction_max), _watt(run.swing)]
            if run.steady
            else ["-"] * 3
        )
        head = (run.strategy, run.modulation, format_quantity(run.frequency, "Hz", 4))
        rows.append((*head, *cells, *total, mission_mark(run, best=k == found.best)))
    columns = (
        "strategy",
        "modulator",
        "frequency",
        *(f"{part_label(PARTS[part])} Wh" for part in kinds),
        "total Wh",
    )
    columns = (*columns, "junction max degC", "swing K", "")
    first = found.runs[max(found.best, 0)]
    length = float(mission.time[-1] - mission.time[0])
    notes = [
        f"{mission.length.size} intervals, {length:.6g} s; the mission repeats",
        (
            f"at the shaft {_energy(first.driving)} Wh go out and {_energy(-first.braking)} Wh are "
            "recovered"
        ),
    ]
    notes += [_FREQUENCY, "swing: largest less smallest temperature of a junction over the mission"]
    notes += _bridge_notes(design, compared=found.compared)
    notes += _dead_time_notes(found.dead_time_share)
    if len(found.runs) > _MOST_ROWS:
        notes.append(f"{len(found.runs) - _MOST_ROWS} more alternatives are in the JSON")
    if math.isfinite(first.winding_temperature):
        notes.append(f"winding at {first.winding_temperature:.1f} degC by the mean copper loss")
    if not all(run.within_tables for run in found.runs):
        notes.append("in some alternatives the device tables are extrapolated")
    notes += _missed_notes(found)
    title = f"{design.name}: losses over the mission {mission.source}"
    return [Table(title, columns, tuple(rows), (*notes, *mission.findings))]


def plain_mission(found: MissionComparison) -> PlainData:
    """Energies in J and temperatures of every alternative, and the course of the
    best one's hottest junction.
    """
    rows = [
        {
            "strategy": run.strategy,
            "modulation": run.modulation,
            "frequency_Hz": run.frequency,
            "energy_J": run.energy,
            "total_J": run.total,
            "input_J": run.input_energy,
            "driving_J": run.driving,
            "braking_J": run.braking,
            "junction_max_degC": run.junction_max,
            "junction_swing_K": run.swing,
            "winding_degC": run.winding_temperature,
            "lines_not_reached": run.missed,
            "usable": run.usable,
            "within_tables": run.within_tables,
            "steady": run.steady,
            "cool_enough": run.cool_enough,
        }
        for run in found.runs
    ]
    course = None
    if found.best >= 0:
        best = found.runs[found.best]
        course = {"time_s": best.time, "junction_degC": best.junction}
    best_index = None if found.best < 0 else found.best
    mission = found.mission
    return {
        "source": mission.source,
        "intervals": mission.length.size,
        "duration_s": float(mission.time[-1] - mission.time[0]),
        "findings": list(mission.findings),
        "dead_time_share": list(found.dead_time_share),
        "alternatives": rows,
        "best": best_index,
        "compared": found.compared,
        "course": course,
    }


# What loss comparisons say of half bridges and neutral, for machines with any back-EMF.

Index = tuple[int, ...]
_SAME = 5e-4  # Legs whose losses differ by less, relative, are named together.


def legs_text(found: PhaseBudget, index: Index) -> str:
    """Losses of the legs such as ``a, b, c 6.56 W each, n 2.08 W``; empty where unknown."""
    losses = [float(value) for value in found.leg_loss[index]]
    if not all(math.isfinite(value) for value in losses):
        return ""
    groups: list[tuple[float, list[str]]] = []
    for name, value in zip(found.legs, losses, strict=True):
        if groups and abs(value - groups[-1][0]) <= _SAME * max(groups[-1][0], value):
            groups[-1][1].append(name)
        else:
            groups.append((value, [name]))
    return ", ".join(
        f"{', '.join(names)} {three_decimals(value)} W{' each' if len(names) > 1 else ''}"
        for value, names in groups
    )


def leg_notes(comparison: LossComparison, point: int) -> list[str]:
    """What is said below the table of an operating point: legs, neutral and dead time by rule."""
    found = comparison.legs
    if found is None:
        return []
    rules: dict[str, list[str]] = {}
    for s, strategy in enumerate(comparison.strategies):
        text = _rule_text(found, (s, 0, point))
        if text:
            rules.setdefault(text, []).append(strategy)
    return [f"legs with {', '.join(names)}: {text}" for text, names in rules.items()]


def _rule_text(found: PhaseBudget, index: Index) -> str:
    """Legs, neutral and dead time of one rule; empty where the legs are unknown."""
    text = legs_text(found, index)
    if not text:
        return ""
    neutral, ripple = float(found.neutral_current[index]), float(found.neutral_ripple[index])
    if ripple > 0.0:
        through = f"{three_decimals(neutral)} A r.m.s. and " if neutral > 0.0 else ""
        text += f"; neutral {through}{three_decimals(ripple)} A r.m.s. of the switching"
    volts = float(found.budget.voltage_error[index])
    if volts > 0.0:
        text += f"; dead time takes {three_decimals(volts)} V without compensation"
    return text


def plain_legs(found: PhaseBudget, index: Index) -> dict[str, PlainData]:
    """Keys of a row of the JSON document."""
    losses = zip(found.legs, found.leg_loss[index].tolist(), strict=True)
    warm = zip(found.legs, found.leg_temperature[index].tolist(), strict=True)
    return {
        "legs_W": dict(losses),
        "legs_degC": dict(warm),
        "neutral_A": found.neutral_current[index],
        "neutral_ripple_A": found.neutral_ripple[index],
        "link_needed_V": found.link_demand[index],
        "dead_time_V": found.budget.voltage_error[index],
    }


# Why an alternative has the least loss, from its numbers.

_EQUAL = 0.01  # Relative difference up to which two losses are called equal.
_HALF = (0.47, 0.53)  # Ratios that are called half.


def winner_reason(comparison: LossComparison, point: int) -> str:
    """What the best modulator does otherwise than the most usual other one with its strategy.

    Empty where none is best, or no other can be used.
    """
    s, best = int(comparison.best_strategy[point]), int(comparison.best_modulation[point])
    others = [
        m
        for m, name in sorted(enumerate(comparison.modulations), key=lambda one: one[1] != "svpwm")
        if m != best and comparison.usable[s, m, point]
    ]
    if s < 0 or not others:
        return ""
    other, names = others[0], comparison.modulations
    budget = comparison.budget

    def pair(part: str) -> tuple[float, float]:
        values = getattr(budget, part)
        return float(values[s, best, point]), float(values[s, other, point])

    part = max(PARTS, key=lambda one: pair(one)[1] - pair(one)[0])
    own, theirs = pair(part)
    if theirs - own <= _EQUAL * pair("total")[1]:
        return f"{names[best]}: total within {100.0 * _EQUAL:g} % of that of {names[other]}"
    equal = [
        part_label(one)
        for one in ("copper", "conduction", "switching")
        if one != part and _equal(*pair(one))
    ]
    at = f" at equal {' and '.join(equal)} loss" if equal else ""
    text = f"{names[best]}: {_share_text(own / theirs)} {part_label(part)} loss of {names[other]}"
    mine, reference = pair("ripple_current")
    if not (math.isfinite(mine) and math.isfinite(reference)):
        return text + at
    if _equal(mine, reference):
        return f"{text}{at}; ripple current equal"
    word = "higher" if mine > reference else "lower"
    figures = f"{three_decimals(mine)} A instead of {three_decimals(reference)} A"
    return f"{text}{at}; ripple current {word}, {figures}"


def _equal(own: float, theirs: float) -> bool:
    return abs(own - theirs) <= _EQUAL * max(abs(own), abs(theirs)) and theirs > 0.0


def _share_text(ratio: float) -> str:
    return "half the" if _HALF[0] <= ratio <= _HALF[1] else f"{100.0 * ratio:.0f} % of the"


# Loss comparisons as tables of the terminal.


def losses_tables(
    design: Design, comparison: LossComparison, kinds: Sequence[str] = (), *, reasons: bool = True
) -> list[Table]:
    """One table per operating point: strategy and modulator against losses
    and junction temperature; ``kinds`` are those that have a column, by default all that are there.
    """
    kinds = kinds or shown_parts(comparison.budget)
    headings = [f"{part_label(kind)} W" for kind in kinds]
    columns = ("strategy", "modulator", *headings, "total W", "junction degC")
    columns = (*columns, "ripple current A", "saving %", "")
    tables = []
    budget = comparison.budget
    for p, (point, best) in enumerate(zip(comparison.points, comparison.best_labels, strict=True)):
        rows = []
        for s, strategy in enumerate(comparison.strategies):
            for m, modulation in enumerate(comparison.modulations):
                index = (s, m, p)
                mark = "best" if best == (strategy, modulation) else obstacle(comparison, index)
                cells = [
                    *(getattr(budget, kind) for kind in kinds),
                    budget.total,
                    budget.junction_temperature,
                    budget.ripple_current,
                ]
                texts = [three_decimals(float(cell[index])) for cell in cells]
                # Strategies with the same currents differ by rounding, which nobody saves.
                saving = three_decimals(round(float(comparison.saving[index]), 3))
                rows.append((strategy, modulation, *texts, saving, mark))
        title = f"{design.name}: losses at {point.torque:.4g} N m, {in_rpm(point.omega_m):.5g} rpm"
        notes = [
            friction_text(comparison, p),
            winner_reason(comparison, p) if reasons else "",
            "saving: of the total of the first row; ripple current: r.m.s. of a phase",
            "" if comparison.compared else NOT_COMPARED,
            WITHOUT_BRIDGE if comparison.scope != "drive" else "",
            *leg_notes(comparison, p),
        ]
        tables.append(Table(title, columns, tuple(rows), tuple(note for note in notes if note)))
    return tables


def losses_tables_over(
    design: Design, found: Sequence[LossComparison], frequencies: Sequence[float]
) -> list[Table]:
    """The same with several switching frequencies (Hz), one comparison each: one table per point,
    whose best and saving are those of all its rows.
    """
    tables = []
    there = {kind for one in found for kind in shown_parts(one.budget)}
    kinds = [kind for kind in PARTS if kind in there]
    each = [losses_tables(design, one, kinds, reasons=False) for one in found]
    for p, parts in enumerate(zip(*each, strict=True)):
        best, base = best_over(found, p), float(found[0].budget.total[0, 0, p])
        rows = []
        for k, (part, one) in enumerate(zip(parts, found, strict=True)):
            totals = one.budget.total[:, :, p].ravel().tolist()
            for n, (row, total) in enumerate(zip(part.rows, totals, strict=True)):
                mark = "best" if best == (k, n) else "" if row[-1] == "best" else row[-1]
                saving = three_decimals(round(100.0 * (1.0 - total / base), 6)) if base else ""
                rows.append((f"{frequencies[k]:g}", *row[:-2], saving, mark))
        columns = ("f_sw Hz", *parts[0].columns)
        tables.append(Table(parts[0].title, columns, tuple(rows), parts[0].notes))
    return tables


def best_over(found: Sequence[LossComparison], point: int) -> tuple[int, int] | None:
    """Comparison, and flat index of its alternative, with the least total loss of what is usable at
    a point; None where nothing is, or the bridge is unknown.
    """
    if not found[0].compared:
        return None
    totals = [
        np.where(one.usable[:, :, point], one.budget.total[:, :, point], np.inf).ravel()
        for one in found
    ]
    k = int(np.argmin([float(part.min()) for part in totals]))
    return (k, int(np.argmin(totals[k]))) if np.isfinite(totals[k].min()) else None


def loss_lines(comparison: LossComparison) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of a comparison as a Python session prints it, in SI units."""
    headings = ("torque N m", "speed rad/s", "strategy", "modulator", "total W", "junction degC")
    rows = []
    for s, m, p in np.ndindex(comparison.budget.total.shape):
        point, labels = comparison.points[p], (comparison.strategies[s], comparison.modulations[m])
        mark = "best" if comparison.best_labels[p] == labels else obstacle(comparison, (s, m, p))
        values = (comparison.budget.total, comparison.budget.junction_temperature)
        numbers = (three_decimals(float(value[s, m, p])) for value in values)
        rows.append((f"{point.torque:.5g}", f"{point.omega_m:.5g}", *labels, *numbers, mark))
    none = "" if comparison.compared else NOT_COMPARED
    return (*headings, none), rows


def map_lines(found: LossMap) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of a map as a Python session prints it: alternatives, best first."""
    alternatives, means = found.comparison.alternatives, np.sum(found.mean_losses, axis=0)
    usable, least = np.mean(found.usable, axis=1), found.least_share
    compared = found.comparison.compared
    order = np.argsort(-least, kind="stable").tolist()
    rows: list[tuple[str, ...]] = []
    for k in order:
        strategy, modulation, frequency = alternatives.label(k)
        shares = (f"{100.0 * usable[k]:.0f}", f"{100.0 * least[k]:.0f}" if compared else "-")
        rows.append((strategy, modulation, f"{frequency:g}", three_decimals(means[k]), *shares))
    headings = ("strategy", "modulator", "f_sw Hz", "mean total W", "drives %")
    return (*headings, "least at %" if compared else NOT_COMPARED), rows


# Loss comparisons as plain data.


def plain_losses(comparison: LossComparison | None) -> PlainData | None:
    """One row per point, strategy and modulator."""
    if comparison is None:
        return None
    budget = comparison.budget
    rows = [
        {
            "torque_Nm": point.torque,
            "omega_m_rad_per_s": point.omega_m,
            "strategy": strategy,
            "modulation": modulation,
            "copper_W": budget.copper[index],
            "conduction_W": budget.conduction[index],
            "switching_W": budget.switching[index],
            "ripple_copper_W": budget.ripple_copper[index],
            "iron_W": budget.iron[index],
            "ripple_iron_W": budget.ripple_iron[index],
            "magnet_W": budget.magnet[index],
            "dead_time_W": budget.dead_time[index],
            "capacitor_W": budget.capacitor[index],
            "total_W": budget.total[index],
            "junction_degC": budget.junction_temperature[index],
            "voltage_V": budget.voltage[index],
            "ripple_current_A": budget.ripple_current[index],
            "friction_W": budget.friction[index],
            "feasible": comparison.usable[index],
            "reached": comparison.reached[index],
            "torque_made_Nm": comparison.most[index],
            "obstacle": obstacle(comparison, index),
            "saving_percent": comparison.saving[index],
        }
        | ({} if comparison.legs is None else plain_legs(comparison.legs, index))
        for p, point in enumerate(comparison.points)
        for s, strategy in enumerate(comparison.strategies)
        for m, modulation in enumerate(comparison.modulations)
        for index in [(s, m, p)]
    ]
    best = [None if labels is None else list(labels) for labels in comparison.best_labels]
    return {
        "scope": comparison.scope,
        "rows": rows,
        "best": best,
        "compared": comparison.compared,
    }


def plain_losses_over(found: Sequence[LossComparison], frequencies: Sequence[float]) -> PlainData:
    """The same with several switching frequencies: each row has its own, and so has the best."""
    each = [plain_losses(one) or {} for one in found]
    rows = [
        {"switching_frequency_Hz": f_sw, **row}
        for f_sw, one in zip(frequencies, each, strict=True)
        for row in one["rows"]
    ]
    best: list[list[object] | None] = []
    for p in range(len(found[0].points)):
        least = best_over(found, p)
        if least is None:
            best.append(None)
            continue
        k, flat = least
        s, m = divmod(flat, len(found[k].modulations))
        best.append([found[k].strategies[s], found[k].modulations[m], frequencies[k]])
    return each[0] | {"rows": rows, "best": best}


def plain_iron_map(mapped: MappedLoss) -> PlainData:
    """The iron loss by |psi|^2 held against the loss map of a design, for JSON."""
    held = mapped.compared
    if held is None:
        return {}
    least, i_d, i_q = held.least
    return {
        "file": mapped.source,
        "frequency_Hz": mapped.omega / (2.0 * math.pi),
        "coefficients": "map" if held.fitted else "machine.iron_loss",
        "hysteresis": held.hysteresis,
        "eddy": held.eddy,
        "misfit": held.misfit,
        "points": held.points,
        "below_zero": held.below,
        "least": {"left_W": least, "i_d_A": i_d, "i_q_A": i_q},
    }


# Measured losses beside the budget.

_MEASURED_COLUMNS = ("line", "torque", "speed", "measured", "model", "left", "of the measured")
_SHOWN_POINTS = 12


def measured_tables(found: MeasuredComparison) -> list[Table]:
    """The points with the largest rests, and what all of them say."""
    measured, left = found.measured, found.left
    size = np.where(found.reached, np.abs(left), -1.0)
    order = np.argsort(-size, kind="stable")[: min(_SHOWN_POINTS, int(found.reached.sum()))]
    rows = tuple(
        (
            str(measured.lines[n]),
            format_quantity(float(measured.torque[n]), "N m", 4),
            format_quantity(float(measured.omega_m[n]), "rpm", 4),
            f"{measured.loss[n]:.4g} W",
            f"{found.model[n]:.4g} W",
            f"{left[n]:+.3g} W",
            f"{100.0 * left[n] / measured.loss[n]:+.3g} %" if measured.loss[n] > 0.0 else "-",
        )
        for n in order.tolist()
    )
    return [
        Table(
            f"Measured losses of the {measured.whose}",
            _MEASURED_COLUMNS,
            rows,
            _measured_notes(found),
        )
    ]


def _measured_notes(found: MeasuredComparison) -> tuple[str, ...]:
    measured, reached = found.measured, found.reached
    share = found.rms / float(np.sqrt(np.mean(measured.loss[reached] ** 2)))
    mean = float(np.mean(found.left[reached]))
    first = (
        f"{int(reached.sum())} of {reached.size} points are reached; left of them {found.rms:.3g} "
        f"W r.m.s., {100.0 * share:.3g} % of what was measured, on average {mean:+.3g} W"
    )
    notes = [first]
    if found.below.any():
        worst = int(np.nanargmin(np.where(found.below, found.left, np.nan)))
        notes.append(
            f"below zero at {int(found.below.sum())} points, most on line {measured.lines[worst]} "
            f"({found.left[worst]:.3g} W): less was measured than the model loses there; check the "
            "resistance, the temperature of the winding, the losses of the design and the meters"
        )
    notes += [
        f"what is left goes with a {one.label}: {one.value:.3g} {one.unit} "
        f"(95 %: {one.low:.3g} to {one.high:.3g})"
        for one in found.goes_with
        if not one.low <= 0.0 <= one.high
    ]
    return (*notes, *measured.findings)


def plain_measured_losses(found: MeasuredComparison) -> PlainData:
    """The same in SI units, with every point."""
    measured = found.measured
    return {
        "of": measured.whose,
        "line": measured.lines,
        "torque_Nm": measured.torque,
        "omega_m_rad_per_s": measured.omega_m,
        "speed_rpm": in_rpm(measured.omega_m),
        "measured_W": measured.loss,
        "model_W": [finite(float(value)) for value in found.model],
        "left_W": [finite(float(value)) for value in found.left],
        "left_rms_W": found.rms,
        "below_zero": int(found.below.sum()),
        "goes_with": [
            {
                "key": one.key,
                "value": one.value,
                "unit": one.unit,
                "interval_95": [one.low, one.high],
            }
            for one in found.goes_with
        ],
    }
