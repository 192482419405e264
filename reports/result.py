"""Results as plain data for ``--json`` and ``result.json``: documented,
versioned and the same bytes every time.
"""

from __future__ import annotations

from dataclasses import asdict

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.flux_maps.evidence import FluxEvidence
from dqforge.optimizer.solution import Solution
from dqforge.reports.control.fixed_header import (
    plain_fixed,
)
from dqforge.reports.control.header import plain_control
from dqforge.reports.current_reference.plain import plain_fit, plain_negative, to_plain
from dqforge.reports.field_weakening.header import plain_weakening
from dqforge.reports.field_weakening.plain import plain_weakening_fit
from dqforge.reports.loops.header import plain_evaluator
from dqforge.reports.loops.plain import plain_gains
from dqforge.reports.losses.map_tables import plain_mission
from dqforge.reports.losses.plain import plain_losses
from dqforge.reports.modulation_choice.header import choice_model, plain_emitted
from dqforge.reports.modulation_choice.tables import plain_choice
from dqforge.reports.observers.position_header import emitted, plain_observer
from dqforge.reports.observers.speed_header import plain_speed_observer
from dqforge.reports.operating_points.plain import plain_curves
from dqforge.reports.plain_data import PlainData
from dqforge.reports.waveforms.header import plain_phase_reference
from dqforge.reports.waveforms.tables import plain_phase_fit, plain_waveforms


def plain_design(design: Design) -> PlainData:
    """Name, origin of every value, assumptions and the digest of the input."""
    return {
        "name": design.name,
        "about": design.about,
        "digest": design.digest,
        "values": [asdict(value) for value in design.values],
        "assumptions": list(design.assumptions),
        **(
            {"flux_maps": [plain_flux_map(evidence) for evidence in design.flux_evidence]}
            if design.flux_evidence
            else {}
        ),
    }


def plain_flux_map(evidence: FluxEvidence) -> PlainData:
    """Fit and asymmetry of the flux map of one file, in Wb, A, N m and rad.

    The asymmetry None for a half plane.
    """
    fit, found = evidence.fit, evidence.asymmetry
    rms, most = evidence.torque_residual
    plain = asdict(fit) | {"torque_rms": rms, "torque_largest": most}
    asymmetry = None
    if found is not None:
        asymmetry = asdict(found) | {
            "torque": found.torque,
            "share": found.share,
            "share_left": found.share_left,
        }
    return {"file": evidence.source, "fit": plain, "asymmetry": asymmetry}


def plain_drive(design: Design) -> PlainData:
    """Constants of machine and inverter in SI units, whatever keys the design gave them by.

    Limits and settings.
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


def plain_solution(solution: Solution) -> PlainData:
    """Everything that a run found, with what `dqforge verify` needs under ``header``."""
    design, weakening, gains = solution.design, solution.weakening, solution.loops
    schedule = None if gains is None else gains.schedule
    observer = None if gains is None else emitted(gains.position)
    return {
        "input": plain_design(design),
        "drive": plain_drive(design),
        "header": {
            "prefix": design.export.prefix,
            "vectors": design.export.vectors,
            "reference": to_plain(solution.reference),
        },
        "mtpa": plain_curves(solution.curves),
        "fit": plain_fit(
            solution.fit,
            solution.alternatives,
            solution.trials,
            solution.certificate,
            solution.data,
        ),
        **plain_negative(solution.negative),
        "gains": None if gains is None else plain_gains(design, gains),
        **({} if gains is not None else {"gains_left_out": solution.gains_left_out}),
        "losses": plain_losses(solution.losses),
        "mission": None if solution.mission is None else plain_mission(solution.mission),
        "waveforms": None if solution.waveforms is None else plain_waveforms(solution.waveforms),
        "waveform_fit": None if solution.phases is None else plain_phase_fit(solution.phases),
        "waveform_header": None
        if solution.phases is None
        else plain_phase_reference(solution.phases.reference),
        "weakening": plain_weakening_fit(weakening),
        "weakening_header": None if weakening is None else plain_weakening(weakening.step),
        "control_header": plain_control(solution) if "float32" in design.export.control else None,
        **plain_fixed(solution),
        "modulation_choice": None if solution.choice is None else plain_choice(solution.choice),
        "modulation_header": None
        if solution.choice is None
        else plain_emitted(choice_model(solution.choice)),
        "gains_header": None if schedule is None else plain_evaluator(schedule.fit.evaluator),
        "observer_header": None if observer is None else plain_observer(observer),
        "speed_observer_header": plain_speed_observer(
            design.machine, None if gains is None else gains.observer
        ),
    }
