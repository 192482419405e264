"""Figures 4.1 to 4.3 of paper 002: the controller as it is drawn, and what its parts put out over
the angle.

Figure 4.2 has references (4.4) to (4.6) and PI controllers in dqy alone; Figure 4.3 adds the
coupling (4.10) to (4.15) and what the thesis calls compensation of the back-EMF, (4.16) to (4.18).
At a constant torque i_qy is constant and i_dy = i_0y = 0, so that these terms are

    d: A omega i_qy     q: H omega i_qy + omega phi_m sqrt(3/2)/a_y^2     0: F omega i_qy
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frame_transforms import (
    CLARKE,
    Frame,
    frame_rates,
    frame_rms,
    loss_ratio_x_over_y,
    spectral_derivative,
    thesis_shapes,
    to_frame,
    transform,
)
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Largest flux in Wb of the machine with a trapezoid that stands beside the shipped one; chosen.
TRAPEZOID_FLUX = 0.2
_ANGLES = 7200


@dataclass(frozen=True, slots=True, eq=False)
class Compensation:
    """Voltages of Figure 4.3 over the angle, power-invariant and divided by a_y, in V, shape (N,).

    ``emf`` is that of the q axis; ``coupling`` of d, q and 0, shape (3, N), all but the back-EMF
    and the resistance. ``i_qy`` in A is the constant reference; ``theta`` in rad. ``theta_x`` and
    ``theta_y`` in rad, ``frame`` the other quantities.
    """

    name: str
    theta: FloatArray
    theta_x: FloatArray
    theta_y: FloatArray
    frame: FrameQuantities
    i_qy: float
    emf: FloatArray
    coupling: FloatArray

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and largest of every quantity: angles in deg, voltages in V, the others without
        unit.
        """
        values = {
            "a_x": self.frame.a_x,
            "a_y": self.frame.a_y,
            "theta_x": np.degrees(self.theta_x),
            "theta_y": np.degrees(self.theta_y),
            "turn": self.frame.turn,
            "theta_y_rate": self.frame.rate,
            "growth": self.frame.growth,
            "emf": self.emf,
            "coupling_d": self.coupling[0],
            "coupling_q": self.coupling[1],
            "coupling_0": self.coupling[2],
        }
        return {name: (float(np.min(part)), float(np.max(part))) for name, part in values.items()}


def shipped_machine(machine: PhaseMachine) -> ShapedMachine:
    """A machine whose back-EMF is smooth, at the angles of its grid."""
    phi_m = float(np.max(np.abs(machine.flux)))
    shape = machine.flux / phi_m
    theta = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    slope = spectral_derivative(shape)
    return ShapedMachine(theta, shape, slope, machine.l_s, machine.m_s, machine.r_s, phi_m)


def trapezoid_machine(machine: PhaseMachine) -> ShapedMachine:
    """A machine with the thesis's trapezoid, else like another; at angles between the corners."""
    nodes = thesis_shapes(_ANGLES)["trapezoid"]
    step = 2.0 * np.pi / _ANGLES
    ahead = np.roll(nodes, -1, axis=1)
    # Its lines are straight and their corners nodes: middle and slope are exact.
    theta = np.asarray(step * (np.arange(_ANGLES) + 0.5), dtype=np.float64)
    shape: FloatArray = 0.5 * (nodes + ahead)
    slope: FloatArray = (ahead - nodes) / step
    return ShapedMachine(theta, shape, slope, machine.l_s, machine.m_s, machine.r_s, TRAPEZOID_FLUX)


def compensation(
    name: str, machine: ShapedMachine, pole_pairs: int, torque: float, omega_e: float
) -> Compensation:
    """Terms of Figure 4.3 of a machine for a torque in N m at a speed in rad/s (electrical)."""
    frame = frame_quantities(machine)
    blocks = model_blocks(frame, machine.l_s, machine.m_s)
    d, q, _ = to_frame("dq0", machine.theta, machine.shape, machine.shape)
    i_qy = torque / (pole_pairs * machine.phi_m * POWER_INVARIANT)
    return Compensation(
        name=name,
        theta=machine.theta,
        theta_x=np.arctan2(-d, q),
        theta_y=np.arctan2(frame.sine, frame.cosine),
        frame=frame,
        i_qy=i_qy,
        emf=omega_e * machine.phi_m * POWER_INVARIANT / frame.a_y**2,
        coupling=omega_e * i_qy * np.stack([blocks[block] for block in ("A", "H", "F")]),
    )


# Paper 002, chapter 4: the terms (4.10) to (4.18) of the model in dqy, as they hold and as they
# are printed.
#
# The thesis names nine blocks A to I; times omega_e and a current of dqy they are the voltages that
# couple the axes (A to F) and those of the axis itself (G to I). They are the entries of
#
#     omega_e [ (a_y'/a_y) D + N L (N^T)' ]      ' = d/dtheta,  D = N L N^T,  N = T_dqy T_dqx
#
# as (E.13) to (E.49) derive it. They are judged by voltages of a machine in alpha, beta and 0,
# carried into dqy by unit vectors of the back-EMF alone, without its angles.

BLOCKS = ("A", "B", "C", "D", "E", "F", "G", "H", "I")

# Axis of the voltage and axis of the current of each block: 0 dy, 1 qy, 2 0y.
PLACES = {
    "A": (0, 1),
    "B": (0, 2),
    "C": (1, 0),
    "D": (1, 2),
    "E": (2, 0),
    "F": (2, 1),
    "G": (0, 0),
    "H": (1, 1),
    "I": (2, 2),
}


@dataclass(frozen=True, slots=True, eq=False)
class ShapedMachine:
    """A machine without saliency at N angles.

    ``theta`` in rad, shape (N,); ``shape`` and ``slope``: F and its derivative by theta in 1/rad,
    shape (3, N); ``l_s``, ``m_s`` in H, ``r_s`` in Ohm, ``phi_m`` in Wb.
    """

    theta: FloatArray
    shape: FloatArray
    slope: FloatArray
    l_s: float
    m_s: float
    r_s: float
    phi_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameQuantities:
    """What the equations of chapter 4 are written in, arrays of shape (N,).

    Sine and cosine of theta_y; ``turn`` 1 + theta_x', ``rate`` theta_y', ``growth`` a_y'/a_y, in
    1/rad; ``a_x`` and ``a_y``.
    """

    sine: FloatArray
    cosine: FloatArray
    turn: FloatArray
    rate: FloatArray
    growth: FloatArray
    a_x: FloatArray
    a_y: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Currents of dqy and their derivatives by time, power-invariant and divided by a_y, in A and
    A/s, shape (3, N); ``omega_e`` in rad/s.
    """

    currents: FloatArray
    slopes: FloatArray
    omega_e: float


def frame_quantities(machine: ShapedMachine) -> FrameQuantities:
    """Angles, rates and factors of dqy for a machine."""
    rates = frame_rates(machine.theta, machine.shape, machine.slope)
    _, size, zero = to_frame("dqx", machine.theta, machine.shape, machine.shape)
    whole = np.hypot(size, zero)
    return FrameQuantities(
        sine=-size / whole,
        cosine=zero / whole,
        turn=1.0 + rates.theta_x,
        rate=rates.theta_y,
        growth=rates.growth_y,
        a_x=POWER_INVARIANT / size,
        a_y=POWER_INVARIANT / whole,
    )


def model_blocks(frame: FrameQuantities, l_s: float, m_s: float) -> dict[str, FloatArray]:
    """Blocks A to I as they hold, in H, shape (N,) each."""
    s, c, rate, growth = frame.sine, frame.cosine, frame.rate, frame.growth
    mixed = 3.0 * m_s * s * c
    square = 3.0 * m_s * s * s
    along, across = l_s + 2.0 * m_s - square, l_s - m_s + square
    plane = (l_s - m_s) * frame.turn
    return {
        "A": s * plane,
        "B": -c * plane,
        "C": -s * plane,
        "D": growth * mixed + rate * along,
        "E": c * plane,
        "F": growth * mixed - rate * (l_s + 0.5 * m_s - 1.5 * m_s * (c * c - s * s)),
        "G": growth * (l_s - m_s),
        "H": growth * along - rate * mixed,
        "I": growth * across + rate * mixed,
    }


def printed_blocks(frame: FrameQuantities, l_s: float, m_s: float) -> dict[str, FloatArray]:
    """Blocks A, C and H as they are printed, in H, shape (N,) each; the others are printed right.

    G, printed without an inductance, is none.
    """
    s, c = frame.sine, frame.cosine
    wrong = s * (l_s + 2.0 * m_s) * frame.turn
    bracket = frame.growth * (l_s + 2.0 * m_s - 3.0 * m_s) * s * s
    return {"A": wrong, "C": -wrong, "H": bracket - frame.rate * 3.0 * m_s * s * c}


def block_voltages(
    machine: ShapedMachine, motion: Motion, blocks: dict[str, FloatArray]
) -> FloatArray:
    """Voltages of dqy in V, shape (3, N), with given blocks: (3.3) to (3.5), with the torque on qy
    alone.
    """
    frame = frame_quantities(machine)
    s, c, i, di = frame.sine, frame.cosine, motion.currents, motion.slopes
    mixed, square = 3.0 * machine.m_s * s * c, 3.0 * machine.m_s * s * s
    plane, zero = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    v = machine.r_s * i
    v[0] += plane * di[0]
    v[1] += (zero - square) * di[1] + mixed * di[2]
    v[2] += mixed * di[1] + (plane + square) * di[2]
    for name, (axis, cause) in PLACES.items():
        v[axis] += motion.omega_e * blocks[name] * i[cause]
    v[1] += motion.omega_e * machine.phi_m * POWER_INVARIANT / frame.a_y**2
    return v


def _unit(vector: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Vectors of length 1 along given ones, shape (3, N), and their derivative."""
    length = np.sqrt(np.sum(vector**2, axis=0))
    growth = np.sum(vector * slope, axis=0) / length
    return vector / length, (slope - vector * growth / length) / length


def _axes(machine: ShapedMachine) -> tuple[FloatArray, FloatArray]:
    """N / a_y and its derivative by theta, shape (3, 3, N): unit vectors of F, at right angles to
    it in the plane, and to both, times the length of F.
    """
    f, df = CLARKE @ machine.shape, CLARKE @ machine.slope
    nothing = np.zeros_like(f[0])
    rows = (
        (np.stack([f[1], -f[0], nothing]), np.stack([df[1], -df[0], nothing])),
        (f, df),
        (
            np.stack([f[0] * f[2], f[1] * f[2], -(f[0] ** 2) - f[1] ** 2]),
            np.stack(
                [
                    df[0] * f[2] + f[0] * df[2],
                    df[1] * f[2] + f[1] * df[2],
                    -2.0 * (f[0] * df[0] + f[1] * df[1]),
                ]
            ),
        ),
    )
    length = np.sqrt(np.sum(f**2, axis=0)) / POWER_INVARIANT
    growth = np.sum(f * df, axis=0) / (length * POWER_INVARIANT**2)
    units = [_unit(vector, slope) for vector, slope in rows]
    into = np.stack([unit * length for unit, _ in units])
    return into, np.stack([slope * length + unit * growth for unit, slope in units])


def stationary_voltages(
    machine: ShapedMachine, currents: FloatArray, slopes: FloatArray, omega_e: float
) -> tuple[FloatArray, Motion]:
    """Voltages that currents of alpha, beta and 0 need, in V and in dqy, shape (3, N), and the
    motion in dqy that these currents are.

    Args:
        machine: The machine.
        currents, slopes: Power-invariant, in A and A/s, shape (3, N).
        omega_e: In rad/s.
    """
    plane, zero = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    inductance = np.array([[plane], [plane], [zero]])
    emf = omega_e * machine.phi_m * (CLARKE @ machine.shape)
    v = machine.r_s * currents + inductance * slopes + emf
    into, turn = _axes(machine)

    def seen(matrix: FloatArray, vector: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("kmn,mn->kn", matrix, vector))

    moving = seen(into, slopes) + omega_e * seen(turn, currents)
    return seen(into, v), Motion(seen(into, currents), moving, omega_e)


# Figures 4.1 to 4.3 of paper 002: the control structures, and their terms over the angle.

_COLOURS = (BLUE, ORANGE, TEAL)


# Centre, width and text of the boxes of a row; all boxes of a diagram are as high.
_SIMPLE = (
    (0.17, 0.2, "transforms and\nequations\nT → currents"),
    (0.42, 0.17, "current\ncontroller"),
    (0.65, 0.14, "inverter"),
    (0.87, 0.14, "machine"),
)


_FORWARD = (
    (0.125, 0.155, "(4.4)-(4.6)\ni_qy = T/(p φ_m √1.5)\ni_dy = i_0y = 0"),
    (0.325, 0.11, "PI dy, qy, 0y"),
    (0.505, 0.14, "(4.8), (4.9)\na_y (T_dqy T_dqx)⁻¹\nT_\u03b1β0⁻¹"),
    (0.7, 0.13, "modulator,\ninverter"),
    (0.89, 0.12, "machine"),
)


_BACK = (
    (0.325, 0.2, "(4.7)\n1/a_y T_dqy T_dqx"),
    (0.7, 0.13, "T_\u03b1β0"),
)


_TABLE = (0.505, 0.12, "table over θ_r\na_y, θ_x, θ_y")


_UPPER, _MIDDLE, _LOWER = 0.82, 0.5, 0.17


_HEIGHT = 0.24


def _box(axes: Axes, centre: float, height: float, width: float, text: str, edge: str) -> None:
    from matplotlib.patches import Rectangle

    corner = (centre - 0.5 * width, height - 0.5 * _HEIGHT)
    axes.add_patch(
        Rectangle(corner, width, _HEIGHT, facecolor="white", edgecolor=edge, linewidth=1.0)
    )
    axes.text(centre, height, text, ha="center", va="center", fontsize=6.0, color=INK)


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float]) -> None:
    axes.annotate(
        "", end, start, arrowprops={"arrowstyle": "-|>", "color": MUTED, "linewidth": 0.8}
    )


def _line(axes: Axes, *points: tuple[float, float]) -> None:
    across, up = zip(*points, strict=True)
    axes.plot(across, up, color=MUTED, linewidth=0.8)


def _row(axes: Axes, boxes: Any, height: float) -> None:
    for centre, width, text in boxes:
        _box(axes, centre, height, width, text, BLUE)
    for (left, wide, _), (right, next_wide, _) in pairwise(boxes):
        _arrow(axes, (left + 0.5 * wide, height), (right - 0.5 * next_wide, height))


def _note(axes: Axes, across: float, up: float, text: str) -> None:
    axes.text(across, up, text, ha="center", va="bottom", fontsize=6.0, color=MUTED)


def _diagram(figure: Figure, place: tuple[float, float, float, float], title: str) -> Axes:
    axes = figure.add_axes(place)
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), xticks=(), yticks=(), title=title)
    axes.grid(visible=False)
    for side in axes.spines.values():
        side.set_edgecolor(FAINT)
    axes.spines[["top", "right"]].set_visible(True)
    return axes


def _simple(axes: Axes) -> None:
    _row(axes, _SIMPLE, 0.65)
    _arrow(axes, (0.0, 0.65), (0.07, 0.65))
    _note(axes, 0.035, 0.67, "T*")
    _line(axes, (0.87, 0.65 - 0.5 * _HEIGHT), (0.87, 0.2), (0.17, 0.2))
    _arrow(axes, (0.17, 0.2), (0.17, 0.65 - 0.5 * _HEIGHT))
    _note(axes, 0.52, 0.21, "i_abc, θ_r")


def _dqy(axes: Axes, *, decoupled: bool) -> None:
    half = 0.5 * _HEIGHT
    _row(axes, _FORWARD, _UPPER)
    _arrow(axes, (0.0, _UPPER), (0.0475, _UPPER))
    _note(axes, 0.02, _UPPER + 0.02, "T*")
    for centre, width, text in _BACK:
        _box(axes, centre, _LOWER, width, text, BLUE)
    centre, width, text = _TABLE
    _box(axes, centre, _MIDDLE, width, text, TEAL)
    _arrow(axes, (centre, _MIDDLE + half), (centre, _UPPER - half))
    _arrow(axes, (centre - 0.03, _MIDDLE - half), (0.41, _LOWER + half))
    _line(axes, (0.89, _UPPER - half), (0.89, _LOWER))
    _arrow(axes, (0.89, _LOWER), (0.765, _LOWER))
    _note(axes, 0.825, _LOWER + 0.02, "i_abc")
    _arrow(axes, (0.635, _LOWER), (0.425, _LOWER))
    _note(axes, 0.54, _LOWER + 0.02, "i_\u03b1β0")
    _arrow(axes, (0.235, _LOWER + half), (0.235, _UPPER - 0.02))
    _note(axes, 0.21, 0.36, "i_dqy")
    axes.plot(0.235, _UPPER, marker="o", markersize=5.0, color="white", markeredgecolor=BLUE)
    _note(axes, 0.245, _UPPER - 0.14, "\u2212")
    if decoupled:
        _box(axes, 0.325, _MIDDLE, 0.13, "A to F, G to I\n(4.10)-(4.18)", ORANGE)
        _arrow(axes, (0.235, _MIDDLE), (0.26, _MIDDLE))
        _line(axes, (0.39, _MIDDLE), (0.407, _MIDDLE))
        _arrow(axes, (0.407, _MIDDLE), (0.407, _UPPER - 0.02))
        axes.plot(0.407, _UPPER, marker="o", markersize=5.0, color="white", markeredgecolor=ORANGE)


def plot_structures() -> Figure:
    """The three control structures as diagrams."""
    with style():
        figure = new_figure(
            "paper-002-structures", 6.6, "Control structures: simplified, dqy, dqy with decoupling"
        )
        titles = (
            "Figure 4.1: the parts of the control",
            "Figure 4.2: dqy control",
            "Figure 4.3: dqy control with decoupling and compensation",
        )
        first, second, third = (
            _diagram(figure, (0.03, 0.71 - 0.34 * row, 0.94, 0.245), title)
            for row, title in enumerate(titles)
        )
        _simple(first)
        _dqy(second, decoupled=False)
        _dqy(third, decoupled=True)
    return figure


def plot_terms(machines: tuple[Compensation, ...]) -> Figure:
    """References, back-EMF and coupling over the angle, a column per machine."""
    with style():
        figure = new_figure(
            "paper-002-terms", 5.4, "References, back-EMF and coupling in dqy over the angle"
        )
        for column, found in enumerate(machines):
            degrees = np.degrees(found.theta)
            first, second, third = (
                figure.add_axes((0.08 + 0.5 * column, 0.725 - 0.315 * row, 0.4, 0.21))
                for row in range(3)
            )
            constant = np.full_like(degrees, found.i_qy)
            first.plot(degrees, constant, color=ORANGE, label="i_qy")
            first.plot(degrees, 0.0 * degrees, color=BLUE, label="i_dy, i_0y")
            first.set(title=f"{found.name}\nFigure 4.2: references", ylabel="A", ylim=(-1.0, 9.5))
            second.plot(degrees, found.emf, color=ORANGE)
            second.set(title="Figure 4.3: back-EMF on qy", ylabel="V", ylim=(90.0, 200.0))
            for values, colour, label in zip(
                found.coupling, _COLOURS, ("dy", "qy", "0y"), strict=True
            ):
                third.plot(degrees, values, color=colour, label=label)
            third.set(title="Figure 4.3: coupling", ylabel="V", ylim=(-32.0, 26.0))
            for axes in (first, third):
                axes.legend(frameon=False, loc="upper right", ncols=3)
            for axes in (first, second, third):
                axes.set(xlim=(0.0, 360.0), xticks=np.arange(0, 361, 60))
            third.set(xlabel="Electrical angle in deg")
    return figure


# Misprints of chapter 4 of paper 002, and how large an error each one makes.

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


# Table 3.1 of paper 002 beside the printed values, copper losses, and Figures 2.3 to 3.2.
#
# The printed values are facts of the thesis; where they contain misprints the
# notes say how they are read.

ANGLES = 7200

# R.m.s. of the components of the back-EMF of unit amplitude.
PRINTED_TABLE_3_1 = {
    "balanced sine": {"d": 0.0, "q": 1.22, "qx": 1.22, "qy": 1.22, "zero": 0.0},
    "one phase at half amplitude": {"d": 0.14, "q": 1.02, "qx": 1.03, "qy": 1.06, "zero": 0.20},
    "one phase missing": {"d": 0.28, "q": 0.86, "qx": 0.91, "qy": 0.99, "zero": 0.40},
    "trapezoid": {"d": 0.15, "q": 1.49, "qx": 1.83, "qy": 1.92, "zero": 0.30},
}

COMPONENTS = ("d", "q", "qx", "qy", "zero")  # Columns of the table, as `dq_frames` names them.

# The frame of each figure of the back-EMF; the phases themselves in the first.
FRAMES: dict[str, Frame | None] = {
    "2.3": None,
    "2.4": "alphabeta0",
    "2.5": "dq0",
    "2.6": "dqx",
    "3.2": "dqy",
}

_FRAME_POINTS = 720


@dataclass(frozen=True, slots=True)
class ComponentRow:
    """One row of Table 3.1: printed and recomputed r.m.s. by component, and the
    copper loss of dqx over dqy.
    """

    shape: str
    printed: dict[str, float]
    found: dict[str, float]
    loss_ratio: float


def table_3_1() -> tuple[ComponentRow, ...]:
    """R.m.s. of every component for the four shapes of the thesis."""
    rows = []
    for name, shape in thesis_shapes(ANGLES).items():
        found = frame_rms(shape)
        values = {component: float(getattr(found, component)) for component in COMPONENTS}
        rows.append(ComponentRow(name, PRINTED_TABLE_3_1[name], values, loss_ratio_x_over_y(shape)))
    return tuple(rows)


def frame_curves() -> dict[str, dict[str, FloatArray]]:
    """Back-EMF of unit amplitude by figure and shape, shape (3, N) over a period:
    Figures 2.3 to 2.6 and 3.2.
    """
    shapes = thesis_shapes(_FRAME_POINTS)
    theta = 2.0 * np.pi * np.arange(_FRAME_POINTS) / _FRAME_POINTS

    def components(frame: Frame | None, shape: FloatArray) -> FloatArray:
        return (
            shape
            if frame is None
            else np.einsum("jkm,mj->kj", transform(frame, theta, shape), shape)
        )

    return {
        number: {name: components(frame, shape) for name, shape in shapes.items()}
        for number, frame in FRAMES.items()
    }
