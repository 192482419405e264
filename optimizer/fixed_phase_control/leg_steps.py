"""Voltages that the legs of a topology can make, and their duty cycles, in integers.

Arithmetic and vectors are as in `phase_step`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, TopologyRule
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.transforms import duty
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedPhaseControl,
    Vector,
    duties_type,
)
from dqforge.optimizer.fixed_phase_control.reference_steps import (
    bounded,
)
from dqforge.optimizer.steps.code_vectors import (
    Filling,
)
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    larger,
    rounded,
    saturated,
)

COARSE = 3  # bits that a voltage beyond full scale is lowered by before it is shortened


def highest(o: Arithmetic[N, Any], x: tuple[N, N, N]) -> N:
    """Largest of three numbers."""
    return larger(o, o.let("high", larger(o, x[0], x[1])), x[2])


def _smaller(o: Arithmetic[N, Any], a: N, b: N) -> N:
    return o.choose(o.at_least(a, b), b, a)


def lowest(o: Arithmetic[N, Any], x: tuple[N, N, N]) -> N:
    """Least of three numbers."""
    return _smaller(o, o.let("low", _smaller(o, x[0], x[1])), x[2])


@dataclass(frozen=True, slots=True)
class LegSteps:
    """Voltages that the legs of a topology can make, and their duty cycles."""

    control: FixedPhaseControl

    @property
    def rule(self) -> TopologyRule:
        """How the phases are fed."""
        return TOPOLOGIES[self.control.topology]

    def phases(
        self, o: Arithmetic[N, Any], v: Vector[N]
    ) -> Annotated[tuple[N, N, N], Filling("phase")]:
        """Phases of a vector in codes of one word; sums of two have a bit more."""
        bits = self.control.width - 1
        half = o.let("half", o.product("phases: alpha / 2", v.alpha, o.const(1 << (bits - 1))))
        side = o.product("phases: beta", v.beta, o.const(round(2**bits * math.sqrt(0.75))))
        side, less = o.let("side", side), o.negative(half)
        b = o.call(rounded, "phases: b", o.total("phases: b", side, less), bits)
        c = o.call(rounded, "phases: c", o.total("phases: c", o.negative(side), less), bits)
        return (
            o.total("phases: a", v.alpha, v.zero),
            o.total("phases: b", b, v.zero),
            o.total("phases: c", c, v.zero),
        )

    def _ends(self, o: Arithmetic[N, Any], x: tuple[N, ...]) -> tuple[N, N]:
        """Largest and least of three numbers, and of 0 where a leg feeds the neutral."""
        high, low = (o.call(of, x) for of in (highest, lowest))  # type: ignore[arg-type]
        if not (self.rule.neutral and self.rule.between is not None):
            return o.let("high", high), o.let("low", low)
        high, low, none = o.let("above", high), o.let("below", low), o.const(0)
        return o.let("high", larger(o, high, none)), o.let("low", _smaller(o, low, none))

    def demand(self, o: Arithmetic[N, Any], phase: tuple[N, N, N]) -> N:
        """What phase voltages ask of the link, of half of it where it is split."""
        if self.rule.between is None:
            high = o.let("high", o.call(highest, phase))
            low = o.let("low", o.negative(o.call(lowest, phase)))
            return larger(o, high, low)
        high, low = self._ends(o, phase)
        spread = o.total("demand: spread", high, o.negative(low))
        return spread if self.rule.between == 1.0 else o.shifted(spread, 1)

    def link(self, o: Arithmetic[N, Any], v_dc: N, v_m: N | None) -> N:
        """What there is of it, in codes of the voltage, lowered as it is where it is shortened."""
        control, there = self.control, v_dc
        if v_m is not None:
            above = o.let("above", o.total("link: above the midpoint", v_dc, o.negative(v_m)))
            there = o.let("side", o.call(bounded, _smaller(o, v_m, above), 1, control.top))
        whole = o.product("link", there, o.const(1 << control.dc_scale))
        return o.let("most", o.call(bounded, o.shifted(whole, COARSE), 0, control.top))

    def fitting(self, o: Arithmetic[N, Any], v: Vector[N], most: N) -> N:
        """Share of a voltage that the legs can make, a code, and full scale where they can make all
        of it.
        """
        bits = self.control.width - 1
        phase = o.let("phase", o.call(self.phases, v))
        asked = o.let("asked", o.call(self.demand, phase))
        # A range does not know that the larger of two is positive; 8 full scales are never passed.
        asked = o.known(o.let("positive", larger(o, asked, o.const(1))), 1, 8 << bits)

        def part() -> N:
            whole = o.product("region: link", most, o.const(1 << bits))
            share = o.quotient("region: share", whole, asked)
            return o.call(bounded, share, 0, self.control.top)

        beyond = o.at_least(asked, most)
        return o.cases("share", (beyond, part), otherwise=lambda: o.const(1 << bits))

    def shortened(
        self, o: Arithmetic[N, Any], v: Vector[N], coarse: Vector[N], share: N
    ) -> Vector[N]:
        """A voltage shortened along its direction to a share of it, where that is a code."""
        width, top = self.control.width, self.control.top
        name, bits = "region: shortened", width - 1 - COARSE

        def cut() -> Vector[N]:
            part = o.known(share, 0, top)
            return Vector(*(o.call(rounded, name, o.product(name, x, part), bits) for x in coarse))

        short = o.at_least(o.const(top), share)
        made = o.cases("made", (short, cut), otherwise=lambda: v)
        return Vector(*(o.call(saturated, width, x) for x in made))

    def duties(self, o: Arithmetic[N, Any], v: Vector[N], v_dc: N, v_m: N | None = None) -> Any:
        """Duty cycles of the legs; v_dc must be positive."""
        width, one = self.control.width, 1 << (self.control.width - 1)
        rule, factor, middle = self.rule, o.const(one >> self.control.dc_scale), o.const(0)
        bridges = len(rule.legs) == 6
        phase = o.let("phase", o.call(self.phases, v))
        if bridges and not rule.neutral:
            both = o.total("duties: ends", o.call(highest, phase), o.call(lowest, phase))
            middle = o.let("middle", o.shifted(both, 1))

        def over(k: Any) -> N:
            x = o.at(phase, k)
            if bridges and not rule.neutral:
                x = o.total("duties: centred", x, o.negative(middle))
            whole = o.product("duties: v", o.call(saturated, width, x), factor)
            return o.call(saturated, width, o.quotient("duties: v / v_dc", whole, v_dc))

        share = o.each("share", 3, over)

        def limited(*terms: N) -> N:
            return o.call(duty, width, o.total("duties: sum", *terms))

        legs: tuple[N, ...]
        if bridges:
            half, halves = o.const(one >> 1), [o.shifted(x, 1) for x in share]
            halves = [o.let(f"half_{name}", x) for name, x in zip("abc", halves, strict=True)]
            legs = tuple(limited(half, x) for x in halves)
            legs = (*legs, *(limited(half, o.negative(x)) for x in halves))
        elif v_m is not None:
            ratio = o.quotient(
                "duties: v_m / v_dc", o.product("duties: v_m", v_m, o.const(one)), v_dc
            )
            common = o.let("zero", o.call(bounded, ratio, 0, one))
            legs = tuple(limited(x, common) for x in share)
        else:
            high, low = self._ends(o, share)
            common = o.total("duties: offset", o.const(one), o.negative(high), o.negative(low))
            common = o.let("zero", o.shifted(common, 1))
            legs = tuple(limited(x, common) for x in share)
            legs = (*legs, limited(common)) if rule.neutral else legs
        return duties_type(self.control.topology)(*legs)
