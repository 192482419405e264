"""What to flash: the question of a design, with everything that this computer can find out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.optimizer.flashing_choice import (
    Advice,
    FlashComparison,
    advise,
    compare_flashing,
    variant,
    with_rows,
)
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.flashing_choice.counted_cycles import counted_rows
from dqforge.reports.flashing_choice.simulated_rows import simulated_rows

Progress = Callable[[float], None]


@on_design("waveform")
def what_to_flash(
    design: Design, settings: WaveformSettings, progress: Progress | None = None
) -> tuple[FlashComparison, Advice]:
    """The comparison with the ripple of the emitted C and its cycles, and what follows from it.

    What cannot be had here, for want of a compiler or because a control cannot be emitted, is left
    out, and the comparison says why.

    Args:
        design: The design.
        settings: The operating point.
        progress: Called with the share of the simulation that is done.

    Raises:
        InputError, NoSolutionError: As `compare_flashing`.
    """
    found = compare_flashing(design, settings)
    try:
        solution = _references(design, settings, found)
    except (NoSolutionError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message, uncounted=error.message)
        return found, advise(found)
    try:
        found = with_rows(found, simulated_rows(solution, found, progress), unsimulated="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, unsimulated=error.message)
    try:
        found = with_rows(found, counted_rows(solution, found), uncounted="")
    except (VerificationError, InputError) as error:
        found = with_rows(found, found.rows, uncounted=error.message)
    return found, advise(found)


def _references(design: Design, settings: WaveformSettings, found: FlashComparison) -> Solution:
    """The solution that the emitted control takes its current references from, on the design's own
    topology and without what else the design asks for.
    """
    plain = variant(design, design.inverter.topology, "dq", found.capacitance)
    return solve(
        replace(
            plain,
            waveform=settings,
            losses=None,
            simulation=None,
            modulation_choice=None,
            weakening=None,
        )
    )
