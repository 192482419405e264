"""Random drives with their tolerances, for proofs over a box, and what sampling says of them.

Sampling uses the model in physical quantities (`coupled_loops`), which the proofs do not.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentLoopMethod
from dqforge.optimizer.certificates.cell_queue import BoxDrive, CurrentLoopBox
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, largest_pole
from dqforge.optimizer.loops.pi_methods import current_pi

# A vendor's rule more or less among the names must not draw other drives.
METHODS: tuple[CurrentLoopMethod, ...] = (
    "bandwidth",
    "damping",
    "magnitude-optimum",
    "symmetrical-optimum",
)


def random_box(generator: np.random.Generator, *, fast: bool) -> CurrentLoopBox | None:
    """A drive with tuned gains: R -30..+60 %, L +-30 %, v_dc +-20 %, turning up to 0.05 rad per
    sample, ``fast`` ones up to 0.09..0.3; None where the method gives no gains.
    """
    r_s = 10.0 ** generator.uniform(-2.5, 0.7)
    l_d = r_s * 10.0 ** generator.uniform(-3.3, -1.5)
    l_q = l_d * generator.uniform(0.6, 3.0)
    t_s = 10.0 ** generator.uniform(-4.6, -3.6)
    settings = CurrentLoopSettings(
        method=METHODS[int(generator.integers(len(METHODS)))],
        bandwidth=generator.uniform(0.03, 0.5) / t_s,
        damping=generator.uniform(0.6, 1.5),
        spread=generator.uniform(1.8, 4.0),
    )
    turn = generator.uniform(0.09, 0.3) if fast else 0.05
    try:
        (kp_d, ki_d), (kp_q, ki_q) = (current_pi(r_s, x, t_s, settings) for x in (l_d, l_q))
    except NoSolutionError:
        return None
    if min(kp_d, ki_d, kp_q, ki_q) <= 0.0:
        return None
    return CurrentLoopBox(
        t_s=t_s,
        kp=(kp_d, kp_q),
        ki_ts=(ki_d * t_s, ki_q * t_s),
        decoupling=(l_d, l_q),
        r_s=(0.7 * r_s, 1.6 * r_s),
        dead_time=(0.0, 0.0),
        l_d=(0.7 * l_d, 1.3 * l_d),
        l_q=(0.7 * l_q, 1.3 * l_q),
        gain=(0.8, 1.2),
        omega_e=turn / t_s,
    )


def random_boxes(count: int, seed: int, *, fast: bool) -> list[CurrentLoopBox]:
    """As many random drives, the same for the same seed."""
    generator = np.random.default_rng(seed)
    found: list[CurrentLoopBox] = []
    while len(found) < count:
        box = random_box(generator, fast=fast)
        if box is not None:
            found.append(box)
    return found


def times(box: CurrentLoopBox, factor: float) -> CurrentLoopBox:
    """The same with gains times a factor."""
    return replace(
        box,
        kp=(factor * box.kp[0], factor * box.kp[1]),
        ki_ts=(factor * box.ki_ts[0], factor * box.ki_ts[1]),
    )


def drives_inside(box: CurrentLoopBox, generator: np.random.Generator, count: int) -> FloatArray:
    """Random drives: R with dead time, L_d, L_q, gain, omega_e of either sense, shape (count, 5);
    a quarter of each parameter lies on one of its ends.
    """
    ends = np.array(
        [box.r_s, box.dead_time, box.l_d, box.l_q, box.gain, (-box.omega_e, box.omega_e)]
    )
    share = generator.uniform(size=(count, len(ends)))
    at_end = generator.uniform(size=share.shape) < 0.25
    share = np.where(at_end, np.round(share), share)
    r_s, dead_time, l_d, l_q, gain, omega_e = (ends[:, 0] + share * (ends[:, 1] - ends[:, 0])).T
    return np.column_stack([r_s + dead_time * gain, l_d, l_q, gain, omega_e])


def corner_drives(box: CurrentLoopBox, speeds: int) -> FloatArray:
    """All corners at evenly spaced speeds from rest on, shape (N, 5)."""
    omega_e = np.linspace(0.0, box.omega_e, speeds)
    rows = itertools.product(box.r_s, box.dead_time, box.l_d, box.l_q, box.gain, omega_e)
    return np.array(
        [(r_s + dead * gain, l_d, l_q, gain, omega) for r_s, dead, l_d, l_q, gain, omega in rows]
    )


def radii(box: CurrentLoopBox, drives: FloatArray) -> FloatArray:
    """Largest pole modulus of each drive by the model in physical quantities, shape (N,)."""
    machines = TurningMachines(*np.ascontiguousarray(drives.T))
    control = CurrentControl(box.kp, box.ki_ts, *box.decoupling, 1.5 * box.t_s, box.t_s)
    return largest_pole(machines, control)


def radius_of(box: CurrentLoopBox, drive: BoxDrive) -> float:
    """The same of one drive."""
    row = np.array([[drive.r_s, drive.l_d, drive.l_q, drive.gain, drive.omega_e]])
    return float(radii(box, row)[0])


def limit(box: CurrentLoopBox) -> float | None:
    """Factor on the gains from which on corners or random drives are unstable.

    None where the box is unstable as it is, or no factor up to 12 makes it so.
    """
    drives = np.vstack([corner_drives(box, 25), drives_inside(box, np.random.default_rng(3), 1500)])
    low, high = 1.0, 12.0
    if radii(box, drives).max() >= 1.0 or radii(times(box, high), drives).max() < 1.0:
        return None
    for step in range(18):
        if step == 4:  # the worst alone, from here on
            drives = drives[np.argsort(-radii(times(box, high), drives))[:150]]
        middle = np.sqrt(low * high)
        if radii(times(box, middle), drives).max() >= 1.0:
            high = middle
        else:
            low = middle
    return float(high)
