"""Figures of the page on the estimators by model, injection and third harmonic."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.observers.methods.ekf import (
    DriveNoise,
    innovations,
    noisy_trial,
    tuned_ekf,
)
from dqforge.optimizer.observers.methods.matsui_model import closed_form_error, matsui, with_errors
from dqforge.optimizer.observers.sampled_machine import CurrentSensor
from dqforge.optimizer.saliency.inform import track
from dqforge.optimizer.saliency.sampled_injection import cross_saturation_error, injection
from dqforge.reports.pages.figures_style import MUTED, new_figure, save, style

_I_REF = (0.0, 2.0)


@style()
def estimators(path: Path) -> None:
    """Mean NIS of 20 drives in its band; Matsui's errors over the speed; the saliency tracker,
    and saturation.
    """
    design = catalogue.load("paper001-pmsm-bench")
    machine, t_s = linearised(design.machine), design.control.t_s
    figure = new_figure(
        "estimators-page", 5.2, "Kalman filter, Matsui's models and injection", arranged=True
    )
    upper, lower = figure.subplots(2, 2)

    noise = DriveNoise(CurrentSensor(12, 8.0, 0.004), 1.0, 400.0)
    tuned = tuned_ekf(machine, t_s, noise, 600.0, np.array(_I_REF))
    trial = noisy_trial(machine, t_s, noise, 600.0, np.array(_I_REF), 500, 20, 1000)
    times = t_s * np.arange(1, 501) * 1e3
    erring = innovations(tuned.model, trial)
    for label, filter_ in (
        ("tuned", tuned),
        ("$q_i$ ten times too large", replace(tuned, q_i=10.0 * tuned.q_i)),
    ):
        upper[0].plot(times, np.mean(erring(filter_).nis, axis=1), linewidth=0.8, label=label)
    for edge in chi2.ppf([0.025, 0.975], 40) / 20.0:  # of the mean of 20 drives
        upper[0].axhline(edge, color=MUTED, linewidth=0.8, linestyle="--")
    upper[0].set(
        xlabel="Time in ms", ylabel="NIS, mean of 20 drives", title="Kalman filter", ylim=(0.0, 4.6)
    )
    upper[0].legend()

    speeds = np.linspace(60.0, 1700.0, 60)
    surface = replace(machine, l_d=machine.l_q)
    for kind in ("voltage", "current"):
        for label, errors in (("R + 10 %", {"r_s": 0.1}), ("L + 10 %", {"l_d": 0.1, "l_q": 0.1})):
            observer = matsui(with_errors(surface, **errors), t_s, kind, 1000.0)
            theta = [closed_form_error(observer, surface, float(w), _I_REF).theta for w in speeds]
            upper[1].plot(speeds, np.degrees(theta), label=f"{kind} model, {label}")
    upper[1].set(
        xlabel="Electrical speed in rad/s",
        ylabel="Angle error in deg",
        title="Matsui's models",
        ylim=(-0.76, 0.45),
    )
    upper[1].legend()

    ipm = linearised(catalogue.load("paper000-ipmsm-100kw").machine)
    tracker = injection(ipm, 1e-4, 60.0, 120.0)
    omega = np.concatenate([np.zeros(300), np.linspace(0.0, 150.0, 601)])[:, np.newaxis]
    result, seen = track(
        tracker, ipm, omega, (0.0, 50.0), theta_error=0.4, sensor=CurrentSensor(12, 350.0, 0.2)
    )
    lower[0].plot(np.arange(901) * 0.1, np.degrees(result.angle_error(seen)[:, 0]))
    lower[0].set(
        xlabel="Time in ms",
        ylabel="Angle error in deg",
        title="Injection, 30 ms standstill, then a ramp",
    )

    saturated = catalogue.load("abb-syrm-6k7-saturated").machine
    i_q = np.linspace(0.0, 20.0, 41)
    for i_d in (6.0, 12.0):
        error = cross_saturation_error(saturated, np.full_like(i_q, i_d), i_q)
        lower[1].plot(i_q, np.degrees(error), label=f"$i_d$ = {i_d:g} A")
    lower[1].set(
        xlabel="$i_q$ in A", ylabel="Angle error in deg", title="Injection, cross saturation"
    )
    lower[1].legend()
    save(figure, path)
