"""The words that a design may use where it chooses among methods, and as
which type they are kept.
"""

from __future__ import annotations

from typing import Literal

FORMAT_VERSION = 1


Strategy = Literal["mtpa", "id0"]


MachineModel = Literal["linear", "flux-map", "saturation", "waveform"]


OpenPhase = Literal["a", "b", "c"]


Topology = Literal[
    "three-wire",
    "four-leg",
    "split-capacitor",
    "diode-neutral",
    "six-leg",
    "six-leg-isolated",
]


CurrentFrame = Literal["dq", "dqx", "dqy", "table"]

"""Where the references of a phase machine are constant and its integrators live: in dq0 with
sinusoidal references (``dq``), in dqx or dqy of paper 002, or in dq0 with references from a table
of the back-EMF over the angle (``table``)."""


Feedforward = Literal["references", "emf", "measured", "none"]

"""What a current controller of a phase machine adds to its PI: the whole voltage of the
references, the back-EMF alone, the back-EMF and the coupling of measured currents, or nothing."""


AxisGainRule = Literal["own", "one"]

"""Whether each axis has gains for its own inductance, or all axes those of d and q."""


WaveformForm = Literal["cheapest", "table", "harmonics"]


FluxAxes = Literal["magnet-d", "reluctance"]


FluxScaling = Literal["peak", "rms", "power-invariant"]


FluxTorque = Literal["air-gap", "shaft", "per-pole-pair", "ignore"]


FluxFitName = Literal["interpolate", "smooth", "auto"]


FluxSymmetry = Literal["average", "keep", "positive", "negative"]


FitMethod = Literal["lagrange", "least-squares", "minimax"]


FitForm = Literal["polynomial", "even-odd", "torque-exact", "closed-form"]


NumberFormat = Literal["float32", "q15", "q31"]


Core = Literal["cortex-m0plus", "cortex-m3", "cortex-m4", "cortex-m7", "cortex-m33"]


BreakpointMode = Literal["shared", "own"]


VendorMethod = Literal["nxp-mcat", "st-mcsdk", "vesc", "ti", "infineon", "moteus"]

"""Rules of vendors' own tools for the gains of current loops."""


VendorSpeedMethod = Literal["nxp-mcat", "ti", "infineon"]

"""The same for the speed loop; the others have none."""


CurrentLoopMethod = Literal[
    "bandwidth",
    "damping",
    "magnitude-optimum",
    "symmetrical-optimum",
    "optimised",
    "given",
    VendorMethod,
]


SpeedLoopMethod = Literal[
    "bandwidth", "damping", "symmetrical-optimum", "optimised", "given", VendorSpeedMethod
]


ObserverMethodName = Literal[
    "reduced-order",
    "extended-emf",
    "flux",
    "open-loop-flux",
    "matsui-voltage",
    "matsui-current",
    "ekf",
]


SPEED_OBSERVER: ObserverMethodName = "reduced-order"

"""The one that observes the speed behind an encoder; all others observe the position."""


OBSERVER_KEYS: dict[str, tuple[str, ...]] = {
    "reduced-order": ("pole",),
    "extended-emf": ("bandwidth", "pll_bandwidth", "damping"),
    "flux": ("bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    "open-loop-flux": ("bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    "matsui-voltage": ("bandwidth", "pll_bandwidth", "damping"),
    "matsui-current": ("bandwidth", "pll_bandwidth"),
    "ekf": (),
}

"""The keys of ``control.observer`` that a method takes beside ``method`` and ``tuning``."""


ObserverTuningName = Literal["named", "optimised"]


QFormats = tuple[int, int] | Literal["auto"]


OvermodulationName = Literal["none", "least-phase-error", "least-magnitude-error"]


ModulationName = Literal[
    "spwm",
    "thipwm6",
    "thipwm4",
    "svpwm",
    "dpwm0",
    "dpwm1",
    "dpwm2",
    "dpwm3",
    "dpwmmin",
    "dpwmmax",
    "gdpwm",
    "ddt-gdpwm",
]


Firmware = Literal["vesc", "simplefoc", "moteus", "odrive", "nxp", "st", "ti", "infineon"]

"""Firmware of others whose configuration files are written and read, and whose loops are judged."""
