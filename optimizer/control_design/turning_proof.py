"""Both current loops of a design together, proven stable over its tolerances."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.box_proofs.current_loop_model import (
    BoxDrive,
    CurrentLoopBox,
    largest_moduli,
    loop_matrices,
    parameters_of,
)
from dqforge.optimizer.box_proofs.current_loop_proof import (
    CurrentLoopProof,
    prove_current_loops,
    prove_sensitivity,
)
from dqforge.optimizer.loops.robustness import unstable_together

if TYPE_CHECKING:
    from dqforge.machines.errors import NoSolutionError
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.tolerance_box import DriveBox


def current_loop_box(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentLoopBox | None:
    """All that a proof of both current loops depends on; None where the machine states no largest
    speed.

    Args:
        box: The drive with its tolerances.
        i_d, i_q: The current loops.
    """
    machine, control = box.design.machine, box.design.control
    if machine.omega_m_max is None:
        return None
    low_d, high_d = box.inductance_limits("i_d")
    low_q, high_q = box.inductance_limits("i_q")
    low_r, high_r = box.tolerances.limits("r_s")
    low_v, high_v = box.tolerances.limits("v_dc")
    low_t, high_t = box.tolerances.limits("dead_time")
    per_second = box.dead_time_resistance if high_t > low_t else 0.0
    return CurrentLoopBox(
        t_s=control.t_s,
        kp=(i_d.kp, i_q.kp),
        ki_ts=(i_d.ki_ts, i_q.ki_ts),
        decoupling=(machine.l_d, machine.l_q),
        r_s=(machine.r_s * (1.0 + low_r), machine.r_s * (1.0 + high_r)),
        dead_time=(per_second * low_t + 0.0, per_second * high_t),  # no -0
        l_d=(box.nominal[0] * (1.0 + low_d), box.nominal[0] * (1.0 + high_d)),
        l_q=(box.nominal[1] * (1.0 + low_q), box.nominal[1] * (1.0 + high_q)),
        gain=(1.0 + low_v, 1.0 + high_v),
        omega_e=machine.pole_pairs * machine.omega_m_max,
    )


def turning_proof(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentLoopProof | None:
    """What is proven of both current loops together over the tolerances; None where the machine
    states no largest speed.

    Args:
        box: The drive with its tolerances.
        i_d, i_q: The current loops.

    Raises:
        NoSolutionError: The loops are unstable at a drive between the corners and points that were
            tried; names it.
    """
    inputs = current_loop_box(box, i_d, i_q)
    if inputs is None:
        return None
    proof = prove_current_loops(inputs)
    if proof.counterexample is not None:
        raise _refusal(box, inputs, proof.counterexample)
    if not proof.proven:
        return proof
    return replace(proof, sensitivity=prove_sensitivity(inputs, proof.left))


def _refusal(box: DriveBox, inputs: CurrentLoopBox, drive: BoxDrive) -> NoSolutionError:
    machine = box.design.machine
    rpm = drive.omega_e / machine.pole_pairs * 30.0 / np.pi
    point = parameters_of(inputs, drive)
    radius = float(largest_moduli(loop_matrices(inputs, point[None]))[0])
    shares = (
        ("l_d", drive.l_d / box.nominal[0]),
        ("l_q", drive.l_q / box.nominal[1]),
        ("v_dc", drive.gain),
    )
    parts = [f"{rpm:.4g} rpm, {drive.r_s:.4g} Ohm"]
    parts += [f"{name} {100.0 * (share - 1.0):+.3g} %" for name, share in shares]
    return unstable_together(", ".join(parts), radius)
