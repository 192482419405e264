"""The design file as a schema: every key with its meaning, unit and default.

The models hold what the file says; `dqforge.machines.loader` turns it into a `dqforge.machines.design.Design`.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from dqforge.machines.inverter import Topology
from dqforge.machines.schema_device import DeviceEntry
from dqforge.machines.schema_entries import (
    About,
    Bandwidth,
    ByteCount,
    ControlFormats,
    Current,
    CurrentGain,
    CurrentIntegralGain,
    DeadTime,
    FileName,
    FilterTime,
    GainFormats,
    Listing,
    Name,
    OnResistance,
    PhaseCurrent,
    PhaseMargin,
    PointSpeed,
    PointTorque,
    Prefix,
    Rate,
    Ratio,
    ResistanceRatio,
    Section,
    Share,
    SlewRate,
    SmallShare,
    Speed,
    SpeedGain,
    SpeedIntegralGain,
    Temperature,
    Torque,
    Version,
    Voltage,
)
from dqforge.machines.schema_machine import MachineSection
from dqforge.machines.schema_simulation import SimulationSection
from dqforge.machines.schema_tolerances import TolerancesSection
from dqforge.machines.settings import (
    BreakpointMode,
    ChoiceSettings,
    Core,
    CurrentLoopMethod,
    CurrentLoopSettings,
    ExportSettings,
    FitForm,
    FitMethod,
    FitSettings,
    LossSettings,
    LossStrategy,
    ModulationName,
    NumberFormat,
    ObserverMethodName,
    ObserverTuningName,
    OpenPhase,
    OperationSettings,
    SpeedLoopMethod,
    SpeedLoopSettings,
    Strategy,
    WaveformForm,
    WaveformSettings,
    WeakeningSettings,
)

FORMAT_VERSION = 1

_OPERATION = OperationSettings()
_FIT = FitSettings()
_CURRENT = CurrentLoopSettings()
_SPEED = SpeedLoopSettings()
_WAVEFORM = WaveformSettings()
_WEAKENING = WeakeningSettings(omega_m=1.0)
_LOSSES = LossSettings(points=())
_CHOICE = ChoiceSettings(f_min=1.0, f_max=1.0, omega_m=1.0)
_EXPORT = ExportSettings(prefix="motor")


class InverterSection(Section):
    """The inverter."""

    topology: Topology = Field(
        default="three-wire", description="three-wire: two-level bridge, star point not connected"
    )
    v_dc: Voltage = Field(description="DC-link voltage (V)")
    switching_frequency: Rate = Field(description="carrier frequency (Hz)")
    dead_time: DeadTime | None = Field(default=None, description="dead time (s); default 0")
    max_current: PhaseCurrent | None = Field(
        default=None, description="largest phase current (A); kind peak (default) or rms"
    )
    coolant_temperature: Temperature | None = Field(
        default=None,
        description="temperature that thermal_resistance refers to (degC, also without a unit); default 25",
    )
    capacitor_esr: OnResistance | None = Field(
        default=None,
        description="series resistance of the DC-link capacitor (Ohm) for loss maps and missions; default 0",
    )
    device: DeviceEntry | None = Field(
        default=None, description="the switch, needed for losses: its constants, or a file or name of the library"
    )


class CurrentLoopSection(Section):
    """PI current controllers of both axes."""

    method: CurrentLoopMethod = Field(default=_CURRENT.method, description="how the gains are found")
    bandwidth: Bandwidth | None = Field(
        default=None, description="for bandwidth and damping (there the natural frequency): in Hz or rad/s"
    )
    damping: float = Field(default=_CURRENT.damping, gt=0.0, le=10.0, description="damping ratio, for damping")
    spread: float = Field(default=_CURRENT.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum")
    kp: CurrentGain | None = Field(default=None, description="for given: proportional gain (V/A)")
    ki: CurrentIntegralGain | None = Field(default=None, description="for given: integral gain (V/(A s))")
    phase_margin_min: PhaseMargin | None = Field(
        default=None, description="least phase margin (rad; write deg); default 30 deg"
    )
    q_formats: GainFormats | None = Field(
        default=None, description="fractional bits of the per-unit integers kp and ki t_s, such as [10, 15], or auto"
    )
    max_sensitivity: float = Field(
        default=_CURRENT.max_sensitivity,
        ge=1.05,
        le=4.0,
        description="for optimised: largest M_s within the tolerances",
    )
    schedule: bool = Field(
        default=_CURRENT.schedule, description="gains over the current, for machines that saturate: a header of its own"
    )


class SpeedLoopSection(Section):
    """PI speed controller that commands torque."""

    method: SpeedLoopMethod = Field(default=_SPEED.method, description="how the gains are found")
    ratio: int = Field(default=_SPEED.ratio, ge=1, le=100_000, description="current samples per speed sample")
    bandwidth: Bandwidth | None = Field(
        default=None, description="for bandwidth and damping (there the natural frequency): in Hz or rad/s"
    )
    damping: float = Field(default=_SPEED.damping, gt=0.0, le=10.0, description="damping ratio, for damping")
    spread: float = Field(default=_SPEED.spread, gt=1.0, le=100.0, description="a of the symmetrical optimum")
    filter_time: FilterTime | None = Field(default=None, description="first-order filter on the speed (s); default 0")
    kp: SpeedGain | None = Field(default=None, description="for given: proportional gain (N m s/rad)")
    ki: SpeedIntegralGain | None = Field(default=None, description="for given: integral gain (N m/rad)")
    phase_margin_min: PhaseMargin | None = Field(
        default=None, description="least phase margin (rad; write deg); default 30 deg"
    )
    q_formats: GainFormats | None = Field(
        default=None, description="fractional bits of the per-unit integers kp and ki t_s, such as [10, 10], or auto"
    )
    max_sensitivity: float = Field(
        default=_SPEED.max_sensitivity, ge=1.05, le=4.0, description="for optimised: largest M_s within the tolerances"
    )


class ObserverSection(Section):
    """Speed or position observer."""

    method: ObserverMethodName = Field(default="reduced-order", description="how speed or position is observed")
    pole: Bandwidth | None = Field(
        default=None, description="for reduced-order: the pole lies at -pole (rad/s, or Hz times 2 pi)"
    )
    bandwidth: Bandwidth | None = Field(
        default=None, description="of the EMF filter or of the flux correction at rest (rad/s, or Hz times 2 pi)"
    )
    pll_bandwidth: Bandwidth | None = Field(
        default=None, description="natural frequency of the phase-locked loop (rad/s, or Hz times 2 pi)"
    )
    damping: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None, description="damping ratio of the phase-locked loop; default 1"
    )
    speed_gain: Annotated[float, Field(ge=0.0, le=10.0)] | None = Field(
        default=None, description="for flux and open-loop-flux: share of the speed in the correction of the flux"
    )
    tuning: ObserverTuningName = Field(
        default="named", description="named: what is left open has its usual value; optimised: it is searched for"
    )


class PerUnitSection(Section):
    """Bases of the per-unit gains."""

    current: PhaseCurrent | None = Field(default=None, description="base current (A); default the current limit")
    voltage: Voltage | None = Field(default=None, description="base voltage (V, peak of phase); default v_dc/sqrt(3)")
    speed: Speed | None = Field(
        default=None, description="base mechanical speed (rad/s; write rpm); default the largest speed"
    )
    torque: Torque | None = Field(
        default=None, description="base torque (N m); default 3/2 p psi_pm times the base current"
    )


class ControlSection(Section):
    """Sampling and controllers."""

    sampling_frequency: Rate | None = Field(
        default=None, description="sampling of the current control (Hz); default the switching frequency"
    )
    current_loop: CurrentLoopSection = Field(default=CurrentLoopSection(), description="current controllers")
    speed_loop: SpeedLoopSection | None = Field(default=None, description="speed controller, if one is wanted")
    observer: ObserverSection | None = Field(default=None, description="speed observer, if one is wanted")
    per_unit: PerUnitSection = Field(default=PerUnitSection(), description="bases of the per-unit gains")
    tolerances: TolerancesSection | None = Field(
        default=None, description="how far the drive may be from its data; every loop must hold throughout"
    )
    gains: bool = Field(default=True, description="false: no loops are tuned, the header holds the references alone")


class OperationSection(Section):
    """Which currents make the torque."""

    strategy: Strategy = Field(default="mtpa", description="mtpa: least current for the torque; id0: no d current")
    speed: Speed | None = Field(
        default=None, description="mechanical speed for which the field is weakened (rad/s; write rpm); default: none"
    )
    modulation: ModulationName = Field(
        default=_OPERATION.modulation, description="whose linear range limits the voltage at the speed"
    )
    voltage_margin: Share | None = Field(
        default=None, description="share of that voltage kept free for control (write 5 %); default 0"
    )


class FitSection(Section):
    """How the current references become code."""

    form: FitForm = Field(default=_FIT.form, description="what is evaluated on the controller")
    method: FitMethod = Field(default=_FIT.method, description="how the coefficients are found")
    format: NumberFormat | None = Field(
        default=None,
        description="numbers of the evaluator: float32, or q15 and q31 with polynomials over control.per_unit; "
        "default float32, with a budget the cheapest",
    )
    degree: int = Field(default=_FIT.degree, ge=1, le=6, description="degree of the polynomials")
    segments: int = Field(default=_FIT.segments, ge=1, le=4, description="number of segments")
    breakpoint_mode: BreakpointMode = Field(
        default=_FIT.breakpoint_mode, description="one set of breakpoints, or one per axis"
    )
    exact_at_zero: bool = Field(default=_FIT.exact_at_zero, description="no current at zero torque")
    continuous: bool = Field(default=_FIT.continuous, description="no step at the breakpoints")
    flat_at_zero: bool = Field(default=_FIT.flat_at_zero, description="no linear term of i_d at zero torque")
    torque_max: Torque | None = Field(
        default=None, description="end of the domain (N m); default the largest torque within the current limit"
    )
    breakpoints: Listing[Torque] | None = Field(
        default=None, description="segments - 1 ascending torques (N m); default: searched for"
    )
    torque_error: SmallShare | None = Field(
        default=None, description="budget: largest torque error over the largest torque (write 0.2 %)"
    )
    loss_penalty: SmallShare | None = Field(
        default=None, description="budget: largest copper loss above the least, from 5 % torque up (write 0.1 %)"
    )
    core: Core = Field(default=_FIT.core, description="whose cycles the choice by a budget counts")
    flash: ByteCount | None = Field(default=None, ge=8, le=100_000, description="budget: bytes of constants (256 B)")


class PointSection(Section):
    """One operating point."""

    torque: PointTorque = Field(description="torque (N m)")
    speed: PointSpeed = Field(description="mechanical speed (rad/s; write rpm)")


class LossSection(Section):
    """Which alternatives are compared, and where."""

    points: Annotated[Listing[PointSection], Field(min_length=1, max_length=1000)] = Field(
        default=(), description="operating points, a list of {torque: ..., speed: ...}"
    )
    mission: FileName | None = Field(
        default=None,
        description="text file beside the design with time, speed and torque, over which energy is counted",
    )
    strategies: Annotated[Listing[LossStrategy], Field(min_length=1, max_length=10)] = Field(
        default=_LOSSES.strategies, description="strategies to compare: mtpa, id0, least-loss"
    )
    modulations: Annotated[Listing[ModulationName], Field(min_length=1, max_length=12)] = Field(
        default=_LOSSES.modulations, description="modulations to compare"
    )


class WaveformSection(Section):
    """Phase currents of a machine whose back-EMF is not sinusoidal."""

    torque: Torque | None = Field(default=None, description="torque of the comparison (N m); default: most of dq")
    speed: Speed | None = Field(
        default=None, description="its mechanical speed (rad/s; write rpm); default: base speed"
    )
    ripple: Share | None = Field(default=None, description="permitted deviation of the torque (write 5 %); default 0")
    neutral_current: Current | None = Field(default=None, description="largest neutral current (A); default: none")
    open_phase: OpenPhase | None = Field(default=None, description="a phase that carries no current: a, b or c")
    slew_rate: SlewRate | None = Field(default=None, description="largest rate of change of a current (A/s)")
    form: WaveformForm = Field(default=_WAVEFORM.form, description="what the firmware evaluates")
    error: SmallShare | None = Field(default=None, description="largest error of it over the peak; default 0.5 %")


class WeakeningSection(Section):
    """Current references over torque, voltage and speed, for field weakening."""

    speed: Speed | None = Field(
        default=None, description="largest mechanical speed (rad/s; write rpm); default machine.max_speed"
    )
    torque_error: SmallShare | None = Field(
        default=None, description="largest torque error over the largest torque; default 0.5 %"
    )
    voltage_excess: SmallShare | None = Field(
        default=None, description="largest excess over the voltage limit and over the current limit; default 0.5 %"
    )
    flash: ByteCount = Field(
        default=_WEAKENING.flash, ge=256, le=100_000, description="largest number of bytes of code and constants"
    )


class BandSection(Section):
    """A band of frequencies."""

    min: Rate = Field(description="its lower end (Hz)")
    max: Rate = Field(description="its upper end (Hz)")


class ChoiceSection(Section):
    """Modulator and switching frequency that lose least over torque and speed, and a rule for the firmware."""

    min_frequency: Rate = Field(description="least switching frequency (Hz), for noise and control")
    max_frequency: Rate = Field(description="largest switching frequency (Hz)")
    avoid: Annotated[Listing[BandSection], Field(max_length=10)] = Field(
        default=(), description="bands of switching frequencies that are not used, a list of {min: ..., max: ...}"
    )
    modulations: Annotated[Listing[ModulationName], Field(min_length=1, max_length=12)] = Field(
        default=_CHOICE.modulations, description="modulators to choose from; default all"
    )
    strategy: Strategy | None = Field(default=None, description="whose currents flow; default operation.strategy")
    speed: Speed | None = Field(
        default=None, description="largest mechanical speed (rad/s; write rpm); default machine.max_speed"
    )
    ripple_current: Current | None = Field(
        default=None, description="largest ripple of a phase current (A, r.m.s.); default: any"
    )
    ripple_share: Share | None = Field(
        default=None, description="the same as a share of the r.m.s. current limit (write 2 %), instead"
    )
    max_junction_temperature: Temperature | None = Field(
        default=None, description="largest junction temperature (degC, also without a unit); default the device's"
    )
    carrier_ratio: Ratio | None = Field(
        default=None, description="least number of carrier periods in an electrical period; default 20"
    )
    ripple_resistance: ResistanceRatio | None = Field(
        default=None,
        description="winding resistance at the switching frequency over that of the fundamental; default 1",
    )
    torques: int = Field(default=_CHOICE.torques, ge=2, le=60, description="torques of the grid")
    speeds: int = Field(default=_CHOICE.speeds, ge=2, le=60, description="speeds of the grid")
    frequencies: int = Field(
        default=_CHOICE.frequencies,
        ge=2,
        le=16,
        description="switching frequencies that the search for a rule begins with",
    )
    questions: int = Field(
        default=_CHOICE.questions, ge=0, le=2, description="questions that the rule in the header may ask"
    )


class ExportSection(Section):
    """The header."""

    prefix: Prefix = Field(default=_EXPORT.prefix, description="first part of every name in the code, a C identifier")
    vectors: int = Field(default=_EXPORT.vectors, ge=16, le=4096, description="least number of test vectors")
    control: ControlFormats = Field(
        default=_EXPORT.control, description="control functions as C: float32, q15, q31 or a list of them; default none"
    )


class DesignFile(Section):
    """Design of a motor drive: machine, inverter, control, and what is to be generated."""

    dqforge: Version = Field(description="version of this format")
    name: Name = Field(description="one line that names the design, at most 80 characters")
    about: About = Field(default="", description="a paragraph on the design")
    machine: MachineSection
    inverter: InverterSection
    control: ControlSection = ControlSection()
    operation: OperationSection = OperationSection()
    fit: FitSection = FitSection()
    losses: LossSection | None = Field(default=None, description="loss comparison, if one is wanted")
    waveform: WaveformSection = Field(
        default=WaveformSection(), description="phase currents, for machine.model waveform"
    )
    field_weakening: WeakeningSection | None = Field(
        default=None, description="two-dimensional current references, if they are wanted"
    )
    modulation_choice: ChoiceSection | None = Field(
        default=None, description="choice of modulator and switching frequency, if it is wanted"
    )
    simulation: SimulationSection | None = Field(
        default=None, description="simulation in the time domain, if one is wanted"
    )
    export: ExportSection = ExportSection()


_SIMPLE = (str, int, float, list)  # defaults worth showing; those of whole sections repeat their keys


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the design file, for editors and for documentation."""
    schema: dict[str, Any] = _tidied(DesignFile.model_json_schema())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "dqforge design file"} | schema


def _tidied(schema: Any) -> Any:
    """Schema without generated titles and without null, which the reader refuses."""
    if isinstance(schema, list):
        return [_tidied(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    tidy: dict[str, Any] = {}
    for key, value in schema.items():
        if (key == "title" and isinstance(value, str)) or (key == "default" and not isinstance(value, _SIMPLE)):
            continue
        if key == "anyOf":
            choices = [choice for choice in value if choice != {"type": "null"}]
            # An optional entry with several forms arrives as a choice within a choice.
            tidy |= _tidied(choices[0]) if len(choices) == 1 else {"anyOf": _tidied(choices)}
        else:
            tidy[key] = _tidied(value)
    return tidy
