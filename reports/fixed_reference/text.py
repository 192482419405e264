"""Current references in fixed point in words, for the header, the terminal and the report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.reports.c_code.numbers import rounded_up

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit


def percent(share: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(share, 0.0))} %"


def size_words(fit: FixedReferenceFit) -> str:
    """Cells and bytes of the tables."""
    mesh = fit.reference
    across = f" x {mesh.columns - 1}" if mesh.voltage is not None else ""
    cells = "cell" if (mesh.rows, across) == (1, "") else "cells"
    return f"{mesh.rows}{across} {cells}, {mesh.table_bytes} B of tables"


def error_words(fit: FixedReferenceFit) -> str:
    """The largest errors in one line."""
    errors = fit.errors
    over = errors.voltage_excess
    voltage = "" if over is None else f", voltage +{percent(over)}"
    return (
        f"torque {percent(errors.torque_relative)}{voltage}, current "
        f"+{percent(errors.current_excess)}, copper loss +{percent(errors.loss_relative)}"
    )


def preamble_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What the header is, as lines of a comment."""
    mesh, fullest = fit.reference, fit.fullest
    current, voltage, speed, torque = mesh.bases
    bits = mesh.width
    link = "; the dc link is not looked at."
    if mesh.voltage is not None:
        full = voltage * mesh.voltage.limit.value / (design.v_max / design.inverter.v_dc)
        link = f", {full:.6g} V of the dc link."
    return [
        f"Codes are int{bits}_t, 2^{bits - 1} of them full scale: {torque:.6g} N m of torque,",
        f"{current:.6g} A (peak) of current, {speed:.6g} rad/s of mechanical speed{link}",
        f"{size_words(fit)}. Plain C99 and C++11 in integers, no library function.",
        (
            f"No overflow for any codes: {len(fit.reaches)} products and sums proven by interval "
            "analysis;"
        ),
        f"the fullest, '{fullest.name}', reaches {fullest.share:.4%} of int{2 * bits}_t.",
    ]


def meaning_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What goes in, what comes out and what it errs by, as lines of a comment."""
    mesh, errors = fit.reference, fit.errors
    lines = [
        f"torque: either sign, held to +-{mesh.end_torque:.6g} N m; i_q has its sign.",
        "Between exact operating points the currents are linear.",
    ]
    if mesh.voltage is not None:
        lines += _voltage_lines(design, fit)
    else:
        lines.append("v_dc and omega_m are not looked at.")
    lines += [
        "",
        f"Errors against exact operating points, sampled at {errors.samples} points:",
        (
            f"torque at most {rounded_up(errors.torque)} N m, {percent(errors.torque_relative)} of "
            f"the largest; currents at most {rounded_up(errors.current)} A away;"
        ),
        f"copper loss at most {percent(errors.loss_relative)} above the least, from 5 % torque up.",
        (
            f"Proven: the current exceeds its limit of {design.i_max:.6g} A by at most "
            f"{percent(fit.proven.current)}."
        ),
    ]
    return lines


def _voltage_lines(design: Design, fit: FixedReferenceFit) -> list[str]:
    """What holds where the field is weakened."""
    over, speed = fit.errors.voltage_excess, fit.speed
    assert over is not None
    assert speed is not None
    share = design.v_max / design.inverter.v_dc
    what = "The phase voltage, resistance drop included, exceeds that by"
    kept = [f"{what} {percent(over)} (sampled)."]
    if fit.proven.voltage is not None:
        kept = [
            f"{what} at most {percent(fit.proven.voltage)}: proven",
            (
                f"from {100.0 * LEAST_VOLTAGE:g} % of the dc link up, for speeds in proportion to "
                f"it ({percent(over)} found by sampling)."
            ),
        ]
    return [
        f"v_dc: of it {share:.6g} is the largest phase amplitude. omega_m: either sign.",
        (
            f"Made up to {format_quantity(speed, 'rpm', 5)} at {design.inverter.v_dc:.6g} V; at "
            "other voltages in proportion. The torque is"
        ),
        "reduced where it cannot be had, beyond the largest speed down to none.",
        *kept,
        f"The phase resistance is {design.machine.r_s:.6g} Ohm in what follows: take it warm.",
    ]
