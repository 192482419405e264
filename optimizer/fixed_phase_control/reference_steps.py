"""References of a phase machine's control in integers, the flux that they follow, and its start.

Arithmetic and vectors are as in `phase_step`.
"""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.fixed_control.codes import (
    Codes,
    code_clarke,
    code_clarke_inverse,
    code_park_inverse,
    rotation,
)
from dqforge.optimizer.fixed_phase_control.integers import (
    Axis,
    Control,
    ControlGains,
    FixedPhaseControl,
    Measured,
    Shape,
    Vector,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import (
    FEW,
    Abc,
    AlphaBeta,
    Coded,
    Dq,
    Turned,
)
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    magnitude,
    rounded,
    saturated,
    scaled,
)


def zero(o: Arithmetic[N, Any], width: int, x: Abc[N]) -> Coded[N]:
    """Mean of the phases."""
    share = o.const(round(2 ** (width - 1) / 3))
    mean = o.product("zero: / 3", o.total("zero: a + b + c", *x), share)
    return Codes(o, width).settled("zero", mean)


def bounded(o: Arithmetic[N, Any], x: N, low: Any, high: Any) -> N:
    """The number nearest to x from low to high."""
    return o.clamp(x, low, high)


def code_product(o: Arithmetic[N, Any], width: int, name: str, x: N, y: N) -> N:
    """A product of two codes as a code."""
    return o.call(rounded, name, o.product(name, x, y), width - 1)


def ahead(o: Arithmetic[N, Any], width: int, name: str, theta: Turned[N], codes: N) -> Turned[N]:
    """An angle so many codes later."""
    return o.wrapped(o.let("later", o.total(name, theta, codes)), width)


def multiple(o: Arithmetic[N, Any], width: int, theta: Turned[N], order: N) -> Turned[N]:
    """So many times an angle."""
    return o.wrapped(o.let("turned", o.product("harmonic: angle", theta, order)), width)


def axes_of(gains: ControlGains) -> tuple[Axis, Axis, Axis | None]:
    """Controllers of the axes, None of a zero sequence that nothing drives."""
    return gains.d, gains.q, gains.zero


def added(o: Arithmetic[N, Any], v: Vector[N], more: Vector[N]) -> Vector[N]:
    """A voltage with a further one."""
    return Vector(*(o.total("voltage", x, y) for x, y in zip(v, more, strict=True)))


# State at rest.


def currents_start(o: Arithmetic[N, Any], state: Control[N]) -> None:
    """The currents' part of it at rest."""
    none = o.const(0)
    state.integral = (none, none, none)
    for held in state.harmonic:
        held.x = held.y = none
    state.v = state.reference = Vector(none, none, none)
    state.open_phase = none


def control_start(o: Arithmetic[N, Any], state: Control[N]) -> None:
    """Everything at rest. Call it before the first sample and after every pulse lock."""
    o.call(currents_start, state)
    state.speed.integral = state.filtered = state.omega_m = o.const(0)
    state.torque = state.count = o.const(0)


def open_phase(o: Arithmetic[N, Any], state: Control[N], phase: Annotated[N, FEW]) -> None:
    """A phase that carries no current any more (1 to 3), or none (0); what the integrators hold is
    stale then.
    """
    o.call(currents_start, state)
    state.open_phase = phase


@dataclass(frozen=True, slots=True)
class ReferenceSteps:
    """The back-EMF over the angle, and the references that follow from it."""

    control: FixedPhaseControl

    def flux(self, o: Arithmetic[N, Any], shape: Shape, theta: Turned[N]) -> Abc[N]:
        """Flux of the phases, between the nodes by straight lines."""
        width, nodes = self.control.width, self.control.nodes
        place = o.let("place", o.product("shape: place", theta, o.const(nodes)))
        index = o.let("index", o.shifted(place, width))
        share = o.let("share", o.shifted(o.wrapped(place, width), 1))
        found = []
        for phase, name in enumerate("abc"):
            row, at = shape.flux[phase if len(shape.flux) == 3 else 0], index
            if len(shape.flux) == 1 and phase:
                later = o.total("shape: index", index, o.const(nodes - nodes * phase // 3))
                later = o.let(f"later_{name}", later)
                past = o.total("shape: index", later, o.const(-nodes))
                at = o.let(f"at_{name}", o.choose(o.at_least(later, o.const(nodes)), past, later))
                at = o.known(at, 0, nodes - 1)
            here = o.let(f"here_{name}", o.entry(row, at))
            gap = o.total("shape: slope", o.entry(row[1:], at), o.negative(here))
            rise = o.call(code_product, width, "shape: rise", gap, share)
            value = o.call(saturated, width, o.total("shape: value", here, rise))
            found.append(o.let(f"flux_{name}", value))
        return Abc(*found)

    def electrical(self, o: Arithmetic[N, Any], theta: Turned[N]) -> Turned[N]:
        """Electrical angle of an angle of the shape."""
        turns = self.control.turns
        if turns == 1:
            return theta
        return o.wrapped(o.product("angle: turns", theta, o.const(turns)), self.control.width)

    def flux_vector(self, o: Arithmetic[N, Any], flux: Abc[N]) -> Vector[N]:
        """Flux on alpha, beta and zero; none on zero where nothing drives it."""
        pair = o.let("pair", o.call(code_clarke, self.control.width, flux))
        if not self.control.has_zero:
            return Vector(pair.x, pair.y, o.const(0))
        return Vector(pair.x, pair.y, o.call(zero, self.control.width, flux))

    def reference_flux(
        self,
        o: Arithmetic[N, Any],
        shape: Shape,
        theta: Turned[N],
        share: N,
        open_phase: Annotated[N, FEW],
    ) -> Vector[N]:
        """Flux that the references follow: faded to its fundamental, without an open phase."""
        control, width = self.control, self.control.width
        codes, whole = Codes(o, width), o.let("whole", o.call(self.flux, shape, theta))

        def faded() -> Abc[N]:
            electrical = o.call(self.electrical, theta)
            turn = o.let("turn", o.call(rotation, width, electrical))
            size = o.const(control.fundamental)
            back = codes.settled("fundamental", o.product("fundamental", size, turn.y))
            along = codes.settled("fundamental", o.product("fundamental", size, turn.x))
            pair = o.let("pair", AlphaBeta(o.negative(back), along))
            sines = o.let("sine", o.call(code_clarke_inverse, width, pair))
            found = []
            for flux, sine in zip(whole, sines, strict=True):
                gap = codes.saturated(o.total("fade: harmonics", flux, o.negative(sine)))
                part = o.call(code_product, width, "fade: part", gap, share)
                found.append(codes.saturated(o.total("fade: flux", sine, part)))
            return Abc(*found)

        fades = o.above(o.const(control.top), share)
        flux = o.cases("flux", (fades, faded), otherwise=lambda: whole)
        if control.has_zero:
            left = []
            for n, (name, x) in enumerate(zip("abc", flux, strict=True), start=1):
                closed = o.choose(o.equal(open_phase, o.const(n)), o.const(0), x)
                left.append(o.let(f"left_{name}", closed))
            flux = o.let("left", Abc(*left))
        if control.frame == "dqx":
            pair = o.let("plane", o.call(code_clarke, width, flux))
            return Vector(pair.x, pair.y, o.const(0))
        return o.call(self.flux_vector, flux)

    def torque_currents(
        self, o: Arithmetic[N, Any], unit: FixedGain, torque: Coded[N], flux: Vector[N]
    ) -> Vector[N]:
        """Currents T f / (p |f|^2) for the code of a torque."""
        control, bits = self.control, self.control.width - 1
        codes, least = Codes(o, control.width), control.least_square
        wanted = o.let("wanted", codes.saturated(o.call(scaled, "torque", unit, torque)))
        none = o.shifted(o.product("square: axis", flux.zero, flux.zero), bits)
        none = o.let("zero", none)
        plane = [o.shifted(o.product("square: axis", x, x), bits) for x in (flux.alpha, flux.beta)]
        total = o.total("square", *plane, none, none)
        square = o.let("square", o.call(bounded, total, least, 4 << bits))
        wide = o.product("torque 2^bits", wanted, o.const(1 << bits))
        per_flux = codes.saturated(o.quotient("torque / square", wide, square))
        per_flux, left = o.let("per_flux", per_flux), bits - control.unit_bits
        found = (
            o.call(rounded, "reference", o.product("reference", per_flux, x), left) for x in flux
        )
        return Vector(*map(codes.saturated, found))

    def _shaped(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        theta: N,
        torque: N,
        speed: N,
    ) -> Vector[N]:
        """Currents over the shape, whose harmonics fade with the speed."""
        control, top = self.control, self.control.top
        fade = o.let("fade", control.fade)
        lack = o.total("fade: lack", o.const(control.fade_end), o.negative(speed))
        lack = o.let("lack", o.call(bounded, lack, 0, top))
        share = o.call(bounded, o.call(scaled, "fade", fade, lack), 0, top)
        share = o.let("share", share)
        flux = o.call(self.reference_flux, gains.shape, theta, share, state.open_phase)
        flux = o.let("flux", flux)
        return o.let("shaped", o.call(self.torque_currents, gains.unit, torque, flux))

    def reference(
        self,
        o: Arithmetic[N, Any],
        gains: ControlGains,
        state: Control[N],
        measured: Measured[N],
        theta: Turned[N],
        torque: Coded[N],
        constant: Dq[N],
    ) -> Vector[N]:
        """Reference at an angle: of the torque over the shape, and of constant dq currents."""
        control, width = self.control, self.control.width
        codes, shared = Codes(o, width), control.frame != "dq"
        turn = o.let("turn", o.call(rotation, width, o.call(self.electrical, theta)))
        pair = o.let("pair", o.call(code_park_inverse, width, constant, turn))
        current = Vector(pair.x, pair.y, o.const(0))
        if not shared and measured.v_m is None:
            return current
        speed = o.let("speed", o.call(magnitude, measured.omega_m))
        if shared:
            shaped = self._shaped(o, gains, state, theta, torque, speed)
            both = zip(shaped, current, strict=True)
            current = Vector(*(codes.saturated(o.total("reference: sum", x, y)) for x, y in both))
        if control.midpoint is None or measured.v_m is None:
            return current
        rise = o.let("rise", control.midpoint.fade)
        balance = o.let("balance", control.midpoint.balance)
        weight = o.call(scaled, "midpoint: fade", rise, speed)
        weight = o.let("weight", o.call(bounded, weight, 0, control.top))
        gap = o.total("midpoint: gap", measured.v_m, o.negative(o.shifted(measured.v_dc, 1)))
        back = o.call(scaled, "midpoint: balance", balance, o.let("gap", codes.saturated(gap)))
        kept = o.call(code_product, width, "midpoint: zero", current.zero, weight)
        balanced = codes.saturated(o.total("midpoint: reference", kept, o.negative(back)))
        return current._replace(zero=balanced)

    def sinusoids(self, o: Arithmetic[N, Any], gains: ControlGains, torque: Coded[N]) -> Dq[N]:
        """Sinusoids that make a torque: currents along and across the magnets."""
        asked = o.call(scaled, "current per torque", gains.current_per_torque, torque)
        return Dq(o.const(0), o.call(saturated, self.control.width, asked))
