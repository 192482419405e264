"""Points at constant speed, simulated on a measured flux map with everything that goes wrong on a
bench: warming, dead time, a turned encoder, iron, offsets, noise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import RectBivariateSpline

from dqforge.machines.arrays import ComplexArray, FloatArray
from dqforge.optimizer.identification.flux_points import FluxRows

POLE_PAIRS = 2
TRUTH = {
    "resistance": 0.63,
    "inverter_voltage": 1.2,
    "encoder_angle": np.deg2rad(0.5),
    "iron_conductance": 1.0 / 900.0,
}
OFFSET = 0.1 + 0.05j
NOISE_V = 0.05


class MeasuredMap:
    """The Baldor map of motulator (MIT), symmetrised, between its points by cubic splines."""

    def __init__(self, data: Path) -> None:
        with np.load(data / "fluxmaps/baldor_400rpm_map.npz") as found:
            self.current: ComplexArray = found["i_s_dq"]
            flux: ComplexArray = found["psi_s_dq"]
        i_d, i_q = self.current[:, 0].real, self.current[0].imag
        self._d = RectBivariateSpline(i_d, i_q, flux.real)
        self._q = RectBivariateSpline(i_d, i_q, flux.imag)

    def flux(self, current: ComplexArray) -> ComplexArray:
        """Flux linkages in V s."""
        return np.asarray(
            self._d.ev(current.real, current.imag) + 1j * self._q.ev(current.real, current.imag)
        )


def simulated(
    machine: MeasuredMap,
    seed: int,
    *,
    rpm: tuple[float, ...] = (400.0,),
    motoring: bool = False,
    smooth: float = 0.02,
) -> FluxRows:
    """All points of the map but its rim, in the order of the grid, once at each speed.

    The winding warms from 20 to about 75 degC over each run.
    """
    grid = machine.current[1:-1, 1:-1].ravel()
    rng = np.random.default_rng(seed)
    parts = []
    for place, speed in enumerate(rpm):
        chosen = grid[grid.imag * speed >= 0.0] if motoring else grid
        omega_e = np.full(chosen.size, POLE_PAIRS * speed * np.pi / 30.0)
        temperature = 20.0 + 55.0 * (1.0 - np.exp(-np.linspace(0.0, 3.0, chosen.size)))
        voltage = terminal_voltage(machine, chosen, omega_e, temperature, smooth)
        noise = rng.normal(0.0, NOISE_V, chosen.size) + 1j * rng.normal(0.0, NOISE_V, chosen.size)
        parts.append((np.full(chosen.size, place), chosen, voltage + noise, omega_e, temperature))
    series, current, voltages, omega, warm = (
        np.concatenate(each) for each in zip(*parts, strict=True)
    )
    names = tuple(f"{speed:g} rpm" for speed in rpm)
    return FluxRows(names, series, current, voltages, omega, warm)


def terminal_voltage(
    machine: MeasuredMap,
    measured: ComplexArray,
    omega_e: FloatArray,
    temperature: FloatArray,
    smooth: float,
) -> ComplexArray:
    """Voltage in the frame of the encoder at currents that are measured in it."""
    turn = np.exp(1j * TRUTH["encoder_angle"])
    current = measured * turn
    warm = TRUTH["resistance"] * (1.0 + 0.00393 * (temperature - 20.0))
    through = current
    for _ in range(30):
        emf = 1j * omega_e * machine.flux(through)
        through = current - TRUTH["iron_conductance"] * emf
    small = smooth * float(np.abs(measured).max())
    along = current / np.hypot(np.abs(current), small)
    voltage = warm * current + emf + TRUTH["inverter_voltage"] * along
    return np.asarray(voltage / turn + OFFSET)
