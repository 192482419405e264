"""The sections that say what knows the position and the speed: ``control.observer``,
``control.speed_loop.measurement`` and ``control.six_step``, with what observer and loop leave
to each other; and what knows the machine, ``control.online_estimation``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, ValidatorFunctionWrapHandler, WrapValidator

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import (
    SPEED_ERROR,
    CommissioningSettings,
    ObserverSettings,
    OnlineEstimationSettings,
    SixStepSettings,
    SpeedLoopSettings,
    SpeedMeasurementSettings,
    Tolerances,
    settings_from,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.entries.kinds import (
    Bandwidth,
    Drop,
    FilterTime,
    PhaseCurrent,
    PointSpeed,
    SampleInterval,
    Section,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule, not_truth, si_of
from dqforge.machines.errors import KeyPath
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    OBSERVER_KEYS,
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    InjectionWave,
    ObserverMethodName,
    ObserverTuningName,
    SpeedMeasurementName,
)


def _known(value: Any, words: ValidatorFunctionWrapHandler) -> Any:
    """Let a registered method pass; all else is judged by the words of the package."""
    return value if isinstance(value, str) and value in OBSERVER_KEYS else words(value)


def _users(key: str) -> str:
    """The methods that take a key, in words."""
    return " and ".join(name for name, keys in OBSERVER_KEYS.items() if key in keys)


_Neurons = Annotated[int, Field(ge=1, le=16)]
HiddenLayers = Annotated[tuple[_Neurons, _Neurons], Field(strict=False)]
CorrectionTime = Annotated[Quantity, QuantityRule("time", 1e-3, 1.0)]
CorrectionLimit = Annotated[Quantity, QuantityRule("angle", 1e-3, 2.0)]
SpeedError = Annotated[Quantity, QuantityRule("number", 1e-4, 0.5)]
InjectedVoltage = Annotated[Quantity, QuantityRule("voltage", 1e-3, 2e4)]


class ObserverSection(Section):
    """Speed or position observer."""

    method: Annotated[ObserverMethodName, WrapValidator(_known)] = Field(
        default=SPEED_OBSERVER, description="how speed or position is observed"
    )
    pole: Bandwidth | None = Field(
        default=None,
        description="for reduced-order: the pole lies at -pole (rad/s, or Hz times 2 pi)",
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="of the EMF filter or of the flux correction at rest (rad/s, or Hz times 2 pi)",
    )
    pll_bandwidth: Bandwidth | None = Field(
        default=None,
        description="natural frequency of the phase-locked loop (rad/s, or Hz times 2 pi)",
    )
    damping: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None, description="damping ratio of the phase-locked loop; default 1"
    )
    speed_gain: Annotated[float, Field(ge=0.0, le=10.0)] | None = Field(
        default=None,
        description=f"for {_users('speed_gain')}: share of the speed in the correction of the flux",
    )
    hidden_layers: HiddenLayers | None = Field(
        default=None,
        description="for neural: neurons of both hidden layers, such as [8, 8]; at most 16",
    )
    correction_filter: CorrectionTime | None = Field(
        default=None,
        description=(
            f"for {_users('correction_filter')}: time constant before the correction of the angle "
            "(s); default 20 ms"
        ),
    )
    correction_limit: CorrectionLimit | None = Field(
        default=None,
        description=(
            f"for {_users('correction_limit')}: largest correction of the angle (rad; write deg); "
            "default the largest error of the training"
        ),
    )
    wave: InjectionWave | None = Field(
        default=None,
        description=(
            "for injection: square (half the sampling frequency, the default), sine on the assumed "
            "d axis, or rotating"
        ),
    )
    voltage: InjectedVoltage | None = Field(
        default=None, description=f"for {_users('voltage')}: amplitude of the injected voltage (V)"
    )
    samples: Annotated[int, Field(ge=2, le=16)] | None = Field(
        default=None, description="for injection: samples per injected period; default 2 or 10"
    )
    period: SampleInterval | None = Field(
        default=None,
        description=f"for {_users('period')}: from one sequence of pulses to the next (s)",
    )
    max_speed_error: SpeedError | None = Field(
        default=None,
        description=(
            "largest error of the speed within the tolerances at which the speed loop counts as "
            f"holding (share or %); default {100.0 * SPEED_ERROR:.3g} %"
        ),
    )
    tuning: ObserverTuningName = Field(
        default="named",
        description="named: unset values take their defaults; optimised: they are searched for",
    )


_OBSERVER_ENTRIES = (
    *("pole", "bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    *("wave", "voltage", "samples", "period"),
    *("hidden_layers", "correction_filter", "correction_limit"),
)

# Methods whose speed loop is not judged on them.
_TOLD_NO_SPEED = (SPEED_OBSERVER, *SIX_STEP_METHODS)


def check_observer(
    observer: ObserverSection, document: YamlDocument, path: KeyPath = ("control", "observer")
) -> None:
    """Check that an observer has the keys that its method needs, and no other.

    ``path`` is where it stands. Raises `InputError` with a position.
    """
    used, where = OBSERVER_KEYS[observer.method], ".".join(map(str, path))
    if observer.method == SPEED_OBSERVER and observer.pole is None:
        message = (
            "control.observer: the method 'reduced-order' needs the key 'pole'; write pole: 400 "
            "rad/s"
        )
        raise document.error(message, path, key=True)
    if observer.max_speed_error is not None and (
        path != ("control", "observer") or observer.method in _TOLD_NO_SPEED
    ):
        raise document.error(
            f"{where}.max_speed_error is for a speed loop that runs on control.observer, by a "
            "method that observes the position; remove it",
            (*path, "max_speed_error"),
            key=True,
        )
    for key in _OBSERVER_ENTRIES:
        if getattr(observer, key) is not None and key not in used:
            raise document.error(
                f"{where}: the method '{observer.method}' does not use '{key}'; remove it, or "
                f"write another method (it uses {', '.join(used) or 'no key but tuning'})",
                (*path, key),
                key=True,
            )


# Speed loop and position observer of a design that leaves the spread of the loop open.

SPREAD = 4.0  # Spread of a speed loop that counts the lag of its observer: about 60 degrees.

# Share of the speed in the correction of the flux: with the whole dead time, and where what is left
# of it is small.
SPEED_GAIN, SPEED_GAIN_COMPENSATED = 1.0, 0.5
COMPENSATED = 0.1  # Largest share of the dead time that counts as small.


def chosen_together(
    loop: SpeedLoopSettings,
    observer: ObserverSettings,
    inverter: Inverter,
    tolerances: Tolerances | None,
    reading: Reading,
) -> tuple[SpeedLoopSettings, ObserverSettings]:
    """Settings of both, with what is assumed said in the remarks of the reading.

    Args:
        loop, observer: As they were read.
        inverter: With its dead time.
        tolerances: What the compensation of the dead time leaves, None where the design names none.
        reading: Takes the remarks.
    """
    reading.remarks.append(
        f"control.speed_loop.spread is taken as {SPREAD:g}, and the observer's lag as one of the "
        "loop's delays, because the loop runs on a position observer"
    )
    loop = replace(loop, spread=SPREAD, counts_observer=True)
    if observer.method != "flux" or observer.speed_gain is not None or observer.tuning != "named":
        return loop, observer
    small = _compensated(inverter, tolerances)
    gain = SPEED_GAIN_COMPENSATED if small else SPEED_GAIN
    reading.remarks.append(
        f"control.observer.speed_gain is taken as {gain:g}, because the speed loop runs on the "
        f"observer{' and little is left of the dead time' if small else ''}"
    )
    return loop, replace(observer, speed_gain=gain)


def _compensated(inverter: Inverter, tolerances: Tolerances | None) -> bool:
    """Whether the design says that at most a tenth of the dead time is left."""
    if inverter.dead_time == 0.0:
        return True
    if tolerances is None:
        return False
    left = max(abs(value) for value in tolerances.limits("dead_time"))
    return 0.0 < left <= COMPENSATED * inverter.dead_time


# The section ``control.speed_loop.measurement``: the speed from the edges of an encoder.

_PATH = ("control", "speed_loop", "measurement")


_SHARE = 0.1  # of the largest speed, from which the loop holds where nothing is said


TimerClock = Annotated[Quantity, QuantityRule("frequency", 1e3, 1e9)]


Whole = Annotated[int, BeforeValidator(not_truth)]


class SpeedMeasurementSection(Section):
    """How the speed comes from the edges of an encoder."""

    method: SpeedMeasurementName = Field(
        default="mixed",
        description=(
            "counts: edges in a speed period; capture: time between two edges; mixed: edges over "
            "the time that they took"
        ),
    )
    lines: Whole = Field(ge=1, le=1_000_000, description="of the encoder, per revolution")
    edges: Whole = Field(
        default=1,
        ge=1,
        le=4,
        description="captured of each line: 1, 2 or 4; counts always takes all four",
    )
    clock: TimerClock | None = Field(
        default=None, description="for capture and mixed: frequency of the timer (Hz)"
    )
    counter_bits: Whole = Field(
        default=16, ge=8, le=32, description="for capture and mixed: bits of the timer"
    )
    lowest: PointSpeed | None = Field(
        default=None,
        description=(
            "mechanical speed from which the loop must hold (rad/s; write rpm); default a tenth "
            "of the largest"
        ),
    )


def check_measurement(
    section: SpeedMeasurementSection | None, observed: bool, document: YamlDocument
) -> None:
    """Check what the keys need of each other.

    ``observed`` says that an observer makes the speed. Raises `InputError` with a position.
    """
    if section is None:
        return
    where = ".".join(_PATH)
    if observed:
        message = (
            f"{where} is of an encoder, but control.observer makes the speed; remove one of them"
        )
        raise document.error(message, _PATH, key=True)
    if section.edges == 3:
        raise document.error(f"{where}.edges must be 1, 2 or 4", (*_PATH, "edges"))
    timed = section.method != "counts"
    if timed and section.clock is None:
        message = (
            f"{where}: the method '{section.method}' needs the key 'clock'; write clock: 10 MHz"
        )
        raise document.error(message, _PATH, key=True)
    for key in ("clock", "counter_bits", "edges"):
        if not timed and key in section.model_fields_set:
            message = f"{where}: the method 'counts' does not use '{key}'; remove it"
            raise document.error(message, (*_PATH, key), key=True)
    if section.lowest is not None and section.lowest.si <= 0.0:
        raise document.error(f"{where}.lowest must be above 0 rpm", (*_PATH, "lowest"))


def read_measurement(
    section: SpeedMeasurementSection | None, omega_max: float
) -> SpeedMeasurementSettings | None:
    """What the section asks for, in SI units; ``omega_max`` in rad/s is the largest speed."""
    if section is None:
        return None
    lowest, clock = si_of(section.lowest), si_of(section.clock)
    return SpeedMeasurementSettings(
        section.method,
        section.lines,
        0.0 if clock is None else clock,
        section.counter_bits,
        4 if section.method == "counts" else section.edges,
        _SHARE * omega_max if lowest is None else lowest,
    )


# The section ``control.six_step``: a drive whose blocks of 120 degrees are commutated by the
# voltage of the phase that floats.

_SETTINGS = SixStepSettings()


class SixStepSection(Section):
    """Six-step drive; only with the observers that make one."""

    voltage_offset: Drop | None = Field(
        default=None,
        description="of the measured voltage of the floating phase, or of its diode's threshold "
        "(V); default 0.2 % of v_dc, of a threshold 0.2 V",
    )
    voltage_noise: Drop | None = Field(
        default=None,
        description="of that voltage, standard deviation (V); default one step of its converter",
    )
    voltage_bits: Annotated[int, Field(ge=8, le=16)] = Field(
        default=_SETTINGS.voltage_bits, description="of its converter, over 1.25 v_dc"
    )
    filter_time: FilterTime | None = Field(
        default=None, description="first-order filter on that voltage (s); default 0"
    )
    start_current: PhaseCurrent | None = Field(
        default=None, description="of alignment and forced start; default half of the limit"
    )
    align_time: FilterTime | None = Field(
        default=None, description="whole time of the alignment (s); default by the inertia"
    )


def read_six_step(section: SixStepSection | None, method: str | None) -> SixStepSettings | None:
    """The settings of a six-step drive, None for other drives.

    Args:
        section: ``control.six_step``, None where the file has none.
        method: ``control.observer.method``, None without an observer.
    """
    if method not in SIX_STEP_METHODS:
        return None
    return settings_from(SixStepSettings, section or SixStepSection())


# The section ``control.online_estimation``: resistance and flux linkage while the drive runs.

_ESTIMATION = OnlineEstimationSettings()

EstimationTime = Annotated[Quantity, QuantityRule("time", 0.01, 1e4)]


class OnlineEstimationSection(Section):
    """Parameters that are estimated while the drive runs; no control function uses them."""

    flux: bool = Field(
        default=_ESTIMATION.flux, description="flux linkage of the magnets, where speed shows it"
    )
    resistance: bool = Field(
        default=_ESTIMATION.resistance, description="resistance, where current shows it"
    )
    time_constant: EstimationTime | None = Field(
        default=None, description="with which they are followed (s); default 5 s"
    )


# The section ``control.commissioning``: tests of the drive on its own machine.

_TESTS = CommissioningSettings()


class CommissioningSection(Section):
    """Tests that the firmware runs on its own machine, with the log that dqforge identify reads."""

    current: PhaseCurrent | None = Field(
        default=None,
        description="current of the tests (A); default half of the current limit",
    )
    speed: PointSpeed | None = Field(
        default=None,
        description="mechanical speed at which coasting begins (rad/s); default: half of the "
        "voltage limit as back-EMF",
    )
    rows: Annotated[int, Field(ge=64, le=16384)] = Field(
        default=_TESTS.rows, description="rows of five floats that the log holds (20 bytes each)"
    )
    shaft_time: EstimationTime | None = Field(
        default=None, description="longest acceleration, and longest coasting (s); default 5 s"
    )


def check_on_line(
    estimation: OnlineEstimationSection | None,
    tests: CommissioningSection | None,
    machine: Machine,
    document: YamlDocument,
    *,
    left_out: bool,
) -> None:
    """Check what the sections need that learn of the machine in the drive.

    ``left_out`` says that nothing is controlled in rotor coordinates by a modulator. Raises
    `InputError` with a position.
    """
    _check_online_estimation(estimation, machine, document, left_out=left_out)
    if tests is not None:
        _check_commissioning(tests, machine.i_max, document, left_out=left_out)


def _check_commissioning(
    section: CommissioningSection, i_max: float, document: YamlDocument, *, left_out: bool
) -> None:
    path = ("control", "commissioning")
    if left_out:
        raise document.error(
            "control.commissioning: its tests are of a control in rotor coordinates of a machine "
            "with a sinusoidal back-EMF; remove it, or the waveform, six_step or switching current "
            "loop",
            path,
            key=True,
        )
    current = si_of(section.current)
    if current is not None and current > i_max:
        raise document.error(
            f"control.commissioning.current: {current:g} A is above the current limit of {i_max:g} "
            "A; write less",
            (*path, "current"),
        )


def _check_online_estimation(
    section: OnlineEstimationSection | None,
    machine: Machine,
    document: YamlDocument,
    *,
    left_out: bool,
) -> None:
    if section is None:
        return
    path = ("control", "online_estimation")

    def fault(message: str) -> Exception:
        return document.error(f"control.online_estimation: {message}", path, key=True)

    if left_out:
        raise fault(
            "it compares the voltage reference of a control in rotor coordinates of a machine with "
            "a sinusoidal back-EMF; remove it, or the waveform, six_step or switching current loop"
        )
    if not isinstance(machine, LinearMachine):
        raise fault(
            "the inductances of this machine change with the current, which it knows nothing of; "
            "remove it, or write model: linear"
        )
    if machine.psi_pm == 0.0:
        raise fault("it needs a magnet flux, the machine has none; remove it")
    if machine.r_s == 0.0:
        raise fault("it needs a resistance above 0 Ohm; write machine.resistance, or remove it")
    if not (section.flux or section.resistance):
        raise fault("neither flux nor resistance is estimated; write one of them as true")
