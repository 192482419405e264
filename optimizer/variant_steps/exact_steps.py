"""The steps of a row, one design at a time: what ``dqforge run`` computes of it, without proofs,
alternatives and choices.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import located
from dqforge.machines.design.settings import FitSettings, LossSettings, WaveformSettings
from dqforge.machines.errors import DqforgeError, NoSolutionError
from dqforge.machines.losses.machine_budget import NO_EXTRA_LOSS
from dqforge.optimizer.control_design.gain_set import gains_or_reason, solve_current_loops
from dqforge.optimizer.current_reference.fit import signed_designs
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.losses.phase_comparison import LossComparison, compare_points
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.solve import current_choice
from dqforge.optimizer.variant_steps.outputs import (
    FIT_ERRORS,
    LOOP_QUANTITIES,
    LossDrive,
    LossGrid,
    LossTable,
    Step,
    drive_table,
    loss_drive,
)
from dqforge.optimizer.variant_steps.variation import StepCache, Work, key_of, used_settings

Numbers = Mapping[str, float]  # Values by name of the output, in SI units.


@dataclass(slots=True)
class ExactSteps:
    """Steps of designs, each computed once for equal inputs; ``work`` counts them."""

    grid: LossGrid = field(default_factory=LossGrid)
    work: Work = field(default_factory=Work)
    _limits: StepCache[Numbers] = field(default_factory=StepCache)
    _fits: StepCache[Numbers] = field(default_factory=StepCache)
    _currents: StepCache[Numbers] = field(default_factory=StepCache)
    _loops: StepCache[Numbers] = field(default_factory=StepCache)
    _losses: StepCache[LossComparison] = field(default_factory=StepCache)
    _tables: StepCache[LossTable | None] = field(default_factory=StepCache)

    def key(self, step: Step, design: Design) -> Hashable:
        """What a step of a design depends on, the same for all designs that share it.

        Args:
            step: The step.
            design: The design.
        """
        positive = _positive(design)
        if step == "limit":
            return key_of(current_choice(positive))
        if step == "fit":
            return key_of((current_choice(positive), used_settings(positive.fit)))
        if step == "current-loops" and _has_plain_currents(design):
            plain = _for_current_loops(design)
            return key_of((plain.machine, plain.control, plain.i_max))
        if step == "losses":
            return key_of((loss_drive(design), design.losses))
        return key_of(_for_gains(design))

    def limit(self, design: Design) -> Numbers:
        """Largest torque and its currents.

        Raises:
            DqforgeError: As `CurrentChoice.largest_torque`.
        """
        with located(design.places, "operation"):
            choice = current_choice(_positive(design))
            return self._limits.of(self.key("limit", design), lambda: self._limit(choice))

    def _limit(self, choice: CurrentChoice) -> Numbers:
        self.work.limits += 1
        with located(None, "operation"):
            return _largest(choice)

    def fit(self, design: Design) -> Numbers:
        """Errors of the current reference.

        Raises:
            DqforgeError: As `solve_fit`.
        """
        plain = _positive(design)
        with located(design.places, "fit"):
            return self._fits.of(self.key("fit", design), lambda: self._fit(plain))

    def _fit(self, plain: Design) -> Numbers:
        self.work.fits += 1
        errors = solve_fit(plain).fit.errors
        return {f"fit.error.{name}": float(getattr(errors, name)) for name in FIT_ERRORS}

    def current_loops(self, design: Design) -> Numbers:
        """Gains and margins of both current loops.

        Raises:
            DqforgeError: As `solve_gains`, which is asked where the design names tolerances.
        """
        if not _has_plain_currents(design):
            return self.all_loops(design)
        plain, key = _for_current_loops(design), self.key("current-loops", design)
        with located(design.places, "control"):
            return self._currents.of(key, lambda: self._current_loops(plain))

    def _current_loops(self, plain: Design) -> Numbers:
        self.work.gain_sets += 1
        try:
            return _loop_numbers(solve_current_loops(plain))
        except NoSolutionError as error:
            if plain.control.gains == "required":
                raise
            raise _left_out(error) from None

    def all_loops(self, design: Design) -> Numbers:
        """Gains and margins of every loop.

        Raises:
            DqforgeError: As `solve_gains`.
        """
        plain = _for_gains(design)
        with located(design.places, "control"):
            key = self.key("speed-loop", design)
            return self._loops.of(key, lambda: self._all_loops(plain))

    def _all_loops(self, plain: Design) -> Numbers:
        self.work.gain_sets += 1
        gains, reason = gains_or_reason(plain, proofs=False)
        if gains is None:
            raise _left_out(NoSolutionError(reason))
        loops = [gains.i_d, gains.i_q] + ([] if gains.speed is None else [gains.speed])
        return _loop_numbers(loops)

    def losses(self, design: Design) -> LossComparison:
        """Losses at the points of the design, which names some.

        Raises:
            DqforgeError: As `compare_points`.
        """
        drive = loss_drive(design)
        with located(design.places, "losses"):
            key = self.key("losses", design)
            return self._losses.of(key, lambda: self._points(drive, design))

    def _points(self, drive: LossDrive, design: Design) -> LossComparison:
        self.work.budget_calls += 1
        assert design.losses is not None
        with located(None, "losses"):
            return compare_points(
                drive.machine,
                drive.inverter,
                design.losses,
                i_max=drive.i_max,
                options=drive.options,
                margin=drive.margin,
                phases=drive.phases,
            )

    def loss_table(self, design: Design) -> LossTable | None:
        """Losses at the points of the design with every modulator and frequency of the study,
        arrays (S, M, F, P) in the order of ``grid``; None where the design is none of them, or one
        of its alternatives is refused.
        """
        losses = design.losses
        if losses is None or not self.grid.holds(design):
            return None
        drive = loss_drive(design, f_sw=self.grid.frequencies[0])
        asked = (losses.points, losses.strategies)
        return self._tables.of(key_of((drive, asked)), lambda: self._table(drive, losses))

    def _table(self, drive: LossDrive, losses: LossSettings) -> LossTable | None:
        self.work.budget_calls += 1
        try:
            with located(None, "losses"):
                return drive_table(drive, losses, self.grid)
        except DqforgeError:  # each row then says for itself what is wrong with it
            return None


def _largest(choice: CurrentChoice) -> Numbers:
    most = choice.largest_torque()
    i_d, i_q = choice.currents(np.array([most]))
    return {
        "reference.torque_max": most,
        "reference.i_d": float(i_d[0]),
        "reference.i_q": float(i_q[0]),
    }


def _loop_numbers(loops: Sequence[LoopGains]) -> Numbers:
    found = {
        f"gains.{loop.loop}.{name}": float(getattr(loop, name))
        for loop in loops
        for name in LOOP_QUANTITIES
    }
    return found | {"gains.phase_margin": min(loop.phase_margin for loop in loops)}


class GainsLeftOutError(NoSolutionError):
    """A design that can do without gains has none: no loop was asked for and none was found."""


def _left_out(error: NoSolutionError) -> GainsLeftOutError:
    words = error.message.removeprefix("no loop was asked for and none was found: ")
    return GainsLeftOutError(f"no loop was asked for and none was found: {words}")


def _bare(design: Design) -> Design:
    """A design without what no step looks at."""
    return replace(
        design,
        name="",
        about="",
        waveform=WaveformSettings(),
        values=(),
        assumptions=(),
        digest="",
        weakening=None,
        modulation_choice=None,
        given=None,
        flux_evidence=(),
        places=None,
    )


def _positive(design: Design) -> Design:
    """The design as torques of the positive sign see it, without places."""
    return signed_designs(replace(design, places=None))[0]


def _has_plain_currents(design: Design) -> bool:
    """Whether the current loops hold or fail by themselves: no tolerances, no zero sequence."""
    return design.control.tolerances is None and design.phase_machine is None


def _for_current_loops(design: Design) -> Design:
    control = replace(design.control, speed_loop=None, observer=None)
    return replace(design, control=control, places=None)


def _for_gains(design: Design) -> Design:
    """Without devices and losses, and without the carrier and the link where no loop knows them."""
    inverter = replace(
        design.inverter,
        device=None,
        device_model=None,
        coolant_temperature=0.0,
        capacitor_esr=0.0,
    )
    if not _knows_the_bridge(design):
        inverter = replace(inverter, f_sw=1.0, dead_time=0.0)
    bare = _bare(design)
    return replace(
        bare,
        inverter=inverter,
        machine_loss=NO_EXTRA_LOSS,
        fit=FitSettings(),
        losses=None,
        winding=None,
    )


def _knows_the_bridge(design: Design) -> bool:
    """Whether gains depend on carrier frequency and dead time: all but the plainest do."""
    control = design.control
    observer = control.observer
    return (
        design.phase_machine is not None
        or control.tolerances is not None
        or control.start_up is not None
        or control.firmware is not None
        or (observer is not None and observer.pole is None)
    )
