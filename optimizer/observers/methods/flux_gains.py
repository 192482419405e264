"""What the firmware needs of the flux observer."""

from __future__ import annotations

from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.pll import PllGains


@dataclass(frozen=True, slots=True)
class FluxPath:
    """The voltage model over a period: ``drop`` = R t_s in Ohm s and its half,
    ``end`` = R t_s/(12 L_q), L_q in H.
    """

    t_s: float
    drop: float
    half_drop: float
    end: float
    l_q: float


@dataclass(frozen=True, slots=True)
class FluxGains:
    """Voltage model; H and Wb; correction ``alpha_0 + alpha_1 |x|``; ``floor`` in Wb:
    least flux linkage in full.
    """

    path: FluxPath
    l_d: float
    l_q: float
    psi_pm: float
    alpha_0: float
    alpha_1: float
    floor: float
    pll: PllGains
