"""What dead time leaves of the linear range where the duty cycles make up for it.

In each gap of a carrier period, t_d long, the current chooses the rail: a phase that switches loses
the voltage t_d f_sw v_dc against its current. A controller that makes up for it commands u +
sign(i) t_d f_sw in the place of the duty cycle u, which must stay between the rails. A phase that
rests at a rail has no gaps and needs nothing.

Source: derived; the voltage lost is that of R. B. Sepe, J. H. Lang, "Inverter nonlinearities and
discrete-time vector current control", IEEE Transactions on Industry Applications 30(1), 1994
(quoted without the paper at hand).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName


def dead_time_factor(name: ModulationName, dead_time: ArrayLike, f_sw: ArrayLike) -> FloatArray:
    """Linear range with compensated dead time over that without, for any direction of the currents.

    ::

        continuous       1 - 2 t_d f_sw    two phases switch at the limit, in opposite directions
        discontinuous    1 - t_d f_sw      the third rests at its rail

    The line-to-line duty cycle of two phases that switch reaches 1 - 2 t_d f_sw where their
    currents flow against it, as they do in motoring; more in generating, which is not counted on.

    Args:
        name: The modulator.
        dead_time, f_sw: Dead time t_d in s and carrier frequencies in Hz, broadcast to the shape
            (...).

    Returns:
        0 where the dead time takes the whole period.
    """
    gaps = 1.0 if MODULATORS[name].rests else 2.0
    lost = gaps * np.asarray(dead_time, dtype=np.float64) * np.asarray(f_sw, dtype=np.float64)
    return np.asarray(np.maximum(1.0 - lost, 0.0))
