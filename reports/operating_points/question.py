"""One question about operating points, answered: options in; tables,
plain data and a figure out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.units.quantities import parse_option
from dqforge.optimizer.operating_points.characteristics import (
    VoltageLimit,
    characteristics,
    envelope,
    envelope_speeds,
    fastest_speed,
    loci,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.operating_points.drive_points import drive_points
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.loss_model import loss_coefficients
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.reports.operating_points.map_tables import (
    envelope_tables,
    plain_map,
    plain_points,
    point_tables,
    points_tables,
)
from dqforge.reports.pages.options import map_size
from dqforge.reports.pages.reply import Reply

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


def _limit(design: Design, request: Request) -> VoltageLimit:
    names = tuple(MODULATORS)
    if request.modulation not in names:
        raise InputError(
            f"--modulation: expected one of {', '.join(names)}, got '{request.modulation}'"
        )
    name: ModulationName = next(name for name in names if name == request.modulation)
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
def answer(design: Design, request: Request) -> Reply:
    """Solve what the options ask for.

    Raises
    ------
    InputError
        An option is not understood, options exclude each other, or the
        design's strategy is not MTPA.
    NoSolutionError
        The limits leave no current at the speed, or no speed at all.
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
            raise InputError("--map spans all speeds and torques; leave --speed and --torque out")
        return _map(design, limit, request, *map_size(request.chart))
    return _points(design, limit, request)


def _minimised(
    design: Design, limit: VoltageLimit, request: Request, omega: FloatArray
) -> LossCoefficients | None:
    """What is minimised at speeds in rad/s: None for the copper loss."""
    if request.objective == "copper":
        return None
    return loss_coefficients(
        design.machine,
        omega,
        design.inverter,
        extra=design.machine_loss,
        modulation=limit.modulation,
    )


def _most_torque(design: Design, limit: VoltageLimit, omega: float, sign: float) -> OptimalPoints:
    """Most torque of a sign at a speed in rad/s."""
    beyond = sign * 2.0 * float(mtpa_locus(design.machine, design.i_max).torque[-1])
    most = optimal_points(design.machine, beyond, omega, v_max=limit.v_max, i_max=design.i_max)
    if most.active[0] != Active.UNREACHABLE:
        return most
    last = characteristics(design.machine, limit.v_max, design.i_max).speed_max
    end = "" if last is None else f"; it can be kept up to {last * 30.0 / np.pi:.4g} rpm"
    raise NoSolutionError(
        f"--speed: at {omega * 30.0 / np.pi:.4g} rpm no current within {design.i_max:.4g} A keeps "
        f"the voltage limit of {limit.v_max:.4g} V{end}"
    )


def _points(design: Design, limit: VoltageLimit, request: Request) -> Reply:
    omega = parse_option(request.speed, "speed", "--speed") or 0.0
    machine, i_max = design.machine, design.i_max
    asked = parse_option(request.torque, "torque", "--torque")
    most = _most_torque(design, limit, omega, -1.0 if asked is not None and asked < 0.0 else 1.0)
    end = float(most.torque[0])
    shown = np.linspace(0.0, end, _CURVE_ROWS) if asked is None else np.array([asked])
    loss = _minimised(design, limit, request, np.asarray(omega))
    found = drive_points(
        machine, design.inverter, limit, shown, omega, i_max, loss=loss, extra=design.machine_loss
    )

    def figure() -> Any:
        from dqforge.reports.operating_points.figures import plot_speed

        if asked is not None:
            raise InputError("--plot draws a speed or a map; leave --torque out")
        fine = optimal_points(
            machine, np.linspace(0.0, end, 201), omega, v_max=limit.v_max, i_max=i_max, loss=loss
        )
        return plot_speed(fine, limit)

    one = asked is not None
    name = request.objective
    tables = (
        point_tables(design, found, most, limit, name)
        if one
        else points_tables(design, found, limit, name)
    )
    return Reply(tables, {"operating_points": plain_points(found, most, limit, name)}, figure)


def _map(design: Design, limit: VoltageLimit, request: Request, torques: int, speeds: int) -> Reply:
    machine, i_max = design.machine, design.i_max
    figures = characteristics(machine, limit.v_max, i_max)
    fastest = fastest_speed(design, figures, limit)
    omega = np.linspace(0.0, fastest, speeds)
    chart = operating_map(
        machine,
        design.inverter,
        limit,
        np.linspace(0.0, figures.torque_max, torques),
        omega,
        i_max,
        loss=_minimised(design, limit, request, omega),
        extra=design.machine_loss,
    )
    edge = envelope(
        machine, limit.v_max, envelope_speeds(machine, limit.v_max, fastest, i_max), i_max
    )

    def figure() -> Any:
        from dqforge.reports.operating_points.figures import plot_operating_map

        return plot_operating_map(figures, edge, chart)

    tables = envelope_tables(design, figures, edge, chart, limit)
    plain = plain_map(figures, edge, chart, loci(machine, limit.v_max, i_max), limit) | {
        "objective": request.objective
    }
    return Reply(tables, {"operating_map": plain}, figure)
