"""Two-dimensional references in words, alike on the terminal and in the report."""

from __future__ import annotations

from dqforge.machines.quantities import format_quantity
from dqforge.optimizer.surface_fit import WeakeningFit
from dqforge.reports.c_numbers import rounded_up


def percent(value: float) -> str:
    """A share in percent, rounded up, at least 0."""
    return f"{rounded_up(100.0 * max(value, 0.0))} %"


def domain_text(fit: WeakeningFit) -> str:
    """Speed, range of the flux linkage, and size in one line."""
    region = fit.region
    return (
        f"up to {format_quantity(fit.settings.omega_m, 'rpm', 4)}, {format_quantity(region.flux_min, 'Wb', 4)} to"
        f" {format_quantity(region.flux_max, 'Wb', 4)}; {fit.reference.coefficients} coefficients,"
        f" below {fit.reference.flash} B on a Cortex-M4F (estimate)"
    )


def errors_text(fit: WeakeningFit) -> str:
    """The largest errors in one line."""
    errors = fit.errors
    return (
        f"torque {percent(errors.torque_relative)}, voltage +{percent(errors.flux_excess)},"
        f" current +{percent(errors.current_excess)}, copper loss +{percent(errors.loss_relative)}"
    )
