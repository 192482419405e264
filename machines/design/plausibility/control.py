"""Figures of sampling, loops, observer and bases, see
`dqforge.machines.design.plausibility.design`.
"""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.design.plausibility.figures import Figure
from dqforge.machines.design.plausibility.scale import Scale
from dqforge.machines.design.settings import ToleranceName

_TURN = 2.0 * math.pi


def control_figures(design: Design, scale: Scale) -> list[Figure]:
    """Figures of the controllers and of what they are told."""
    return [
        *_current_loop(design),
        *_speed_loop(design),
        *_observer(design),
        *_bases(design, scale),
        *_tolerances(design),
        *_operation(design, scale),
    ]


def _current_loop(design: Design) -> list[Figure]:
    control, machine = design.control, design.machine
    loop, least = control.current_loop, min(machine.l_d, machine.l_q)
    figures = [
        Figure(
            "control.sampling_frequency",
            "the sampling period over the time constant of the winding",
            control.t_s * machine.r_s / least,
            "",
            0.0,
            1.0,
        )
    ]
    if loop.bandwidth is not None:
        share, what = loop.bandwidth * control.t_s / _TURN, "its share of the sampling frequency"
        figures.append(Figure("control.current_loop.bandwidth", what, share, "%", 5e-4, 0.25))
    if loop.kp is not None and loop.ki is not None:
        key, what = "control.current_loop.kp", "kp times the sampling period over the inductance"
        figures.append(Figure(key, what, loop.kp * control.t_s / least, "", 1e-3, 2.0))
        key, what = (
            "control.current_loop.ki",
            "the integral time kp/ki over the time constant of the winding",
        )
        if loop.ki > 0.0:
            figures.append(
                Figure(key, what, loop.kp / loop.ki * machine.r_s / least, "", 1e-2, 1e2)
            )
    return figures


def _speed_loop(design: Design) -> list[Figure]:
    control, loop = design.control, design.control.speed_loop
    if loop is None:
        return []
    sampling = 1.0 / (control.t_s * loop.ratio)
    figures = [
        Figure(
            "control.speed_loop.ratio",
            "the sampling frequency of the speed",
            sampling,
            "Hz",
            50.0,
            100e3,
        ),
        Figure("control.speed_loop.filter_time", "the time", loop.filter_time, "s", 0.0, 0.1),
    ]
    if loop.bandwidth is not None:
        key, share = "control.speed_loop.bandwidth", loop.bandwidth / (_TURN * sampling)
        figures.append(
            Figure(key, "its share of the sampling frequency of the speed", share, "%", 1e-4, 0.25)
        )
        if control.current_loop.bandwidth is not None:
            share = loop.bandwidth / control.current_loop.bandwidth
            figures.append(Figure(key, "its share of the current loop's", share, "%", 0.0, 0.5))
    return figures


def _observer(design: Design) -> list[Figure]:
    observer, figures = design.control.observer, []
    if observer is None:
        return []
    for name in ("pole", "bandwidth", "pll_bandwidth"):
        value = getattr(observer, name)
        if value is not None:
            key, what = f"control.observer.{name}", "the angular frequency"
            figures.append(Figure(key, what, value, "rad/s", 1.0, math.inf))
            share, what = value * design.control.t_s / _TURN, "its share of the sampling frequency"
            figures.append(Figure(key, what, share, "%", 0.0, 0.25))
    return figures


def _bases(design: Design, scale: Scale) -> list[Figure]:
    bases = design.control.bases
    speed = scale.base_speed if scale.top_speed is None else scale.top_speed
    return [
        Figure(
            "control.per_unit.current",
            "its ratio to the current limit",
            bases.current / scale.current,
            "",
            0.2,
            20.0,
        ),
        Figure(
            "control.per_unit.voltage",
            "its ratio to v_dc/sqrt(3)",
            bases.voltage / scale.voltage,
            "",
            0.2,
            20.0,
        ),
        Figure(
            "control.per_unit.speed",
            "its ratio to the largest speed",
            bases.speed / speed,
            "",
            0.05,
            50.0,
        ),
        Figure(
            "control.per_unit.torque",
            "its ratio to the largest torque",
            bases.torque / scale.torque,
            "",
            5e-3,
            50.0,
        ),
    ]


_LARGEST_DEVIATIONS: tuple[tuple[ToleranceName, float], ...] = (
    ("r_s", 0.7),
    ("l_d", 0.7),
    ("l_q", 0.7),
    ("psi_pm", 0.4),
    ("inertia", 0.8),
    ("v_dc", 0.5),
)


def _tolerances(design: Design) -> list[Figure]:
    box, figures = design.control.tolerances, []
    if box is None:
        return []
    for name, most in _LARGEST_DEVIATIONS:
        deviation = max(map(abs, box.limits(name)))
        figures.append(
            Figure(f"control.tolerances.{name}", "the deviation", deviation, "%", 0.0, most)
        )
    if design.inverter.dead_time > 0.0:
        share = max(map(abs, box.limits("dead_time"))) / design.inverter.dead_time
        figures.append(
            Figure(
                "control.tolerances.dead_time", "its share of the dead time", share, "%", 0.0, 1.0
            )
        )
    return figures


def _operation(design: Design, scale: Scale) -> list[Figure]:
    operation, fit, weakening = design.operation, design.fit, design.weakening
    figures = [
        Figure(
            "operation.voltage_margin",
            "the share kept free",
            operation.voltage_margin,
            "%",
            0.0,
            0.3,
        )
    ]
    if operation.omega_m is not None:
        ratio = operation.omega_m / scale.base_speed
        figures.append(
            Figure("operation.speed", "its ratio to the base speed", ratio, "", 0.05, 20.0)
        )
    if fit.torque_max is not None:
        share = fit.torque_max / scale.torque
        figures.append(
            Figure("fit.max_torque", "its share of the largest torque", share, "%", 0.05, 1.01)
        )
    if fit.budget is not None:
        for name in ("torque_error", "loss_penalty"):
            value = getattr(fit.budget, name)
            if value is not None:
                figures.append(Figure(f"fit.{name}", "the permitted error", value, "%", 1e-7, 0.1))
    if weakening is not None:
        ratio = weakening.omega_m / scale.base_speed
        figures += [
            Figure("field_weakening.speed", "its ratio to the base speed", ratio, "", 0.05, 20.0),
            Figure(
                "field_weakening.torque_error",
                "the permitted error",
                weakening.torque_error,
                "%",
                1e-6,
                0.1,
            ),
            Figure(
                "field_weakening.voltage_excess",
                "the permitted excess",
                weakening.voltage_excess,
                "%",
                1e-6,
                0.1,
            ),
        ]
    return figures
