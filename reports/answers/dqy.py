"""What `dqforge dqy` answers: phase currents of a machine whose back-EMF is not sinusoidal."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.plants.scenario import CurrentSensor, Encoder, PlantErrors, Scenario, constant
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import parse_option
from dqforge.optimizer.flashing_choice import (
    BACK_EMF,
    DEVIATIONS,
    INDUCTANCE,
    NOISE,
    OFFSET,
    WORTH,
    Advice,
    FlashComparison,
    FlashRow,
    RippleFigures,
    Trade,
    advise,
    compare_flashing,
    variant,
    with_rows,
)
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.waveforms.comparison import compare_waveforms, with_point
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.main_header import header_files
from dqforge.reports.pages.answer import Answer, Table, stage
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.header import phase_control_files
from dqforge.reports.plain_data import PlainData
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Summary, simulate_many, simulator
from dqforge.reports.verification.measured_cost import cost_on_target
from dqforge.reports.waveforms.tables import plain_waveforms, waveform_files, waveform_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class WaveformRequest:
    """The options as they were written; None where an option was not given."""

    torque: str | None
    speed: str | None
    ripple: str | None
    open_phase: str | None
    flash: bool = False


FLASH_HINT = "dqforge dqy --flash compares topologies and controllers, and recommends what to flash"


def answer_dqy(design: Design, request: WaveformRequest) -> Answer:
    """Shape the currents at the point of the request, or else of the design.

    Raises:
        InputError: An option is not understood, or as `compare_waveforms`.
    """
    stage("shaping the currents")
    settings = with_point(
        design.waveform,
        parse_option(request.torque, "torque", "--torque"),
        parse_option(request.speed, "speed", "--speed"),
        parse_option(request.ripple, "number", "--ripple"),
        request.open_phase,
    )
    found = compare_waveforms(design, settings)

    def figure() -> Figure:
        from dqforge.reports.waveforms.figures import plot_waveforms

        return plot_waveforms(found)

    tables = waveform_tables(design, found)
    plain: dict[str, PlainData] = {"waveforms": plain_waveforms(found)}
    if not request.flash:
        return Answer(design.name, tables, plain, figure, notes=(FLASH_HINT,))
    stage("comparing topologies and controllers")
    flashing, advice = what_to_flash(design, settings)
    tables += flash_tables(design, flashing, advice)
    return Answer(design.name, tables, plain | {"flashing": plain_flash(flashing, advice)}, figure)


# What to flash: the question of a design, with everything that this computer can find out.

Progress = Callable[[float], None]


@on_design("waveform")
def what_to_flash(
    design: Design, settings: WaveformSettings, progress: Progress | None = None
) -> tuple[FlashComparison, Advice]:
    """The comparison with the ripple of the emitted C and its cycles, and what follows from it.

    What cannot be had here, for want of a compiler or because a control cannot be emitted, is left
    out, and the comparison says why.

    Args:
        design: The design.
        settings: The operating point.
        progress: Called with the share of the simulation that is done.

    Raises:
        InputError, NoSolutionError: As `compare_flashing`.
    """
    found = compare_flashing(design, settings)
    try:
        solution = _references(design, settings, found)
    except (NoSolutionError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message, uncounted=error.message)
        return found, advise(found)
    try:
        found = with_rows(found, simulated_rows(solution, found, progress), unsimulated="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message)
    try:
        found = with_rows(found, counted_rows(solution, found), uncounted="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, uncounted=error.message)
    return found, advise(found)


def _references(design: Design, settings: WaveformSettings, found: FlashComparison) -> Solution:
    """The solution that the emitted control takes its current references from, on the design's own
    topology and without what else the design asks for.
    """
    plain = variant(design, design.inverter.topology, "dq", found.capacitance)
    return solve(
        replace(
            plain,
            waveform=settings,
            losses=None,
            simulation=None,
            modulation_choice=None,
            weakening=None,
        )
    )


# The rows of the comparison in time: each topology and controller emitted, compiled with the
# switched plant, and run as it is and with every deviation.

# Duration in s of a run with and without harmonic integrators, of which the last part counts.
LEARNING, SETTLING = 0.4, 0.2
_TAIL = 0.75  # Share of a run after which ripple counts.
_PERIODS = 2.0  # Electrical periods that the rest of the run holds at least.

# Relative error of the mean torque above which a row does not do what it is asked for.
_MISSED = 0.05


def simulated_rows(
    solution: Solution,
    found: FlashComparison,
    progress: Callable[[float], None] | None = None,
) -> tuple[FlashRow, ...]:
    """Rows with the torque ripple of the emitted C; those with an obstacle stay as they are.

    Args:
        solution: Of the design; current references and speed loop are taken from it.
        found: The comparison, with the control of each row.
        progress: Called with the share that is done.

    Raises:
        VerificationError: There is no compiler, or a header does not compile.
        InputError: The sampling does not fit the carrier, or a control cannot be emitted.
    """
    done = 0

    def run(row: FlashRow) -> FlashRow:
        nonlocal done
        made = row if row.obstacle else replace(row, simulated=_row(solution, found, row))
        done += 1
        if progress is not None:
            progress(done / len(found.rows))
        return made

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(run, found.rows))


def _row(solution: Solution, found: FlashComparison, row: FlashRow) -> RippleFigures:
    """Ripple of one row."""
    control = row.control
    assert control is not None  # only a row with an obstacle has none
    design = solution.design
    inverter = replace(
        design.inverter, topology=row.topology, midpoint_capacitance=found.capacitance
    )
    drive = Drive(design.machine, inverter, design.control.t_s, 10, design.phase_machine)
    files = files_with_control(solution, control)
    runs = [
        (drive, scenario, b"") for scenario in _scenarios(found, row, design.machine.pole_pairs)
    ]
    with simulator(files, design.export.prefix, (), row.topology) as program:
        ripples = _ripples(simulate_many(program, runs, tail=_TAIL), found.torque)
    return RippleFigures(ripples[0], dict(zip(DEVIATIONS, ripples[1:], strict=True)))


def _scenarios(found: FlashComparison, row: FlashRow, pole_pairs: int) -> list[Scenario]:
    """The run as it is, and one for each deviation."""
    period = 2.0 * math.pi / (pole_pairs * abs(found.omega_m))
    least = LEARNING if row.frame == "table" else SETTLING
    plain = Scenario(
        duration=max(least, _PERIODS * period / (1.0 - _TAIL)),
        mode="torque",
        reference=constant(found.torque),
        shaft=constant(found.omega_m),
        inverter="switched",
        encoder=Encoder(speed="exact"),
        omega_m=found.omega_m,
    )
    sensors = {
        "offset": CurrentSensor(offset=(OFFSET, 0.0, 0.0)),
        "noise": CurrentSensor(noise=NOISE),
    }
    errors = {
        "inductance": PlantErrors(l_d=INDUCTANCE, l_q=INDUCTANCE),
        "back_emf": PlantErrors(psi_pm=BACK_EMF),
    }
    deviating = [
        replace(plain, sensor=sensors[name])
        if name in sensors
        else replace(plain, errors=errors[name])
        for name in DEVIATIONS
    ]
    return [plain, *deviating]


def _ripples(summary: Summary, torque: float) -> list[float]:
    """Ripple over the mean torque of each run; NaN where the mean is not the requested torque."""
    found = []
    for bounded, mean, ripple in zip(
        summary.bounded, summary.tail_torque, summary.tail_ripple_means, strict=True
    ):
        reached = bounded and abs(mean / torque - 1.0) <= _MISSED + BACK_EMF
        found.append(float(ripple / abs(mean)) if reached else math.nan)
    return found


# What a sample of each row costs on the design's core: the emitted control compiled for it and run
# on the emulation.

_SAMPLES = 40


def counted_rows(solution: Solution, found: FlashComparison) -> tuple[FlashRow, ...]:
    """Rows with the cycles of a sample; those without a control stay as they are.

    Args:
        solution: Of the design; its fit names the core.
        found: The comparison, with the control of each row.

    Raises:
        VerificationError: A tool is missing, or the emulation failed.
    """

    def count(row: FlashRow) -> FlashRow:
        if row.control is None:
            return row
        return replace(row, cycles=_cycles(solution, found, row))

    with ThreadPoolExecutor(max(1, os.cpu_count() or 1)) as pool:
        return tuple(pool.map(count, found.rows))


def _cycles(solution: Solution, found: FlashComparison, row: FlashRow) -> tuple[float, float]:
    """Mean cycles (low, high) of a sample."""
    assert row.control is not None  # asked for before
    prefix = solution.design.export.prefix
    omega_e = found.omega_m * row.control.pole_pairs
    sample = render(
        "c_code/control_sample.h.j2",
        {
            "prefix": prefix,
            "omega_m": float_literal(found.omega_m),
            "v_dc": float_literal(found.v_dc),
            "step": float_literal(omega_e * row.control.t_s),
            "midpoint": TOPOLOGIES[row.topology].midpoint,
        },
    )
    files = files_with_control(solution, row.control)
    sources = files | {"control_sample.h": sample.encode("ascii")}
    torques = np.full(_SAMPLES, found.torque, dtype=np.float32)
    core = solution.design.fit.core
    return cost_on_target(sources, "control_sample.h", "control_sample", core, torques).cycles


# The headers that a row of the comparison would flash.


def files_with_control(solution: Solution, control: PhaseControl) -> dict[str, bytes]:
    """Headers of another control than that of a solution, on another topology maybe, complete.

    Args:
        solution: Of a design with a phase machine.
        control: The control; its references are solved for its own topology where it reads them
            from the header of phase currents.
    """
    design = solution.design
    files = header_files(solution) | phase_control_files(solution, control)
    if control.frame != "table" or not isinstance(design.phase_machine, SalientPhaseMachine):
        return files
    other = replace(design, inverter=replace(design.inverter, topology=control.topology))
    return files | waveform_files(other, solve_phases(other))


# What to flash: the comparison as tables and plain data, and its rows in the simulation.


_COLUMNS = (
    "legs",
    "control",
    "ripple %",
    "copper W",
    "inverter W",
    "link V",
    "neutral A",
    "cycles",
    "table B",
    "",
)


_DEVIATIONS = {
    "offset": "a sensor 30 mA off",
    "noise": "30 mA of noise",
    "inductance": "L 30 % lower",
    "back_emf": "EMF 5 % higher",
}


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"


def _share(figures: RippleFigures | None, name: str | None = None) -> str:
    """Percent with two decimals; a dash where it is not known."""
    if figures is None:
        return "-"
    share = figures.plain if name is None else figures.deviating.get(name, math.nan)
    return f"{100.0 * share:.2f}" if math.isfinite(share) else "-"


def _cells(row: FlashRow, advice: Advice, *, without_device: bool) -> tuple[str, ...]:
    known = row.ripple_known
    best = advice.row is not None and (row.topology, row.frame) == (
        advice.row.topology,
        advice.row.frame,
    )
    return (
        TOPOLOGY_TEXT[row.topology],
        FRAME_TEXT[row.frame],
        _share(known),
        _number(row.copper, 4),
        "no device" if without_device else _number(row.bridge, 4),
        _number(row.link, 4),
        _number(row.neutral),
        "-" if row.cycles is None else f"{0.5 * sum(row.cycles):.0f}",
        str(row.constants) if row.constants else "-",
        "flash this" if best else row.obstacle,
    )


def flash_tables(design: Design, found: FlashComparison, advice: Advice) -> list[Table]:
    """Rows of topologies and controllers, the recommendation below them; then what the torque
    ripple becomes where sensors and machine are not what the firmware takes them for.
    """
    point = f"{found.torque:.4g} N m, {in_rpm(found.omega_m):.4g} rpm, {found.v_dc:.4g} V"
    rows = tuple(_cells(row, advice, without_device=found.without_device) for row in found.rows)
    by = "of the emitted C in the compiled simulation"
    if found.unsimulated:
        by = f"by closed form ({found.unsimulated})"
    notes = [
        *advice_lines(advice),
        *_fault(found),
        (
            f"torque ripple, peak to peak of the means over a PWM period, {by}, with a dead time "
            f"of {1e6 * design.inverter.dead_time:.3g} us; table: with harmonic integrators"
        ),
    ]
    if found.uncounted:
        notes.append(f"no cycles: {found.uncounted}")
    if found.without_device:
        notes.append("inverter W: the design has no inverter.device, the switches are unknown")
    if design.inverter.midpoint_capacitance is None:
        notes.append(
            f"split-capacitor: with {1e3 * found.capacitance:.3g} mF in all, which hold the "
            "midpoint within 2 % of the link here"
        )
    main = Table(f"{design.name}: what to flash at {point}", _COLUMNS, rows, tuple(notes))
    columns = ("legs", "control", "as it is", *(_DEVIATIONS[name] for name in DEVIATIONS))
    sensitive = tuple(
        (
            TOPOLOGY_TEXT[row.topology],
            FRAME_TEXT[row.frame],
            _share(row.ripple_known),
            *(_share(row.ripple_known, name) for name in DEVIATIONS),
        )
        for row in found.rows
        if row.ripple_known is not None
    )
    return [main, Table("Torque ripple in % with deviating parameters", columns, sensitive)]


def _fault(found: FlashComparison) -> list[str]:
    """What speaks for a neutral where a phase may fail."""
    price = found.without_phase
    if price is None:
        return []
    return [
        (
            "with a phase open a star's torque vanishes twice a period; with a neutral it stays "
            f"constant for {price.copper:.3g} times the copper, and the neutral's leg carries "
            f"{price.neutral:.2g} times the phase peak"
        )
    ]


def _plain_ripple(figures: RippleFigures | None) -> PlainData | None:
    return None if figures is None else {"plain": figures.plain, **figures.deviating}


def plain_flash(found: FlashComparison, advice: Advice) -> PlainData:
    """Rows, recommendation and what was left out."""
    rows = [
        {
            "topology": row.topology,
            "frame": row.frame,
            "obstacle": row.obstacle,
            "copper_W": row.copper,
            "bridge_W": row.bridge,
            "neutral_leg_W": row.neutral_leg,
            "link_V": row.link,
            "neutral_A": row.neutral,
            "table_B": row.constants,
            "ripple_closed_form": _plain_ripple(row.ripple),
            "ripple_simulated": _plain_ripple(row.simulated),
            "cycles": None if row.cycles is None else list(row.cycles),
        }
        for row in found.rows
    ]
    chosen = advice.row
    trades = [
        {
            "topology": trade.topology,
            "copper_saved_W": trade.copper_saved,
            "bridge_added_W": trade.bridge_added,
            "net_W": trade.net,
            "link_saved_V": trade.link_saved,
            "obstacle": trade.obstacle,
        }
        for trade in advice.trades
    ]
    return {
        "torque_Nm": found.torque,
        "omega_m_rad_per_s": found.omega_m,
        "v_dc_V": found.v_dc,
        "midpoint_capacitance_F": found.capacitance,
        "rows": rows,
        "flash": None if chosen is None else {"topology": chosen.topology, "frame": chosen.frame},
        "dq_ripple": advice.dq_ripple,
        "dq_saved_W": advice.dq_saved,
        "trades": trades,
        "words": [*advice_lines(advice), *_fault(found)],
        "unsimulated": found.unsimulated,
        "uncounted": found.uncounted,
    }


# The recommendation in plain words.

TOPOLOGY_TEXT: dict[Topology, str] = {
    "three-wire": "star",
    "four-leg": "four legs",
    "six-leg": "six legs",
    "split-capacitor": "split link",
}


_MANY = {"six-leg"}

_SUBJECTS: dict[Topology, str] = {
    "three-wire": "a star on three legs",
    "four-leg": "the fourth leg",
    "six-leg": "six legs",
    "split-capacitor": "a split link",
}


FRAME_TEXT: dict[CurrentFrame, str] = {
    "dq": "dq",
    "dqx": "dqx",
    "dqy": "dqy",
    "table": "table",
}


def watts(value: float) -> str:
    """A loss with two or three digits that count."""
    return f"{value:.3g} W" if abs(value) < 10.0 else f"{value:.1f} W"


def percent(share: float) -> str:
    """A share as percent with two digits, as a human reads it."""
    return f"{100.0 * share:.2g} %"


def advice_lines(advice: Advice) -> list[str]:
    """Sentences: what to flash, what it leaves, and what each other topology would change."""
    row = advice.row
    if row is None:
        return ["flash none of these here: no row keeps the voltage and the current of the design"]
    return [_first(row, advice), *(_traded(trade) for trade in advice.trades)]


def _first(row: FlashRow, advice: Advice) -> str:
    known = row.ripple_known
    ripple = math.nan if known is None else known.plain
    bridge = "" if math.isnan(row.bridge) else f" and {watts(row.bridge)} in the inverter"
    control = (
        "dq with constant currents"
        if row.frame == "dq"
        else "the table with harmonic integrators (frame: table)"
    )
    kept = f"torque ripple {percent(ripple)}"
    if row.frame != "dq":
        kept += f", {percent(advice.dq_ripple)} with dq"
        if advice.dq_saved > WORTH * row.losses:
            kept += f", which loses {watts(advice.dq_saved)} less"
    lost = f"{watts(row.copper)} of copper{bridge}"
    return f"flash {TOPOLOGY_TEXT[row.topology]}, {control}: {lost}, {kept}"


def _traded(trade: Trade) -> str:
    name = _SUBJECTS[trade.topology]
    if trade.obstacle:
        return f"{name}: {trade.obstacle}"
    many = trade.topology in _MANY
    copper = _change(trade.copper_saved, many=many)
    if math.isnan(trade.bridge_added):
        cost = "what that costs in the inverter is unknown without inverter.device"
        return f"{name} {copper} of copper; {cost}{_voltage(trade)}"
    of_leg = (
        f" (the neutral's leg loses {watts(trade.neutral_leg)})"
        if math.isfinite(trade.neutral_leg)
        else ""
    )
    bridge = _change(-trade.bridge_added, many=many)
    total = f"that {_change(trade.net, many=False)} in all"
    if trade.net > 0.0:
        total += f", less than the {percent(WORTH)} of the losses that would justify it"
    return (
        f"{name} {copper} of copper and {bridge} in the inverter{of_leg}: {total}{_voltage(trade)}"
    )


def _change(saved: float, *, many: bool) -> str:
    word = "save" if saved >= 0.0 else "cost"
    return f"{word if many else word + 's'} {watts(abs(saved))}"


def _voltage(trade: Trade) -> str:
    """What a topology changes in voltage, from a volt on."""
    if trade.link_saved > 1.0:
        return f"; the link could be {trade.link_saved:.0f} V lower"
    if trade.link_saved < -1.0:
        return f"; the link must be {-trade.link_saved:.0f} V higher"
    return ""
