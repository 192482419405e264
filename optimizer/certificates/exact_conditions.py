"""What the exact currents of a choice solve: torque and a second condition, with derivatives,
in ball arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import TYPE_CHECKING, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import Value, as_ball, exactly, hull
from dqforge.optimizer.certificates.enclosures import Jet, jets
from dqforge.optimizer.current_reference.forms import Reference
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from flint import arb


Condition = Literal["loss", "no i_d", "voltage"]  # What fixes the exact currents beside the torque.
_GRID = 1001
_KINK_MARGIN = 1e-7  # Share of the domain around a kink on which both conditions are allowed for.


@dataclass(frozen=True, slots=True)
class Local:
    """Torque, its gradient and Hessian; the second condition and the voltage excess with theirs;
    balls or series.
    """

    torque: Value
    t_d: Value
    t_q: Value
    t_dd: Value
    t_dq: Value
    t_qq: Value
    condition: Value
    c_d: Value
    c_q: Value
    excess: Value
    e_d: Value
    e_q: Value


def _voltage_kinks(choice: CurrentChoice, end: float) -> tuple[list[float], bool]:
    """Torques at which the voltage begins or ceases to limit, and whether it does at zero
    torque.
    """
    speed = choice.speed
    assert speed is not None

    def limited(torque: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        i_d, i_q = choice.currents(torque)
        omega_e = np.full_like(torque, choice.machine.pole_pairs * speed.omega_m)
        taken = np.hypot(*choice.machine.voltage(i_d, i_q, omega_e))
        return np.asarray(taken > speed.v_max * (1.0 - 1e-9))

    torque = np.linspace(0.0, end, _GRID)
    states = limited(torque)
    kinks = []
    for place in np.flatnonzero(states[1:] != states[:-1]):
        low, high = float(torque[place]), float(torque[place + 1])
        for _ in range(2):
            finer = np.linspace(low, high, _GRID)
            inside = limited(finer)
            at = int(np.argmax(inside != inside[0]))
            low, high = float(finer[at - 1]), float(finer[at])
        kinks.append(high)
    return kinks, bool(states[0])


def torque_parts(jet: Jet, i_d: Value, i_q: Value, k: Value) -> tuple[Value, ...]:
    """Torque in N m, its gradient and its Hessian (dd, dq, qq) by the currents.

    ``k`` is 1.5 times the pole pairs.
    """
    return (
        (jet.psi_d * i_q - jet.psi_q * i_d) * k,
        (jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q) * k,
        (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d) * k,
        (jet.d_dd * i_q - jet.q_dd * i_d - jet.l_qd * 2) * k,
        (jet.l_dd + jet.d_dq * i_q - jet.l_qq - jet.q_dq * i_d) * k,
        (jet.l_dq * 2 + jet.d_qq * i_q - jet.q_qq * i_d) * k,
    )


@dataclass(frozen=True, slots=True)
class Task:
    """What is certified: the machine with its conditions, and where each holds."""

    choice: CurrentChoice
    reference: Reference
    kinks: tuple[float, ...]
    starts_limited: bool
    curves: dict[str, Callable[[FloatArray], FloatArray]] = field(repr=False)

    @classmethod
    def of(cls, choice: CurrentChoice, reference: Reference) -> Task:
        """What a choice asks for.

        Torques at which the voltage begins or ceases to limit are found by sampling.
        """
        end = float(reference.torque_max)
        kinks, limited = ([], False) if choice.speed is None else _voltage_kinks(choice, end)
        return cls(choice, reference, tuple(kinks), limited, choice.curves(end))

    def exact(self, torque: float) -> tuple[float, float]:
        """Close to the exact currents in A at a torque in N m."""
        at = np.array([torque])
        return float(self.curves["d"](at)[0]), float(self.curves["q"](at)[0])

    def conditions(self, low: float, high: float) -> list[Condition]:
        """Conditions that may hold between two torques."""
        if self.choice.strategy == "id0":
            return ["no i_d"]
        margin = _KINK_MARGIN * float(self.reference.torque_max)
        before = sum(1 for kink in self.kinks if kink < low - margin)
        after = sum(1 for kink in self.kinks if kink <= high + margin)
        if after > before:
            return ["loss", "voltage"]
        return ["voltage" if self.starts_limited ^ (before % 2 == 1) else "loss"]

    def local(
        self, jet: Jet, i_d: Value, i_q: Value, condition: Condition, *, gradient: bool = True
    ) -> Local:
        """Torque and condition with their derivatives; zeros as the gradient of the voltage excess
        where that is no condition and without ``gradient``.
        """
        machine = self.choice.machine
        torque, t_d, t_q, t_dd, t_dq, t_qq = torque_parts(
            jet, i_d, i_q, exactly(1.5 * machine.pole_pairs)
        )
        voltage = self._voltage(machine, jet, i_d, i_q, gradient or condition == "voltage")
        if condition == "loss":
            second = (
                t_q * i_d - t_d * i_q,
                t_q + t_dq * i_d - t_dd * i_q,
                t_qq * i_d - t_d - t_dq * i_q,
            )
        elif condition == "voltage":
            second = voltage
        else:
            second = (i_d, exactly(1.0) + i_d * 0, i_d * 0)
        return Local(torque, t_d, t_q, t_dd, t_dq, t_qq, *second, *voltage)

    def torque_and_excess(self, jet: Jet, i_d: Value, i_q: Value) -> tuple[Value, Value]:
        """Torque in N m and (|v| / v_max)^2 - 1, of the flux linkages alone."""
        machine = self.choice.machine
        torque = (jet.psi_d * i_q - jet.psi_q * i_d) * exactly(1.5 * machine.pole_pairs)
        return torque, self._voltage(machine, jet, i_d, i_q, gradient=False)[0]

    def _voltage(
        self, machine: Machine, jet: Jet, i_d: Value, i_q: Value, gradient: bool
    ) -> tuple[Value, Value, Value]:
        """(|v| / v_max)^2 - 1 and its gradient; zeros where there is no speed."""
        speed = self.choice.speed
        if speed is None:
            return i_d * 0, i_d * 0, i_d * 0
        omega, r_s = exactly(speed.omega_m) * machine.pole_pairs, exactly(machine.r_s)
        scale = 1 / (exactly(speed.v_max) * exactly(speed.v_max))
        v_d, v_q = i_d * r_s - jet.psi_q * omega, i_q * r_s + jet.psi_d * omega
        excess = (v_d * v_d + v_q * v_q) * scale - 1
        if not gradient:
            return excess, exactly(0.0), exactly(0.0)
        by_d = (v_d * (r_s - jet.l_qd * omega) + v_q * (jet.l_dd * omega)) * (2 * scale)
        by_q = (v_q * (r_s + jet.l_dq * omega) - v_d * (jet.l_qq * omega)) * (2 * scale)
        return excess, by_d, by_q


def conditions_over_box(task: Task, box: tuple[arb, arb], condition: Condition) -> Local:
    """Torque and condition over a box of currents, whatever cells it touches."""
    found = [task.local(jet(*box), *box, condition) for jet in jets(task.choice.machine, *box)]
    return Local(
        *(
            hull([as_ball(getattr(part, name)) for part in found])
            for name in Local.__dataclass_fields__
        )
    )
