"""Tables, plain data and figures of operating points within the limits."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design
from matplotlib.figure import Figure
from matplotlib.text import Text

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.operating_points.characteristics import (
    Envelope,
    LimitedDrive,
    OperatingMap,
    VoltageLimit,
    characteristics,
    envelope,
    envelope_speeds,
    loci,
    operating_map,
    points_within,
    voltage_limit,
)
from dqforge.optimizer.operating_points.mtpa_locus import Active
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.reports.answers.mtpa import Request, answer
from dqforge.reports.operating_points.figures import plot_operating_map, plot_speed
from dqforge.reports.operating_points.map_tables import (
    envelope_tables,
    plain_map,
    point_tables,
    points_tables,
)
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.pages.templating import to_text

LIMIT = VoltageLimit("svpwm", 500.0, 0.0, 500.0 / np.sqrt(3.0))


def solved(
    machine: LinearMachine, fastest: float, limit: VoltageLimit
) -> tuple[Any, Envelope, OperatingMap]:
    figures = characteristics(machine, limit.v_max)
    edge = envelope(
        machine,
        limit.v_max,
        envelope_speeds(machine, limit.v_max, fastest, machine.i_max),
        machine.i_max,
    )
    torque, speed = np.linspace(0.0, figures.torque_max, 20), np.linspace(0.0, fastest, 25)
    chart = operating_map(machine, Inverter(limit.v_dc, 1e4), limit, torque, speed, machine.i_max)
    return figures, edge, chart


def drive_of(design: Design) -> LimitedDrive:
    return LimitedDrive(design.machine, design.inverter, LIMIT, design.i_max)


def detail(design: Design, torque: float, omega: float) -> dict[str, str]:
    found = points_within(drive_of(design), torque, omega)
    most = optimal_points(design.machine, 1e4, omega, v_max=LIMIT.v_max)
    (table,) = point_tables(design, found, most, LIMIT, "copper")
    return {row[0]: row[1] for row in table.rows}


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text) if isinstance(text, Text)]


def test_point_in_detail_says_what_it_is_made_of() -> None:
    """100 N m at 300 rad/s is below the base speed: MTPA, copper 3/2 R |i|^2."""
    rows = detail(make_design(), 100.0, 300.0)
    assert rows["held by"] == "nothing: the unlimited optimum"
    assert rows["torque"] == "100 N m"
    assert rows["speed"] == "2865 rpm"
    assert rows["mechanical power"] == "30 kW"
    assert rows["most torque here"] == "206 N m, held by current"
    total = sum(
        float(rows[name].split()[0])
        for name in ("copper loss", "conduction loss", "switching loss")
    )
    assert float(rows["total loss"].split()[0]) == pytest.approx(total, rel=1e-3)
    assert float(rows["efficiency"].split()[0]) == pytest.approx(
        100.0 * 3e4 / (3e4 + total), abs=0.01
    )


def test_point_in_detail_beyond_what_can_be_had_and_without_device() -> None:
    design = replace(make_design(), inverter=Inverter(500.0, 1e5))
    rows = detail(design, 500.0, 700.0)
    assert "(no more)" in rows["torque"]
    assert rows["held by"] == "current and voltage"
    assert "switching loss" not in rows
    standstill = detail(design, 10.0, 0.0)
    assert standstill["efficiency"] == "none"


def test_points_table_has_a_row_per_point_and_the_limit() -> None:
    design = make_design()
    found = points_within(drive_of(design), np.array([0.0, 50.0, 300.0]), 600.0)
    (table,) = points_tables(design, found, replace(LIMIT, margin=0.05), "copper")
    assert [len(row) for row in table.rows] == [len(table.columns)] * 3
    assert "(no more)" in table.rows[2][2]
    assert table.notes[0].endswith("5 % kept free")


def test_envelope_table_shows_even_speeds_and_every_change() -> None:
    machine = replace(SURFACE, psi_pm=0.02)
    figures, edge, chart = solved(machine, 2000.0, replace(LIMIT, v_max=100.0))
    limits, over_speed = envelope_tables(make_design(machine), figures, edge, chart, LIMIT)
    held = [row[-2] for row in over_speed.rows]
    assert list(dict.fromkeys(held)) == ["current", "both", "MTPV"]
    assert [row[0] for row in over_speed.rows][-1] == "19099"
    assert len(over_speed.rows) == 15
    assert ("characteristic current", "20 A (peak)") in limits.rows
    assert ("voltage limit can be kept up to", "any speed") in limits.rows


def test_plain_map_is_json_with_nothing_undefined() -> None:
    figures, edge, chart = solved(IPM, 900.0, LIMIT)
    document = json.loads(
        to_text("mtpa", "x", {"map": plain_map(figures, edge, chart, loci(IPM, 288.0), LIMIT)})
    )
    grid = document["map"]["map"]
    assert np.shape(grid["loss_W"]) == np.shape(grid["efficiency"]) == (20, 25)
    assert grid["efficiency"][0][3] is None
    assert grid["losses"]["conduction_W"] is None
    assert len(grid["points"]["torque_Nm"]) == 500


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("machine", "v_max", "fastest"),
    [
        (IPM, 288.0, 900.0),
        (SURFACE, 100.0, 700.0),
        (INVERSE_SALIENT, 150.0, 1500.0),
        (RELUCTANCE, 300.0, 1500.0),
        (replace(SURFACE, psi_pm=0.02), 100.0, 2000.0),
        (replace(IPM, psi_pm=1e-4, l_q=1e-3), 288.0, 100.0),
    ],
    ids=["ipm", "spm", "inverse", "reluctance", "mtpv", "no weakening"],
)
def test_map_figure_labels_stay_apart_and_inside(
    machine: LinearMachine, v_max: float, fastest: float
) -> None:
    """No two texts inside the axes overlap, and none leaves the figure."""
    figure = plot_operating_map(*solved(machine, fastest, replace(LIMIT, v_max=v_max)))
    figure.draw_without_rendering()
    whole = figure.bbox
    axes = figure.axes[0]
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
    assert len(boxes) >= 2
    for k, box in enumerate(boxes):
        assert box.x0 >= whole.x0
        assert box.x1 <= whole.x1
        assert not any(box.overlaps(other) for other in boxes[k + 1 :])
    assert "<svg" in to_svg(figure)


def test_map_figure_names_the_speeds_where_the_limits_change() -> None:
    shown = texts(
        plot_operating_map(
            *solved(replace(SURFACE, psi_pm=0.02), 2000.0, replace(LIMIT, v_max=100.0))
        )
    )
    assert any(text.startswith("base speed") for text in shown)
    assert any(re.match(r"MTPV from \d+ rpm", text) for text in shown)
    assert "Speed in rpm" in shown
    assert "Torque in N m" in shown


def test_map_without_any_power_is_drawn_all_the_same() -> None:
    figures, edge, chart = solved(IPM, 900.0, LIMIT)
    nothing = replace(chart, efficiency=np.full_like(chart.efficiency, np.nan))
    assert "most torque" in texts(plot_operating_map(figures, edge, nothing))


def test_speed_figure_marks_where_the_field_is_weakened() -> None:
    points = optimal_points(IPM, np.linspace(0.0, 170.0, 50), 628.0, v_max=LIMIT.v_max)
    assert Active.VOLTAGE in points.active
    shown = texts(plot_speed(points, LIMIT))
    assert "field weakening" in shown
    assert "5997 rpm" in shown
    slow = texts(
        plot_speed(optimal_points(IPM, np.linspace(0.0, 170.0, 50), 50.0, v_max=LIMIT.v_max), LIMIT)
    )
    assert "field weakening" not in slow


def test_voltage_limit_is_that_of_the_modulator() -> None:
    assert voltage_limit(Inverter(500.0, 1e4), "spwm", 0.1).v_max == pytest.approx(225.0)


def test_margin_of_the_dead_time() -> None:
    """200 ns at 100 kHz: 4 % of the range of SVPWM, 2 % where a phase rests;
    the field is weakened at lower speeds.
    """
    design = catalogue.load("paper000-ipmsm-100kw")
    for name, left in (("svpwm", 0.96), ("dpwm1", 0.98)):
        asked = Request("5600 rpm", "130 N m", None, name, "dead-time")
        found = answer(design, asked).plain["operating_points"]
        limit = 500.0 / np.sqrt(3.0) * left
        assert found["limit"]["v_max_V"] == pytest.approx(limit)
        assert found["points"]["voltage_V"][0] == pytest.approx(limit, rel=1e-6)
    with pytest.raises(InputError, match="or dead-time"):
        answer(design, replace(asked, margin="deadtime"))
