"""The regulator of a design: its numbers, given or computed, and what its current loop counts as.

Defaults aim at the inverter's switching frequency f_sw with the smaller inductance L:

    band     v_dc / (8 L f_sw), at which a phase on the middle of the link would switch at f_sw at
             rest (`hysteresis_frequency`); an isolated star point mostly switches less
    outer    twice the band
    carrier  f_sw, with kp for half of the triangle's slope (`slope_ratio`) at the voltage limit and
             ki = kp R / L, which cancels the winding's pole
    sampling 10 f_sw; of a trajectory, whose edges need no more, 2 f_sw
    pulses   at most 15 per electrical period
"""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError
from dqforge.machines.names import FeedbackMethod
from dqforge.machines.plants.current_feedback import Hysteresis, RampComparison, Scheme
from dqforge.machines.plants.current_regulators.schemes import (
    FurtherScheme,
    Sampled,
    Trajectory,
)
from dqforge.machines.plants.fed_machine import BridgeDrive
from dqforge.machines.records import dataclass

METHODS: tuple[FeedbackMethod, ...] = (
    "hysteresis",
    "ramp-comparison",
    "look-up-table",
    "circle",
    "predictive",
    "trajectory",
)

VOLTAGE_SHARE = 0.95  # Share of v_dc/sqrt(3) that a regulator is given: the rest is for the error.
_PULSES = 15


@dataclass(frozen=True, slots=True)
class RegulatorPlan:
    """Numbers of a regulator in SI units; those that its method does not use are defaults.

    Args:
        method: Which one.
        band, outer_band: In A.
        kp, ki: In V/A and V/(A s).
        carrier: In Hz.
        comparator_band: In V.
        t_s: Sampling period in s.
        pulses: Most pulses of a leg per electrical period.
    """

    method: FeedbackMethod
    band: float
    outer_band: float
    kp: float
    ki: float
    carrier: float
    comparator_band: float
    t_s: float
    pulses: int

    def scheme(self, electrical: float) -> Scheme | FurtherScheme:
        """The scheme that is simulated, at an electrical frequency in Hz, which decides the pulses
        of a pattern.
        """
        if self.method == "hysteresis":
            return Hysteresis(self.band)
        if self.method == "ramp-comparison":
            return RampComparison(
                self.kp, self.ki, self.carrier, comparator_band=self.comparator_band
            )
        if self.method == "trajectory":
            return Trajectory(self.angles(electrical), self.t_s)
        return Sampled(self.method, self.t_s, self.band, self.outer_band)

    def angles(self, electrical: float) -> int:
        """Angles in a quarter of a pattern at an electrical frequency in Hz: as many pulses as the
        carrier frequency leaves, three at least.
        """
        pulses = min(self.pulses, int(self.carrier / electrical))
        return max(1, (pulses - 1) // 2)


def bridge_of(design: Design) -> BridgeDrive:
    """Machine and ideal bridge of a design."""
    return BridgeDrive(linearised(design.machine), design.inverter.v_dc)


def regulator_plan(design: Design, method: FeedbackMethod | None = None) -> RegulatorPlan:
    """Numbers of the design's regulator, or of another one with the same section.

    Args:
        design: The drive; keys that it leaves open are computed.
        method: Another method than the design's, for comparisons.

    Raises:
        InputError: The design's outer band, given or not, is less than its band.
    """
    loop, machine = design.control.current_loop, linearised(design.machine)
    v_dc, f_sw = design.inverter.v_dc, design.inverter.f_sw
    least = min(machine.l_d, machine.l_q)
    band = v_dc / (8.0 * least * f_sw) if loop.band is None else loop.band
    carrier = f_sw if loop.carrier is None else loop.carrier
    steepest = (2.0 / 3.0 + 1.0 / math.sqrt(3.0)) * v_dc / least
    kp = v_dc * carrier / steepest if loop.kp is None else loop.kp
    ki = kp * machine.r_s / least if loop.ki is None else loop.ki
    outer = 2.0 * band if loop.outer_band is None else loop.outer_band
    if outer < band:
        raise InputError(
            f"control.current_loop.outer_band: {outer:.4g} A is less than the band of {band:.4g} "
            "A; write both"
        )
    chosen = loop.method if method is None else method
    often = 2.0 if chosen == "trajectory" else 10.0
    if chosen not in METHODS:
        raise InputError(
            f"control.current_loop: the method '{chosen}' does not switch the bridge itself"
        )
    return RegulatorPlan(
        method=chosen,
        band=band,
        outer_band=outer,
        kp=kp,
        ki=ki,
        carrier=carrier,
        comparator_band=0.0 if loop.comparator_band is None else loop.comparator_band,
        t_s=1.0 / (often * f_sw if loop.sampling is None else loop.sampling),
        pulses=_PULSES if loop.pulses is None else loop.pulses,
    )
