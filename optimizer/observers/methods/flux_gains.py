"""What the firmware needs of the flux observer."""

from __future__ import annotations

from typing import Annotated

from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.pll import PllGains
from dqforge.optimizer.steps.step_arithmetic import Member


@dataclass(frozen=True, slots=True)
class FluxPath:
    """The voltage model over a period."""

    t_s: Annotated[float, Member("sampling period", "s")]
    drop: Annotated[float, Member("R t_s", "Ohm s")]
    half_drop: Annotated[float, Member("R t_s / 2", "Ohm s")]
    end: Annotated[float, Member("R t_s / (12 L_q)")]
    l_q: Annotated[float, Member("inductance of the q axis", "H")]


@dataclass(frozen=True, slots=True)
class FluxGains:
    """Voltage model, current model, correction ``alpha_0 + alpha_1 |x|``, and loop."""

    path: FluxPath
    l_d: Annotated[float, Member("inductance of the d axis", "H")]
    l_q: Annotated[float, Member("inductance of the q axis", "H")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    alpha_0: Annotated[float, Member("correction by the current model at rest")]
    alpha_1: Annotated[float, Member("... and per rad of omega t_s", "1/rad")]
    floor: Annotated[float, Member("least active flux that counts in full", "Wb")]
    pll: PllGains
