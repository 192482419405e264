"""The loops of a profile step by step in numpy's float32, from the profile alone."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.transforms import Triple, clarke, park, park_inverse
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.firmware.configuration import DriveValues, LoopProfile, PiController
from dqforge.reports.c_code.harness import rotation, small_rotation, turned, wrap
from dqforge.reports.control.header import three_leg_duties

F = np.float32
ZERO, HALF = F(0.0), F(0.5)


def cut(value: np.float32, limit: np.float32) -> np.float32:
    return max(-limit, min(limit, value))


def rest(whole: np.float32, part: np.float32) -> np.float32:
    return F(np.sqrt(max(ZERO, whole * whole - part * part)))


class Pi:
    """A controller by its rule and its anti-windup."""

    def __init__(self, pi: PiController, t_s: float) -> None:
        self.own = pi
        self.kp, self.ki, self.track = F(pi.kp), F(pi.ki * t_s), F(pi.tracking * t_s)
        self.share = F(t_s / (t_s + pi.filter_time))
        self.limit = None if pi.limit is None else F(pi.limit)
        self.integral, self.before, self.error = ZERO, ZERO, ZERO
        self.measured, self.begun = ZERO, False

    def output(self, reference: np.float32, measured: np.float32) -> np.float32:
        if not self.begun or self.share >= 1.0:
            self.measured, self.begun = measured, True
        else:
            self.measured = self.measured + self.share * (measured - self.measured)
        error, self.before = reference - self.measured, self.integral
        if self.own.rule == "integral-first":
            self.add(self.ki * error)
        elif self.own.rule == "trapezoid":
            self.add(self.ki * (HALF * (error + self.error)))
        else:
            self.add(ZERO)
        out = self.kp * error + self.integral
        if self.own.rule == "integral-last":
            self.add(self.ki * error)
        self.error = error
        return out

    def add(self, step: np.float32) -> None:
        self.integral = self.integral + step
        if self.own.anti_windup == "clamp" and self.limit is not None:
            self.integral = cut(self.integral, self.limit)

    def kept(self, output: np.float32) -> np.float32:
        return output if self.limit is None else cut(output, self.limit)

    def wound(self, wanted: np.float32, made: np.float32, limit: np.float32) -> None:
        if self.own.anti_windup == "clamp":
            self.integral = cut(self.integral, limit)
        elif self.own.anti_windup == "hold" and made != wanted:
            self.integral = self.before
        elif self.own.anti_windup == "back-calculation":
            self.integral = self.integral + self.track * (made - wanted)


class Estimate:
    """The speed in rad/s (mechanical) as it is made of the angle."""

    def __init__(self, profile: LoopProfile, pole_pairs: int, t_s: float) -> None:
        self.own = None if profile.speed is None else profile.speed.feedback
        self.pairs, self.count, self.place, self.newest = F(pole_pairs), 0, 0, 0
        self.every = 1
        if self.own is not None:
            self.every = max(1, round((self.own.t_s or t_s) / t_s))
            self.t, self.kp = F(self.every * t_s), F(self.own.kp)
            self.ki = F(self.own.ki * self.every * t_s)
            period = self.every * t_s
            self.share = F(period / (period + self.own.filter_time))

    def step(self, theta: np.float32, omega_m: np.float32) -> np.float32:
        if self.own is None or (self.own.kind == "ideal" and self.own.averaged == 1):
            return omega_m
        first, due = self.count == 0, self.count % self.every == 0
        self.count += 1
        if first:
            self.omega, self.value = self.pairs * omega_m, omega_m
            self.theta, self.smooth, self.since = theta, self.omega, ZERO
            self.past = [self.omega * self.t] * self.own.samples
            self.speeds = [self.omega] * self.own.averaged
            if self.own.kind == "pll":
                self.theta = folded(self.theta + self.omega * self.t)
        elif self.own.kind != "pll":
            self.since = self.since + folded(theta - self.theta)
            self.theta = theta
        if due and not first:
            speed = self.pairs * omega_m if self.own.kind == "ideal" else self.of_angle(theta)
            if self.own.kind in ("pll", "low-pass") and self.share < 1.0:
                speed = self.smooth + self.share * (speed - self.smooth)
            self.smooth = speed
            self.value = self.mean(speed) / self.pairs
        return self.value

    def of_angle(self, theta: np.float32) -> np.float32:
        assert self.own is not None
        if self.own.kind == "pll":
            error = folded(theta - self.theta)
            self.omega = self.omega + self.ki * error
            both = self.omega + self.kp * error
            self.theta = folded(self.theta + both * self.t)
            return both if self.own.whole else self.omega
        count = self.own.samples if self.own.kind == "difference" else 1
        self.place = (self.place + 1) % count
        self.past[self.place], self.since = self.since, ZERO
        return total(self.past[:count]) / (F(count) * self.t)

    def mean(self, speed: np.float32) -> np.float32:
        count = len(self.speeds)
        if count == 1:
            return speed
        self.newest = (self.newest + 1) % count
        self.speeds[self.newest] = speed
        return total(self.speeds) / F(count)


def total(values: list[np.float32]) -> np.float32:
    """Their sum, one after the other."""
    found = ZERO
    for value in values:
        found = found + value
    return found


def folded(theta: np.float32) -> np.float32:
    return F(wrap(np.array([theta], dtype=np.float32))[0])


class Loops:
    """All of them; `step` takes what one sample gives and returns voltages and references."""

    def __init__(self, profile: LoopProfile, values: DriveValues) -> None:
        current, t_s = profile.current, profile.current.d.t_s
        self.profile, self.own = profile, current
        self.pairs = values.pole_pairs or 0
        self.d, self.q = Pi(current.d, t_s), Pi(current.q, t_s)
        self.estimate = Estimate(profile, self.pairs, t_s)
        self.psi, self.i_max = F(values.psi_pm or 0.0), F(values.i_max or 0.0)
        self.constant = F(1.5 * self.pairs * (values.psi_pm or 0.0))
        self.cross = (F(values.l_d or 0.0), F(values.l_q or 0.0)) if current.cross else (ZERO, ZERO)
        self.emf = self.psi if current.back_emf else ZERO
        self.saliency = F((values.l_q or 0.0) - (values.l_d or 0.0))
        self.share = F(current.voltage_share / math.sqrt(3.0))
        self.advance = F(current.angle_advance * t_s)
        self.command, self.sample = ZERO, 0
        if profile.speed is not None:
            self.ratio = max(1, round(profile.speed.pi.t_s / t_s))
            self.speed = Pi(profile.speed.pi, self.ratio * t_s)
            self.asked: np.float32 | None = None
            ramp = profile.speed.ramp
            self.ramp = None if ramp is None else F(ramp * self.ratio * t_s)

    def speed_step(self, reference: np.float32, omega_m: np.float32) -> np.float32:
        if self.sample % self.ratio == 0:
            if self.asked is None:
                self.asked = omega_m
            if self.ramp is None:
                self.asked = reference
            else:
                self.asked = self.asked + cut(reference - self.asked, self.ramp)
            out = self.speed.output(self.asked, omega_m)
            self.command = cut(self.speed.kept(out), self.i_max)
            self.speed.wound(out, self.command, self.i_max)
        self.sample += 1
        return self.command

    def currents(self, command: np.float32) -> tuple[np.float32, np.float32]:
        size, sign = abs(command), F(-1.0 if command < 0.0 else 1.0)
        if self.profile.reference == "table":
            points = np.array(self.profile.table, dtype=np.float32)
            k = 1
            while k + 1 < len(points) and size > points[k, 0]:
                k += 1
            low, high = points[k - 1], points[k]
            share = max(ZERO, min(F(1.0), (size - low[0]) / (high[0] - low[0])))
            return low[1] + share * (high[1] - low[1]), sign * (low[2] + share * (high[2] - low[2]))
        if self.profile.reference == "mtpa-linear" and self.saliency != 0.0:
            four = F(4.0) * self.saliency
            drawn = self.psi * self.psi + HALF * ((four * size) * (four * size))
            i_d = (self.psi - F(np.sqrt(drawn))) / four
            return i_d, sign * rest(size, i_d)
        return ZERO, command

    def voltages(
        self, reference: tuple[np.float32, np.float32], i: tuple[np.float32, np.float32],
        v_dc: np.float32, omega_m: np.float32,
    ) -> tuple[np.float32, np.float32]:  # fmt: skip
        omega_e, v_max = F(self.pairs) * omega_m, self.share * v_dc
        out_d, out_q = self.d.output(reference[0], i[0]), self.q.output(reference[1], i[1])
        feed_d = -(omega_e * (self.cross[1] * self.q.measured))
        feed_q = omega_e * (self.cross[0] * self.d.measured + self.emf)
        v_d, v_q = self.d.kept(out_d) + feed_d, self.q.kept(out_q) + feed_q
        most_d = most_q = v_max
        order = self.own.order
        if order == "vector":
            square = v_d * v_d + v_q * v_q
            if square > v_max * v_max:
                share = v_max / F(np.sqrt(square))
                v_d, v_q = share * v_d, share * v_q
        elif order == "q-first":
            v_q = cut(v_q, v_max)
            most_d = rest(v_max, v_q)
            v_d = cut(v_d, most_d)
        else:
            v_d = cut(v_d, v_max)
            most_q = rest(v_max, v_d) if order == "d-first" else v_max
            v_q = cut(v_q, most_q)
        self.d.wound(out_d + feed_d, v_d, most_d)
        self.q.wound(out_q + feed_q, v_q, most_q)
        return v_d, v_q


def recursion(
    profile: LoopProfile,
    values: DriveValues,
    mode: str,
    references: tuple[FloatArray, FloatArray],
    measured: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
) -> tuple[SingleArray, SingleArray]:
    """Duty cycles (N, 3) and current references (N, 2) for the samples of a run.

    ``references`` are that of the mode and that of the d current; ``measured`` phase currents
    (N, 3), angle, mechanical speed, and voltage of the dc link.
    """
    loops = Loops(profile, values)
    phases, theta, omega, v_dc = (np.asarray(x, dtype=np.float32) for x in measured)
    first, second = (np.asarray(x, dtype=np.float32) for x in references)
    i = clarke(SINGLE, Triple(*phases.T))
    now = rotation(theta)
    i_d, i_q = park(SINGLE, i, now)
    count = theta.size
    v, wanted, speeds = np.zeros((count, 2), F), np.zeros((count, 2), F), np.zeros(count, F)
    for k in range(count):
        speeds[k] = loops.estimate.step(theta[k], omega[k])
        if mode == "speed":
            pair = loops.currents(loops.speed_step(first[k], speeds[k]))
        elif mode == "torque":
            pair = loops.currents(cut(first[k] / loops.constant, loops.i_max))
        else:
            pair = (second[k], first[k])
        wanted[k] = pair
        v[k] = loops.voltages(pair, (i_d[k], i_q[k]), v_dc[k], speeds[k])
    ahead = small_rotation(F(loops.pairs) * speeds * loops.advance)
    voltage = park_inverse(SINGLE, type(i)(v[:, 0], v[:, 1]), turned(now, ahead))
    return np.stack(three_leg_duties("svpwm", voltage, v_dc, i), axis=1), wanted
