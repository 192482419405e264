"""Control functions in integers for a design: per-unit constants, formats that use the word,
and their evidence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import filter_share
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.fixed_control.codes import full_scale, sine_error
from dqforge.optimizer.fixed_control.ranges import (
    DeadBand,
    control_ranges,
    dead_band,
    finest,
    observer_ranges,
    pi_ranges,
    require,
    with_fraction,
)
from dqforge.optimizer.fixed_control.transforms import (
    FixedControl,
    FixedDecoupling,
    FixedObserver,
    FixedPi,
    FixedReferences,
    PiForm,
)
from dqforge.optimizer.loops.integer_gains import FixedGain, given, quantise, rounded_mantissa
from dqforge.optimizer.loops.loop_gains import (
    LoopGains,
    analyse_current_loop,
    analyse_speed_loop,
    decoupling,
    loop_bases,
    per_unit,
)
from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
from dqforge.optimizer.steps.integer_arithmetic import Reach

DC_HEADROOM = 1.15  # of the dc link over its nominal value that its full scale holds at least


_MOST_DC_SCALE = 6


_LARGEST_ERROR = 0.02  # of a gain whose format was chosen here


@dataclass(frozen=True, slots=True)
class FixedControlFit:
    """Control functions in integers with their evidence.

    Args:
        control: The integers.
        loops: Each loop with the gains that its integers make, by name.
        reaches: Proven range of every product and sum.
        dead_bands: Smallest errors that move each integral, by loop.
        word_dead_bands: The same for integrals without fractional bits, as they would be in one
            word.
        sine_error: Largest error of sine and cosine in codes.
    """

    control: FixedControl
    loops: dict[str, QuantisedLoop]
    reaches: tuple[Reach, ...]
    dead_bands: dict[str, DeadBand]
    word_dead_bands: dict[str, DeadBand]
    sine_error: float

    def physical_band(self, loop: str) -> float | None:
        """Smallest error in A or rad/s that moves the integral of a loop; None without one."""
        band = self.dead_bands.get(loop)
        one = self.control.one_code[2 if loop == "speed" else 0]
        return None if band is None else band.largest * one

    @property
    def filter_band(self) -> float:
        """Smallest change of the speed in rad/s that moves its filter."""
        return dead_band(self.control.speed_filter).largest * self.control.one_code[2]

    @property
    def observer_band(self) -> float | None:
        """Speed in rad/s below which the observer's state no longer decays; None without one."""
        part = self.control.observer
        if part is None or part.decay.mantissa <= 0:
            return None
        return dead_band(part.decay).largest * self.control.one_code[2]

    @property
    def fullest(self) -> Reach:
        """The quantity that comes nearest to its word's end."""
        return max(self.reaches, key=lambda reach: reach.share)


def fit_control(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains | None],
    observer: ReducedOrderObserver | None,
    width: int,
    torque_max: float | None = None,
    reference: FixedReferences | None = None,
) -> FixedControlFit:
    """Control functions of a design in words of 16 or 32 bits.

    Args:
        design: Machine, inverter, sampling and bases.
        loops: Gains of i_d, i_q and, where there is one, of the speed loop.
        observer: The reduced-order observer, if one is wanted.
        width: Bits of a code.
        torque_max: Limit of the speed controller's output in N m; None is full scale.
        reference: Current references in the same codes, if there are any.

    Raises:
        InputError: The bases do not hold the largest current or speed.
        NoSolutionError: A quantity can overflow, a gain has no format, or a loop with rounded gains
            misses its phase margin.
    """
    _require_bases(design)
    found: dict[str, QuantisedLoop] = {}
    forms: dict[str, dict[PiForm, FixedPi]] = {}
    decoupled = _decoupling(design, width)
    for loop in loops:
        if loop is not None:
            further = feed_reach(decoupled, width).get(loop.loop, 0)
            found[loop.loop], forms[loop.loop] = loop_integers(
                design, loop, width, loops[1], further
            )
    dc_scale, dc_least = dc_link(design, width)
    control = FixedControl(
        width=width,
        bases=_bases(design),
        modulation=design.operation.modulation,
        dc_scale=dc_scale,
        dc_least=dc_least,
        limit=precise_gain("voltage limit", _limit(design), width, 2 ** (width - 1)),
        advance=precise_gain("angle advance", _advance(design), width, 2 ** (width - 1)),
        i_d=forms["i_d"],
        i_q=forms["i_q"],
        speed=forms.get("speed"),
        decoupling=decoupled,
        observer=None if observer is None else _observer(design, observer, width),
        speed_filter=speed_filter(design, width),
        torque_max=torque_code(design, torque_max, width),
        ratio=1 if design.control.speed_loop is None else design.control.speed_loop.ratio,
        reference=reference,
    )
    bands = {
        name: dead_band(made["parallel"].ki)
        for name, made in forms.items()
        if made["parallel"].ki.mantissa > 0
    }
    whole = {name: dead_band(found[name].ki_ts) for name in bands}
    return FixedControlFit(control, found, control_ranges(control), bands, whole, sine_error(width))


def fit_controls(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains | None],
    observer: ReducedOrderObserver | None,
    torque_max: float | None = None,
    references: Mapping[int, FixedReferences] | None = None,
) -> tuple[FixedControlFit, ...]:
    """Control functions in every fixed-point format that the design asks for.

    ``references`` are current references by the bits of their codes. Other arguments and errors as
    `fit_control`.
    """
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    known = references or {}
    return tuple(
        fit_control(design, loops, observer, width, torque_max, known.get(width))
        for width in widths
    )


def torque_code(design: Design, torque_max: float | None, width: int) -> int:
    """Code of a torque in N m, full scale at the most."""
    top = full_scale(width)
    if torque_max is None:
        return top
    return min(top, round(torque_max / design.control.bases.torque * 2.0 ** (width - 1)))


def speed_filter(design: Design, width: int) -> FixedGain:
    """Share of a new speed sample, to a state with width - 2 more bits than a code."""
    settings = design.control.speed_loop
    share = filter_share(0.0 if settings is None else settings.filter_time, design.control.t_s)
    return precise_gain("speed filter", share * 2.0 ** (width - 2), width, 2**width - 1)


def _bases(design: Design) -> tuple[float, float, float, float]:
    bases = design.control.bases
    return bases.current, bases.voltage, bases.speed, bases.torque


def require_scales(design: Design) -> None:
    """Refuse bases of current and speed that do not hold the largest ones, those of the
    references with field weakening among them: a speed beyond full scale would be clamped.

    Raises:
        InputError: With the base, what it must hold, and what to write.
    """
    bases, weakening = design.control.bases, design.weakening
    known = (design.machine.omega_m_max, None if weakening is None else weakening.omega_m)
    speed = max((each for each in known if each is not None), default=None)
    if design.i_max > bases.current * (1.0 + 1e-9):
        raise InputError(
            f"control.per_unit.current: {bases.current:.4g} A is full scale in fixed point, but "
            f"the current limit is {design.i_max:.4g} A; write current: {design.i_max * 1.25:.3g} A"
        )
    if speed is not None and speed > bases.speed * (1.0 + 1e-9):
        raise InputError(
            f"control.per_unit.speed: {in_rpm(bases.speed):.5g} rpm is full scale in fixed point, "
            f"but the largest speed is {in_rpm(speed):.5g} rpm; write speed: "
            f"{in_rpm(speed) * 1.25:.4g} rpm"
        )


def _require_bases(design: Design) -> None:
    require_scales(design)
    bases = design.control.bases
    if design.inverter.v_dc * DC_HEADROOM > bases.voltage * 2**_MOST_DC_SCALE:
        raise InputError(
            f"control.per_unit.voltage: {bases.voltage:.4g} V is too small a base for a dc link of"
            f" {design.inverter.v_dc:.4g} V in fixed point;"
            f" write voltage: {linear_voltage(design.inverter.v_dc):.4g} V"
        )


def _dc_scale(design: Design) -> int:
    ratio = design.inverter.v_dc * DC_HEADROOM / design.control.bases.voltage
    return max(0, math.ceil(math.log2(ratio)))


def _dc_base(design: Design) -> float:
    return design.control.bases.voltage * 2.0 ** _dc_scale(design)


def dc_link(design: Design, width: int) -> tuple[int, int]:
    """Scale of the dc link as a power of two, and the code below which it is taken as that."""
    half = 0.5 * design.inverter.v_dc / _dc_base(design)
    return _dc_scale(design), round(half * 2 ** (width - 1))


def _limit(design: Design) -> float:
    share = MODULATORS[design.operation.modulation].linear_limit
    return share * (1.0 - design.operation.voltage_margin) * 2.0 ** _dc_scale(design)


def _advance(design: Design) -> float:
    """Share of a turn in 1.5 samples at full speed, between codes of half
    a turn and of full speed.
    """
    turns = (
        1.5
        * design.control.t_s
        * design.machine.pole_pairs
        * design.control.bases.speed
        / (2.0 * math.pi)
    )
    return 2.0 * turns


def precise_gain(name: str, value: float, width: int, argument: int) -> FixedGain:
    """A gain in the best format, refused where even that is coarse.

    Args:
        name: What it is, for the message.
        value: The gain between codes.
        width: Bits of a code.
        argument: Largest magnitude of what it is multiplied with.

    Raises:
        NoSolutionError: No format holds it within 2 %.
    """
    try:
        gain = quantise(value, width, argument)
    except NoSolutionError as error:
        raise NoSolutionError(f"fixed point: {name}: {error}") from None
    if abs(gain.error) > _LARGEST_ERROR:
        raise NoSolutionError(
            f"fixed point: {name} {value:.4g} is rounded by {gain.error:+.1%} in {width} bits; use "
            "other bases"
        )
    return gain


def loop_integers(
    design: Design, gains: LoopGains, width: int, current_gains: LoopGains, further: int
) -> tuple[QuantisedLoop, dict[PiForm, FixedPi]]:
    """Integers of a loop in both forms, and what they do to it; ``further`` as of `pi_ranges`."""
    control = design.control
    section = control.speed_loop if gains.loop == "speed" else control.current_loop
    formats = None if section is None else section.q_formats
    kp, ki_ts = real_pi(design, gains)
    tracking = gains.anti_windup * gains.t_s
    forms: dict[PiForm, FixedPi] = {}
    for form in ("parallel", "velocity"):
        asked = formats if width == 16 else None
        found = None
        if asked is not None and asked != "auto":
            found = _in_formats(gains.loop, (kp, ki_ts, tracking), asked, form, further)
        forms[form] = found or _automatic(gains.loop, (kp, ki_ts, tracking), width, form, further)
    shown = forms["parallel"]
    plain = FixedGain(shown.ki.mantissa, shown.ki.shift + shown.fraction, ki_ts)
    loop = quantised_loop(design, gains, (shown.kp, plain), width, current_gains)
    return loop, forms


def _automatic(
    name: str, values: tuple[float, float, float], width: int, form: PiForm, further: int
) -> FixedPi:
    """Mantissas that use the word, and the most fractional bits of the state."""
    kp, ki_ts, tracking = values
    error = 2**width - 1
    proportional = precise_gain(f"kp of {name}", kp, width, error)
    for fraction in range(width - 2, -1, -1):
        scale = 2.0**fraction
        try:
            ki = quantise(ki_ts * scale, width, error)
            back = quantise(tracking * scale, width, excess_reach(width, kp, ki_ts, further))
        except NoSolutionError:
            continue
        found = FixedPi(proportional, ki, back, fraction)
        if pi_ranges(width, name, found, form, further).overflowing() is None:
            return found
    raise NoSolutionError(
        f"fixed point: kp, ki t_s and the back-calculation of {name}, {kp:.4g}, {ki_ts:.4g} and "
        f"{tracking:.4g} per unit, have no format of {width} bits together; use other bases"
    )


def _in_formats(
    name: str,
    values: tuple[float, float, float],
    formats: tuple[int, int],
    form: PiForm,
    further: int,
) -> FixedPi:
    """The integers of 16 bits in the formats of the design.

    Names the smallest change that would hold.
    """
    kp, ki_ts, tracking = values
    back = quantise(tracking, 16, excess_reach(16, kp, ki_ts, further))
    whole = FixedPi(given(kp, formats[0]), given(ki_ts, formats[1]), back, 0)
    found = finest(16, name, whole, form, formats[1], further)
    if found is not None:
        return found
    trial = with_fraction(whole, 0)
    assert trial is not None
    require(pi_ranges(16, name, trial, form, further), _cure(name, values, formats, form, further))
    raise AssertionError  # some fraction would have held


def _cure(
    name: str,
    values: tuple[float, float, float],
    formats: tuple[int, int],
    form: PiForm,
    further: int,
) -> str:
    """Formats with the fewest bits less that hold, as advice."""
    section = "speed_loop" if name == "speed" else "current_loop"
    limits = [range(bits, -1, -1) for bits in formats]
    pairs = sorted(((m, n) for m in limits[0] for n in limits[1]), key=lambda pair: -sum(pair))
    for pair in pairs:
        try:
            whole = FixedPi(
                given(values[0], pair[0]),
                given(values[1], pair[1]),
                quantise(values[2], 16, excess_reach(16, values[0], values[1], further)),
                0,
            )
        except NoSolutionError:
            continue
        if finest(16, name, whole, form, pair[1], further) is not None:
            return f"write control.{section}.q_formats: [{pair[0]}, {pair[1]}]"
    return (
        "no format of 16 bits holds; use larger bases in control.per_unit, or smaller gains in "
        f"control.{section}"
    )


def feed_reach(part: FixedDecoupling, width: int) -> dict[str, int]:
    """Largest magnitude of the feedforward of both axes in codes, by loop."""
    top = 2 ** (width - 1)
    sizes = {"i_d": (part.x_q,), "i_q": (part.x_d, part.back_emf)}
    return {
        name: sum(2 + math.ceil(abs(gain.realised) * top) for gain in gains)
        for name, gains in sizes.items()
    }


def excess_reach(width: int, kp: float, ki_ts: float, further: int) -> int:
    """Codes that the excess of a limited output stays within: kp e + integral + ki t_s e and
    ``further`` codes of feedforward less what is left of them.
    """
    codes: int = 2**width
    return math.ceil(1.01 * (abs(kp) + abs(ki_ts)) * codes) + codes + further


def _decoupling(design: Design, width: int) -> FixedDecoupling:
    current, voltage, speed, _ = _bases(design)
    omega_e, found = design.machine.pole_pairs * speed, decoupling(design.machine)
    argument = 2 ** (width - 1)
    return FixedDecoupling(
        x_d=precise_gain(
            "decoupling l_d", omega_e * found.l_d * current / voltage, width, argument
        ),
        x_q=precise_gain(
            "decoupling l_q", omega_e * found.l_q * current / voltage, width, argument
        ),
        back_emf=precise_gain("decoupling psi", omega_e * found.psi_pm / voltage, width, argument),
    )


def _observer(design: Design, observer: ReducedOrderObserver, width: int) -> FixedObserver:
    """Coefficients per unit with the most fractional bits of zeta."""
    current, voltage, speed, _ = _bases(design)
    c = observer.c * current / speed
    reach = max(2, 2 ** math.ceil(math.log2(1.0 + abs(c))))
    x_d = _decoupling(design, width).x_d
    code, error = 2 ** (width - 1), 2**width - 1
    fault: NoSolutionError | None = None
    for fraction in range(width - 2, -1, -1):
        scale = 2.0**fraction
        try:
            found = FixedObserver(
                decay=precise_gain(
                    "observer 1 - a", (1.0 - observer.a) * scale, width, reach * code
                ),
                b_u=precise_gain(
                    "observer b_u", observer.b_u * voltage / speed * scale, width, error
                ),
                b_i=precise_gain(
                    "observer b_i", observer.b_i * current / speed * scale, width, code
                ),
                c=precise_gain("observer c", c, width, code),
                x_d=x_d,
                fraction=fraction,
                reach=reach,
            )
            require(observer_ranges(width, found))
        except NoSolutionError as error_found:
            fault = error_found
            continue
        return found
    assert fault is not None
    raise fault


# What rounding gains to integers (`dqforge.optimizer.loops.integer_gains`) does to the loop.


def velocity_integers(kp: float, ki_ts: float, width: int = 16) -> tuple[FixedGain, FixedGain]:
    """Integers of q0 = kp + ki t_s and q1 = -kp with one shift, d[k] = d[k-1] + q0 e[k] + q1
    e[k-1] (paper 001, (8.9)).

    The integral gain is the small difference q0 + q1, so that it loses the digits that both share.
    """
    coarse = quantise(kp + ki_ts, width, 2**width - 1)
    return coarse, FixedGain(rounded_mantissa(-kp, coarse.shift), coarse.shift, -kp)


@dataclass(frozen=True, slots=True)
class QuantisedLoop:
    """One loop with the gains that integers make.

    Args:
        kp, ki_ts: The integers, per unit.
        q0, q1: Those of the velocity form with two products.
        exact, found: Evidence for the real gains and for those of ``kp`` and ``ki_ts``.
        velocity: Evidence for the gains that ``q0`` and ``q1`` make; None where their integral gain
            is not positive.
    """

    kp: FixedGain
    ki_ts: FixedGain
    q0: FixedGain
    q1: FixedGain
    exact: LoopGains
    found: LoopGains
    velocity: LoopGains | None

    @property
    def velocity_ki_error(self) -> float:
        """Relative error of the integral gain q0 + q1."""
        return (self.q0.realised + self.q1.realised) / self.ki_ts.value - 1.0


def quantised_loop(
    design: Design,
    gains: LoopGains,
    integers: tuple[FixedGain, FixedGain],
    width: int = 16,
    current_gains: LoopGains | None = None,
) -> QuantisedLoop:
    """Poles and margins of a loop with its gains in integers.

    Args:
        design: Machine, sampling and bases.
        gains: The loop with real gains.
        integers: kp and ki t_s per unit.
        width: Bits of q0 and q1.
        current_gains: Gains of the q axis, for the speed loop.

    Raises:
        NoSolutionError: The loop with these integers is unstable or has less than the required
            phase margin.
    """
    kp, ki_ts = integers
    q0, q1 = velocity_integers(kp.value, ki_ts.value, width)
    found = _analysed(design, gains, (kp.realised, ki_ts.realised), current_gains)
    velocity_ki = q0.realised + q1.realised
    velocity = (
        None
        if velocity_ki <= 0.0
        else _analysed(design, gains, (-q1.realised, velocity_ki), current_gains)
    )
    _require(design, found, kp, ki_ts)
    return QuantisedLoop(kp, ki_ts, q0, q1, gains, found, velocity)


def real_pi(design: Design, gains: LoopGains) -> tuple[float, float]:
    """Per-unit (kp, ki t_s) of a loop of the design."""
    return per_unit(gains, *loop_bases(design.control.bases, gains.loop))


def _analysed(
    design: Design, gains: LoopGains, found: Sequence[float], current_gains: LoopGains | None
) -> LoopGains:
    base_in, base_out = loop_bases(design.control.bases, gains.loop)
    kp, ki = found[0] * base_out / base_in, found[1] * base_out / base_in / gains.t_s
    if gains.loop == "speed":
        assert current_gains is not None
        return analyse_speed_loop(
            design.machine, current_gains, design.control, kp, ki, gains.method, respond=False
        )
    inductance = gains.inductance or design.machine.l_q
    return analyse_current_loop(
        design.machine.r_s, inductance, gains.t_s, kp, ki, gains.method, gains.loop, respond=False
    )


def _require(design: Design, found: LoopGains, kp: FixedGain, ki_ts: FixedGain) -> None:
    control = design.control
    loop = control.speed_loop if found.loop == "speed" else control.current_loop
    section = "speed_loop" if found.loop == "speed" else "current_loop"
    required = 0.0 if loop is None else loop.min_phase_margin
    if found.stable and abs(found.phase_margin) >= required:
        return
    raise NoSolutionError(
        (
            f"control.{section}: with kp = {kp.text()} and ki t_s = {ki_ts.text()} the "
            f"{found.loop} loop "
        )
        + ("misses its phase margin" if found.stable else "is unstable")
        + f" (rounded by {kp.error:+.2%} and {ki_ts.error:+.2%}); write q_formats: auto"
    )


# The integer control that a design asks for.


@on_design("export.control")
def solve_fixed(
    design: Design,
    gains: GainSet,
    torque_max: float | None = None,
    references: Mapping[int, FixedReferences] | None = None,
) -> tuple[FixedControlFit, ...]:
    """Control functions in the fixed-point formats that the design asks for.

    Arguments and errors as `fit_controls`.
    """
    loops = (gains.i_d, gains.i_q, gains.speed)
    return fit_controls(design, loops, gains.observer, torque_max, references)
