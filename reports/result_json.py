"""Results as plain data for ``--json`` and ``result.json``: documented, versioned and the same bytes every time."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from dqforge import __version__
from dqforge.machines.design import Design
from dqforge.machines.flux_evidence import FluxEvidence
from dqforge.machines.settings import QFormats
from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.certificate import Certificate
from dqforge.optimizer.current_choice import OperatingPoints
from dqforge.optimizer.data_use import COVERED, DataUse
from dqforge.optimizer.fit_alternatives import Alternative
from dqforge.optimizer.fit_choice import Trial
from dqforge.optimizer.fixed_gains import pi_integers
from dqforge.optimizer.gains import LoopGains, per_unit
from dqforge.optimizer.piecewise import PiecewisePolynomial
from dqforge.optimizer.point_losses import LossComparison
from dqforge.optimizer.reference_fit import ReferenceFit
from dqforge.optimizer.solution import Curves, GainSet, NegativeHalf, Solution
from dqforge.optimizer.surface_fit import WeakeningFit
from dqforge.reports.certificate_text import JSON_DIGITS, plain_certificate
from dqforge.reports.choice_tables import plain_choice
from dqforge.reports.control_fixed_header import plain_fixed_control, plain_fixed_evidence
from dqforge.reports.control_header import plain_control
from dqforge.reports.data_text import plain_data_use
from dqforge.reports.drive_losses_tables import plain_mission
from dqforge.reports.gains_header import plain_evaluator
from dqforge.reports.observed_text import plain_observed
from dqforge.reports.observer_header import emitted, plain_observer
from dqforge.reports.observer_text import plain_position
from dqforge.reports.reference_ir import PlainData, to_plain
from dqforge.reports.robustness_text import plain_robustness
from dqforge.reports.rule_header import choice_model, plain_emitted
from dqforge.reports.schedule_text import plain_schedule
from dqforge.reports.speed_observer_header import plain_speed_observer
from dqforge.reports.surface_header import plain_weakening
from dqforge.reports.waveform_header import plain_phase_reference
from dqforge.reports.waveform_tables import plain_waveforms

FORMAT = 1
"""Version of the layout; it rises when a key is renamed or removed."""


def _clean(value: Any) -> Any:
    """Plain data with nine significant digits: enough to read back a float32, few enough to be the same everywhere.

    Infinite and undefined numbers become null, which JSON can hold.
    """
    if isinstance(value, dict):
        return {key: _clean(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_clean(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return _clean(value.tolist())
    if isinstance(value, np.generic):
        return _clean(value.item())
    if isinstance(value, float):
        return float(f"{value:.{JSON_DIGITS}g}") if math.isfinite(value) else None
    return value


def to_text(command: str, name: str, result: PlainData) -> str:
    """The JSON document of a command: an envelope with the versions around the result; ends with a line feed."""
    envelope = {"dqforge": __version__, "format": FORMAT, "command": command, "design": name, **result}
    return json.dumps(_clean(envelope), indent=1, ensure_ascii=True, allow_nan=False) + "\n"


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
    """Fit and asymmetry of the flux map of one file, in Wb, A, N m and rad; the asymmetry None for a half plane."""
    fit, found = evidence.fit, evidence.asymmetry
    rms, most = evidence.torque_residual
    plain = asdict(fit) | {"torque_rms": rms, "torque_largest": most}
    asymmetry = None
    if found is not None:
        asymmetry = asdict(found) | {"torque": found.torque, "share": found.share, "share_left": found.share_left}
    return {"file": evidence.source, "fit": plain, "asymmetry": asymmetry}


def plain_drive(design: Design) -> PlainData:
    """Constants of machine and inverter in SI units, whatever keys the design gave them by; limits and settings."""
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


def _plain_points(points: OperatingPoints) -> PlainData:
    return {
        "torque_Nm": points.torque,
        "i_d_A": points.i_d,
        "i_q_A": points.i_q,
        "limited": points.limited,
        "held_by_data": points.held,
        "torque_residual_largest": float(np.max(np.abs(points.torque_residual))),
    }


def plain_curves(curves: Curves) -> PlainData:
    """Operating points over torque."""
    return {
        "chosen": _plain_points(curves.chosen),
        "id0": None if curves.id0 is None else _plain_points(curves.id0),
        "base": None if curves.base is None else {"current_A": curves.base.current, "torque_Nm": curves.base.torque},
    }


def _plain_polynomial(polynomial: PiecewisePolynomial | None) -> PlainData | None:
    if polynomial is None:
        return None
    return {"edges_Nm": polynomial.edges, "coefficients_local": polynomial.coefficients}


def plain_fit(
    fit: ReferenceFit,
    rows: tuple[Alternative, ...],
    trials: tuple[Trial, ...] = (),
    certificate: Certificate | None = None,
    data: DataUse = COVERED,
) -> PlainData:
    """The fit in double, its emitted constants, its errors found and proven, and the alternatives with theirs."""
    return {
        "form": fit.form,
        "method": fit.settings.method,
        "degree": fit.settings.degree,
        "segments": fit.settings.segments,
        "torque_max_Nm": fit.torque_max,
        "d": _plain_polynomial(fit.d),
        "q": _plain_polynomial(fit.q),
        "reference": to_plain(fit.reference),
        "errors": asdict(fit.errors),
        "certificate": plain_certificate(certificate),
        **plain_data_use(data),
        "trials": [asdict(trial) for trial in trials],
        "alternatives": [{"label": row.label, "errors": asdict(row.errors)} for row in rows],
    }


def _plain_loop(gains: LoopGains, bases: tuple[float, float], q_formats: QFormats | None) -> PlainData:
    kp_pu, ki_ts_pu = per_unit(gains, *bases)
    integers, found = {}, pi_integers(kp_pu, ki_ts_pu, q_formats)
    if found is not None:
        kp, ki_ts = found
        integers = {"kp_q": kp.mantissa, "ki_ts_q": ki_ts.mantissa, "q_formats": (kp.shift, ki_ts.shift)}
    return {
        "method": gains.method,
        "kp": gains.kp,
        "ki": gains.ki,
        "t_s": gains.t_s,
        "ki_ts": gains.ki_ts,
        "t_i_s": gains.t_i,
        "q0": gains.velocity[0],
        "q1": gains.velocity[1],
        "anti_windup_per_s": gains.anti_windup,
        "kp_pu": kp_pu,
        "ki_ts_pu": ki_ts_pu,
        **integers,
        "crossover_rad_per_s": gains.crossover,
        "phase_margin_rad": gains.phase_margin,
        "gain_margin": gains.gain_margin,
        "delay_margin_s": gains.delay_margin,
        "max_sensitivity": gains.max_sensitivity,
        "poles": [[pole.real, pole.imag] for pole in gains.poles.tolist()],
        **plain_observed(gains),
    }


def plain_gains(design: Design, gains: GainSet) -> PlainData:
    """Gains of each loop with their margins; None where the design has no such loop."""
    control = design.control
    current = (control.bases.current, control.bases.voltage)
    speed = None
    if gains.speed is not None and control.speed_loop is not None:
        bases = (control.bases.speed, control.bases.torque)
        speed = _plain_loop(gains.speed, bases, control.speed_loop.q_formats)
    return {
        "i_d": _plain_loop(gains.i_d, current, control.current_loop.q_formats),
        "i_q": _plain_loop(gains.i_q, current, control.current_loop.q_formats),
        "speed": speed,
        "observer": None if gains.observer is None else asdict(gains.observer),
        "position": None if gains.position is None else plain_position(gains.position),
        "bases": asdict(control.bases),
        **plain_robustness(gains.robust),
        **plain_schedule(gains.schedule),
    }


def plain_losses(comparison: LossComparison | None) -> PlainData | None:
    """One row per point, strategy and modulator."""
    if comparison is None:
        return None
    budget = comparison.budget
    rows = [
        {
            "torque_Nm": point.torque,
            "omega_m_rad_per_s": point.omega_m,
            "strategy": strategy,
            "modulation": modulation,
            "copper_W": budget.copper[index],
            "conduction_W": budget.conduction[index],
            "switching_W": budget.switching[index],
            "ripple_copper_W": budget.ripple_copper[index],
            "iron_W": budget.iron[index],
            "ripple_iron_W": budget.ripple_iron[index],
            "magnet_W": budget.magnet[index],
            "dead_time_W": budget.dead_time[index],
            "capacitor_W": budget.capacitor[index],
            "total_W": budget.total[index],
            "junction_degC": budget.junction_temperature[index],
            "voltage_V": budget.voltage[index],
            "friction_W": budget.friction[index],
            "feasible": comparison.usable[index],
            "reached": comparison.reached[index],
            "saving_percent": comparison.saving[index],
        }
        for p, point in enumerate(comparison.points)
        for s, strategy in enumerate(comparison.strategies)
        for m, modulation in enumerate(comparison.modulations)
        for index in [(s, m, p)]
    ]
    best = [None if labels is None else list(labels) for labels in comparison.best_labels]
    return {"scope": comparison.scope, "rows": rows, "best": best}


def plain_weakening_fit(fit: WeakeningFit | None) -> PlainData | None:
    """Domain, errors and trials of the two-dimensional reference."""
    if fit is None:
        return None
    region = fit.region
    return {
        "omega_m_rad_per_s": fit.settings.omega_m,
        "flux_min_Wb": region.flux_min,
        "flux_max_Wb": region.flux_max,
        "torque_max_Nm": region.torque_max,
        "v_max_V": fit.domain.v_max,
        "omega_e_rad_per_s": fit.domain.omega_e,
        "r_s_Ohm": fit.domain.machine.r_s,
        "coefficients": fit.step.coefficients,
        "flash_B": fit.step.flash,
        "errors": asdict(fit.errors),
        "voltage_errors": asdict(fit.voltage),
        "certificate": plain_certificate(fit.certificate),
        "trials": [asdict(trial) for trial in fit.trials],
    }


def _plain_fixed(solution: Solution) -> PlainData:
    """Control functions in fixed point with their evidence; nothing where none are asked for."""
    if not solution.fixed:
        return {}
    evidence = {fit.control.format: plain_fixed_evidence(fit) for fit in solution.fixed}
    headers = {f"control_{fit.control.format}_header": plain_fixed_control(fit.control) for fit in solution.fixed}
    return {"control_fixed": evidence} | headers


def plain_negative(half: NegativeHalf | None) -> PlainData:
    """Currents and fit of negative torques, mirrored; nothing where one reference serves both signs."""
    if half is None:
        return {}
    return {
        "mtpa_negative": plain_curves(half.curves),
        "fit_negative": plain_fit(half.fit, (), (), half.certificate),
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
        "fit": plain_fit(solution.fit, solution.alternatives, solution.trials, solution.certificate, solution.data),
        **plain_negative(solution.negative),
        "gains": None if gains is None else plain_gains(design, gains),
        **({} if gains is not None else {"gains_left_out": solution.gains_left_out}),
        "losses": plain_losses(solution.losses),
        "mission": None if solution.mission is None else plain_mission(solution.mission),
        "waveforms": None if solution.waveforms is None else plain_waveforms(solution.waveforms),
        "waveform_header": None if solution.phases is None else plain_phase_reference(solution.phases.reference),
        "weakening": plain_weakening_fit(weakening),
        "weakening_header": None if weakening is None else plain_weakening(weakening.step),
        "control_header": plain_control(solution) if "float32" in design.export.control else None,
        **_plain_fixed(solution),
        "modulation_choice": None if solution.choice is None else plain_choice(solution.choice),
        "modulation_header": None if solution.choice is None else plain_emitted(choice_model(solution.choice)),
        "gains_header": None if schedule is None else plain_evaluator(schedule.fit.evaluator),
        "observer_header": None if observer is None else plain_observer(observer),
        "speed_observer_header": plain_speed_observer(design.machine, None if gains is None else gains.observer),
    }
