"""Figures of points, simulation, waveform and choice of modulator, see
`dqforge.machines.design.plausibility.design`.
"""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.design.plausibility.figures import Figure
from dqforge.machines.design.plausibility.scale import Scale


def scenario_figures(design: Design, scale: Scale) -> list[Figure]:
    """Figures of what the drive is asked to do."""
    return [
        *_points(design, scale),
        *_simulation(design, scale),
        *_waveform(design, scale),
        *_choice(design, scale),
    ]


def _points(design: Design, scale: Scale) -> list[Figure]:
    figures = []
    for index, point in enumerate(() if design.losses is None else design.losses.points):
        share, what = abs(point.torque) / scale.torque, "its share of the largest torque"
        figures.append(Figure(f"losses.points[{index}].torque", what, share, "%", 0.0, 1.01))
        power, what = (
            abs(point.torque * point.omega_m) / scale.power,
            "torque times speed over the apparent power",
        )
        figures.append(Figure(f"losses.points[{index}].speed", what, power, "%", 0.0, 1.2))
    return figures


def _simulation(design: Design, scale: Scale) -> list[Figure]:
    scenario = design.simulation
    if scenario is None:
        return []
    sensor = scenario.sensor
    figures = [
        Figure(
            "simulation.duration",
            "the number of control periods",
            scenario.duration / design.control.t_s,
            "",
            10.0,
            2e7,
        ),
        Figure(
            "simulation.current_sensor.noise",
            "its share of the current limit",
            sensor.noise / scale.current,
            "%",
            0.0,
            0.1,
        ),
        Figure(
            "simulation.current_sensor.offset",
            "the largest share of the current limit",
            max(map(abs, sensor.offset)) / scale.current,
            "%",
            0.0,
            0.2,
        ),
    ]
    if sensor.bits > 0:
        ratio, what = sensor.full_scale / scale.current, "its ratio to the current limit"
        figures.append(Figure("simulation.current_sensor.full_scale", what, ratio, "", 0.8, 20.0))
    if scenario.dead_time is not None:
        share, what = scenario.dead_time * design.inverter.f_sw, "its share of the switching period"
        figures.append(Figure("simulation.dead_time", what, share, "%", 0.0, 0.1))
    speed = scale.base_speed if scale.top_speed is None else scale.top_speed
    start = abs(scenario.omega_m) / speed
    figures.append(
        Figure("simulation.initial.speed", "its ratio to the largest speed", start, "", 0.0, 2.0)
    )
    return figures


def _waveform(design: Design, scale: Scale) -> list[Figure]:
    settings, figures = design.waveform, []
    if settings.torque is not None:
        share, what = (
            settings.torque / scale.torque,
            "its ratio to the largest torque of the fundamental",
        )
        figures.append(Figure("waveform.torque", what, share, "", 1e-3, 2.0))
    figures.append(
        Figure("waveform.ripple", "the permitted ripple", settings.ripple, "%", 0.0, 0.5)
    )
    return figures


def _choice(design: Design, scale: Scale) -> list[Figure]:
    choice = design.modulation_choice
    if choice is None:
        return []
    figures = [
        Figure(
            "modulation_choice.max_frequency", "the frequency", choice.f_max, "Hz", 500.0, 500e3
        ),
        Figure(
            "modulation_choice.speed",
            "its ratio to the base speed",
            choice.omega_m / scale.base_speed,
            "",
            0.05,
            20.0,
        ),
    ]
    if choice.junction_max is not None:
        margin = choice.junction_max - design.inverter.coolant_temperature
        what = "what it leaves above the coolant"
        figures.append(
            Figure("modulation_choice.max_junction_temperature", what, margin, "K", 5.0, math.inf)
        )
    if choice.ripple_max is not None:
        share, what = choice.ripple_max / scale.current, "its share of the current limit"
        figures.append(Figure("modulation_choice.ripple_current", what, share, "%", 1e-4, 0.7))
    return figures
