"""Which alternative loses least over a map or a mission: options in; tables,
plain data and a figure out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, get_args

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import LossStrategy
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.losses.machine_budget import MOST_BYTES, Mission, read_mission
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import parse_quantity
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
)
from dqforge.optimizer.losses.loss_map import solve_map
from dqforge.optimizer.losses.solve import mission_comparison
from dqforge.reports.losses.map_tables import map_tables, mission_tables, plain_map, plain_mission
from dqforge.reports.pages.answer import Answer
from dqforge.reports.pages.labels import map_size

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


def _frequencies(text: str) -> tuple[float, ...]:
    found = []
    for part in text.split(","):
        try:
            found.append(parse_quantity(part.strip(), "frequency"))
        except InputError as error:
            raise InputError(f"--frequencies: {error.message}") from None
    if any(not 1.0 <= f <= 1e7 for f in found) or len(set(found)) != len(found):
        raise InputError("--frequencies: write each once, 1 Hz to 10 MHz, such as '8 kHz, 16 kHz'")
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
    share = parse_quantity(text, "number")
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
        raise InputError("--map and --mission are two questions; ask one at a time")
    alternatives = requested_alternatives(design, request)
    margin = _margin(request.margin)
    if request.mission is not None:
        return _mission(design, request.mission, alternatives, margin)
    return _map(design, alternatives, margin, *map_size(request.chart or ""))


def _map(
    design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int
) -> Answer:
    count = torques * speeds * int(np.prod(alternatives.shape))
    if count > _MOST_BUDGETS:
        message = f"--map: {count} budgets are asked for, at most {_MOST_BUDGETS} are computed"
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
