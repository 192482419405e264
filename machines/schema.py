"""The design file as a schema: every key with its meaning, unit and default.

The models hold what the file says; `dqforge.machines.loader` turns it into a `dqforge.machines.design.Design`.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from dqforge.machines.entries import CountRule, Quantity, QuantityRule, byte_count, not_truth, plain_text
from dqforge.machines.identifiers import check_prefix
from dqforge.machines.inverter import DeviceKind, Topology
from dqforge.machines.settings import (
    BreakpointMode,
    CurrentLoopMethod,
    CurrentLoopSettings,
    ExportSettings,
    FitForm,
    FitMethod,
    FitSettings,
    FluxAxes,
    FluxScaling,
    LossSettings,
    MachineModel,
    ModulationName,
    OpenPhase,
    OperationSettings,
    SpeedLoopMethod,
    SpeedLoopSettings,
    Strategy,
    WaveformForm,
    WaveformSettings,
)

FORMAT_VERSION = 1

_PHASE = ("phase", "line-to-line")
_PEAK = ("peak", "rms")
_OPERATION = OperationSettings()
_FIT = FitSettings()
_CURRENT = CurrentLoopSettings()
_SPEED = SpeedLoopSettings()
_WAVEFORM = WaveformSettings()
_LOSSES = LossSettings(points=())
_EXPORT = ExportSettings(prefix="motor")

_T = TypeVar("_T")
Listing = Annotated[tuple[_T, ...], Field(strict=False)]  # YAML has lists, the models hold tuples
Version = Annotated[Literal[1], BeforeValidator(not_truth)]
Name = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=80))]
About = Annotated[str, AfterValidator(partial(plain_text, limit=2000))]
Prefix = Annotated[str, AfterValidator(check_prefix)]
FileName = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=200))]
ColumnName = Annotated[str, Field(min_length=1), AfterValidator(partial(plain_text, limit=80))]
ByteCount = Annotated[int, BeforeValidator(byte_count)]
Bits = Annotated[int, Field(ge=0, le=31)]

Resistance = Annotated[Quantity, QuantityRule("resistance", 1e-6, 1e3, _PHASE, "phase")]
Inductance = Annotated[Quantity, QuantityRule("inductance", 1e-9, 10.0, _PHASE, "phase")]
Flux = Annotated[Quantity, QuantityRule("flux", 1e-6, 20.0, ("peak", "rms", "power-invariant"), "peak", zero=True)]
BackEmfConstant = Annotated[
    Quantity,
    QuantityRule(
        "back-emf", 1e-6, 1e3, ("phase peak", "phase rms", "line-to-line peak", "line-to-line rms"), zero=True
    ),
]
TorqueConstant = Annotated[Quantity, QuantityRule("torque-constant", 1e-6, 1e4, _PEAK, zero=True)]
PhaseCurrent = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5, _PEAK, "peak")]
Current = Annotated[Quantity, QuantityRule("current", 1e-3, 1e5)]
Voltage = Annotated[Quantity, QuantityRule("voltage", 1.0, 2e4)]
Drop = Annotated[Quantity, QuantityRule("voltage", 0.0, 10.0)]
Speed = Annotated[Quantity, QuantityRule("speed", 0.1, 1e5)]
PointSpeed = Annotated[Quantity, QuantityRule("speed", -1e5, 1e5)]
Torque = Annotated[Quantity, QuantityRule("torque", 1e-6, 1e7)]
PointTorque = Annotated[Quantity, QuantityRule("torque", -1e7, 1e7)]
Power = Annotated[Quantity, QuantityRule("power", 1e-2, 1e8)]
Frequency = Annotated[Quantity, QuantityRule("frequency", 0.1, 1e5)]
Rate = Annotated[Quantity, QuantityRule("frequency", 100.0, 1e7)]
DeadTime = Annotated[Quantity, QuantityRule("time", 0.0, 1e-4)]
FilterTime = Annotated[Quantity, QuantityRule("time", 0.0, 10.0)]
Inertia = Annotated[Quantity, QuantityRule("inertia", 1e-10, 1e5)]
Friction = Annotated[Quantity, QuantityRule("friction", 0.0, 1e4)]
Temperature = Annotated[Quantity, QuantityRule("temperature", -60.0, 200.0)]
Coefficient = Annotated[Quantity, QuantityRule("temperature-coefficient", -0.02, 0.05)]
OnResistance = Annotated[Quantity, QuantityRule("resistance", 1e-6, 100.0, zero=True)]
Energy = Annotated[Quantity, QuantityRule("energy", 1e-10, 100.0, zero=True)]
ThermalResistance = Annotated[Quantity, QuantityRule("thermal-resistance", 1e-4, 1e3)]
Bandwidth = Annotated[Quantity, QuantityRule("bandwidth", 0.01, 1e7)]
PhaseMargin = Annotated[Quantity, QuantityRule("angle", 0.0, 1.5707963267948966)]
CurrentGain = Annotated[Quantity, QuantityRule("current-gain", 1e-9, 1e9)]
CurrentIntegralGain = Annotated[Quantity, QuantityRule("current-integral-gain", 0.0, 1e12)]
SpeedGain = Annotated[Quantity, QuantityRule("speed-gain", 1e-12, 1e9)]
SpeedIntegralGain = Annotated[Quantity, QuantityRule("speed-integral-gain", 0.0, 1e12)]
Ratio = Annotated[Quantity, QuantityRule("number", 1.0, 100.0)]
HarmonicShare = Annotated[Quantity, QuantityRule("number", 0.0, 10.0)]
SmallShare = Annotated[Quantity, QuantityRule("number", 1e-6, 0.2)]
MutualInductance = Annotated[Quantity, QuantityRule("inductance", -10.0, 10.0)]
Angle = Annotated[Quantity, QuantityRule("angle", -6.2831853071795865, 6.2831853071795865)]
SlewRate = Annotated[Quantity, QuantityRule("current-slew", 1.0, 1e12)]
Share = Annotated[Quantity, QuantityRule("number", 0.0, 0.9)]
Nonnegative = Annotated[float, Field(ge=0.0, le=1e9, strict=False), BeforeValidator(not_truth)]
Positive = Annotated[float, Field(gt=0.0, le=1e9, strict=False), BeforeValidator(not_truth)]
PolePairs = Annotated[Quantity, CountRule(1, 200, 4)]
Poles = Annotated[Quantity, CountRule(2, 400, 8)]


class Section(BaseModel):
    """A part of the design file: immutable, without unknown keys and without silent conversions."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, arbitrary_types_allowed=True)


class RatedSection(Section):
    """Values of the name plate, used only to cross-check the others."""

    torque: Torque | None = Field(default=None, description="rated torque (N m)")
    speed: Speed | None = Field(default=None, description="rated mechanical speed (rad/s; write rpm)")
    power: Power | None = Field(default=None, description="rated mechanical power (W)")
    current: PhaseCurrent | None = Field(
        default=None, description="rated phase current (A); kind peak (default) or rms"
    )
    frequency: Frequency | None = Field(default=None, description="rated electrical frequency (Hz)")


class ColumnsSection(Section):
    """What a file calls the columns or arrays of a flux map, where their names are not recognised."""

    i_d: ColumnName | None = Field(default=None, description="name of the d current")
    i_q: ColumnName | None = Field(default=None, description="name of the q current")
    psi_d: ColumnName | None = Field(default=None, description="name of the d flux linkage")
    psi_q: ColumnName | None = Field(default=None, description="name of the q flux linkage")


class FluxMapFileSection(Section):
    """One of several flux maps of the same machine."""

    file: FileName = Field(description="file beside the design file")
    magnet_temperature: Temperature = Field(description="temperature of the magnets in this map (degC)")


class FluxMapSection(Section):
    """Flux linkages over the currents, in a file: CSV, NPZ, MAT or HDF5."""

    file: FileName | None = Field(default=None, description="file beside the design file, or in a folder below it")
    files: Annotated[Listing[FluxMapFileSection], Field(min_length=2, max_length=20)] | None = Field(
        default=None, description="several maps over the magnet temperature, in place of file"
    )
    axes: FluxAxes = Field(
        default="magnet-d",
        description="magnet-d: d along the magnets; reluctance: the magnets lie on the negative q axis",
    )
    scaling: FluxScaling = Field(
        default="peak", description="of currents and flux linkages: peak, rms, power-invariant"
    )
    current_unit: Literal["A", "mA", "kA"] | None = Field(default=None, description="where the file does not say it")
    flux_unit: Literal["Wb", "mWb", "V s", "mV s"] | None = Field(
        default=None, description="where the file does not say it"
    )
    columns: ColumnsSection = Field(default=ColumnsSection(), description="names in the file, where they are unusual")
    extrapolate: bool = Field(
        default=False, description="permit currents beyond the map; results that use them are marked"
    )


class BridgeSection(Section):
    """Magnets and their saturable bridges; the coefficients are those of Lelli et al. 2024."""

    psi_n: Nonnegative = Field(description="flux linkage at which the bridges carry none (Wb)")
    a_b: Nonnegative = Field(description="coefficient of the inverse inductance (1/H at 1 Wb)")
    a_bp: Nonnegative = Field(description="coefficient of its saturation (at 1 Wb)")
    k_q: Nonnegative = Field(description="share of the q flux linkage, squared")
    w: Nonnegative = Field(description="exponent")


class SaturationSection(Section):
    """Saturation by published coefficients (Hinkkanen et al. 2017), in powers of A and Wb, peak dq quantities."""

    a_d0: Positive = Field(description="1/H")
    a_dd: Nonnegative = Field(description="coefficient of |psi_d|^s")
    s: Nonnegative = Field(description="exponent")
    a_q0: Positive = Field(description="1/H")
    a_qq: Nonnegative = Field(description="coefficient of |psi_q|^t")
    t: Nonnegative = Field(description="exponent")
    a_dq: Nonnegative = Field(description="coefficient of the cross-saturation")
    u: Nonnegative = Field(description="exponent of |psi_d| there")
    v: Nonnegative = Field(description="exponent of |psi_q| there")
    bridge: BridgeSection | None = Field(default=None, description="magnets and bridges, if there are any")


class TemperatureSection(Section):
    """Operating temperatures; resistance and magnet flux are converted from those of their values."""

    winding: Temperature | None = Field(default=None, description="operating temperature of the winding (degC)")
    winding_reference: Temperature | None = Field(
        default=None, description="temperature of the resistance as given (degC); default 20"
    )
    copper_coefficient: Coefficient | None = Field(
        default=None, description="relative change of the resistance (1/K; write %/K); default 0.393 %/K"
    )
    magnet: Temperature | None = Field(default=None, description="operating temperature of the magnets (degC)")
    magnet_reference: Temperature | None = Field(
        default=None, description="temperature of the magnet flux as given (degC); default 20"
    )
    magnet_coefficient: Coefficient | None = Field(
        default=None, description="relative change of the magnet flux (1/K; write %/K), such as -0.11 %/K (NdFeB)"
    )


class IronLossSection(Section):
    """Iron loss at one frequency and flux linkage; it grows with f (hysteresis) and f^2 (eddy currents), and psi^2."""

    frequency: Frequency = Field(description="electrical frequency of the two losses (Hz)")
    flux: Flux = Field(description="flux linkage of the two losses (Wb); kind peak of phase (default), rms")
    hysteresis: Power | None = Field(default=None, description="hysteresis loss there (W)")
    eddy: Power | None = Field(default=None, description="eddy-current loss there (W)")


class AcResistanceSection(Section):
    """Rise of the resistance with the frequency, (R_ac - R_dc) proportional to f^2."""

    ratio: Ratio = Field(description="R_ac / R_dc at the frequency, such as 1.3")
    frequency: Frequency = Field(description="electrical frequency of the ratio (Hz)")


class HarmonicSection(Section):
    """One harmonic of the back-EMF, e / omega_e = - sum A sin(h theta - phase); b and c lag by 120 and 240 deg."""

    order: int = Field(ge=1, le=200, description="order h")
    amplitude: Flux | None = Field(default=None, description="A (Wb = V s/rad electrical); kind peak (default) or rms")
    share: HarmonicShare | None = Field(default=None, description="A over that of order 1 (write 18 %), in place of it")
    phase: Angle | None = Field(default=None, description="phase (rad; write deg); default 0")


class BackEmfSection(Section):
    """Back-EMF of the three phases: harmonics, or a capture in a text file."""

    harmonics: Annotated[Listing[HarmonicSection], Field(min_length=1, max_length=100)] | None = Field(
        default=None, description="list of {order: 1, amplitude: 0.2 Wb}, {order: 3, share: 18 %, phase: 0 deg}"
    )
    file: FileName | None = Field(default=None, description="capture beside the design file, in place of harmonics")
    connection: Literal["phase", "line-to-line"] = Field(default="phase", description="what the channels measured")
    scale: Annotated[tuple[float, float, float], Field(strict=False)] = Field(
        default=(1.0, 1.0, 1.0), description="factors of the channels (probes)"
    )
    highest_order: int = Field(default=13, ge=1, le=100, description="highest harmonic taken from the file")
    symmetric: bool = Field(
        default=True, description="take the mean of the phases and half waves of the file; false keeps them as measured"
    )


class MachineSection(Section):
    """The machine.

    Model linear needs inductance_d, inductance_q and one of magnet_flux, back_emf_constant and torque_constant (several
    must agree); flux-map and saturation need the section of their name.
    """

    model: MachineModel = Field(
        default="linear",
        description="linear: constant inductances; flux-map: data in a file; saturation: published coefficients; "
        "waveform: any back-EMF shape",
    )
    pole_pairs: PolePairs | None = Field(default=None, description="number of pole pairs p; or give poles")
    poles: Poles | None = Field(default=None, description="number of poles, 2 p; or give pole_pairs")
    resistance: Resistance = Field(description="stator resistance (Ohm); kind phase (default) or line-to-line")
    inductance_d: Inductance | None = Field(
        default=None, description="inductance along the magnets (H); kind phase (default) or line-to-line"
    )
    inductance_q: Inductance | None = Field(
        default=None, description="inductance across the magnets (H); kind phase (default) or line-to-line"
    )
    magnet_flux: Flux | None = Field(
        default=None,
        description="flux linkage of the magnets (Wb); kind peak of phase (default), rms or power-invariant",
    )
    back_emf_constant: BackEmfConstant | None = Field(
        default=None,
        description="back-EMF per mechanical speed (V s/rad; write V/krpm), kind required; rpm/V is inverted",
    )
    torque_constant: TorqueConstant | None = Field(
        default=None, description="torque per ampere of phase current (N m/A), kind required: per ampere peak or rms"
    )
    self_inductance: Inductance | None = Field(default=None, description="for model waveform: L_s of a phase (H)")
    mutual_inductance: MutualInductance | None = Field(
        default=None, description="for model waveform: M_s between two phases, usually negative (H); default 0"
    )
    back_emf: BackEmfSection | None = Field(default=None, description="for model waveform: its shape")
    flux_map: FluxMapSection | None = Field(default=None, description="for model flux-map: the data")
    saturation: SaturationSection | None = Field(default=None, description="for model saturation: the coefficients")
    iron_loss: IronLossSection | None = Field(default=None, description="iron loss, if it is known")
    ac_resistance: AcResistanceSection | None = Field(default=None, description="AC resistance, if it is known")
    temperature: TemperatureSection = Field(default=TemperatureSection(), description="operating temperatures")
    max_current: PhaseCurrent = Field(description="largest phase current (A); kind peak (default) or rms")
    max_speed: Speed | None = Field(default=None, description="largest mechanical speed (rad/s; write rpm)")
    inertia: Inertia | None = Field(default=None, description="moment of inertia of all that turns (kg m^2)")
    friction: Friction | None = Field(default=None, description="viscous friction (N m s/rad); default 0")
    rated: RatedSection = Field(default=RatedSection(), description="name plate, for cross-checks only")


class DeviceSection(Section):
    """One switch position: transistor and antiparallel diode."""

    kind: DeviceKind = Field(description="mosfet (conducts both ways) or igbt (its diode conducts backwards)")
    on_resistance: OnResistance = Field(description="R_DS(on) or r_CE at 25 degC (Ohm)")
    on_resistance_temperature_coefficient: Coefficient | None = Field(
        default=None, description="relative change of on_resistance (1/K; write %/K); default 0"
    )
    on_voltage: Drop | None = Field(default=None, description="V_CE0 of an IGBT (V); default 0")
    diode_voltage: Drop | None = Field(default=None, description="threshold voltage of the diode (V); default 0")
    diode_resistance: OnResistance | None = Field(
        default=None, description="differential resistance of the diode (Ohm)"
    )
    turn_on_energy: Energy = Field(description="E_on at the reference point (J)")
    turn_off_energy: Energy = Field(description="E_off at the reference point (J)")
    reverse_recovery_energy: Energy | None = Field(
        default=None, description="E_rr at the reference point (J); default 0"
    )
    reference_current: Current = Field(description="current of the energies (A)")
    reference_voltage: Voltage = Field(description="voltage of the energies (V)")
    thermal_resistance: ThermalResistance = Field(description="junction to coolant, per switch position (K/W)")
    max_junction_temperature: Temperature | None = Field(
        default=None, description="largest permitted junction temperature (degC, also without a unit); default 175"
    )


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
    device: DeviceSection | None = Field(default=None, description="the switch, needed for losses")


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
    q_formats: Annotated[tuple[Bits, Bits], Field(strict=False)] | None = Field(
        default=None, description="fractional bits of the per-unit integers kp and ki t_s, such as [10, 15]"
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
    q_formats: Annotated[tuple[Bits, Bits], Field(strict=False)] | None = Field(
        default=None, description="fractional bits of the per-unit integers kp and ki t_s, such as [10, 10]"
    )


class ObserverSection(Section):
    """Reduced-order speed observer."""

    pole: Bandwidth = Field(description="the observer's pole lies at -pole (rad/s, or Hz times 2 pi)")


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
    degree: int = Field(default=_FIT.degree, ge=1, le=6, description="degree of the polynomials")
    segments: int = Field(default=_FIT.segments, ge=1, le=4, description="number of segments")
    breakpoint_mode: BreakpointMode = Field(
        default=_FIT.breakpoint_mode, description="one set of breakpoints, or one per axis"
    )
    exact_at_zero: bool = Field(default=_FIT.exact_at_zero, description="no current at zero torque")
    continuous: bool = Field(default=_FIT.continuous, description="no step at the breakpoints")
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
    flash: ByteCount | None = Field(default=None, ge=8, le=100_000, description="budget: bytes of constants (256 B)")


class PointSection(Section):
    """One operating point."""

    torque: PointTorque = Field(description="torque (N m)")
    speed: PointSpeed = Field(description="mechanical speed (rad/s; write rpm)")


class LossSection(Section):
    """Which alternatives are compared, and where."""

    points: Annotated[Listing[PointSection], Field(min_length=1, max_length=1000)] = Field(
        description="operating points, a list of {torque: ..., speed: ...}"
    )
    strategies: Annotated[Listing[Strategy], Field(min_length=1, max_length=10)] = Field(
        default=_LOSSES.strategies, description="strategies to compare"
    )
    modulations: Annotated[Listing[ModulationName], Field(min_length=1, max_length=10)] = Field(
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


class ExportSection(Section):
    """The header."""

    prefix: Prefix = Field(default=_EXPORT.prefix, description="first part of every name in the code, a C identifier")
    vectors: int = Field(default=_EXPORT.vectors, ge=16, le=4096, description="least number of test vectors")


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
