"""What a current reference over torque and flux linkage needs to know of the resistance drop."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.settings import WeakeningSettings
from dqforge.optimizer.field_weakening.drop_reference import DropReference
from dqforge.optimizer.field_weakening.form import WeakeningReference
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE, VoltageRegion
from dqforge.optimizer.linear_programme import least_cost

# Share of the permitted voltage excess up to which a bound of the current stands for the current
# itself.
_NEGLIGIBLE = 0.1
_LEVELS = 201

# Share of the squared current limit by which the emitted currents may lie above the exact ones.
_MARGIN = 0.003

# Share of the squared current limit below which it is worth saying that MTPV takes less than the
# limit.
_WORTH = 0.97


def _single_above(value: float) -> np.float32:
    """The least float that is not below a number."""
    found = np.float32(value)
    return found if float(found) >= value else np.nextafter(found, np.float32(np.inf))


def _near_mtpv(region: VoltageRegion) -> tuple[float, float] | None:
    """(c, e): |i|^2 <= c + e a^2 at the largest torque of every flux linkage a at which the
    current is not the limit.

    The line lies as low as it can (a linear programme). None where the
    current limit holds everywhere.
    """
    flux, square = region.flux, region.flux.i_max**2
    levels = np.linspace(flux.flux_min, flux.flux_max, _LEVELS)
    points = flux.points(np.full(_LEVELS, 2.0 * flux.torque_max), levels)
    used = (points.i_d**2 + points.i_q**2) / square
    below = used < 1.0 - 1e-6
    if not np.any(used < _WORTH):
        return None
    argument, target = (levels[below] / flux.flux_max) ** 2, used[below] + _MARGIN
    rows = np.column_stack([np.ones(argument.size), argument])
    found = least_cost(rows.sum(axis=0), -rows, -target, bounds=(0.0, np.inf))
    if found is None:
        return None
    constant, slope = (float(part) * square for part in found)
    return constant, slope / flux.flux_max**2


def with_drop(
    region: VoltageRegion, surface: WeakeningReference, settings: WeakeningSettings
) -> DropReference:
    """The whole step about a surface: what the resistance takes of the voltage,
    bounded and then evaluated.
    """
    r_s, i_max = region.machine.r_s, region.flux.i_max
    share = (r_s * i_max / (LEAST_VOLTAGE * region.v_max)) ** 2
    passes = 1 if 0.5 * share <= _NEGLIGIBLE * settings.voltage_excess else 2
    near = _near_mtpv(region) if passes > 1 else None
    return DropReference(
        surface=surface,
        torque_max=np.float32(region.flux.torque_max),
        per_torque=np.float32(region.per_torque),
        square=np.float32(r_s**2),
        reserve=_single_above((r_s * i_max) ** 2),
        near=None
        if near is None
        else (_single_above(near[0] * r_s**2), _single_above(near[1] * r_s**2)),
        passes=passes,
    )
