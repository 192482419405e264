"""Device tables made ready for averages: one set of straight pieces per junction temperature,
at one DC voltage.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Curve, DeviceModel, EnergyTable, Family, Inverter
from dqforge.machines.devices.thermal_network import CauerNetwork, ThermalNetwork
from dqforge.machines.losses.machine_budget import required_device
from dqforge.machines.modulation.modulators import PhaseWaveforms, sector_waveforms
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.ripple import ripple_squares
from dqforge.machines.names import ModulationName, OvermodulationName
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


# Losses of a bridge from device tables, averaged over an electrical period,
# whole arrays of points at once.
#
# Averages depend on the waveforms and on the temperatures of the tables, not on the carrier
# frequency: they are taken once per point and modulator, at every temperature of the tables, and
# the balance of heat then interpolates in the temperature for any number of frequencies.
#
# Sources: docs/methods/loss-budget.md; DC-link current: J. W. Kolar, S. D. Round, "Analytical
# calculation of the RMS current stress on the DC-link capacitor of voltage-PWM converter systems",
# IEE Proceedings - Electric Power Applications 153(4), 2006, doi:10.1049/ip-epa:20050458 (of which
# this is the general form, for any modulator).

# Points at once: each array of 1024 x 24 angles x 3 phases is 0.6 MB,
# so that a handful stays in the cache.
_CHUNK = 1024


@dataclass(frozen=True, slots=True)
class BridgeAverages:
    """Averages over an electrical period at N points, for one modulator.

    The first three have the shape (2, J, K, N): upper and lower position; junction of the
    transistor and, where the diode has its own, of the diode; temperature of the tables. They are
    those of one switch position.

    Args:
        conduction: Conduction loss in W without dead time.
        switching: Energy in J of all events in a carrier period.
        dead: Loss in W that dead time adds, for the share of 1 of the carrier period in each gap.
        dc_current, dc_square: Mean in A and mean square in A^2 of the current from the DC link,
            shape (N,).
        switched: Sum over the phases of the mean magnitude of current in A while the phase
            switches, shape (N,).
        ripple: Mean square of the ripple of a phase current in A^2 for v_dc / f_sw = 1 V s, shape
            (N,).
    """

    conduction: FloatArray
    switching: FloatArray
    dead: FloatArray
    dc_current: FloatArray
    dc_square: FloatArray
    switched: FloatArray
    ripple: FloatArray


def _shares(wave: PhaseWaveforms, *, one_rail: bool) -> dict[str, FloatArray]:
    """Weights (S, n, angles, legs) of what flows or switches where, for S positions:
    one stands for two that are alike.

    ``own`` is the share of the carrier period in which a position carries its transistor's current,
    ``back`` in which it carries current backwards; ``events`` and ``recoveries`` are one where it
    switches, or its diode recovers.
    """
    weight = wave.weight[..., None] / wave.current.shape[-1]
    duty = np.clip(wave.modulation.duty, 0.0, 1.0)
    ahead = wave.current >= 0.0
    free = weight * ~wave.modulation.clamped
    upper = {"own": weight * duty * ahead, "back": weight * duty * ~ahead, "events": free * ahead}
    off = weight * (1.0 - duty)
    lower = {"own": off * ~ahead, "back": off * ahead, "events": free * ~ahead}
    upper["recoveries"], lower["recoveries"] = lower["events"], upper["events"]
    if one_rail:
        return {name: np.stack([upper[name], lower[name]]) for name in upper}
    return {name: 0.5 * (upper[name] + lower[name])[None] for name in upper}


def _mean(shares: FloatArray, values: FloatArray) -> FloatArray:
    """Weighted sums (S, K, n) of values (K, n, angles, legs) with shares (S, n, angles, legs)."""
    count = shares.shape[1]
    left = shares.reshape(shares.shape[0], 1, count, 1, -1)
    right = values.reshape(1, values.shape[0], count, -1, 1)
    return np.asarray((left @ right)[..., 0, 0])


def junction_losses(tables: BridgeTables, wave: PhaseWaveforms, *, one_rail: bool) -> FloatArray:
    """Conduction, switching and dead time (rows) of transistor and diode, shape (3, S, 2, K, n).

    The mean over the half bridges of the waveforms, three of them or any number: conduction in W,
    energies of all events of a carrier period in J, and W for the share of 1 in each gap, as in
    `BridgeAverages`.

    Args:
        tables: The device, K temperatures.
        wave: Duty cycles and currents of n points, the half bridges along the last axis.
        one_rail: Whether upper and lower positions differ (S = 2); else one stands for both (S =
            1).
    """
    share = _shares(wave, one_rail=one_rail)
    size = np.abs(wave.current)
    channel = tables.channel.at(size) * size
    diode = None if tables.diode is None else tables.diode.at(size) * size
    zero = np.zeros((share["own"].shape[0], channel.shape[0], size.shape[0]))
    switching, recovery = _mean(share["events"], tables.switching.at(size)), zero
    if np.any(tables.recovery.value):
        recovery = _mean(share["recoveries"], tables.recovery.at(size))
    if not tables.synchronous:
        assert diode is not None  # an IGBT has one
        own, back = _mean(share["own"], channel), _mean(share["back"], diode)
        # With the references as voltages that are made, dead time only says
        # which switch turns on later.
        return np.stack(
            [np.stack(part, axis=1) for part in ((own, back), (switching, recovery), (zero, zero))]
        )
    conduction = _mean(share["own"] + share["back"], channel)
    added, removed = zero, zero
    if diode is not None:
        # Both gaps of a carrier period fall to the position that carries the current backwards.
        added, removed = (
            2.0 * _mean(share["recoveries"], diode),
            2.0 * _mean(share["recoveries"], channel),
        )
    parts = ((conduction, zero), (switching, recovery), (-removed, added))
    return np.stack([np.stack(part, axis=1) for part in parts])


def _link(wave: PhaseWaveforms) -> FloatArray:
    """Mean, mean square of the DC-link current, and sum of the switched magnitudes, shape (3, n).

    Centred pulses overlap, so that two phases are on together for the smaller of their duty cycles.
    """
    duty, current = np.clip(wave.modulation.duty, 0.0, 1.0), wave.current
    mean = wave.phase_sum(duty * current)
    square = duty * current**2
    turned = np.roll(duty, -1, axis=-1), np.roll(current, -1, axis=-1)
    square = square + 2.0 * np.minimum(duty, turned[0]) * current * turned[1]
    switched = wave.phase_sum(np.where(wave.modulation.clamped, 0.0, np.abs(current)))
    return np.stack([mean, wave.phase_sum(square), switched])


def bridge_averages(
    tables: BridgeTables,
    modulation: ModulationName,
    voltage: FloatArray,
    current: FloatArray,
    v_dc: float,
    stiffness: FloatArray | None = None,
    overmodulation: OvermodulationName = "none",
    energy_factors: FloatArray | None = None,
) -> BridgeAverages:
    """Averages of losses, DC-link current and ripple over an electrical period.

    Args:
        tables: The device.
        modulation: The modulator.
        voltage, current: Phase voltages in V and currents in A in rotor coordinates (peak), shape
            (2, N) each. Duty cycles beyond the linear range are saturated: what is said there has
            no meaning.
        v_dc: DC-link voltage in V.
        stiffness: Inverse of the incremental inductances in 1/H, shape (N, 2, 2), for the ripple;
            None leaves it zero.
        overmodulation: What becomes of voltages beyond the circle in the hexagon, where duty cycles
            saturate else.
        energy_factors: Energies of the transistors' events and of the recoveries over those of the
            tables, shape (2, N); None for one.

    Returns:
        BridgeAverages
    """
    one_rail, count = MODULATORS[modulation].one_rail, voltage.shape[1]
    junctions = 2 if tables.separate_diode else 1
    losses = np.empty((3, 2, junctions, tables.temperatures.size, count))
    link, ripple = np.empty((3, count)), np.zeros(count)
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        v_d, v_q = voltage[:, part]
        i_d, i_q = current[:, part]
        wave = sector_waveforms(modulation, v_d, v_q, i_d, i_q, v_dc, overmodulation)
        found = junction_losses(tables, wave, one_rail=one_rail)
        if energy_factors is not None:
            found[1] *= energy_factors[:, None, part]
        losses[..., part] = found if tables.separate_diode else np.sum(found, axis=2, keepdims=True)
        link[:, part] = _link(wave)
        if stiffness is not None:
            ripple[part] = 0.5 * np.sum(ripple_squares(wave, stiffness[part]), axis=-1)
    return BridgeAverages(losses[0], losses[1], losses[2], link[0], link[1], link[2], ripple)


# Junction temperatures over time: exact response of Foster networks to losses that are
# constant in each interval.
#
# Each element obeys tau dx/dt = R P - x, so that over an interval of length h
#
#   x(h) = x(0) a + R P (1 - a),   mean x = R P + (x(0) - R P) (1 - a) tau / h,   a = exp(-h / tau)
#
# A whole mission is one chain of such affine maps. The chain is composed by doubling, log2 N steps
# over whole arrays, and the state with which a repeated mission begins is the fixed point of all
# maps together.

_SWEEPS = 300


_STILL = 1e-7


_HOTTEST = 1e6


@dataclass(frozen=True, slots=True)
class JunctionNetworks:
    """Foster elements of J junctions: resistances in K/W and time constants in s, shape (J, E);
    zeros fill up.

    ``shared`` in K/W lies behind all junctions of a position and has no capacity.
    """

    resistances: FloatArray
    time_constants: FloatArray
    shared: float


@dataclass(frozen=True, slots=True)
class JunctionHistory:
    """Temperatures of one position pair over N intervals, in degC.

    Args:
        start, mean, end: At the start of each interval (with its loss on), on the average and at
            its end, shape (2, J, N).
        steady: Whether the temperatures settled; if not, they ran away and are NaN.
    """

    start: FloatArray
    mean: FloatArray
    end: FloatArray
    steady: bool


def _elements(network: ThermalNetwork | None, total: float) -> tuple[list[float], list[float]]:
    """Elements of one junction whose resistances make `total` K/W.

    What the network leaves has no capacity; a network with more than the
    total is made smaller alike.
    """
    if network is None:
        return [total], [0.0]
    foster = network.foster() if isinstance(network, CauerNetwork) else network
    scale = min(1.0, total / foster.resistance)
    resistances = [scale * part for part in foster.resistances]
    rest = max(total - scale * foster.resistance, 0.0)
    return [*resistances, rest], [*foster.time_constants, 0.0]


def junction_networks(inverter: Inverter, tables: BridgeTables) -> JunctionNetworks:
    """Networks of the inverter's device; without data of its own each junction
    follows its loss at once.

    Args:
        inverter: Device and coolant.
        tables: Tables of the bridge, for devices without thermal data of their own.
    """
    model = inverter.device_model
    *own, shared = tables.resistances
    given = [None] * len(own) if model is None else [model.thermal, model.diode_thermal][: len(own)]
    parts = [_elements(network, total) for network, total in zip(given, own, strict=True)]
    size = max(len(resistances) for resistances, _ in parts)
    padded = [[side + [0.0] * (size - len(side)) for side in part] for part in parts]
    array = np.array(padded)
    return JunctionNetworks(array[:, 0], array[:, 1], shared)


def _states(decay: FloatArray, drive: FloatArray, *, repeated: bool) -> FloatArray:
    """States at the starts of all intervals for x -> decay x + drive, last axis N."""
    through, added, step = decay.copy(), drive.copy(), 1
    count = decay.shape[-1]
    while step < count:
        # Maps of 2 step intervals from those of step; each place takes what lies before it.
        added[..., step:] = through[..., step:] * added[..., :-step] + added[..., step:]
        through[..., step:] = through[..., step:] * through[..., :-step]
        step *= 2
    first = np.zeros(decay.shape[:-1])
    if repeated:
        first = added[..., -1] / (1.0 - through[..., -1])
    ends = through * first[..., None] + added
    return np.concatenate([first[..., None], ends[..., :-1]], axis=-1)


def junction_history(
    tables: BridgeTables,
    networks: JunctionNetworks,
    loss: FloatArray,
    length: FloatArray,
    *,
    repeated: bool = True,
) -> JunctionHistory:
    """Temperatures over a mission, with losses that follow the mean temperature of each interval.

    Args:
        tables, networks: The device.
        loss: Losses in W of the junctions at the temperatures of the tables, shape (2, J, K, N).
        length: Lengths of the intervals in s, shape (N,).
        repeated: Whether the mission repeats without end, so that it ends as warm as it
            begins; else it begins at the coolant's temperature.
    """
    coolant = tables.coolant_temperature
    resistance, tau = networks.resistances[:, :, None], networks.time_constants[:, :, None]
    ratio = length / np.where(tau > 0.0, tau, 1.0)
    decay = np.where(tau > 0.0, np.exp(-ratio), 0.0)
    # Mean over the interval of what decays from one: (1 - a) tau / h.
    fading = np.where(tau > 0.0, -np.expm1(-ratio) / ratio, 0.0)
    shape = (*loss.shape[:2], loss.shape[-1])
    mean = np.full(shape, coolant)
    wide = (shape[0], *decay.shape)
    settled, start, end = False, mean, mean
    for _ in range(_SWEEPS):
        power = at_temperature(tables.temperatures, loss, mean)
        level = resistance * power[:, :, None]
        state = _states(np.broadcast_to(decay, wide), level * (1.0 - decay), repeated=repeated)
        base = coolant + networks.shared * np.sum(power, axis=1, keepdims=True)
        held = np.where(tau > 0.0, state, level)
        start = base + np.sum(held, axis=2)
        end = base + np.sum(level + (held - level) * decay, axis=2)
        found = base + np.sum(level + (held - level) * fading, axis=2)
        moved = float(np.max(np.abs(found - mean)))
        mean = found
        settled = moved <= _STILL
        if settled or not np.max(np.abs(mean)) < _HOTTEST:
            break
    if not settled:
        start, mean, end = (np.full(shape, np.nan) for _ in range(3))
    return JunctionHistory(start, mean, end, settled)


# Balance of heat of a switch position: junction temperatures at which its losses leave it,
# and runaway.
#
# Losses are straight between the temperatures of the device tables and carried on beyond them, so
# that the balance of one junction is solved exactly, piece by piece, from the cold side. Where
# transistor and diode have junctions of their own behind a common path, the two are solved in turn
# until both stand still.

_BRIDGE_HEAT_SWEEPS = 200
_BRIDGE_HEAT_STILL = 1e-10  # Largest change in K of a last sweep.
_BRIDGE_HEAT_HOTTEST = 1e9  # Temperature in degC beyond which a junction is said to run away.


@dataclass(frozen=True, slots=True)
class JunctionBalance:
    """Steady junctions of upper and lower position, J junctions each, at points of the shape (...).

    Args:
        temperature: In degC, shape (2, J, ...); NaN where a junction runs away.
        residual: Temperature minus the one that its losses lead to, in K, shape (2, J, ...).
        steady: False where a junction runs away, shape (...).
    """

    temperature: FloatArray
    residual: FloatArray
    steady: BoolArray


def at_temperature(knots: FloatArray, values: FloatArray, temperature: FloatArray) -> FloatArray:
    """Values (..., K, *points) between the K temperatures, carried on beyond them,
    at temperatures (..., *points).

    Args:
        knots: Temperatures in degC, shape (K,), ascending.
        values: With the axis of temperatures third, shape (2, J, K, *points).
        temperature: In degC, shape (2, J, *points).
    """
    if knots.size == 1:
        return np.asarray(np.broadcast_to(values[:, :, 0], temperature.shape))
    found = np.array(np.broadcast_to(values[:, :, 0], temperature.shape))
    steps = np.diff(values, axis=2)
    for k, width in enumerate(np.diff(knots)):
        low = -np.inf if k == 0 else knots[k]
        high = np.inf if k == knots.size - 2 else knots[k + 1]
        # NaN temperatures stay NaN.
        share = (np.minimum(np.maximum(temperature, low), high) - knots[k]) / width
        found += share * steps[:, :, k]
    return found


def _root(
    knots: FloatArray, loss: FloatArray, base: FloatArray, resistance: float
) -> tuple[FloatArray, BoolArray]:
    """Least T with T = base + R P(T), and whether there is one.

    Loss (2, K, *points) in W, base (2, *points).
    """
    if knots.size == 1:
        found = base + resistance * loss[:, 0]
        return found, np.ones(found.shape, dtype=np.bool_)
    above = base[:, None] + resistance * loss - knots.reshape(1, -1, *[1] * (base.ndim - 1))
    met = above[:, 1:] <= 0.0
    last = knots.size - 2
    piece = np.where(np.any(met, axis=1), np.argmax(met, axis=1), last)[:, None]
    start, end = (np.take_along_axis(above, piece + k, axis=1)[:, 0] for k in (0, 1))
    low, width = knots[piece[:, 0]], np.diff(knots)[piece[:, 0]]
    # h(T) falls from `start` to `end` over the piece; 1 - R dP/dT is its slope.
    slope = (start - end) / width
    steady = np.asarray(slope > 0.0)
    return low + start / np.where(steady, slope, 1.0), steady


def junction_balance(tables: BridgeTables, loss: FloatArray) -> JunctionBalance:
    """Junction temperatures of losses that depend on them.

    Args:
        tables: The device, with its thermal resistances.
        loss: Losses in W of the junctions of one position at the temperatures of the tables, shape
            (2, J, K, *points).

    Returns:
        The steady state that a junction reaches when it warms up from the coolant: the coldest one.
    """
    knots, coolant = tables.temperatures, tables.coolant_temperature
    *own, shared = tables.resistances
    shape = (*loss.shape[:2], *loss.shape[3:])
    temperature = np.full(shape, coolant)
    steady = np.ones(shape[2:], dtype=np.bool_)
    power = np.zeros(shape)
    for _ in range(_BRIDGE_HEAT_SWEEPS if len(own) > 1 else 1):
        before = temperature.copy()
        for j, resistance in enumerate(own):
            others = sum(
                (power[:, k] for k in range(len(own)) if k != j), np.zeros_like(power[:, j])
            )
            found, held = _root(knots, loss[:, j], coolant + shared * others, resistance + shared)
            steady &= np.all(held & (np.abs(found) < _BRIDGE_HEAT_HOTTEST), axis=0)
            temperature[:, j] = np.where(steady, found, coolant)
            power[:, j] = at_temperature(knots, loss[:, j : j + 1], temperature[:, j : j + 1])[:, 0]
        moved = np.max(np.abs(temperature - before), axis=(0, 1))
        if np.all(moved <= _BRIDGE_HEAT_STILL):
            break
    else:
        # What still moves after so many sweeps does not settle.
        steady &= (moved <= 1e6 * _BRIDGE_HEAT_STILL) if len(own) > 1 else True
    total = shared * np.sum(power, axis=1, keepdims=True)
    residual = (
        temperature
        - coolant
        - total
        - power * np.array(own).reshape(1, -1, *[1] * (power.ndim - 2))
    )
    return JunctionBalance(
        np.where(steady, temperature, np.nan),
        np.where(steady, residual, np.nan),
        np.asarray(steady),
    )
