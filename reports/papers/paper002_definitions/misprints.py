"""Misprints of chapter 4 of paper 002, and how large an error each one makes."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT
from dqforge.reports.papers.paper002_definitions.model_equations import (
    BLOCKS,
    FrameQuantities,
    Motion,
    ShapedMachine,
    block_voltages,
    frame_quantities,
    model_blocks,
    printed_blocks,
    stationary_voltages,
)

_SAMPLES = 4000
_ORDERS = (2, 3, 5, 6, 7, 9)


@dataclass(frozen=True, slots=True)
class Misprint:
    """An equation of chapter 4, as it is printed and as it holds.

    ``share`` is the largest error over the largest component of the voltage at that angle, of a
    machine and currents by chance; ``volts`` the largest error in V of the shipped drive at a
    constant torque. None where the printed line is no voltage, or not of the machine's equations.
    """

    equation: str
    printed: str
    holds: str
    share: float | None
    volts: float | None


@dataclass(frozen=True, slots=True, eq=False)
class ModelCheck:
    """Chapter 4 judged.

    ``agreement`` is the largest difference of (3.3) to (3.5) with the corrected blocks from the
    voltages in alpha, beta and 0, over the largest of these; ``misprints`` what keeps the printed
    ones from it; ``reference_ripple`` peak to peak of the torque over its mean where i_qy follows
    (4.4) as printed; ``emf_error`` the largest relative error of (4.3) after (4.2).
    """

    agreement: float
    misprints: tuple[Misprint, ...]
    reference_ripple: float
    emf_error: float


def machine_by_chance(seed: int, l_s: float, m_s: float) -> tuple[ShapedMachine, FloatArray]:
    """A machine whose phases differ, with even orders, and currents of alpha, beta and 0 with their
    derivatives by time, in A and A/s, shape (2, 3, N).

    ``l_s`` and ``m_s`` in H.
    """
    chance = np.random.default_rng(seed)
    theta = chance.uniform(0.0, 2.0 * np.pi, _SAMPLES)
    shape, slope = np.zeros((2, 3, _SAMPLES))
    for phase in range(3):
        lag = 2.0 * np.pi / 3.0 * phase + chance.uniform(-0.1, 0.1)
        for order in (1, *_ORDERS):
            size = chance.uniform(0.55, 0.75) if order == 1 else chance.uniform(-0.12, 0.12) / order
            angle = order * theta - (lag if order == 1 else chance.uniform(0.0, 6.0))
            shape[phase] -= size * np.sin(angle)
            slope[phase] -= size * order * np.cos(angle)
    motion = chance.uniform(-1.0, 1.0, (2, 3, _SAMPLES)) * np.array([10.0, 3000.0])[:, None, None]
    return ShapedMachine(theta, shape, slope, l_s, m_s, 1.0, 0.2), motion


def _of_dqx(frame: FrameQuantities, currents: FloatArray) -> FloatArray:
    """Currents of dqx, divided by a_x, from those of dqy, divided by a_y, shape (3, N)."""
    s, c = frame.sine, frame.cosine
    turned = np.stack(
        [currents[0], -s * currents[1] + c * currents[2], c * currents[1] + s * currents[2]]
    )
    return turned * frame.a_y / frame.a_x


def _errors(machine: ShapedMachine, motion: Motion) -> dict[str, FloatArray]:
    """Printed less right voltage by misprint, in V, shape (3, N)."""
    frame = frame_quantities(machine)
    right = model_blocks(frame, machine.l_s, machine.m_s)
    printed = printed_blocks(frame, machine.l_s, machine.m_s)
    i, omega = motion.currents, motion.omega_e
    other = _of_dqx(frame, i) - i
    errors = {name: np.zeros_like(i) for name in ("A", "C", "A and C", "H", "qx", "0x", "dx", "e")}
    errors["A"][0] = omega * (printed["A"] - right["A"]) * i[1]
    errors["C"][1] = omega * (printed["C"] - right["C"]) * i[0]
    errors["A and C"][:] = errors["A"] + errors["C"]
    errors["H"][1] = omega * (printed["H"] - right["H"]) * i[1]
    errors["qx"][0] = omega * right["A"] * other[1]
    errors["0x"][0] = omega * right["B"] * other[2]
    errors["dx"][0] = omega * right["G"] * other[0]
    errors["e"][1] = -omega * machine.phi_m * POWER_INVARIANT / frame.a_y**2
    return errors


def largest_shares(machine: ShapedMachine, motion: Motion) -> dict[str, float]:
    """Largest error over the largest component of the voltage at that angle, by misprint."""
    frame = frame_quantities(machine)
    right = block_voltages(machine, motion, model_blocks(frame, machine.l_s, machine.m_s))
    largest = np.max(np.abs(right), axis=0)
    return {
        name: float(np.max(np.max(np.abs(error), axis=0) / largest))
        for name, error in _errors(machine, motion).items()
    }


def agreement(machine: ShapedMachine, motion: FloatArray, omega_e: float) -> float:
    """Largest difference of the corrected equations from alpha, beta and 0, over the largest
    voltage; ``motion`` as in `machine_by_chance`, ``omega_e`` in rad/s.
    """
    voltages, moving = stationary_voltages(machine, motion[0], motion[1], omega_e)
    blocks = model_blocks(frame_quantities(machine), machine.l_s, machine.m_s)
    assert tuple(blocks) == BLOCKS
    difference = block_voltages(machine, moving, blocks) - voltages
    return float(np.max(np.abs(difference)) / np.max(np.abs(voltages)))


# Equation, what it prints, what holds, and the error's name.
_TEXTS = (
    ("(4.10)", "A = sin theta_y (L_s + 2 M_s) (theta_x' + 1)", "(L_s - M_s)", "A"),
    ("(4.12)", "C = -sin theta_y (L_s + 2 M_s) (theta_x' + 1)", "(L_s - M_s)", "C"),
    ("(4.10), (4.12)", "both", "(L_s - M_s)", "A and C"),
    ("(4.10)", "A omega i_qx", "A omega i_qy", "qx"),
    ("(4.11)", "B omega i_0x", "B omega i_0y", "0x"),
    ("(4.16)", "G omega i_dx", "G omega i_dy", "dx"),
    (
        "(4.17)",
        "H: a'/a (L_s + 2 M_s - 3 M_s) sin^2 theta_y",
        "a'/a (L_s + 2 M_s - 3 M_s sin^2 theta_y)",
        "H",
    ),
    (
        "(4.17), (4.18)",
        "omega phi_m F_0y in (4.18), which is 0",
        "omega phi_m F_qy in (4.17): the back-EMF",
        "e",
    ),
)

_NO_VOLTAGES = (
    ("(4.11)", "B = -cos theta_y .. omega i_0y, times omega i_0x", "omega i_0y once"),
    ("(4.14)", "E = cos theta_y .. omega i_dy, times omega i_dy", "omega i_dy once"),
    ("(4.16)", "G = a'/a, and d i_dy/dt alone", "both times (L_s - M_s)"),
)


def check_model(
    machine: ShapedMachine, pole_pairs: int, torque: float, omega_e: float
) -> ModelCheck:
    """Chapter 4 against a machine by chance with the inductances of a drive, and the errors in that
    drive at a constant torque in N m and a speed in rad/s (electrical).
    """
    chance, motion = machine_by_chance(1, machine.l_s, machine.m_s)
    _, moving = stationary_voltages(chance, motion[0], motion[1], omega_e)
    shares = largest_shares(chance, moving)
    frame = frame_quantities(machine)
    currents = np.zeros_like(machine.shape)
    currents[1] = torque / (pole_pairs * machine.phi_m * POWER_INVARIANT)
    errors = _errors(machine, Motion(currents, np.zeros_like(currents), omega_e))
    rows = [
        Misprint(equation, printed, holds, shares[name], float(np.max(np.abs(errors[name]))))
        for equation, printed, holds, name in _TEXTS
    ]
    rows += [Misprint(*texts, share=None, volts=None) for texts in _NO_VOLTAGES]
    # (4.4) as printed: i_qy in proportion to e_qy / a_y^2, and the torque with it.
    followed = frame.a_y**-4
    return ModelCheck(
        agreement=agreement(chance, motion, omega_e),
        misprints=tuple(rows),
        reference_ripple=float(np.ptp(followed) / np.mean(followed)),
        emf_error=float(np.max(1.0 / frame.a_x - 1.0)),
    )
