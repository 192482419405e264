"""Voltage region and duty cycles of every topology of a phase machine."""

from __future__ import annotations

from collections import namedtuple
from functools import cache
from typing import Any, NamedTuple

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import Reals
from dqforge.optimizer.phase_control.phase_records import Alphabetazero
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic


class Span(NamedTuple):
    """The highest and the lowest of some voltages."""

    high: Reals
    low: Reals


@cache
def duties_of(topology: Topology) -> type[Any]:
    """The vector of the duty cycles of a topology."""
    legs = TOPOLOGIES[topology].legs
    if len(legs) == 3:
        return Abc
    kind = namedtuple("Duties", legs)  # type: ignore[misc]
    more = (
        "; n of the leg of the neutral"
        if "n" in legs
        else "; a2, b2, c2 at the second ends of the phases"
    )
    kind.__doc__ = f"Duty cycles 0 to 1 of the upper switches{more}."
    return kind


def duty(o: Arithmetic, x: Reals) -> Reals:
    """A duty cycle within 0 to 1; one half for not-a-number."""
    within = o.choose(x >= 0.0, x, o.choose(x < 0.0, o.full(0.0, x), o.full(0.5, x)))
    return o.choose(x > 1.0, o.full(1.0, x), within)


def phases(o: Arithmetic, x: Alphabetazero) -> Abc:
    """Phase voltages of stationary coordinates with a zero sequence."""
    plane = o.let("plane", AlphaBeta(x.alpha, x.beta))
    y = o.let("y", o.clarke_inverse(plane))
    return Abc(y.a + x.zero, y.b + x.zero, y.c + x.zero)


def _highest(o: Arithmetic, v: Abc) -> Reals:
    first = o.let("higher", o.choose(v.b > v.a, v.b, v.a))
    return o.choose(v.c > first, v.c, first)


def _lowest(o: Arithmetic, v: Abc) -> Reals:
    first = o.let("lower", o.choose(v.b < v.a, v.b, v.a))
    return o.choose(v.c < first, v.c, first)


def extremes(o: Arithmetic, v: Abc) -> Span:
    """The highest and the lowest of the phases."""
    return Span(_highest(o, v), _lowest(o, v))


def _share(o: Arithmetic, most: Reals, needed: Reals) -> Reals:
    """Share of a voltage for a link that gives so much of what it needs, in V."""
    within = o.choose(needed > most, most / needed, o.full(1.0, most))
    return o.choose(most >= 0.0, within, o.full(-1.0, most))


@dataclass(frozen=True, slots=True)
class ThreeLegs:
    """Three legs by a modulator, and nothing at the neutral."""

    modulation: ModulationName

    def needed_voltage(self, o: Arithmetic, voltage: AlphaBeta) -> Reals:
        """DC-link voltage in V that phase voltages need."""
        rule = MODULATORS[self.modulation]
        v = o.let("v", o.clarke_inverse(voltage))
        high, low = o.let("high", _highest(o, v)), o.let("low", _lowest(o, v))
        if rule.kind not in ("sine", "third-harmonic"):
            return high - low
        if rule.kind == "third-harmonic":
            alpha, beta = voltage
            square = o.let("square", (alpha * alpha) + (beta * beta))
            zero = o.cases(
                "zero",
                (square > 0.0, lambda: (4.0 * rule.share) * (((v.a * v.b) * v.c) / square)),
                otherwise=lambda: o.full(0.0, square),
            )
            high, low = o.let("above", high - zero), o.let("below", zero - low)
        else:
            low = o.let("below", -low)
        return 2.0 * o.choose(high > low, high, low)

    def voltage_share(self, o: Arithmetic, v: Alphabetazero, part: Reals, v_dc: Reals) -> Reals:
        """Share of a voltage in V that the DC link can make, up to 1; negative where its samples
        make no sense.
        """
        most = o.let("most", part * v_dc)
        plane = o.let("plane", AlphaBeta(v.alpha, v.beta))
        return _share(o, most, o.let("needed", o.call(self.needed_voltage, plane)))


@dataclass(frozen=True, slots=True)
class SplitLegs:
    """Three legs, and the neutral at the midpoint of the link."""

    def duties(self, o: Arithmetic, voltage: Alphabetazero, v_dc: Reals, v_m: Reals) -> Abc:
        """Duty cycles for a voltage in V against the midpoint at v_m; one half each without DC-link
        voltage.
        """
        v = o.let("v", o.call(phases, voltage))
        scale = o.let("scale", o.choose(v_dc > 0.0, 1.0 / v_dc, o.full(0.0, v_dc)))
        a, b, c = (o.call(duty, (one + v_m) * scale) for one in v)
        half = o.full(0.5, v_dc)
        return Abc(*(o.choose(v_dc > 0.0, one, half) for one in (a, b, c)))

    def voltage_share(
        self, o: Arithmetic, v: Alphabetazero, part: Reals, v_dc: Reals, v_m: Reals
    ) -> Reals:
        """Share of a voltage in V that the DC link can make, up to 1; negative where its samples
        make no sense.
        """
        above, below = o.let("above", part * (v_dc - v_m)), o.let("below", part * v_m)
        phase = o.let("phase", o.call(phases, v))
        high, low = o.let("span", o.call(extremes, phase))
        one = o.full(1.0, above)
        upper = o.let("upper", o.choose(high > above, above / high, one))

        def within() -> Reals:
            return o.choose(-low * upper > below, below / -low, upper)

        known = (above >= 0.0) & (below >= 0.0)
        return o.cases("share", (known, within), otherwise=lambda: o.full(-1.0, above))


@dataclass(frozen=True, slots=True)
class NeutralLegs:
    """Four legs, or two for each phase."""

    topology: Topology

    def extremes(self, o: Arithmetic, v: Abc) -> Span:
        """The highest and the lowest of the phases and nothing."""
        high, low = o.let("most", _highest(o, v)), o.let("least", _lowest(o, v))
        none = o.full(0.0, high)
        return Span(o.choose(high > 0.0, high, none), o.choose(low < 0.0, low, none))

    def _span(self, o: Arithmetic, v: Abc) -> Span:
        return o.let("span", o.call(self.extremes if self.topology == "four-leg" else extremes, v))

    def needed_voltage(self, o: Arithmetic, voltage: Alphabetazero) -> Reals:
        """DC-link voltage in V that phase voltages need."""
        high, low = self._span(o, o.let("phase", o.call(phases, voltage)))
        if self.topology == "six-leg":
            return o.choose(high > -low, high, -low)
        return 0.5 * (high - low) if self.topology == "six-leg-isolated" else high - low

    def duties(self, o: Arithmetic, voltage: Alphabetazero, v_dc: Reals) -> Any:
        """Duty cycles for a voltage in V; one half each without DC-link voltage."""
        v = o.let("v", o.call(phases, voltage))
        scale = o.let("scale", o.choose(v_dc > 0.0, 1.0 / v_dc, o.full(0.0, v_dc)))
        kind = duties_of(self.topology)
        if self.topology == "six-leg":
            half = o.let("half", 0.5 * scale)
            sides = [o.let(f"side_{n}", x * half) for n, x in zip("abc", v, strict=True)]
        else:
            high, low = self._span(o, v)
            offset = o.let("offset", -0.5 * (high + low))
            if self.topology == "four-leg":
                legs = (o.call(duty, 0.5 + ((x + offset) * scale)) for x in v)
                return kind(*legs, o.call(duty, 0.5 + (offset * scale)))
            half = o.let("half", 0.5 * scale)
            sides = [o.let(f"side_{n}", (x + offset) * half) for n, x in zip("abc", v, strict=True)]
        first = (o.call(duty, 0.5 + side) for side in sides)
        return kind(*first, *(o.call(duty, 0.5 - side) for side in sides))

    def voltage_share(self, o: Arithmetic, v: Alphabetazero, part: Reals, v_dc: Reals) -> Reals:
        """Share of a voltage in V that the DC link can make, up to 1; negative where its samples
        make no sense.
        """
        most = o.let("most", part * v_dc)
        return _share(o, most, o.let("needed", o.call(self.needed_voltage, v)))


Legs = ThreeLegs | SplitLegs | NeutralLegs


def legs_of(topology: Topology, modulation: ModulationName) -> Legs:
    """The legs of a topology; the modulator is for those of three legs alone."""
    if topology in ("three-wire", "diode-neutral"):
        return ThreeLegs(modulation)
    return SplitLegs() if topology == "split-capacitor" else NeutralLegs(topology)
