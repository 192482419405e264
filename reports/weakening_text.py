"""Two-dimensional references in words, alike on the terminal and in the report."""

from __future__ import annotations

from dqforge.machines.quantities import format_quantity
from dqforge.optimizer.surface_fit import WeakeningFit
from dqforge.reports.c_numbers import rounded_up
from dqforge.reports.certificate_text import AGAINST


def percent(value: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(value, 0.0))} %"


def domain_text(fit: WeakeningFit) -> str:
    """Speed, range of the flux linkage, and size in one line."""
    region = fit.region
    return (
        f"up to {format_quantity(fit.settings.omega_m, 'rpm', 4)}, {format_quantity(region.flux_min, 'Wb', 4)} to"
        f" {format_quantity(region.flux_max, 'Wb', 4)}; {fit.step.coefficients} coefficients,"
        f" below {fit.step.flash} B on a Cortex-M4F (estimate)"
    )


def errors_text(fit: WeakeningFit) -> str:
    """The largest errors in one line."""
    errors = fit.errors
    return (
        f"torque {percent(errors.torque_relative)}, voltage +{percent(errors.flux_excess)},"
        f" current +{percent(errors.current_excess)}, copper loss +{percent(errors.loss_relative)}"
    )


def proof_text(fit: WeakeningFit) -> str | None:
    """The proven bounds in one line; None where nothing is proven."""
    proof = fit.certificate
    if proof is None:
        return None
    return (
        f"torque {percent(proof.torque_relative)}, voltage +{percent(proof.flux_excess)},"
        f" current +{percent(proof.current_excess)}, against {AGAINST[proof.model]}"
    )


def error_lines(fit: WeakeningFit) -> list[str]:
    """Proven bounds and sampled errors as lines of at most 110 characters for the comment of the evaluator."""
    errors, proof, most = fit.errors, fit.certificate, f"{fit.region.torque_max:.6g} N m"
    evaluations = f"{errors.samples} evaluations, with and without fused multiply-add"
    loss = (
        f"copper loss is up to {percent(errors.loss_relative)} above the least, from 5 % of the largest torque upwards"
    )
    if proof is None:
        return [
            f"The torque errs by at most {percent(errors.torque_relative)} of the largest one, {most};",
            f"flux linkage (voltage) exceeds the available one by {percent(errors.flux_excess)},",
            f"the current its limit by {percent(errors.current_excess)};",
            f"{loss}",
            f"({evaluations}; sampled, not proven).",
        ]
    torque = f"{percent(proof.torque_relative)} of the largest one, {most} ({percent(errors.torque_relative)})"
    flux = f"{percent(proof.flux_excess)} ({percent(errors.flux_excess)})"
    return [
        f"Bounds of the errors, proven for every torque and flux linkage, against {AGAINST[proof.model]},",
        "rounding included, with and without fused multiply-add; in brackets what was found by sampling:",
        f"the torque errs by at most {rounded_up(proof.torque)} N m, {torque};",
        f"flux linkage (voltage) exceeds the available one by {flux},",
        f"the current its limit by {percent(proof.current_excess)} ({percent(errors.current_excess)}).",
        f"Sampled, not proven: {loss}",
        f"({evaluations}).",
    ]
