"""Device tables made ready for averages: one set of straight pieces per junction temperature,
at one DC voltage.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.curves import Curve, Family
from dqforge.machines.devices.device import DeviceModel
from dqforge.machines.devices.energies import EnergyTable
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.losses.constant_device import required_device
from dqforge.machines.records import dataclass

_FAR = 1e6  # Current in A at which the last straight piece of a curve ends.
_LEAST_SPAN = 1.0  # Temperatures in K closer than this are one.


@dataclass(frozen=True, slots=True)
class CurrentTable:
    """A quantity over current at K junction temperatures, straight between its points.

    ``current`` in A, shape (n,), ascending; ``value`` in SI units, shape (K, n).
    """

    current: FloatArray
    value: FloatArray

    def at(self, size: FloatArray) -> FloatArray:
        """Values at magnitudes of current in A, shape (...); result (K, ...)."""
        return np.stack([np.interp(size, self.current, row) for row in self.value])

    def plus(self, other: CurrentTable) -> CurrentTable:
        """Sum of two tables."""
        current = np.union1d(self.current, other.current)
        return CurrentTable(current, self.at(current) + other.at(current))


@dataclass(frozen=True, slots=True)
class BridgeTables:
    """One switch position at one DC voltage.

    Args:
        temperatures: Junction temperatures in degC at which the tables stand, shape (K,),
            ascending.
        synchronous: Whether the transistor conducts backwards (MOSFET).
        separate_diode: Whether the diode has a junction of its own.
        channel, diode: Voltages in V; ``diode`` is None where nothing is known of it.
        turn_on, turn_off: Energies of one turn-on and of one turn-off in J.
        recovery: Energy of one recovery in J, lost in the diode of the other position.
        resistances: From each junction alone, in K/W, and the part to the coolant that both share,
            last.
        coolant_temperature, max_junction_temperature: In degC.
        current_reach: Current in A up to which every table has points; inf for constants.
        temperature_reach: Temperatures in degC between which the tables stand; all where a single
            one is known, or for constants.
    """

    temperatures: FloatArray
    synchronous: bool
    separate_diode: bool
    channel: CurrentTable
    diode: CurrentTable | None
    turn_on: CurrentTable
    turn_off: CurrentTable
    recovery: CurrentTable
    resistances: tuple[float, ...]
    coolant_temperature: float
    max_junction_temperature: float
    current_reach: float
    temperature_reach: tuple[float, float]

    @property
    def switching(self) -> CurrentTable:
        """Energy of one turn-on and one turn-off in J."""
        return self.turn_on.plus(self.turn_off)


def _ends(curve: Curve) -> list[float]:
    """Currents at which a curve bends, with the place where its last piece falls to zero."""
    ends = list(curve.x)
    if len(curve.x) > 1 and curve.y[-1] < curve.y[-2]:
        slope = (curve.y[-1] - curve.y[-2]) / (curve.x[-1] - curve.x[-2])
        ends.append(curve.x[-1] - curve.y[-1] / slope)
    return ends


def _currents(families: tuple[Family, ...]) -> FloatArray:
    bends = {x for family in families for curve in family.curves for x in _ends(curve)}
    return np.array(sorted(x for x in {0.0, _FAR} | bends if x <= _FAR))


def _of_family(family: Family, temperatures: FloatArray) -> CurrentTable:
    current = _currents((family,))
    return CurrentTable(current, family.at(current[None, :], temperatures[:, None]).value)


def _of_energy(
    energy: EnergyTable | None, voltage: float, temperatures: FloatArray
) -> CurrentTable:
    if energy is None:
        return CurrentTable(np.array([0.0, _FAR]), np.zeros((temperatures.size, 2)))
    current = _currents(energy.tables)
    return CurrentTable(current, energy.at(current[None, :], voltage, temperatures[:, None]).value)


def _families(model: DeviceModel) -> tuple[Family, ...]:
    energies = [
        table for table in (model.turn_on, model.turn_off, model.recovery) if table is not None
    ]
    families = [model.conduction, *([] if model.diode is None else [model.diode])]
    return (*families, *(family for energy in energies for family in energy.tables))


def _knots(families: tuple[Family, ...]) -> FloatArray:
    """All temperatures at which some table bends, ascending.

    Those that make no difference are left out.
    """
    several = [family.parameters for family in families if len(family.parameters) > 1]
    every = sorted({t for parameters in several for t in parameters}) or [families[0].parameters[0]]
    kept = [every[0]]
    for temperature in every[1:]:
        if temperature - kept[-1] >= _LEAST_SPAN:
            kept.append(temperature)
    return np.array(kept)


def _known_diode(model: DeviceModel) -> bool:
    """Whether anything is known of the diode: constants of zero stand for nothing."""
    return model.diode is not None and any(y > 0.0 for curve in model.diode.curves for y in curve.y)


def _resistances(model: DeviceModel, total: float) -> tuple[float, ...]:
    """Thermal resistances of the junctions alone and of the path that they share, in K/W,
    for `total` to the coolant.

    What the transistor's network leaves of the total lies behind the case, where the diode's heat
    passes too. Where the total is less than the network, it is that of the transistor and the
    diode's is made smaller alike.
    """
    if model.thermal is None or model.diode_thermal is None:
        return total, 0.0
    own, diode = model.thermal.resistance, model.diode_thermal.resistance
    if total < own:
        return total, diode * total / own, 0.0
    return own, diode, total - own


def energy_factors(inverter: Inverter, v_dc: FloatArray) -> FloatArray | None:
    """Energies at other link voltages over those at the inverter's: of the transistors' events and
    of the recoveries, shape (2, N).

    None where tables at several voltages, or turn-on and turn-off by different powers of it, leave
    no one factor for all currents.

    Args:
        inverter: With its device and its own link voltage.
        v_dc: Link voltages in V, shape (N,).
    """
    given = inverter.device_model
    model = DeviceModel.from_switch_device(required_device(inverter)) if given is None else given
    events = [energy for energy in (model.turn_on, model.turn_off) if energy is not None]
    recoveries = [] if model.recovery is None else [model.recovery]
    exponents = []
    for energies in (events, recoveries):
        powers = {energy.exponent for energy in energies}
        if len(powers) > 1 or any(len(energy.voltages) > 1 for energy in energies):
            return None
        exponents.append(powers.pop() if powers else 1.0)
    ratio = v_dc / inverter.v_dc
    return np.stack([ratio**exponent for exponent in exponents])


def bridge_tables(inverter: Inverter) -> BridgeTables:
    """Tables of the inverter's device at its DC voltage; its constants as tables where it has none.

    Raises:
        InputError: The inverter has no device.
    """
    device = required_device(inverter)
    given = inverter.device_model
    model = DeviceModel.from_switch_device(device) if given is None else given
    families = _families(model)
    knots = _knots(families)
    spread = np.size(knots) > 1 and given is not None
    resistances = _resistances(model, device.thermal_resistance)
    energies = (
        _of_energy(energy, inverter.v_dc, knots) for energy in (model.turn_on, model.turn_off)
    )
    turn_on, turn_off = energies
    # The diode of an IGBT conducts whatever is known of it; beside a channel one
    # without data is left out.
    diode = model.diode if model.kind == "igbt" or _known_diode(model) else None
    return BridgeTables(
        temperatures=knots,
        synchronous=model.kind == "mosfet",
        separate_diode=len(resistances) > 2,
        channel=_of_family(model.conduction, knots),
        diode=None if diode is None else _of_family(diode, knots),
        turn_on=turn_on,
        turn_off=turn_off,
        recovery=_of_energy(model.recovery, inverter.v_dc, knots),
        resistances=resistances,
        coolant_temperature=inverter.coolant_temperature,
        max_junction_temperature=device.max_junction_temperature,
        current_reach=np.inf
        if given is None
        else min(f.reach for f in families if f.end == "extend"),
        temperature_reach=(float(knots[0]), float(knots[-1])) if spread else (-np.inf, np.inf),
    )
