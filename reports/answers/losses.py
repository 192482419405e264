"""What `dqforge losses` answers: the losses of alternatives at points, over a map or a mission,
and the choice.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np

from dqforge.machines.design.design import ROUNDING_OF_DATA, Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import LoadPoint, LossSettings, LossStrategy
from dqforge.machines.entries.kinds import Rate
from dqforge.machines.entries.rules import EntryError, QuantityRule
from dqforge.machines.errors import InputError, shown
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.losses.machine_budget import MOST_BYTES, Mission, read_mission
from dqforge.machines.losses.measured_losses import read_measured
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, parse_option, refuse_bare
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import solve_map
from dqforge.optimizer.losses.measured_comparison import compare_measured
from dqforge.optimizer.losses.phase_comparison import LossComparison
from dqforge.optimizer.losses.solve import mission_comparison, require_losses
from dqforge.optimizer.modulation_choice.solve import solve_choice
from dqforge.reports.answers.current_feedback import with_regulators
from dqforge.reports.losses.map_tables import (
    losses_tables,
    losses_tables_over,
    map_tables,
    measured_tables,
    mission_tables,
    plain_iron_map,
    plain_losses,
    plain_losses_over,
    plain_map,
    plain_measured_losses,
    plain_mission,
)
from dqforge.reports.modulation_choice.text import choice_tables, plain_choice
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.pages.html_text import map_size

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = ["LossRequest", "answer_losses"]


def answer_losses(design: Design, request: LossRequest, *, choice: bool) -> Answer:
    """Losses at the points of the design, over a map or a mission, or the choice of the design.

    Raises:
        InputError: As `answer` and `answer_choice`, and where options do not go together.
    """
    if design.control.six_step is not None:
        raise InputError(
            "losses: the loss budget is that of sinusoidal currents, and control.observer makes "
            "this a six-step drive; simulate it, or write another observer"
        )
    if choice:
        if request != LossRequest():
            raise InputError(
                "--choice takes its settings from the section 'modulation_choice'; omit the "
                "other options"
            )
        stage("choosing modulator and frequency")
        return answer_choice(design)
    stage("comparing the losses")
    return _with_iron_map(design, _compared(design, request))


def _compared(design: Design, request: LossRequest) -> Answer:
    """The losses that are asked for."""
    if request.measured is not None:
        if request != LossRequest(measured=request.measured):
            raise InputError(
                "--measured: the file has the points, and the design strategy, modulator and "
                "carrier; omit the other options"
            )
        return _measured(design, request.measured)
    if request.chart is not None or request.mission is not None:
        return answer(design, request)
    return _points(design, request)


def _with_iron_map(design: Design, answered: Answer) -> Answer:
    """The answer with what the iron loss by |psi|^2 makes of the design's loss map."""
    mapped = design.machine_loss.mapped
    if mapped is None or mapped.compared is None:
        return answered
    note = f"{mapped.source}: {mapped.compared.sentence}"
    plain = {**answered.plain, "iron_loss_map": plain_iron_map(mapped)}
    return replace(answered, plain=plain, notes=(*answered.notes, note))


# What tells torque from speed in one point: the number that a blank stands before.
_POINT = re.compile(
    r"\s*(?P<torque>\S[^@]*?)(?:\s*@\s*|\s+at\s+|\s+)(?P<speed>[-+]?\.?[0-9][^@]*)\s*"
)
_POINTS = "write each as '130 N m 3000 rpm', with commas between them"


def _asked_points(design: Design, text: str) -> tuple[LoadPoint, ...]:
    """Points of ``--points``; raises `InputError` where one is none, or is beyond the machine."""
    found = []
    for part in text.split(","):
        match = _POINT.fullmatch(part)
        if match is None:
            raise InputError(f"--points: {shown(part.strip())} is no torque and speed; {_POINTS}")
        torque = parse_option(match["torque"], "torque", "--points") or 0.0
        omega = parse_option(match["speed"], "speed", "--points") or 0.0
        most = design.machine.omega_m_max
        if most is not None and abs(omega) > most * (1.0 + ROUNDING_OF_DATA):
            limit = format_quantity(most, "rpm")
            raise InputError(f"--points: {match['speed']} is above machine.max_speed {limit}")
        found.append(LoadPoint(torque, omega))
    if len(found) > MOST_POINTS:
        raise InputError(f"--points: {len(found)} points are named, at most {MOST_POINTS} are read")
    return tuple(found)


def _points(design: Design, request: LossRequest) -> Answer:
    """Losses at points of the command line or of the design, with all alternatives in one table."""
    if request == LossRequest():
        return _answered(design, [require_losses(design)])
    alternatives = requested_alternatives(design, request)
    settings = design.losses
    if request.points is not None:
        points = _asked_points(design, request.points)
    elif settings is not None and settings.points:
        points = settings.points
    else:
        raise InputError(
            "the design names no points; add --points '130 N m 3000 rpm', --map or --mission"
        )
    asked = LossSettings(points, alternatives.strategies, alternatives.modulations)  # type: ignore[arg-type]
    operation = design.operation
    if request.margin != LossRequest().margin:
        operation = replace(operation, voltage_margin=_margin(request.margin))
    each = [
        replace(
            design, losses=asked, operation=operation, inverter=replace(design.inverter, f_sw=f_sw)
        )
        for f_sw in alternatives.frequencies
    ]
    return _answered(each[0], [require_losses(one) for one in each], alternatives.frequencies)


def _answered(
    design: Design, found: list[LossComparison], frequencies: tuple[float, ...] = ()
) -> Answer:
    def figure() -> Figure:
        from dqforge.reports.losses.map_figures import plot_losses

        if len(found) > 1:
            raise InputError("--plot draws one carrier frequency; name one in --frequencies")
        return plot_losses(design, found[0])

    plain: dict[str, Any]
    if len(found) > 1:
        tables = losses_tables_over(design, found, frequencies)
        plain = {"losses": plain_losses_over(found, frequencies)}
    else:
        tables, plain = losses_tables(design, found[0]), {"losses": plain_losses(found[0])}
    answered = Answer(design.name, tables, plain, figure)
    return with_regulators(design, answered) if design.control.current_loop.switches else answered


# Which alternative loses least over a map or a mission: options in; tables, plain data and a
# figure out.

MOST_POINTS = 1000  # As the section losses of a design has it.
_DEFAULT_MODULATIONS: tuple[ModulationName, ...] = ("spwm", "svpwm", "dpwm1", "ddt-gdpwm")


_MOST_BUDGETS = 4_000_000


@dataclass(frozen=True, slots=True)
class LossRequest:
    """The options as they were written; None where an option was not given."""

    chart: str | None = None
    mission: Path | None = None
    strategies: str | None = None
    modulations: str | None = None
    frequencies: str | None = None
    margin: str = "0 %"
    points: str | None = None
    measured: Path | None = None


def _listed(text: str, option: str, known: tuple[str, ...]) -> tuple[str, ...]:
    """Names of a list with commas, each known and once."""
    names = tuple(part.strip().lower() for part in text.split(",") if part.strip())
    if names == ("all",):
        return known
    for name in names:
        if name not in known:
            raise InputError(f"{option}: expected some of {', '.join(known)}, or all, got '{name}'")
    if not names or len(set(names)) != len(names):
        raise InputError(f"{option}: write each name once, such as {','.join(known[:2])}")
    return names


_CARRIER: QuantityRule = get_args(Rate)[1]  # As inverter.switching_frequency has it.


def _frequencies(text: str) -> tuple[float, ...]:
    found = []
    for part in text.split(","):
        try:
            refuse_bare(part, "frequency")
            found.append(_CARRIER.read(part.strip()).si)
        except (EntryError, InputError) as error:
            raise InputError(f"--frequencies: {error.message}") from None
    if len(set(found)) != len(found):
        raise InputError("--frequencies: write each once, such as '8 kHz, 16 kHz'")
    return tuple(found)


def requested_alternatives(design: Design, request: LossRequest) -> Alternatives:
    """What the options and the design's section ``losses`` ask to compare."""
    known_strategies, known_names = get_args(LossStrategy), tuple(MODULATORS)
    settings = design.losses
    strategies: tuple[LossStrategy, ...] = ("mtpa",) if settings is None else settings.strategies
    names = _DEFAULT_MODULATIONS if settings is None else settings.modulations
    if request.strategies is not None:
        wanted = _listed(request.strategies, "--strategies", known_strategies)
        strategies = tuple(name for name in known_strategies if name in wanted)
    if request.modulations is not None:
        wanted = _listed(request.modulations, "--modulations", known_names)
        names = tuple(name for name in known_names if name in wanted)
    frequencies = (
        (design.inverter.f_sw,)
        if request.frequencies is None
        else _frequencies(request.frequencies)
    )
    return Alternatives(strategies, names, frequencies)


def _margin(text: str) -> float:
    share = parse_option(text, "number", "--margin") or 0.0
    if not 0.0 <= share < 0.9:
        raise InputError(f"--margin: expected a share below 90 % such as '5 %', got '{text}'")
    return share


@on_design("losses")
def answer(design: Design, request: LossRequest) -> Answer:
    """Compare what the options ask for, over a map or a mission.

    Raises:
        InputError: An option or the mission file is not understood, or options exclude each other.
        NoSolutionError: The limits leave no speed at all, or the winding has no steady temperature.
    """
    if request.chart is not None and request.mission is not None:
        raise InputError("--map and --mission exclude each other; use one at a time")
    alternatives = requested_alternatives(design, request)
    margin = _margin(request.margin)
    if request.points is not None:
        raise InputError("--points: --map and --mission have their own points; omit it, or them")
    if request.mission is not None:
        return _mission(design, request.mission, alternatives, margin)
    return _map(design, alternatives, margin, *map_size(request.chart or ""))


def _map(
    design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int
) -> Answer:
    count = torques * speeds * int(np.prod(alternatives.shape))
    if count > _MOST_BUDGETS:
        message = f"--map: {count} budgets are requested, at most {_MOST_BUDGETS} are computed"
        raise InputError(f"{message}; take fewer points or alternatives")
    found = solve_map(design, alternatives, margin, torques, speeds)

    def figure() -> Any:
        from dqforge.reports.losses.map_figures import plot_loss_map

        return plot_loss_map(found)

    return Answer(design.name, map_tables(design, found), {"loss_map": plain_map(found)}, figure)


def _read(path: Path, omega_max: float | None) -> Mission:
    content = read_regular_file(path, MOST_BYTES)
    return read_mission(content, str(path), omega_max=omega_max)


def _mission(design: Design, path: Path, alternatives: Alternatives, margin: float) -> Answer:
    mission = _read(path, design.machine.omega_m_max)
    found = mission_comparison(design, mission, alternatives, margin)

    def figure() -> Any:
        from dqforge.reports.losses.map_figures import plot_mission

        return plot_mission(found)

    plain = {"mission": plain_mission(found)}
    return Answer(design.name, mission_tables(design, found), plain, figure)


def _measured(design: Design, path: Path) -> Answer:
    """What was measured beside the budget of the design."""
    measured = read_measured(read_regular_file(path, MOST_BYTES), str(path))
    found = compare_measured(design, measured)
    plain = {"measured_losses": plain_measured_losses(found)}
    return Answer(design.name, measured_tables(found), plain)


@on_design("modulation_choice")
def answer_choice(design: Design) -> Answer:
    """Choose modulator and switching frequency as the design asks.

    Raises:
        InputError: The design has no section ``modulation_choice``.
        NoSolutionError: Nothing keeps the limits anywhere.
    """
    found = solve_choice(design)
    if found is None:
        message = (
            "the design requests no choice; add a section 'modulation_choice' with min_frequency, "
            "max_frequency"
        )
        raise InputError(message)

    def figure() -> Any:
        from dqforge.reports.modulation_choice.figures import plot_choice

        return plot_choice(found)

    return Answer(
        design.name,
        choice_tables(design, found),
        {"modulation_choice": plain_choice(found)},
        figure,
    )
