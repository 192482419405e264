"""How much torque the asymmetry of a flux map is, and the turned frame that removes it.

An angle sensor that is misaligned by an angle gives currents and flux linkages turned by it, which
makes a machine with equal halves look asymmetric; what no turn removes is the machine's or the
measurement's own.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import torque_from_flux
from dqforge.machines.flux_maps.evidence import FluxAsymmetry
from dqforge.machines.names import FluxSymmetry

_WIDEST = np.radians(20.0)


_ANGLES = 3601


_RADII, _DIRECTIONS = np.linspace(0.1, 0.85, 12), 72


def in_turned_frame(
    angle: float, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Vectors in a frame that is turned by ``angle`` rad, from those in the old one."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * first + sine * second, cosine * second - sine * first


def turned_flux(
    whole: FluxMap, angle: float, i_d: FloatArray, i_q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Flux linkages in Wb at currents in A, all in a frame turned by ``angle``
    rad from that of the map.
    """
    return in_turned_frame(angle, *whole.flux(*in_turned_frame(-angle, i_d, i_q)))


def _test_points(whole: FluxMap) -> tuple[FloatArray, FloatArray]:
    """Currents in A inside the data whatever the turn: rings about zero current, i_q >= 0,
    shape (K,).
    """
    reach = min(float(whole.i_q[-1]), max(-float(whole.i_d[0]), float(whole.i_d[-1])))
    direction = np.linspace(0.0, np.pi, _DIRECTIONS)
    i_d = (reach * _RADII[:, np.newaxis] * np.cos(direction)).ravel()
    i_q = (reach * _RADII[:, np.newaxis] * np.sin(direction)).ravel()
    room = 0.1 * reach
    kept = (i_d >= whole.i_d[0] + min(room, -float(whole.i_d[0]))) & (
        i_d <= whole.i_d[-1] - min(room, float(whole.i_d[-1]))
    )
    return i_d[kept], i_q[kept]


def _apart(whole: FluxMap, angle: float, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Half the distances of mirrored points in a turned frame, in Wb, shape (2, K)."""
    upper, lower = turned_flux(whole, angle, i_d, i_q), turned_flux(whole, angle, i_d, -i_q)
    return 0.5 * np.stack([upper[0] - lower[0], upper[1] + lower[1]])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=0))))


def frame_angle(whole: FluxMap) -> float:
    """Turn in rad (electrical) within +-20 deg that makes the halves of a
    map the best mirror images.
    """
    from scipy.optimize import minimize_scalar

    i_d, i_q = _test_points(whole)
    coarse = np.linspace(-_WIDEST, _WIDEST, 41)
    sizes = [_rms(_apart(whole, float(angle), i_d, i_q)) for angle in coarse]
    best, step = float(coarse[int(np.argmin(sizes))]), float(coarse[1] - coarse[0])
    found = minimize_scalar(
        lambda angle: _rms(_apart(whole, float(angle), i_d, i_q)) ** 2,
        bounds=(best - step, best + step),
        method="bounded",
        options={"xatol": 1e-7},
    )
    return float(found.x)


def asymmetry_of(
    whole: FluxMap,
    averaged: FluxMap,
    pole_pairs: int,
    current: float,
    current_name: str,
    symmetry: FluxSymmetry,
) -> FluxAsymmetry:
    """Asymmetry of a map over the whole plane that nobody averaged, in torque and in flux linkage.

    Args:
        whole, averaged: The map as measured, and its symmetric part.
        pole_pairs: Number p.
        current, current_name: Amplitude in A (peak) where the torques are compared, and what it is
            called.
        symmetry: What is done about it.
    """
    direction = np.linspace(0.0, np.pi, _ANGLES)
    i_d, i_q = current * np.cos(direction), current * np.sin(direction)
    inside = averaged.inside(i_d, i_q)
    i_d, i_q = (i_d[inside], i_q[inside]) if np.any(inside) else (i_d, i_q)
    best = int(np.argmax(torque_from_flux(pole_pairs, *averaged.flux(i_d, i_q), i_d, i_q)))
    angle = frame_angle(whole)

    def torques(turn: float) -> tuple[float, float, float]:
        upper = torque_from_flux(pole_pairs, *turned_flux(whole, turn, i_d, i_q), i_d, i_q)
        lower = -torque_from_flux(pole_pairs, *turned_flux(whole, turn, i_d, -i_q), i_d, -i_q)
        return float(upper[best]), float(lower[best]), float(np.max(np.abs(upper - lower)))

    grid_d, grid_q = np.meshgrid(whole.i_d, whole.i_q[whole.i_q >= 0.0], indexing="ij")
    largest = float(np.max(np.abs(_apart(whole, 0.0, grid_d.ravel(), grid_q.ravel()))))
    points = _test_points(whole)
    (positive, negative, most), left = torques(0.0), torques(angle)
    return FluxAsymmetry(
        symmetry=symmetry,
        current=current,
        current_name=current_name,
        positive=positive,
        negative=negative,
        torque_most=most,
        largest=largest,
        rms=_rms(_apart(whole, 0.0, *points)),
        angle=angle,
        rms_left=_rms(_apart(whole, angle, *points)),
        torque_left=left[0] - left[1],
        torque_most_left=left[2],
    )
