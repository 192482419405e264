"""Control of a six-step drive as the firmware runs it: catching a rotor that turns, forced start,
blocks by the estimator, current and speed.

    stopped -> caught (all legs rest, the back-EMF shows whether and how the rotor turns)
    caught  -> running, where it turns fast enough; else aligning in one block, then in the next
    aligning -> ramp: blocks at a frequency that rises -> caught -> running, or the fault no-start
    running -> stopped where the reference asks for no speed; fault lost where no crossing comes

One leg is chopped, both switches in turn, the other stays at its rail, the third rests. While the
chopped leg lies at the other's rail, the star point does so too, and the diode of the third leg at
that rail conducts where its back-EMF points there. The integral is taken while it must not: where
that EMF falls, the returning leg is chopped instead of the fed one. Up to the crossing, where such
a current is nothing, it does not matter, and the fed leg is chopped throughout. Where the diode is
what is observed, it is to conduct from the crossing on: there the EMF must rise for that.

Alignment and ramp apply a voltage, that of the start current and of the back-EMF at the forced
speed: a regulated current would leave the rotor to swing without damping. Above the limit the
current controller takes off what is too much.

The current is that of the phase which both blocks share, so that a commutation does not show in it.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.six_step.sector_step import (
    SIXTH,
    BlockGains,
    BlockState,
    at_rest,
    block_start,
    block_step,
    diode_step,
    rises,
    six_step_phase,
    six_step_seen,
)
from dqforge.optimizer.six_step.sectors import FED, RETURN
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic, Member, where

STOPPED, CATCHING, ALIGNING, RAMP, RUNNING, FAULT = range(6)

# Names of the stages, by their numbers.
STAGES = ("stopped", "catching", "aligning", "ramp", "running", "fault")
NO_FAULT, NO_START, LOST = range(3)
FAULTS = ("none", "no start", "lost")  # Names of the faults, by their numbers.
_WHOLE = "int32_t"
Number = Any  # Of a design a float or an integer, of a step a number of its arithmetic.


@dataclass(frozen=True, slots=True)
class SixStepGains:
    """Numbers of the control."""

    observer: BlockGains
    kp: Annotated[Number, Member("of the current of two phases in series", "V/A")]
    ki_ts: Annotated[Number, Member("its integral per period", "V/A")]
    emf: Annotated[
        Number,
        Member("mean back-EMF of two phases in series over the electrical speed", "V s/rad"),
    ]
    torque: Annotated[Number, Member("over the current", "N m/A")]
    i_max: Annotated[Number, Member("A")]
    duty_least: Annotated[
        Number, Member("while the position is estimated: the on-time can be sampled")
    ]
    speed_kp: Annotated[Number, Member("at the least speed", "N m s/rad")]
    speed_ki_ts: Annotated[
        Number, Member("its integral per period of the speed controller", "N m s/rad")
    ]
    omega_low: Annotated[Number, Member("least speed, rad/s (electrical)")]
    speed_scale: Annotated[Number, Member("how far the gains rise with the speed")]
    pole_pairs: Number
    ratio: Annotated[Number, Member("periods per period of the speed controller", kind=_WHOLE)]
    omega_least: Annotated[
        Number, Member("speed reference below which the drive stops, rad/s (mechanical)")
    ]
    omega_caught: Annotated[
        Number, Member("least speed from which it runs on its estimator, rad/s (electrical)")
    ]
    i_start: Annotated[Number, Member("of alignment and ramp", "A")]
    v_start: Annotated[
        Number, Member("that two phases in series take for it at rest, dead time included", "V")
    ]
    align: Annotated[Number, Member("periods of each of its two blocks", kind=_WHOLE)]
    rise: Annotated[Number, Member("of the ramp: blocks per period and period")]
    rate: Annotated[Number, Member("its end, blocks per period")]
    settle: Annotated[
        Number,
        Member("periods with all legs at rest before the back-EMF is looked at", kind=_WHOLE),
    ]
    gap: Annotated[Number, Member("and between both looks", kind=_WHOLE)]
    duty_most: Annotated[
        Number | None, Member("while diodes are observed: in the off-time they can conduct")
    ] = None


@dataclass(slots=True)
class SixStep:
    """What the control keeps from period to period."""

    stage: Annotated[Any, Member("", kind=_WHOLE)]
    fault: Annotated[Any, Member("", kind=_WHOLE)]
    direction: Annotated[Any, Member("1 or -1", kind=_WHOLE)]
    sector: Annotated[Any, Member("0 to 5: fed now", kind=_WHOLE)]
    count: Annotated[Any, Member("periods in this stage", kind=_WHOLE)]
    ramped: Annotated[Any, Member("1: the ramp is over", kind=_WHOLE)]
    seen: Annotated[Any, Member("sector at the first look", kind=_WHOLE)]
    tick: Annotated[Any, Member("periods since the speed controller ran", kind=_WHOLE)]
    rate: Annotated[Reals, Member("of the ramp, blocks per period")]
    phase: Annotated[Reals, Member("of its block")]
    beyond: Annotated[Reals, Member("the crossing at the first look, rad")]
    integral: Annotated[Reals, Member("of the current, V")]
    speed_integral: Annotated[Reals, Member("N m")]
    asked: Annotated[Reals, Member("torque, N m")]
    current: Annotated[Reals, Member("reference, A")]
    observer: BlockState


class SixStepLegs(NamedTuple):
    """What the legs do in the next period; phases 0, 1, 2, or -1 where all rest: high lies at the
    positive rail, low at the negative one, the third leg rests. One of both is chopped: it lies at
    its rail for the share duty of the period, about its middle, and at the other rail before and
    after.
    """

    high: Annotated[Any, Member("", kind=_WHOLE)]
    low: Annotated[Any, Member("", kind=_WHOLE)]
    chopped: Annotated[Any, Member("", kind=_WHOLE)]
    duty: Reals


def _stage(o: Arithmetic, stage: int) -> Any:
    name = STAGES[stage].upper()
    return o.constant(f"SIX_STEP_{name}", stage)


def _fault(o: Arithmetic, fault: int) -> Any:
    name = FAULTS[fault].upper().replace(" ", "_")
    return o.constant(f"SIX_STEP_FAULT_{name}", fault)


def blank() -> SixStep:
    """Members of a state before `six_step_reset`."""
    zero: Any = 0.0
    return SixStep(STOPPED, NO_FAULT, 1, *(0,) * 5, *(zero,) * 7, at_rest())


def six_step_reset(o: Arithmetic, gains: SixStepGains, drive: SixStep) -> None:
    """A drive at rest, without a fault."""
    zero = o.full(0.0, gains.omega_caught)
    drive.stage, drive.fault = _stage(o, STOPPED), _fault(o, NO_FAULT)
    drive.direction = 1
    drive.sector, drive.count, drive.ramped, drive.seen, drive.tick = 0, 0, 0, 0, 0
    drive.rate, drive.phase, drive.beyond = zero, zero, zero
    drive.integral, drive.speed_integral, drive.asked, drive.current = zero, zero, zero, zero
    o.call(block_start, gains.observer, drive.observer, 0, 1, gains.omega_caught, zero)


def six_step_begin(o: Arithmetic, drive: SixStep, stage: Any) -> None:
    """A stage begins."""
    drive.stage, drive.count = stage, 0
    drive.integral = o.full(0.0, drive.integral)


def six_step_begin_start(o: Arithmetic, drive: SixStep, direction: Any) -> None:
    """A start in a direction begins."""
    drive.direction, drive.ramped = direction, 0
    drive.fault = _fault(o, NO_FAULT)
    o.call(six_step_begin, drive, _stage(o, CATCHING))


def six_step_catch(o: Arithmetic, gains: SixStepGains, drive: SixStep, v: Abc) -> None:
    """All legs rest: two looks at the back-EMF."""
    direction = drive.direction
    seen = o.let("seen", o.call(six_step_seen, v, direction))
    drive.count = count = o.let("count", drive.count + 1)

    def first() -> None:
        drive.seen, drive.beyond = seen.sector, seen.beyond

    def second() -> None:
        x = o.let("x", o.real(gains.gap) * gains.observer.t_s)
        held = o.let("held", 0.5 * (gains.emf * gains.omega_caught))
        least = o.let("least", 0.7 * gains.omega_caught)
        forwards, backwards = seen.sector - drive.seen, drive.seen - seen.sector
        passed = o.let("passed", (o.choose(direction > 0, forwards, backwards) + 6) % 6)
        blocks = o.let("blocks", o.choose(passed > 3, passed - 6, passed))
        turned = SIXTH * o.real(blocks) + (seen.beyond - drive.beyond)
        omega = o.let("omega", turned / x)

        def caught() -> None:
            latency = gains.observer.latency
            ahead = o.let("ahead", seen.beyond + (omega * gains.observer.t_s) * latency)
            drive.sector = seen.sector
            start = gains.observer, drive.observer, seen.sector, direction, omega, ahead
            o.call(block_start, *start)
            drive.speed_integral = 0.5 * (gains.torque * gains.i_start)
            drive.tick = 0
            o.call(six_step_begin, drive, _stage(o, RUNNING))

        def failed() -> None:
            drive.fault = _fault(o, NO_START)
            o.call(six_step_begin, drive, _stage(o, FAULT))

        def waits() -> None:
            o.remark("it turns the other way: wait")
            drive.count = 0

        def aligns() -> None:
            drive.sector = 0
            o.call(six_step_begin, drive, _stage(o, ALIGNING))

        shows = o.let("shows", seen.largest >= held)
        o.cases(
            "",
            (shows & (omega >= least), caught),
            (o.negated(o.equal(drive.ramped, 0)), failed),
            (shows & (omega <= -least), waits),
            otherwise=aligns,
            changing=(drive,),
        )

    where(o, o.equal(count, gains.settle), first, drive)
    where(o, count >= gains.settle + gains.gap, second, drive)


def six_step_force(o: Arithmetic, gains: SixStepGains, drive: SixStep) -> None:
    """Alignment in two blocks, then blocks at a rising frequency."""
    following = (drive.sector + o.choose(drive.direction > 0, 1, 5)) % 6
    following = o.let("following", following)

    def on() -> None:
        drive.sector = following

    def aligning() -> None:
        drive.count = count = o.let("count", drive.count + 1)

        def aligned() -> None:
            zero = o.full(0.0, drive.rate)
            drive.rate, drive.phase = zero, zero
            drive.stage = _stage(o, RAMP)

        where(o, o.equal(count, gains.align), on, drive)
        where(o, count >= 2 * gains.align, aligned, drive)

    def ramp() -> None:
        drive.rate = rate = o.let("rate", drive.rate + gains.rise)
        drive.phase = phase = o.let("phase", drive.phase + rate)

        def passed() -> None:
            drive.phase = phase - 1.0
            on()

        def ended() -> None:
            drive.ramped = 1
            o.call(six_step_begin, drive, _stage(o, CATCHING))

        where(o, phase >= 1.0, passed, drive)
        where(o, rate >= gains.rate, ended, drive)

    aligns = o.equal(drive.stage, _stage(o, ALIGNING))
    o.cases("", (aligns, aligning), otherwise=ramp, changing=(drive,))


def six_step_wanted(o: Arithmetic, gains: SixStepGains, drive: SixStep) -> Reals:
    """Current in A that is wanted."""

    def running() -> Reals:
        along = o.choose(drive.direction > 0, drive.asked, -drive.asked)
        current = o.let("asked", along / gains.torque)
        above = o.let("above", o.choose(current > 0.0, current, o.full(0.0, current)))
        return o.choose(above < gains.i_max, above, gains.i_max)

    runs = o.equal(drive.stage, _stage(o, RUNNING))
    return o.cases("current", (runs, running), otherwise=lambda: gains.i_start)


def six_step_voltage(
    o: Arithmetic, gains: SixStepGains, drive: SixStep, i: Reals, v_dc: Reals
) -> Reals:
    """Duty cycle of the fed leg by the current controller."""
    zero = o.full(0.0, i)

    def regulated() -> tuple[Reals, Reals, Reals]:
        omega = drive.observer.omega_e
        speed = o.choose(omega >= 0.0, omega, -omega)
        difference = o.let("difference", drive.current - i)
        wanted = (gains.emf * speed + drive.integral) + gains.kp * difference
        return wanted, difference, gains.duty_least

    def forced() -> tuple[Reals, Reals, Reals]:
        o.remark("a voltage: a regulated current would leave the rotor to swing without damping")
        ramps = o.equal(drive.stage, _stage(o, RAMP))
        rate = o.let("rate", o.choose(ramps, drive.rate, zero))
        over = o.let("over", i - gains.i_max)
        emf = (gains.emf * rate) * (SIXTH / gains.observer.t_s)
        excess = o.choose(over > 0.0, over, zero)
        return (gains.v_start + emf) - gains.kp * excess, zero, zero

    runs = o.equal(drive.stage, _stage(o, RUNNING))
    most = 1.0 if gains.duty_most is None else gains.duty_most
    wanted, error, low = o.cases(("wanted", "error", "low"), (runs, regulated), otherwise=forced)
    asked = o.let("asked", o.choose(v_dc > 0.0, wanted / v_dc, zero))

    def moved(by: Reals) -> None:
        drive.integral = drive.integral + gains.ki_ts * by

    def within() -> Reals:
        moved(error)
        return asked

    def above() -> Reals:
        moved(o.choose(error < 0.0, error, zero))
        return o.full(1.0, asked) if gains.duty_most is None else gains.duty_most

    def below() -> Reals:
        moved(o.choose(error > 0.0, error, zero))
        return low

    return o.cases(
        "duty",
        ((asked >= low) & (asked <= most), within),
        (asked > most, above),
        otherwise=below,
        changing=(drive,),
    )


def six_step_speed_control(
    o: Arithmetic, gains: SixStepGains, drive: SixStep, reference: Reals
) -> Reals:
    """Torque in N m for a mechanical speed reference in rad/s; call it once per period, before the
    step. A stopped drive starts where the reference asks for a speed, a running one stops where it
    asks for none, or for the other direction.
    """
    way = o.let("way", o.choose(reference >= 0.0, 1, -1))
    size = o.let("size", o.choose(way > 0, reference, -reference))
    wanted = o.let("wanted", size >= gains.omega_least)
    zero = o.full(0.0, reference)

    def stops() -> None:
        omega = drive.observer.omega_e
        slow = o.let("slow", o.choose(omega >= 0.0, omega, -omega))
        ended = o.negated(o.equal(drive.observer.lost, 0)) | (slow < gains.omega_caught)
        where(o, ended, lambda: o.call(six_step_begin, drive, _stage(o, STOPPED)), drive)
        drive.asked, drive.speed_integral = zero, zero

    def controls() -> None:
        drive.asked = _regulated(o, gains, drive, reference, way)

    def between() -> None:
        o.remark("between two samples of the speed")

    def stopped() -> None:
        where(o, wanted, lambda: o.call(six_step_begin_start, drive, way), drive)

    def running() -> None:
        other = o.negated(wanted) | o.negated(o.equal(way, drive.direction))
        o.cases(
            "",
            (other, stops),
            (o.equal(drive.tick, 0), controls),
            otherwise=between,
            changing=(drive,),
        )

    o.switch(
        "",
        drive.stage,
        {_stage(o, STOPPED): stopped, _stage(o, RUNNING): running},
        lambda: o.remark("it starts, or waits for the end of a fault"),
        changing=(drive,),
    )
    later = o.let("later", drive.tick + 1)
    drive.tick = o.choose(later < gains.ratio, later, 0)
    return drive.asked


def _regulated(
    o: Arithmetic, gains: SixStepGains, drive: SixStep, reference: Reals, way: Any
) -> Reals:
    """Torque in N m of the speed controller."""
    zero = o.full(0.0, reference)
    most = o.let("most", gains.torque * gains.i_max)
    omega = drive.observer.omega_e
    gap = o.let("gap", reference - omega / gains.pole_pairs)
    error = o.let("error", o.choose(way > 0, gap, -gap))
    seen = o.choose(way > 0, omega, -omega)
    ratio = o.let("ratio", seen / gains.omega_low, "the faster it turns, the sooner it is known")
    above = o.let("above", o.choose(ratio > 1.0, ratio, o.full(1.0, ratio)))
    scale = o.let("scale", o.choose(above < gains.speed_scale, above, gains.speed_scale))
    asked = o.let("asked", (scale * gains.speed_kp) * error + drive.speed_integral)

    def integrated() -> None:
        gain = (scale * scale) * gains.speed_ki_ts
        drive.speed_integral = drive.speed_integral + gain * error

    free = ((asked < most) | (error < 0.0)) & ((asked > 0.0) | (error > 0.0))
    where(o, free, integrated, drive)
    below = o.let("below", o.choose(asked > most, most, asked))
    given = o.let("given", o.choose(below > 0.0, below, zero))
    return o.choose(way > 0, given, -given)


def six_step_torque_control(o: Arithmetic, drive: SixStep, reference: Reals) -> Reals:
    """The same for a torque reference in N m: a stopped drive starts in its direction; against the
    rotation it counts as none.
    """
    stopped = o.equal(drive.stage, _stage(o, STOPPED))
    way = o.let("way", o.choose(reference > 0.0, 1, -1))
    starts = stopped & ((reference > 0.0) | (reference < 0.0))
    where(o, starts, lambda: o.call(six_step_begin_start, drive, way), drive)
    given = o.choose(o.is_number(reference), reference, o.full(0.0, reference))
    drive.asked = asked = o.let("asked", given)
    return asked


def six_step_step(
    o: Arithmetic, gains: SixStepGains, drive: SixStep, v: Abc, i: Abc, v_dc: Reals
) -> SixStepLegs:
    """One period: voltages of the terminals and currents into the phases, both sampled in its
    middle, and the link's voltage in V; what the legs do in the next one.
    """
    return _stepped(o, gains, drive, v, i, v_dc)


def six_step_diode_step(
    o: Arithmetic,
    gains: SixStepGains,
    drive: SixStep,
    v: Abc,
    diodes: Abc,
    i: Abc,
    v_dc: Reals,
) -> SixStepLegs:
    """One period: voltages of the terminals and currents into the phases, sampled in its middle;
    1 of each leg whose switches rest and whose diode conducted at its beginning, else 0; the link's
    voltage in V. The voltages serve the start alone. What the legs do in the next period.
    """
    return _stepped(o, gains, drive, v, i, v_dc, diodes)


def _stepped(
    o: Arithmetic,
    gains: SixStepGains,
    drive: SixStep,
    v: Abc,
    i: Abc,
    v_dc: Reals,
    diodes: Abc | None = None,
) -> SixStepLegs:
    before = o.let("before", drive.sector)
    aligning, ramp, running = (_stage(o, stage) for stage in (ALIGNING, RAMP, RUNNING))

    def lost() -> None:
        drive.fault = _fault(o, LOST)
        o.call(six_step_begin, drive, _stage(o, FAULT))

    def estimated() -> None:
        if diodes is None:
            o.call(block_step, gains.observer, drive.observer, v)
        else:
            o.call(diode_step, gains.observer, drive.observer, diodes)
        drive.sector = drive.observer.sector
        where(o, o.negated(o.equal(drive.observer.lost, 0)), lost, drive)

    def forced() -> None:
        o.call(six_step_force, gains, drive)

    o.switch(
        "",
        drive.stage,
        {
            _stage(o, CATCHING): lambda: o.call(six_step_catch, gains, drive, v),
            running: estimated,
            (aligning, ramp): forced,
        },
        lambda: o.remark("at rest"),
        changing=(drive,),
    )

    def fed() -> SixStepLegs:
        # the phase that both blocks share is fed, or returns the current
        first = o.constant("SIX_STEP_FED", FED)
        second = o.constant("SIX_STEP_RETURN", RETURN)
        goes = o.call(six_step_phase, i, o.at(first, before))
        returns = o.call(six_step_phase, i, o.at(second, before))
        shared = o.let("shared", o.choose(rises(before, drive.direction), goes, -returns))
        drive.current = o.let("current", o.call(six_step_wanted, gains, drive))
        duty = o.let("duty", o.call(six_step_voltage, gains, drive, shared, v_dc))
        high = o.let("high", o.at(first, drive.sector))
        low = o.let("low", o.at(second, drive.sector))
        flat = _flat(o, gains, drive, o.equal(drive.stage, running), diodes)
        return SixStepLegs(high, low, o.choose(flat, low, high), duty)

    def rests() -> SixStepLegs:
        return SixStepLegs(-1, -1, -1, o.full(0.0, v_dc))

    acts = o.equal(drive.stage, aligning) | o.equal(drive.stage, ramp)
    acts = acts | o.equal(drive.stage, running)
    return o.cases("legs", (acts, fed), otherwise=rests, changing=(drive,))


def _flat(o: Arithmetic, gains: SixStepGains, drive: SixStep, runs: Any, diodes: Abc | None) -> Any:
    """Whether the returning leg is chopped instead of the fed one."""
    rising = rises(drive.sector, drive.direction)
    if diodes is not None:
        text = "the diode of the third leg conducts from the crossing on"
        return o.let("rising", runs & rising, text)
    by_integral = o.negated(o.equal(gains.observer.by_integral, 0))
    text = "the diodes of the third leg stay free of current while it is integrated"
    return o.let("falls", runs & by_integral & o.negated(rising), text)
