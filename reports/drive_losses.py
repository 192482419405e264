"""Which alternative loses least over a map or a mission: options in; tables, plain data and a figure out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.input_files import read_regular_file
from dqforge.machines.inverter import Inverter
from dqforge.machines.mission import MOST_BYTES, Mission, read_mission
from dqforge.machines.modulation import linear_limit
from dqforge.machines.numerical import on_design
from dqforge.machines.quantities import parse_quantity
from dqforge.machines.settings import LossStrategy, ModulationName
from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.characteristics import VoltageLimit, characteristics, voltage_limit
from dqforge.optimizer.drive_budget import BudgetOptions
from dqforge.optimizer.drive_comparison import (
    Alternatives,
    DriveComparison,
    compare_drives,
    usable_limit,
)
from dqforge.optimizer.mission_budget import MissionComparison, compare_mission
from dqforge.reports.drive_losses_tables import map_tables, mission_tables, plain_map, plain_mission
from dqforge.reports.operating_points import fastest_speed, map_size
from dqforge.reports.reference_ir import PlainData
from dqforge.reports.tables import Table

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


@dataclass(frozen=True, slots=True)
class LossReply:
    """The answer: tables for the terminal, plain data for JSON, and what draws its figure."""

    tables: list[Table]
    plain: PlainData
    figure: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class LossMap:
    """A comparison over N torques in N m and M mechanical speeds in rad/s; its points run row by row."""

    torque: FloatArray
    omega_m: FloatArray
    comparison: DriveComparison


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
    known_strategies, known_names = get_args(LossStrategy), get_args(ModulationName)
    settings = design.losses
    strategies: tuple[LossStrategy, ...] = ("mtpa",) if settings is None else settings.strategies
    names = _DEFAULT_MODULATIONS if settings is None else settings.modulations
    if request.strategies is not None:
        wanted = _listed(request.strategies, "--strategies", known_strategies)
        strategies = tuple(name for name in known_strategies if name in wanted)
    if request.modulations is not None:
        wanted = _listed(request.modulations, "--modulations", known_names)
        names = tuple(name for name in known_names if name in wanted)
    frequencies = (design.inverter.f_sw,) if request.frequencies is None else _frequencies(request.frequencies)
    return Alternatives(strategies, names, frequencies)


def budget_options(design: Design) -> BudgetOptions:
    """What the design says of losses beside those of the fundamental."""
    return BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr)


def _margin(text: str) -> float:
    share = parse_quantity(text, "number")
    if not 0.0 <= share < 0.9:
        raise InputError(f"--margin: expected a share below 90 % such as '5 %', got '{text}'")
    return share


@on_design("losses")
def answer(design: Design, request: LossRequest) -> LossReply:
    """Compare what the options ask for, over a map or a mission.

    Raises
    ------
    InputError
        An option or the mission file is not understood, or options exclude each other.
    NoSolutionError
        The limits leave no speed at all, or the winding has no steady temperature.
    """
    if request.chart is not None and request.mission is not None:
        raise InputError("--map and --mission are two questions; ask one at a time")
    alternatives = requested_alternatives(design, request)
    margin = _margin(request.margin)
    if request.mission is not None:
        return _mission(design, request.mission, alternatives, margin)
    return _map(design, alternatives, margin, *map_size(request.chart or ""))


def _map(design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int) -> LossReply:
    count = torques * speeds * int(np.prod(alternatives.shape))
    if count > _MOST_BUDGETS:
        message = f"--map: {count} budgets are asked for, at most {_MOST_BUDGETS} are computed"
        raise InputError(f"{message}; take fewer points or alternatives")
    found = solve_map(design, alternatives, margin, torques, speeds)

    def figure() -> Any:
        from dqforge.reports.figures_drive_losses import plot_loss_map

        return plot_loss_map(found)

    return LossReply(map_tables(design, found), {"loss_map": plain_map(found)}, figure)


def _widest(inverter: Inverter, alternatives: Alternatives, margin: float) -> VoltageLimit:
    """Largest limit that one of the alternatives has, dead time and margin taken off."""
    slowest = replace(inverter, f_sw=min(alternatives.frequencies))
    widest = max(alternatives.modulations, key=lambda name: usable_limit(slowest, name))
    taken = 1.0 - usable_limit(slowest, widest, margin) / linear_limit(widest, inverter.v_dc)
    return voltage_limit(inverter, widest, taken)


def solve_map(design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int) -> LossMap:
    """Compare over the motoring quadrant, up to the most torque and the largest speed of the best modulator."""
    limit = _widest(design.inverter, alternatives, margin)
    figures = characteristics(design.machine, limit.v_max, design.i_max)
    fastest = fastest_speed(design, figures, limit)
    torque = np.linspace(0.0, figures.torque_max, torques + 1)[1:]
    omega = np.linspace(0.0, fastest, speeds + 1)[1:]
    wanted, speed = np.meshgrid(torque, omega, indexing="ij")
    comparison = compare_drives(
        design.machine,
        design.inverter,
        wanted.ravel(),
        speed.ravel(),
        alternatives,
        i_max=design.i_max,
        options=budget_options(design),
        margin=margin,
    )
    return LossMap(torque, omega, comparison)


def _read(path: Path, omega_max: float | None) -> Mission:
    content = read_regular_file(path, MOST_BYTES)
    return read_mission(content, str(path), omega_max=omega_max)


def _mission(design: Design, path: Path, alternatives: Alternatives, margin: float) -> LossReply:
    mission = _read(path, design.machine.omega_m_max)
    found: MissionComparison = compare_mission(
        design.machine,
        design.inverter,
        mission,
        alternatives,
        i_max=design.i_max,
        options=budget_options(design),
        margin=margin,
    )

    def figure() -> Any:
        from dqforge.reports.figures_drive_losses import plot_mission

        return plot_mission(found)

    return LossReply(mission_tables(design, found), {"mission": plain_mission(found)}, figure)
