"""Random speed loops with tolerances, for what is proven of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from random_loops import METHODS

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings, filter_share
from dqforge.optimizer.loops.pi_methods import current_pi
from dqforge.optimizer.speed_box import SpeedBox, SpeedLoopNumbers, speed_scale

RATIOS = (1, 2, 5, 10, 20)


@dataclass(frozen=True)
class SpeedDrive:
    """A drive in SI units, its gains, and the same as the proof sees it."""

    winding: tuple[float, float, float]  # R in Ohm, L in H, t_s in s
    mechanics: tuple[float, float, float]  # J in kg m^2, B in N m s/rad, filter time in s
    constant: float  # torque constant in N m/A
    current: tuple[float, float]
    speed: tuple[float, float]
    loop: SpeedLoopNumbers
    box: SpeedBox

    def radii(self, parameters: FloatArray) -> FloatArray:
        """Largest pole modulus at parameters (b, c, j, e), shape (N,)."""
        steps = self.loop.steps(parameters)
        return np.array(
            [np.max(np.abs(np.linalg.eigvals(self.loop.cycle(step)))) for step in steps]
        )


def corners_of(box: SpeedBox) -> FloatArray:
    """Corners of the box in the drive's own quantities, shape (32, 4)."""
    sides = (box.resistance, box.inductance, box.gain, box.torque, box.inertia, box.back_emf)
    return np.array(
        [[g / x, r / x, f * j, e / g] for r, x, g, f, j, e in itertools.product(*sides)]
    )


def _drawn(generator: np.random.Generator, ratio: int) -> SpeedDrive | None:
    r_s = 10.0 ** generator.uniform(-2.5, 0.7)
    inductance = r_s * 10.0 ** generator.uniform(-3.3, -1.5)
    t_s = 10.0 ** generator.uniform(-4.6, -3.6)
    settings = CurrentLoopSettings(
        method=METHODS[int(generator.integers(len(METHODS)))],
        bandwidth=generator.uniform(0.03, 0.5) / t_s,
        damping=generator.uniform(0.6, 1.5),
        spread=generator.uniform(1.8, 4.0),
    )
    kp, ki = current_pi(r_s, inductance, t_s, settings)
    filter_time = ratio * t_s * 10.0 ** generator.uniform(-0.5, 0.5) * int(generator.integers(2))
    inertia = 10.0 ** generator.uniform(-4.5, -1.0)
    friction = inertia * 10.0 ** generator.uniform(-2.0, 0.0)
    flux = int(generator.integers(1, 7)) * 10.0 ** generator.uniform(-2.5, -0.5)
    delay, spread = (3.0 + 0.5 * ratio) * t_s + filter_time, generator.uniform(1.8, 4.0)
    kp_s = inertia / (spread * delay) * generator.uniform(0.3, 1.0)
    ki_s = kp_s / (spread**2 * delay)
    h, eta = kp_s * t_s / inertia, t_s * 1.5 * flux / (inductance * kp_s)
    scale = speed_scale(h, eta * 0.1 * flux / 0.8)
    loop = SpeedLoopNumbers(
        rho=r_s * t_s / inductance,
        h=h / scale,
        p=kp * t_s / inductance,
        q=ki * t_s**2 / inductance,
        eta=eta * scale,
        integral=ki_s * ratio * t_s / kp_s,
        friction=friction * t_s / inertia,
        filter_share=filter_share(filter_time, t_s),
        ratio=ratio,
        uneven=0.0,
        scale=scale,
    )
    emf = (-0.1 * flux, 0.1 * flux)
    box = SpeedBox((0.7, 1.6), (0.7, 1.3), (0.8, 1.2), (0.0, 0.0), (1.0, 1.0), (0.7, 1.3), emf)
    drive = SpeedDrive(
        (r_s, inductance, t_s),
        (inertia, friction, filter_time),
        1.5 * flux,
        (kp, ki),
        (kp_s, ki_s),
        loop,
        box,
    )
    tried = np.vstack([corners_of(box), box.samples(400, generator)])
    return drive if min(kp, ki) > 0.0 and np.max(drive.radii(tried)) < 1.0 else None


def random_speed_drive(generator: np.random.Generator, ratio: int | None = None) -> SpeedDrive:
    """A drive that is stable at the corners and at 400 points of its box."""
    while True:
        drive = _drawn(generator, int(generator.choice(RATIOS)) if ratio is None else ratio)
        if drive is not None:
            return drive
