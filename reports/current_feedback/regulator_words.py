"""Current-feedback PWM in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.current_feedback.regulator_numbers import RegulatorPlan
    from dqforge.optimizer.current_feedback.regulator_runs import RegulatorRun
    from dqforge.optimizer.current_feedback.solve import CurrentFeedback

ASSUMED = (
    "At constant speed with an ideal bridge: no dead time, no delay of comparators. Sampled "
    "regulators have their computing time of one sample and the numbers of the emitted C."
)

BESIDE = (
    "Modulators are at the mean switching frequency of the chosen regulator, with the currents "
    "that make the torque; a regulator whose mean current is off makes another torque with other "
    "losses."
)

SPEED_LOOP = (
    "The speed loop takes the regulator as a first-order lag; what it makes of errors of the mean "
    "current is left to its integral."
)

NOT_EMITTED = {
    "hysteresis": (
        "Analog comparators: each leg goes down where its current exceeds the reference by the "
        "band, up where it falls short of it by the band; the references are the user's DAC."
    ),
    "ramp-comparison": (
        "Analog regulators and comparators: v = kp e + ki integral(e) in rotor coordinates, back "
        "to phases; a leg is up while v exceeds the triangle."
    ),
    "trajectory": (
        "The edges of the pattern are the user's timers; each sample moves the next edge of a leg "
        "by the flux error over v_dc, later for an edge up with too much current."
    ),
}


def _number(value: float, unit: str) -> str:
    return format_quantity(value, unit, 4)


def setting_rows(plan: RegulatorPlan) -> list[tuple[str, str]]:
    """What a regulator has instead of gains and margins."""
    band = ("band", f"{_number(plan.band, 'A')} to either side")
    sampling = ("sampling", f"{_number(1.0 / plan.t_s, 'Hz')}, {_number(plan.t_s, 's')}")
    rows = {
        "hysteresis": [band],
        "ramp-comparison": [
            ("kp, ki", f"{plan.kp:.4g} V/A, {plan.ki:.4g} V/(A s)"),
            ("carrier", _number(plan.carrier, "Hz")),
            ("comparator band", f"{plan.comparator_band:.4g} V"),
        ],
        "look-up-table": [
            band,
            ("outer band", f"{_number(plan.outer_band, 'A')}: a transient beyond it"),
            sampling,
        ],
        "circle": [("radius", _number(plan.band, "A")), sampling],
        "predictive": [sampling],
        "trajectory": [("most pulses", f"{plan.pulses} per electrical period"), sampling],
    }
    return [("regulator", plan.method), *rows[plan.method]]


def _range(low: float, high: float, unit: str) -> str:
    first, last = _number(low, unit), _number(high, unit)
    return first if first == last else f"{first} to {last}"


def run_rows(run: RegulatorRun) -> list[tuple[str, str]]:
    """Ranges of what a regulator does over speed."""
    known = [k for k, text in enumerate(run.obstacles) if not text]
    if not known:
        return [("not possible", run.obstacles[0])]

    def ends(values: FloatArray, unit: str) -> str:
        numbers = [float(values[k]) for k in known]
        return _range(min(numbers), max(numbers), unit)

    rows = [
        ("switching frequency", f"{ends(run.frequency, 'Hz')} on average over speed"),
        ("error", f"{ends(run.rms_error, 'A')} r.m.s., {ends(run.largest_error, 'A')} at most"),
    ]
    distortion = [100.0 * float(run.distortion[k]) for k in known]
    return [*rows, ("distortion", f"{min(distortion):.3g} to {max(distortion):.3g} %")]


def speed_rows(found: CurrentFeedback) -> list[tuple[str, str]]:
    """The speed loop over the regulator."""
    if found.speed is None or found.equivalent is None:
        return []
    speed, lag = found.speed, found.equivalent
    margin = math.degrees(speed.margins.phase_margin)
    return [
        (
            "current loop as the speed loop sees it",
            f"lag of {_number(lag.bandwidth, 'rad/s')} (delay {_number(lag.delay, 's')})",
        ),
        ("speed kp, ki", f"{speed.kp:.4g} N m s/rad, {speed.ki:.4g} N m/rad"),
        (
            "speed loop",
            f"crossover {_number(speed.margins.crossover, 'rad/s')}, phase margin {margin:.3g} deg",
        ),
    ]


def emitted_lines(design: Design, found: CurrentFeedback) -> list[str]:
    """What the header says of itself."""
    plan = found.plan
    lines = [f"{label}: {text}." for label, text in (*setting_rows(plan)[1:], *run_rows(found.run))]
    if plan.method in NOT_EMITTED:
        lines = [*lines, "", NOT_EMITTED[plan.method]]
        if plan.method == "hysteresis" and design.inverter.current_sensing is None:
            lines.append("Codes of a DAC need inverter.current_sensing in the design.")
        return lines
    return [
        *lines,
        "",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
        "The function knows the state that is on now and names that of the next period; it",
        "predicts the currents at the next sample, so that the computing time is part of it.",
        "Not-a-number keeps the present state.",
    ]
