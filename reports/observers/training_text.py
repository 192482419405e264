"""What is said of a correction that was learned: what it gains, and where it knows nothing."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.optimizer.observers.training import Limits, Training
    from dqforge.reports.plain_data import PlainData

# Title, columns, rows, notes.
TrainingTable = tuple[str, tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...]]


def _hertz(omega: float) -> str:
    return f"{omega / (2.0 * math.pi):.3g}"


def _per_cent(limits: Limits) -> str:
    low, high = limits
    return f"{100.0 * low:+.3g} to {100.0 * high:+.3g} %"


def silence_text(training: Training) -> str:
    """Where the correction is nought, in words."""
    box = training.box
    return (
        f"no correction below {_hertz(box.omega_low)} Hz, where nothing can be learned, above "
        f"{_hertz(box.omega_high)} Hz, beyond {1.05 * box.i_max:.3g} A, and wherever psi^ - "
        "psi_model is beyond what was trained"
    )


def bound_text(training: Training) -> str:
    """How large the correction can become, in words."""
    limit = f"limited to {math.degrees(training.limit):.3g} deg"
    if training.rules is None:
        return f"{limit}: nothing more is proven of a network"
    return (
        f"{limit}; the mean of the rules is within {math.degrees(training.rules):.3g} deg, the "
        "largest of them over the trained ranges"
    )


def training_part(training: Training) -> TrainingTable:
    """Errors with and without the correction per band of speeds, as a text table."""
    alone, *others = training.rms

    def both(name: str, band: int) -> str:
        rms, largest = training.rms[name][band], training.largest[name][band]
        return f"{math.degrees(rms):.3g} ({math.degrees(largest):.3g})"

    corrected = others[-1]
    rows = tuple(
        (
            f"{_hertz(low)} to {_hertz(high)}",
            *(both(name, k) for name in (alone, *others)),
            f"{100.0 * training.inside[k]:.3g} %",
            f"{100.0 * training.held[k]:.3g} %",
            f"{math.degrees(training.outside[alone][k]):.3g}",
            f"{math.degrees(training.outside[corrected][k]):.3g}",
            f"{100.0 * training.inside_beyond[k]:.3g} %",
        )
        for k, (low, high) in enumerate(training.edges.tolist())
    )
    beyond = f"R {_per_cent(training.beyond)}"
    columns = (
        "electrical Hz",
        alone,
        *others,
        "acts",
        "steady state",
        f"{beyond}: alone",
        corrected,
        "acts",
    )
    box = training.box
    notes = (
        (
            f"{training.numbers} numbers learned of {training.points} steady states: R "
            f"{_per_cent(box.r_s)}, L_d {_per_cent(box.l_d)}, L_q {_per_cent(box.l_q)}, psi_pm "
            f"{_per_cent(box.psi_pm)}, {box.lost[0]:.3g} to {box.lost[1]:.3g} V lost"
        ),
        silence_text(training),
        bound_text(training),
        "transients were neither trained nor tried; the speed is that of the flux observer",
    )
    title = (
        "Learned correction: angle error in deg r.m.s. (largest) on drives of the box that were "
        "not trained"
    )
    return title, columns, rows, notes


def plain_training(training: Training | None) -> PlainData:
    """The same as plain data, angles in rad; nothing of an observer that learns nothing."""
    if training is None:
        return {}

    def plain(values: dict[str, FloatArray]) -> PlainData:
        return {name.replace(" ", "_"): value for name, value in values.items()}

    return {
        "training": {
            "box": asdict(training.box),
            "edges_rad_per_s": training.edges,
            "rms_rad": plain(training.rms),
            "largest_rad": plain(training.largest),
            "beyond_r_s": training.beyond,
            "beyond_rms_rad": plain(training.outside),
            "held": training.held,
            "acts": training.inside,
            "acts_beyond": training.inside_beyond,
            "limit_rad": training.limit,
            "rules_rad": training.rules,
            "numbers": training.numbers,
            "points": training.points,
        }
    }
