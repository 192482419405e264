"""The sections ``control.current_loop`` and ``control.speed_loop``: what may be written, and which
keys a method needs.
"""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import Field

from dqforge.machines.design.sections.speed_measurement import (
    SpeedMeasurementSection,
)
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    SpeedLoopSettings,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.entries.former_keys import former
from dqforge.machines.entries.kinds import (
    Bandwidth,
    Current,
    CurrentGain,
    CurrentIntegralGain,
    FilterTime,
    GainFormats,
    PhaseMargin,
    Rate,
    Section,
    SpeedGain,
    SpeedIntegralGain,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    AxisGainRule,
    CurrentFrame,
    CurrentLoopMethod,
    Feedforward,
    SpeedLoopMethod,
    VendorMethod,
)
from dqforge.machines.places import KeyPath

_CURRENT = CurrentLoopSettings()


_SPEED = SpeedLoopSettings()


ComparatorBand = Annotated[Quantity, QuantityRule("voltage", 0.0, 2e4)]


class CurrentLoopSection(Section):
    """PI current controllers of both axes."""

    method: CurrentLoopMethod = Field(
        default=_CURRENT.method, description="how the gains are found"
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="for bandwidth and damping (there the natural frequency): in Hz or rad/s",
    )
    damping: float = Field(
        default=_CURRENT.damping, gt=0.0, le=10.0, description="damping ratio, for damping"
    )
    spread: float = Field(
        default=_CURRENT.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum"
    )
    kp: CurrentGain | None = Field(default=None, description="for given: proportional gain (V/A)")
    ki: CurrentIntegralGain | None = Field(
        default=None, description="for given: integral gain (V/(A s))"
    )
    min_phase_margin: PhaseMargin | None = Field(
        default=None,
        json_schema_extra=former("phase_margin_min"),
        description="least phase margin (rad; write deg); default 30 deg",
    )
    q_formats: GainFormats | None = Field(
        default=None,
        description=(
            "fractional bits of the per-unit integers kp and ki t_s, such as [10, 15], or auto"
        ),
    )
    max_sensitivity: float = Field(
        default=_CURRENT.max_sensitivity,
        ge=1.05,
        le=4.0,
        description="for optimised: largest M_s within the tolerances",
    )
    schedule: bool = Field(
        default=_CURRENT.schedule,
        description="gains over the current, for machines that saturate: a header of its own",
    )
    frame: CurrentFrame | None = Field(
        default=_CURRENT.frame,
        description=(
            "for machines of model: waveform: dq (sinusoidal references), dqx, dqy, or table "
            "(references over the angle); default: what the machine asks for"
        ),
    )
    feedforward: Feedforward = Field(
        default=_CURRENT.feedforward,
        description=(
            "for machines of model: waveform, what is added to the PI: references (their whole "
            "voltage), emf, measured (back-EMF, and coupling of measured currents) or none"
        ),
    )
    axis_gains: AxisGainRule = Field(
        default=_CURRENT.axis_gains,
        description=(
            "for machines of model: waveform: own gains for the zero-sequence axis, or one set"
        ),
    )
    harmonic_integrators: bool = Field(
        default=_CURRENT.harmonic_integrators,
        description=(
            "for machines of model: waveform: integrators that turn with the harmonics of dead "
            "time and back-EMF"
        ),
    )
    limited_waveforms: bool = Field(
        default=_CURRENT.limited_waveforms,
        description=(
            "for machines of model: waveform, frame table: currents over torque, speed and angle "
            "where the link limits them, instead of less torque"
        ),
    )
    band: Current | None = Field(
        default=None,
        description=(
            "for hysteresis, circle and look-up-table: half of the tolerance band, the radius of "
            "the circle (A); default v_dc/(8 L f_sw)"
        ),
    )
    outer_band: Current | None = Field(
        default=None,
        description="for look-up-table: error that it takes for a transient (A); default 2 band",
    )
    carrier: Rate | None = Field(
        default=None,
        description="for ramp-comparison: frequency of the triangle (Hz); default f_sw",
    )
    comparator_band: ComparatorBand | None = Field(
        default=None,
        description="for ramp-comparison: hysteresis of its comparators (V); default 0",
    )
    sampling: Rate | None = Field(
        default=None,
        description=(
            "for look-up-table, circle, predictive and trajectory: sampling of the currents (Hz); "
            "default 10 f_sw, of trajectory 2 f_sw"
        ),
    )
    pulses: Annotated[int, Field(ge=3, le=25)] | None = Field(
        default=None,
        description="for trajectory: most pulses of a leg per electrical period, odd; default 15",
    )


class SpeedLoopSection(Section):
    """PI speed controller that commands torque."""

    method: SpeedLoopMethod = Field(default=_SPEED.method, description="how the gains are found")
    ratio: int = Field(
        default=_SPEED.ratio, ge=1, le=100_000, description="current samples per speed sample"
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="for bandwidth and damping (there the natural frequency): in Hz or rad/s",
    )
    damping: float = Field(
        default=_SPEED.damping, gt=0.0, le=10.0, description="damping ratio, for damping"
    )
    spread: float = Field(
        default=_SPEED.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum"
    )
    filter_time: FilterTime | None = Field(
        default=None, description="first-order filter on the speed (s); default 0"
    )
    kp: SpeedGain | None = Field(
        default=None, description="for given: proportional gain (N m s/rad)"
    )
    ki: SpeedIntegralGain | None = Field(
        default=None, description="for given: integral gain (N m/rad)"
    )
    min_phase_margin: PhaseMargin | None = Field(
        default=None,
        json_schema_extra=former("phase_margin_min"),
        description="least phase margin (rad; write deg); default 30 deg",
    )
    q_formats: GainFormats | None = Field(
        default=None,
        description=(
            "fractional bits of the per-unit integers kp and ki t_s, such as [10, 10], or auto"
        ),
    )
    max_sensitivity: float = Field(
        default=_SPEED.max_sensitivity,
        ge=1.05,
        le=4.0,
        description="for optimised: largest M_s within the tolerances",
    )
    measurement: SpeedMeasurementSection | None = Field(
        default=None,
        description="how the speed is measured; default: taken as exact, without delay",
    )


_EXAMPLES: dict[tuple[str | int, str], str] = {
    ("current_loop", "bandwidth"): "500 Hz",
    ("current_loop", "kp"): "1.1 V/A",
    ("current_loop", "ki"): "32 V/(A s)",
    ("speed_loop", "bandwidth"): "20 Hz",
    ("speed_loop", "kp"): "0.1 N m s/rad",
    ("speed_loop", "ki"): "6 N m/rad",
}


def _needed(loop: CurrentLoopSection | SpeedLoopSection) -> tuple[str, ...]:
    """The keys that a method cannot do without.

    TI makes the gains of the speed loop of the bandwidth of the current loop.
    """
    if loop.method == "given":
        return ("kp", "ki")
    if loop.method == "ti" and isinstance(loop, SpeedLoopSection):
        return ()
    named = ("bandwidth", "damping", *get_args(VendorMethod))
    return ("bandwidth",) if loop.method in named else ()


def check_method(
    loop: CurrentLoopSection | SpeedLoopSection, path: KeyPath, document: YamlDocument
) -> None:
    """Check that a loop has the keys that its method needs, and no other.

    Raises `InputError` with a position.
    """
    needed = _needed(loop)
    where = ".".join(map(str, path))
    for key in needed:
        if getattr(loop, key) is None:
            example = _EXAMPLES[path[-1], key]
            raise document.error(
                f"{where}: the method '{loop.method}' needs the key '{key}'; write {key}: "
                f"{example}",
                (*path, "method"),
            )
    if loop.method == "ramp-comparison":
        return
    for key in ("bandwidth", "kp", "ki"):
        if getattr(loop, key) is not None and key not in needed:
            method = "bandwidth" if key == "bandwidth" else "given"
            raise document.error(
                f"{where}: the method '{loop.method}' does not use '{key}'; write method: "
                f"{method}, or remove the key",
                (*path, key),
                key=True,
            )
    if "max_sensitivity" in loop.model_fields_set and loop.method != "optimised":
        raise document.error(
            f"{where}: the method '{loop.method}' does not use 'max_sensitivity'; write method: "
            "optimised, or remove the key",
            (*path, "max_sensitivity"),
            key=True,
        )


def check_schedule(loop: CurrentLoopSection, machine: Machine, document: YamlDocument) -> None:
    """Check that gains over the current can be had.

    Raises `InputError` with a position.
    """
    path = ("control", "current_loop", "schedule")
    if not loop.schedule:
        return
    if isinstance(machine, LinearMachine):
        message = (
            "control.current_loop.schedule: the machine's inductances are constant, so are the "
            "gains; remove it"
        )
        raise document.error(message, path)
    if loop.method in get_args(VendorMethod):
        message = (
            f"control.current_loop.schedule: the gains by '{loop.method}' are constant in that "
            "firmware; write another method, or schedule: false"
        )
        raise document.error(message, path)
    if loop.method == "given":
        message = (
            "control.current_loop.schedule: given gains are constant; write another method, or "
            "schedule: false"
        )
        raise document.error(message, path)
