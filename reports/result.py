"""Results as plain data for ``--json`` and ``result.json``: documented,
versioned and the same bytes every time.
"""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.plain_data import PlainData
from dqforge.reports.plain_design import plain_design


def plain_drive(design: Design) -> PlainData:
    """Constants, limits and settings of machine and inverter in SI units, whatever keys the design
    gave them by.
    """
    machine, inverter = design.machine, design.inverter
    return {
        "constant": isinstance(machine, LinearMachine),
        "pole_pairs": machine.pole_pairs,
        "r_s_Ohm": machine.r_s,
        "l_d_H": machine.l_d,
        "l_q_H": machine.l_q,
        "psi_pm_Wb": machine.psi_pm,
        "inertia_kg_m2": machine.inertia,
        "friction_Nms_per_rad": machine.friction,
        "omega_m_max_rad_per_s": machine.omega_m_max,
        "i_max_A": design.i_max,
        "v_dc_V": inverter.v_dc,
        "f_sw_Hz": inverter.f_sw,
        "dead_time_s": inverter.dead_time,
        "topology": inverter.topology,
        "t_s_s": design.control.t_s,
        "strategy": design.strategy,
        "reference_omega_m_rad_per_s": design.operation.omega_m,
    }


def plain_header(solution: Solution) -> PlainData:
    """The main header: its prefix, the number of its test vectors, and what its model needs."""
    export = solution.design.export
    return {
        "prefix": export.prefix,
        "vectors": export.vectors,
        "reference": to_plain(solution.reference),
    }


def plain_outcome(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> PlainData:
    """What each capability says of its result and of its headers, by key.

    Args:
        outcome: What was solved, verified and simulated.
        capabilities: Those of the product, or these and some from outside.
    """
    plain: PlainData = {}
    for capability in capabilities:
        found = capability.of(outcome)
        if capability.plain is not None and (capability.always or found is not None):
            plain[capability.name] = (
                None if found is None else capability.plain(outcome.solution, found)
            )
        for kind in capability.headers:
            described = None if found is None else kind.plain(outcome.solution, found)
            if capability.always or described is not None:
                plain[kind.key] = described
    return plain


def plain_solution(solution: Solution, capabilities: Capabilities = CAPABILITIES) -> PlainData:
    """Everything that a run found, with what `dqforge verify` needs under ``header``."""
    return {
        "input": plain_design(solution.design),
        "drive": plain_drive(solution.design),
        "header": plain_header(solution),
        **plain_outcome(Outcome(solution), capabilities),
    }
