"""What is proven of each loop by itself: margins over the tolerances, the speed loop, changing
inductances.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.optimizer.axis_margins.margin_proof import ProvenMargins
    from dqforge.optimizer.changing_loops.current_range import ChangingAxis
    from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
    from dqforge.optimizer.loops.robustness import RobustSet
    from dqforge.optimizer.loops.schedule.gain_schedule import GainSchedule
    from dqforge.optimizer.loops.tolerance_box import DriveBox
    from dqforge.optimizer.speed_box.speed_proof import SpeedProof


@dataclass(frozen=True, slots=True)
class LoopProofs:
    """Proofs of single loops.

    Args:
        margins: Of each current loop over the tolerances; empty without them.
        speed: Of the speed loop over the tolerances; None without them, or with an observer.
        observed: Whether there is a speed loop with tolerances whose speed is observed, of which
            nothing is proven.
        changing: Of both axes of a machine that saturates while the inductances change; empty for
            others.
        measured: The same as ``observed`` where an encoder's edges make the speed.
    """

    margins: Mapping[LoopName, ProvenMargins] = field(default_factory=dict)
    speed: SpeedProof | None = None
    observed: bool = False
    changing: tuple[ChangingAxis, ...] = ()
    measured: bool = False


def prove_margins_of(
    box: DriveBox, loops: tuple[LoopGains | None, ...], robust: RobustSet
) -> dict[LoopName, ProvenMargins]:
    """Margins of the current loops over the tolerances.

    Args:
        box: The drive with its tolerances.
        loops: Loops of d, q and the zero sequence, None where there is none.
        robust: What corners and samples found.
    """
    found = {"i_d": robust.i_d, "i_q": robust.i_q, "i_0": robust.i_0}
    proven: dict[LoopName, ProvenMargins] = {}
    for loop in loops:
        worst = None if loop is None else found[loop.loop]
        if loop is not None and worst is not None:
            from dqforge.optimizer.axis_margins.margin_proof import prove_margins

            proven[loop.loop] = prove_margins(box, loop, worst)
    return proven


def prove_loops(
    box: DriveBox,
    largest: tuple[float, float],
    currents: tuple[LoopGains, LoopGains, LoopGains | None],
    speed: LoopGains | None,
    found: tuple[RobustSet | None, GainSchedule | None],
) -> LoopProofs:
    """All proofs of single loops of a design whose gains are found.

    Args:
        box: The drive with its tolerances.
        largest: Largest incremental inductances (l_d, l_q) along the reference, in H.
        currents: Current loops of d, q and the zero sequence (None where there is none).
        speed: The speed loop, None where there is none.
        found: What corners and samples found (None without tolerances), and the gains over the
            current.

    Raises:
        NoSolutionError: The speed loop is unstable between the corners and samples; names the
            drive.
    """
    i_d, i_q, _ = currents
    robust, schedule = found
    changing: tuple[ChangingAxis, ...] = ()
    if box.design.phase_machine is None and not isinstance(box.design.machine, LinearMachine):
        from dqforge.optimizer.changing_loops.current_range import prove_changing_currents

        changing = prove_changing_currents(box, largest, (i_d, i_q), schedule)
    if robust is None:
        return LoopProofs(changing=changing)
    observed = speed is not None and speed.observed is not None
    proof = None
    if speed is not None and not observed:
        from dqforge.optimizer.speed_box.speed_proof import prove_speed_loop

        proof = prove_speed_loop(box, speed, i_q, thorough=box.tolerances.thorough)
        if proof.unstable is not None:
            raise _refusal(proof.unstable)
    return LoopProofs(prove_margins_of(box, currents, robust), proof, observed, changing)


def _refusal(unstable: Mapping[str, float]) -> NoSolutionError:
    at = ", ".join(f"{name} {100.0 * value:+.3g} %" for name, value in unstable.items())
    return NoSolutionError(
        f"control.speed_loop: within control.tolerances the speed loop is unstable at {at}, "
        "between the corners and points that were tried; ask for a slower loop, or narrow "
        "control.tolerances"
    )
