"""Duty cycles of three legs."""

from __future__ import annotations

from dqforge.machines.modulation.registry import MODULATORS, load_turn, zero_sequence_of
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair, Reals, Triple
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Rotation

_INSIDE = 0.999999  # Of the highest duty cycle: with its rounding all lie within 0 to 1.
_HALF_ROOT_3 = 0.8660254


def centred_duties(o: Arithmetic, voltage: AlphaBeta, v_dc: Reals) -> Abc:
    """Duty cycles 0 to 1 of the upper switches, centred in the link, for a voltage in V that is 0
    where v_dc is not above 0; one half each without voltage.
    """
    scale = o.let("scale", 1.0 / v_dc)
    alpha = o.let("alpha", scale * voltage.alpha)
    middle = o.let("middle", -0.5 * alpha, "b and c lie at one distance on either side")
    side = o.let("side", _HALF_ROOT_3 * (scale * voltage.beta))
    upper = o.let("upper", middle + o.magnitude(side))
    lower = o.let("lower", middle - o.magnitude(side))
    high, low = o.cases(
        ("high", "low"),
        (alpha > upper, lambda: (alpha, lower)),
        (alpha < lower, lambda: (upper, alpha)),
        otherwise=lambda: (upper, lower),
    )
    zero = o.let("zero", 0.5 - 0.5 * (high + low))
    made = o.let("made", Abc(alpha + zero, (middle + side) + zero, (middle - side) + zero))

    def beyond() -> Abc:
        return Abc(*(_powered(o, clamped(o, one), v_dc) for one in made))

    return o.cases("duty", (high + zero <= _INSIDE, lambda: made), otherwise=beyond)


def clamped(o: Arithmetic, duty: Reals) -> Reals:
    """Within 0 to 1; 0 for not-a-number."""
    one, none = o.full(1.0, duty), o.full(0.0, duty)
    return o.choose(duty > 1.0, one, o.choose(duty > 0.0, duty, none))


def _powered(o: Arithmetic, duty: Reals, v_dc: Reals) -> Reals:
    return o.choose(v_dc > 0.0, duty, o.full(0.5, v_dc))


@dataclass(frozen=True, slots=True)
class Duties:
    """Duty cycles by a modulator."""

    modulation: ModulationName

    def duties(self, o: Arithmetic, voltage: AlphaBeta, v_dc: Reals, i: AlphaBeta) -> Abc:
        """Duty cycles 0 to 1 of the upper switches for a voltage in V and currents in A; one half
        each without DC-link voltage.
        """
        if MODULATORS[self.modulation].kind == "centred":
            half = o.full(0.5, v_dc)
            return o.cases(
                "duty",
                (v_dc > 0.0, lambda: o.call(centred_duties, voltage, v_dc)),
                otherwise=lambda: Abc(half, half, half),
            )
        v = o.let("v", o.clarke_inverse(voltage))
        zero = o.let("zero", self._zero(o, v, voltage, v_dc, i))
        scale = o.let("scale", o.choose(v_dc > 0.0, 1.0 / v_dc, o.full(0.0, v_dc)))
        names = ("duty_a", "duty_b", "duty_c")
        made = [
            o.let(name, _powered(o, (phase + zero) * scale, v_dc))
            for name, phase in zip(names, v, strict=True)
        ]
        return Abc(*(clamped(o, one) for one in made))

    def _zero(self, o: Arithmetic, v: Abc, voltage: AlphaBeta, v_dc: Reals, i: AlphaBeta) -> Reals:
        """Zero sequence from the negative rail in V."""
        rule, vector = MODULATORS[self.modulation], Pair(*voltage)
        currents, turn = Triple(*v), None
        if rule.compared == "currents":
            currents = Triple(*o.let("currents", o.clarke_inverse(i)))
        elif rule.compared == "load angle":
            o.remark("The load angle, within 30 degrees; generating counts as motoring, reversed.")
            turn = Pair(*load_turn(o, Rotation, voltage, i))
        elif rule.delay is not None:
            turn = Pair(*(o.full(value, voltage.alpha) for value in rule.delay))
        return zero_sequence_of(o, self.modulation, Triple(*v), currents, v_dc, vector, turn)
