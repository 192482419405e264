"""The section ``simulation`` of a design file: what the drive goes through in the time domain."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from dqforge.machines.entries.kinds import (
    Angle,
    Current,
    DeadTime,
    Listing,
    PointSpeed,
    PointTorque,
    Section,
    Voltage,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule, not_truth
from dqforge.machines.names import OpenPhase, StartLoadName
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    InverterModel,
    Shape,
    SpeedSource,
)

Instant = Annotated[Quantity, QuantityRule("time", 0.0, 1e4)]


Duration = Annotated[Quantity, QuantityRule("time", 1e-6, 1e4)]


SignedCurrent = Annotated[Quantity, QuantityRule("current", -1e5, 1e5)]


RippleVoltage = Annotated[Quantity, QuantityRule("voltage", 0.0, 2e4)]


ProfileFrequency = Annotated[Quantity, QuantityRule("frequency", 1e-3, 1e5)]


NoiseCurrent = Annotated[Quantity, QuantityRule("current", 0.0, 1e5)]


RelativeError = Annotated[Quantity, QuantityRule("number", -0.9, 10.0)]


SmallError = Annotated[Quantity, QuantityRule("number", -0.5, 0.5)]


Whole = Annotated[int, BeforeValidator(not_truth)]


_POINTS = (
    "a list of {time: ..., value: ...}, times ascending; before the first and behind the last its "
    "value holds"
)


_MOST = 100_000


_ENCODER, _SENSOR = Encoder(), CurrentSensor()


class SpeedPointSection(Section):
    """Speed at a time."""

    time: Instant = Field(description="time (s)")
    speed: PointSpeed = Field(description="mechanical speed (rad/s; write rpm)")


class TorquePointSection(Section):
    """Torque at a time."""

    time: Instant = Field(description="time (s)")
    torque: PointTorque = Field(description="torque (N m)")


class CurrentPointSection(Section):
    """Currents at a time."""

    time: Instant = Field(description="time (s)")
    i_d: SignedCurrent = Field(description="d current (A, peak)")
    i_q: SignedCurrent = Field(description="q current (A, peak)")


class VoltagePointSection(Section):
    """DC-link voltage at a time."""

    time: Instant = Field(description="time (s)")
    voltage: Voltage = Field(description="DC-link voltage (V)")


class SpeedProfileSection(Section):
    """Speed over time."""

    points: Annotated[Listing[SpeedPointSection], Field(min_length=1, max_length=_MOST)] | None = (
        Field(default=None, description=_POINTS.replace("value", "speed") + "; default: rest")
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: PointSpeed | None = Field(
        default=None, description="of a sine on top (rad/s; write rpm)"
    )
    frequency: ProfileFrequency | None = Field(default=None, description="of that sine (Hz)")


class TorqueProfileSection(Section):
    """Torque over time."""

    points: Annotated[Listing[TorquePointSection], Field(min_length=1, max_length=_MOST)] | None = (
        Field(default=None, description=_POINTS.replace("value", "torque") + "; default: none")
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: PointTorque | None = Field(default=None, description="of a sine on top (N m)")
    frequency: ProfileFrequency | None = Field(default=None, description="of that sine (Hz)")


class LoadSection(TorqueProfileSection):
    """Load torque over time."""

    kind: StartLoadName | None = Field(
        default=None,
        description=(
            "active: it acts at rest too; friction: it resists motion either way and holds the "
            "shaft; default active, without encoder that of control.start_up"
        ),
    )


class CurrentProfileSection(Section):
    """Currents over time."""

    points: Annotated[Listing[CurrentPointSection], Field(min_length=1, max_length=_MOST)] = Field(
        description="a list of {time: ..., i_d: ..., i_q: ...}, times ascending"
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )


class VoltageProfileSection(Section):
    """DC-link voltage over time."""

    points: (
        Annotated[Listing[VoltagePointSection], Field(min_length=1, max_length=_MOST)] | None
    ) = Field(
        default=None, description=_POINTS.replace("value", "voltage") + "; default: inverter.v_dc"
    )
    shape: Shape = Field(
        default="hold", description="hold: until the next point; linear: lines between points"
    )
    amplitude: RippleVoltage | None = Field(
        default=None, description="of a sinusoidal ripple on top (V, peak)"
    )
    frequency: ProfileFrequency | None = Field(default=None, description="of that ripple (Hz)")


class EncoderSection(Section):
    """Position sensor."""

    lines: Whole = Field(
        default=_ENCODER.lines,
        ge=0,
        le=10_000_000,
        description="per revolution, four counts each; 0: exact",
    )
    speed: SpeedSource = Field(
        default=_ENCODER.speed,
        description=(
            "difference of the counts over a speed period, exact, that of control.observer, or "
            "measured by control.speed_loop.measurement, the default where that is there"
        ),
    )
    misalignment: Angle | None = Field(
        default=None, description="added to the electrical angle (rad; write deg)"
    )
    absent: bool = Field(
        default=_ENCODER.absent,
        description="there is none, control.start_up starts the drive; encoder: none for short",
    )


def _no_encoder(value: object) -> object:
    """The word none as what it stands for."""
    return {"absent": True} if value == "none" else value


class SensorlessSection(Section):
    """Control with angle and speed of the position observer (control.observer)."""

    above: PointSpeed = Field(
        description="from this speed on, mechanical, in either direction (rad/s; write rpm)"
    )
    below: PointSpeed | None = Field(
        default=None,
        description=(
            "under it the encoder takes over again (rad/s; write rpm); default 80 % of above"
        ),
    )


class CurrentSensorSection(Section):
    """Sensors and converters of the phase currents."""

    bits: Whole = Field(default=_SENSOR.bits, ge=0, le=24, description="of the converter; 0: exact")
    full_scale: Current | None = Field(
        default=None, description="the converter spans minus to plus this current (A)"
    )
    noise: NoiseCurrent | None = Field(
        default=None, description="standard deviation of normal noise (A)"
    )
    offset: Annotated[Listing[SignedCurrent], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="of the phases a, b and c, such as [10 mA, 0 A, -20 mA]"
    )
    gain_error: Annotated[Listing[SmallError], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="of the phases a, b and c, such as [1 %, 0, -1 %]"
    )


class PlantErrorsSection(Section):
    """How the simulated drive differs from the data that its controller was made for (write
    20 %).
    """

    resistance: RelativeError | None = Field(default=None, description="relative; default 0")
    inductance_d: RelativeError | None = Field(default=None, description="relative; default 0")
    inductance_q: RelativeError | None = Field(default=None, description="relative; default 0")
    magnet_flux: RelativeError | None = Field(default=None, description="relative; default 0")
    inertia: RelativeError | None = Field(default=None, description="relative; default 0")
    v_dc: RelativeError | None = Field(default=None, description="relative; default 0")


class PhaseOpeningSection(Section):
    """A phase that opens while the drive runs."""

    phase: OpenPhase = Field(description="a, b or c")
    time: Instant = Field(
        description="from which its switches rest (s); open for good once its current is gone"
    )
    detected_after: Instant | None = Field(
        default=None,
        description="time until the controller is told (s); default: never",
    )


class InitialSection(Section):
    """State at the start."""

    speed: PointSpeed | None = Field(
        default=None, description="mechanical speed (rad/s; write rpm); default 0"
    )
    angle: Angle | None = Field(
        default=None, description="electrical angle (rad; write deg); default 0"
    )


class SimulationSection(Section):
    """A simulation in the time domain with the emitted controller, whose reference is a
    speed, a torque or currents.
    """

    duration: Duration = Field(description="simulated time (s)")
    speed: SpeedProfileSection | None = Field(
        default=None, description="reference of the speed controller"
    )
    torque: TorqueProfileSection | None = Field(default=None, description="torque reference")
    current: CurrentProfileSection | None = Field(default=None, description="current references")
    load: LoadSection = Field(
        default_factory=LoadSection, description="load torque, against positive speed"
    )
    shaft: SpeedProfileSection | None = Field(
        default=None, description="speed that a load machine imposes; default: the shaft is free"
    )
    v_dc: VoltageProfileSection | None = Field(
        default=None, description="DC-link voltage; default inverter.v_dc"
    )
    inverter: InverterModel = Field(
        default="averaged",
        description="averaged: duty cycles as voltages; switched: every switching instant",
    )
    dead_time: DeadTime | None = Field(
        default=None, description="dead time (s); default inverter.dead_time"
    )
    encoder: Annotated[EncoderSection, BeforeValidator(_no_encoder)] = Field(
        default_factory=EncoderSection, description="position sensor, or none"
    )
    sensorless: SensorlessSection | None = Field(
        default=None,
        description=(
            "angle and speed from the position observer at speed; default: from the encoder"
        ),
    )
    current_sensor: CurrentSensorSection = Field(
        default_factory=CurrentSensorSection, description="current sensors"
    )
    errors: PlantErrorsSection = Field(
        default_factory=PlantErrorsSection, description="differences from the data"
    )
    initial: InitialSection = Field(
        default_factory=InitialSection, description="state at the start"
    )
    open_phase: PhaseOpeningSection | None = Field(
        default=None, description="a phase that opens (machines of model: waveform); default: none"
    )
    stop: Instant | None = Field(
        default=None, description="the command of a drive without encoder goes (s); default: never"
    )
    seed: Whole = Field(default=1, ge=0, le=2**31, description="of the noise")
    steps: Annotated[int, Field(ge=1, le=1000), BeforeValidator(not_truth)] | None = Field(
        default=None,
        description="integration steps per control period; default: as many as the accuracy needs",
    )
