"""The closed loops of paper 002 in tables: the circuit of the thesis beside others."""

from __future__ import annotations

import numpy as np

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper002_loops.closed_loops import RPM, LoopRun
from dqforge.reports.papers.paper002_loops.diode_path import DiodePath
from dqforge.reports.papers.paper002_loops.loop_cases import BANDWIDTH, SPEED_BANDWIDTH
from dqforge.reports.papers.paper002_loops.loss_ratios import LoopRatio

_TITLE = "Paper 002, Figures 6.9 to 6.17 with the emitted C in the loop: 750 rpm, 1 N m"


def _row(run: LoopRun) -> tuple[str, ...]:
    _, least, largest = run.i_qy
    return (
        run.case.circuit,
        run.case.controller,
        run.case.shown or "-",
        f"{run.torque:.3f}",
        f"{100.0 * run.ripple_averaged:.2f}",
        f"{100.0 * run.ripple_means:.2f}",
        f"{100.0 * run.ripple:.0f}",
        f"{least:.2f} to {largest:.2f}",
        f"{run.neutral_rms:.3f}",
        f"{run.zero_third:.3f}",
        f"{run.phase_rms:.3f}",
    )


def _currents(runs: tuple[LoopRun, ...]) -> Table:
    return Table(
        _TITLE,
        (
            "circuit",
            "controller",
            "Figure",
            "T N m",
            "p-p %, averaged",
            "p-p %, per PWM period",
            "p-p %, with PWM",
            "i_qy A",
            "i_n A r.m.s.",
            "i_0, order 3 A",
            "i_a A r.m.s.",
        ),
        tuple(_row(run) for run in runs),
        (
            "dqy runs on diodes on purpose: designs refuse it there. Averaged: no dead time.",
            "Torque ripple p-p of 1 N m: averaged inverter; means of PWM periods; every instant.",
            f"Dead time 1 us (inferred); {BANDWIDTH:.0f} Hz per axis (chosen: none are printed).",
        ),
    )


def _path(path: DiodePath, runs: tuple[LoopRun, ...]) -> Table:
    rows = tuple(
        (
            f"{run.case.circuit}, {run.case.controller}",
            f"{run.neutral_rms:.3f}",
            _asked(run.asked),
        )
        for run in runs
        if run.case.frame != "dqx" and run.case.plant != "three-wire"
    )
    return Table(
        "Paper 002, Figures 6.13 and 6.15: the neutral current, and why Figure 5.4 cannot carry it",
        ("", "i_n A r.m.s.", "v_0 asked for, mean of a period, V: at 0.3 s, at 1.2 s"),
        (("by dqy at 1 N m, 750 rpm", f"{path.neutral_rms:.3f}", "-"), *rows),
        (
            "A current out of the neutral takes the upper diode: no phase voltage above 0.",
            (
                "Into it: none below 0. What dqy needs keeps that in "
                f"{100.0 * path.share:.0f} % of the period, {path.short:.0f} V beyond or more."
            ),
            "What flows is left over by the PWM; what the controller asks for grows without end.",
        ),
    )


def _asked(asked: tuple[float, float]) -> str:
    return f"{asked[0]:+.2f}, {asked[1]:+.2f}" if np.isfinite(asked[0]) else "-"


def _step(runs: tuple[LoopRun, ...]) -> Table:
    return Table(
        "Paper 002, Figure 6.18: load step from 0 to 1 N m at 750 rpm",
        ("circuit", "controller", "slowed by rpm", "after ms"),
        tuple(
            (
                run.case.circuit,
                run.case.controller,
                f"{run.dip / RPM:.1f}",
                f"{1e3 * run.dip_after:.0f}",
            )
            for run in runs
        ),
        (
            f"Inertia (inferred) and speed loop ({SPEED_BANDWIDTH:.0f} rad/s, chosen) decide it,",
            "alike with every controller: the curve of the thesis tells nothing of dqy.",
        ),
    )


def _ratios(ratios: tuple[LoopRatio, ...], closed: dict[str, float]) -> Table:
    return Table(
        "Paper 002, section 3.4: copper loss of dqx over dqy at the same constant torque",
        ("back-EMF", "closed form", "emitted C on four legs, averaged", "torques N m"),
        tuple(
            (
                row.shape,
                f"{closed[row.shape]:.4f}",
                f"{row.ratio:.4f}",
                ", ".join(f"{torque:.4f}" for torque in row.torques),
            )
            for row in ratios
        ),
    )


def loop_tables(
    runs: tuple[LoopRun, ...],
    path: DiodePath,
    ratios: tuple[LoopRatio, ...],
    closed: dict[str, float],
) -> list[Table]:
    """Tables of the closed loops; ``closed`` are the loss ratios by closed form."""
    return [_currents(runs), _path(path, runs), _step(runs), _ratios(ratios, closed)]


def left_out_table(reason: str) -> Table:
    """What stands in their place where nothing could be run."""
    return Table(
        _TITLE,
        notes=(f"Missing: {reason}.", "Figures 6.9 to 6.18 are then those of the definitions."),
    )
