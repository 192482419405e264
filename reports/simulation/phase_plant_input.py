"""Phase machines, their topologies and what opens in them as the numbers that the compiled
simulation reads (template phase_plant.c.j2).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.topologies.topology import TOPOLOGIES

# Where the neutral ends, as the C code numbers it.
_FLOATING, _LEG, _DIODES, _MIDPOINT, _LINK = range(5)

# Rows and columns of the six entries of a symmetric matrix, in the order of the C code.
_ENTRIES = ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))
_NEGLIGIBLE = 1e-13
_NOTHING = 1e-12  # Share of the current limit below which a conductor has no current.


def harmonics_table(waveforms: FloatArray) -> FloatArray:
    """Harmonics of periodic waveforms: order, then cosine and sine of each, for every order.

    They are those of the interpolating trigonometric polynomial, without what is rounding.

    Args:
        waveforms: Values in any unit on an even grid over their period, shape (K, N).
    """
    count = waveforms.shape[1]
    spectrum = np.fft.rfft(waveforms, axis=1) * (2.0 / count)
    spectrum[:, 0] *= 0.5
    orders = np.arange((count + 1) // 2)  # without the highest, whose phase the table does not tell
    sizes = np.max(np.abs(spectrum[:, orders]), axis=0)
    kept = orders[sizes > _NEGLIGIBLE * np.max(sizes)]
    terms = np.empty((kept.size, 1 + 2 * waveforms.shape[0]))
    terms[:, 0] = kept
    terms[:, 1::2], terms[:, 2::2] = spectrum[:, kept].real.T, -spectrum[:, kept].imag.T
    return terms.reshape(-1)


def emf_table(phases: AnyPhaseMachine, scale: float = 1.0) -> FloatArray:
    """Harmonics of the back-EMF over electrical speed, of the phases a, b, c."""
    return harmonics_table(phases.flux * scale)


def inductance_table(phases: AnyPhaseMachine, scale: float = 1.0) -> FloatArray:
    """Harmonics of the inductances aa, bb, cc, bc, ca, ab; empty where they are constant."""
    if isinstance(phases, PhaseMachine):
        return np.zeros(0)
    return harmonics_table(np.stack([phases.inductance[:, j, k] for j, k in _ENTRIES]) * scale)


def duty_table(profiles: list[FloatArray]) -> FloatArray:
    """The tables of profiles one behind the other, each behind its length."""
    parts = [part for table in profiles for part in (np.array([float(table.size)]), table)]
    return np.concatenate(parts) if parts else np.zeros(0)


def constant_inductances(phases: AnyPhaseMachine) -> tuple[float, float]:
    """Self and mutual inductance in H, of salient machines the means over phases and angle."""
    if isinstance(phases, SalientPhaseMachine):
        mean = np.mean(phases.inductance, axis=0)
        own = float(np.trace(mean)) / 3.0
        return own, (float(np.sum(mean)) - 3.0 * own) / 6.0
    return phases.l_s, phases.m_s


def least_inductance(phases: AnyPhaseMachine, topology: Topology) -> float:
    """Least inductance in H of a current that the topology lets flow."""
    matrices = (
        phases.inductance
        if isinstance(phases, SalientPhaseMachine)
        else phases.inductances[np.newaxis]
    )
    if not TOPOLOGIES[topology].neutral:
        basis = np.array([[2.0, -1.0, -1.0], [0.0, math.sqrt(3.0), -math.sqrt(3.0)]])
        basis /= math.sqrt(6.0)
        matrices = basis @ matrices @ basis.T
    return float(np.min(np.linalg.eigvalsh(matrices)))


def midpoint_frequency(phases: AnyPhaseMachine, inverter: Inverter) -> float:
    """Frequency in rad/s with which the midpoint of a split link swings against the machine's zero
    sequence; 0 where the link is not split, or stiff.
    """
    if not TOPOLOGIES[inverter.topology].midpoint or inverter.midpoint_capacitance is None:
        return 0.0
    least = least_inductance(phases, inverter.topology)
    return math.sqrt(3.0 / (least * inverter.midpoint_capacitance))


def highest_order(phases: AnyPhaseMachine) -> float:
    """Highest harmonic of the back-EMF in electrical periods."""
    return float(emf_table(phases)[::7].max()) / turns_of(phases)


def turns_of(phases: AnyPhaseMachine) -> int:
    """Electrical periods after which the waveforms repeat."""
    return phases.turns


def neutral_end(topology: Topology) -> int:
    """Where the neutral ends, by the record of the topology."""
    rule = TOPOLOGIES[topology]
    if rule.diodes:
        return _DIODES
    if not rule.neutral:
        return _FLOATING
    if rule.midpoint:
        return _MIDPOINT
    return _LEG if "n" in rule.legs else _LINK


def no_phase_parameters() -> dict[str, float]:
    """Parameters of the phase plant for a machine in dq coordinates, on three legs."""
    return dict.fromkeys(
        (
            "second",
            "neutral",
            "capacitance",
            "l_own",
            "l_mutual",
            "l_neutral",
            "i_nothing",
            "open_phase",
            "open_time",
            "aware_time",
        ),
        0.0,
    ) | {"legs": 3.0, "turns": 1.0}


def phase_parameters(
    phases: AnyPhaseMachine,
    inverter: Inverter,
    topology: Topology,
    scenario: Scenario,
    i_max: float,
) -> dict[str, float]:
    """Parameters of the phase plant, the relative errors applied."""
    scale = 1.0 + scenario.errors.l_d
    own, mutual = (scale * value for value in constant_inductances(phases))
    legs, opening = TOPOLOGIES[topology].legs, scenario.open_phase
    return {
        "l_d": own - mutual,
        "l_q": own - mutual,
        "legs": float(len(legs)),
        "second": 1.0 if "a2" in legs else 0.0,
        "neutral": float(neutral_end(topology)),
        "capacitance": inverter.midpoint_capacitance or 0.0,
        "l_own": own,
        "l_mutual": mutual,
        "l_neutral": inverter.neutral_inductance,
        "turns": float(turns_of(phases)),
        "i_nothing": _NOTHING * i_max,
        "open_phase": 0.0 if opening is None else 1.0 + "abc".index(opening.phase),
        "open_time": 0.0 if opening is None else opening.time,
        "aware_time": math.inf
        if opening is None or opening.detected_after is None
        else opening.time + opening.detected_after,
    }
