"""The comparison in words: who is refused and why, the pair to flash, and names of cells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.optimizer.estimator_comparison.flashed_pair import BY_SALIENCY, FlashedPair
from dqforge.optimizer.estimator_comparison.solve import NOBODY, EstimatorComparison

if TYPE_CHECKING:
    from dqforge.optimizer.estimator_comparison.candidate import Question
    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator

_TURN = 2.0 * math.pi


def hertz(omega: float) -> str:
    """An angular speed in rad/s as Hz."""
    return f"{omega / _TURN:.3g}"


def rpm(omega: float, pole_pairs: int) -> str:
    """An electrical speed in rad/s as rpm of the shaft."""
    return f"{omega / pole_pairs * 30.0 / math.pi:.4g} rpm"


def load_name(share: float) -> str:
    """A torque over the largest one."""
    if share == 0.0:
        return "no load"
    return f"{100.0 * abs(share):.0f} % {'motoring' if share > 0.0 else 'braking'}"


def cell_name(found: EstimatorComparison, speed: int, load: int) -> str:
    """Who wins at a speed and a load, with its error in deg; a dash where nobody holds, nothing
    where the voltage does not reach.
    """
    index = int(found.winner[speed, load])
    if index < 0:
        return "-" if index == NOBODY else ""
    row = found.estimators[index]
    assert row.figures is not None
    return f"{row.candidate.name} {math.degrees(float(row.figures.angle[speed, load])):.2g}"


def held_text(row: ComparedEstimator, omega_max: float) -> str:
    """Speeds in Hz at which an estimator holds at every load."""
    if row.figures is None:
        return ""
    low, high = row.figures.omega_low, row.figures.omega_high
    return f"{hertz(low)} to {hertz(min(high, omega_max))}" if math.isfinite(low) else "none"


def pair_lines(asked: Question, pair: FlashedPair) -> tuple[str, ...]:
    """Sentences on what to flash."""
    share = f"{100.0 * pair.held:.0f} % of the cells of speed and load that the voltage reaches"
    low = pair.from_standstill
    if pair.at_speed is None and low is not None:
        return (f"flash {low}: it holds in {share}; no estimator of higher speeds holds",)
    if pair.at_speed is None:
        return ("flash none of these: no estimator holds at any speed and load of this drive",)
    pairs = asked.design.machine.pole_pairs
    first = (
        f"flash {pair.at_speed} at speed: it holds in {share}"
        if low is None
        else f"flash {low} from standstill and {pair.at_speed} at speed: they hold in {share}"
    )
    if pair.start is not None:
        first += f"; start by {pair.start}"
    if pair.up is None or pair.down is None:
        over = "no speed for a hand-over: at none does it hold at every load"
    else:
        over = (
            f"hand over above {rpm(pair.up, pairs)} ({hertz(pair.up)} Hz), and back below "
            f"{rpm(pair.down, pairs)} ({hertz(pair.down)} Hz)"
        )
    lines = [first, over, *_loop_lines(asked, pair)]
    if pair.passed:
        lines.append(
            "passed over, as the speed loop over them is stable at every corner from a higher "
            f"speed on, or nowhere: {', '.join(pair.passed)}"
        )
    lines += _keys(asked, pair)
    if pair.gap is not None:
        from_, to = (rpm(omega, pairs) for omega in pair.gap)
        lines.append(f"neither holds at every load from {from_} to {to}")
    return tuple(lines)


def _loop_lines(asked: Question, pair: FlashedPair) -> list[str]:
    """The speed loop over the estimator at speed."""
    loop = pair.loop
    if loop is None:
        return []
    margin = f"{math.degrees(loop.margin):.3g} deg at {hertz(loop.crossover)} Hz"
    verdict = "" if loop.holds else ", too little: see dqforge tune"
    text = f"the speed loop over {pair.at_speed} has {margin}{verdict}"
    if not math.isfinite(loop.low):
        return [f"{text}; at no speed every corner of the tolerances is stable"]
    least = rpm(loop.low, asked.design.machine.pole_pairs)
    return [f"{text}; every corner of the tolerances is stable from {least} on"]


def _keys(asked: Question, pair: FlashedPair) -> list[str]:
    """What to write into the design for the pair."""
    if pair.start is None:
        return [f"write control.observer: {{method: {pair.at_speed}}}"]
    keys = [f"method: {pair.start}"]
    if pair.up is not None:
        keys.append(f"hand_over: {rpm(pair.up, asked.design.machine.pole_pairs)}")
    if pair.start == BY_SALIENCY:
        keys.append(f"observer: {{method: {pair.from_standstill}}}")
    start = f"{{{', '.join(keys)}}}"
    return [f"write control.observer: {{method: {pair.at_speed}}} and control.start_up: {start}"]
