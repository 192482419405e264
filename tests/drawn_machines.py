"""Machines round a nominal one, drawn as a study of tolerances draws them."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine

# Standard deviations as shares of the nominal value.
SPREAD = {"r_s": 0.05, "l_d": 0.05, "l_q": 0.05, "psi_pm": 0.02}


def factors(count: int, sigma: float, random: np.random.Generator, cut: float = 3.0) -> FloatArray:
    """Factors round 1, normally distributed and cut at ``cut`` standard deviations, shape
    (count,).
    """
    low = ndtr(-cut)
    return np.asarray(1.0 + sigma * ndtri(low + (1.0 - 2.0 * low) * random.random(count)))


def drawn_machines(base: LinearMachine, count: int, seed: int, cut: float = 3.0) -> MachineBatch:
    """Machines whose resistance, inductances and magnet flux are drawn."""
    random = np.random.default_rng(seed)
    columns = {
        name: getattr(base, name) * factors(count, sigma, random, cut)
        for name, sigma in SPREAD.items()
    }
    return MachineBatch.varied(base, count, columns)
