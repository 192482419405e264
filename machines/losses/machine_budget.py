"""Losses of a machine beyond the dc copper loss, over missions and at operating points as its
terminals see them, and those of a device of constant figures.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.machine_batch import MachineOrBatch
from dqforge.machines.dq_machines.synchronous import torque_from_flux
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable, read_table
from dqforge.machines.modulation.modulators import PhaseWaveforms, sector_waveforms
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import overmodulation_of
from dqforge.machines.units.quantities import Reading, read_quantity

if TYPE_CHECKING:
    from dqforge.machines.losses.loss_map import LossMap

# What files call the columns; single letters count with their case, T is a torque and t a time.
_NAMES: dict[str, tuple[str, ...]] = {
    "time": ("t", "time", "zeit", "seconds"),
    "speed": (
        "n",
        "speed",
        "rpm",
        "omega",
        "omega_m",
        "w",
        "w_m",
        "drehzahl",
        "n_m",
        "rotational speed",
    ),
    "torque": (
        "T",
        "M",
        "torque",
        "drehmoment",
        "moment",
        "t_e",
        "t_m",
        "t_ref",
        "m_ref",
        "tq",
        "trq",
    ),
}

_SI = {"time": "s", "speed": "rad/s", "torque": "N m", "power": "W"}

# Revolutions per minute as drives people write them, beyond the vocabulary of units.
_PER_MINUTE = re.compile(
    r"(?:1|u|r|rev|umdr\.?)\s*/\s*min|min\s*(?:\^|\*\*)?\s*[-\N{MINUS SIGN}]\s*1|min⁻¹",
    re.IGNORECASE,
)

_MOST_ROWS = 200_000
MOST_BYTES = 50_000_000  # Bytes of the largest file of a mission.


@dataclass(frozen=True, slots=True)
class Mission:
    """Torque and speed over time; what stands in a row holds until the time of the next.

    Args:
        time: Instants in s, shape (N + 1,), strictly ascending.
        torque, omega_m: In N m and rad/s (mechanical) from each instant to the next, shape (N,).
        lines: Line of the file of each interval, shape (N,).
        source: Name of the file.
        findings: Sentences on what was assumed.
    """

    time: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    lines: NDArray[np.intp]
    source: str
    findings: tuple[str, ...] = ()

    @property
    def length(self) -> FloatArray:
        """Lengths of the intervals in s, shape (N,)."""
        return np.diff(self.time)


def kind_of_title(name: str) -> str | None:
    """Which quantity the title ``name`` of a column names, None for another."""
    word = " ".join(name.split())
    for kind, names in _NAMES.items():
        if word in names or (len(word) > 1 and word.lower() in names):
            return kind
    if word in ("N", "m"):
        return "speed" if word == "N" else "torque"
    return None


def _columns(table: TextTable) -> dict[str, int]:
    """Column of each quantity: by its title, else by its unit, else the first three in order."""
    found: dict[str, int] = {}
    for column, (name, unit) in enumerate(zip(table.names, table.units, strict=True)):
        kind = kind_of_title(name) or _kind_of_unit(unit)
        if kind is None:
            continue
        if kind in found:
            first = table.names[found[kind]]
            message = (
                f"columns '{first}' and '{name}' both look like the {kind}; leave one of them out"
            )
            raise InputError(message, source=table.source, line=_head_line(table))
        found[kind] = column
    untitled = all(name.startswith("column ") for name in table.names)
    if not found and untitled and len(table.names) == 3:
        return {"time": 0, "speed": 1, "torque": 2}
    missing = [kind for kind in _NAMES if kind not in found]
    if missing:
        titles = ", ".join(f"'{name}'" for name in table.names)
        message = f"no column for the {' and the '.join(missing)} among {titles}"
        raise InputError(
            f"{message}; write a head row such as: time [s]; speed [rpm]; torque [N m]",
            source=table.source,
            line=_head_line(table),
        )
    return found


def _kind_of_unit(unit: str) -> str | None:
    for kind in _NAMES:
        if unit and _factor(kind, unit) is not None:
            return kind
    return None


def _head_line(table: TextTable) -> int:
    return max(int(table.lines[0]) - 1, 1)


def _unit(kind: str, unit: str) -> Reading:
    """One of a unit as a quantity; raises where it is none of this kind."""
    return read_quantity(
        "1 rpm" if kind == "speed" and _PER_MINUTE.fullmatch(unit.strip()) else f"1 {unit}", kind
    )


def _factor(kind: str, unit: str) -> float | None:
    """SI value of one of a unit, None where it is none of this quantity."""
    try:
        return _unit(kind, unit).si
    except InputError:
        return None


def column_in_si(table: TextTable, kind: str, column: int, findings: list[str]) -> FloatArray:
    """Values of a column in SI units, shape (rows,).

    Args:
        table: The file.
        kind: ``time``, ``speed``, ``torque`` or ``power``.
        column: Place of the column.
        findings: Takes a sentence where a unit is assumed.

    Raises:
        InputError: A cell without a number, or a unit of another kind.
    """
    values, unit = table.values[:, column], table.units[column]
    (holes,) = np.nonzero(~np.isfinite(values))
    if holes.size:
        message = (
            f"no number for the {kind} in column '{table.names[column]}'; write one, or remove the "
            "line"
        )
        raise InputError(message, source=table.source, line=int(table.lines[holes[0]]))
    if not unit:
        if table.names[column].lower() == "rpm":
            unit = "rpm"
        else:
            findings.append(f"{kind} without a unit, taken as {_SI[kind]}")
            return values
    factor = _factor(kind, unit)
    if factor is None:
        message = (
            f"unit '{unit}' of column '{table.names[column]}' is none of a {kind}; write "
            f"{_SI[kind]}"
        )
        message += " or rpm" if kind == "speed" else ""
        raise InputError(message, source=table.source, line=_head_line(table))
    remark = _unit(kind, unit).remark
    findings.extend([f"{kind}: {remark}"] if remark else [])
    return values * factor


def read_mission(content: bytes, source: str, *, omega_max: float | None = None) -> Mission:
    """Read a mission profile: time, speed and torque in a text table of any
    delimiter and decimal sign.

    Titles name the columns (time, speed, torque, t, n, M, ...), and units beside them are honoured;
    without units the numbers are SI. Without titles the columns are time, speed and torque. The
    last row ends the mission.

    Args:
        content: Bytes of the file.
        source: Name of the file, for messages.
        omega_max: Largest permitted mechanical speed in rad/s, or None.

    Raises:
        InputError: With file and line: no table, a missing or doubled column, a foreign unit, a
            cell without a number, times that do not ascend, a speed above the largest, or too many
            rows.
    """
    table = read_table(content, source)
    if table.lines.size > _MOST_ROWS:
        message = (
            f"the mission has {table.lines.size} rows, at most {_MOST_ROWS} are read; resample it"
        )
        raise InputError(message, source=source)
    columns, findings = _columns(table), list[str]()
    time, omega_m, torque = (
        column_in_si(table, kind, columns[kind], findings) for kind in ("time", "speed", "torque")
    )
    (stuck,) = np.nonzero(np.diff(time) <= 0.0)
    if stuck.size:
        k = int(stuck[0])
        message = (
            f"time {time[k + 1]:.6g} s does not lie after the {time[k]:.6g} s of the row before"
        )
        raise InputError(
            f"{message}; sort the rows, and keep each time once",
            source=source,
            line=int(table.lines[k + 1]),
        )
    if omega_max is not None:
        (fast,) = np.nonzero(np.abs(omega_m) > omega_max * (1.0 + 1e-9))
        if fast.size:
            k, rpm = int(fast[0]), 9.549296585513721
            message = (
                f"speed {omega_m[k] * rpm:.5g} rpm is above machine.max_speed "
                f"{omega_max * rpm:.5g} rpm"
            )
            bare = not table.units[columns["speed"]] and abs(omega_m[k]) > 3.0 * omega_max
            hint = (
                "the column has no unit and is taken as rad/s, write speed [rpm]"
                if bare
                else "correct one of them"
            )
            raise InputError(f"{message}; {hint}", source=source, line=int(table.lines[k]))
    return Mission(time, torque[:-1], omega_m[:-1], table.lines[:-1], source, tuple(findings))


# Losses of a machine beyond the dc copper loss: alternating-current copper loss,
# iron loss and magnet loss.
#
# Source of the iron loss: G. Bertotti, "General properties of power losses in soft ferromagnetic
# materials", IEEE Transactions on Magnetics 24(1), 1988, doi:10.1109/20.43994 (hysteresis and
# eddy-current terms).


@dataclass(frozen=True, slots=True)
class MachineLoss:
    """Losses of the machine beyond the dc copper loss; all zero by default.

    Args:
        ac_copper: k_ac in s^2/rad^2: the resistance that makes heat is R (1 + k_ac omega_e^2).
        hysteresis, eddy: k_h in W s/(rad Wb^2) and k_c in W s^2/(rad^2 Wb^2): iron loss (k_h
            |omega_e| + k_c omega_e^2) |psi|^2 with the peak dq flux linkage.
        magnet: k_m in W s^2/(rad^2 A^2): eddy-current loss k_m omega_e^2 |i|^2 of the magnets under
            the field of the winding, with the peak dq current.
        mapped: Core and magnet loss over the currents; with it ``hysteresis`` and ``eddy`` are what
            it is compared with, and ``eddy`` serves the loss of the switching alone.
    """

    ac_copper: float = 0.0
    hysteresis: float = 0.0
    eddy: float = 0.0
    magnet: float = 0.0
    mapped: LossMap | None = None

    def __post_init__(self) -> None:
        """Refuse what is no loss."""
        for name in ("ac_copper", "hysteresis", "eddy", "magnet"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"machine loss: {name} must be zero or positive, got {value:g}")

    def copper_factor(self, omega_e: FloatArray) -> FloatArray:
        """AC over dc copper loss at electrical speeds in rad/s, any shape."""
        return 1.0 + self.ac_copper * omega_e * omega_e

    def iron_factor(self, omega_e: FloatArray) -> FloatArray:
        """Iron loss over |psi|^2 in W/Wb^2 at electrical speeds in rad/s, any shape."""
        return self.hysteresis * np.abs(omega_e) + self.eddy * omega_e * omega_e

    def core_losses(
        self, i_d: FloatArray, i_q: FloatArray, square: FloatArray, omega_e: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Iron loss, and what a map gives of the magnets, in W, shape (...).

        Args:
            i_d, i_q: Currents in A (peak), shape (...).
            square: |psi|^2 there in Wb^2, shape (...).
            omega_e: Electrical speed in rad/s, shape (...).
        """
        if self.mapped is not None:
            return self.mapped.losses(i_d, i_q, omega_e)
        iron = self.iron_factor(omega_e) * square
        return iron, np.zeros_like(iron)

    @classmethod
    def measured(
        cls,
        *,
        frequency: float = 0.0,
        flux: float = 0.0,
        hysteresis: float = 0.0,
        eddy: float = 0.0,
        resistance_ratio: float = 1.0,
        resistance_frequency: float = 1.0,
        magnet: float = 0.0,
        magnet_frequency: float = 1.0,
        magnet_current: float = 1.0,
    ) -> MachineLoss:
        """Coefficients from a measurement or a computation.

        Args:
            frequency, flux: Electrical frequency in Hz and flux linkage in Wb (peak) of the two
                iron losses.
            hysteresis, eddy: The two parts of the iron loss there, in W.
            resistance_ratio, resistance_frequency: AC over dc resistance at an electrical frequency
                in Hz.
            magnet, magnet_frequency, magnet_current: Magnet loss in W at an electrical frequency in
                Hz and a current in A (peak).
        """
        omega, square = 2.0 * math.pi * frequency, flux * flux
        return cls(
            ac_copper=(resistance_ratio - 1.0) / (2.0 * math.pi * resistance_frequency) ** 2,
            hysteresis=hysteresis / (omega * square) if hysteresis else 0.0,
            eddy=eddy / (omega * omega * square) if eddy else 0.0,
            magnet=magnet / (2.0 * math.pi * magnet_frequency * magnet_current) ** 2,
        )


NO_EXTRA_LOSS = MachineLoss()


# Losses of a machine at operating points as its terminals see them,
# the winding as warm as its loss makes it.
#
# Every loss has its place in the equivalent circuit, so that the power at the terminals is the sum
# of losses and shaft power without remainder: copper and magnet loss as resistances in series, iron
# loss as a conductance beside the back-EMF. The currents of a reference are those that make the
# torque; the iron's current comes on top.
#
# Source of the circuit: T. M. Jahns, "Flux-weakening regime operation of an interior permanent-
# magnet synchronous motor drive", IEEE Transactions on Industry Applications IA-23(4), 1987,
# doi:10.1109/TIA.1987.4504966 (without iron loss); S. Morimoto et al., "Loss minimization control
# of permanent magnet synchronous motor drives", IEEE Transactions on Industrial Electronics 41(5),
# 1994, doi:10.1109/41.315269 (with it).

COPPER_COEFFICIENT = 0.00393  # Relative change of the resistance of copper per kelvin, at 20 degC.


@dataclass(frozen=True, slots=True)
class WindingHeat:
    """How warm the winding becomes.

    Args:
        thermal_resistance: Winding to coolant in K/W.
        coolant_temperature: In degC.
        reference_temperature: Temperature in degC at which the machine's r_s holds.
        coefficient: Relative change of r_s per kelvin, in 1/K, at the reference temperature.
    """

    thermal_resistance: float
    coolant_temperature: float = 25.0
    reference_temperature: float = 20.0
    coefficient: float = COPPER_COEFFICIENT

    def __post_init__(self) -> None:
        """Refuse what no winding has."""
        values = (
            self.thermal_resistance,
            self.coolant_temperature,
            self.reference_temperature,
            self.coefficient,
        )
        if (
            not all(math.isfinite(value) for value in values)
            or self.thermal_resistance < 0.0
            or self.coefficient < 0.0
        ):
            raise InputError(
                "winding: thermal resistance and coefficient must be zero or positive finite "
                "numbers"
            )
        if 1.0 + self.coefficient * (self.coolant_temperature - self.reference_temperature) <= 0.0:
            raise InputError(
                "winding: the resistance vanishes at the coolant temperature; check the coefficient"
            )


@dataclass(frozen=True, slots=True)
class MachineBudget:
    """Losses of a machine and what its terminals see, arrays of the shape (...).

    Args:
        torque, shaft_power: In N m and W.
        copper, iron, magnet: Losses in W; copper with the AC factor, at the winding temperature.
        resistance: Resistance in Ohm that makes the copper loss.
        winding_temperature: In degC, NaN without data of the winding's heat or where it is not
            steady.
        steady: False where the winding temperature runs away; copper loss, resistance and voltages
            are NaN there.
        i_d, i_q, v_d, v_q: Currents in A and voltages in V at the terminals (peak).
    """

    torque: FloatArray
    shaft_power: FloatArray
    copper: FloatArray
    iron: FloatArray
    magnet: FloatArray
    resistance: FloatArray
    winding_temperature: FloatArray
    steady: BoolArray
    i_d: FloatArray
    i_q: FloatArray
    v_d: FloatArray
    v_q: FloatArray


def warm_ratio(
    heat: WindingHeat, cold_loss: FloatArray, extra: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Resistance over r_s of the steady winding, shape (...), and where it is steady.

    Args:
        heat: How warm the winding becomes.
        cold_loss: Copper loss c in W with r_s, shape (...).
        extra: Relative rise k of the resistance by eddy currents in cold copper, shape (...).

    Notes:
        With r = 1 + alpha (T - T_ref) and the copper loss c (r + k / r), whose eddy currents warm
        copper damps: (1 - g) r^2 - b r - g k = 0 with g = alpha R_th c and b = 1 + alpha (T_coolant
        - T_ref).
    """
    gain = heat.coefficient * heat.thermal_resistance * cold_loss
    base = 1.0 + heat.coefficient * (heat.coolant_temperature - heat.reference_temperature)
    steady = np.asarray(gain < 1.0)
    rest = np.where(steady, 1.0 - gain, 1.0)
    ratio = (base + np.sqrt(base * base + 4.0 * rest * gain * extra)) / (2.0 * rest)
    return np.where(steady, ratio, np.nan), steady


def machine_budget(
    machine: MachineOrBatch,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_m: FloatArray,
    *,
    loss: MachineLoss = NO_EXTRA_LOSS,
    heat: WindingHeat | None = None,
) -> MachineBudget:
    """Losses and terminal quantities of a machine in the steady state.

    ::

        e     = j omega_e psi
              back-EMF, psi and the torque from the currents given
        i_t   = i + e P_iron / (3/2 |e|^2)              current at the terminals
        R     = r_s (r + k_ac omega_e^2 / r)            r = 1 + alpha (T_winding - T_ref)
        v     = (R + 2/3 k_m omega_e^2) i_t + e
        3/2 Re(v i_t*) = 3/2 R |i_t|^2 + k_m omega_e^2 |i_t|^2 + P_iron + T omega_m

    The magnet loss of a `LossMap` stands beside P_iron: it is a loss at the currents given, too.

    Args:
        machine: Any machine, or one per point.
        i_d, i_q, omega_m: Currents in A (peak) that make the torque, and mechanical speed in rad/s,
            of one shape (...).
        loss: AC copper, iron and magnet loss.
        heat: How warm the winding becomes; None keeps r_s. Only the copper loss of the fundamental
            heats it.

    Returns:
        MachineBudget
    """
    omega_e = machine.pole_pairs * omega_m
    psi_d, psi_q = machine.flux(i_d, i_q)
    square = psi_d * psi_d + psi_q * psi_q
    iron, in_magnets = loss.core_losses(i_d, i_q, square, omega_e)
    # e P / (3/2 |e|^2) with e = j omega psi: of the loss by |psi|^2 the flux linkage cancels.
    turning = np.where(omega_e == 0.0, 1.0, omega_e)
    if loss.mapped is None:
        conductance = np.where(omega_e == 0.0, 0.0, loss.iron_factor(omega_e) / (1.5 * turning))
    else:
        still = (omega_e == 0.0) | (square == 0.0)
        per_flux = (iron + in_magnets) / np.where(still, 1.0, 1.5 * turning * square)
        conductance = np.where(still, 0.0, per_flux)
    t_d, t_q = i_d - conductance * psi_q, i_q + conductance * psi_d
    current = t_d * t_d + t_q * t_q
    extra = loss.ac_copper * omega_e * omega_e
    steady = np.ones(current.shape, dtype=np.bool_)
    ratio, temperature = np.ones(current.shape), np.full(current.shape, np.nan)
    if heat is not None:
        ratio, steady = warm_ratio(heat, 1.5 * machine.r_s * current, extra)
        temperature = (
            heat.coolant_temperature
            + heat.thermal_resistance * 1.5 * machine.r_s * current * (ratio + extra / ratio)
        )
    resistance = machine.r_s * (ratio + extra / ratio)
    series = resistance + loss.magnet * omega_e * omega_e / 1.5
    torque = torque_from_flux(machine.pole_pairs, psi_d, psi_q, i_d, i_q)
    return MachineBudget(
        torque=torque,
        shaft_power=torque * omega_m,
        copper=1.5 * resistance * current,
        iron=iron,
        magnet=loss.magnet * omega_e * omega_e * current + in_magnets,
        resistance=resistance,
        winding_temperature=temperature,
        steady=steady,
        i_d=t_d,
        i_q=t_q,
        v_d=series * t_d - omega_e * psi_q,
        v_q=series * t_q + omega_e * psi_d,
    )


# Losses and junction temperature of the inverter bridge.
#
# Averages over an electrical period at each operating point; the ripple of the currents, the dead
# time, the losses of the gate drivers and the rise and fall of the junction temperature within the
# period are left out.
#
# Sources: paper 000 (10) and (11), written with the peak current; A. M. Hava, R. J. Kerkman, T. A.
# Lipo, "Simple analytical and graphical methods for carrier-based PWM-VSI drives", IEEE
# Transactions on Power Electronics 14(1), 1999, doi:10.1109/63.737592 (switching loss of
# discontinuous modulators).

# Junction temperature in degC at which `SwitchDevice.on_resistance` is given.
REFERENCE_TEMPERATURE = 25.0
SWITCH_POSITIONS = 6  # Switch positions of the bridge, which share its losses equally.

# Points evaluated at once: some ten arrays of 4096 x 24 angles x 3 phases are 24 MB.
_CHUNK = 4096


@dataclass(frozen=True, slots=True)
class BridgeLoad:
    """Losses of the bridge in W before its temperature is known, arrays of the shape (...).

    Args:
        threshold: Conduction loss that does not depend on temperature: threshold voltages, and the
            resistance of the diodes.
        resistive: Conduction loss in the on resistance of the transistors at 25 degC.
        switching: Switching loss.
    """

    threshold: FloatArray
    resistive: FloatArray
    switching: FloatArray


def required_device(inverter: Inverter) -> SwitchDevice:
    """Device of the inverter; an `InputError` if the inverter has none."""
    if inverter.device is None:
        raise InputError(
            "inverter: losses need the data of the switches, but no device is given; add the "
            "device data"
        )
    return inverter.device


def junction_temperature(inverter: Inverter, loss: FloatArray) -> FloatArray:
    """Junction temperature in degC for inverter losses in W, any shape: T_coolant + R_th P / 6.

    Args:
        inverter: Temperature of the coolant and thermal resistance of a switch.
        loss: Losses P of the whole inverter in W, any shape.
    """
    device = required_device(inverter)
    return inverter.coolant_temperature + device.thermal_resistance / SWITCH_POSITIONS * loss


@dataclass(frozen=True, slots=True)
class BridgeLosses:
    """Losses of the bridge at its junction temperature, arrays of the shape (...).

    Args:
        conduction, switching: Losses of all six switch positions in W.
        junction_temperature: Average junction temperature of a switch position in degC.
        thermal_residual: Junction temperature minus the temperature that its losses lead to, in K.
        thermally_stable: False where there is no steady state (thermal runaway); conduction loss
            and temperature are NaN there.
    """

    conduction: FloatArray
    switching: FloatArray
    junction_temperature: FloatArray
    thermal_residual: FloatArray
    thermally_stable: BoolArray


def resistance_factor(device: SwitchDevice, junction_temperature: FloatArray) -> FloatArray:
    """On resistance at a junction temperature in degC, any shape, relative to that at 25 degC:
    1 + alpha (T - 25).

    Args:
        device: The switch, with its temperature coefficient alpha in 1/K.
        junction_temperature: Temperature T in degC, any shape.
    """
    return 1.0 + device.on_resistance_temperature_coefficient * (
        junction_temperature - REFERENCE_TEMPERATURE
    )


def _mosfet_conduction(device: SwitchDevice, wave: PhaseWaveforms) -> tuple[FloatArray, FloatArray]:
    """Threshold and resistive conduction loss in W: one of the two channels of a phase
    always carries its current.
    """
    resistive = device.on_resistance * wave.phase_sum(wave.current**2)
    return np.zeros_like(resistive), resistive


def _igbt_conduction(device: SwitchDevice, wave: PhaseWaveforms) -> tuple[FloatArray, FloatArray]:
    """Threshold and resistive conduction loss in W: the transistor of one rail,
    the diode of the other.
    """
    duty = wave.modulation.duty
    share = np.where(wave.current > 0.0, duty, 1.0 - duty)
    magnitude, square = np.abs(wave.current), wave.current**2
    diode = device.diode_voltage * magnitude + device.diode_resistance * square
    threshold = wave.phase_sum(share * device.on_voltage * magnitude + (1.0 - share) * diode)
    return threshold, device.on_resistance * wave.phase_sum(share * square)


def _switching_loss(inverter: Inverter, device: SwitchDevice, wave: PhaseWaveforms) -> FloatArray:
    """Switching loss in W: one turn-on and one turn-off per carrier period and phase,
    while it is not clamped.
    """
    energy = (
        device.switching_energy
        / (device.reference_current * device.reference_voltage)
        * inverter.v_dc
    )
    return (
        inverter.f_sw
        * energy
        * wave.phase_sum(np.where(wave.modulation.clamped, 0.0, np.abs(wave.current)))
    )


def _chunk_load(inverter: Inverter, device: SwitchDevice, wave: PhaseWaveforms) -> FloatArray:
    """Threshold, resistive and switching loss in W as rows, shape (3, n) for n points."""
    conduction = _mosfet_conduction if device.kind == "mosfet" else _igbt_conduction
    return np.stack([*conduction(device, wave), _switching_loss(inverter, device, wave)])


def bridge_load(
    inverter: Inverter,
    modulation: ModulationName,
    v_d: ArrayLike,
    v_q: ArrayLike,
    i_d: ArrayLike,
    i_q: ArrayLike,
) -> BridgeLoad:
    """Conduction and switching losses of the bridge at 25 degC.

    ::

        MOSFET     P_cond = 3 R <i^2> = 3/2 R |i|^2
                   (synchronous rectification)
        IGBT       P_cond = 3 < s (V_CE0 |i| + r_CE i^2) + (1 - s) (V_F0 |i| + r_F i^2) >
                   with s = u where i > 0, and s = 1 - u elsewhere; u the duty cycle of the upper
                   switch
        switching  P_sw
                   = 3 f_sw (E_on + E_off + E_rr) / (I_ref V_ref) v_dc < |i|, 0 where clamped >

    where < > is the average over an electrical period, to rounding (`sector_waveforms`).

    Args:
        inverter: With the data of its device.
        modulation: The modulator.
        v_d, v_q, i_d, i_q: Phase voltages in V and currents in A in rotor coordinates (peak),
            broadcastable to the shape (...). Beyond the linear range of the modulator the
            conduction loss of an IGBT bridge has no meaning.

    Returns:
        Arrays of the shape (...).
    """
    device = required_device(inverter)
    points = np.broadcast_arrays(
        *(np.asarray(value, dtype=np.float64) for value in (v_d, v_q, i_d, i_q))
    )
    flat = np.stack([value.ravel() for value in points])
    method = overmodulation_of(inverter, modulation)
    chunks = []
    for start in range(0, max(flat.shape[1], 1), _CHUNK):
        part = flat[:, start : start + _CHUNK]
        wave = sector_waveforms(
            modulation, part[0], part[1], part[2], part[3], inverter.v_dc, method
        )
        chunks.append(_chunk_load(inverter, device, wave))
    load = np.concatenate(chunks, axis=-1).reshape(3, *points[0].shape)
    return BridgeLoad(threshold=load[0, ...], resistive=load[1, ...], switching=load[2, ...])


def thermal_gain(inverter: Inverter, load: BridgeLoad) -> FloatArray:
    """Rise of the junction temperature per kelvin of its rise, R_th / 6 alpha P_resistive,
    shape (...).

    Each kelvin raises the losses, which raise the temperature by this many kelvins again:
    from 1 on it runs away.

    Args:
        inverter: Thermal resistance R_th in K/W and temperature coefficient alpha in 1/K.
        load: Loss of the resistances in W among the losses of the bridge, shape (...).
    """
    device = required_device(inverter)
    alpha = device.on_resistance_temperature_coefficient
    return device.thermal_resistance / SWITCH_POSITIONS * alpha * load.resistive


def thermal_balance(inverter: Inverter, load: BridgeLoad) -> BridgeLosses:
    """Losses at the junction temperature that they lead to.

    The on resistance is linear in the temperature, so that the fixed point of

        T = T_coolant + R_th / 6 (P_threshold + P_switching + P_resistive (1 + alpha (T - 25)))

    is found in one step. Each of the six positions is given a sixth of the losses and its
    own `thermal_resistance`.

    Args:
        inverter: With the data of its device.
        load: Losses at 25 degC from `bridge_load`, arrays of the shape (...).

    Returns:
        Arrays of the shape (...).
    """
    device = required_device(inverter)
    at_reference = junction_temperature(inverter, load.threshold + load.resistive + load.switching)
    gain = thermal_gain(inverter, load)
    stable = np.asarray(gain < 1.0)
    rise = (at_reference - REFERENCE_TEMPERATURE) / np.where(stable, 1.0 - gain, 1.0)
    temperature = np.where(stable, REFERENCE_TEMPERATURE + rise, np.nan)
    conduction = load.threshold + load.resistive * resistance_factor(device, temperature)
    return BridgeLosses(
        conduction=np.asarray(conduction),
        switching=load.switching,
        junction_temperature=temperature,
        thermal_residual=temperature - junction_temperature(inverter, conduction + load.switching),
        thermally_stable=stable,
    )
