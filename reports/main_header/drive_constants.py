"""Constants of machine, torque domain and bases for the main header."""

from __future__ import annotations

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.current_reference.forms import Emitted, SignedReference
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_constant import Constant, ConstantGroup
from dqforge.reports.plain_data import shortest


def machine_constants(solution: Solution) -> list[ConstantGroup]:
    """Machine, current limit and the ends of the torque domain."""
    machine = solution.design.machine
    rest = "" if isinstance(machine, LinearMachine) else "; at zero current, the machine saturates"
    to_q = f"{rest}; decoupling v_q += omega_e (L_D i_d + PSI_PM)"
    to_d = f"{rest}; decoupling v_d -= omega_e L_Q i_q"
    constants = (
        Constant("machine.pole_pairs", machine.pole_pairs, "", "number of pole pairs"),
        Constant("machine.r_s", machine.r_s, "Ohm", "phase resistance"),
        Constant("machine.l_d", machine.l_d, "H", "d-axis inductance", to_q),
        Constant("machine.l_q", machine.l_q, "H", "q-axis inductance", to_d),
        Constant("machine.psi_pm", machine.psi_pm, "Wb", "magnet flux linkage", " (peak)"),
        Constant("limit.current", solution.design.i_max, "A", "current limit", " (peak)"),
        *_torque_limits(solution.reference),
    )
    title = "Machine (dq quantities are amplitude-invariant: peak of phase)"
    return [ConstantGroup(title, constants)]


def _torque_limits(reference: Emitted) -> list[Constant]:
    """End of the torque domain, and its code in fixed point.

    Both ends where the signs of the torque differ.
    """
    if isinstance(reference, SignedReference):
        end = shortest(reference.negative.torque_max)
        words = "magnitude of its end for negative torques"
        below = Constant("limit.torque_negative", end, "N m", words)
        return [*_torque_limits(reference.positive), below]
    words = "end of the torque domain"
    if not isinstance(reference, FixedReference):
        return [Constant("limit.torque", shortest(reference.torque_max), "N m", words)]
    bits = reference.width - 1
    code = f"the same over BASE_TORQUE_NM, times 2^{bits}"
    return [
        Constant("limit.torque", reference.torque_max, "N m", words),
        Constant("limit.torque_code", reference.end, "", code, base="base.torque", bits=bits),
    ]


def operation_constants(solution: Solution) -> list[ConstantGroup]:
    """The speed for which the references weaken the field, where there is one."""
    speed = solution.fit.speed
    if speed is None:
        return []
    words = "phase amplitude that is not exceeded there"
    return [
        ConstantGroup(
            "The one speed for which the current references hold",
            (
                Constant("reference.speed", speed.omega_m, "rad/s", "mechanical speed"),
                Constant("reference.voltage", speed.v_max, "V", words),
            ),
            (
                (
                    "Below it they keep the voltage limit with current to spare, above it they "
                    "exceed the limit."
                ),
            ),
        )
    ]


def base_constants(solution: Solution) -> list[ConstantGroup]:
    """Bases of what is per unit."""
    bases = solution.design.control.bases
    return [
        ConstantGroup(
            "Bases of the per-unit gains",
            (
                Constant("base.current", bases.current, "A"),
                Constant("base.voltage", bases.voltage, "V"),
                Constant("base.speed", bases.speed, "rad/s", "mechanical speed"),
                Constant("base.torque", bases.torque, "N m"),
            ),
        )
    ]
