"""What stays the same whatever machine it meets: the current reference and the gains of a header,
as they are emitted.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.current_reference.forms import Emitted
from dqforge.optimizer.current_reference.signed import signed_designs, signed_reference
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.loops.loop_gains import LoopGains


@dataclass(frozen=True, slots=True)
class FixedLoop:
    """Gains of a current loop as the header holds them, rounded to single precision.

    Args:
        kp: Proportional gain in V/A.
        ki_ts: Integral gain per sample in V/A.
        t_s: Sampling period in s.
    """

    kp: float
    ki_ts: float
    t_s: float

    @classmethod
    def emitted(cls, kp: float, ki_ts: float, t_s: float) -> FixedLoop:
        """A loop with gains in double, as the header spells them out."""
        return cls(float(np.float32(kp)), float(np.float32(ki_ts)), t_s)

    @property
    def ki(self) -> float:
        """Integral gain in V/(A s)."""
        return self.ki_ts / self.t_s


@dataclass(frozen=True, slots=True)
class FixedHeader:
    """A header that is flashed to every drive.

    Args:
        reference: The current reference in the arithmetic of the emitted C.
        i_d, i_q: The current loops, None where the header has none in rotor coordinates.
        v_dc: DC-link voltage in V that the loops were designed for.
        speed: Mechanical speed in rad/s at which the reference keeps the voltage limit, None where
            it knows none: it then is to have the least copper loss.
        digest: SHA-256 of the design that the header was made of, in hexadecimal.
    """

    reference: Emitted
    i_d: FixedLoop | None
    i_q: FixedLoop | None
    v_dc: float
    speed: float | None = None
    digest: str = ""

    @property
    def torque_max(self) -> float:
        """End of the domain in N m, the full scale of its torque."""
        return float(self.reference.torque_max)


def nominal_header(design: Design) -> FixedHeader:
    """The header that a design gives, rounded as it is emitted.

    Args:
        design: The design.

    Raises:
        InputError: It is a six-step drive, which has no currents in rotor coordinates.
        NoSolutionError: There is no fit, or no gains.
    """
    if design.control.six_step is not None:
        raise InputError(
            "header: a six-step drive has no reference over the torque; leave header out, or write "
            "another control.observer"
        )
    positive, negative = signed_designs(design)
    fit = solve_fit(positive).fit
    reference: Emitted = fit.reference
    if negative is not None:
        reference = signed_reference(fit, solve_fit(negative).fit)
    loops = None if design.control.current_loop.switches else solve_gains(design)
    return FixedHeader(
        reference=reference,
        i_d=None if loops is None else _fixed(loops.i_d),
        i_q=None if loops is None else _fixed(loops.i_q),
        v_dc=design.inverter.v_dc,
        speed=None if fit.speed is None else fit.speed.omega_m,
        digest=design.digest,
    )


def _fixed(gains: LoopGains) -> FixedLoop:
    return FixedLoop.emitted(gains.kp, gains.ki_ts, gains.t_s)
