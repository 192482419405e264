"""What is proven of single loops, in words, comment lines and plain data: margins axis by axis, the
speed loop, and current loops whose inductance changes.
"""

from __future__ import annotations

import math
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.axis_margins.margin_proof import ProvenMargins
    from dqforge.optimizer.changing_loops.current_range import ChangingAxis
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.speed_box.speed_proof import SpeedProof
    from dqforge.reports.plain_data import PlainData

_WIDTH = 100


def margin_text(name: str, proven: ProvenMargins) -> str:
    """Bounds of one axis in words.

    Args:
        name: Of the loop.
        proven: What is proven.
    """
    if not proven.stable:
        return f"{name} alone: nothing is proven of its margins"
    parts = [f"M_s {proven.max_sensitivity:.3f} or less"]
    if proven.phase_margin is not None:
        degrees = math.floor(100.0 * math.degrees(proven.phase_margin)) / 100.0
        parts.append(f"phase margin {degrees:.2f} deg or more")
    return (
        f"{name} alone: proven stable for every drive in the box, {' and '.join(parts)} "
        f"({proven.cells} cells, rational arithmetic)"
    )


def speed_text(proof: SpeedProof) -> str:
    """What is proven of the speed loop.

    Args:
        proof: The proof.
    """
    samples = "one matrix" if proof.ratio == 1 else f"a cycle of {proof.ratio} matrices"
    scope = (
        "without torque, voltage and current limits, the torque following as i_q does; checked in "
        "double precision with the remainder of every cell"
    )
    if proof.complete:
        cells = "one cell" if proof.leaves == 1 else f"{proof.leaves} cells"
        return (
            "speed loop: proven stable for every drive in the box, which within a cell may change "
            f"at every current sample ({cells}, {samples} each): {scope}"
        )
    if proof.cells == 0:
        return (
            f"speed loop: not tried to prove, {samples} per cell are more than every run can "
            "afford; control.tolerances.thorough: true tries"
        )
    share = math.floor(1000.0 * proof.share) / 10.0
    cells = "one cell" if proof.leaves == 1 else f"{proof.leaves} cells"
    return (
        f"speed loop: proven stable for {share:.1f} % of the drives in the box ({cells}, "
        f"{samples} each), the others at corners and points alone; "
        f"control.tolerances.thorough: true tries longer: {scope}"
    )


def _range(axis: ChangingAxis) -> str:
    low, high = (f"{1e3 * value:.4g}" for value in axis.inductance)
    return f"l_{axis.axis[-1]} between {low} and {high} mH along the reference"


def changing_text(axis: ChangingAxis) -> str:
    """What is proven of an axis whose inductance changes with the current.

    Args:
        axis: The axis.
    """
    held = "one Lyapunov function" if axis.cells == 1 else f"{axis.cells} Lyapunov functions"
    if axis.any_current is None:
        if axis.proven:
            return (
                f"{axis.axis}, constant gains: deviations are forgotten however fast saturation "
                f"changes {_range(axis)} (proven by {held} in rational arithmetic)"
            )
        slower = (
            "not proven for any change of it"
            if axis.rate is None
            else f"proven while it changes by a factor of {axis.rate:.2f} per sample at most"
        )
        return f"{axis.axis}, constant gains: {_range(axis)}: {slower}"
    if not axis.proven:
        return f"{axis.axis}, scheduled gains: not proven while the current changes {_range(axis)}"
    other = (
        "of any size, also with the gains of any other current, such as the reference"
        if axis.any_current
        else "not with the gains of another current, such as the reference of one on its way"
    )
    return (
        f"{axis.axis}, scheduled gains in parallel form at the measured current: small deviations "
        f"are forgotten however fast the current changes {_range(axis)} (proven by {held} in "
        f"rational arithmetic); {other}"
    )


def velocity_text(axis: ChangingAxis) -> str:
    """Why the velocity form is refused with scheduled gains; empty where it does not grow.

    Args:
        axis: The axis.
    """
    if axis.velocity is None:
        return ""
    growth, (low, high) = axis.velocity
    every = "every sample" if growth.stay == 1 else f"every {growth.stay} samples"
    return (
        f"{axis.axis}: not in velocity form with kp (e[k] - e[k-1]): where i_q alternates between "
        f"{low:.4g} and {high:.4g} A {every} it grows by {growth.factor:.2f} per sample, though at "
        "each of these currents it is stable; kp[k] e[k] - kp[k-1] e[k-1] is the parallel form"
    )


def changing_notes(gains: GainSet) -> tuple[str, ...]:
    """What is proven while inductances change; nothing of a machine that does not saturate."""
    notes = [changing_text(axis) for axis in gains.proofs.changing]
    notes += [velocity_text(axis) for axis in gains.proofs.changing]
    return tuple(note for note in notes if note)


def box_notes(gains: GainSet) -> tuple[str, ...]:
    """What is proven of single loops over the tolerances; nothing without them."""
    proofs = gains.proofs
    notes = [margin_text(name, proven) for name, proven in proofs.margins.items()]
    if proofs.speed is not None:
        notes.append(speed_text(proofs.speed))
    if proofs.observed:
        notes.append(
            "speed loop: nothing is proven over the box, since its speed comes from an observer, "
            "which has too many states for this proof"
        )
    if proofs.measured:
        notes.append(
            "speed loop: nothing is tried or proven over the box, since the delay of its measured "
            "speed is part of neither"
        )
    return tuple(notes)


def proven_lines(gains: GainSet | None) -> list[str]:
    """Both as comment lines of a header."""
    return [] if gains is None else [*_wrapped(box_notes(gains)), *changing_lines(gains)]


def changing_lines(gains: GainSet) -> list[str]:
    """What is proven while inductances change as comment lines of a header."""
    return _wrapped(changing_notes(gains))


def _wrapped(notes: tuple[str, ...]) -> list[str]:
    lines = []
    for note in notes:
        lines += textwrap.wrap(f"{note}.", _WIDTH)
    return lines


def plain_box_proofs(gains: GainSet) -> PlainData:
    """What is proven over the tolerances as plain data."""
    proofs, speed = gains.proofs, gains.proofs.speed
    return {
        "margins": {
            name: {
                "proven_stable": proven.stable,
                "max_sensitivity": proven.max_sensitivity,
                "phase_margin_rad": proven.phase_margin,
                "cells": proven.cells,
            }
            for name, proven in proofs.margins.items()
        },
        "speed": None
        if speed is None
        else {
            "proven": speed.complete,
            "share": speed.share,
            "cells": speed.cells,
            "matrices": speed.leaves * (speed.ratio + 1),
        },
        "speed_observed": proofs.observed,
    }


def plain_changing(gains: GainSet) -> PlainData:
    """What is proven while inductances change; an empty mapping of a machine without saturation."""
    axes = gains.proofs.changing
    if not axes:
        return {}
    return {"changing_inductances": {axis.axis: _plain_axis(axis) for axis in axes}}


def _plain_axis(axis: ChangingAxis) -> PlainData:
    plain: PlainData = {
        "inductance_H": list(axis.inductance),
        "proven": axis.proven,
        "gains_of_any_current": axis.any_current,
        "largest_factor_per_sample": axis.rate,
        "cells": axis.cells,
    }
    if axis.velocity is not None:
        growth, currents = axis.velocity
        plain["velocity_form"] = {
            "growth_per_sample": growth.factor,
            "samples": growth.stay,
            "i_q_A": list(currents),
        }
    return plain
