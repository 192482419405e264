"""Paper 002 as plain data."""

from __future__ import annotations

import math
from dataclasses import asdict

from dqforge.reports.papers.paper002.figure_list import FIGURES
from dqforge.reports.papers.paper002.recomputed import Reproduction
from dqforge.reports.papers.paper002_definitions.back_emf_components import ComponentRow
from dqforge.reports.papers.paper002_definitions.bench_currents import HIGHEST_ORDER, BenchCurves
from dqforge.reports.papers.paper002_definitions.compensation import Compensation
from dqforge.reports.papers.paper002_definitions.misprints import ModelCheck
from dqforge.reports.papers.paper002_loops.closed_loops import LoopRun
from dqforge.reports.plain_data import PlainData


def _component_row(row: ComponentRow) -> PlainData:
    return {
        "shape": row.shape,
        "printed": row.printed,
        "found": row.found,
        "loss_ratio_dqx_over_dqy": row.loss_ratio,
    }


def _drive(curves: BenchCurves) -> PlainData:
    lines = slice(0, HIGHEST_ORDER + 1)
    return {
        "theta_rad": curves.theta,
        "emf_over_omega_Wb": curves.flux,
        "harmonics_emf_Wb": curves.flux_harmonics[lines],
        "theta_x_rad": curves.angles.theta_x,
        "theta_y_rad": curves.angles.theta_y,
        "a_x": curves.angles.a_x,
        "a_y": curves.angles.a_y,
        "current_a_dqx_A": curves.currents[0],
        "current_a_dqy_A": curves.currents[1],
        "harmonics_a_dqx_A": curves.harmonics[0, lines],
        "harmonics_a_dqy_A": curves.harmonics[1, lines],
        "i_qy_A": curves.i_qy,
        "i_qx_A": curves.dqx[1],
        "i_alphabeta0_A": curves.stationary,
        "loss_ratio_dqx_over_dqy": curves.loss_ratio,
    }


def _model(model: ModelCheck) -> PlainData:
    return {
        "agreement": model.agreement,
        "misprints": [asdict(row) for row in model.misprints],
        "reference_ripple": model.reference_ripple,
        "emf_error": model.emf_error,
    }


def _terms(found: Compensation) -> PlainData:
    return {"machine": found.name, "i_qy_A": found.i_qy, "ranges": found.ranges}


def _loop(run: LoopRun) -> PlainData:
    mean, least, largest = run.i_qy
    early, late = run.asked
    case, curves = run.case, run.curves
    return {
        "circuit": case.plant,
        "header_for": case.firmware,
        "frame": case.frame,
        "feedforward": case.feedforward,
        "harmonic_integrators": case.harmonics,
        "in_the_thesis": case.shown or None,
        "torque_Nm": run.torque,
        "ripple_averaged_Nm": run.ripple_averaged,
        "ripple_of_means_Nm": run.ripple_means,
        "ripple_Nm": run.ripple,
        "neutral_rms_A": run.neutral_rms,
        "i_0_rms_A": run.zero_rms,
        "i_0_order_3_A": run.zero_third,
        "i_qy_A": {"mean": mean, "least": least, "largest": largest},
        "phase_rms_A": run.phase_rms,
        "copper_W": run.copper,
        "v_0_asked_V": None if math.isnan(early) else [early, late],
        "dip_rad_per_s": run.dip,
        "dip_after_s": run.dip_after,
        "theta_rad": curves.theta,
        "i_alphabeta0_A": curves.stationary,
        "i_dqy_A": curves.dqy,
        "step_time_s": curves.time,
        "step_torque_Nm": curves.torque,
        "step_speed_rad_per_s": curves.speed,
    }


def plain_reproduction(found: Reproduction) -> PlainData:
    """Tables and curves as plain data."""
    return {
        "figures": [asdict(figure) for figure in FIGURES],
        "table_3_1": [_component_row(row) for row in found.rows],
        "chapter_4": _model(found.model),
        "figure_4_3": [_terms(machine) for machine in found.terms],
        "conditions": [asdict(row) for row in found.conditions],
        "drive": _drive(found.curves),
        "figures_6_9_to_6_16": [asdict(row) for row in found.curve_figures],
        "telling_orders": list(found.telling),
        "diode_path": asdict(found.path),
        "closed_loops": None if found.loops is None else [_loop(run) for run in found.loops.runs],
        "closed_loops_left_out": found.loops_left_out or None,
        "closed_loop_loss_ratios": [asdict(row) for row in found.ratios],
    }
