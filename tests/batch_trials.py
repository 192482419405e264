"""Linear machines of every kind for trials of batches, drawn by a seed."""

from __future__ import annotations

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine


def linear_machines(count: int, seed: int = 0, *, all_kinds: bool = True) -> list[LinearMachine]:
    """Machines from a few watts to hundreds of kilowatts, over three decades of tau.

    With ``all_kinds`` every eighth has l_d > l_q, no saliency, or no magnet; else all have l_q >
    l_d and a magnet.
    """
    rng = np.random.default_rng(seed)
    found = []
    for row in range(count):
        psi_pm, ratio = rng.uniform(0.01, 0.3), rng.uniform(1.05, 8.0)
        l_d = 10.0 ** rng.uniform(-4.0, -1.5)
        l_q, pole_pairs, r_s = ratio * l_d, int(rng.integers(1, 7)), rng.uniform(0.01, 1.0)
        # The current limit in units of the MTPA curve's base sets how far that curve bends.
        i_max = 10.0 ** rng.uniform(-0.4, 1.0) * psi_pm / (2.0 * (l_q - l_d))
        kind = row % 8 if all_kinds else 0
        if kind == 5:
            l_d, l_q = l_q, l_d
        elif kind == 6:
            l_q = l_d
        elif kind == 7:
            psi_pm = 0.0
        found.append(LinearMachine(pole_pairs, r_s, l_d, l_q, psi_pm, i_max))
    return found
