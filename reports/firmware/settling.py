"""Whether the loops of a firmware settle on a machine, tried in the time domain."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.reports.firmware.loop_run import (
    firmware_drive,
    firmware_simulator,
    simulate_profile,
)
from dqforge.reports.firmware.standard_steps import StandardStep, standard_steps
from dqforge.reports.firmware.step_answer import StepAnswer, step_answer

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.machines.names import Firmware
    from dqforge.optimizer.firmware.configuration import DriveValues
    from dqforge.optimizer.firmware.profile import LoopProfile
    from dqforge.reports.simulation.compiled_plant import Simulator
    from dqforge.reports.simulation.recorded_run import Simulation

_MOST_ROWS = 40_000


_UNITS = {"current": "A", "torque": "N m", "speed": "rad/s"}


@dataclass(frozen=True, slots=True)
class TriedStep:
    """One step and what became of it; ``quantity`` is what answered, ``unit`` its unit."""

    name: str
    quantity: str
    unit: str
    before: float
    after: float
    answer: StepAnswer

    @property
    def settles(self) -> bool:
        """Whether it does."""
        return self.answer.outcome == "settles"

    @property
    def words(self) -> str:
        """What happened, in one clause with its numbers."""
        step = f"{self.name} from {self._text(self.before)} to {self._text(self.after)}"
        found = self.answer
        if found.outcome == "settles":
            return f"{step}: settles within {format_quantity(found.settling, 's', 3)}"
        ends = f"{self._text(found.lowest)} and {self._text(found.highest)}"
        text = {
            "limit cycle": f"limit cycle of {self.quantity} between {ends}, every "
            f"{format_quantity(found.period, 's', 3)}",
            "divergence": f"{self.quantity} leaves all bounds",
            "steady error": f"{self.quantity} stays at {self._text(found.mean)}",
            "never reaches": f"{self.quantity} still moves between {ends} at the end",
        }[found.outcome]
        return f"{step}: {text}"

    def _text(self, value: float) -> str:
        return f"{value:.4g} {self.unit}"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the standard steps showed of one configuration.

    ``tried`` are the steps, ``left_out`` sentences on those that could not be tried.
    """

    firmware: Firmware
    tried: tuple[TriedStep, ...]
    left_out: tuple[str, ...] = ()

    @property
    def settles(self) -> bool:
        """Whether every step does."""
        return all(step.settles for step in self.tried)

    @property
    def failures(self) -> tuple[str, ...]:
        """What did not settle, a clause each."""
        return tuple(step.words for step in self.tried if not step.settles)

    @property
    def reason(self) -> str:
        """Why the configuration does not settle, empty where it does."""
        return "; ".join(self.failures[:2])


def settles(
    profile: LoopProfile,
    design: Design,
    values: DriveValues,
    *,
    program: Simulator | None = None,
) -> Verdict:
    """Put the loops of a firmware through the standard steps on a design's machine.

    Steps of half of the current limit, at rest and at half of the base speed, and of its torque;
    small and large steps of the speed. The inverter is averaged and without dead time, sensors are
    exact, the shaft carries no load.

    Args:
        profile: The loops of a configuration.
        design: Machine and inverter that they drive.
        values: What the firmware is told, such as `Configuration.drive`.
        program: That of `firmware_simulator`, where it is there already.

    Raises:
        InputError: As `dqforge.reports.firmware.loop_run.simulate_profile`.
        VerificationError: There is no C compiler.
    """
    i_max = min(design.i_max, values.i_max or design.i_max)
    told = replace(values, i_max=i_max, pole_pairs=values.pole_pairs or design.machine.pole_pairs)
    steps, left_out = standard_steps(profile, told, design.machine, i_max, design.inverter.v_dc)
    drive = firmware_drive(profile, design)
    tried: list[TriedStep] = []
    opened = firmware_simulator(profile, told) if program is None else nullcontext(program)
    with opened as made:
        for step in steps:
            stride = 1 + int(step.scenario.duration / drive.t_s) // _MOST_ROWS
            run = simulate_profile(profile, told, drive, step.scenario, stride=stride, program=made)
            tried.append(_tried(step, run, design.machine))
    return Verdict(profile.firmware, tuple(tried), left_out)


def _tried(step: StandardStep, run: Simulation, machine: Machine) -> TriedStep:
    """The worst answer of a step."""
    after = np.flatnonzero(run.t >= step.time - 1e-12)
    answers = [
        TriedStep(
            step.name,
            quantity,
            _UNITS[step.scenario.mode],
            step.before,
            step.after,
            step_answer(
                run.t[after],
                value[after],
                before,
                wanted,
                span=span,
                bounded=bool(run.figures.bounded[0]),
            ),
        )
        for quantity, value, before, wanted, span in _answers(step, run, machine)
    ]
    return next((answer for answer in answers if not answer.settles), answers[0])


def _answers(
    step: StandardStep, run: Simulation, machine: Machine
) -> Sequence[tuple[str, FloatArray, float, float, float]]:
    """What is to follow: its name, its values, its references before and after, and the span."""
    span = abs(step.after - step.before)
    if step.scenario.mode == "speed":
        return [("the speed", run.omega_m, step.before, step.after, span)]
    if step.scenario.mode == "current":
        return [
            ("i_q", run.i_q, step.before, step.after, span),
            ("i_d", run.i_d, 0.0, 0.0, span),
        ]
    # The firmware's constant makes currents of the torque: what those make is to be reached.
    torque = float(machine.torque(run.i_d_reference[-1:], run.i_q_reference[-1:])[0])
    return [("the torque", run.torque, 0.0, torque, abs(torque))]
