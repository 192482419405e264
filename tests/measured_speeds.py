"""Drives whose speed comes from the edges of an encoder, and edges of a turning shaft."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drives import SURFACE, make_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings, SpeedMeasurementSettings
from dqforge.machines.names import SpeedMeasurementName

# Encoder and timer of paper 001.
METHODS: tuple[SpeedMeasurementName, ...] = ("counts", "capture", "mixed")
THESIS = SpeedMeasurementSettings("capture", 1024, 1.0 / 33.9e-9, 16, 1, 10.0)


def settings(
    method: SpeedMeasurementName, lines: int = 1024, lowest: float = 20.0
) -> SpeedMeasurementSettings:
    """An encoder with a timer of 10 MHz and 16 bits."""
    edges, clock = (4, 0.0) if method == "counts" else (1, 1e7)
    return SpeedMeasurementSettings(method, lines, clock, 16, edges, lowest)


def design(own: SpeedMeasurementSettings | None, loop: SpeedLoopSettings | None = None) -> Design:
    """A surface-magnet drive with a speed loop on that measurement."""
    base = make_design(SURFACE)
    speed = replace(loop or SpeedLoopSettings(), measurement=own)
    return replace(base, control=replace(base.control, speed_loop=speed, observer=None))


def edge_instants(
    own: SpeedMeasurementSettings, theta_m: FloatArray, time: FloatArray
) -> FloatArray:
    """Instants in s at which a shaft that turns forward passes the edges, by linear interpolation
    of its angle in rad at dense times, both shape (N,).
    """
    pitch = 2.0 * np.pi / (own.lines * own.edges)
    first, last = np.floor(theta_m[0] / pitch) + 1.0, np.floor(theta_m[-1] / pitch)
    return np.asarray(np.interp(np.arange(first, last + 1.0) * pitch, theta_m, time))
