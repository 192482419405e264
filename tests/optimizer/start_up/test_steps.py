"""Steps of the start-up against their definitions: the ramp's angle as the integral of its speed,
the hand-over as a turn of the frame that leaves current and voltage where they are, the current of
a short circuit as that of the differential equation; and whole starts by all methods, with an
estimator that knows the rotor.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import NUMBERS, Control, ControlGains, Pi, PiGains
from dqforge.optimizer.start_up.start_parts import Neighbours
from dqforge.optimizer.start_up.start_records import (
    Followed,
    FollowedFromRest,
    Measured,
    Startup,
    StartupFault,
    StartupSample,
    StartupSettings,
    StartupState,
)
from dqforge.optimizer.start_up.step import StartupSteps
from dqforge.optimizer.steps.step_arithmetic import EXACT, Abc, AlphaBeta, Arithmetic, Dq

T_S, POLE_PAIRS = 1e-4, 4.0


def number(value: Any) -> Any:
    return np.float64(value)


ZERO = number(0.0)


class _Told(Neighbours):
    """A control that keeps what it was told, and estimators that know the rotor."""

    def __init__(self) -> None:
        self.samples: Measured | None = None
        self.reference: Dq | None = None
        self.voltage, self.speed, self.emf = complex(0.0), 0.0, 0.05
        self.rotor = self.started = 0.0, 0.0

    def control_start(self, o: Arithmetic, state: Control) -> None:  # noqa: ARG002
        state.v, state.held = AlphaBeta(ZERO, ZERO), Dq(ZERO, ZERO)
        state.d.integral, state.q.integral = ZERO, ZERO

    def current_control(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: ControlGains,  # noqa: ARG002
        state: Control,  # noqa: ARG002
        measured: Measured,
        reference: Dq,
    ) -> Abc:
        self.samples, self.reference = replace(measured), reference
        return Abc(ZERO, ZERO, ZERO)

    def speed_control(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: ControlGains,  # noqa: ARG002
        state: Control,
        measured: Measured,
        reference: Reals,
    ) -> Abc:
        self.samples, self.speed = replace(measured), float(reference)
        state.v = vector(1j * self.emf * self.rotor[1] * cmath.exp(1j * self.rotor[0]))
        return Abc(number(0.1), number(0.2), number(0.3))

    def duties(self, o: Arithmetic, voltage: AlphaBeta, v_dc: Reals, i: AlphaBeta) -> Abc:  # noqa: ARG002
        self.voltage = complex(*voltage)
        return Abc(number(0.4), number(0.5), number(0.6))

    def currents(self, torque: Reals) -> Iterable[Any]:
        return -torque / 0.9, torque / 0.3

    def observer_start(
        self,
        o: Arithmetic,  # noqa: ARG002
        observer: Followed,
        theta_e: Reals,
        omega_e: Reals,
    ) -> None:
        observer.theta_e, observer.omega_e = theta_e, omega_e
        self.started = float(theta_e), float(omega_e)

    def observer_step(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: Any,  # noqa: ARG002
        observer: Followed,
        v: AlphaBeta,  # noqa: ARG002
        i: AlphaBeta,  # noqa: ARG002
        *heard: Reals,  # noqa: ARG002
    ) -> None:
        observer.theta_e, observer.omega_e = map(number, self.rotor)

    def standstill_start(
        self,
        o: Arithmetic,  # noqa: ARG002
        low: FollowedFromRest,
        theta_e: Reals,
        omega_e: Reals,
    ) -> None:
        low.theta_e, low.omega_e = theta_e, omega_e

    def standstill_step(
        self,
        o: Arithmetic,  # noqa: ARG002
        gains: Any,  # noqa: ARG002
        low: FollowedFromRest,
        v: AlphaBeta,  # noqa: ARG002
        i: AlphaBeta,
    ) -> None:
        low.theta_e, low.omega_e = map(number, self.rotor)
        low.current = AlphaBeta(0.5 * i.alpha, 0.5 * i.beta)  # half of it is ripple
        low.added = AlphaBeta(number(0.3), number(-0.7))


def vector(value: complex) -> AlphaBeta:
    return AlphaBeta(number(value.real), number(value.imag))


def made(**changes: Any) -> StartupSettings:
    usual: dict[str, Any] = {member.name: ZERO for member in fields(StartupSettings)}
    usual |= {
        "t_s": number(T_S), "r_s_Ohm": number(0.4), "l_d_H": number(1e-3),
        "l_q_H": number(2e-3), "psi_pm_Wb": number(0.05), "ramp_A": number(5.0),
        "ramp_A_step": number(0.1), "ramp_step": number(0.5),
        "ramp_jerk": number(0.01), "ramp_end": number(200.0), "fade_samples": 10,
        "torque_per_A": number(0.3), "reluctance": number(-0.006), "method": 0,
    }  # fmt: skip
    return StartupSettings(**(usual | changes))


def gains() -> ControlGains:
    pi, numbers = PiGains(ZERO, ZERO, ZERO), dict.fromkeys(NUMBERS, ZERO)
    numbers |= {
        "pole_pairs": number(POLE_PAIRS), "l_d": number(1e-3), "l_q": number(2e-3),
        "psi_pm": number(0.05), "advance": number(1.5 * T_S),
    }  # fmt: skip
    return ControlGains(pi, pi, pi, ratio=ZERO, **numbers)


def drive(low: complex | None = None) -> Startup:
    pair = Dq(ZERO, ZERO)
    control = Control(
        Pi(ZERO), Pi(ZERO), Pi(ZERO), pair, AlphaBeta(*pair), ZERO, ZERO, ZERO, held=pair
    )
    rest = None if low is None else FollowedFromRest(vector(0j), vector(low), ZERO, ZERO)
    found = Startup.blank(control, Followed(ZERO, ZERO), rest, ZERO)
    found.along = Dq(number(1.0), ZERO)
    return found


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("alignment", [1, 2, 3])
def test_alignment_rises_in_half_of_its_time_and_brakes_the_rotor(
    alignment: int, direction: float
) -> None:
    told, own = _Told(), drive()
    own.direction = number(direction)
    settings = made(
        alignment=alignment, align_rise=number(0.05), align_A=number(3.0), align_V=number(20.0),
        align_damping=number(0.1), align_share=number(0.25),
    )  # fmt: skip
    usual = replace(gains(), voltage_share=number(0.5))
    omega, turning, before = direction * 20.0, 0.0, 0.0
    for time in range(40):
        own.time, passed = time, 0.05 * time
        share = min(1.0, passed)
        behind = -direction * 0.5 * math.pi * min(1.0, 2.0 - passed)
        turn = cmath.exp(1j * behind) if alignment == 2 else complex(1.0)
        # what a rotor at this speed makes of a current across
        across = 0.3 * math.sin(0.2 * time)
        volts = 0.4 * across + 1e-3 * (across - before) / T_S + 0.05 * omega
        before = across
        i, v = vector(complex(1.1, across) * turn), vector(complex(0.7, volts) * turn)
        measured = Measured(EXACT.clarke_inverse(i), ZERO, number(9.0), number(30.0))
        StartupSteps(told).align(EXACT, usual, settings, own, measured, v)
        assert cmath.exp(1j * float(own.theta_e)) == pytest.approx(turn, abs=1e-6)
        assert (measured.theta_e, measured.omega_m) == pytest.approx((own.theta_e, 0.0))
        if alignment == 3:
            assert told.voltage == pytest.approx(min(20.0 * share, 15.0))
            continue
        turning += 0.25 * (omega - turning)
        assert told.reference is not None
        most = 1.5 * share
        q = min(max(-0.1 * turning, -most), most)
        assert told.reference == pytest.approx((3.0 * share, q), abs=1e-6)


@pytest.mark.parametrize("omega", [150.0, -150.0, 0.0])
@pytest.mark.parametrize(("sine", "seen"), [(0.6, 0.6), (0.95, 0.85), (-0.3, 0.0)])
def test_an_estimator_starts_behind_the_current_by_what_the_active_voltage_tells(
    omega: float, sine: float, seen: float
) -> None:
    own = drive()
    own.theta_e, own.omega_e, own.current = number(0.4), number(omega), number(4.0)
    own.along = Dq(number(math.cos(0.8)), number(math.sin(0.8)))
    own.power = number(0.4 * 4.0 + abs(omega) * 0.05 * sine)
    with np.errstate(invalid="ignore", divide="ignore"):  # no EMF at rest
        StartupSteps(_Told(), hears=True).follow_ramp(EXACT, made(), own)
    lag = math.copysign(math.asin(seen), omega) if omega else 0.0
    assert own.observer.theta_e == pytest.approx(0.4 + T_S * omega + 0.8 - lag, abs=3e-5)
    assert own.observer.omega_e == omega


@pytest.mark.parametrize(("north", "south"), [(0.5, 0.3), (0.3, 0.5), (0.4, 0.41)])
@pytest.mark.parametrize("aligned", [0, 1])
def test_the_end_with_the_larger_ripple_is_north(north: float, south: float, aligned: int) -> None:
    told, own = _Told(), drive(complex(1.0, -0.5))
    told.rotor = 0.9, 0.0
    low = own.low
    assert low is not None
    settings = made(
        alignment=aligned, polarity_samples=10, polarity_A=number(2.0),
        polarity_share=number(0.1), retries=1,
    )  # fmt: skip
    steps, measured = StartupSteps(told), Measured(Abc(ZERO, ZERO, ZERO), ZERO, ZERO, ZERO)
    low.theta_e, low.omega_e = number(0.9), number(12.0)
    own.state, own.omega_e, own.tries = StartupState.SEARCH, number(7.0), 1
    steps.search(EXACT, gains(), settings, own, measured, low.current)
    assert told.reference == pytest.approx((0.0, 0.0))
    if aligned == 0:
        steps.found(EXACT, settings, own)
        assert (own.state, own.time) == (StartupState.POLARITY, 0)
    own.state = StartupState.POLARITY
    for time in range(20):
        own.time = time
        size = north if time < 10 else south
        ripple = complex((-1) ** time * size, 0.2) * cmath.exp(0.9j)
        current = vector(complex(*low.current) + ripple)
        steps.search(EXACT, gains(), settings, own, measured, current)
        assert told.reference == pytest.approx((2.0, 0.0) if time < 10 else (-2.0, 0.0))
        assert told.samples is not None
        assert EXACT.clarke(told.samples.i) == pytest.approx(low.current)
        assert (told.samples.theta_e, told.samples.omega_m) == pytest.approx((0.9, 3.0))
    assert own.ripple == pytest.approx((5.0 * north, 5.0 * south))
    own.control.d.integral = own.control.q.integral = number(3.0)
    steps.found(EXACT, settings, own)
    if not aligned and abs(north - south) < 0.1 * (north + south):
        assert (own.state, own.fault) == (StartupState.WAIT, StartupFault.NO_POLARITY)
        return
    turned = not aligned and south > north
    assert cmath.exp(1j * float(low.theta_e)) == pytest.approx(
        (-1.0 if turned else 1.0) * cmath.exp(0.9j), abs=1e-6
    )
    assert (own.state, own.fault) == (StartupState.LOW, StartupFault.NO_FAULT)
    assert own.observer == Followed(low.theta_e, ZERO)
    integrals = own.control.d.integral, own.control.q.integral
    assert (own.omega_e, *integrals) == pytest.approx((0.0, 0.0, 0.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "gap", "before"),
    [
        (10.0, 0.2, 0.3), (60.0, -0.4, 0.0), (60.0, 0.4, 0.15), (90.0, 0.9, 0.5),
        (90.0, -0.9, 1.0), (130.0, 0.3, 0.9), (40.0, 0.3, 0.1),
    ],
)  # fmt: skip
def test_the_observer_counts_by_the_speed_as_far_as_it_agrees(
    speed: float, gap: float, before: float, sign: float
) -> None:
    own = drive(complex(1.0, -0.5))
    low = own.low
    assert low is not None
    settings = made(
        mix_from=number(50.0), hand_over=number(100.0), mix_step=number(0.2),
        held_A=number(1.5), stall_below=number(20.0),
    )  # fmt: skip
    own.omega_e, own.share = number(sign * speed), number(before)
    low.theta_e, low.omega_e = number(0.5), number(sign * speed + 3.0)
    own.observer = Followed(number(0.5 + gap), number(sign * speed - 2.0))
    own.control.held = Dq(number(0.7), number(-0.2))
    measured = Measured(Abc(ZERO, ZERO, ZERO), ZERO, ZERO, ZERO)
    StartupSteps(_Told()).mix(EXACT, settings, own, measured)
    target = float(np.clip((speed - 50.0) / 50.0, 0.0, 1.0))
    target = target if abs(gap) < 0.7 or before == 1.0 else 0.0
    share = before + float(np.clip(target - before, -0.2, 0.2))
    assert own.share == pytest.approx(share)
    assert own.theta_e == pytest.approx(0.5 + share * gap)
    assert own.omega_e == pytest.approx(sign * speed + 3.0 - 5.0 * share)
    assert own.control.held == pytest.approx((0.8, -0.2))
    assert EXACT.clarke(measured.i) == pytest.approx(low.current)
    again = own.observer == Followed(low.theta_e, low.omega_e)
    assert again == (abs(float(own.omega_e)) < 20.0)


@pytest.mark.parametrize("omega", [140.0, -140.0, 60.0, -60.0])
@pytest.mark.parametrize("method", [0, 3])
def test_a_rotor_that_turns_is_driven_on_without_a_jump(omega: float, method: int) -> None:
    own = drive(complex(1.0, -0.5))
    own.theta_e, own.omega_e = number(0.7), number(omega)
    settings, control = made(hand_over=number(100.0), method=method), gains()
    control = replace(control, psi_pm=number(0.04))
    StartupSteps(_Told()).caught(EXACT, control, settings, own)
    emf = 0.05j * omega * cmath.exp(1j * (0.7 + 0.5 * T_S * omega))
    assert complex(*own.acted) == pytest.approx(emf)
    assert own.control.q.integral == pytest.approx(0.01 * omega)
    assert own.control.omega_m == pytest.approx(omega / POLE_PAIRS)
    assert (own.reference, own.emf) == pytest.approx((omega, 0.05 * omega))
    assert own.observer == Followed(number(0.7), number(omega))
    slow = StartupState.LOW if method == 3 else StartupState.RAMP
    assert own.state == (slow if abs(omega) < 100.0 else StartupState.RUN)
    if own.state == StartupState.LOW:
        assert own.low is not None
        assert (own.low.theta_e, own.low.omega_e) == pytest.approx((0.7, omega))
        assert own.share == 0.0


class _Start:
    """A drive whose rotor does what the start-up asks of it, and its whole way by states."""

    def __init__(self, low: complex | None = None, **changes: Any) -> None:
        usual: dict[str, Any] = {
            "align_samples": 6, "align_rise": number(2.0 / 6.0), "align_A": number(3.0),
            "align_V": number(4.0), "align_share": number(0.2), "align_damping": number(0.01),
            "agree_samples": 3, "agree_share": number(0.2), "patience_samples": 9,
            "stall_samples": 5, "stall_below": number(15.0), "settled_samples": 4,
            "ratio_samples": 4, "wait_samples": 3, "search_samples": 4, "polarity_samples": 4,
            "catch_samples": 8, "pause_samples": 3, "catch_A": number(1.0),
            "catch_slow": number(200.0), "catch_least": number(10.0), "retries": 1,
            "hand_over": number(100.0), "mix_from": number(50.0), "back_below": number(70.0),
            "ramp_end": number(130.0), "ramp_step": number(10.0), "ramp_jerk": number(3.0),
            "ramp_A_step": number(1.0), "mean_share": number(0.1), "damping": number(0.3),
            "boost_V": number(1.5), "held_A": number(1.0), "run_step": number(9.0),
            "ratio_above": number(90.0), "ratio_low": number(0.7), "ratio_high": number(1.4),
            "ratio_share": number(0.5), "trip_A": number(20.0), "v_dc_min_V": number(100.0),
            "mix_step": number(0.25), "polarity_share": number(0.1), "polarity_A": number(2.0),
            "fade_samples": 4,
        }  # fmt: skip
        self.settings, self.told = made(**(usual | changes)), _Told()
        self.gains = replace(gains(), voltage_share=number(0.5))
        self.low, self.own = low, drive(low)
        self.steps, self.states = StartupSteps(self.told), [StartupState.IDLE]
        self.current, self.follows, self.v_dc = complex(0.2, -0.1), True, 300.0
        self.steps.init(EXACT, self.own)

    def turn(self, count: int, speed: float, run: int = 1) -> Sequence[StartupState]:
        """Steps with a mechanical speed; gives the states that they come to."""
        begin = len(self.states)
        for _ in range(count):
            own, gate = self.own, 0
            if self.follows and own.state == StartupState.RAMP:
                self.told.rotor = float(own.theta_e), float(own.omega_e)
                self.current = float(own.current) * cmath.exp(1j * float(own.theta_e)) or 0.1
            elif self.follows and own.state in (StartupState.LOW, StartupState.RUN):
                omega = self.told.rotor[1] + 0.5 * (float(own.reference) - self.told.rotor[1])
                self.told.rotor = self.told.rotor[0] + T_S * omega, omega
                self.current = 0.1 * cmath.exp(1j * self.told.rotor[0])
            elif own.state in (StartupState.SEARCH, StartupState.POLARITY):
                first = own.time < self.settings.polarity_samples
                self.told.rotor = 0.9, 0.0
                self.current = (0.5 if first else 0.3) * cmath.exp(0.9j) * (1 + own.time % 2)
            sample = StartupSample(
                EXACT.clarke_inverse(vector(self.current)), number(self.v_dc), None
            )
            step: Any = self.steps.step if self.low is None else self.steps.step_from_standstill
            estimators: tuple[Any, ...] = (None,) if self.low is None else (None, None)
            asked = number(speed), run
            found = step(EXACT, self.gains, self.settings, *estimators, own, sample, *asked)
            gate = found.gate
            resting = own.state in (StartupState.IDLE, StartupState.WAIT, StartupState.FAULT)
            assert own.state == StartupState.CATCH or bool(gate) != resting
            if own.state != self.states[-1]:
                self.states.append(own.state)
        return self.states[begin:]


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("method", "alignment", "low", "way"),
    [
        (0, 1, None, "ALIGN RAMP RUN"),
        (1, 3, None, "ALIGN RAMP RUN"),
        (2, 2, None, "ALIGN LOW RUN"),
        (3, 0, 1.0 - 0.5j, "SEARCH POLARITY LOW RUN"),
        (3, 1, 1.0 - 0.5j, "ALIGN SEARCH LOW RUN"),
    ],
)
def test_each_method_comes_to_its_speed_and_back_to_rest(
    method: int, alignment: int, low: complex | None, way: str, sign: float
) -> None:
    start = _Start(low, method=method, alignment=alignment)
    came = start.turn(120, sign * 40.0)
    assert [state.name for state in came] == way.split()
    own = start.own
    assert (own.fault, own.tries, own.fading) == (StartupFault.NO_FAULT, 1, 0)
    assert own.reference == pytest.approx(sign * 160.0)
    assert start.told.speed == pytest.approx(sign * 40.0)
    assert own.control.held == pytest.approx((0.0, 0.0))
    if low is not None:
        assert own.share == 1.0
    # the command goes
    back = ["LOW", "IDLE"] if method == 3 else ["RAMP", "IDLE"]
    assert [state.name for state in start.turn(160, sign * 40.0, run=0)] == back
    assert (own.tries, own.reference, own.omega_e) == pytest.approx((0, 0.0, 0.0))


def test_what_fails_is_tried_again_and_then_given_up() -> None:
    start = _Start(alignment=1)
    start.told.emf = 0.02  # far from that of the rotor
    came = [state.name for state in start.turn(260, 40.0)]
    assert came == ["ALIGN", "RAMP", "RUN", "WAIT", "ALIGN", "RAMP", "RUN", "FAULT"]
    assert (start.own.fault, start.own.tries) == (StartupFault.LOST, 2)
    assert [state.name for state in start.turn(2, 40.0, run=0)] == ["IDLE"]
    assert start.own.fault == StartupFault.NO_FAULT
    # a rotor that does not follow, on the ramp and at speed
    start = _Start(alignment=0)
    start.follows = False
    assert [state.name for state in start.turn(50, -40.0)][:3] == ["RAMP", "WAIT", "RAMP"]
    assert start.own.fault == StartupFault.NO_HANDOVER
    start = _Start(alignment=1)
    start.turn(60, 40.0)
    start.told.rotor, start.follows = (0.3, 10.0), False
    assert [state.name for state in start.turn(8, 40.0)][:1] == ["WAIT"]
    assert start.own.fault == StartupFault.STALLED


@pytest.mark.parametrize(
    ("current", "v_dc", "fault"),
    [
        (complex(math.nan, 0.0), 300.0, StartupFault.SAMPLE),
        (complex(1.0, 0.0), math.inf, StartupFault.SAMPLE),
        (complex(15.0, -15.0), 300.0, StartupFault.OVERCURRENT),
        (complex(0.0, 1.0), 99.0, StartupFault.UNDERVOLTAGE),
        (complex(14.0, -14.0), 101.0, StartupFault.NO_FAULT),
    ],
)
def test_a_dangerous_sample_ends_it_at_once(
    current: complex, v_dc: float, fault: StartupFault
) -> None:
    start = _Start(alignment=1)
    start.turn(2, 40.0)
    start.current, start.v_dc = current, v_dc
    assert start.own.state == StartupState.ALIGN
    start.turn(1, 40.0)
    assert start.own.fault == fault
    assert start.own.state == (StartupState.FAULT if fault else StartupState.ALIGN)


@pytest.mark.parametrize("omega", [400.0, -900.0, 120.0, 0.0])
def test_a_rotor_that_turns_is_found_by_short_circuits(omega: float) -> None:
    start, theta, ended = _Start(flying=1, alignment=1), 0.6, -1
    system = np.array(
        [
            [-0.4 / 1e-3, omega * 2e-3 / 1e-3, 0.0],
            [-omega * 1e-3 / 2e-3, -0.4 / 2e-3, -omega * 0.05 / 2e-3],
            [0.0, 0.0, 0.0],
        ]
    )
    once, i = expm(system * T_S), np.array([0.0, 0.0, 1.0])
    gates, steps, own = [0, 0], start.steps, start.own
    for time in range(90):
        shorted = gates[-2] and own.state == StartupState.CATCH
        i = once @ i if shorted else np.array([0.0, 0.0, 1.0])
        current = complex(i[0], i[1]) * cmath.exp(1j * theta)
        sample = StartupSample(EXACT.clarke_inverse(vector(current)), number(300.0), None)
        asked = number(math.copysign(40.0, omega)), 1
        found = steps.step(EXACT, start.gains, start.settings, None, own, sample, *asked)
        gates.append(found.gate)
        if own.state not in (StartupState.IDLE, StartupState.CATCH):
            ended = time
            break
        theta += T_S * omega
    assert ended > 0
    if omega == 0.0:
        assert own.state == StartupState.ALIGN
        return
    assert own.state == StartupState.RUN
    angle, speed = start.told.started
    assert speed == pytest.approx(omega, rel=0.03)
    assert math.remainder(angle - theta, 2.0 * math.pi) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_the_angle_of_the_ramp_is_the_integral_of_a_speed_that_reaches_its_end(
    direction: float,
) -> None:
    told, own, settings = _Told(), drive(), made()
    steps, wanted = StartupSteps(told), number(direction * 300.0)
    speeds, angles = [], []
    for time in range(600):
        own.time = time
        measured = Measured(Abc(ZERO, ZERO, ZERO), ZERO, ZERO, number(300.0))
        acted = AlphaBeta(ZERO, ZERO)
        with np.errstate(invalid="ignore"):  # no current, no active voltage
            steps.ramp(EXACT, gains(), settings, own, measured, acted, wanted)
        assert told.samples is not None
        assert told.samples.omega_m == pytest.approx(own.omega_e / POLE_PAIRS)
        speeds.append(float(own.omega_e))
        angles.append(float(told.samples.theta_e))
    assert np.unwrap(angles) == pytest.approx(T_S * np.cumsum(speeds), abs=1e-9)
    assert speeds[-1] == pytest.approx(direction * 200.0)
    assert np.all(direction * np.diff(speeds) >= 0.0)
    # it rises by the jerk to the acceleration, never faster
    rises = direction * np.diff([0.0, *speeds])
    assert rises[:40] == pytest.approx(0.01 * np.arange(1, 41))
    assert np.max(rises) == pytest.approx(0.5)
    assert told.reference == pytest.approx((5.0, 0.0))


@pytest.mark.parametrize("omega", [150.0, -150.0])
def test_the_hand_over_keeps_current_and_voltage(omega: float) -> None:
    own, settings, control = drive(), made(), gains()
    theta, current, voltage = 0.7, complex(3.0, -2.0), complex(11.0, 4.0)
    own.observer = Followed(number(theta), number(omega))
    own.control.v = AlphaBeta(number(voltage.real), number(voltage.imag))
    seen = AlphaBeta(number(current.real), number(current.imag))
    StartupSteps(_Told()).turn_frame(EXACT, control, settings, own, seen)
    i = current * np.exp(-1j * theta)
    torque = (0.3 - 0.006 * i.real) * i.imag
    held = own.control.held
    assert held is not None
    # what the torque asks for and what is held are the current that flows
    assert (held.d - torque / 0.9, held.q + torque / 0.3) == pytest.approx((i.real, i.imag))
    assert own.control.torque == pytest.approx(torque)
    assert own.control.speed.integral == pytest.approx(torque)
    # integrals and decoupling are the voltage that acts, in the frame of its period's middle
    v = voltage * np.exp(-1j * (theta + 0.5 * T_S * omega))
    d = own.control.d.integral - omega * 2e-3 * i.imag
    q = own.control.q.integral + omega * (1e-3 * i.real + 0.05)
    assert (d, q) == pytest.approx((v.real, v.imag))
    assert (own.fade.d, own.fade.q) == pytest.approx((held.d / 10.0, held.q / 10.0))
    assert own.control.omega_m == pytest.approx(omega / POLE_PAIRS)


@pytest.mark.parametrize("omega", [400.0, -900.0])
def test_the_current_of_a_short_circuit_is_that_of_its_differential_equation(omega: float) -> None:
    settings, duration = made(), 4 * T_S
    found = StartupSteps(_Told()).shorted(EXACT, settings, number(omega), number(duration))
    # d/dt (i_d, i_q, 1) of a machine with no voltage at its terminals
    system = np.array(
        [
            [-0.4 / 1e-3, omega * 2e-3 / 1e-3, 0.0],
            [-omega * 1e-3 / 2e-3, -0.4 / 2e-3, -omega * 0.05 / 2e-3],
            [0.0, 0.0, 0.0],
        ]
    )
    d, q, _ = expm(system * duration) @ np.array([0.0, 0.0, 1.0])
    assert found == pytest.approx(math.atan2(q, d), abs=1e-3)


def test_the_angle_of_a_vector_is_its_arc_tangent() -> None:
    angles = np.linspace(-math.pi, math.pi, 721)[1:-1]
    steps = StartupSteps(_Told())
    found = [steps.angle(EXACT, AlphaBeta(np.cos(one), np.sin(one))) for one in angles]
    assert np.max(np.abs(np.array(found) - angles)) < 1.1e-5


def test_a_control_by_torque_takes_its_current_across_alone() -> None:
    """T = 3/2 p psi_pm i_q, without a current along the magnets."""
    usual = StartupSteps(_Told(), by_torque=True)._usual(EXACT, gains(), number(0.6))
    across = 0.6 / (1.5 * POLE_PAIRS * float(gains().psi_pm))
    assert usual == pytest.approx((0.0, across))
