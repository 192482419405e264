"""The documentation's figures of machines whose back-EMF is not sinusoidal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.back_emf.capture import analyse
from dqforge.machines.back_emf.columns import BemfCapture
from dqforge.machines.design import catalogue
from dqforge.optimizer.waveforms.comparison import compare_waveforms
from dqforge.reports.back_emf import CaptureReading, plot_capture
from dqforge.reports.pages.figures_style import save
from dqforge.reports.waveforms.figures import plot_waveforms

_TORQUE_NM, _NEUTRAL_A = 3.5, 1.0

_POLE_PAIRS = 2
_SAMPLING_HZ = 4000.0
_SAMPLES = 1600
_FREQUENCY_HZ, _DRIFT = 25.0, -0.04
_NOISE = 0.02
_BITS = 10
_RANGE_V = 50.0
# Order, amplitude in Wb, phase in rad.
_HARMONICS = ((1, 0.2233, 0.0), (3, 0.0268, 0.0), (5, 0.0067, 0.3), (7, 0.0022, -0.5))


def phase_waveforms(path: Path) -> None:
    """Currents of the machine of paper 002 by every rule, their torque and harmonics;
    a limit on the neutral binds.
    """
    design = catalogue.load("paper002-phase-waveforms")
    settings = replace(design.waveform, torque=_TORQUE_NM, neutral=_NEUTRAL_A)
    save(plot_waveforms(compare_waveforms(design, settings)), path)


def capture(path: Path) -> None:
    """A capture with noise, drift and the steps of a converter, and the harmonics that are found in
    it.
    """
    synthetic = _synthetic()
    reading = CaptureReading(
        "capture.csv", synthetic, analyse(synthetic, pole_pairs=_POLE_PAIRS), _POLE_PAIRS
    )
    save(plot_capture(reading), path)


def _synthetic() -> BemfCapture:
    """Three phases of a machine that slows down evenly, as an oscilloscope records them."""
    time = np.arange(_SAMPLES) / _SAMPLING_HZ
    slowing = _DRIFT / time[-1]
    omega = 2.0 * np.pi * _FREQUENCY_HZ * (1.0 + slowing * (time - 0.5 * time[-1]))
    theta = 0.7 + 2.0 * np.pi * _FREQUENCY_HZ * (time + 0.5 * slowing * time * (time - time[-1]))
    turns = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    shape = -sum(size * np.sin(order * turns - lag) for order, size, lag in _HARMONICS)
    peak = _HARMONICS[0][1] * 2.0 * np.pi * _FREQUENCY_HZ
    noise = np.random.default_rng(2).normal(0.0, _NOISE * peak, shape.shape)
    step = 2.0 * _RANGE_V / 2**_BITS
    voltages = step * np.round((omega * shape + noise) / step)
    return BemfCapture("capture.csv", time, None, voltages, np.arange(2, _SAMPLES + 2))
