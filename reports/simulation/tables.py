"""A simulation as tables for the terminal and the report, as plain data, and as a figure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import NumberFormat
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_feedback.closed_drive import ClosedPoint
from dqforge.optimizer.current_feedback.regulator_runs import WorkingPoints
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Draw, Outcome, Passage, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import (
    AXIS_COLOURS,
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    PALE,
    TEAL,
    new_figure,
    style,
    thinned,
)
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import SIMULATION as CHAPTER
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.design_run import DriveSimulation, StartFigures, spans
from dqforge.reports.simulation.plant_input import format_text, not_simulated, simulated
from dqforge.reports.simulation.recorded_run import BridgeRecord, Simulation, StartRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SHOWN = {"rad/s": "rpm"}


_STEP_COLUMNS = ("at", "from", "to", "rise time", "overshoot", "settled after", "error at the end")


def _value(value: float, unit: str, digits: int = 4) -> str:
    return format_quantity(value, _SHOWN.get(unit, unit), digits) if math.isfinite(value) else "-"


def _step_rows(found: DriveSimulation) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (
            _value(step.time, "s"),
            _value(step.before, found.unit),
            _value(step.after, found.unit),
            _value(step.rise, "s", 3),
            f"{100.0 * step.overshoot:.3g} %",
            _value(step.settling, "s", 3),
            _value(step.error, found.unit, 3),
        )
        for step in found.steps
    )


def _figure_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    run, figures = found.run, found.run.figures
    return (
        ("simulated", f"{_value(float(figures.t[0]), 's')}, {run.scenario.inverter} inverter"),
        ("largest deviation from the reference", _value(found.tracking[0], found.unit)),
        ("r.m.s. deviation from the reference", _value(found.tracking[1], found.unit)),
        ("largest speed", _value(found.speed_largest, "rad/s")),
        ("largest torque", _value(found.torque_largest, "N m")),
        ("largest current vector", _value(float(figures.peak_current[0]), "A")),
        ("phase current, r.m.s.", _value(float(figures.rms_current[0]), "A")),
        ("mean copper loss", _value(found.copper, "W")),
    )


def _observer_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Estimates beside the truth, nothing where no observer ran."""
    seen = found.observed
    if seen is None:
        return ()
    rows = [("largest error of the observed speed", _value(seen.speed_largest, "rad/s", 3))]
    if seen.angle_rms is not None and seen.angle_largest is not None:
        rows = [
            (
                "angle of the observer, largest error",
                f"{math.degrees(seen.angle_largest):.3g} deg (electrical)",
            ),
            (
                "angle of the observer, r.m.s. error",
                f"{math.degrees(seen.angle_rms):.3g} deg (electrical)",
            ),
            *rows,
        ]
    if found.run.scenario.sensorless is not None:
        rows.append(
            ("control without encoder", f"{100.0 * seen.sensorless_share:.3g} % of the time")
        )
    return tuple(rows)


def _degrees(angle: float) -> str:
    """An angle in rad; a dash where it is not known."""
    return f"{math.degrees(angle):.3g} deg (electrical)" if math.isfinite(angle) else "-"


def _start_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """The start without encoder, nothing where there is one."""
    start = found.start
    if start is None:
        return ()
    fault = "" if start.fault == "NO_FAULT" else f", fault {start.fault}"
    rows = [("state at the end", f"{start.state}{fault}")]
    if start.failed:
        rows.append(("faults on the way", ", ".join(start.failed)))
    rows += [
        ("the observer takes over at", _value(start.hand_over, "s")),
        ("... speed there", _value(start.speed, "rad/s")),
        ("... error of its angle", _degrees(start.angle_error)),
        ("... change of the current vector", _value(start.current_step, "A", 3)),
        ("within 10 % of the last reference after", _value(start.reached, "s", 3)),
        ("largest turn backwards", _degrees(start.back)),
        ("times the observer took over or handed back", str(start.crossings)),
    ]
    return tuple(rows)


def _phase_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Figures of the last tenth of the run, nothing for machines with a sinusoidal back-EMF."""
    seen = found.phases
    if seen is None:
        return ()
    copper = ", ".join(_value(loss, "W", 3) for loss in seen.copper)
    rows = [
        ("last tenth: mean torque", _value(seen.torque, "N m")),
        ("its means over control periods, peak to peak", _value(seen.ripple_means, "N m", 3)),
        ("every instant of it, peak to peak", _value(seen.ripple, "N m", 3)),
        ("copper loss of the phases", copper),
    ]
    rule = TOPOLOGIES[found.design.inverter.topology]
    if rule.neutral or rule.diodes:
        rows.append(("neutral current, r.m.s.", _value(seen.neutral_rms, "A", 3)))
    if seen.midpoint is not None:
        rows.append(("midpoint off half the link, at most", _value(seen.midpoint, "V", 3)))
    return tuple(rows)


def _turning_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Ripple of the last tenth with a map over the rotor angle, nothing without."""
    seen = found.turning
    if seen is None:
        return ()
    share = "" if seen.relative is None else f" ({100.0 * seen.relative:.3g} %)"
    return (
        ("last tenth: mean torque", _value(seen.torque, "N m")),
        ("its ripple, peak to peak", _value(seen.ripple, "N m", 3) + share),
        ("... of its means over control periods", _value(seen.ripple_means, "N m", 3)),
        ("ripple of the speed, peak to peak", _value(seen.speed, "rad/s", 3)),
        ("ripple of the current vector, peak to peak", _value(seen.current, "A", 3)),
    )


def _estimation_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Parameters estimated on line, nothing where none are."""
    seen = found.estimation
    if seen is None:
        return ()
    return tuple(
        (
            f"estimated {name} (plant), and share of the time seen",
            f"{_value(own, unit)} ({_value(true, unit)}), {100.0 * part:.3g} %",
        )
        for name, own, true, unit, part in (
            ("resistance", seen.r_s, seen.r_s_plant, "Ohm", seen.r_s_share),
            ("flux linkage", seen.psi_pm, seen.psi_pm_plant, "Wb", seen.psi_pm_share),
        )
    )


def _block_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Figures of a six-step drive, nothing for others."""
    seen = found.six_step
    if seen is None:
        return ()
    rows = [
        ("on its estimator from", "-" if seen.started is None else _value(seen.started, "s")),
        ("at the end", f"{seen.stage}, fault: {seen.fault}"),
        ("commutations by the estimator", str(seen.commutations)),
    ]
    for name, value in (
        ("their error, mean (late: positive)", seen.error_mean),
        ("their error, r.m.s.", seen.error_rms),
        ("their error, largest", seen.error_largest),
        ("their largest error by the formula", seen.predicted),
    ):
        if value is not None:
            rows.append((name, f"{math.degrees(value):.3g} deg (electrical)"))
    return tuple(rows)


def _bridge_rows(found: DriveSimulation) -> tuple[tuple[str, str], ...]:
    """Figures of a counted bridge, nothing where the bridge was not counted."""
    if found.run.bridge is None:
        return ()
    seen = found.run.bridge.figures
    conduction, switching = seen.conduction, seen.switching
    rows = [
        ("switched by", found.design.control.current_loop.method),
        ("switching frequency of a leg", _value(seen.frequency, "Hz")),
        ("last tenth: switching frequency of a leg", _value(seen.tail_frequency, "Hz")),
        ("... distortion of the phase currents", _share_of_fundamental(seen.distortion, " %")),
        ("... mean torque", _value(seen.torque, "N m")),
        ("... torque ripple, peak to peak", _value(seen.torque_ripple, "N m", 3)),
        ("... torque ripple, r.m.s.", _value(seen.torque_rms, "N m", 3)),
        ("... copper loss", _value(seen.copper, "W")),
        ("... power from the link", _value(seen.link, "W")),
    ]
    if found.design.inverter.device is not None:
        rows += [
            ("... conduction loss", _value(conduction[1], "W")),
            ("... switching loss", _value(switching[1], "W")),
            ("... hottest junction", f"{seen.junction_temperature:.4g} degC"),
            ("conduction loss of the run", _value(conduction[0], "W")),
            ("switching loss of the run", _value(switching[0], "W")),
        ]
    return tuple(rows)


def _notes(found: DriveSimulation) -> tuple[str, ...]:
    if found.run.figures.bounded[0]:
        return (
            ("rise from 10 to 90 % of the step; settled within 2 % of it",) if found.steps else ()
        ) + found.remarks
    return (
        *found.remarks,
        (
            f"the currents left all bounds at {_value(float(found.run.figures.t[0]), 's')}: the "
            "drive is unstable"
        ),
    )


def _lines(found: DriveSimulation) -> list[tuple[str, ...]]:
    """Label and a value per run; a dash where only the first run has one."""
    text = format_text(found.formats, found.not_simulated)
    blank = ("",) * len(found.others)
    columns = [
        dict(
            (
                *_figure_rows(each),
                *_phase_rows(each),
                *_turning_rows(each),
                *_block_rows(each),
                *_bridge_rows(each),
                *_observer_rows(each),
                *_estimation_rows(each),
                *_start_rows(each),
            )
        )
        for each in found.every
    ]
    lines = [(name, *(column.get(name, "-") for column in columns)) for name in columns[0]]
    return [lines[0], *([("arithmetic", text, *blank)] if text else []), *lines[1:]]


def _heads(found: DriveSimulation, single: str) -> tuple[str, ...]:
    return ("", *(each.label for each in found.every)) if found.others else ("", single)


def _step_title(found: DriveSimulation, each: DriveSimulation) -> str:
    title = f"Steps of the {found.run.scenario.mode}"
    return f"{title}, {each.label}" if found.others else title


def simulation_tables(found: DriveSimulation) -> list[Table]:
    """Figures of the run, a column per format, and of each step of its reference."""
    notes = tuple(dict.fromkeys(note for each in found.every for note in _notes(each)))
    title = f"{found.design.name}: simulation"
    steps = [
        Table(_step_title(found, each), _STEP_COLUMNS, _step_rows(each))
        for each in found.every
        if each.steps
    ]
    return [Table(title, _heads(found, ""), tuple(_lines(found)), notes), *steps]


_CLOSED_COLUMNS = (
    "regulator", "kHz", "THD %", "rpm off", "ripple N m", "copper W", "ripple W", "iron W",
    "conduction W", "switching W", "total W", "",
)  # fmt: skip

_CLOSED_SAID = (
    "Closed drive: the compiled speed loop holds the speed, so that all make one torque; with "
    "dead time and voltage drops. rpm off: mean speed less its reference; ripple N m: of the "
    "torque, r.m.s.; iron W: with what the switching makes."
)


def _share_of_fundamental(distortion: float, unit: str = "") -> str:
    """In %, a dash where there is next to no fundamental."""
    return f"{100.0 * distortion:.1f}{unit}" if math.isfinite(distortion) else "-"


def closed_cells(point: ClosedPoint, *, chosen: bool) -> tuple[str, ...]:
    """A row of `closed_tables`."""
    if point.obstacle:
        return (point.name, *("-",) * (len(_CLOSED_COLUMNS) - 2), point.obstacle)
    return (
        point.name,
        f"{1e-3 * point.frequency:.2f}",
        _share_of_fundamental(point.distortion),
        f"{in_rpm(point.speed_error):.2f}",
        f"{point.torque_ripple:.3g}",
        f"{point.copper:.4g}",
        f"{point.ripple_copper:.3g}",
        f"{point.iron + point.ripple_iron:.3g}",
        f"{point.conduction:.4g}",
        f"{point.switching:.4g}",
        f"{point.total:.4g}",
        "chosen" if chosen else "",
    )


def closed_tables(
    found: Mapping[str, tuple[ClosedPoint, ...]], points: WorkingPoints, chosen: str
) -> list[Table]:
    """One table per load: every regulator in the closed drive, and the carrier."""
    return [
        Table(
            f"Closed drive at {points.torque[p]:.4g} N m, {in_rpm(points.omega_m[p]):.5g} rpm",
            _CLOSED_COLUMNS,
            tuple(closed_cells(run[p], chosen=name == chosen) for name, run in found.items()),
            (_CLOSED_SAID,),
        )
        for p in range(points.torque.size)
    ]


def plain_closed(found: Mapping[str, tuple[ClosedPoint, ...]]) -> list[PlainData]:
    """The same as plain data, one entry per regulator and load."""
    return [
        {"regulator": name, "obstacle": point.obstacle or None}
        | {
            key: None if math.isnan(value) else value
            for key, value in (
                ("torque_Nm", point.torque),
                ("omega_m_rad_per_s", point.omega_m),
                ("speed_error_rad_per_s", point.speed_error),
                ("frequency_Hz", point.frequency),
                ("distortion", point.distortion),
                ("torque_ripple_rms_Nm", point.torque_ripple),
                ("copper_W", point.copper),
                ("ripple_copper_W", point.ripple_copper),
                ("iron_W", point.iron),
                ("ripple_iron_W", point.ripple_iron),
                ("conduction_W", point.conduction),
                ("switching_W", point.switching),
                ("total_W", point.total),
            )
        }
        for name, run in found.items()
        for point in run
    ]


def simulation_html(found: DriveSimulation) -> list[HtmlTable]:
    """The same for the report."""
    figures = tuple(Row(tuple(symbols(cell) for cell in line)) for line in _lines(found))
    steps = [
        HtmlTable(
            f"{_step_title(found, each)}; settled within 2 % of the step",
            _STEP_COLUMNS,
            tuple(Row(cells) for cells in _step_rows(each)),
        )
        for each in found.every
        if each.steps
    ]
    return [HtmlTable("Figures of the run", _heads(found, "value"), figures), *steps]


def run_key(found: DriveSimulation) -> str:
    """What the heading of the report's chapter says of a simulation."""
    away = _value(found.tracking[0], found.unit)
    return f"at most {away} from the reference"


def simulation_passage(found: DriveSimulation) -> Passage:
    """What the report says of a simulation."""
    from markupsafe import Markup

    prefix, code = found.design.export.prefix, Markup("<code>{}</code>")
    controllers = [control_header_name(prefix, name) for name in found.formats]
    if found.run.bridge is not None:
        controllers = [f"{prefix}.h", f"{prefix}_current_feedback.h"]
    if found.six_step is not None:
        controllers = [f"{prefix}_six_step.h"]
    held = Markup(" and that of ").join(code.format(name) for name in controllers)
    loops = ""
    for name in (each.firmware for each in found.every if each.firmware is not None):
        remarks = "".join(f"; {remark}" for each in found.every for remark in each.remarks)
        loops += (
            f" The same drive is run by loops with the structure of {name}, at their own sampling "
            f"and delay{remarks}."
        )
    files = Markup(" and ").join(code.format(name) for name in found.files())
    acts = "its duty cycles act one period later"
    if found.run.bridge is not None:
        acts = (
            "its references act one period later, and the regulator of the phase currents switches "
            "the bridge"
        )
    text = Markup(
        "The controller of {}, compiled, runs the simulated drive sample by sample; {}.{} The "
        "samples are in {}."
    ).format(held, acts, loops, files)
    caption = f"{_panels(found.run)} at the sampling instants; dashed: references."
    names = [figure_name(each.label, number) for number, each in enumerate(found.every)]
    captions = [caption, *(f"The same, {name.split('_')[-1]}." for name in names[1:])]
    drawings = list(zip(names, captions, strict=True))
    return Passage(text=[text], drawings=drawings, tables=simulation_html(found))


def control_header_name(prefix: str, number_format: NumberFormat) -> str:
    """Name of the header of the control functions in a format."""
    return f"{prefix}_control{'' if number_format == 'float32' else '_' + number_format}.h"


def figure_name(label: str, number: int) -> str:
    """Name of the figure of a run; those after the first bear what ran."""
    return "simulation" if number == 0 else f"simulation_{label}"


def _plain_phases(found: DriveSimulation) -> PlainData:
    """The key of phase machines; nothing for others."""
    seen = found.phases
    if seen is None:
        return {}
    return {
        "phases": {
            "topology": found.design.inverter.topology,
            "torque_mean_Nm": seen.torque,
            "torque_ripple_means_Nm": seen.ripple_means,
            "torque_ripple_Nm": seen.ripple,
            "neutral_rms_A": seen.neutral_rms,
            "copper_W": list(seen.copper),
            "midpoint_off_V": seen.midpoint,
        }
    }


def _plain_blocks(found: DriveSimulation) -> PlainData:
    """The key of six-step drives; nothing for others."""
    seen = found.six_step
    if seen is None:
        return {}
    return {
        "six_step": {
            "started_s": seen.started,
            "stage": seen.stage,
            "fault": seen.fault,
            "commutations": seen.commutations,
            "error_mean_rad": seen.error_mean,
            "error_rms_rad": seen.error_rms,
            "error_largest_rad": seen.error_largest,
            "predicted_rad": seen.predicted,
        }
    }


def _plain_bridge(found: DriveSimulation) -> PlainData:
    """The key of a counted bridge; nothing for others."""
    if found.run.bridge is None:
        return {}
    seen = found.run.bridge.figures
    named = found.design.inverter.device is not None
    watts = {
        f"{part}{of}_W": value if named else None
        for part in ("conduction", "switching", "blanked")
        for of, value in zip(("_run", ""), getattr(seen, part), strict=True)
    }
    return {
        "current_feedback": {
            "method": found.design.control.current_loop.method,
            "frequency_run_Hz": seen.frequency,
            "frequency_Hz": seen.tail_frequency,
            "distortion": seen.distortion if math.isfinite(seen.distortion) else None,
            "ripple_current_A": seen.ripple_current,
            "torque_Nm": seen.torque,
            "torque_ripple_Nm": seen.torque_ripple,
            "torque_ripple_rms_Nm": seen.torque_rms,
            "i_d_A": seen.i_d,
            "i_q_A": seen.i_q,
            "copper_W": seen.copper,
            "shaft_W": seen.shaft,
            "link_W": seen.link,
            **watts,
            "junction_degC": seen.junction_temperature if named else None,
        }
    }


def _plain_firmware(found: DriveSimulation) -> PlainData:
    """The keys of loops of other firmware; nothing for the emitted code."""
    if found.firmware is None:
        return {}
    return {"firmware": found.firmware, "remarks": list(found.remarks)}


def plain_start(start: StartFigures) -> PlainData:
    """Figures of a start as plain data, in SI units and rad."""
    return {
        "state": start.state,
        "fault": start.fault,
        "failed": list(start.failed),
        "hand_over_s": start.hand_over,
        "omega_m_rad_per_s": start.speed,
        "angle_error_rad": start.angle_error,
        "current_step_A": start.current_step,
        "reached_s": start.reached,
        "back_rad": start.back,
        "crossings": start.crossings,
    }


def plain_simulation(found: DriveSimulation) -> PlainData:
    """Figures as plain data, in SI units; the samples are in the archives."""
    others = [_plain_run(other) for other in found.others]
    return _plain_run(found) | {"not_simulated": list(found.not_simulated), "others": others}


def _plain_run(found: DriveSimulation) -> PlainData:
    run, figures, seen = found.run, found.run.figures, found.observed
    return (
        _plain_phases(found)
        | _plain_blocks(found)
        | _plain_bridge(found)
        | _plain_firmware(found)
        | ({} if found.turning is None else {"turning": asdict(found.turning)})
        | ({} if found.start is None else {"start": plain_start(found.start)})
        | ({} if found.estimation is None else {"estimation": asdict(found.estimation)})
        | {
            "mode": run.scenario.mode,
            "inverter": run.scenario.inverter,
            "format": found.format,
            "unit": found.unit,
            "duration_s": float(figures.t[0]),
            "bounded": bool(figures.bounded[0]),
            "deviation_largest": found.tracking[0],
            "deviation_rms": found.tracking[1],
            "omega_m_largest_rad_per_s": found.speed_largest,
            "torque_largest_Nm": found.torque_largest,
            "peak_current_A": float(figures.peak_current[0]),
            "rms_current_A": float(figures.rms_current[0]),
            "copper_W": found.copper,
            "energy_J": {
                name: float(getattr(figures, f"e_{name}")[0])
                for name in ("in", "copper", "shaft", "load", "friction")
            },
            "end": {
                "omega_m_rad_per_s": float(figures.omega_m[0]),
                "torque_Nm": float(figures.torque[0]),
                "i_d_A": float(figures.i_d[0]),
                "i_q_A": float(figures.i_q[0]),
            },
            "steps": [asdict(step) for step in found.steps],
            "observer": None
            if seen is None
            else {
                "angle_error_rms_rad": seen.angle_rms,
                "angle_error_largest_rad": seen.angle_largest,
                "speed_error_largest_rad_per_s": seen.speed_largest,
                "sensorless_share": seen.sensorless_share,
            },
        }
    )


# The simulation of a drive with its emitted controller, as records.


def _figures(_: Solution, found: DriveSimulation) -> Mapping[str, Draw]:

    return {
        figure_name(each.label, number): partial(plot_simulation, each)
        for number, each in enumerate(found.every)
    }


def _parts(_: Solution, found: DriveSimulation) -> list[ReportPart]:
    return [
        simulation_passage(found).of(CHAPTER, run_key(found)),
    ]


def _not_simulated(outcome: Outcome) -> tuple[NumberFormat, ...] | None:
    if outcome.design.simulation is None or not outcome.verified:
        return None
    return not_simulated(outcome.solution) or None


FORMATS_NOT_SIMULATED = Capability(
    name="not_simulated",
    title="number formats that no simulation runs",
    of=_not_simulated,
    summary=lambda solution, formats: [("simulation", format_text(simulated(solution), formats))],
)


def _simulation(outcome: Outcome) -> DriveSimulation | None:
    found: DriveSimulation | None = outcome.simulation
    return found


# Figure of a simulation: speed, torque, currents and duty cycles over time.

_WINDOW = 50  # Recorded rows over which a switching frequency is averaged.

_PHASES = (("a", BLUE), ("b", ORANGE), ("c", TEAL))


def _line(
    axes: Axes, time: FloatArray, value: FloatArray, colour: str, label: str, width: float = 1.2
) -> None:
    axes.plot(*thinned(time, value, 600), color=colour, linewidth=width, label=label)


def _reference(axes: Axes, time: FloatArray, value: FloatArray, label: str = "reference") -> None:
    axes.plot(
        *thinned(time, value, 600), color=INK, linewidth=0.8, linestyle=(0, (3.0, 2.0)), label=label
    )


def _angle(axes: Axes, time: FloatArray, found: DriveSimulation) -> None:
    """Error of the observed angle; a bar on top where the controller ran on it."""
    _line(axes, time, np.degrees(found.angle_error), BLUE, "error of the observed angle", 0.9)
    run = found.run
    if run.scenario.sensorless is not None:
        edges = np.flatnonzero(np.diff(run.sensorless > 0.5, prepend=False, append=False))
        for number, (start, end) in enumerate(edges.reshape(-1, 2)):
            name = "control without encoder"
            axes.axvspan(
                float(time[start]), float(time[end - 1]), color=FAINT, alpha=0.35, linewidth=0.0,
                label=f"_{name}" if number else name, zorder=0,
            )  # fmt: skip
    axes.set_ylabel("Angle error in deg")


def _currents(axes: Axes, time: FloatArray, run: Simulation) -> None:
    """Currents in d and q with their references; of phase machines those of phases and neutral."""
    axes.set_ylabel("Currents in A")
    if run.phases is not None:
        for k, (phase, colour) in enumerate(_PHASES):
            _line(axes, time, run.phases.i_phases[:, k], colour, phase, 0.9)
        if np.any(run.phases.i_neutral):
            _line(axes, time, run.phases.i_neutral, MUTED, "neutral", 0.9)
        return
    for axis, value, wanted in (
        ("d", run.i_d, run.i_d_reference),
        ("q", run.i_q, run.i_q_reference),
    ):
        _line(axes, time, value, AXIS_COLOURS[axis], f"$i_{axis}$")
        _reference(axes, time, wanted, ("" if axis == "q" else "_") + f"reference of $i_{axis}$")


def _duties(axes: Axes, time: FloatArray, run: Simulation) -> None:
    """Duty cycles of the three legs, and of a fourth one where the neutral has it."""
    for k, (phase, colour) in enumerate(_PHASES):
        _line(axes, time, run.duty[:, k], colour, phase, 0.7)
    if run.phases is not None and run.phases.duty_legs.shape[1] == len(_PHASES) + 1:
        _line(axes, time, run.phases.duty_legs[:, 3], MUTED, "neutral", 0.7)
    axes.set(ylabel="Duty cycles", ylim=(-0.02, 1.02))


def _frequency(axes: Axes, time: FloatArray, run: Simulation, record: BridgeRecord) -> None:
    """Switching frequency of a leg, mean over some periods."""
    if run.t.size < 2:
        return
    span = max(1, min(_WINDOW, run.t.size - 1))
    gone = record.edges[span:] - record.edges[:-span]
    mean = gone / (6.0 * (run.t[span:] - run.t[:-span]))
    _line(axes, time[span:], mean / 1e3, BLUE, "switching frequency of a leg", 0.9)
    axes.set_ylabel("Frequency in kHz")
    axes.set_ylim(0.0, None)


def _midpoint(axes: Axes, time: FloatArray, voltage: FloatArray) -> None:
    _line(axes, time, voltage, BLUE, "midpoint of the link", 0.9)
    axes.set_ylabel("Voltage in V")


def _states(axes: Axes, time: FloatArray, record: StartRecord) -> None:
    """What a start without encoder is doing, as bands behind the speed."""
    for number, (name, start, end) in enumerate(spans(record)):
        low, high = float(time[start]), float(time[min(end, time.size - 1)])
        axes.axvspan(
            low, high, color=FAINT, alpha=0.3 * (number % 2), linewidth=0.0, zorder=0,
            label=f"_{name}",
        )  # fmt: skip
        if high - low > 0.04 * float(time[-1]):
            axes.text(
                low, 0.03, f" {name}", transform=axes.get_xaxis_transform(), fontsize=6.0,
                color=MUTED, ha="left", va="bottom",
            )  # fmt: skip


def _panels(run: Simulation) -> str:
    """What the figure shows; a regulator of the phase currents has no duty cycles."""
    last = "duty cycles" if run.bridge is None else "switching frequency"
    return f"Speed, torque, currents and {last}"


def plot_simulation(found: DriveSimulation) -> Figure:
    """What `_panels` says, with references where there are some."""
    run = found.run
    factor, unit = (1e3, "ms") if run.t[-1] < 0.5 else (1.0, "s")
    time = run.t * factor
    with style():
        seen = found.observed
        angle = seen is not None and seen.angle_rms is not None
        split = run.phases is not None and bool(np.isfinite(run.phases.v_midpoint).all())
        more = angle + split
        ratios = (1.3, 1.0, 1.3, *(0.8,) * more, 0.9)
        figure = new_figure(
            "simulation",
            6.6 + 1.3 * more,
            f"{_panels(run)} of the simulated drive",
        )
        axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
        speed, torque, currents, bridge = axes[0], axes[1], axes[2], axes[-1]
        if angle:
            _angle(axes[3], time, found)
        if split and run.phases is not None:
            _midpoint(axes[-2], time, run.phases.v_midpoint)
        _line(speed, time, in_rpm(run.omega_m), TEAL, "speed")
        if run.start is not None:
            _states(speed, time, run.start)
        if seen is not None:
            _line(speed, time, in_rpm(run.omega_m_observed), ORANGE, "observed", 0.7)
        elif run.scenario.encoder.speed != "exact" and run.scenario.encoder.lines > 0:
            _line(speed, time, in_rpm(run.omega_m_measured), PALE, "measured", 0.7)
        speed.set_ylabel("Speed in rpm")
        _line(torque, time, run.torque, ORANGE, "torque")
        _line(torque, time, run.torque_load, MUTED, "load", 0.9)
        torque.set_ylabel("Torque in N m")
        _currents(currents, time, run)
        if run.bridge is None:
            _duties(bridge, time, run)
        else:
            _frequency(bridge, time, run, run.bridge)
        bridge.set(xlabel=f"Time in {unit}", xlim=(0.0, float(time[-1])))
        wanted_of = {"speed": (speed, in_rpm(run.reference)), "torque": (torque, run.reference)}
        if run.scenario.mode in wanted_of:
            _reference(wanted_of[run.scenario.mode][0], time, wanted_of[run.scenario.mode][1])
        for panel in axes:
            panel.legend(frameon=False, loc="upper right", ncols=5, fontsize=7.0)
            low, high = panel.get_ylim()
            if (panel is not bridge or run.bridge is not None) and np.isfinite(high - low):
                panel.set_ylim(low, high + 0.18 * (high - low))  # room for the legend
        figure.align_ylabels(axes)
        figure.subplots_adjust(left=0.1, right=0.985, top=0.985, bottom=0.065, hspace=0.14)
    return figure


SIMULATION = Capability(
    name="simulation",
    title="simulation of the drive",
    of=_simulation,
    plain=lambda _, found: plain_simulation(found),
    always=False,
    tables=lambda _, found: simulation_tables(found),
    figures=_figures,
    parts=_parts,
    files=lambda _, found: found.files(),
)
