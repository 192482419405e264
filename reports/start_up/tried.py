"""The emitted start-up read back from a result, and the runs that prove it against its model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.estimators import TRACKERS
from dqforge.optimizer.start_up.start_records import StartupState
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.c_code.harness import Harness, Programme, single_from
from dqforge.reports.observers.position_header import observer_from, tracker_from, tracker_programme
from dqforge.reports.phase_control.emitted_integers import emitted_control_from
from dqforge.reports.start_up.float32_reading import MEMBERS, StartUpModel, StartUpRun
from dqforge.reports.start_up.header import LOW_FILE

if TYPE_CHECKING:
    from dqforge.optimizer.curves.single_precision import SingleArray
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


# Sequences that take the emitted state machine through every state and fault: a short-lived drive
# in closed loop with its model, whose samples the C code gets as they were.
#
# Settings are data, so that a start takes some hundred samples: times are shortened, accelerations
# raised, the inertia is chosen to fit.

SEEN = 7  # Columns before the settings: start flag, i_a, i_b, i_c, v_dc, reference, command.
OUTPUTS = 13
HEARING = SEEN + 1  # The same with the mean sum of the phase voltages behind them.
_LENGTH = 440
_ZERO = np.float32(0.0)
# Samples at rest after which nothing follows, and the states of that rest.
_REST, _OVER = 8, (StartupState.IDLE, StartupState.FAULT)
_QUICK = 3.0  # samples in which the whole torque reaches the hand-over

_SHORT = {
    "flying": 0, "retries": 1, "align_samples": 50, "agree_samples": 4, "patience_samples": 60,
    "fade_samples": 12, "stall_samples": 6, "settled_samples": 6, "ratio_samples": 4,
    "wait_samples": 6, "search_samples": 24, "polarity_samples": 8, "catch_samples": 4,
    "pause_samples": 3,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Sequence:
    """One start: what differs from the shortened settings, and what happens.

    ``speeds`` are (sample, share of the hand-over speed), ``bad`` the samples that are no numbers;
    ``blocked`` and ``collapse`` are samples from which the shaft stands or the dc link is low,
    ``surge`` the one in which a current is far too large, ``stop`` the one from which the command
    is gone. ``spin`` is the first speed over that of the hand-over; ``load`` and ``drag`` are
    sliding friction, and viscous friction at that speed, over the largest torque. ``deaf`` are the
    samples in which the sum of the phase voltages is no number.
    """

    settings: Mapping[str, float] = field(default_factory=dict)
    speeds: tuple[tuple[int, float], ...] = ((0, 2.0),)
    bad: tuple[int, ...] = ()
    surge: int = -1
    collapse: int = _LENGTH
    blocked: int = _LENGTH
    stop: int = _LENGTH
    spin: float = 0.0
    load: float = 0.1
    drag: float = 0.15
    deaf: tuple[int, ...] = ()


def _common() -> tuple[Sequence, ...]:
    ramp: Mapping[str, float] = {"method": 0, "alignment": 2}
    there_and_back = ((0, 2.0), (260, 0.3))
    return (
        Sequence(ramp, there_and_back),
        Sequence(ramp, ((0, -2.0),), stop=250),
        Sequence({**ramp, "alignment": 1}, bad=(20, 300)),
        Sequence({**ramp, "alignment": 0}, surge=90),
        Sequence({**ramp, "alignment": 3}, collapse=200),
        Sequence({"method": 1, "alignment": 3}, bad=(140,)),
        Sequence({"method": 2, "alignment": 1}, blocked=150),
        Sequence({"method": 2, "alignment": 1}, ((0, 0.4), (200, 2.0)), stop=330),
        Sequence(ramp, blocked=0),
        Sequence({**ramp, "flying": 1}, spin=1.6, stop=200, load=0.0, drag=0.0),
        Sequence({**ramp, "flying": 1}, spin=-0.8, bad=(5,)),
        Sequence({**ramp, "flying": 1}, spin=0.0),
        Sequence(
            {**ramp, "flying": 1, "ratio_low": 1.3, "ratio_above": 1.0},
            spin=2.0,
            load=0.0,
            drag=0.0,
        ),
    )


def _salient() -> tuple[Sequence, ...]:
    own: Mapping[str, float] = {"method": 3, "alignment": 0, "polarity_share": -1.0}
    return (
        Sequence(own, ((0, 1.6), (240, 0.2), (330, 1.6))),
        Sequence({**own, "polarity_share": 2.0}),
        Sequence({**own, "alignment": 1}, ((0, -1.6),), stop=260),
        Sequence({**own, "flying": 1}, spin=0.8, bad=(90,), load=0.0, drag=0.0),
        Sequence(
            {**own, "flying": 1}, ((0, 1.5), (120, 0.2)), spin=1.6, stop=350, load=0.0, drag=0.0
        ),
        Sequence(own, bad=(10, 40)),
    )


def _hearing() -> tuple[Sequence, ...]:
    ramp: Mapping[str, float] = {"method": 0, "alignment": 2}
    slowly: Mapping[str, float] = {**ramp, "agree_samples": 30}
    return (
        Sequence(slowly, ((0, 1.3), (330, 0.3)), deaf=(40, 170, 300), load=0.3),
        Sequence(slowly, ((0, -1.3),), deaf=(180, 181)),
        Sequence({**ramp, "agree_samples": 200}, blocked=0),
    )


def sequences(model: StartUpModel) -> tuple[Sequence, ...]:
    """What is tried of a machine; starts by saliency where it has an estimator for them.

    Args:
        model: The machine.
    """
    if model.hears:
        return _common() + _hearing()
    return _common() if model.low is None else _common() + _salient()


def shortened(model: StartUpModel, sequence: Sequence) -> dict[str, float]:
    """Settings of a sequence, numbers of single precision.

    Args:
        model: The machine.
        sequence: What differs.
    """
    own = dict(model.settings)
    hand_over, most = own["hand_over"], max(own["align_A"], own["ramp_A"])
    shorter: dict[str, float] = {
        **_SHORT,
        "align_A": most,
        "ramp_A": most,
        "ramp_A_step": 0.1 * most,
        "ramp_step": hand_over / 60.0,
        "ramp_jerk": hand_over / 1200.0,
        "mean_share": 0.05,
        "run_step": hand_over / 40.0,
        "mix_step": 0.1,
        "ratio_share": 0.1,
        "agree_share": 0.3,
        "ratio_low": -2.0,
        "ratio_high": 4.0,
        "polarity_A": 0.5 * most,
    }
    shorter["ratio_above"] = 1.2 * hand_over
    given = {name: value for name, value in sequence.settings.items() if name != "ratio_above"}
    if "ratio_above" in sequence.settings:
        given["ratio_above"] = sequence.settings["ratio_above"] * hand_over
    values = own | shorter | given
    values["align_rise"] = 2.0 / values["align_samples"]
    whole = {member.name for member in MEMBERS if member.whole}
    return {
        name: int(value) if name in whole else float(np.float32(value))
        for name, value in values.items()
    }


class _Plant:
    """A drive in double precision between two samples: its currents, speed and angle."""

    def __init__(self, settings: Mapping[str, float], pole_pairs: float, v_dc: float) -> None:
        """Take the machine from the settings; the inertia lets a start last 100 samples."""
        self.s, self.v_dc, self.t_s = settings, v_dc, settings["t_s"]
        torque = settings["torque_per_A"] * settings["ramp_A"]
        self.per_torque = settings["hand_over"] / (_QUICK * self.t_s * torque)
        self.load = torque
        self.i_d = self.i_q = self.theta = self.omega = 0.0
        self.pole_pairs = pole_pairs

    def phases(self) -> tuple[float, float, float]:
        """Phase currents in A."""
        vector = complex(self.i_d, self.i_q) * np.exp(1j * self.theta)
        return (
            float(vector.real),
            float((vector * np.exp(-2j * np.pi / 3)).real),
            float((vector * np.exp(2j * np.pi / 3)).real),
        )

    def sum_flux(self, gains: Any) -> float:
        """Integral of the sum of the phase voltages in V s, as a tracker knows it."""
        return float(gains.amplitude * math.cos(3.0 * self.theta - gains.phase))

    def go(self, duty: tuple[float, float, float], gate: int, sequence: Sequence) -> None:
        """One period; without gate pulses the currents are gone at its end."""
        s, steps = self.s, 4
        h = self.t_s / steps
        turn = np.exp(2j * np.pi / 3)
        v = self.v_dc * (2.0 / 3.0) * (duty[0] + turn * duty[1] + turn.conjugate() * duty[2])
        if not gate:
            self.i_d = self.i_q = 0.0
        for _ in range(steps):
            along = v * np.exp(-1j * self.theta)
            if gate:
                d = (along.real - s["r_s_Ohm"] * self.i_d) / s["l_d_H"]
                q = (along.imag - s["r_s_Ohm"] * self.i_q - self.omega * s["psi_pm_Wb"]) / s[
                    "l_q_H"
                ]
                d += self.omega * s["l_q_H"] * self.i_q / s["l_d_H"]
                q -= self.omega * s["l_d_H"] * self.i_d / s["l_q_H"]
                self.i_d, self.i_q = self.i_d + h * d, self.i_q + h * q
            torque = (s["torque_per_A"] + s["reluctance"] * self.i_d) * self.i_q
            share = self.omega / s["hand_over"]
            sliding = sequence.load * math.tanh(30.0 * share)
            drag = self.load * (sliding + sequence.drag * share)
            self.omega += h * (torque - drag) * self.per_torque
            self.theta = math.remainder(self.theta + h * self.omega, 2.0 * math.pi)


def _number(value: float) -> float:
    return float(np.float32(value))


def _row(sequence: Sequence, k: int, plant: _Plant, settings: Mapping[str, float]) -> list[float]:
    """Samples, reference and command of an instant."""
    phases = list(plant.phases())
    if k in sequence.bad:
        phases[k % 3] = math.nan
    if k == sequence.surge:
        phases = [3.0 * settings["trip_A"], *phases[1:]]
    v_dc = 0.2 * plant.v_dc if k >= sequence.collapse else plant.v_dc
    share = [value for start, value in sequence.speeds if start <= k][-1]
    reference = share * settings["hand_over"] / plant.pole_pairs
    run = 0.0 if k >= sequence.stop else 1.0
    return [1.0 if k == 0 else 0.0, *(_number(x) for x in (*phases, v_dc, reference)), run]


def _outputs(run: StartUpRun, duty: tuple[float, ...], gate: int) -> list[float]:
    drive = run.drive
    return [
        *(float(x) for x in duty),
        float(gate),
        float(drive.state),
        float(drive.fault),
        float(drive.theta_e),
        float(drive.omega_e),
        float(drive.observer.theta_e),
        float(drive.reference),
        *(float(x) for x in drive.control.v),
        float(drive.emf),
    ]


def recorded(model: StartUpModel, v_dc: float) -> tuple[SingleArray, SingleArray]:
    """What the C code is given, (N, 7 or 8 + settings), and what it must answer, shape (N, 13).

    Args:
        model: The machine.
        v_dc: Voltage of the dc link in V.
    """
    pole_pairs = float(model.control.gains["pole_pairs"])
    inputs, outputs = [], []
    with np.errstate(all="ignore"):  # samples that are no numbers go in
        for sequence in sequences(model):
            settings = shortened(model, sequence)
            settings["v_dc_min_V"] = _number(0.5 * v_dc)
            settings["trip_A"] = _number(4.0 * settings["ramp_A"])
            run, plant = StartUpRun(model, settings), _Plant(settings, pole_pairs, v_dc)
            plant.omega = sequence.spin * settings["hand_over"]
            plant.theta = 1.0 if settings["alignment"] == 2 else 0.2
            tail = [settings[member.name] for member in MEMBERS]
            waiting: tuple[tuple[float, float, float], int] = ((0.5, 0.5, 0.5), 0)
            before = plant.sum_flux(model.gains) if model.hears else 0.0
            for k in range(_LENGTH):
                row = _row(sequence, k, plant, settings)
                u = _ZERO
                if model.hears:
                    flux = plant.sum_flux(model.gains)
                    u = np.float32(
                        (flux - before) / plant.t_s if k not in sequence.deaf else math.nan
                    )
                    before = flux
                    row.append(float(u))
                i_a, i_b, i_c, link, reference = map(np.float32, row[1:6])
                duty, gate = run.step((i_a, i_b, i_c), link, reference, int(row[6]), u)
                inputs.append([*row, *tail])
                outputs.append(_outputs(run, duty, gate))
                plant.go(*waiting, sequence)
                if run.drive.state in _OVER and run.drive.time > _REST:
                    break
                a, b, c = (float(x) for x in duty)
                waiting = ((a, b, c), gate)
                if k >= sequence.blocked:
                    plant.omega = 0.0
    return (
        np.array(inputs, dtype=np.float32),
        np.array(outputs, dtype=np.float32),
    )


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
