"""What `dqforge mtpa` answers: currents over torque, and operating points
within the voltage limit.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import contradiction
from dqforge.machines.units.quantities import parse_option
from dqforge.optimizer.current_reference.fit import signed_designs
from dqforge.optimizer.operating_points.characteristics import (
    LimitedDrive,
    Objective,
    VoltageLimit,
    map_within,
    most_torque,
    points_within,
    voltage_limit,
)
from dqforge.optimizer.operating_points.points import OptimalPoints
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.overmodulation import solve_overmodulation
from dqforge.reports.operating_points.map_tables import (
    envelope_tables,
    mtpa_tables,
    plain_curves,
    plain_map,
    plain_points,
    point_tables,
    points_tables,
)
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.pages.html_text import map_size
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = ["Request", "answer_mtpa"]


def answer_mtpa(design: Design, request: Request) -> Answer:
    """Currents over torque; with a speed, a torque or a map what is asked for;
    raises as `answer`.
    """
    stage("solving")
    return answer(design, request) if request.within_voltage else _curves(design)


def _curves(design: Design) -> Answer:
    positive, negative = signed_designs(design)
    curves = solve_curves(positive)
    mirrored = None if negative is None else solve_curves(negative)

    def figure() -> Figure:
        from dqforge.reports.current_reference.figures import plot_mtpa

        return plot_mtpa(positive, curves)

    plain: PlainData = {"mtpa": plain_curves(curves)}
    if mirrored is not None:
        plain["mtpa_negative"] = plain_curves(mirrored)
    tables, beyond = mtpa_tables(design, curves, mirrored), solve_overmodulation(design)
    if beyond is not None:
        from dqforge.reports.single_headers.overmodulation import (
            overmodulation_tables,
            plain_overmodulation,
        )

        plain["overmodulation"] = plain_overmodulation(beyond)
        tables = [*tables, *overmodulation_tables(beyond)]
    return Answer(design.name, tables, plain, figure)


# One question about operating points, answered: options in; tables, plain data and a figure out.

_CURVE_ROWS = 11


@dataclass(frozen=True, slots=True)
class Request:
    """The options as they were written; None where an option was not given."""

    speed: str | None
    torque: str | None
    chart: str | None
    modulation: str
    margin: str
    objective: str = "copper"

    @property
    def within_voltage(self) -> bool:
        """Whether a speed, a torque or a map is asked for, and with it the voltage limit."""
        return (self.speed, self.torque, self.chart) != (None, None, None)


def _limit(design: Design, request: Request) -> VoltageLimit:
    names = tuple(MODULATORS)
    if request.modulation not in names:
        raise InputError(
            f"--modulation: expected one of {', '.join(names)}, got '{request.modulation}'"
        )
    name: ModulationName = next(name for name in names if name == request.modulation)
    found = contradiction("--modulation", design.inverter.topology, name)
    if found:
        raise InputError(found)
    text = request.margin.strip()
    if text == "dead-time":
        inverter = design.inverter
        return voltage_limit(
            inverter, name, 1.0 - float(dead_time_factor(name, inverter.dead_time, inverter.f_sw))
        )
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*%", text)
    if match is None or float(match[1]) >= 90.0:
        raise InputError(
            f"--margin: expected a share below 90 % such as '5 %', or dead-time, got '{text}'"
        )
    return voltage_limit(design.inverter, name, float(match[1]) / 100.0)


@on_design("operation")
def answer(design: Design, request: Request) -> Answer:
    """Solve what the options ask for.

    Raises:
        InputError: An option is not understood, options exclude each other, or the design's
            strategy is not MTPA.
        NoSolutionError: The limits leave no current at the speed, or no speed at all.
    """
    if design.strategy != "mtpa":
        raise InputError(
            "these options minimise the copper loss, but operation.strategy is id0; write "
            "strategy: mtpa"
        )
    limit = _limit(design, request)
    if request.objective not in ("copper", "total"):
        raise InputError(f"--objective: expected copper or total, got '{request.objective}'")
    if request.chart is not None:
        if request.speed is not None or request.torque is not None:
            raise InputError("--map spans all speeds and torques; omit --speed and --torque")
        return _map(design, limit, request, *map_size(request.chart))
    return _points(design, limit, request)


def _drive(design: Design, limit: VoltageLimit) -> LimitedDrive:
    """The drive of a design within a voltage limit."""
    return LimitedDrive(design.machine, design.inverter, limit, design.i_max, design.machine_loss)


def _objective(request: Request) -> Objective:
    return "copper" if request.objective == "copper" else "total"


def _most_torque(drive: LimitedDrive, omega: float, sign: float) -> OptimalPoints:
    """Most torque of a sign at a speed in rad/s; its refusal is about the option."""
    try:
        return most_torque(drive, omega, sign)
    except NoSolutionError as error:
        raise NoSolutionError(f"--speed: {error.message}") from error


def _points(design: Design, limit: VoltageLimit, request: Request) -> Answer:
    omega = parse_option(request.speed, "speed", "--speed") or 0.0
    drive, objective = _drive(design, limit), _objective(request)
    asked = parse_option(request.torque, "torque", "--torque")
    most = _most_torque(drive, omega, -1.0 if asked is not None and asked < 0.0 else 1.0)
    end = float(most.torque[0])
    shown = np.linspace(0.0, end, _CURVE_ROWS) if asked is None else np.array([asked])
    found = points_within(drive, shown, omega, objective)

    def figure() -> Any:
        from dqforge.reports.operating_points.figures import plot_speed

        if asked is not None:
            raise InputError("--plot draws a speed or a map; omit --torque")
        fine = points_within(drive, np.linspace(0.0, end, 201), omega, objective)
        return plot_speed(fine.points, limit)

    one = asked is not None
    tables = (
        point_tables(design, found, most, limit, objective)
        if one
        else points_tables(design, found, limit, objective)
    )
    plain = {"operating_points": plain_points(found, most, limit, objective)}
    return Answer(design.name, tables, plain, figure)


def _map(
    design: Design, limit: VoltageLimit, request: Request, torques: int, speeds: int
) -> Answer:
    found = map_within(_drive(design, limit), torques, speeds, _objective(request))
    figures, edge, chart = found.figures, found.envelope, found.chart

    def figure() -> Any:
        from dqforge.reports.operating_points.figures import plot_operating_map

        return plot_operating_map(figures, edge, chart)

    tables = envelope_tables(design, figures, edge, chart, limit)
    plain = plain_map(figures, edge, chart, found.loci, limit) | {"objective": found.objective}
    return Answer(design.name, tables, {"operating_map": plain}, figure)
