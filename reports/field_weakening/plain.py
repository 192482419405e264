"""The field-weakening reference as plain data."""

from __future__ import annotations

from dataclasses import asdict

from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.reports.pages.certificate_text import plain_certificate
from dqforge.reports.plain_data import PlainData


def plain_weakening_fit(fit: WeakeningFit | None) -> PlainData | None:
    """Domain, errors and trials of the two-dimensional reference."""
    if fit is None:
        return None
    region = fit.region
    return {
        "omega_m_rad_per_s": fit.settings.omega_m,
        "flux_min_Wb": region.flux_min,
        "flux_max_Wb": region.flux_max,
        "torque_max_Nm": region.torque_max,
        "v_max_V": fit.domain.v_max,
        "omega_e_rad_per_s": fit.domain.omega_e,
        "v_least_V": fit.domain.voltages[0],
        "voltages_V": list(fit.domain.voltages),
        "voltage_drop_V": fit.domain.largest_drop,
        "torque_error_Nm": fit.largest_torque_error,
        "r_s_Ohm": fit.domain.machine.r_s,
        "coefficients": fit.step.coefficients,
        "flash_B": fit.step.flash,
        "errors": asdict(fit.errors),
        "voltage_errors": asdict(fit.voltage),
        "certificate": plain_certificate(fit.certificate),
        "trials": [asdict(trial) for trial in fit.trials],
    }
