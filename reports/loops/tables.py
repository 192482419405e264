"""Loops as tables of the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.reports.loops.firmware_text import (
    FIRMWARE_COLUMNS,
    firmware_notes,
    firmware_rows,
    firmware_title,
)
from dqforge.reports.loops.judged_text import (
    JUDGED_TITLE,
    judged_columns,
    judged_notes,
    judged_rows,
)
from dqforge.reports.loops.proven_text import box_notes, changing_notes
from dqforge.reports.loops.robustness_text import (
    FORM_COLUMNS,
    ROBUST_COLUMNS,
    form_rows,
    robust_notes,
    robust_rows,
)
from dqforge.reports.loops.schedule_text import SCHEDULE_COLUMNS, schedule_notes, schedule_rows
from dqforge.reports.loops.stability_text import stability_notes
from dqforge.reports.observers.speed_loop_text import leaving_notes, margin_words, observed_notes
from dqforge.reports.pages.labels import (
    significant,
)
from dqforge.reports.pages.table import Table

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.proof import ObserverProof


def _loop_row(gains: LoopGains, unit: str, scaled: PerUnitGains) -> tuple[str, ...]:
    return (
        gains.loop,
        gains.method,
        f"{gains.kp:.5g} {unit}",
        f"{gains.ki:.5g}",
        _per_unit_text(scaled),
        significant(gains.crossover / (2.0 * math.pi)),
        margin_words(gains),
        f"{20.0 * math.log10(gains.gain_margin):.1f}"
        if math.isfinite(gains.gain_margin)
        else "none",
        significant(gains.delay_margin * 1e6, 3),
        f"{gains.max_sensitivity:.2f}",
    )


_UNITS = {"speed": "N m s/rad"}


def _per_unit_text(scaled: PerUnitGains) -> str:
    if scaled.integers is None:
        return f"{scaled.kp:.5g}, {scaled.ki_ts:.4g}"
    return ", ".join(f"{number.mantissa} (Q{number.shift})" for number in scaled.integers)


def gains_tables(design: Design, gains: GainSet, proof: ObserverProof | None = None) -> list[Table]:
    """Gains of each loop with their margins, and the observer with its errors
    and what is proven of it.
    """
    rows = [
        _loop_row(loop, _UNITS.get(loop.loop, "V/A"), gains.per_unit[loop.loop])
        for loop in gains.loops
    ]
    columns = (
        "loop",
        "method",
        "kp",
        "ki (kp unit)/s",
        "per unit: kp, ki t_s",
        "crossover Hz",
        "phase margin deg",
        "gain margin dB",
        "delay margin us",
        "M_s",
    )
    title, notes = (
        f"{design.name}: gains, sampled every {design.control.t_s * 1e6:.4g} us",
        (*observed_notes(gains.speed), *leaving_notes(gains.speed)),
    )
    if gains.schedule is None:
        notes = (*notes, *changing_notes(gains))
    tables = [Table(title, columns, tuple(rows), notes)]
    tables.append(Table("Parallel, series and velocity form", FORM_COLUMNS, form_rows(gains)))
    if gains.firmware is not None:
        title, found = firmware_title(gains.firmware), firmware_rows(gains.firmware)
        tables.append(Table(title, FIRMWARE_COLUMNS, found, firmware_notes(gains.firmware)))
    if gains.phases is not None and gains.phases.judged is not None:
        judged, notes = gains.phases.judged, judged_notes(gains.phases)
        heads, found = judged_columns(judged), judged_rows(judged)
        tables.append(Table(JUDGED_TITLE, heads, found, notes))
    if gains.robust is not None:
        rows_ = robust_rows(gains.robust)
        notes = (
            *robust_notes(gains.robust),
            *box_notes(gains),
            *stability_notes(gains, design.machine.pole_pairs),
        )
        tables.append(Table("Worst within control.tolerances", ROBUST_COLUMNS, rows_, notes))
    if gains.schedule is not None:
        rows_ = schedule_rows(gains.schedule)
        notes = (*schedule_notes(gains.schedule), *changing_notes(gains))
        tables.append(
            Table("Scheduled gains along the current reference", SCHEDULE_COLUMNS, rows_, notes)
        )
    if gains.observer is not None and gains.observer_slopes is not None:
        from dqforge.reports.observers.tables import observer_table

        tables.append(observer_table(gains.observer, gains.observer_slopes))
    if gains.measured_speed is not None:
        from dqforge.reports.speed_measurement.tables import measured_tables

        tables += measured_tables(gains.measured_speed)
    if gains.position is not None:
        from dqforge.reports.observers.text import position_parts

        tables += [Table(*part) for part in position_parts(gains.position, proof)]
    if gains.tracker is not None:
        from dqforge.reports.observers.tracker_text import tracker_part

        tables.append(Table(*tracker_part(gains.tracker)))
    return tables
