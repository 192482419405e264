"""Gains of the speed loop and its phase-locked loop within the structure of a firmware.

As `dqforge.optimizer.firmware.gain_search`, with the current loops fixed. The
phase-locked loop stays as the design gives it, or as the firmware has it where the loop holds with
that; else its poles are put together, and then kp is raised.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import VendorMethod
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    LoopProfile,
    Mechanics,
    PiController,
    PiGains,
    SpeedController,
    Winding,
    added_gain,
    current_plant,
    equivalent_gains,
    speed_plant,
    turning_axes,
)
from dqforge.optimizer.firmware.firmware_method import (
    METHODS,
    Asked,
    FirmwareMethod,
    JudgedFirmware,
    JudgedLoop,
    check_drivable,
    judge,
    judged_loop,
)
from dqforge.optimizer.firmware.firmware_method import asked as asked_of
from dqforge.optimizer.loops.loop_gains import LoopGains, speed_delay
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    BatchMargins,
    PlantBatch,
    Settings,
    batch_margins,
    calmer,
    close_loops,
    current_pi,
    largest_factor,
    loop_advice,
    speed_pi,
    vendor_inductance,
)
from dqforge.optimizer.loops.plants import SpeedLoop
from dqforge.optimizer.loops.robustness import (
    Axis,
    BoxPoints,
    DriveBox,
    LoopRobustness,
    first_fault,
    summarise,
)
from dqforge.optimizer.sampled_systems import SampledSystem

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.names import Firmware
    from dqforge.optimizer.firmware.firmware_method import FreeGains, Shortfall
    from dqforge.optimizer.loops.loop_gains import LoopName


# The loops of a design as the firmware that it names runs them.


@dataclass(frozen=True, slots=True, eq=False)
class FirmwareLoop:
    """One loop in both structures.

    Args:
        loop: ``i_d``, ``i_q`` or ``speed``.
        gains: Of the firmware: V/A and V/(A s), or A s/rad and A/rad.
        judged: As the firmware runs it.
        own: Gains of the emitted header: V/A and V/(A s), or N m s/rad and N m/rad.
        neutral: As that header runs them.
        worst: What it keeps over the corners of ``control.tolerances``, None without them.
    """

    loop: LoopName
    gains: PiGains
    judged: JudgedLoop
    own: PiGains
    neutral: JudgedLoop
    worst: LoopRobustness | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FirmwareLoops:
    """What a firmware makes of a design.

    Args:
        name, version: The firmware and the version of its format.
        free: Which gains of its current loops can be chosen.
        asked: What its configuration was asked to hold, with the gains that were chosen.
        configuration, profile: The configuration, rounded as its file prints it, and the loops that
            it amounts to.
        judged: These loops on the machine, with remarks.
        loops: Those of them that the design has, beside those of the header.
        changes: What was chosen otherwise than the design's own structure has it, one sentence
            each.
        shortfalls: What the configuration cannot hold of what was asked.
    """

    name: Firmware
    version: str
    free: FreeGains
    asked: Asked
    configuration: Configuration
    profile: LoopProfile
    judged: JudgedFirmware
    loops: tuple[FirmwareLoop, ...]
    changes: tuple[str, ...]
    shortfalls: tuple[Shortfall, ...]


def firmware_loops(
    design: Design,
    box: DriveBox,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
    methods: Mapping[Firmware, FirmwareMethod] = METHODS,
) -> FirmwareLoops | None:
    """Choose and judge the gains within the structure of ``control.firmware``; None without one.

    Args:
        design: The design.
        box: The drive with its tolerances.
        own: i_d, i_q and speed as the design's own structure has them: what is wished for.
        methods: The firmwares that are known.

    Raises:
        NoSolutionError: No gains within the structure keep what the design asks for; says what
            would.
        InputError: A value does not fit the firmware; with its key.
    """
    wanted = design.control.firmware
    if wanted is None:
        return None
    method = methods.get(wanted.name)
    if method is None:
        raise InputError(f"control.firmware: '{wanted.name}' is not known here; use another")
    check_drivable(design, [method])
    i_d, i_q, speed = own
    if design.control.tolerances is None:
        box = replace(box, spread=(1.0, 1.0))
    pll = None if wanted.pll is None else PiGains(*wanted.pll)
    asked = replace(asked_of(design, i_d, i_q, speed), pll=pll)
    chosen = CurrentSearch(method, box, asked, design.control.current_loop).solve()
    search = speed_search(method, box, chosen, asked, i_q)
    chosen = chosen if search is None else search.solve()
    return _record(method, box, chosen, asked, own)


def _record(
    method: FirmwareMethod,
    box: DriveBox,
    chosen: Chosen,
    asked: Asked,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
) -> FirmwareLoops:
    profile = chosen.profile
    drive = replace(chosen.asked.drive, l_d=box.nominal[0], l_q=box.nominal[1])
    judged = judge(profile, drive)
    return FirmwareLoops(
        method.name,
        method.version,
        method.free,
        chosen.asked,
        chosen.configuration,
        profile,
        judged,
        _loops(profile, judged, box, own),
        chosen.words,
        method.shortfalls(asked, chosen.configuration),
    )


def _loops(
    profile: LoopProfile,
    judged: JudgedFirmware,
    box: DriveBox,
    own: tuple[LoopGains, LoopGains, LoopGains | None],
) -> tuple[FirmwareLoop, ...]:
    named, found = box.design.control.tolerances is not None, []
    current, speed = profile.current, profile.speed
    controllers, alone = (current.d, current.q), (judged.current_d, judged.current_q)
    for axis, pi, loop, header in zip(AXES, controllers, alone, own[:2], strict=True):
        assert loop is not None
        worst = axis_plants(box, axis, current).kept(pi) if named else None
        found.append(_beside(pi, loop, header, worst))
    if speed is not None and judged.speed is not None and own[2] is not None:
        worst = speed_plants_over(box, current, speed).kept(speed.pi) if named else None
        found.append(_beside(speed.pi, judged.speed, own[2], worst))
    return tuple(found)


def _beside(
    pi: PiController, loop: JudgedLoop, header: LoopGains, worst: LoopRobustness | None
) -> FirmwareLoop:
    """A loop of the firmware beside that of the header."""
    model = header.model
    neutral = judged_loop(model.loop if isinstance(model, SpeedLoop) else model)
    gains, own = PiGains(pi.kp, pi.ki), PiGains(header.kp, header.ki)
    return FirmwareLoop(header.loop, gains, loop, own, neutral, worst)


# Gains of the speed loop and its phase-locked loop within the structure of a firmware.
#
# As `dqforge.optimizer.firmware.gain_search`, with the current loops fixed. The phase-locked loop
# stays as the design gives it, or as the firmware has it where the loop holds with that; else its
# poles are put together, and then kp is raised.

_NO_LOOP: tuple[float, PiGains | None] = (0.0, None)
_WORTH = 1.02  # What a faster phase-locked loop must bring in integral gain to be taken.
_PLL_STEPS = 7
_LARGEST_PLL_STEP = 0.5  # kp of the phase-locked loop times its period: it is slow beside its own


@dataclass(frozen=True, slots=True)
class Chosen:
    """What was asked in the end, what the firmware makes of it, and in words what was changed."""

    asked: Asked
    configuration: Configuration
    profile: LoopProfile
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SpeedSearch:
    """Search for the gains of the speed loop and its phase-locked loop, current loops fixed."""

    method: FirmwareMethod
    box: DriveBox
    current: Chosen
    settings: SpeedLoopSettings
    asked: Asked
    torque_per_ampere: float
    t_sum: float

    @property
    def bounds(self) -> Bounds:
        """What the loop must keep."""
        return bounds_of(self.settings)

    def by(self, trial: SpeedLoopSettings) -> PiGains:
        """Gains per ampere by a formula."""
        machine = self.box.design.machine
        assert machine.inertia is not None
        kp, ki = speed_pi(machine.inertia, machine.friction, self.t_sum, trial)
        return PiGains(kp / self.torque_per_ampere, ki / self.torque_per_ampere)

    def family(self) -> SpeedLoopSettings:
        """Settings with a number that can be lowered."""
        assert self.asked.speed is not None
        if self.settings.method != "optimised":
            return self.settings
        inertia = self.box.design.machine.inertia
        assert inertia is not None
        bandwidth = self.asked.speed.kp * self.torque_per_ampere / inertia
        return replace(self.settings, method="bandwidth", bandwidth=bandwidth)

    def plls(self) -> list[PiGains | None]:
        """Gains of the phase-locked loop that may be tried: as given, or the firmware's own and
        then faster ones with a double pole.
        """
        if self.asked.pll is not None:
            return [self.asked.pll]
        own = self._made(None, self.asked.speed)
        if own is None or own.profile.speed is None or own.profile.speed.feedback.kind != "pll":
            return [None]
        feedback = own.profile.speed.feedback
        rates = [feedback.kp * 2.0 ** (0.5 * step) for step in range(_PLL_STEPS)]
        fast = [kp for kp in rates if kp * feedback.t_s <= _LARGEST_PLL_STEP]
        return [None, *(PiGains(kp, 0.25 * kp * kp) for kp in fast)]

    def _made(self, pll: PiGains | None, speed: PiGains | None) -> Chosen | None:
        return possible(self.method, replace(self.asked, pll=pll, speed=speed))

    def plants(self, chosen: Chosen) -> BoxedPlants:
        """Plants over the box with what a configuration makes of the phase-locked loop."""
        speed = chosen.profile.speed
        assert speed is not None
        return speed_plants_over(self.box, chosen.profile.current, speed)

    def solve(self) -> Chosen:
        """Gains that keep the bounds; raises `NoSolutionError` where there are none."""
        first = configured(self.method, self.asked, *self.current.words)
        if first.profile.speed is None:
            return replace(
                first,
                words=(
                    *first.words,
                    f"{firmware_text(self.method)} has no such speed controller: none is evaluated",
                ),
            )
        fault = self.plants(first).fault(first.profile.speed.pi, self.bounds)
        if fault is None and self.settings.method != "optimised":
            return first
        if self.settings.method == "optimised":
            return self._best(fault)
        for pll in self.plls()[1:]:
            found = self._made(pll, self.asked.speed)
            if found is not None and self._keeps(found):
                return replace(found, words=(*self.current.words, _of_pll(pll, fault)))
        assert fault is not None
        return self._slower(fault)

    def _keeps(self, chosen: Chosen) -> bool:
        speed = chosen.profile.speed
        return speed is not None and self.plants(chosen).fault(speed.pi, self.bounds) is None

    def _slower(self, fault: str) -> Chosen:
        """The fastest loop of the same shape over all phase-locked loops, or a refusal."""
        family, best = self.family(), _NO_LOOP
        for pll in self.plls():
            start = self._made(pll, self.asked.speed)
            factor = None if start is None else self._largest(start, pll, family)
            if factor is not None and factor > best[0]:
                best = (factor, pll)
        factor, pll = best
        if factor > 0.0 and self.settings.method not in NAMED:
            found = self._made(pll, self.by(calmer(family, factor)))
            assert found is not None
            words = [lowered("the speed loop", f"it {fault}", factor, self.method)]
            if pll is not None and pll != self.asked.pll:
                words.append(f"the PLL gets kp {pll.kp:.6g} and ki {pll.ki:.6g}")
            return replace(found, words=(*self.current.words, *words))
        raise NoSolutionError(self._refusal(fault, family, factor))

    def _largest(
        self, start: Chosen, pll: PiGains | None, family: SpeedLoopSettings
    ) -> float | None:
        plants = self.plants(start)

        def holds(share: float) -> bool:
            gains = self.by(calmer(family, share))
            if not min(gains.kp, gains.ki) > 0.0:
                return False
            found = self._made(pll, gains)
            if found is None or found.profile.speed is None:
                return False
            return plants.fault(found.profile.speed.pi, self.bounds) is None

        return largest_factor(holds)

    def _refusal(self, fault: str, family: SpeedLoopSettings, factor: float) -> str:
        advice = (
            loop_advice("control.speed_loop", family, factor)
            if factor > 0.0
            else "no slower gains of this method hold"
        )
        given = self.asked.pll
        with_pll = "" if given is None else f" with a PLL of {given.kp:.6g}/{given.ki:.6g}"
        freed = ""
        if given is not None:
            freed = (
                "leave control.firmware.pll_kp and pll_ki out, or write pll_ki: "
                f"{0.25 * given.kp**2:.6g} (kp^2/4), or slow the loop down: "
            )
        return (
            f"control.speed_loop: as {firmware_text(self.method)} runs it{with_pll}, the speed "
            f"loop by method '{self.settings.method}' {fault}; {freed}{advice}"
        )

    def _best(self, fault: str | None) -> Chosen:
        """Largest integral gain within M_s over all phase-locked loops, after rounding."""
        best: Chosen | None = None
        for pll in self.plls():
            start = self._made(pll, self.asked.speed)
            found = None if start is None else self._optimised(start, pll)
            if found is None:
                continue
            if best is not None and _ki(found) <= _ki(best) * _WORTH:
                break
            best = found
        if best is not None:
            return replace(best, words=self.current.words)
        return self._slower(fault or "keeps its bounds by no gains of this search")

    def _optimised(self, start: Chosen, pll: PiGains | None) -> Chosen | None:
        speed, boxed = start.profile.speed, self.plants(start)
        machine = self.box.design.machine
        assert speed is not None
        assert machine.inertia is not None
        per_ampere = self.torque_per_ampere
        scale = pi_scale(machine.inertia / per_ampere, machine.friction / per_ampere, self.t_sum)
        for share in SHRUNK:
            bound = 1.0 + share * (self.settings.max_sensitivity - 1.0)
            try:
                kp, ki = optimised_pi(boxed.plants, bound, scale, "control.speed_loop")
            except NoSolutionError:
                return None
            gains = PiGains(kp + added_gain(_period(replace(speed.pi, ki=ki), boxed)), ki)
            found = self._made(pll, gains)
            if found is not None and self._keeps(found):
                return found
        return None


def _period(pi: PiController, boxed: BoxedPlants) -> PiController:
    return replace(pi, t_s=boxed.plants.t_s)


def _ki(chosen: Chosen) -> float:
    assert chosen.profile.speed is not None
    return chosen.profile.speed.pi.ki


def _of_pll(pll: PiGains | None, fault: str | None) -> str:
    assert pll is not None
    return (
        f"the PLL gets kp {pll.kp:.6g} and ki {pll.ki:.6g}: with its own gains the speed loop "
        f"{fault}"
    )


def speed_search(
    method: FirmwareMethod,
    box: DriveBox,
    current: Chosen,
    asked: Asked,
    i_q: LoopGains,
) -> SpeedSearch | None:
    """The search for a design's speed loop; None where it asks for none, or has no magnets.

    Args:
        method: The firmware.
        box: The drive with its tolerances.
        current: What was chosen for the current loops.
        asked: What the design asks for, the speed loop included.
        i_q: The q axis as the design's own structure has it.
    """
    control, machine = box.design.control, box.design.machine
    if control.speed_loop is None or asked.speed is None:
        return None
    return SpeedSearch(
        method,
        box,
        current,
        control.speed_loop,
        replace(asked, current_d=current.asked.current_d, current_q=current.asked.current_q),
        machine.torque_per_ampere,
        speed_delay(i_q, control.t_s, control.speed_loop),
    )


# Gains of the current loops within the structure of a firmware: what the design asks for where
# that holds, else the fastest that does.
#
# Every candidate goes through the firmware's own `configure`, so that what is judged are the
# numbers that its file holds, and its own loops over the corners of the tolerances. Deterministic.
#
# Gains by a formula with a number that the design names (a bandwidth, given gains) are judged as
# they are, and refused with what would hold. Of a formula without such a number the structure may
# take slower gains of the same shape; the method ``optimised`` looks for the largest integral gain
# within the bound of M_s in this structure.


@dataclass(frozen=True, slots=True)
class CurrentSearch:
    """Search for the gains of both current loops of a drive within one structure."""

    method: FirmwareMethod
    box: DriveBox
    asked: Asked
    settings: CurrentLoopSettings

    @property
    def bounds(self) -> Bounds:
        """What the loops must keep."""
        return bounds_of(self.settings)

    def with_gains(self, d: tuple[float, float], q: tuple[float, float]) -> Asked:
        """What is asked with other current gains, and without a speed loop."""
        return replace(self.asked, current_d=PiGains(*d), current_q=PiGains(*q), speed=None)

    def by(self, trial: CurrentLoopSettings) -> Asked:
        """What is asked by a formula for both axes."""
        design = self.box.design
        d, q = (
            current_pi(
                design.machine.r_s,
                vendor_inductance(trial.method, self.box.nominal, place),
                design.control.t_s,
                trial,
            )
            for place in (0, 1)
        )
        return self.with_gains(d, q)

    def fault(self, chosen: Chosen) -> str | None:
        """What one of both loops does not keep, in words."""
        loops = chosen.profile.current
        for axis, pi in zip(AXES, (loops.d, loops.q), strict=True):
            found = axis_plants(self.box, axis, loops).fault(pi, self.bounds)
            if found is not None:
                return f"the {axis} loop {found}"
        return self._turning_fault(loops)

    def _turning_fault(self, loops: CurrentLoops) -> str | None:
        """That both loops together are unstable at a speed that the machine reaches, in words."""
        machine = self.box.design.machine
        if machine.omega_m_max is None:
            return None
        found = turning_axes(
            machine.r_s, self.box.nominal, loops, machine.pole_pairs, machine.omega_m_max
        )
        if found.unstable_from is None:
            return None
        return (
            "both current loops together are unstable from about "
            f"{in_rpm(found.unstable_from):.4g} rpm (largest pole modulus "
            f"{found.radius:.4g})"
        )

    def holds(self, asked: Asked) -> bool:
        """Whether gains can be held and keep the bounds."""
        if not min(asked.current_d.kp, asked.current_d.ki, asked.current_q.kp) > 0.0:
            return False
        chosen = possible(self.method, asked)
        return chosen is not None and self.fault(chosen) is None

    def family(self) -> CurrentLoopSettings:
        """Settings with a number that can be lowered."""
        settings = self.settings
        if settings.method in ("magnitude-optimum", "optimised"):
            bandwidth = self.asked.current_q.kp / self.box.nominal[1]
            return replace(settings, method="bandwidth", bandwidth=bandwidth)
        return settings

    def solve(self) -> Chosen:
        """Gains that keep the bounds; raises `NoSolutionError` where there are none."""
        first = configured(self.method, replace(self.asked, speed=None))
        if self.settings.method == "optimised":
            found = self._optimised(first)
            if found is not None:
                return found
        fault = self.fault(first)
        if fault is None:
            return first
        family = self.family()
        factor = largest_factor(lambda share: self.holds(self.by(calmer(family, share))))
        advice = "no slower gains of this method hold" if factor is None else ""
        if factor is not None and self.settings.method not in NAMED:
            slower = self.by(calmer(family, factor))
            return configured(
                self.method, slower, lowered("the current loops", fault, factor, self.method)
            )
        advice = advice or loop_advice("control.current_loop", family, factor or 1.0)
        raise NoSolutionError(
            f"control.current_loop: as {firmware_text(self.method)} runs it, by method "
            f"'{self.settings.method}' {fault}; {advice}"
        )

    def _optimised(self, first: Chosen) -> Chosen | None:
        """Largest integral gain within M_s in the firmware's structure, after rounding."""
        for share in SHRUNK:
            bound = 1.0 + share * (self.settings.max_sensitivity - 1.0)
            asked = self._free(first.profile, bound)
            if asked is not None and self.holds(asked):
                return configured(self.method, asked)
        return None

    def _free(self, profile: LoopProfile, bound: float) -> Asked | None:
        loops, r_s = profile.current, self.box.design.machine.r_s
        if self.method.free == "bandwidth":
            tight = replace(self, settings=replace(self.settings, max_sensitivity=bound))
            start = replace(self.family(), bandwidth=1.0 / ((loops.delay + 0.5) * loops.q.t_s))
            factor = largest_factor(lambda share: tight.holds(self.by(calmer(start, share))))
            return None if factor is None else self.by(calmer(start, factor))
        both = [axis_plants(self.box, axis, loops).plants for axis in AXES]
        sets = [_together(both)] * 2 if self.method.free == "one-pair" else both
        found = []
        for plants, inductance, pi in zip(sets, self.box.nominal, (loops.d, loops.q), strict=True):
            scale = pi_scale(inductance, r_s, (loops.delay + 0.5) * pi.t_s)
            kp, ki = optimised_pi(plants, bound, scale, "control.current_loop")
            found.append((kp + added_gain(replace(pi, ki=ki)), ki))
        return self.with_gains(found[0], found[1])


def _together(batches: list[PlantBatch]) -> PlantBatch:
    """Plants of both axes as one set."""
    return replace(
        batches[0],
        a=np.concatenate([batch.a for batch in batches]),
        b=np.concatenate([batch.b for batch in batches]),
    )


# The loops of a firmware over the box of drives that the tolerances allow: its corners, and the
# data themselves.

AXES: tuple[Axis, Axis] = ("i_d", "i_q")


_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a loop must keep: phase margin in rad, and largest M_s (inf where none is asked)."""

    phase_margin: float
    max_sensitivity: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class BoxedPlants:
    """Plants of one loop at M points of the box."""

    plants: PlantBatch
    points: BoxPoints

    def margins(self, pi: PiController) -> BatchMargins:
        """Margins with a controller, at every point."""
        return batch_margins(close_loops(self.plants, *equivalent_gains(pi)))

    def fault(self, pi: PiController, bounds: Bounds) -> str | None:
        """What the worst point does not keep, in words; None where all keep all."""
        loops = close_loops(self.plants, *equivalent_gains(pi))
        stable = bool(np.max(loops.radius) < 1.0)
        margins = batch_margins(loops) if stable else _radii_only(loops.radius)
        found = first_fault(margins, self.points, bounds.phase_margin)
        if found is not None:
            text = f"{found}, required: {math.degrees(bounds.phase_margin):.1f} deg"
            return text if self.points.names else text.replace(f" at {self.points.text(0)}", "")
        row = int(np.argmax(margins.max_sensitivity))
        worst = float(margins.max_sensitivity[row])
        if worst <= bounds.max_sensitivity * (1.0 + _ROUNDING):
            return None
        where = f" at {self.points.text(row)}" if self.points.names else ""
        return f"has M_s = {worst:.4g}{where}, required is {bounds.max_sensitivity:.4g}"

    def kept(self, pi: PiController) -> LoopRobustness:
        """The worst margins over the points."""
        return summarise(self.margins(pi), self.points)


def _radii_only(radius: FloatArray) -> BatchMargins:
    silent = np.full(len(radius), np.nan)
    return BatchMargins(radius, silent, silent, silent, silent, silent)


def _corners(points: BoxPoints) -> BoxPoints:
    """The corners, and last the data themselves."""
    rows = np.append(np.arange(points.corners), len(points.deviations) - 1)
    return replace(points, deviations=points.deviations[rows], loaded=points.loaded[rows])


def _batch(systems: list[SampledSystem]) -> PlantBatch:
    return PlantBatch(
        np.stack([system.a for system in systems]),
        np.stack([system.b[:, 0] for system in systems]),
        int(np.argmax(systems[0].c[0])),
        systems[0].t_s,
    )


def axis_plants(box: DriveBox, axis: Axis, loops: CurrentLoops) -> BoxedPlants:
    """Plants of one current loop over the box.

    Args:
        box: The drive with its tolerances.
        axis: Which axis.
        loops: The structure: period, filter and delay.
    """
    place, name = (0, "l_d") if axis == "i_d" else (1, "l_q")
    pi = loops.d if axis == "i_d" else loops.q
    points = _corners(box.current_points(axis))
    rows = zip(
        box.resistance(points),
        box.nominal[place] * (1.0 + points.of(name)),
        1.0 + points.of("v_dc"),
        strict=True,
    )
    systems = [
        current_plant(Winding(float(r_s), float(inductance), float(gain)), pi, loops.delay)
        for r_s, inductance, gain in rows
    ]
    return BoxedPlants(_batch(systems), points)


def speed_plants_over(box: DriveBox, loops: CurrentLoops, speed: SpeedController) -> BoxedPlants:
    """Plants of the speed loop over the box, from q current to the speed that is controlled.

    Args:
        box: The drive with its tolerances; its machine has magnets and an inertia.
        loops, speed: The structure with its current gains.
    """
    machine, points = box.design.machine, _corners(box.speed_points())
    assert machine.inertia is not None
    constant = machine.pole_pairs * machine.psi_pm
    left = points.of("psi_pm") if loops.back_emf else 1.0 + points.of("psi_pm")
    inertia = machine.inertia * (1.0 + points.of("inertia"))
    torque = 1.5 * constant * box.torque_factor(points)
    inductance = box.nominal[1] * (1.0 + points.of("l_q"))
    resistance, gain = box.resistance(points), 1.0 + points.of("v_dc")
    systems = [
        speed_plant(
            Winding(float(resistance[row]), float(inductance[row]), float(gain[row])),
            Mechanics(
                float(inertia[row]),
                machine.friction,
                float(torque[row]),
                float(constant * left[row]),
            ),
            loops,
            speed,
        )
        for row in range(len(points.deviations))
    ]
    return BoxedPlants(_batch(systems), points)


# What was chosen for a firmware: asked, configured and in words; what both searches share.

# Shares of M_s - 1 that are tried until the rounded gains keep the bound.
SHRUNK = (1.0, 0.999, 0.99, 0.95, 0.9, 0.8, 0.6)

# Methods whose numbers the design names.
NAMED = ("bandwidth", "damping", "given", *get_args(VendorMethod))


def configured(method: FirmwareMethod, asked: Asked, *words: str) -> Chosen:
    """What a firmware makes of what is asked; raises as its ``configure``.

    Args:
        method: The firmware.
        asked: What its configuration is to hold.
        words: What was changed of what the design asks for.
    """
    configuration = method.configure(asked)
    return Chosen(asked, configuration, method.profile(configuration), words)


def possible(method: FirmwareMethod, asked: Asked) -> Chosen | None:
    """The same, None where the format cannot hold it.

    Args:
        method: The firmware.
        asked: What its configuration is to hold.
    """
    try:
        return configured(method, asked)
    except InputError:
        return None


def bounds_of(settings: Settings) -> Bounds:
    """What a loop must keep; M_s only by the method ``optimised``.

    Args:
        settings: Method and settings of the loop.
    """
    if settings.method == "optimised":
        return Bounds(settings.min_phase_margin, settings.max_sensitivity)
    return Bounds(settings.min_phase_margin)


def firmware_text(method: FirmwareMethod) -> str:
    """The firmware with its version.

    Args:
        method: The firmware.
    """
    return f"{method.name} {method.version}".strip()


def lowered(what: str, fault: str, factor: float, method: FirmwareMethod) -> str:
    """That a loop is slowed down, and why.

    Args:
        what: The loop, in words.
        fault: What it does not keep with what the design asks for.
        factor: Of its bandwidth.
        method: The firmware.
    """
    return (
        f"slowed down: {what}, to {factor:.3g} times what the method gives; with that, as "
        f"{firmware_text(method)} runs it, {fault}"
    )
