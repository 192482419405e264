"""What in a motor block of TI's lab does not fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.configuration import DriveValues, OwnValue
from dqforge.optimizer.firmware.ti_format.ti_keys import number

# Share of the measured range above which the lab lets no over-current threshold go.
TRIP_SHARE = 0.475

# Inertia in kg m^2 of the Teknic M2310 in TI's file, which other blocks repeat.
TEKNIC_INERTIA = 7.06154e-6
_TOLERANCE = 0.05


def contradictions(name: str, own: Mapping[str, OwnValue], drive: DriveValues) -> tuple[str, ...]:
    """Sentences on values that do not fit together, with both numbers.

    Args:
        name: Name of the motor.
        own: Values by macro.
        drive: What they amount to.
    """
    return (*_voltage(own), *_currents(own), *_speeds(own, drive), *_copied(name, drive))


def _voltage(own: Mapping[str, OwnValue]) -> Iterator[str]:
    flux, most = number(own, "RATED_FLUX_VpHz"), number(own, "FREQ_MAX_Hz")
    rated = number(own, "RATED_VOLTAGE_V")
    if not flux or not most or not rated:
        return
    emf, available = flux * most, rated / math.sqrt(3.0)
    if emf > available:
        yield (
            f"at FREQ_MAX_Hz {most:g} Hz the magnets of RATED_FLUX_VpHz {flux:g} V/Hz induce "
            f"{emf:.4g} V (peak of phase), RATED_VOLTAGE_V {rated:g} V gives {available:.4g} V: "
            f"without field weakening the speed ends at {available / flux:.4g} Hz"
        )


def _currents(own: Mapping[str, OwnValue]) -> Iterator[str]:
    most, trip = number(own, "MAX_CURRENT_A"), number(own, "OVER_CURRENT_A")
    scale = number(own, "M1_ADC_FULL_SCALE_CURRENT_A")
    if most and trip and trip < most:
        yield f"OVER_CURRENT_A {trip:g} A trips below the permitted MAX_CURRENT_A {most:g} A"
    if most and scale and most > TRIP_SHARE * scale:
        yield (
            f"MAX_CURRENT_A {most:g} A is above {TRIP_SHARE * scale:.4g} A, the 47.5 % of "
            f"ADC_FULL_SCALE_CURRENT_A {scale:g} A at which the lab trips at the latest"
        )


def _speeds(own: Mapping[str, OwnValue], drive: DriveValues) -> Iterator[str]:
    rated, most = number(own, "RATED_SPEED_KRPM"), number(own, "FREQ_MAX_Hz")
    if rated and most and drive.pole_pairs:
        needed = 1e3 * rated / 60.0 * drive.pole_pairs
        if needed > most * (1.0 + _TOLERANCE):
            yield (
                f"RATED_SPEED_KRPM {rated:g} is {needed:.4g} Hz with {drive.pole_pairs} pole "
                f"pairs, above FREQ_MAX_Hz {most:g} Hz"
            )


def _copied(name: str, drive: DriveValues) -> Iterator[str]:
    if drive.inertia is None or "teknic" in name.lower():
        return
    if math.isclose(drive.inertia, TEKNIC_INERTIA, rel_tol=1e-6):
        yield (
            f"INERTIA_Kgm2 {drive.inertia:g} is that of the Teknic M2310 in TI's file, which "
            f"other blocks repeat: the gain of the speed loop is proportional to it"
        )
