"""Gains of the speed loop and its phase-locked loop within the structure of a firmware.

As `dqforge.optimizer.firmware.gain_search.current_gains`, with the current loops fixed. The
phase-locked loop stays as the design gives it, or as the firmware has it where the loop holds with
that; else its poles are put together, and then kp is raised.
"""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import PiGains
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod
from dqforge.optimizer.firmware.gain_search.chosen import (
    NAMED,
    SHRUNK,
    Chosen,
    bounds_of,
    configured,
    firmware_text,
    lowered,
    possible,
)
from dqforge.optimizer.firmware.gain_search.structure_box import (
    Bounds,
    BoxedPlants,
    speed_plants_over,
)
from dqforge.optimizer.firmware.profile import PiController
from dqforge.optimizer.firmware.sampled_structure import added_gain
from dqforge.optimizer.loops.gains import speed_delay
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import calmer, largest_factor, loop_advice, speed_pi
from dqforge.optimizer.loops.tolerance_box import DriveBox

_NO_LOOP: tuple[float, PiGains | None] = (0.0, None)
_WORTH = 1.02  # What a faster phase-locked loop must bring in integral gain to be taken.
_PLL_STEPS = 7
_LARGEST_PLL_STEP = 0.5  # kp of the phase-locked loop times its period: it is slow beside its own


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
                    f"{firmware_text(self.method)} has no such speed controller: none is judged",
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
        1.5 * machine.pole_pairs * machine.psi_pm,
        speed_delay(i_q, control.t_s, control.speed_loop),
    )
