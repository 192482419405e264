"""What a drive goes through in a simulation: references, load, sensors,
and how the machine differs from its data.
"""

from __future__ import annotations

from dataclasses import field
from itertools import pairwise
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.names import OpenPhase, StartLoadName
from dqforge.machines.records import dataclass

ControlMode = Literal["speed", "torque", "current", "open-loop"]


InverterModel = Literal["averaged", "switched"]


Shape = Literal["hold", "linear"]


SpeedSource = Literal["difference", "exact", "observer", "measured"]


@dataclass(frozen=True, slots=True)
class Profile:
    """A value over time: points, held until the next or joined by lines, and a sine on top.

    Before its first point and behind its last one the value is that of the point.

    Args:
        times: In s, strictly ascending, at least one.
        values: In the unit of what they describe, as many.
        shape: ``hold`` or ``linear``.
        amplitude, frequency: Of amplitude sin(2 pi frequency t), in the unit of the values and in
            Hz.

    Raises:
        InputError: No point, times that do not ascend, or a number that is not finite.
    """

    times: tuple[float, ...] = (0.0,)
    values: tuple[float, ...] = (0.0,)
    shape: Shape = "hold"
    amplitude: float = 0.0
    frequency: float = 0.0

    def __post_init__(self) -> None:
        """Refuse points that are no function of time."""
        if not self.times or len(self.times) != len(self.values):
            raise InputError(
                f"a profile needs as many times as values, got {len(self.times)} and "
                f"{len(self.values)}"
            )
        numbers = np.array([*self.times, *self.values, self.amplitude, self.frequency])
        if not np.all(np.isfinite(numbers)):
            raise InputError("a profile must consist of finite numbers")
        for before, after in pairwise(self.times):
            if after <= before:
                raise InputError(
                    f"time {after:g} s does not lie after {before:g} s; let the times of a profile "
                    "ascend"
                )

    def at(self, time: FloatArray) -> FloatArray:
        """Values at times in s, any shape."""
        times, values = np.array(self.times), np.array(self.values)
        if self.shape == "linear":
            found = np.interp(time, times, values)
        else:
            found = values[np.maximum(np.searchsorted(times, time, side="right") - 1, 0)]
        return np.asarray(
            found + self.amplitude * np.sin(2.0 * np.pi * self.frequency * np.asarray(time))
        )

    @property
    def largest(self) -> float:
        """Bound of the magnitude."""
        return float(np.max(np.abs(self.values))) + abs(self.amplitude)

    def scaled(self, factor: float) -> Profile:
        """The profile times a factor."""
        values = tuple(factor * value for value in self.values)
        return Profile(self.times, values, self.shape, factor * self.amplitude, self.frequency)


def constant(value: float) -> Profile:
    """A profile that never changes."""
    return Profile((0.0,), (value,))


@dataclass(frozen=True, slots=True)
class Encoder:
    """Position sensor.

    ``lines`` per revolution give four times as many counts; 0 is an exact angle. ``speed`` comes
    from the ``difference`` of the counts over a period of the speed controller, from the
    ``observer`` of the design, is ``measured`` as the design says, or is ``exact``.
    ``misalignment`` in rad (electrical) is added to the angle. For a ``measured`` speed ``edges``
    of each line are captured by a timer of ``clock`` Hz.
    ``absent``: there is none, the drive starts by `control.start_up`.
    """

    lines: int = 0
    speed: SpeedSource = "difference"
    misalignment: float = 0.0
    edges: int = 4
    clock: float = 0.0
    absent: bool = False


@dataclass(frozen=True, slots=True)
class Sensorless:
    """Control with angle and speed of the position observer while the drive turns fast enough.

    It begins where the speed that the controller knows reaches ``above`` and ends where that falls
    under ``below``, both mechanical in rad/s.

    Raises:
        InputError: A speed is negative, or ``below`` exceeds ``above``.
    """

    above: float
    below: float

    def __post_init__(self) -> None:
        """Refuse speeds between which it would never rest."""
        if not 0.0 <= self.below <= self.above < np.inf:
            raise InputError(
                f"sensorless control from {self.above:g} rad/s cannot end below {self.below:g} "
                "rad/s"
            )


@dataclass(frozen=True, slots=True)
class CurrentSensor:
    """Sensors and converters of the phase currents.

    ``bits`` (0: exact) span -``full_scale`` to +``full_scale`` A; ``noise`` in A is the standard
    deviation of a normal distribution; ``offset`` in A and ``gain_error`` (relative) are those of
    the phases a, b and c.
    """

    bits: int = 0
    full_scale: float = 1.0
    noise: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain_error: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PlantErrors:
    """How the plant differs from the data that the controller was made for, relative:
    0.1 is 10 % more.

    ``l_d`` and ``l_q`` scale flux linkages without the magnets', of saturated machines those of
    each axis; of machines with another back-EMF than a sine ``l_d`` scales the inductance,
    ``psi_pm`` the whole back-EMF.
    """

    r_s: float = 0.0
    l_d: float = 0.0
    l_q: float = 0.0
    psi_pm: float = 0.0
    inertia: float = 0.0
    v_dc: float = 0.0


@dataclass(frozen=True, slots=True)
class PhaseOpening:
    """A phase that opens while the drive runs.

    Its switches rest from ``time`` in s on; once its diodes have let its current die it is open for
    good. The controller is told ``detected_after`` s later, never where that is None.
    """

    phase: OpenPhase
    time: float
    detected_after: float | None = None

    def __post_init__(self) -> None:
        """Refuse instants before the start."""
        if not 0.0 <= self.time < np.inf or (self.detected_after or 0.0) < 0.0:
            raise InputError(
                f"phase {self.phase} cannot open at {self.time:g} s and be found after "
                f"{self.detected_after} s; neither may be negative"
            )


@dataclass(frozen=True, slots=True)
class ElasticBrake:
    """A brake that holds the shaft by a spring where it is at ``time`` in s.

    ``stiffness`` in N m/rad, positive, and ``damping`` in N m s/rad (mechanical).
    """

    time: float
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """One simulation.

    Args:
        duration: In s.
        mode: What `reference` is: mechanical speed in rad/s, torque in N m, i_q in A (then
            `reference_d` is i_d in A), or for ``open-loop`` the duty cycle of phase a (and
            `reference_d` that of b; c takes what is missing to 1.5).
        reference, reference_d: References over time; the controller sees them at its samples.
        load: Load torque in N m, against positive speed.
        shaft: Mechanical speed in rad/s that a load machine imposes; None where the shaft is free.
        v_dc: DC-link voltage in V over time; None for that of the inverter.
        inverter: ``averaged``: duty cycles act as voltages; ``switched``: every switching instant
            of a symmetric carrier.
        dead_time: In s; None for that of the inverter.
        encoder, sensor, errors: Sensors, and differences between plant and data.
        omega_m, theta_e: Speed in rad/s (mechanical) and electrical angle in rad at the start.
        seed: Of the noise.
        sensorless: When angle and speed come from the position observer; None for never.
        sub_steps: Integration steps per control period; None for as many as the accuracy needs.
        open_phase: Phase that opens; None for none. Phase machines only.
        duties: Duty cycles of all legs over time for ``open-loop``, in the order of `TOPOLOGIES`,
            instead of the references; empty for none.
        load_kind: ``active``: the load acts always, as a hoist does; ``friction``: it is the
            magnitude of a torque that acts against the motion, whichever way, and holds a shaft at
            rest.
        brake: A brake that grips during the run; None for none.
        stop: Instant in s at which the command of a drive without encoder goes; None for never.
    """

    duration: float
    mode: ControlMode
    reference: Profile
    reference_d: Profile = field(default_factory=Profile)
    load: Profile = field(default_factory=Profile)
    shaft: Profile | None = None
    v_dc: Profile | None = None
    inverter: InverterModel = "averaged"
    dead_time: float | None = None
    encoder: Encoder = field(default_factory=Encoder)
    sensor: CurrentSensor = field(default_factory=CurrentSensor)
    errors: PlantErrors = field(default_factory=PlantErrors)
    omega_m: float = 0.0
    theta_e: float = 0.0
    seed: int = 1
    sub_steps: int | None = None
    sensorless: Sensorless | None = None
    open_phase: PhaseOpening | None = None
    duties: tuple[Profile, ...] = ()
    load_kind: StartLoadName = "active"
    brake: ElasticBrake | None = None
    stop: float | None = None
