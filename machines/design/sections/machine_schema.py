"""The machine's section of the design file, with its flux map and its back-EMF."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Literal, get_args

from pydantic import BeforeValidator, Field, WithJsonSchema

from dqforge.machines.design.design import Connection
from dqforge.machines.entries.kinds import (
    Angle,
    BackEmfConstant,
    ChannelPlace,
    Coefficient,
    ColumnName,
    FileName,
    Flux,
    Frequency,
    Friction,
    HarmonicShare,
    Inductance,
    Inertia,
    Listing,
    LossExponent,
    MachineCurrent,
    MapFactor,
    MutualInductance,
    Nonnegative,
    PointSpeed,
    PolePairs,
    Poles,
    Positive,
    Power,
    Ratio,
    Resistance,
    SampleInterval,
    Section,
    Speed,
    SpeedConstant,
    Temperature,
    ThermalResistance,
    Torque,
    TorqueConstant,
)
from dqforge.machines.entries.rules import any_word_of, in_other_words
from dqforge.machines.names import (
    FluxAxes,
    FluxFitName,
    FluxScaling,
    FluxSymmetry,
    FluxTorque,
    MachineModel,
)


class HarmonicSection(Section):
    """One harmonic of the back-EMF, e / omega_e = - sum A sin(h theta - phase); b and c lag
    by 120 and 240 deg.
    """

    order: int | None = Field(default=None, ge=1, le=200, description="order h")
    mechanical_order: int | None = Field(
        default=None,
        ge=1,
        le=4000,
        description=(
            "order of the mechanical angle, h times the pole pairs, in place of order: where pole "
            "pairs differ"
        ),
    )
    amplitude: Flux | None = Field(
        default=None, description="A (Wb = V s/rad electrical); kind peak (default) or rms"
    )
    share: HarmonicShare | None = Field(
        default=None, description="A over that of order 1 (write 18 %), in place of it"
    )
    phase: Angle | None = Field(default=None, description="phase (rad; write deg); default 0")


class BackEmfSection(Section):
    """Back-EMF of the three phases: harmonics, or a capture in one or several files."""

    harmonics: Annotated[Listing[HarmonicSection], Field(min_length=1, max_length=400)] | None = (
        Field(
            default=None,
            description=(
                "list of {order: 1, amplitude: 0.2 Wb}, {order: 3, share: 18 %, phase: 0 deg}"
            ),
        )
    )
    file: FileName | None = Field(
        default=None,
        description="capture beside the design file, in place of harmonics: text or .mat, also .gz",
    )
    files: Annotated[Listing[FileName], Field(min_length=2, max_length=3)] | None = Field(
        default=None,
        description="the files of a capture that has one for each channel, in place of file",
    )
    interval: SampleInterval | None = Field(
        default=None,
        description="time between two samples (s; write us), for captures that do not state it",
    )
    connection: ChannelPlace = Field(
        default="phase", description="what the channels measured: phase or line-to-line"
    )
    scale: Annotated[tuple[float, float, float], Field(strict=False)] = Field(
        default=(1.0, 1.0, 1.0), description="factors of the channels (probes)"
    )
    highest_order: int = Field(
        default=13, ge=1, le=100, description="highest harmonic taken from the file"
    )
    span: Literal["electrical", "mechanical"] = Field(
        default="electrical",
        description=(
            "what the waveform of the file repeats after: mechanical keeps what the pole pairs "
            "differ by"
        ),
    )
    symmetric: bool | None = Field(
        default=None,
        description=(
            "take the mean of the phases and half waves of the file; false keeps them as measured, "
            "as is the default over the mechanical span, where true takes the mean of the phases"
        ),
    )


# The flux map in the machine's section of the design file.


class ColumnsSection(Section):
    """What a file calls the columns or arrays of a flux map, where their names are not
    recognised.
    """

    i_d: ColumnName | None = Field(default=None, description="name of the d current")
    i_q: ColumnName | None = Field(default=None, description="name of the q current")
    psi_d: ColumnName | None = Field(default=None, description="name of the d flux linkage")
    psi_q: ColumnName | None = Field(default=None, description="name of the q flux linkage")
    i: ColumnName | None = Field(
        default=None, description="name of the current's amplitude, in place of i_d and i_q"
    )
    beta: ColumnName | None = Field(default=None, description="name of the current's angle, with i")
    l_d: ColumnName | None = Field(
        default=None, description="name of the apparent d inductance, in place of psi_d"
    )
    l_q: ColumnName | None = Field(
        default=None, description="name of the apparent q inductance, in place of psi_q"
    )
    psi_m: ColumnName | None = Field(
        default=None, description="name of the magnets' flux linkage, with l_d and l_q"
    )
    torque: ColumnName | None = Field(default=None, description="name of the torque")
    angle: ColumnName | None = Field(
        default=None, description="name of the rotor angle; it is averaged over"
    )
    temperature: ColumnName | None = Field(
        default=None, description="name of the temperature; see at"
    )
    speed: ColumnName | None = Field(default=None, description="name of the speed; see at")
    v_d: ColumnName | None = Field(
        default=None, description="name of the d voltage of operating points, in place of psi_d"
    )
    v_q: ColumnName | None = Field(default=None, description="name of the q voltage, with v_d")
    frequency: ColumnName | None = Field(
        default=None, description="name of the electrical frequency, with v_d and v_q"
    )
    resistance: ColumnName | None = Field(
        default=None, description="name of the phase resistance, with v_d and v_q"
    )
    loss: ColumnName | None = Field(default=None, description="name of the total loss")
    efficiency: ColumnName | None = Field(default=None, description="name of the efficiency")


class FluxMapPointsSection(Section):
    """Selection from a file that holds several temperatures or speeds."""

    temperature: Temperature | None = Field(default=None, description="their temperature (degC)")
    speed: PointSpeed | None = Field(default=None, description="their speed (rad/s; write rpm)")


class FluxMapFileSection(Section):
    """One of several flux maps of the same machine."""

    file: FileName = Field(description="file beside the design file")
    magnet_temperature: Temperature = Field(
        description="temperature of the magnets in this map (degC)"
    )


class FluxMapSection(Section):
    """Flux linkages over the currents, in a file: CSV, xlsx, NPZ, MAT, HDF5, FEMAG or Twin
    Builder.
    """

    file: FileName | None = Field(
        default=None, description="file beside the design file, or in a folder below it"
    )
    files: Annotated[Listing[FluxMapFileSection], Field(min_length=2, max_length=20)] | None = (
        Field(
            default=None, description="several maps over the magnet temperature, in place of file"
        )
    )
    psi_q_file: FileName | None = Field(
        default=None,
        description="matrix of psi_q (i_d across, i_q down), where file holds that of psi_d alone",
    )
    torque_file: FileName | None = Field(
        default=None, description="matrix of the torque, in the same layout"
    )
    axes: FluxAxes = Field(
        default="magnet-d",
        description=(
            "magnet-d: d along the magnets; reluctance: the magnets lie on the negative q axis"
        ),
    )
    scaling: FluxScaling = Field(
        default="peak", description="of currents and flux linkages: peak, rms, power-invariant"
    )
    quantities: Literal["line", "winding"] | None = Field(
        default=None,
        description=(
            "of a delta: whether the map holds currents of lines (as measured) or of windings"
        ),
    )
    current_unit: Literal["A", "mA", "kA"] | None = Field(
        default=None, description="where the file does not state it"
    )
    flux_unit: Literal["Wb", "mWb", "V s", "mV s"] | None = Field(
        default=None, description="where the file does not state it"
    )
    resistance: Resistance | None = Field(
        default=None,
        description=(
            "of a phase (Ohm), for operating points with voltages whose file does not give it, at "
            "the temperature of the file"
        ),
    )
    columns: ColumnsSection = Field(
        default_factory=ColumnsSection,
        description="names in the file, where they are not recognised",
    )
    at: FluxMapPointsSection = Field(
        default_factory=FluxMapPointsSection,
        description="which temperature or speed, where the file holds several",
    )
    torque: FluxTorque = Field(
        default="air-gap",
        description=(
            "kind of torque in the file: air-gap; shaft: measured after friction and iron "
            "loss; per-pole-pair; ignore"
        ),
    )
    extrapolate: bool = Field(
        default=False,
        description="permit currents beyond the map; results that use them are marked",
    )
    fit: FluxFitName = Field(
        default="auto",
        description=(
            "interpolate: a spline through the points; smooth: a smooth co-energy near them; auto: "
            "smooth where noise makes more than 3 % of the incremental inductances or one is not "
            "positive"
        ),
    )
    symmetry: FluxSymmetry = Field(
        default="average",
        description=(
            "of the halves i_q > 0 and i_q < 0: average; keep: a current reference for each sign "
            "of the torque; positive, negative: one half, mirrored"
        ),
    )
    frame_angle: Angle | None = Field(
        default=None,
        description=(
            "turn of the file's frame (rad electrical; write deg), against a misaligned sensor"
        ),
    )


# The machine's section of the design file; its flux map and its back-EMF stand beside it.

_CONNECTIONS = get_args(Connection)
_WINDINGS = {"y": "star", "wye": "star", "d": "delta", "δ": "delta", "triangle": "delta"}

WindingConnection = Annotated[
    Connection,
    BeforeValidator(partial(in_other_words, names=_CONNECTIONS, words=_WINDINGS)),
    WithJsonSchema(
        any_word_of(
            _CONNECTIONS, "^([Ss]tar|STAR|[Dd]elta|DELTA|[YyDdΔδ]|[Ww]ye|WYE|[Tt]riangle|TRIANGLE)$"
        )
    ),
]


class RatedSection(Section):
    """Values of the name plate, used only to cross-check the others."""

    torque: Torque | None = Field(default=None, description="rated torque (N m)")
    speed: Speed | None = Field(
        default=None, description="rated mechanical speed (rad/s; write rpm)"
    )
    power: Power | None = Field(default=None, description="rated mechanical power (W)")
    current: MachineCurrent | None = Field(
        default=None, description="rated phase current (A); kind peak (default) or rms"
    )
    frequency: Frequency | None = Field(default=None, description="rated electrical frequency (Hz)")


# Published exponents are at most 7; far beyond, powers of flux linkages vanish, and the magnets
# with them.
Exponent = Annotated[Nonnegative, Field(le=20.0)]


class BridgeSection(Section):
    """Magnets and their saturable bridges; the coefficients are those of Lelli et al. 2024."""

    psi_n: Nonnegative = Field(description="flux linkage at which the bridges carry none (Wb)")
    a_b: Nonnegative = Field(description="coefficient of the inverse inductance (1/H at 1 Wb)")
    a_bp: Nonnegative = Field(description="coefficient of its saturation (at 1 Wb)")
    k_q: Nonnegative = Field(description="share of the q flux linkage, squared")
    w: Exponent = Field(description="exponent")


class SaturationSection(Section):
    """Saturation by published coefficients (Hinkkanen et al. 2017), in powers of A and Wb,
    peak dq quantities.
    """

    a_d0: Positive = Field(description="1/H")
    a_dd: Nonnegative = Field(description="coefficient of |psi_d|^s")
    s: Exponent = Field(description="exponent")
    a_q0: Positive = Field(description="1/H")
    a_qq: Nonnegative = Field(description="coefficient of |psi_q|^t")
    t: Exponent = Field(description="exponent")
    a_dq: Nonnegative = Field(description="coefficient of the cross-saturation")
    u: Exponent = Field(description="exponent of |psi_d| there")
    v: Exponent = Field(description="exponent of |psi_q| there")
    bridge: BridgeSection | None = Field(
        default=None, description="magnets and bridges, if there are any"
    )


class TemperatureSection(Section):
    """Operating temperatures; resistance and magnet flux are converted from those of their
    values.
    """

    winding: Temperature | None = Field(
        default=None, description="operating temperature of the winding (degC)"
    )
    winding_reference: Temperature | None = Field(
        default=None, description="temperature of the resistance as given (degC); default 20"
    )
    copper_coefficient: Coefficient | None = Field(
        default=None,
        description="relative change of the resistance (1/K; write %/K); default 0.393 %/K",
    )
    winding_thermal_resistance: ThermalResistance | None = Field(
        default=None,
        description="winding to coolant (K/W): loss maps and missions then warm the winding",
    )
    winding_coolant: Temperature | None = Field(
        default=None,
        description="temperature that it refers to (degC); default the inverter's coolant",
    )
    magnet: Temperature | None = Field(
        default=None, description="operating temperature of the magnets (degC)"
    )
    magnet_reference: Temperature | None = Field(
        default=None, description="temperature of the magnet flux as given (degC); default 20"
    )
    magnet_coefficient: Coefficient | None = Field(
        default=None,
        description=(
            "relative change of the magnet flux (1/K; write %/K), such as -0.11 %/K (NdFeB)"
        ),
    )


class IronLossSection(Section):
    """Iron loss at one frequency and flux linkage; it grows with f (hysteresis) and f^2
    (eddy currents), and psi^2.
    """

    frequency: Frequency = Field(description="electrical frequency of the two losses (Hz)")
    flux: Flux = Field(
        description="flux linkage of the two losses (Wb); kind peak of phase (default), rms"
    )
    hysteresis: Power | None = Field(default=None, description="hysteresis loss there (W)")
    eddy: Power | None = Field(default=None, description="eddy-current loss there (W)")


class MagnetLossSection(Section):
    """Eddy-current loss of the magnets at one frequency and current; it grows with both squared."""

    loss: Power = Field(description="loss there (W)")
    frequency: Frequency = Field(description="electrical frequency (Hz)")
    current: MachineCurrent = Field(description="phase current (A); kind peak (default) or rms")


class LossColumnsSection(Section):
    """What a file calls the columns of a loss map, where their names are not recognised."""

    i_d: ColumnName | None = Field(default=None, description="name of the d current")
    i_q: ColumnName | None = Field(default=None, description="name of the q current")
    iron: ColumnName | None = Field(default=None, description="name of the whole iron loss")
    hysteresis: ColumnName | None = Field(default=None, description="name of the hysteresis loss")
    eddy: ColumnName | None = Field(default=None, description="name of the eddy-current loss")
    magnet: ColumnName | None = Field(default=None, description="name of the loss in the magnets")
    mechanical: ColumnName | None = Field(default=None, description="name of the mechanical loss")
    frequency: ColumnName | None = Field(
        default=None, description="name of the electrical frequency"
    )
    speed: ColumnName | None = Field(
        default=None, description="name of the mechanical speed, in place of frequency"
    )


class LossMapSection(Section):
    """Iron and magnet loss over the currents, in a file with a column for each: of finite
    elements.
    """

    file: FileName = Field(description="file beside the design file, that of the flux map or other")
    frequency: Frequency | None = Field(
        default=None,
        description="electrical frequency of the losses (Hz), where the file has no column for it",
    )
    exponent: LossExponent | None = Field(
        default=None,
        description=(
            "growth of the iron loss with the frequency, where the file has it as one sum at one "
            "frequency: 1 hysteresis to 2 eddy currents"
        ),
    )
    axes: FluxAxes | None = Field(
        default=None, description="magnet-d or reluctance; default that of flux_map, else magnet-d"
    )
    scaling: FluxScaling | None = Field(
        default=None,
        description="of the currents: peak, rms, power-invariant; default as flux_map, else peak",
    )
    columns: LossColumnsSection = Field(
        default_factory=LossColumnsSection,
        description="names in the file, where they are not recognised",
    )


class AcResistanceSection(Section):
    """Rise of the resistance with the frequency, (R_ac - R_dc) proportional to f^2."""

    ratio: Ratio = Field(description="R_ac / R_dc at the frequency, such as 1.3")
    frequency: Frequency = Field(description="electrical frequency of the ratio (Hz)")


class MapScaleSection(Section):
    """Deviation of a machine from its flux map: factors of the map, 1 each by default."""

    magnet: MapFactor | None = Field(
        default=None, description="open-circuit flux linkage over that of the map"
    )
    inductance_d: MapFactor | None = Field(
        default=None, description="d inductances over those of the map"
    )
    inductance_q: MapFactor | None = Field(
        default=None, description="q inductances over those of the map"
    )
    current: MapFactor | None = Field(
        default=None, description="currents at which it saturates over those of the map"
    )


class InductanceHarmonicSection(Section):
    """One even harmonic of the inductances: L_aa = L_s + sum A cos(h theta), M_bc = M_s +
    sum B cos(h theta).
    """

    order: int = Field(ge=2, le=100, multiple_of=2, description="order h, even")
    amplitude: MutualInductance = Field(
        description=(
            "A of the self inductance (H); order 2 is negative where l_d is smaller than l_q"
        )
    )
    mutual: MutualInductance | None = Field(
        default=None, description="B of the mutual inductance (H); default as amplitude"
    )


class MachineSection(Section):
    """The machine.

    Model linear needs inductance, or inductance_d and inductance_q, and one of magnet_flux,
    back_emf_constant, torque_constant and kv (several must agree); flux-map and saturation need the
    section of their name.
    """

    model: MachineModel = Field(
        default="linear",
        description=(
            "linear: constant inductances; flux-map: data in a file; saturation: published "
            "coefficients; waveform: any back-EMF shape"
        ),
    )
    connection: WindingConnection = Field(
        default="star",
        description=(
            "of the windings, star (Y, wye) or delta (D); the data of a delta are converted to the "
            "equivalent star"
        ),
    )
    pole_pairs: PolePairs | None = Field(
        default=None, description="number of pole pairs p; or give poles"
    )
    poles: Poles | None = Field(
        default=None, description="number of poles, 2 p; or give pole_pairs"
    )
    resistance: Resistance = Field(
        description="stator resistance (Ohm); kind phase (default) or line-to-line"
    )
    inductance: Inductance | None = Field(
        default=None,
        description=(
            "single inductance of a data sheet, for both axes (H); kind phase (default) or "
            "line-to-line"
        ),
    )
    inductance_d: Inductance | None = Field(
        default=None,
        description="inductance along the magnets (H); kind phase (default) or line-to-line",
    )
    inductance_q: Inductance | None = Field(
        default=None,
        description="inductance across the magnets (H); kind phase (default) or line-to-line",
    )
    magnet_flux: Flux | None = Field(
        default=None,
        description=(
            "flux linkage of the magnets (Wb); kind peak of phase (default), rms or power-invariant"
        ),
    )
    back_emf_constant: BackEmfConstant | None = Field(
        default=None,
        description=(
            "back-EMF per mechanical speed (V s/rad; write V/krpm), kind required; rpm/V is "
            "inverted"
        ),
    )
    torque_constant: TorqueConstant | None = Field(
        default=None,
        description=(
            "torque per ampere of phase current (N m/A), kind required: per ampere peak or rms; "
            "of a delta line or winding"
        ),
    )
    kv: SpeedConstant | None = Field(
        default=None,
        description=(
            "speed per volt, the Kv of a hobby motor (rpm/V); kind line-to-line peak (default), "
            "line-to-line rms, phase peak or phase rms"
        ),
    )
    self_inductance: Inductance | None = Field(
        default=None, description="for model waveform: L_s of a phase (H)"
    )
    mutual_inductance: MutualInductance | None = Field(
        default=None,
        description="for model waveform: M_s between two phases, usually negative (H); default 0",
    )
    inductance_harmonics: (
        Annotated[Listing[InductanceHarmonicSection], Field(min_length=1, max_length=20)] | None
    ) = Field(
        default=None,
        description="for model waveform: saliency, list of {order: 2, amplitude: -1 mH}",
    )
    back_emf: BackEmfSection | None = Field(
        default=None, description="for model waveform: its shape"
    )
    flux_map: FluxMapSection | None = Field(
        default=None, description="for model flux-map: the data"
    )
    saturation: SaturationSection | None = Field(
        default=None, description="for model saturation: the coefficients"
    )
    map_scale: MapScaleSection | None = Field(
        default=None,
        description="for models flux-map and saturation: factors of the map, for tolerances",
    )
    iron_loss: IronLossSection | None = Field(default=None, description="iron loss, optional")
    loss_map: LossMapSection | None = Field(
        default=None,
        description=(
            "iron and magnet loss over the currents, in a file; iron_loss is then compared with it"
        ),
    )
    ac_resistance: AcResistanceSection | None = Field(
        default=None, description="AC resistance, optional"
    )
    magnet_loss: MagnetLossSection | None = Field(
        default=None, description="loss in the magnets, optional"
    )
    temperature: TemperatureSection = Field(
        default_factory=TemperatureSection, description="operating temperatures"
    )
    max_current: MachineCurrent = Field(
        description=(
            "largest phase current (A); kind peak (default) or rms; of a delta line peak, winding "
            "rms, ..."
        )
    )
    max_speed: Speed | None = Field(
        default=None, description="largest mechanical speed (rad/s; write rpm)"
    )
    inertia: Inertia | None = Field(
        default=None, description="moment of inertia of all that turns (kg m^2)"
    )
    friction: Friction | None = Field(
        default=None, description="viscous friction (N m s/rad); default 0"
    )
    rated: RatedSection = Field(
        default_factory=RatedSection, description="name plate, for cross-checks only"
    )
