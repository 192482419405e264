"""What dead time leaves of the linear range where the duty cycles make up for it.

In each gap of a carrier period, t_d long, the current chooses the rail: a phase that switches loses
the voltage t_d f_sw v_dc against its current. A controller that makes up for it commands u +
sign(i) t_d f_sw in the place of the duty cycle u, which must stay between the rails. A phase that
rests at a rail has no gaps and needs nothing.

Source: derived; the voltage lost is that of R. B. Sepe, J. H. Lang, "Inverter nonlinearities and
discrete-time vector current control", IEEE Transactions on Industry Applications 30(1), 1994
(quoted without the paper at hand).
"""

from __future__ import annotations

import math
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.machine_batch import BATCHES, MachineOrBatch
from dqforge.machines.modulation.registry import INSCRIBED, MODULATORS, SIX_STEP, overmodulated
from dqforge.machines.modulation.ripple import inverse_inductance
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair


def dead_time_factor(name: ModulationName, dead_time: ArrayLike, f_sw: ArrayLike) -> FloatArray:
    """Linear range with compensated dead time over that without, for any direction of the currents.

    ::

        continuous       1 - 2 t_d f_sw    two phases switch at the limit, in opposite directions
        discontinuous    1 - t_d f_sw      the third rests at its rail

    The line-to-line duty cycle of two phases that switch reaches 1 - 2 t_d f_sw where their
    currents flow against it, as they do in motoring; more in generating, which is not counted on.

    Args:
        name: The modulator.
        dead_time, f_sw: Dead time t_d in s and carrier frequencies in Hz, broadcast to the shape
            (...).

    Returns:
        0 where the dead time takes the whole period.
    """
    gaps = 1.0 if MODULATORS[name].rests else 2.0
    lost = gaps * np.asarray(dead_time, dtype=np.float64) * np.asarray(f_sw, dtype=np.float64)
    return np.asarray(np.maximum(1.0 - lost, 0.0))


# Low harmonics of overmodulation: of the phase voltage, and the currents, the torque ripple and
# the copper loss that they make.
#
# A vector that turns steadily makes one on the hexagon with the harmonics 5, 7, 11, 13 ... of the
# phase voltage; in rotor coordinates these are 6, 12 ... times the fundamental frequency. At
# constant speed, with the controllers taken to leave them alone, they drive::
#
#     v_k = (R + j 6 k omega_e L + omega_e J L) i_k,     J = (0 -1; 1 0)
#
# with the incremental inductances L, and the torque is 3/2 p (psi_d i_q - psi_q i_d) of flux and
# currents with their ripple, without linearisation. All of the waveform is taken, not single
# harmonics.

ORDERS = (5, 7, 11, 13, 17, 19)  # Orders of the phase voltage that are told by number.

# Angles in the 60 degrees after which everything repeats.
_ANGLES = 720

# Operating points at once: some arrays of 256 x 720 x 2 numbers are 3 MB each.
_CHUNK = 256

# A point on the voltage limit exceeds it by what its solver leaves.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class LowHarmonics:
    """What overmodulation adds at operating points, arrays of shape (N,) unless noted.

    Zero within the linear range, NaN beyond six-step operation.

    Args:
        index: Fundamental of the phase voltage over that of six-step operation.
        voltage: Amplitudes of the orders `ORDERS` of the phase voltage in V (peak), shape (N, 6).
        distortion: R.m.s. of all harmonics of the phase voltage over that of the fundamental.
        current: Root mean square in A of the harmonics of a phase current.
        peak_current: Largest length in A of the current vector with its harmonics.
        torque: Peak-to-peak torque in N m.
        torque_6, torque_12: Amplitudes in N m of the torque at 6 and 12 times the fundamental
            frequency.
        copper: Copper loss in W of the harmonics, with the resistance of the fundamental.
    """

    index: FloatArray
    voltage: FloatArray
    distortion: FloatArray
    current: FloatArray
    peak_current: FloatArray
    torque: FloatArray
    torque_6: FloatArray
    torque_12: FloatArray
    copper: FloatArray


def waveform(name: OvermodulationName, share: FloatArray) -> NDArray[np.complex128]:
    """Vectors made, over v_dc and seen from the asked one, at 720 angles in 60 degrees.

    Args:
        name: The method.
        share: Fundamentals over v_dc, shape (N,).

    Returns:
        With the mean of the fundamental; angles at the middle of equal intervals from -30 degrees
        off a side's middle on.
    """
    angle = (np.arange(_ANGLES) + 0.5) * (math.pi / 3.0 / _ANGLES)
    turn = np.exp(1j * angle)
    asked = np.minimum(share, SIX_STEP)[:, None] * turn
    x, y = overmodulated(name, Pair(asked.real, asked.imag), np.ones(asked.shape))
    return np.asarray((x + 1j * y) * np.conj(turn))


def voltage_harmonics(name: OvermodulationName, share: ArrayLike) -> FloatArray:
    """Amplitudes over v_dc of the orders `ORDERS` of the phase voltage, shape (N, 6).

    Args:
        name: The method.
        share: Fundamentals over v_dc, shape (N,).
    """
    wave = waveform(name, np.asarray(share, dtype=np.float64))
    bins = np.fft.fft(wave, axis=-1) / _ANGLES
    # the order 6 k + 1 turns forwards, 6 k - 1 backwards
    places = [order // 6 if order % 6 == 1 else -((order + 1) // 6) for order in ORDERS]
    return np.asarray(np.abs(bins[:, places]))


def low_harmonics(
    name: OvermodulationName,
    machine: MachineOrBatch,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    *,
    v_dc: float,
    voltage: tuple[FloatArray, FloatArray] | None = None,
) -> LowHarmonics:
    """What overmodulation adds at operating points.

    Args:
        name: The method; with ``none`` everything is zero.
        machine: Any machine, or one per point; a saturated one is linearised at the operating
            point.
        i_d, i_q, omega_m: Currents in A (peak) and mechanical speed in rad/s, broadcastable to N
            points; NaN where there is none.
        v_dc: DC-link voltage in V.
        voltage: v_d and v_q at the terminals in V, shape (N,) each; those of the currents and the
            machine's resistance when None.
    """
    d, q, omega = (
        np.ravel(value)
        for value in np.broadcast_arrays(
            *(np.asarray(value, dtype=np.float64) for value in (i_d, i_q, omega_m))
        )
    )
    v_d, v_q = machine.voltage(d, q, machine.pole_pairs * omega) if voltage is None else voltage
    share = np.hypot(v_d, v_q) / v_dc
    empty: dict[str, FloatArray] = {
        part.name: np.where(share <= SIX_STEP * (1.0 + _ROUNDING), 0.0, np.nan)
        for part in fields(LowHarmonics)
    }
    empty["voltage"] = np.repeat(empty["voltage"][:, None], len(ORDERS), axis=1)
    empty["index"] = share / SIX_STEP
    empty["peak_current"] = empty["peak_current"] + np.hypot(d, q)
    beyond = (share > INSCRIBED) & (share <= SIX_STEP * (1.0 + _ROUNDING))
    (places,) = np.nonzero(beyond & (name != "none"))
    for start in range(0, places.size, _CHUNK):
        part = places[start : start + _CHUNK]
        points = np.stack([d[part], q[part], omega[part]])
        direction = np.arctan2(v_q[part], v_d[part])
        here = machine.taken(part) if isinstance(machine, BATCHES) else machine
        found = _harmonics(name, here, points, share[part], direction, v_dc)
        for key, values in found.items():
            empty[key][part] = values
    return LowHarmonics(**empty)


def _harmonics(
    name: OvermodulationName,
    machine: MachineOrBatch,
    points: FloatArray,
    share: FloatArray,
    direction: FloatArray,
    v_dc: float,
) -> dict[str, FloatArray]:
    """Fields of `LowHarmonics` for rows i_d, i_q, omega_m (3, N), all beyond the linear range."""
    wave = v_dc * waveform(name, share)
    mean = np.mean(wave, axis=-1, keepdims=True)
    ripple = _current_ripple(machine, points, (wave - mean) * np.exp(1j * direction)[:, None])
    torque = _torque(machine, points, ripple)
    bins = 2.0 * np.abs(np.fft.rfft(torque, axis=-1)) / _ANGLES
    square = np.mean(np.sum(ripple**2, axis=1), axis=-1)
    whole = points[:2].T[:, :, None] + ripple
    return {
        "voltage": v_dc * voltage_harmonics(name, share),
        "distortion": np.sqrt(np.mean(np.abs(wave - mean) ** 2, axis=-1)) / np.abs(mean[:, 0]),
        "current": np.sqrt(0.5 * square),
        "peak_current": np.max(np.hypot(whole[:, 0], whole[:, 1]), axis=-1),
        "torque": np.ptp(torque, axis=-1),
        "torque_6": bins[:, 1],
        "torque_12": bins[:, 2],
        "copper": 1.5 * machine.r_s * square,
    }


def _current_ripple(
    machine: MachineOrBatch, points: FloatArray, voltage: NDArray[np.complex128]
) -> FloatArray:
    """Ripple of i_d and i_q in A, shape (N, 2, 720), for harmonic voltages v_d + j v_q in V
    (N, 720).
    """
    omega_e = machine.pole_pairs * points[2]
    inductance = np.linalg.inv(inverse_inductance(machine, points[0], points[1]))
    across = omega_e[:, None, None] * (np.array([[0.0, -1.0], [1.0, 0.0]]) @ inductance)
    stack = np.stack([voltage.real, voltage.imag], axis=-1)
    bins = np.fft.rfft(stack, axis=1)
    order = 6.0 * np.arange(bins.shape[1])[:, None, None]
    matrix = (
        np.asarray(machine.r_s)[..., None, None, None] * np.eye(2)
        + across[:, None]
        + 1j * order * (omega_e[:, None, None] * inductance)[:, None]
    )
    bins[:, 0] = 0.0
    currents = np.linalg.solve(matrix, bins[..., None])[..., 0]
    return np.asarray(np.swapaxes(np.fft.irfft(currents, _ANGLES, axis=1), 1, 2))


def _torque(machine: MachineOrBatch, points: FloatArray, ripple: FloatArray) -> FloatArray:
    """Torque in N m, shape (N, 720), with the flux linearised at the points (3, N)."""
    inductance = np.linalg.inv(inverse_inductance(machine, points[0], points[1]))
    flux = np.stack(machine.flux(points[0], points[1]), axis=-1)[:, :, None] + inductance @ ripple
    current = points[:2].T[:, :, None] + ripple
    factor = 1.5 * np.asarray(machine.pole_pairs)[..., None]
    return np.asarray(factor * (flux[:, 0] * current[:, 1] - flux[:, 1] * current[:, 0]))
