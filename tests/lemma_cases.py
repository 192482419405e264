"""A small machine, a reference that is a straight line and plain formulas,
for the lemmas of the certificates.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates.ball import Local, Task, pieces
from dqforge.optimizer.certificates.current_reference import UNKNOWN, Interval
from dqforge.optimizer.current_reference.forms import CurrentReference, Polynomials
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint


def close(value: float, expected: float, rel: float = 1e-7) -> None:
    """Not below what is expected, and above it by little."""
    assert expected * (1.0 - 1e-12) <= value <= expected * (1.0 + rel) + 1e-20


# i_d = -T/4 and i_q = 5 T/4: roughly what the machine below needs for small torques.
LINE = Polynomials(
    SinglePolynomial(np.array([0.0], np.float32), np.array([[0.0, -0.25]], np.float32)),
    SinglePolynomial(np.array([0.0], np.float32), np.array([[0.0, 1.25]], np.float32)),
)

MACHINE = LinearMachine(pole_pairs=2, r_s=0.5, l_d=0.05, l_q=0.15, psi_pm=0.25, i_max=20.0)


def task_of(
    speed: SpeedPoint | None = None, machine: LinearMachine = MACHINE, form: Any = LINE
) -> Task:
    return Task.of(
        CurrentChoice(machine, "mtpa", machine.i_max, speed),
        CurrentReference(form, np.float32(6.0)),
    )


def interval(task: Task, low: float, high: float) -> Interval:
    return Interval(pieces(task.reference)[0], low, high, 0, UNKNOWN.values())


def plain(machine: LinearMachine, i_d: float, i_q: float) -> dict[str, float]:
    """Torque with its derivatives, and the condition of least loss with its own,
    of constant inductances.
    """
    k, s, psi = 1.5 * machine.pole_pairs, machine.l_d - machine.l_q, machine.psi_pm
    t_d, t_q = k * s * i_q, k * (psi + s * i_d)
    return {
        "torque": k * (psi + s * i_d) * i_q,
        "t_d": t_d,
        "t_q": t_q,
        "t_dq": k * s,
        "c": t_q * i_d - t_d * i_q,
        "c_d": t_q + k * s * i_d,
        "c_q": -t_d - k * s * i_q,
    }


def local(**values: float) -> Local:
    """Numbers without radius; those that are not given are zero."""
    return Local(*(arb(values.get(name, 0.0)) for name in Local.__dataclass_fields__))
