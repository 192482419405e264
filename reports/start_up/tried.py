"""The emitted start-up read back from a result, and the runs that prove it against its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.estimators import TRACKERS
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.c_code.harness import Harness, Programme, single_from
from dqforge.reports.observers.position_header import observer_from
from dqforge.reports.observers.tracker_header import (
    tracker_from,
    tracker_programme,
)
from dqforge.reports.phase_control.emitted_integers import emitted_control_from
from dqforge.reports.start_up.float32_reading import StartUpModel
from dqforge.reports.start_up.header import HEARING, LOW_FILE, MEMBERS, OUTPUTS, SEEN, recorded

if TYPE_CHECKING:
    from dqforge.optimizer.estimators import Tracker
    from dqforge.optimizer.observers.parts import ObserverMethod
    from dqforge.reports.observers.float32_model import EmittedTracker

_FAULT = InputError("startup_header is not what dqforge writes; run the design again")


@dataclass(frozen=True, slots=True)
class TriedStart:
    """What verification needs: the machine, and the dc link in V that it is tried on."""

    model: StartUpModel
    v_dc: float


def start_up_from(own: Mapping[str, Any], whole: Mapping[str, Any]) -> TriedStart:
    """Read a state machine back from its part of a result and the whole of it.

    Args:
        own: As `plain_start_up` makes it.
        whole: The result, with the headers of control and observers.

    Raises:
        InputError: The data are not what `plain_start_up` makes.
    """
    try:
        method, gains = _at_speed(whole["observer_header"])
        control = emitted_control_from(whole["control_header"], whole)
        low = whole.get("start_observer_header")
        settings = {
            member.name: _whole(own["settings"][member.name])
            if member.whole
            else float(single_from(own["settings"][member.name]))
            for member in MEMBERS
        }
        v_dc = float(single_from(own["v_dc"]))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise _FAULT from error
    found = None if low is None else tracker_from(low)
    return TriedStart(
        StartUpModel(
            control=control,
            method=method,
            gains=gains,
            settings=settings,
            low=None if found is None else (found.tracker, cast(found.gains, SINGLE)),
        ),
        v_dc,
    )


def _at_speed(described: Mapping[str, Any]) -> tuple[ObserverMethod | Tracker, Any]:
    """The estimator at speed with its gains in single precision."""
    if described.get("method") in TRACKERS:
        tracked = tracker_from(described)
        return tracked.tracker, cast(tracked.gains, SINGLE)
    observer = observer_from(described)
    return observer.method, cast(observer.gains, SINGLE)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**32:
        raise ValueError
    return value


def start_up_programme(tried: TriedStart) -> Programme:
    """The harness of the state machine, with what its model answers.

    Args:
        tried: The machine, and the dc link that it is tried on.
    """
    model = tried.model
    inputs, outputs = recorded(model, tried.v_dc)
    return Programme(_harness(model), inputs, outputs, "start-up")


# What comes out of a step, beside the duty cycles and the gate.
_RESULTS = (
    "output.duty.a",
    "output.duty.b",
    "output.duty.c",
    "(float)output.gate",
    "(float)drive.state",
    "(float)drive.fault",
    "drive.theta_e",
    "drive.omega_e",
    "drive.observer.theta_e",
    "drive.reference",
    "drive.control.v.alpha",
    "drive.control.v.beta",
    "drive.emf",
)


def _harness(model: StartUpModel) -> Harness:
    seen = HEARING if model.hears else SEEN
    members = [
        f"    settings.{member.name} = {'(uint32_t)' if member.whole else ''}in[{column}];"
        for column, member in enumerate(MEMBERS, seen)
    ]
    sample = ["i.a", "i.b", "i.c", "v_dc"]
    codes = [model.method.code, *([] if model.low is None else [model.low[0].code])]
    gains = ", ".join(f"&@@_{code.upper()}_GAINS" for code in codes)
    return Harness(
        "startup",
        "start flag, i_a, i_b, i_c, v_dc, reference, command, "
        f"{'sum of the phase voltages, ' if model.hears else ''}all settings; duty cycles, gate, "
        "state, fault, angle, speed, observed angle, reference, voltage, EMF",
        (seen + len(MEMBERS), OUTPUTS),
        (
            "@_startup_sample_t sample;",
            "@_startup_output_t output;",
            "",
            "if (in[0] > 0.0F) {",
            *members,
            "    @_startup_init(&drive);",
            "}",
            *(f"sample.{name} = in[{column}];" for column, name in enumerate(sample, 1)),
            *(["sample.u = in[7];"] if model.hears else []),
            f"output = @_startup_step(&@@_CONTROL_GAINS, &settings, {gains}, &drive, &sample,",
            "                         in[5], (in[6] > 0.5F) ? 1U : 0U);",
            *(f"out[{k}] = {result};" for k, result in enumerate(_RESULTS)),
        ),
        vectors=False,
        states=("static @_startup_t drive;", "static @_startup_settings_t settings;"),
        starts=("@_startup_init(&drive);", "settings = @@_STARTUP_SETTINGS;"),
    )


def start_observer_programme(tracker: EmittedTracker) -> Programme:
    """The harness of the estimator from standstill on.

    Args:
        tracker: The estimator.
    """
    return replace(tracker_programme(tracker, LOW_FILE), name="estimator from standstill on")
