"""The words that a design may use where it chooses among methods, and as
which type they are kept; records by such words, each loaded when it is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Literal, TypeVar, get_args

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

# Where the references of a phase machine are constant and its integrators live: in dq0 with
# sinusoidal references (``dq``), in dqx or dqy of paper 002, or in dq0 with references from a table
# of the back-EMF over the angle (``table``).
CurrentFrame = Literal["dq", "dqx", "dqy", "table"]

# What a current controller of a phase machine adds to its PI: the whole voltage of the references,
# the back-EMF alone, the back-EMF and the coupling of measured currents, or nothing.
Feedforward = Literal["references", "emf", "measured", "none"]

# Whether each axis has gains for its own inductance, or all axes those of d and q.
AxisGainRule = Literal["own", "one"]
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

# Rules of vendors' own tools for the gains of current loops.
VendorMethod = Literal["nxp-mcat", "st-mcsdk", "vesc", "ti", "infineon", "moteus"]

# The same for the speed loop; the others have none.
VendorSpeedMethod = Literal["nxp-mcat", "ti", "infineon"]

# Current-feedback PWM by a rule that a microcontroller evaluates at each sample.
SampledRuleName = Literal["look-up-table", "circle", "predictive"]

# Current loops that switch the bridge themselves, without a modulator in between.
FeedbackMethod = Literal["hysteresis", "ramp-comparison", "trajectory", SampledRuleName]

# Those of them whose comparators are analogue: no converter stands before them, nothing is sampled.
ANALOGUE_METHODS: tuple[FeedbackMethod, ...] = ("hysteresis", "ramp-comparison")

CurrentLoopMethod = Literal[
    "bandwidth",
    "damping",
    "magnitude-optimum",
    "symmetrical-optimum",
    "optimised",
    "given",
    VendorMethod,
    FeedbackMethod,
]

SpeedLoopMethod = Literal[
    "bandwidth", "damping", "symmetrical-optimum", "optimised", "given", VendorSpeedMethod
]

ObserverMethodName = Literal[
    "reduced-order",
    "extended-emf",
    "smo",
    "flux",
    "open-loop-flux",
    "matsui-voltage",
    "matsui-current",
    "ekf",
    "neuro-fuzzy",
    "neural",
    "injection",
    "inform",
    "inductance-mapping",
    "third-harmonic",
    "zero-crossing",
    "emf-integration",
    "diode-conduction",
]

# Methods that make the drive a six-step drive: blocks of 120 degrees, commutated by the voltage of
# the phase that floats, or by the instant from which its diode conducts.
SixStepMethod = Literal["zero-crossing", "emf-integration", "diode-conduction"]

# The one that observes the speed behind an encoder; all others observe the position.
SIX_STEP_METHODS: tuple[str, ...] = get_args(SixStepMethod)
SPEED_OBSERVER: ObserverMethodName = "reduced-order"
_FLUX_KEYS = ("bandwidth", "pll_bandwidth", "damping", "speed_gain")
_CORRECTION_KEYS = ("correction_filter", "correction_limit")

# How the speed comes from the edges of an encoder: their number in a speed period, the time between
# two of them, or their number over the time that they took.
SpeedMeasurementName = Literal["counts", "capture", "mixed"]

# Those that inject a voltage or are told more than voltage and current; they are trackers
# (`dqforge.optimizer.estimators`).
TRACKER_NAMES: tuple[ObserverMethodName, ...] = (
    "injection",
    "inform",
    "inductance-mapping",
    "third-harmonic",
)

InjectionWave = Literal["square", "sine", "rotating"]

# The keys of ``control.observer`` that a method takes beside ``method`` and ``tuning``.
OBSERVER_KEYS: dict[str, tuple[str, ...]] = {
    "reduced-order": ("pole",),
    "extended-emf": ("bandwidth", "pll_bandwidth", "damping"),
    "smo": ("bandwidth", "pll_bandwidth", "damping"),
    "flux": _FLUX_KEYS,
    "open-loop-flux": ("bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    "matsui-voltage": ("bandwidth", "pll_bandwidth", "damping"),
    "matsui-current": ("bandwidth", "pll_bandwidth"),
    "ekf": (),
    "neuro-fuzzy": (*_FLUX_KEYS, *_CORRECTION_KEYS),
    "neural": (*_FLUX_KEYS, "hidden_layers", *_CORRECTION_KEYS),
    "injection": ("wave", "voltage", "samples", "pll_bandwidth", "damping"),
    "inform": ("voltage", "period", "pll_bandwidth", "damping"),
    "inductance-mapping": ("voltage", "period", "pll_bandwidth", "damping"),
    "third-harmonic": ("bandwidth", "pll_bandwidth"),
    "zero-crossing": (),
    "emf-integration": (),
    "diode-conduction": (),
}

# Those that correct the flux observer by what they have learned.
LEARNED_OBSERVERS: tuple[ObserverMethodName, ...] = ("neuro-fuzzy", "neural")

# How a drive without encoder leaves standstill: a current or a voltage that turns, the observer
# from zero speed on, or the rotor found by its saliency; ``auto`` chooses.
ObserverTuningName = Literal["named", "optimised"]
StartUpMethodName = Literal["auto", "i-f", "v-f", "direct", "saliency"]

# How the rotor is brought to a known angle: by a regulated current at once or from a quarter turn
# away, or by a voltage.
AlignmentName = Literal["none", "one-step", "two-step", "voltage"]

# What the load does at rest: it resists motion, or turns the shaft by itself (a hoist).
StartLoadName = Literal["friction", "active"]
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

# Firmware of others whose configuration files are written and read, and whose loops are evaluated.
Firmware = Literal["vesc", "simplefoc", "moteus", "odrive", "nxp", "st", "ti", "infineon"]
Application = Literal["skeleton"]  # The program that is written around the emitted functions.


# Records of modules by a name, each module loaded when its record is first asked for.

K = TypeVar("K")
V = TypeVar("V")


class LoadedByName(Mapping[K, V]):
    """Records by name.

    Args:
        places: By name, module and attribute of the record: ``dqforge.room.module:RECORD``.
    """

    def __init__(self, places: Mapping[K, str]) -> None:
        self._places = places

    def __getitem__(self, name: K) -> V:
        module, _, attribute = self._places[name].partition(":")
        found: V = getattr(import_module(module), attribute)
        return found

    def __iter__(self) -> Iterator[K]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, name: object) -> bool:
        """Whether there is one of the name; nothing is loaded for that."""
        return name in self._places
