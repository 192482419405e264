"""Gains of the control loops and their schedule, as records."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import (
    Capability,
    Draw,
    Flashed,
    Outcome,
    Quantity,
    ReportPart,
    Rows,
    Tile,
)
from dqforge.reports.loops.firmware_text import firmware_name, firmware_words
from dqforge.reports.loops.header import (
    evaluator_from,
    gains_files,
    gains_programme,
    plain_evaluator,
)
from dqforge.reports.loops.html import (
    LOOP_TEXT,
    firmware_tables,
    judged_tables,
    loop_table,
    tolerance_tables,
)
from dqforge.reports.loops.judged_text import judged_sentence, judged_words
from dqforge.reports.loops.plain import plain_gains
from dqforge.reports.loops.robustness_text import worst_words
from dqforge.reports.loops.stability_text import CERTIFICATE, certificate_bytes, proof_summary
from dqforge.reports.loops.tables import gains_tables
from dqforge.reports.observers.speed_loop_text import corner_words, left_words, loop_words
from dqforge.reports.pages.chapters import LOOPS as CHAPTER
from dqforge.reports.pages.html_text import degrees, symbols

if TYPE_CHECKING:
    from dqforge.optimizer.box_proofs.current_loop_proof import CurrentLoopProof
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.schedule.gain_schedule import GainSchedule
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData


def _summary(_: Solution, gains: GainSet) -> Rows:
    rows = [("speed loop at all corners", words) for words in corner_words(gains.speed)]
    if gains.phases is not None and gains.phases.judged is not None:
        rows.append(("currents together", judged_words(gains.phases.judged)))
    if gains.firmware is not None:
        rows.append((f"as {gains.firmware.name} runs them", firmware_words(gains.firmware)))
    return rows


def _flashed(_: Solution, gains: GainSet) -> list[Flashed]:
    return [
        Flashed(
            f"{loop.loop} loop",
            ", ".join(
                f"{name} {value:.5g} {unit}"
                for name, value, unit in zip(
                    ("kp", "ki"), (loop.kp, loop.ki), _GAIN_UNITS[loop.loop], strict=True
                )
            ),
            loop_words(loop),
        )
        for loop in gains.loops
    ]


def _watched(_: Solution, gains: GainSet) -> list[str]:
    """Loops that swing, and what the observer leaves of the speed loop."""
    texts = [f"the {loop.loop} loop is unstable" for loop in gains.loops if not loop.stable]
    speed = gains.speed
    if speed is not None and speed.observed is not None and not speed.observed.holds:
        texts.append(left_words(speed))
    return texts if gains.robust is None else [*texts, worst_words(gains.robust)]


def _margin(loop: LoopGains) -> str:
    """Phase margin, or that the loop has none."""
    return degrees(loop.phase_margin) if loop.stable else "unstable"


def _sentences(_: Solution, gains: GainSet) -> list[str]:
    margins = ", ".join(f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in gains.loops)
    sentences = [f"The phase margins of the sampled loops are {margins}."]
    speed = gains.speed
    if speed is not None and speed.observed is not None:
        sentences.append(
            f"The speed loop is judged with the lag of its observer; {left_words(speed)}."
        )
    if gains.phases is not None and gains.phases.judged is not None:
        sentences.append(judged_sentence(gains.phases.judged))
    if gains.firmware is not None:
        margins = firmware_words(gains.firmware)
        sentences.append(f"As {firmware_name(gains.firmware)} runs them they are {margins}.")
    return sentences


def _tiles(_: Solution, gains: GainSet) -> list[Tile]:
    loops = gains.loops
    worst = min(loops, key=lambda loop: (loop.stable, abs(loop.phase_margin)))
    others = [f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in loops if loop is not worst]
    detail = symbols(f"{LOOP_TEXT[worst.loop]} loop; {', '.join(others)}")
    return [Tile("Smallest phase margin", _margin(worst), detail)]


def _figures(_: Solution, gains: GainSet) -> Mapping[str, Draw]:
    from dqforge.reports.loops.figures import plot_gains

    return {"loops": lambda: plot_gains(gains)}


def _plain(solution: Solution, gains: GainSet) -> PlainData:
    return plain_gains(solution.design, gains, solution.observer_errors)


def _parts(solution: Solution, gains: GainSet) -> list[ReportPart]:
    pole_pairs = solution.design.machine.pole_pairs
    tables = [
        loop_table(gains),
        *firmware_tables(gains),
        *judged_tables(gains),
        *tolerance_tables(gains, pole_pairs),
    ]
    key = f"smallest phase margin {_tiles(solution, gains)[0].value}"
    return [ReportPart(CHAPTER, "loops/report.html.j2", {"tables": tables}, key)]


def _hertz(omega: float) -> float:
    return omega / (2.0 * math.pi)


_GAIN_UNITS = {
    "i_d": ("V/A", "V/(A s)"),
    "i_q": ("V/A", "V/(A s)"),
    "i_0": ("V/A", "V/(A s)"),
    "speed": ("N m s/rad", "N m/rad"),
}

_OBSERVER = (
    ("A", "a", ""),
    ("B_U", "b_u", "rad/(s V)"),
    ("B_I", "b_i", "rad/(s A)"),
    ("C", "c", "rad/(s A)"),
)


def _loop_quantities(loop: str, kp: str, ki: str) -> tuple[Quantity, ...]:
    section, path = f"{loop} loop", ("gains", loop)
    return (
        Quantity(section, "method", "", (*path, "method")),
        Quantity(section, "kp", kp, (*path, "kp")),
        Quantity(section, "ki", ki, (*path, "ki")),
        Quantity(section, "sampled every", "s", (*path, "t_s")),
        Quantity(section, "bandwidth (crossover)", "Hz", (*path, "crossover_rad_per_s"), _hertz),
        Quantity(section, "phase margin", "deg", (*path, "phase_margin_rad")),
        Quantity(section, "gain margin (factor)", "", (*path, "gain_margin")),
        Quantity(section, "delay margin", "s", (*path, "delay_margin_s")),
        Quantity(section, "M_s", "", (*path, "max_sensitivity")),
    )


def _firmware_quantities(loop: str, kp: str, ki: str) -> tuple[Quantity, ...]:
    section, path = f"{loop} loop as its firmware runs it", ("gains", "firmware", loop)
    return (
        Quantity(section, "kp", kp, (*path, "kp")),
        Quantity(section, "ki", ki, (*path, "ki")),
        Quantity(section, "bandwidth (crossover)", "Hz", (*path, "crossover_rad_per_s"), _hertz),
        Quantity(section, "phase margin", "deg", (*path, "phase_margin_rad")),
        Quantity(section, "gain margin (factor)", "", (*path, "gain_margin")),
        Quantity(section, "M_s", "", (*path, "max_sensitivity")),
        Quantity(section, "damping", "", (*path, "damping")),
    )


_FIRMWARE_UNITS = {
    "i_d": ("V/A", "V/(A s)"),
    "i_q": ("V/A", "V/(A s)"),
    "speed": ("A s/rad", "A/rad"),
}

LOOPS = Capability(
    name="gains",
    title="control loops",
    of=lambda outcome: outcome.solution.loops,
    plain=_plain,
    flashed=_flashed,
    watched=_watched,
    summary=_summary,
    tables=lambda solution, gains: gains_tables(solution.design, gains),
    sentences=_sentences,
    tiles=_tiles,
    figures=_figures,
    parts=_parts,
    quantities=(
        *(row for loop, units in _GAIN_UNITS.items() for row in _loop_quantities(loop, *units)),
        *(
            row
            for loop, units in _FIRMWARE_UNITS.items()
            for row in _firmware_quantities(loop, *units)
        ),
        Quantity("currents together", "radius per sample", "", ("gains", "currents", "radius")),
        *(
            Quantity("observer", label, unit, ("gains", "observer", key))
            for label, key, unit in _OBSERVER
        ),
    ),
)


def _certified(outcome: Outcome) -> CurrentLoopProof | None:
    loops = outcome.solution.loops
    proof = None if loops is None or loops.robust is None else loops.robust.proof
    return None if proof is None or proof.certificate is None else proof


# Its words and its JSON stand with those of the loops; a run stores its certificate.
STABILITY = Capability(
    name="stability",
    title="proof of the current loops",
    of=_certified,
    summary=lambda _, proof: [("current loops", proof_summary(proof))],
    files=lambda solution, proof: {
        f"{solution.design.export.prefix}{CERTIFICATE}": certificate_bytes(proof)
    },
)


def _left_out(outcome: Outcome) -> str | None:
    return outcome.solution.gains_left_out if outcome.solution.loops is None else None


NO_LOOPS = Capability(
    name="gains_left_out",
    title="why there are no control loops",
    of=_left_out,
    plain=lambda _, why: why,
    always=False,
    watched=lambda _, why: [f"there are no control loops: {why}"],
    sentences=lambda _, why: [f"There are no control loops: {why}."],
)


def _gains_files(solution: Solution, schedule: GainSchedule) -> dict[str, bytes]:
    assert solution.loops is not None
    return gains_files(solution.design, solution.loops, schedule)


# Its table and its JSON stand with those of the loops.
GAIN_SCHEDULE = Capability(
    name="gain_schedule",
    title="gains over the current",
    of=lambda outcome: None if outcome.solution.loops is None else outcome.solution.loops.schedule,
    headers=(
        HeaderKind(
            name="gains",
            files=_gains_files,
            plain=lambda _, schedule: plain_evaluator(schedule.fit.evaluator),
            read=lambda own, _: evaluator_from(own),
            programme=gains_programme,
        ),
    ),
)
