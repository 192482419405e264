"""Checks that all readers of device data share: units that were mixed up,
and points that no device has.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dqforge.machines.devices.curves import Curve
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

_KELVIN = 230.0


_COLDEST = -80.0


_LARGEST_CURRENT = 2e4


_RATIO = 50.0


_HIGHEST_DROP = 50.0


# Share of its largest value by which a digitised curve may fall.
_JITTER = 0.05


_SLOWEST = 2e-6


_SLOWEST_HIGH = 1e-5


_HIGH = 1000.0


_LARGEST_RESISTANCE = 20.0


@dataclass(frozen=True, slots=True)
class Place:
    """A part of a device file: what it is called in messages, and its line where one is known."""

    source: str
    path: str
    line: int | None = None

    def fault(self, message: str) -> InputError:
        """Error that names this part."""
        return InputError(
            f"{self.path}: {message}" if self.path else message, source=self.source, line=self.line
        )

    @contextmanager
    def named(self) -> Iterator[None]:
        """Give the place to each `InputError` without one that the block raises."""
        try:
            yield
        except InputError as error:
            if error.source is not None:
                raise
            raise self.fault(error.message) from None


def checked_temperature(value: float, place: Place) -> float:
    """Junction temperature in degC, unless it looks like kelvin."""
    if value > _KELVIN:
        raise place.fault(
            f"{value:g} looks like kelvin; write degrees Celsius, {value - 273.15:.4g}"
        )
    if value < _COLDEST:
        raise place.fault(
            f"{value:g} degC is colder than any junction; write degrees Celsius, such as 25"
        )
    return value


def checked_voltage(value: float, place: Place) -> float:
    """Reference voltage in V of energies."""
    if not 1.0 <= value <= 2e4:
        raise place.fault(
            f"the reference voltage {value:g} V is outside 1 V to 20 kV; write volts, such as 600"
        )
    return value


def _checked_currents(currents: tuple[float, ...], rating: float | None, place: Place) -> None:
    """Refuse currents that look like mA, or like kA."""
    largest = max(currents)
    if largest > _LARGEST_CURRENT or (rating is not None and largest > _RATIO * rating):
        raise place.fault(
            f"currents up to {largest:g} A look like mA; write amperes, {largest / 1e3:g}"
        )
    if rating is not None and 0.0 < largest < rating / (10.0 * _RATIO):
        raise place.fault(
            f"currents up to {largest:g} A look like kA for a device of {rating:g} A; write amperes"
        )


def checked_energies(
    currents: tuple[float, ...],
    energies: tuple[float, ...],
    voltage: float,
    rating: float | None,
    place: Place,
) -> Curve:
    """Curve of energies in J over currents in A, at a voltage in V.

    `rating` is the current of the device, or None.
    """
    for k, energy in enumerate(energies):
        if energy < 0.0:
            raise place.fault(
                f"energy {k} is negative, {energy:g} J; write what the device loses, as a positive "
                "number"
            )
    with place.named():
        curve = Curve(currents, energies)
    _checked_currents(currents, rating, place)
    # Switching takes nanoseconds to a few microseconds: E = v i t / 2 and the like.
    time = energies[-1] / (voltage * currents[-1]) if currents[-1] > 0.0 else 0.0
    limit = _SLOWEST if voltage <= _HIGH else _SLOWEST_HIGH
    if time > limit:
        unit, factor = ("mJ", 1e-3) if time * 1e-3 <= limit else ("uJ", 1e-6)
        raise place.fault(
            f"{energies[-1]:g} J at {currents[-1]:g} A and {voltage:g} V look like {unit}; "
            f"write joules, {energies[-1] * factor:g}"
        )
    return curve


def checked_drop(
    currents: tuple[float, ...], drops: tuple[float, ...], rating: float | None, place: Place
) -> Curve:
    """Curve of on-state voltages in V over currents in A.

    `rating` is the current of the device, or None.
    """
    with place.named():
        curve = Curve(currents, drops)
    _checked_currents(currents, rating, place)
    if max(drops) > _HIGHEST_DROP:
        raise place.fault(
            f"a drop of {max(drops):g} V looks like mV; write volts, {max(drops) / 1e3:g}"
        )
    highest = 0.0
    for k, drop in enumerate(drops):
        if drop < highest - _JITTER * max(drops):
            raise place.fault(
                f"the drop {k} falls to {drop:g} V from {highest:g} V while the current rises to "
                f"{currents[k]:g} A; write the points of one curve in ascending order"
            )
        highest = max(highest, drop)
    return curve


def checked_thermal(resistance: float, place: Place) -> float:
    """Thermal resistance of an element in K/W."""
    if not 0.0 < resistance <= _LARGEST_RESISTANCE:
        message = (
            f"{resistance:g} K/W is no resistance of a power device to its case; write K/W, such "
            "as 0.1"
        )
        raise place.fault(message)
    return resistance
