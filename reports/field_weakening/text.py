"""Two-dimensional references in words, alike on the terminal and in the report."""

from __future__ import annotations

from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.pages.certificate_text import AGAINST


def percent(value: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(value, 0.0))} %"


def domain_text(fit: WeakeningFit) -> str:
    """Speed, voltage, range of the flux linkage, and size in one line."""
    region, domain = fit.region, fit.domain
    return (
        f"up to {format_quantity(fit.settings.omega_m, 'rpm', 4)} at "
        f"{format_quantity(domain.v_max, 'V', 4)}, of which the resistance takes up to "
        f"{format_quantity(domain.largest_drop, 'V', 3)}; "
        f"{format_quantity(region.flux_min, 'Wb', 4)} to "
        f"{format_quantity(region.flux_max, 'Wb', 4)}; {fit.step.coefficients} constants, below "
        f"{fit.step.flash} B on a Cortex-M4F (estimate)"
    )


def least_voltage_text(fit: WeakeningFit) -> str:
    """The least voltage for which errors are stated."""
    return f"{100.0 * LEAST_VOLTAGE:g} % of {format_quantity(fit.domain.v_max, 'V', 4)}"


def errors_text(fit: WeakeningFit) -> str:
    """The largest errors in one line."""
    return (
        f"torque {percent(_torque(fit))}, voltage +{percent(fit.voltage.voltage_excess)},"
        f" current +{percent(fit.largest_current_excess)}, copper loss "
        f"+{percent(fit.voltage.loss_relative)}, from {least_voltage_text(fit)} up"
    )


def nominal_text(fit: WeakeningFit) -> str:
    """What of the errors falls on the design's voltage itself, and what beyond reach is missed."""
    voltage = fit.voltage
    return (
        f"beyond reach at most {percent(voltage.missed)} of what is available is missed; at "
        f"{format_quantity(fit.domain.v_max, 'V', 4)} itself torque "
        f"{percent(voltage.torque_nominal / fit.region.torque_max)}, copper loss "
        f"+{percent(voltage.loss_nominal)}"
    )


def _torque(fit: WeakeningFit) -> float:
    """Largest sampled error of the torque over the largest torque."""
    return fit.largest_torque_error / fit.region.torque_max


def proof_text(fit: WeakeningFit) -> str | None:
    """The proven bounds in one line; None where nothing is proven."""
    proof = fit.certificate
    if proof is None:
        return None
    volts = (
        "voltage not bounded"
        if proof.voltage_excess is None
        else f"voltage +{percent(proof.voltage_excess)}"
    )
    return (
        f"torque {percent(proof.torque_relative)} of what is granted, {volts},"
        f" current +{percent(proof.current_excess)}, from {least_voltage_text(fit)} up, against "
        f"{AGAINST[proof.model]}"
    )


def _sampled_lines(fit: WeakeningFit) -> list[str]:
    """What no bound covers."""
    voltage, volts = fit.voltage, f"{fit.domain.v_max:.6g} V"
    shares = [f"{part / fit.domain.v_max:.3g}" for part in fit.domain.voltages]
    nominal = percent(voltage.torque_nominal / fit.region.torque_max)
    return [
        (
            f"torque beyond reach is granted to within {percent(_torque(fit))} of the largest one, "
            f"and to within {percent(voltage.missed)}"
        ),
        f"of what voltage, speed and current leave of it ({nominal} of the largest at {volts}),",
        (
            f"copper loss is up to {percent(voltage.loss_relative)} above the least "
            f"({percent(voltage.loss_nominal)} at {volts}), from 5 % of the largest torque"
        ),
        (
            f"up: {fit.errors.samples + voltage.samples} evaluations, with and without fused "
            "multiply-add, at"
        ),
        f"{', '.join(shares[:-1])} and {shares[-1]} times {volts}, motoring and generating.",
    ]


def error_lines(fit: WeakeningFit) -> list[str]:
    """Proven bounds and sampled errors as lines of at most 110 characters for the
    comment of the evaluator.
    """
    errors, proof, most = fit.errors, fit.certificate, f"{fit.region.torque_max:.6g} N m"
    volts, current = percent(fit.voltage.voltage_excess), percent(fit.largest_current_excess)
    reach = f"voltages from {least_voltage_text(fit)} up, motoring and generating"
    if proof is None:
        return [
            f"Sampled, not proven, for {reach}:",
            f"the torque errs by at most {percent(_torque(fit))} of the largest one, {most};",
            f"the phase voltage, resistance drop included, exceeds its limit by {volts},",
            f"the current its limit by {current};",
            *_sampled_lines(fit),
        ]
    torque = (
        f"{percent(proof.torque_relative)} of the largest one, {most} "
        f"({percent(errors.torque_relative)})"
    )
    bound = "no proven bound" if proof.voltage_excess is None else percent(proof.voltage_excess)
    return [
        (
            "Bounds of the errors, proven for every torque and speed up to the largest, against "
            f"{AGAINST[proof.model]},"
        ),
        f"for {reach};",
        (
            "rounding included, with and without fused multiply-add; in brackets what was found by "
            "sampling:"
        ),
        f"the phase voltage, resistance drop included, exceeds its limit by {bound} ({volts}),",
        f"the current its limit by {percent(proof.current_excess)} ({current}),",
        f"the torque that is granted errs by at most {rounded_up(proof.torque)} N m, {torque}.",
        "Sampled, not proven:",
        *_sampled_lines(fit),
    ]
