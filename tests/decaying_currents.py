"""Currents of a phase machine that die out under the sampled control, in the time domain.

Written from the words of the control law, in phase quantities with a rotating inductance that is
integrated in small steps; nothing here comes from the modules whose radii it is held against.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.phase_control.phase_controller import PhaseControl

Real = NDArray[np.float64]

FINE = 12  # parts of a sampling period in which a salient rotor stands still
AXES = np.array([0.0, 2.0, 4.0]) * np.pi / 3.0
ROOTS = np.sqrt([1.5, 1.5, 3.0])  # power-invariant over amplitude-invariant: alpha, beta, 0


def to_axes(phases: Real) -> Real:
    """Alpha, beta, 0 (amplitude-invariant) of phase quantities."""
    plane = 2.0 / 3.0 * np.sum(phases * np.exp(1j * AXES))
    return np.array([plane.real, plane.imag, np.mean(phases)])


def to_phases(axes: Real) -> Real:
    """Phase quantities of alpha, beta, 0."""
    return np.asarray(np.real((axes[0] + 1j * axes[1]) * np.exp(-1j * AXES)) + axes[2])


@dataclass
class SampledDrive:
    """Machine, inverter and control without limit, references zero, from random currents on.

    ``plant`` are (R, L_d, L_q, L_0, gain), ``capacitance`` that of a split link.
    """

    control: PhaseControl
    omega: float
    plant: tuple[float, float, float, float, float]
    capacitance: float = 1.0
    seed: int = 0
    theta: float = 0.0
    currents: Real = field(init=False)
    midpoint: float = 0.0
    acting: Real = field(default_factory=lambda: np.zeros(3))  # phase voltages, and v_m within
    integral: Any = field(default_factory=lambda: np.zeros(3))
    learned: dict[tuple[str, int], complex] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        rule = TOPOLOGIES[self.control.topology]
        self.neutral, self.split = rule.neutral, rule.midpoint
        self.currents = rng.standard_normal(3)
        if not self.neutral:
            self.currents -= np.mean(self.currents)

    def inductance(self, theta: float) -> Real:
        """Matrix of the phases in H at an angle."""
        _, l_d, l_q, l_0, _ = self.plant
        lag = np.subtract.outer(AXES, AXES)
        turned = 2.0 * theta - np.add.outer(AXES, AXES)
        return np.asarray(
            l_0 / 3.0 + (l_d + l_q) / 3.0 * np.cos(lag) + (l_d - l_q) / 3.0 * np.cos(turned)
        )

    def flow(self) -> None:
        """One sampling period of the machine under the acting voltage."""
        resistance, l_d, l_q, _, gain = self.plant
        pieces = 1 if l_d == l_q else FINE
        part = self.control.t_s / pieces
        linked: Any = np.asarray(self.inductance(self.theta) @ self.currents)
        for piece in range(pieces):
            # Flux linkages by the exact exponential of the winding held at the middle angle.
            inverse = np.linalg.inv(self.inductance(self.theta + self.omega * part * (piece + 0.5)))
            size = 4 if self.split else 3
            slope = np.zeros((size, size))
            slope[:3, :3] = -resistance * inverse
            if self.split:
                slope[:3, 3] = -1.0
                slope[3, :3] = np.sum(inverse, axis=0) / self.capacitance
            force = np.zeros(size)
            force[:3] = gain * self.acting
            if not self.neutral:
                force[:3] -= np.mean(force[:3])
            state = np.append(linked, self.midpoint)[:size]
            linked_state = _held(slope, force, state, part)
            linked = linked_state[:3]
            if self.split:
                self.midpoint = float(linked_state[3])
        self.theta += self.omega * self.control.t_s
        self.currents = np.linalg.solve(self.inductance(self.theta), linked)

    def shape(self, theta: float) -> tuple[Real, Real]:
        """Back-EMF of the phases over speed and its slope, from the nodes."""
        rows, turns = self.control.shape.flux, self.control.shape.turns
        count = rows.shape[1]
        grid = 2.0 * np.pi * turns * np.arange(count + 1) / count
        value, slope = np.zeros(3), np.zeros(3)
        for phase in range(3):
            row = rows[phase % len(rows)]
            angle = (theta - (AXES[phase] if len(rows) == 1 else 0.0)) % (2.0 * np.pi * turns)
            value[phase] = np.interp(angle, grid, np.append(row, row[0]))
            node = min(int(angle / grid[1]), count - 1)
            slope[phase] = (np.append(row, row[0])[node + 1] - row[node]) / grid[1]
        return value, slope

    def frame(self, theta: float) -> tuple[Real, Real]:
        """Unit vectors of dqx or dqy in rows, in alpha, beta, 0 power-invariant, and a of each."""
        flux = ROOTS * to_axes(self.shape(theta)[0])
        q = np.array([flux[0], flux[1], 0.0])
        if self.control.frame == "dqy":
            q[2] = flux[2]
        d = np.array([-flux[1], flux[0], 0.0])
        axes = np.stack([d / np.linalg.norm(d), q / np.linalg.norm(q), np.zeros(3)])
        axes[2] = np.cross(axes[0], axes[1]) if self.control.frame == "dqy" else [0.0, 0.0, 1.0]
        a = np.ones(3) / np.linalg.norm(q)
        if self.control.frame == "dqx":
            a[2] = 1.0
        return axes, a

    def compute(self) -> Real:
        """Phase voltages of the control for the currents of now."""
        control, t_s = self.control, self.control.t_s
        seen = to_axes(self.currents)
        error = -seen
        if self.split and control.midpoint is not None:
            error += self.balance(self.theta)
        if not self.neutral:
            error[2] = 0.0
        middle = self.theta + 1.5 * self.omega * t_s
        kp, ki = (np.array([getattr(g, name) for g in control.gains]) for name in ("kp", "ki"))
        voltage = self.gained(kp, error) + self.integrated(ki, error, middle)
        if control.feedforward == "measured":
            voltage += self.coupled(seen, middle)
        voltage += self.harmonics(error)
        if self.split and control.midpoint is not None and control.feedforward == "references":
            first, second = (
                self.balance(self.theta + n * self.omega * control.t_s) for n in (1, 2)
            )
            sizes = np.array(control.inductances)
            voltage += control.r_s * (first + second) / 2.0
            voltage += sizes * (second - first) / control.t_s
        if not self.neutral:
            voltage[2] = 0.0
        phases = to_phases(voltage)
        return phases + self.midpoint if self.split else phases

    def balance(self, theta: float) -> Real:
        """References that bring the midpoint back without torque: sum of f i is zero."""
        assert self.control.midpoint is not None
        flux = self.shape(theta)[0]
        wanted = np.full(3, -self.control.midpoint.balance * self.midpoint)
        return to_axes(wanted - flux * (np.sum(flux * wanted) / np.sum(flux**2)))

    def gained(self, gains: Real, error: Real) -> Real:
        """Errors times gains, those of d and q in the rotor's axes."""
        turn = np.exp(1j * self.theta)
        rotor = (error[0] + 1j * error[1]) / turn
        plane = (gains[0] * rotor.real + 1j * gains[1] * rotor.imag) * turn
        return np.array([plane.real, plane.imag, gains[2] * error[2]])

    def integrated(self, gains: Real, error: Real, middle: float) -> Real:
        """Voltage of the integrators after one step, gains in V/(A s) on the axes of the frame."""
        t_s = self.control.t_s
        if self.control.frame in ("dq", "table"):
            rotor = (error[0] + 1j * error[1]) * np.exp(-1j * self.theta)
            seen = np.array([rotor.real, rotor.imag, error[2]])
            self.integral = self.integral + t_s * gains * seen
            plane = (self.integral[0] + 1j * self.integral[1]) * np.exp(1j * middle)
            return np.array([plane.real, plane.imag, self.integral[2]])
        axes, factor = self.frame(self.theta)
        self.integral = self.integral + t_s * gains * (axes @ (ROOTS * error)) / factor
        axes, factor = self.frame(middle)
        return np.asarray(axes.T @ (self.integral * factor) / ROOTS)

    def coupled(self, seen: Real, middle: float) -> Real:
        """Coupling of the currents by the turning frame, by a difference of its axes."""
        l_d, l_q, l_0 = self.control.inductances
        if self.control.frame in ("dq", "table"):
            rotor = (seen[0] + 1j * seen[1]) * np.exp(-1j * self.theta)
            plane = self.omega * (-l_q * rotor.imag + 1j * l_d * rotor.real) * np.exp(1j * middle)
            return np.array([plane.real, plane.imag, 0.0])
        assert l_d == l_q
        small = 1e-7
        axes, a = self.frame(self.theta)
        held = axes @ (ROOTS * seen) / a  # what stands still in the frame
        (there, a_there), (later, a_later) = self.frame(middle), self.frame(middle + small)
        change = (later.T @ (held * a_later) - there.T @ (held * a_there)) / small
        return np.asarray(self.omega * np.array([l_d, l_d, l_0]) * change / ROOTS)

    def harmonics(self, error: Real) -> Real:
        """Voltage of the harmonic integrators."""
        control, found = self.control, np.zeros(3)
        if control.harmonics is None:
            return found
        l_d, l_q, l_0 = control.inductances
        d, q, zero = control.gains
        plane = error[0] + 1j * error[1]
        sets = [
            ("plane", m, plane, (d.kp + q.kp) / 2, (l_d + l_q) / 2) for m in control.harmonics.plane
        ]
        if self.neutral:
            sets += [("zero", m, error[2], zero.kp, l_0) for m in control.harmonics.zero]
        for name, m, of, kp, inductance in sets:
            end = control.harmonics.frequency_max
            share = abs(m * self.omega) / (2.0 * np.pi) / end
            weight = 1.0 if share < 0.8 else max(0.0, (1.0 - share) / 0.2)
            turn = np.exp(1j * m * self.theta)
            r = self.learned.get((name, m), 0.0)
            learns = control.harmonics.rate * control.t_s * weight
            self.learned[name, m] = complex(r + learns * of / turn)
            lead = np.exp(1.5j * m * self.omega * control.t_s)
            inverse = kp + (control.r_s + 1j * m * self.omega * inductance) * lead
            voltage = weight * r * inverse * turn
            if name == "plane":
                found[:2] += voltage.real, voltage.imag
            else:
                found[2] += voltage.real
        return found

    def step(self) -> None:
        """One sample: what was computed before acts while this one is computed."""
        computed = self.compute()
        self.flow()
        self.acting = computed

    def scale(self, factor: float) -> None:
        """Multiplies everything that the drive remembers; the loop is linear."""
        self.currents, self.midpoint = self.currents * factor, self.midpoint * factor
        self.acting, self.integral = self.acting * factor, self.integral * factor
        self.learned = {key: value * factor for key, value in self.learned.items()}

    def size(self) -> float:
        """Of what is left."""
        parts = [*self.currents, self.midpoint, *self.acting, *self.integral]
        return float(np.linalg.norm([*parts, *np.abs(list(self.learned.values()))]))


def _held(slope: Real, force: Real, state: Real, duration: float) -> Real:
    """State after a constant force, by the series of the exponential."""
    found, term = state, state
    for order in range(1, 12):
        term = (slope @ term + (force if order == 1 else 0.0)) * duration / order
        found = found + term
    return np.asarray(found)


def decay_per_sample(drive: SampledDrive, settle: int, samples: int) -> float:
    """What is left of the state per sample, over ``samples`` after ``settle`` samples."""
    logs = 0.0
    for sample in range(settle + samples):
        drive.step()
        if sample == settle - 1:
            drive.scale(1.0 / drive.size())
            logs = 0.0
        elif sample % 50 == 49 or sample == settle + samples - 1:
            size = drive.size()
            logs += np.log(size)
            drive.scale(1.0 / size)
    return float(np.exp(logs / samples))
