"""Figures of a design that are held against what drives usually have,
and the sentences on those that are not.
"""

from __future__ import annotations

import math

from dqforge.machines.devices.inverter import DeviceKind, DeviceModel, Inverter, SwitchDevice
from dqforge.machines.devices.thermal_network import CauerNetwork, ThermalNetwork
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

MARK = "implausible: "  # How every sentence on an implausible figure begins.


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure that follows from the design, and the range in which it usually lies.

    ``key`` is the entry of the design file that most likely is wrong where it does not, ``what``
    says what the figure is, ``value``, ``low`` and ``high`` are in SI units, printed in ``unit``
    (empty: a plain number; ``%``: a share).
    """

    key: str
    what: str
    value: float
    unit: str
    low: float
    high: float

    @property
    def is_usual(self) -> bool:
        """Whether the figure lies in its range; ends included."""
        return self.low <= self.value <= self.high

    def sentence(self) -> str:
        """What to say of a figure outside its range."""
        low, high, value = (
            format_quantity(part, self.unit, 3) for part in (self.low, self.high, self.value)
        )
        if self.low == -math.inf or (self.low == 0.0 and self.value > self.high):
            usual = f"at most {high}"
        elif self.high == math.inf:
            usual = f"at least {low}"
        else:
            usual = f"{low} to {high}"
        return (
            f"{MARK}{self.key}: {self.what} is {value}, usual is {usual}; check the value and its "
            "unit"
        )


def sentences(figures: list[Figure]) -> list[str]:
    """One sentence for each figure outside its range, in order."""
    return [figure.sentence() for figure in figures if not figure.is_usual]


# Device data held against what devices of their voltage and current have, and against each other.
#
# The figures are chosen so that a factor of ten in any entry shows in one of them: switching energy
# over voltage and current is a time, drop times current times thermal resistance a temperature
# rise, ratios are free of the size. Ranges and reasons: docs/methods/devices.md.

_WARM = 100.0  # Junction temperature in degC at which tables are looked at.

# Voltage in V of the energies below which a MOSFET is of the trench kind, with faster edges and
# small drops.
_LOW_VOLTAGE = 200.0


@dataclass(frozen=True, slots=True)
class _Point:
    """A device in V, A and J: drops at ``current``, energies at ``voltage`` and
    the current ``switched``.

    ``resistance`` to the coolant or heat sink in K/W; None where not known.
    """

    path: str
    kind: DeviceKind
    voltage: float
    current: float
    switched: float
    turn_on: float
    turn_off: float
    recovery: float
    drop: float
    diode_drop: float | None
    resistance: float | None


def device_figures(inverter: Inverter) -> list[Figure]:
    """Figures of the inverter's device: of its tables where it has some, else of its constants."""
    if inverter.device_model is not None:
        return model_figures(inverter.device_model)
    return [] if inverter.device is None else constant_figures(inverter.device)


def remarks(model: DeviceModel) -> list[str]:
    """Sentences on what is implausible in the data of a device."""
    return sentences(model_figures(model))


def constant_figures(device: SwitchDevice, path: str = "inverter.device") -> list[Figure]:
    """Figures of the constants of a device at its reference point."""
    current = device.reference_current
    diode = device.diode_voltage + device.diode_resistance * current
    point = _Point(
        path=path,
        kind=device.kind,
        voltage=device.reference_voltage,
        current=current,
        switched=current,
        turn_on=device.turn_on_energy,
        turn_off=device.turn_off_energy,
        recovery=device.reverse_recovery_energy,
        drop=device.on_voltage + device.on_resistance * current,
        diode_drop=diode if diode > 0.0 else None,
        resistance=device.thermal_resistance,
    )
    figures = [*_energies(point), *_drops(point), *_rise(point)]
    for name, volt in (("on_voltage", device.on_voltage), ("diode_voltage", device.diode_voltage)):
        if volt > 0.0:
            figures.append(Figure(f"{path}.{name}", "the threshold", volt, "V", 0.3, 4.0))
    if device.on_voltage > 0.0 and device.on_resistance > 0.0:
        volt, what = device.on_resistance * current, "the drop over it at the reference current"
        figures.append(Figure(f"{path}.on_resistance", what, volt, "V", 0.15, 4.0))
    if device.diode_voltage > 0.0 and device.diode_resistance > 0.0:
        volt, what = device.diode_resistance * current, "the drop over it at the reference current"
        figures.append(Figure(f"{path}.diode_resistance", what, volt, "V", 0.1, 4.0))
    coefficient, key = (
        device.on_resistance_temperature_coefficient,
        f"{path}.on_resistance_temperature_coefficient",
    )
    if coefficient != 0.0:
        figures.append(Figure(key, "the relative change per kelvin", coefficient, "%", 1e-3, 0.015))
    return figures


def model_figures(model: DeviceModel, path: str = "inverter.device") -> list[Figure]:
    """Figures of the tables of a device, at half the current of its energies
    and of its on-state curve.
    """
    ends = [
        family.curves[0].x[-1]
        for table in (model.turn_on, model.turn_off)
        for family in table.tables
    ]
    current, switched = 0.5 * min(curve.x[-1] for curve in model.conduction.curves), 0.5 * min(ends)
    voltage = model.turn_on.voltages[-1]
    resistance = (
        None if model.thermal is None else model.thermal.resistance + (model.case_resistance or 0.0)
    )
    point = _Point(
        path=f"{path} ({model.name})",
        kind=model.kind,
        voltage=voltage,
        current=current,
        switched=switched,
        turn_on=float(model.turn_on_energy(switched, voltage, _WARM).value),
        turn_off=float(model.turn_off_energy(switched, voltage, _WARM).value),
        recovery=float(model.recovery_energy(switched, voltage, _WARM).value),
        drop=float(model.on_voltage(current, _WARM).value),
        diode_drop=None
        if model.diode is None
        else float(model.diode_voltage(_diode_current(model), _WARM).value),
        resistance=resistance,
    )
    return [
        *_energies(point),
        *_drops(point),
        *_rise(point),
        *_ratings(model, point),
        *_networks(model, point),
    ]


def _diode_current(model: DeviceModel) -> float:
    assert model.diode is not None
    return 0.5 * min(curve.x[-1] for curve in model.diode.curves)


def _times(point: _Point) -> dict[str, tuple[float, float]]:
    """Usual ranges in s of E/(V I) by event.

    An IGBT's fall time and tail do not shrink with the current; devices for more than 600 V at the
    link are slower in proportion. A MOSFET's current and voltage cross in a time that grows with
    the voltage, from nanoseconds on.
    """
    volt = point.voltage
    if point.kind == "igbt":
        slower = max(1.0, volt / 600.0)
        return {
            "turn_on": (25e-9, 900e-9 * slower),
            "turn_off": (35e-9, 1.2e-6 * slower),
            "recovery": (18e-9, 700e-9 * slower),
        }
    slow = max(60e-9, 0.15e-9 * volt)
    if volt < _LOW_VOLTAGE:
        return {"turn_on": (2e-9, slow), "turn_off": (3e-9, 80e-9), "recovery": (0.2e-9, slow)}
    return {
        "turn_on": (max(2e-9, 0.01e-9 * volt), slow),
        "turn_off": (max(0.9e-9, volt * 1e-9 / 700.0), slow),
        "recovery": (0.1e-9, slow),
    }


def _energies(point: _Point) -> list[Figure]:
    """Switching energies over voltage and current, and over each other."""
    figures = []
    names = {
        "turn_on": "turn_on_energy",
        "turn_off": "turn_off_energy",
        "recovery": "reverse_recovery_energy",
    }
    for event, (low, high) in _times(point).items():
        energy = getattr(point, event)
        if energy > 0.0:
            key, what = (
                f"{point.path}.{names[event]}",
                "the energy over voltage and current of its point",
            )
            figures.append(
                Figure(key, what, energy / (point.voltage * point.switched), "s", low, high)
            )
    if point.turn_on > 0.0:
        ratio, key = point.turn_off / point.turn_on, f"{point.path}.turn_off_energy"
        high = {"igbt": 5.0, "mosfet": 5.0 if point.voltage < _LOW_VOLTAGE else 1.1}[point.kind]
        figures.append(Figure(key, "its ratio to the turn-on energy", ratio, "", 0.02, high))
    return figures


def _drops(point: _Point) -> list[Figure]:
    """On-state drops."""
    if point.kind == "igbt":
        low, high = 0.8, 6.0
    elif point.voltage < _LOW_VOLTAGE:
        low, high = 0.05, 2.0
    else:
        low, high = 0.4, 11.0
    key, what = f"{point.path}.on_resistance", f"the on-state drop at {point.current:.4g} A"
    figures = [Figure(key, what, point.drop, "V", low, high)]
    if point.diode_drop is not None:
        key, what = f"{point.path}.diode_voltage", "the forward drop of the diode"
        figures.append(Figure(key, what, point.diode_drop, "V", 0.5, 8.0))
    return figures


def _rise(point: _Point) -> list[Figure]:
    """Temperature rise by the conduction loss of half a sine: what the current
    rating of a device comes from.
    """
    if point.resistance is None:
        return []
    mean = point.drop * point.current / (math.pi if point.kind == "igbt" else 4.0)
    high = 30.0 if point.kind == "mosfet" and point.voltage < _LOW_VOLTAGE else 70.0
    key, what = (
        f"{point.path}.thermal_resistance",
        "the rise of the junction by the conduction loss",
    )
    what = f"{what} of a sine of {point.current:.4g} A peak"
    return [Figure(key, what, mean * point.resistance, "K", 2.8, high)]


def _ratings(model: DeviceModel, point: _Point) -> list[Figure]:
    """Ratings against the points of the tables."""
    figures = []
    if model.blocking_voltage is not None:
        share, key = point.voltage / model.blocking_voltage, f"{point.path}.blocking_voltage"
        figures.append(Figure(key, "the voltage of the energies over it", share, "", 0.25, 1.0))
    key = f"{point.path}.max_junction_temperature"
    figures.append(
        Figure(key, "the temperature", model.max_junction_temperature, "degC", 90.0, 250.0)
    )
    cold, hot = (float(model.on_voltage(point.current, kelvin).value) for kelvin in (25.0, 125.0))
    if model.kind == "mosfet" and len(model.conduction.curves) > 1 and cold > 0.0:
        key, what = f"{point.path}.on_state", "the on-state drop at 125 degC over that at 25 degC"
        figures.append(Figure(key, what, hot / cold, "", 0.7, 4.0))
    return figures


def _networks(model: DeviceModel, point: _Point) -> list[Figure]:
    """Thermal networks: time constants, and resistances over each other."""
    figures: list[Figure] = []
    if model.thermal is None:
        return figures
    for name, network in (("thermal", model.thermal), ("diode_thermal", model.diode_thermal)):
        slowest = 0.0 if network is None else _slowest(network)
        if network is not None and slowest > 0.0:
            most = 0.2 * max(1.0, 0.03 / network.resistance)
            what = "the slowest time constant from junction to case"
            figures.append(Figure(f"{point.path}.{name}", what, slowest, "s", 0.01, most))
    if model.case_resistance:
        ratio, key = (
            model.case_resistance / model.thermal.resistance,
            f"{point.path}.case_resistance",
        )
        figures.append(
            Figure(key, "its ratio to the resistance from junction to case", ratio, "", 0.15, 1.6)
        )
    if model.diode_thermal is not None:
        ratio, key = (
            model.diode_thermal.resistance / model.thermal.resistance,
            f"{point.path}.diode_thermal",
        )
        figures.append(Figure(key, "its resistance over the transistor's", ratio, "", 0.5, 5.0))
    return figures


def _slowest(network: ThermalNetwork) -> float:
    """Largest time constant in s of an element that carries at least a tenth of the resistance."""
    foster = network.foster() if isinstance(network, CauerNetwork) else network
    parts = zip(foster.resistances, foster.time_constants, strict=True)
    return max((tau for share, tau in parts if share >= 0.1 * foster.resistance), default=0.0)
