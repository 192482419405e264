"""A machine whose co-energy over currents and rotor angle is known in closed form, and the map file
that finite elements would give of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray

PAIRS = 3
AXIS_D, AXIS_Q = np.linspace(-30.0, 10.0, 9), np.linspace(0.0, 40.0, 9)

# Two thirds of the co-energy in J: terms i_d^m i_q^n of the mean, and of the
# waves cos 6, sin 6, cos 12 and sin 12 of the electrical angle. Terms that are odd in i_q go with
# sines: the machine is its own mirror image.
MEAN = {(1, 0): 0.11, (2, 0): 0.9e-3, (0, 2): 2.1e-3, (0, 4): -1.5e-7, (1, 2): -6e-6}
WAVES = {
    (6, "cos"): {(0, 0): 8e-3, (1, 0): 9e-4, (2, 0): 6e-6, (0, 2): -9e-6},
    (6, "sin"): {(0, 1): 1.2e-3, (1, 1): 7e-6},
    (12, "cos"): {(0, 0): 2e-3, (1, 0): -1.5e-4},
    (12, "sin"): {(0, 1): 2e-4},
}


def _term(term: tuple[int, int], i_d: FloatArray, i_q: FloatArray, by: str) -> FloatArray:
    m, n = term
    if by == "d":
        return m * i_d ** max(m - 1, 0) * i_q**n
    if by == "q":
        return n * i_d**m * i_q ** max(n - 1, 0)
    return i_d**m * i_q**n


def _sum(i_d: FloatArray, i_q: FloatArray, theta: FloatArray, by: str) -> FloatArray:
    """The function above, or its derivative by i_d, i_q or the electrical angle ('theta')."""
    total = np.zeros(np.broadcast(i_d, i_q, theta).shape)
    if by != "theta":
        for term, factor in MEAN.items():
            total += factor * _term(term, i_d, i_q, by)
    for (order, kind), terms in WAVES.items():
        wave = np.cos(order * theta) if kind == "cos" else np.sin(order * theta)
        if by == "theta":
            slope = -np.sin(order * theta) if kind == "cos" else np.cos(order * theta)
            wave = order * slope
        for term, factor in terms.items():
            total += factor * wave * _term(term, i_d, i_q, by)
    return total


def flux(i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flux linkages in Wb at currents in A and electrical angles in rad."""
    return _sum(i_d, i_q, theta, "d"), _sum(i_d, i_q, theta, "q")


def co_energy(i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> FloatArray:
    """Co-energy in J."""
    return 1.5 * _sum(i_d, i_q, theta, "")


def torque(i_d: FloatArray, i_q: FloatArray, theta: FloatArray) -> FloatArray:
    """Torque in N m."""
    psi_d, psi_q = flux(i_d, i_q, theta)
    return 1.5 * PAIRS * (psi_d * i_q - psi_q * i_d + _sum(i_d, i_q, theta, "theta"))


def rows(
    angles: FloatArray, axis_q: FloatArray = AXIS_Q, zero: float = 0.0
) -> tuple[FloatArray, ...]:
    """Columns i_d, i_q, angle in deg (electrical), psi_d, psi_q, torque; the file's angle is the
    machine's plus ``zero``.
    """
    i_d, i_q, theta = (part.ravel() for part in np.meshgrid(AXIS_D, axis_q, angles, indexing="ij"))
    true = np.radians(theta - zero)
    return (i_d, i_q, theta, *flux(i_d, i_q, true), torque(i_d, i_q, true))


def text(columns: Sequence[FloatArray], titles: Sequence[str], mark: str = ",") -> bytes:
    """A table with these titles; with the mark ';' in German, with decimal commas."""
    lines = [mark.join(titles)]
    for row in zip(*columns, strict=True):
        cells = [f"{value:.12g}" for value in row]
        lines.append(mark.join(cell.replace(".", ",") if mark == ";" else cell for cell in cells))
    return "\n".join(lines).encode()


TITLES = ("i_d [A]", "i_q [A]", "theta_el [deg]", "psi_d [Wb]", "psi_q [Wb]", "torque [Nm]")
