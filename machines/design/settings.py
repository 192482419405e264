"""What a design asks for: control, fit, loss comparison and export, as plain values in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, Field, ValidatorFunctionWrapHandler, WrapValidator

from dqforge.machines.entries.kinds import Listing, Section, quantities
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.errors import dotted
from dqforge.machines.losses.machine_budget import Mission
from dqforge.machines.modulation.registry import HEXAGON, MODULATORS, SIX_STEP
from dqforge.machines.names import (
    SPEED_OBSERVER,
    AlignmentName,
    Application,
    AxisGainRule,
    BreakpointMode,
    Core,
    CurrentFrame,
    CurrentLoopMethod,
    FeedbackMethod,
    Feedforward,
    Firmware,
    FitForm,
    FitMethod,
    InjectionWave,
    ModulationName,
    NumberFormat,
    ObserverMethodName,
    ObserverTuningName,
    OpenPhase,
    OvermodulationName,
    QFormats,
    SpeedLoopMethod,
    SpeedMeasurementName,
    StartLoadName,
    StartUpMethodName,
    Strategy,
    WaveformForm,
)
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

# How the currents of a machine with any back-EMF are chosen: sinusoids, constant torque without and
# with zero sequence, and the least copper loss within voltage and current.
LossStrategy = Literal["mtpa", "id0", "least-loss"]
PhaseStrategy = Literal["dq", "dqx", "dqy", "limited"]

# ``mtpa``: least copper loss, the field weakened where the voltage asks for it; ``id0``: no d
# current; ``least-loss``: least loss of machine and inverter together, within the same limits.
AnyStrategy = LossStrategy | PhaseStrategy
GainWish = Literal["required", "optional", "none"]


@dataclass(frozen=True, slots=True)
class OperationSettings:
    """Which currents make the torque, and where.

    ``omega_m`` in rad/s (mechanical) is the speed for which the currents are chosen, None where the
    voltage limits nothing. The voltage limit there is the linear range of ``modulation`` less
    ``voltage_margin``, a share of 0 to 1 that is kept for control. With ``overmodulation`` it
    reaches to ``overmodulation_limit`` of six-step operation: unless told otherwise as far as a
    vector that follows the hexagon.
    """

    strategy: Strategy = "mtpa"
    omega_m: float | None = None
    modulation: ModulationName = "svpwm"
    voltage_margin: float = 0.0
    overmodulation: OvermodulationName = "none"
    overmodulation_limit: float = HEXAGON / SIX_STEP


@dataclass(frozen=True, slots=True)
class FitBudget:
    """What a current reference must keep, for the cheapest form that does; None where that is free.

    ``torque_error`` and ``loss_penalty`` are the largest relative errors (`ReferenceErrors`),
    ``flash`` the bytes of constants.
    """

    torque_error: float | None = None
    loss_penalty: float | None = None
    flash: int | None = None


@dataclass(frozen=True, slots=True)
class FitSettings:
    """How the current references become polynomials.

    ``torque_max`` in N m is the end of the domain, or None for the largest torque that the current
    limit allows. ``breakpoints`` in N m are searched for when None; a given tuple has ``segments -
    1`` ascending entries. With a ``budget`` form, degree, segments and breakpoints are searched
    for, and the format where that is None. Cycles are those of ``core``. ``full_scale`` is what 1
    stands for in fixed point: torque in N m and current in A. ``flat_at_zero`` leaves the linear
    term of i_d out of its first segment.
    """

    form: FitForm = "torque-exact"
    method: FitMethod = "minimax"
    degree: int = 4
    segments: int = 2
    breakpoint_mode: BreakpointMode = "shared"
    exact_at_zero: bool = True
    continuous: bool = True
    flat_at_zero: bool = False
    torque_max: float | None = None
    breakpoints: tuple[float, ...] | None = None
    budget: FitBudget | None = None
    format: NumberFormat | None = "float32"
    full_scale: tuple[float, float] | None = None
    core: Core = "cortex-m4"


@dataclass(frozen=True, slots=True)
class WeakeningSettings:
    """Current references over torque, voltage and speed.

    ``omega_m`` in rad/s (mechanical) is the largest speed that they reach. ``torque_error``, over
    the largest torque, and ``voltage_excess``, over the voltage limit, are the largest permitted
    ones, ``flash`` the bytes of code and constants.
    """

    omega_m: float
    torque_error: float = 0.005
    voltage_excess: float = 0.005
    flash: int = 2048


@dataclass(frozen=True, slots=True)
class CurrentLoopSettings:
    """PI current controllers of both axes.

    ``bandwidth`` in rad/s is for the methods ``bandwidth`` and ``damping`` (there the natural
    frequency); ``damping`` is the damping ratio; ``spread`` is a of the symmetrical optimum; ``kp``
    in V/A and ``ki`` in V/(A s) are for the method ``given`` (both axes). ``q_formats`` are the
    fractional bits (kp, ki t_s) of the per-unit integers, if asked; ``auto`` takes those that use
    16 bits best. ``max_sensitivity`` bounds M_s of the method ``optimised``. With ``schedule`` the
    gains follow the inductances of a machine that saturates. The others are for machines whose
    back-EMF is not sinusoidal: ``frame`` None for the one that the machine asks for,
    ``feedforward``, ``axis_gains``, whether ``harmonic_integrators`` run, and whether
    ``limited_waveforms`` go on where the link ends the plain ones. The last six are for methods
    that switch the bridge themselves, None for their defaults
    (`docs/methods/current-feedback-pwm.md`):
    ``band`` and ``outer_band`` in A, ``carrier`` and ``sampling`` in Hz, ``comparator_band`` in V,
    and the most ``pulses`` of a leg per electrical period.
    """

    method: CurrentLoopMethod = "magnitude-optimum"
    bandwidth: float | None = None
    damping: float = 0.7071067811865476
    spread: float = 2.0
    kp: float | None = None
    ki: float | None = None
    min_phase_margin: float = 0.5235987755982988
    q_formats: QFormats | None = None
    max_sensitivity: float = 1.6
    schedule: bool = False
    frame: CurrentFrame | None = None
    feedforward: Feedforward = "references"
    axis_gains: AxisGainRule = "own"
    harmonic_integrators: bool = True
    limited_waveforms: bool = False
    band: float | None = None
    outer_band: float | None = None
    carrier: float | None = None
    comparator_band: float | None = None
    sampling: float | None = None
    pulses: int | None = None

    @property
    def switches(self) -> bool:
        """Whether the method switches the bridge itself, without gains and modulator."""
        return self.method in get_args(FeedbackMethod)


def filter_share(filter_time: float, t_s: float) -> float:
    """Share of a new sample in the sampled first-order filter of a time constant in s, sampled
    every ``t_s`` in s: 1 - exp(-t_s/filter_time); 1 without a filter.
    """
    return 1.0 if filter_time <= 0.0 else -math.expm1(-t_s / filter_time)


@dataclass(frozen=True, slots=True)
class SpeedMeasurementSettings:
    """The speed from the edges of an encoder.

    ``lines`` per revolution; of each, ``edges`` are captured (four are counted). ``clock`` in Hz
    drives the timer of ``counter_bits`` bits that captures them. From the mechanical speed
    ``omega_from`` in rad/s on the speed loop must hold with the delay of the measurement.
    """

    method: SpeedMeasurementName
    lines: int
    clock: float
    counter_bits: int
    edges: int
    omega_from: float


@dataclass(frozen=True, slots=True)
class SpeedLoopSettings:
    """PI speed controller that commands torque; it runs every ``ratio``-th current sample.

    ``filter_time`` in s is a first-order filter on the measured speed (0 for none). ``kp`` in N m
    s/rad and ``ki`` in N m/rad are for the method ``given``. ``measurement`` is how the speed is
    measured, None where it is taken as exact. With ``counts_observer`` the lag of a position
    observer is one of the loop's small delays. The other fields are as in `CurrentLoopSettings`.
    """

    method: SpeedLoopMethod = "symmetrical-optimum"
    ratio: int = 10
    bandwidth: float | None = None
    damping: float = 1.0
    spread: float = 3.0
    filter_time: float = 0.0
    kp: float | None = None
    ki: float | None = None
    min_phase_margin: float = 0.5235987755982988
    q_formats: QFormats | None = None
    max_sensitivity: float = 1.6
    measurement: SpeedMeasurementSettings | None = None
    counts_observer: bool = False


ToleranceName = Literal["r_s", "l_d", "l_q", "psi_pm", "inertia", "v_dc", "dead_time"]

# How far a value may be off: both ways, or from the first (zero or negative) to the second (zero or
# positive).
Deviation = float | tuple[float, float]


def both_sides(deviation: Deviation) -> tuple[float, float]:
    """Least and largest value of a deviation; a single number goes to either side."""
    return deviation if isinstance(deviation, tuple) else (-deviation, deviation)


@dataclass(frozen=True, slots=True)
class Tolerances:
    """How far the drive may be from its data; 0 where a value is taken as exact.

    ``r_s``, ``l_d``, ``l_q``, ``psi_pm`` and ``inertia`` are relative; ``v_dc`` is that of the
    voltage that acts from the one that duty cycles are computed with. ``dead_time`` in s is what
    the compensation of the dead time leaves over (positive), or does too much (negative), and
    ``low_current`` in A (peak of phase) the smallest current at which the loops must hold in spite
    of it. ``thorough`` asks for proofs that take longer than every run can afford.
    """

    r_s: Deviation = 0.0
    l_d: Deviation = 0.0
    l_q: Deviation = 0.0
    psi_pm: Deviation = 0.0
    inertia: Deviation = 0.0
    v_dc: Deviation = 0.0
    dead_time: Deviation = 0.0
    low_current: float = 0.0
    thorough: bool = False

    def limits(self, name: ToleranceName) -> tuple[float, float]:
        """Least (zero or negative) and largest (zero or positive) deviation of one parameter."""
        return both_sides(getattr(self, name))


SPEED_ERROR = 0.2  # Largest error of an observed speed, relative, of a design that names none.


@dataclass(frozen=True, slots=True)
class ObserverSettings:
    """Speed or position observer.

    ``pole`` is for the reduced-order speed observer, whose pole lies at ``-pole`` (rad/s,
    positive). The others are for the position observers, None for what the method usually has:
    ``bandwidth`` and ``pll_bandwidth`` in rad/s, ``damping`` of the phase-locked loop,
    ``speed_gain`` the share of the speed in the correction of the flux. Of those that learn:
    neurons of both ``hidden_layers``, time constant of ``correction_filter`` in s and
    ``correction_limit`` in rad.
    Of trackers that inject: ``wave``, its amplitude ``voltage`` in V, ``samples`` per period of it,
    and ``period`` in s between sequences of pulses. ``max_speed_error`` is the relative error of
    the speed within the tolerances beyond which a speed loop on it does not count as holding.
    """

    pole: float | None = None
    method: ObserverMethodName = SPEED_OBSERVER
    bandwidth: float | None = None
    pll_bandwidth: float | None = None
    damping: float | None = None
    speed_gain: float | None = None
    tuning: ObserverTuningName = "named"
    wave: InjectionWave | None = None
    voltage: float | None = None
    samples: int | None = None
    period: float | None = None
    hidden_layers: tuple[int, int] | None = None
    correction_filter: float | None = None
    correction_limit: float | None = None
    max_speed_error: float = SPEED_ERROR


@dataclass(frozen=True, slots=True)
class StartUpSettings:
    """How a drive without encoder comes from standstill to speed; None where that is computed.

    ``load_torque`` in N m is the largest that must be started. Currents in A (peak): of the ramp,
    of the alignment, along d until the observer at speed has taken over, and the one that trips.
    Torques in N m accelerate the ramp, and the reference after it; ``hand_over`` in rad/s
    (mechanical) is where the observer at speed takes over. Times in s. ``damping`` is that of the
    ramp; ``v_dc_min`` in V trips below. ``observer`` is the one from standstill on.
    """

    method: StartUpMethodName = "auto"
    alignment: AlignmentName | None = None
    load: StartLoadName = "friction"
    load_torque: float | None = None
    brake: bool = False
    current: float | None = None
    alignment_current: float | None = None
    alignment_time: float | None = None
    acceleration_torque: float | None = None
    damping: float | None = None
    hand_over: float | None = None
    held_current: float | None = None
    fade_time: float | None = None
    patience: float | None = None
    run_torque: float | None = None
    retries: int = 2
    retry_pause: float | None = None
    flying_start: bool = False
    trip_current: float | None = None
    v_dc_min: float | None = None
    observer: ObserverSettings | None = None


@dataclass(frozen=True, slots=True)
class PerUnitBases:
    """Bases of the per-unit gains: current in A, voltage in V, mechanical speed in rad/s,
    torque in N m.
    """

    current: float
    voltage: float
    speed: float
    torque: float


@dataclass(frozen=True, slots=True)
class VoltageFeedbackSettings:
    """Field weakening by voltage feedback: ``bandwidth`` in rad/s is the largest that it has at any
    speed, ``current`` in A (peak) the largest d current that it adds, None for all that the current
    limit leaves.
    """

    bandwidth: float
    current: float | None = None


@dataclass(frozen=True, slots=True)
class ReferenceSettings:
    """How fast references move, and what corrects them; None where nothing does.

    ``torque_slope`` in N m/s, ``current_slope`` in A/s (of the vector of the current reference).
    """

    torque_slope: float | None = None
    current_slope: float | None = None
    voltage_feedback: VoltageFeedbackSettings | None = None

    @property
    def any(self) -> bool:
        """Whether any of them is asked for."""
        return self != ReferenceSettings()


@dataclass(frozen=True, slots=True)
class FirmwareSettings:
    """The firmware of others whose loops are to run the drive.

    ``pll`` are the gains (1/s, 1/s^2) of the phase-locked loop that makes its speed, None where
    they may be chosen.
    """

    name: Firmware
    pll: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class SixStepSettings:
    """A six-step drive, which commutates blocks by the voltage of the phase that floats.

    ``voltage_offset`` and ``voltage_noise`` in V (standard deviation) are those of that voltage as
    it is measured, None for what is usual; ``voltage_bits`` those of its converter. ``filter_time``
    in s is a first-order filter of it. ``start_current`` in A (peak) is that of alignment and
    forced start, ``align_time`` in s the whole time of the alignment; None for computed ones.
    """

    voltage_offset: float | None = None
    voltage_noise: float | None = None
    voltage_bits: int = 12
    filter_time: float = 0.0
    start_current: float | None = None
    align_time: float | None = None


@dataclass(frozen=True, slots=True)
class OnlineEstimationSettings:
    """Which parameters are estimated while the drive runs, and the time constant in s with which
    they are followed.
    """

    flux: bool = True
    resistance: bool = True
    time_constant: float = 5.0


@dataclass(frozen=True, slots=True)
class CommissioningSettings:
    """Tests that the drive runs on its own machine: current in A (peak) and mechanical speed in
    rad/s at which coasting begins, None for what is usual; rows of the log; and the longest time in
    s of acceleration and of coasting.
    """

    current: float | None = None
    speed: float | None = None
    rows: int = 512
    shaft_time: float = 5.0


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """Sampling and controllers; ``t_s`` is the current-control sampling period in s.

    ``tolerances`` is the box in which every loop must hold, None where only the data themselves
    count. ``gains`` are ``optional`` where the design says nothing of control: a machine without
    them still has its current references. ``firmware`` is that of others whose loops are evaluated
    beside those of the emitted code, None without one. ``start_up`` is how the drive starts without
    an encoder, None where it does not. ``six_step`` is that of a six-step drive, None for drives in
    rotor coordinates. ``online_estimation`` is None where no parameter is estimated,
    ``commissioning`` where no header of its tests is wanted.
    """

    t_s: float
    current_loop: CurrentLoopSettings
    speed_loop: SpeedLoopSettings | None
    observer: ObserverSettings | None
    bases: PerUnitBases
    tolerances: Tolerances | None = None
    gains: GainWish = "required"
    references: ReferenceSettings = ReferenceSettings()
    firmware: FirmwareSettings | None = None
    start_up: StartUpSettings | None = None
    six_step: SixStepSettings | None = None
    online_estimation: OnlineEstimationSettings | None = None
    commissioning: CommissioningSettings | None = None


@dataclass(frozen=True, slots=True)
class WaveformSettings:
    """Phase currents of a machine whose back-EMF is not sinusoidal.

    ``torque`` in N m and ``omega_m`` in rad/s are the operating point of the comparison, None for
    the largest torque of the closed forms and the base speed. ``ripple`` is the permitted deviation
    of the torque from its mean, relative; ``neutral`` in A and ``slew`` in A/s limit the neutral
    current and the rate of change. ``form`` and ``error``, the largest error of a current over the
    peak, are for the firmware.
    """

    torque: float | None = None
    omega_m: float | None = None
    ripple: float = 0.0
    neutral: float | None = None
    open_phase: OpenPhase | None = None
    slew: float | None = None
    form: WaveformForm = "cheapest"
    error: float = 0.005


@dataclass(frozen=True, slots=True)
class LoadPoint:
    """One operating point: torque in N m and mechanical speed in rad/s.

    ``weight`` is its share in a mean over the points, relative to those of the others.
    """

    torque: float
    omega_m: float
    weight: float = 1.0


@dataclass(frozen=True, slots=True)
class LossSettings:
    """Which alternatives are compared, and where: at points, and over a mission where there is
    one.
    """

    points: tuple[LoadPoint, ...]
    strategies: tuple[LossStrategy, ...] = ("id0", "mtpa")
    modulations: tuple[ModulationName, ...] = ("spwm", "svpwm", "ddt-gdpwm")
    mission: Mission | None = None


@dataclass(frozen=True, slots=True)
class ChoiceSettings:
    """Which modulator and switching frequency are chosen from, where, and within which limits.

    ``f_min`` and ``f_max`` in Hz bound the switching frequency, ``bands`` (low, high) in Hz are
    left out of that range. ``omega_m`` in rad/s (mechanical) is the largest speed. ``ripple_max``
    in A (r.m.s. of the phase-current ripple) and ``junction_max`` in degC are limits, None where
    there is none beside the device's; at least ``carrier_ratio`` carrier periods make an electrical
    one. ``ripple_resistance`` is the winding's resistance at the switching frequency over that of
    the fundamental. The grid has ``torques`` by ``speeds`` points; a rule asks at most
    ``questions`` and starts from ``frequencies`` per modulator.
    """

    f_min: float
    f_max: float
    omega_m: float
    strategy: Strategy = "mtpa"
    modulations: tuple[ModulationName, ...] = tuple(MODULATORS)
    bands: tuple[tuple[float, float], ...] = ()
    ripple_max: float | None = None
    junction_max: float | None = None
    carrier_ratio: float = 20.0
    ripple_resistance: float = 1.0
    torques: int = 20
    speeds: int = 24
    frequencies: int = 8
    questions: int = 2


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """The header: ``prefix`` is a checked C identifier, ``vectors`` the least number of test
    vectors.

    ``control`` are the number formats in which the control functions are emitted,
    each in a header of its own. ``frame_tables`` asks for tables of the frames dqx and dqy.
    ``firmware`` names firmware of others whose configuration files are written. ``application`` is
    the program around the functions, None for none.
    """

    prefix: str
    vectors: int = 256
    control: tuple[NumberFormat, ...] = ()
    frame_tables: bool = False
    firmware: tuple[Firmware, ...] = ()
    application: Application | None = None


# Speeds that a design file writes without a unit: they are in rad/s,
# where rpm may have been meant.

# How far above the largest speed a speed without a unit is taken for one in rpm (30/pi = 9.5 lies
# between them).
FACTOR = 3.0


def bare_speed_remarks(file: Section, largest: Quantity | None) -> tuple[str, ...]:
    """Sentences on speeds of a file without a unit that lie far above the ``largest`` one,
    and on a largest one without a unit.
    """
    remarks = []
    for parts, quantity in quantities(file):
        if quantity.dimension != "speed" or not quantity.bare:
            continue
        path = dotted(parts)
        if path == "machine.max_speed":
            remarks.append(f"{path} {_bare(quantity)}")
        elif largest is not None and abs(quantity.si) > FACTOR * largest.si:
            times = abs(quantity.si) / largest.si
            remarks.append(f"{path} {_bare(quantity)}; that is {times:.3g} times the largest speed")
    return tuple(remarks)


def bare_speed_hint(quantity: Quantity) -> str:
    """What to write for a speed that is too large: the unit, where it has none."""
    if not quantity.bare:
        return "correct one of them"
    return (
        f"'{quantity.text}' has no unit and is taken as rad/s; write '{quantity.text} rpm' if that "
        "is meant"
    )


def _bare(quantity: Quantity) -> str:
    speed = format_quantity(quantity.si, "rpm")
    return (
        f"has no unit and is taken as {quantity.text} rad/s, {speed}; write '{quantity.text} rpm' "
        "if that is meant"
    )


def speed_keys(model: type[BaseModel], path: str = "") -> Iterator[str]:
    """Paths of all keys of a schema that hold a speed; ``[]`` stands for the entries of a list."""
    for name, field in model.model_fields.items():
        place = f"{path}.{name}" if path else name
        if any(
            isinstance(part, QuantityRule) and part.dimension == "speed" for part in field.metadata
        ):
            yield place
        yield from _inside(field.annotation, place)


def _inside(annotation: Any, place: str) -> Iterator[str]:
    if isinstance(annotation, QuantityRule) and annotation.dimension == "speed":
        yield place
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield from speed_keys(annotation, place)
    several = getattr(annotation, "__origin__", None) is tuple
    for part in get_args(annotation):
        yield from _inside(part, place + "[]" if several else place)


# Settings in SI units from a section of the design file, field by field.

_Settings = TypeVar("_Settings")


def settings_from(settings: type[_Settings], section: Section, **given: Any) -> _Settings:
    """Settings whose fields are the keys of a section.

    Args:
        settings: A dataclass. A field that bears the name of a key takes its value, a quantity in
            SI units; a key that the file leaves out leaves the field at its default.
        section: The section of the file.
        given: Fields that are more than their key, or have another name than it.

    Raises:
        TypeError: A field without a default is neither a key nor given.
    """
    values = dict(given)
    for field in fields(settings):  # type: ignore[arg-type]
        if field.name in values or field.name not in type(section).model_fields:
            continue
        value = getattr(section, field.name)
        if value is not None:
            values[field.name] = _in_si(value)
    return settings(**values)


def _in_si(value: Any) -> Any:
    if isinstance(value, Quantity):
        return value.si
    if isinstance(value, tuple):
        return tuple(_in_si(part) for part in value)
    return value


# Keys of a design that name modulators.


def _known(value: Any, words: ValidatorFunctionWrapHandler) -> Any:
    """Let a registered modulator pass; all else is judged by the words of the package."""
    return value if isinstance(value, str) and value in MODULATORS else words(value)


ModulatorKey = Annotated[ModulationName, WrapValidator(_known)]  # The name of a modulator.

# Some modulators, each at most once.
ModulatorList = Annotated[Listing[ModulatorKey], Field(min_length=1, max_length=len(MODULATORS))]
