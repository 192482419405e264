"""How large the fundamental of a phase voltage may be: of the modulator where the three legs have
one to choose, else of the topology; more with overmodulation.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.modulation.modulators import in_linear_range
from dqforge.machines.modulation.registry import INSCRIBED, MODULATORS, SIX_STEP, follows_hexagon
from dqforge.machines.names import ModulationName, OvermodulationName, Topology
from dqforge.machines.topologies.regions import sine_share
from dqforge.machines.topologies.topology import TOPOLOGIES

_ROUNDING = 1e-12


_CENTRED: ModulationName = "svpwm"


def linear_share(topology: Topology, modulation: ModulationName) -> float:
    """Largest amplitude of the fundamental over the link's voltage, without overmodulation.

    Args:
        topology: The topology.
        modulation: The design's modulator, which three legs without a neutral have.
    """
    if TOPOLOGIES[topology].modulated:
        return MODULATORS[modulation].linear_limit
    return sine_share(topology)


def overmodulation_of(inverter: Inverter, modulation: ModulationName) -> OvermodulationName:
    """The method by which voltages go beyond the linear range; ``none`` where they do not.

    Args:
        inverter: Topology and method of overmodulation.
        modulation: The modulator, which must make all of the hexagon; others keep their linear
            range.
    """
    if TOPOLOGIES[inverter.topology].modulated and follows_hexagon(modulation):
        return inverter.overmodulation
    return "none"


def fundamental_share(inverter: Inverter, modulation: ModulationName) -> float:
    """Largest amplitude of the fundamental over the link's voltage: the one place that says so for
    operating points, maps, references, budgets and the emitted control.

    Args:
        inverter: Topology and overmodulation.
        modulation: As of `linear_share`.
    """
    if overmodulation_of(inverter, modulation) != "none":
        return max(INSCRIBED, inverter.overmodulation_limit * SIX_STEP)
    return linear_share(inverter.topology, modulation)


def contradiction(key: str, topology: Topology, modulation: ModulationName) -> str:
    """Why a modulator cannot be chosen, as a sentence that begins with the key; empty where it can.

    The default stands for the topology's own: it is centred likewise.

    Args:
        key: What the sentence is about.
        topology, modulation: As of `linear_share`.
    """
    if TOPOLOGIES[topology].modulated or modulation == _CENTRED:
        return ""
    return (
        f"{key}: {topology} has a modulator of its own, centred between the rails, so that "
        f"{modulation} cannot be had; leave it out"
    )


def amplitude_limit(inverter: Inverter, modulation: ModulationName, margin: float = 0.0) -> float:
    """Largest phase-voltage amplitude in V (peak) of the fundamental.

    Args:
        inverter: Topology, DC link and overmodulation.
        modulation: As of `linear_share`.
        margin: Share of 0 to 1 that is kept for control.
    """
    return fundamental_share(inverter, modulation) * inverter.v_dc * (1.0 - margin)


def amplitude_fits(
    inverter: Inverter, modulation: ModulationName, amplitude: FloatArray | float
) -> BoolArray:
    """Where a phase-voltage amplitude (V, peak, any shape) is within the linear range, or that of
    overmodulation; false for NaN.

    Args:
        inverter, modulation: As of `amplitude_limit`.
        amplitude: In V, any shape.
    """
    linear = overmodulation_of(inverter, modulation) == "none"
    if linear and TOPOLOGIES[inverter.topology].modulated:
        return in_linear_range(modulation, amplitude, inverter.v_dc)
    limit = amplitude_limit(inverter, modulation) * (1.0 + _ROUNDING)
    return np.asarray(amplitude <= limit)
