"""One question about operating points, answered: options in; tables, plain data and a figure out."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.quantities import parse_quantity
from dqforge.machines.settings import ModulationName
from dqforge.optimizer.characteristics import (
    VoltageLimit,
    characteristics,
    envelope,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.operating_points import optimal_points
from dqforge.reports.characteristics_tables import envelope_tables, plain_map, plain_points, points_tables
from dqforge.reports.reference_ir import PlainData
from dqforge.reports.tables import Table

_CURVE_ROWS = 11
_ENVELOPE_POINTS = 241
_MOST_CELLS = 2000


@dataclass(frozen=True, slots=True)
class Request:
    """The options as they were written; None where an option was not given."""

    speed: str | None
    torque: str | None
    chart: str | None
    modulation: str
    margin: str


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer: tables for the terminal, plain data for JSON, and what draws its figure."""

    tables: list[Table]
    plain: PlainData
    figure: Callable[[], Any]


def _quantity(text: str, dimension: str, option: str) -> float:
    try:
        return parse_quantity(text, dimension)
    except InputError as error:
        raise InputError(f"{option}: {error.message}") from error


def _limit(design: Design, request: Request) -> VoltageLimit:
    names = get_args(ModulationName)
    if request.modulation not in names:
        raise InputError(f"--modulation: expected one of {', '.join(names)}, got '{request.modulation}'")
    text = request.margin.strip()
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*%", text)
    if match is None or float(match[1]) >= 90.0:
        raise InputError(f"--margin: expected a share below 90 % such as '5 %', got '{text}'")
    name: ModulationName = next(name for name in names if name == request.modulation)
    return voltage_limit(design.inverter, name, float(match[1]) / 100.0)


def _map_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text.strip(), re.IGNORECASE)
    sizes = (int(match[1]), int(match[2])) if match else (0, 0)
    if not all(2 <= size <= _MOST_CELLS for size in sizes):
        raise InputError(f"--map: expected NxM with 2 to {_MOST_CELLS} torques and speeds such as 40x60, got '{text}'")
    return sizes


def answer(design: Design, request: Request) -> Reply:
    """Solve what the options ask for.

    Raises
    ------
    InputError
        An option is not understood, options exclude each other, or the design's strategy is not MTPA.
    """
    if design.strategy != "mtpa":
        raise InputError("these options minimise the copper loss, but operation.strategy is id0; write strategy: mtpa")
    limit = _limit(design, request)
    if request.chart is not None:
        if request.speed is not None or request.torque is not None:
            raise InputError("--map spans all speeds and torques; leave --speed and --torque out")
        return _map(design, limit, *_map_size(request.chart))
    return _points(design, limit, request)


def _points(design: Design, limit: VoltageLimit, request: Request) -> Reply:
    omega = 0.0 if request.speed is None else _quantity(request.speed, "speed", "--speed")
    machine, i_max = design.machine, design.i_max
    if request.torque is None:
        most = float(envelope(machine, limit.v_max, np.array([omega]), i_max).points.torque[0])
        shown, drawn = np.linspace(0.0, most, _CURVE_ROWS), np.linspace(0.0, most, 201)
    else:
        shown = drawn = np.array([_quantity(request.torque, "torque", "--torque")])
    points = optimal_points(machine, shown, omega, v_max=limit.v_max, i_max=i_max)
    fine = optimal_points(machine, drawn, omega, v_max=limit.v_max, i_max=i_max)

    def figure() -> Any:
        from dqforge.reports.figures_characteristics import plot_speed

        if request.torque is not None:
            raise InputError("--plot draws a speed or a map; leave --torque out")
        return plot_speed(fine, limit)

    return Reply(points_tables(design, points, limit), {"operating_points": plain_points(points, limit)}, figure)


def _map(design: Design, limit: VoltageLimit, torques: int, speeds: int) -> Reply:
    machine, i_max = design.machine, design.i_max
    figures = characteristics(machine, limit.v_max, i_max)
    fastest = machine.omega_m_max if machine.omega_m_max is not None else 3.0 * figures.base_speed
    chart = operating_map(
        machine,
        design.inverter,
        limit,
        np.linspace(0.0, figures.torque_max, torques),
        np.linspace(0.0, fastest, speeds),
        i_max,
    )
    edge = envelope(machine, limit.v_max, np.linspace(0.0, fastest, _ENVELOPE_POINTS), i_max)

    def figure() -> Any:
        from dqforge.reports.figures_characteristics import plot_operating_map

        return plot_operating_map(figures, edge, chart)

    tables = envelope_tables(design, figures, edge, chart, limit)
    return Reply(tables, {"operating_map": plain_map(figures, edge, chart, limit)}, figure)
