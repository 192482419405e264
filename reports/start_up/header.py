"""The C header of the start-up, as text."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import field
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.reports.c_code.harness import title
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.observers.float32_model import EmittedTracker
from dqforge.reports.observers.position_header import plain_tracker_gains, tracker_files
from dqforge.reports.pages.templating import render
from dqforge.reports.phase_control.emitted_integers import phase_control_of
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.start_up.float32_model import (
    RESTING,
    F,
    Fault,
    Settings,
    StartUpModel,
    State,
    Vector,
    first_drive,
    observer_step,
    off,
    pair,
    scalar,
    trip,
    vector_of,
)
from dqforge.reports.start_up.model_phases import Duties, Phases, follow_ramp

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.start_up.plan import StartUpPlan
    from dqforge.optimizer.start_up.solve import StartUp


LOW_FILE = "start_observer"  # End of the file name of the estimator from standstill on.

_WORDS = {
    "i-f": "a current that turns, at the angle of the ramp",
    "v-f": "a voltage that turns, at the angle of the ramp",
    "direct": "from the alignment into the observer",
    "saliency": "the rotor found by its saliency",
}

_ALIGNMENT_WORDS = {
    "none": "no alignment",
    "one-step": "alignment in one step",
    "two-step": "alignment in two steps",
    "voltage": "alignment by a voltage",
}


def method_words(found: StartUp) -> str:
    """How the drive starts, in words.

    Args:
        found: The start.
    """
    plan = found.plan
    flying = "; a rotor that turns already is caught" if plan.flying else ""
    return f"{_WORDS[plan.method]} ({plan.method}), {_ALIGNMENT_WORDS[plan.alignment]}{flying}"


def load_words(found: StartUp) -> str:
    """Largest load torques, in words.

    Args:
        found: The start.
    """
    others = ", ".join(f"{name} {torque:.4g} N m" for name, torque in found.largest_loads.items())
    return (
        f"largest load torque {found.largest_load:.4g} N m ({found.plan.load_torque:.4g} N m asked "
        f"for); at the current limit: {others}"
    )


def _preamble(found: StartUp, prefix: str) -> list[str]:
    plan = found.plan
    hertz = plan.hand_over / (2.0 * math.pi)
    return [
        *wrap(f"Start: {method_words(found)}; the observer rules from {hertz:.4g} Hz.", 110),
        *wrap(f"It lifts: {load_words(found)}.", 110),
        "",
        f"Call {prefix}_startup_init() once, then {prefix}_startup_step() at every current sample:",
        "it replaces the speed control and calls the observer. State and fault are members of the",
        "structure, which is yours. All settings can be changed: copy the constant structure.",
        "Compile with -ffp-contract=off to equal the model bit for bit.",
    ]


def _setting_lines(found: StartUp) -> list[tuple[str, str]]:
    values = settings_of(found.plan)
    return [
        (
            f"{int(values[member.name])}U" if member.whole else float_literal(values[member.name]),
            f"{member.name}{': ' if member.comment else ''}{member.comment}",
        )
        for member in MEMBERS
    ]


def estimator_at_speed(gains: GainSet) -> tuple[str, bool]:
    """Part of C names of the estimator that a drive runs on after its start, and whether it is told
    the sum of the phase voltages.

    Args:
        gains: Of the design.
    """
    if gains.tracker is not None:
        return gains.tracker.tracker.code, bool(gains.tracker.tracker.hears)
    assert gains.position is not None, "a start has an estimator of the position"
    return gains.position.method.code, False


def phase_parts(solution: Solution) -> PlainData | None:
    """What of the control over the angle the start-up must know, None for other control.

    Args:
        solution: The solved design.
    """
    control = phase_control_of(solution)
    if control is None:
        return None
    return {"by_torque": control.frame != "dq", "feedforward": control.feedforward}


def start_up_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_startup.h``.

    Args:
        solution: The solved design.
        found: Its start.
    """
    design, gains = solution.design, solution.gains
    prefix = design.export.prefix
    code, hears = estimator_at_speed(gains)
    references = gains.references
    context: PlainData = {
        **title(design),
        "preamble": _preamble(found, prefix),
        "code": code,
        "hears": hears,
        "phases": phase_parts(solution),
        "low": "" if found.low is None else found.low.tracker.code,
        "members": MEMBERS,
        "settings": _setting_lines(found),
        "dynamic": None
        if references is None
        else {
            "torque_step": references.torque_step
            if math.isfinite(references.torque_step)
            else None,
            "current_step": references.current_step
            if math.isfinite(references.current_step)
            else None,
        },
    }
    return {f"{prefix}_startup.h": render("start_up/startup.h.j2", context).encode("ascii")}


def start_observer_files(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_start_observer.h``; none without an estimator from standstill.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {} if found.low is None else tracker_files(solution.design, found.low, LOW_FILE)


def every_start_file(solution: Solution, found: StartUp) -> dict[str, bytes]:
    """Names and bytes of the headers of a start.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return start_up_files(solution, found) | start_observer_files(solution, found)


def plain_start_up(solution: Solution, found: StartUp) -> PlainData:
    """The settings, and what the state machine is tried with, as plain data of float32 values.

    Args:
        solution: The solved design.
        found: Its start.
    """
    return {
        "v_dc": solution.design.inverter.v_dc,
        "settings": {
            name: value if isinstance(value, int) else shortest(np.float32(value))
            for name, value in settings_of(found.plan).items()
        },
    }


def plain_start_observer(found: StartUp) -> PlainData | None:
    """The estimator from standstill on as plain data, None without one.

    Args:
        found: The start.
    """
    low = found.low
    return None if low is None else plain_tracker_gains(EmittedTracker(low.tracker, low.gains))


# Sequences that take the emitted state machine through every state and fault: a short-lived drive
# in closed loop with its model, whose samples the C code gets as they were.
#
# Settings are data, so that a start takes some hundred samples: times are shortened, accelerations
# raised, the inertia is chosen to fit.

SEEN = 7  # Columns before the settings: start flag, i_a, i_b, i_c, v_dc, reference, command.
OUTPUTS = 13
HEARING = SEEN + 1  # The same with the mean sum of the phase voltages behind them.
_LENGTH = 440
_ZERO = F(0.0)
_REST, _OVER = 8, (State.IDLE, State.FAULT)  # samples at rest after which nothing follows
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
        float(scalar(drive.observer.theta_e)),
        float(drive.reference),
        *(float(x) for x in drive.made),
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
                    u = F((flux - before) / plant.t_s) if k not in sequence.deaf else F("nan")
                    before = flux
                    row.append(float(u))
                i_a, i_b, i_c = (F(x) for x in row[1:4])
                duty, gate = run.step((i_a, i_b, i_c), F(row[4]), F(row[5]), int(row[6]), u)
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


# The members of ``<prefix>_startup_settings_t`` and their values: a plan in samples, as numbers of
# single precision.

METHODS = ("i-f", "v-f", "direct", "saliency")  # In the order of their numbers in the C code.

# In the order of their numbers in the C code.
ALIGNMENTS = ("none", "one-step", "two-step", "voltage")


@dataclass(frozen=True, slots=True)
class Member:
    """One member: its C type (``float`` or ``uint32_t``), and its value by the plan."""

    name: str
    comment: str
    value: Callable[[StartUpPlan], float]
    whole: bool = False

    @property
    def kind(self) -> str:
        """Its C type."""
        return "uint32_t" if self.whole else "float"


def _samples(time: float, plan: StartUpPlan, least: int = 1) -> int:
    return max(least, min(round(time / plan.t_s), 2**31 - 1))


def _share(time: float, plan: StartUpPlan) -> float:
    """Share of a new sample in a filter of a time constant in s."""
    return -math.expm1(-plan.t_s / time)


def _count(name: str, comment: str, time: Callable[[StartUpPlan], float]) -> Member:
    return Member(name, comment, lambda plan: _samples(time(plan), plan), whole=True)


# The members in the order of the C structure.
MEMBERS: tuple[Member, ...] = (
    Member("method", "0 I-f, 1 V/f, 2 direct, 3 saliency", lambda p: METHODS.index(p.method), True),
    Member(
        "alignment",
        "0 none, 1 one step, 2 two steps, 3 voltage",
        lambda p: ALIGNMENTS.index(p.alignment),
        True,
    ),
    Member("flying", "1: look for a rotor that turns already", lambda p: int(p.flying), True),
    Member("retries", "further tries after a failed start", lambda p: p.retries, True),
    _count("align_samples", "duration of the alignment", lambda p: p.align_time),
    _count("agree_samples", "the observer's speed agrees for so long", lambda p: p.agree_time),
    _count("patience_samples", "beyond the planned end", lambda p: p.patience),
    _count("fade_samples", "in which the held current goes", lambda p: p.fade_time),
    _count("stall_samples", "too slow for so long", lambda p: p.stall_time),
    _count("settled_samples", "above ratio_above for so long", lambda p: p.ratio_settled),
    _count("ratio_samples", "EMF outside its limits for so long", lambda p: p.ratio_time),
    _count("wait_samples", "without current before the next try", lambda p: p.retry_pause),
    _count("search_samples", "to find the axis by saliency", lambda p: p.search_time),
    _count("polarity_samples", "per side of the axis", lambda p: p.polarity_time),
    _count("catch_samples", "longest pulse of a flying start", lambda p: p.catch_longest),
    Member("pause_samples", "between two of them", lambda p: _samples(p.catch_pause, p, 3), True),
    Member("t_s", "sampling period, s", lambda p: p.t_s),
    Member("r_s_Ohm", "phase resistance", lambda p: p.r_s),
    Member("l_d_H", "", lambda p: p.l_d),
    Member("l_q_H", "", lambda p: p.l_q),
    Member("psi_pm_Wb", "", lambda p: p.psi_pm),
    Member("torque_per_A", "3/2 p psi_pm, N m/A", lambda p: p.torque_per_ampere),
    Member(
        "reluctance", "3/2 p (L_d - L_q), N m/A^2", lambda p: 1.5 * p.pole_pairs * (p.l_d - p.l_q)
    ),
    Member("align_A", "current of the alignment", lambda p: p.align_current),
    Member("align_V", "voltage of the alignment", lambda p: p.align_voltage),
    Member(
        "align_rise", "per sample, 0 to 1 in half of it", lambda p: 2.0 / _samples(p.align_time, p)
    ),
    Member("align_damping", "A against the turning rotor per rad/s", lambda p: p.align_damping),
    Member("align_share", "of a new sample in its speed", lambda p: _share(p.align_filter, p)),
    Member("ramp_A", "current of the ramp", lambda p: p.ramp_current),
    Member(
        "ramp_A_step",
        "its change per sample",
        lambda p: p.current_limit * p.t_s / min(0.05, p.align_time or 0.05),
    ),
    Member("ramp_step", "acceleration, rad/s per sample", lambda p: p.ramp_acceleration * p.t_s),
    Member(
        "ramp_jerk",
        "change of ramp_step per sample",
        lambda p: p.ramp_acceleration * p.t_s / _samples(p.ramp_rise, p),
    ),
    Member("boost_V", "voltage of the voltage ramp at rest", lambda p: p.boost),
    Member("damping", "rad/s per V of active voltage above its mean", lambda p: p.damping),
    Member("mean_share", "of that mean, 50 ms", lambda p: _share(0.05, p)),
    Member("hand_over", "the observer rules from here, rad/s", lambda p: p.hand_over),
    Member("mix_from", "its angle counts from here", lambda p: p.mix_from),
    Member("back_below", "it rules no more below, rad/s", lambda p: p.back_below),
    Member("ramp_end", "the ramp ends here, rad/s", lambda p: p.ramp_end),
    Member("agree_share", "of the speed of the ramp", lambda p: p.agree_share),
    Member("held_A", "d current until the observer rules", lambda p: p.held_current),
    Member(
        "run_step", "slope of the reference, rad/s per sample", lambda p: p.run_acceleration * p.t_s
    ),
    Member("stall_below", "rad/s", lambda p: p.stall_below),
    Member("ratio_above", "the EMF is looked at above, rad/s", lambda p: p.ratio_above),
    Member("ratio_low", "least EMF over omega psi", lambda p: p.ratio_low),
    Member("ratio_high", "largest EMF over omega psi", lambda p: p.ratio_high),
    Member("ratio_share", "of a new sample in its filter", lambda p: _share(p.ratio_filter, p)),
    Member("trip_A", "overcurrent", lambda p: p.trip_current),
    Member("v_dc_min_V", "undervoltage; 0: not looked at", lambda p: p.v_dc_min),
    Member("catch_A", "current that a pulse should reach", lambda p: p.catch_current),
    Member("catch_slow", "slower asks for a third pulse, rad/s", lambda p: 0.5 * p.base_speed),
    Member("catch_least", "slower is at rest, rad/s", lambda p: p.catch_least),
    Member("mix_step", "change of the observer's share per sample", lambda p: p.t_s / p.agree_time),
    Member(
        "polarity_share",
        "least difference of the ripples over their sum",
        lambda p: p.polarity_share,
    ),
    Member("polarity_A", "current of the test of the polarity", lambda p: p.polarity_current),
)


def settings_of(plan: StartUpPlan) -> dict[str, float]:
    """Values of all members by name, whole numbers as int.

    Args:
        plan: What the start needs.
    """
    return {
        member.name: int(member.value(plan)) if member.whole else float(member.value(plan))
        for member in MEMBERS
    }


def settings_bytes(plan: StartUpPlan) -> bytes:
    """Bytes of ``<prefix>_startup_settings_t`` on this machine.

    Args:
        plan: What the start needs.
    """
    values = settings_of(plan)
    form = "".join("I" if member.whole else "f" for member in MEMBERS)
    return struct.pack(f"={form}", *(values[member.name] for member in MEMBERS))


# The step of the start-up in single precision, as ``step.j2`` has it.

_HALF = F(0.5)


_MOST = 2_147_483_647


def _guard(phases: Phases, i: Vector, v_dc: Any, wanted: Any, run: int) -> None:
    """As ``<prefix>_startup_guard``."""
    model, s, drive = phases.model, phases.s, phases.drive
    square = (i[0] * i[0]) + (i[1] * i[1])
    told = square < F(1e30) and abs(v_dc) < F(1e15) and abs(wanted) < F(1e15)
    resting = drive.state in RESTING
    if run == 0:
        low = drive.state == State.LOW and s.method == 3
        moving = (
            drive.state == State.RUN
            or (drive.state == State.RAMP and abs(drive.omega_e) > _ZERO)
            or (low and (abs(drive.reference) > _ZERO or abs(drive.omega_e) > F(0.1) * s.hand_over))
        )
        if not moving:
            off(model, drive, State.IDLE)
            drive.fault, drive.tries = Fault.NO_FAULT, 0
    if not resting:
        if drive.state == State.IDLE:
            return
        if not told:
            trip(model, s, drive, Fault.SAMPLE)
        elif square > s.trip_A * s.trip_A:
            trip(model, s, drive, Fault.OVERCURRENT)
        elif v_dc < s.v_dc_min_V:
            trip(model, s, drive, Fault.UNDERVOLTAGE)
    elif run != 0 and told:
        waited = drive.state == State.WAIT and drive.time >= s.wait_samples
        if drive.state == State.IDLE or waited:
            phases.begin(wanted)


class StartUpRun:
    """One drive that starts, step by step; ``settings`` None for those of the model."""

    def __init__(self, model: StartUpModel, settings: dict[str, float] | None = None) -> None:
        """As ``<prefix>_startup_init``."""
        own = Settings(model.settings if settings is None else settings)
        self.model, self.drive = model, first_drive(model)
        self.phases = Phases(model, own, self.drive)

    def _estimate(self, acted: Vector, current: Vector, u: Any) -> None:
        model, s, drive = self.model, self.phases.s, self.drive
        if model.low is not None:
            done = (drive.state == State.SEARCH and drive.time >= s.search_samples) or (
                drive.state == State.POLARITY and drive.time >= 2 * s.polarity_samples
            )
            if done:
                self.phases.found()
            if drive.state in (State.SEARCH, State.POLARITY) or (
                drive.state == State.LOW and s.method == 3
            ):
                tracker, gains = model.low
                assert drive.low is not None
                drive.low = tracker.step(gains, drive.low, pair(*acted), pair(*current), (), SINGLE)
                drive.control.added = drive.low.added
        if model.hears and drive.state == State.RAMP and drive.agreed == 0:
            follow_ramp(model, s, drive)
        if drive.state in (State.RAMP, State.LOW, State.RUN):
            drive.observer = observer_step(model, drive.observer, acted, current, u)

    def _watch(self, acted: Vector, current: Vector, wanted: Any) -> Duties:
        """Speed-driven changes; the currents for the controllers."""
        drive, phases = self.drive, self.phases
        seen = phases.phases
        if drive.state == State.RAMP:
            phases.watch_ramp(current, wanted)
        elif drive.state == State.LOW:
            if self.model.low is not None and phases.s.method == 3:
                seen = phases.mix()
            else:
                drive.theta_e = scalar(drive.observer.theta_e)
                drive.omega_e = scalar(drive.observer.omega_e)
            phases.watch_low()
        elif drive.state == State.RUN:
            phases.watch_run(acted, current)
        return seen

    def step(
        self, i: Duties, v_dc: Any, reference: Any, run: int, u: Any = _ZERO
    ) -> tuple[Duties, int]:
        """Duty cycles and whether there are gate pulses, as ``<prefix>_startup_step``; ``u`` in V
        is the mean sum of the phase voltages, for a tracker that is told it.
        """
        drive, phases, s = self.drive, self.phases, self.phases.s
        acted, current = drive.acted, vector_of(i)
        wanted = phases.pole_pairs * F(reference) if run != 0 else _ZERO
        phases.phases, phases.v_dc = i, F(v_dc)
        duty: Duties = (_HALF, _HALF, _HALF)
        shorted = True
        drive.acted = drive.made
        _guard(phases, current, F(v_dc), wanted, run)
        if drive.state == State.CATCH:
            shorted = phases.catch(current)
        if drive.state == State.ALIGN and (drive.time >= s.align_samples or s.alignment == 0):
            phases.aligned(current, wanted)
        self._estimate(acted, current, u)
        seen = self._watch(acted, current, wanted)
        if drive.state == State.ALIGN:
            duty = phases.align(current, acted)
        elif drive.state == State.RAMP:
            duty = phases.ramp(current, acted, wanted)
        elif drive.state in (State.SEARCH, State.POLARITY):
            duty = phases.search(current)
        elif drive.state == State.LOW:
            duty = phases.speed(seen, wanted)
        elif drive.state == State.RUN:
            drive.theta_e = scalar(drive.observer.theta_e)
            drive.omega_e = scalar(drive.observer.omega_e)
            duty = phases.speed(seen, _ZERO if wanted * drive.omega_e < _ZERO else wanted)
        resting = drive.state in RESTING or (drive.state == State.CATCH and not shorted)
        drive.time = min(drive.time + 1, _MOST)
        return duty, 0 if resting else 1
