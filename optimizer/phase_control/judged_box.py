"""The current control of a phase machine judged from standstill to its largest speed, over the box
of drives that the tolerances allow.

Of each speed the loop's currents are judged (`dqforge.optimizer.phase_control.floquet`): without
harmonic integrators and with the midpoint of a split link held, whose own, far slower motions are
stated beside. Every speed must forget what disturbed it at every point of the box, with all of them
running.

L_0 is no key of the tolerances: it moves on its own, as far as the inductance of d or of q may,
whichever is further. Corners are all combinations; where the step of the loop is the same at every
angle, random points inside them are tried as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.loops.robustness import Worst
from dqforge.optimizer.loops.tolerance_box import BoxPoints, DriveBox
from dqforge.optimizer.phase_control.floquet import (
    radius,
    turns_at_rest,
    whole_samples,
)
from dqforge.optimizer.phase_control.periodic_step import PhasePlants, loop_state
from dqforge.optimizer.phase_control.phase_controller import PhaseControl

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # Of the largest speed, at which the loop is judged.

# Radius above 1 that is taken for rounding: of an integrator that has all but faded.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class JudgedSpeed:
    """What the loop keeps of a disturbance at one speed.

    Args:
        omega_m: Mechanical speed in rad/s.
        samples: Samples per electrical period; infinite at standstill.
        nominal: Largest modulus of a multiplier of the currents per sample, with the data
            themselves.
        decay_time: Time in s in which the slowest of them falls to 1/e.
        worst: The largest over the box and where, None without tolerances.
        orders: Orders of the harmonic integrators that run, of the plane and of the zero sequence;
            at standstill, where all of them do the work of the plain integrators, none are counted.
        learning_time: Time in s in which the slowest of those that run at more than half of their
            weight learns to 1/e; None where none does.
    """

    omega_m: float
    samples: float
    nominal: float
    decay_time: float
    worst: Worst | None
    orders: tuple[tuple[int, ...], tuple[int, ...]]
    learning_time: float | None


@dataclass(frozen=True, slots=True)
class JudgedLoops:
    """The judgement of the current control of a phase machine.

    ``speeds`` ascend from standstill. ``corners`` and ``inside`` count the points of the box that
    were checked at each, 0 without tolerances. ``midpoint_time`` is the time in s in which the
    midpoint of a split link returns to 1/e, at the largest speed, None for all other topologies.
    """

    speeds: tuple[JudgedSpeed, ...]
    corners: int
    inside: int
    midpoint_time: float | None

    @property
    def slowest(self) -> JudgedSpeed:
        """The speed with the largest radius, over the box where there is one."""
        return max(
            self.speeds,
            key=lambda found: found.nominal if found.worst is None else found.worst.value,
        )


@dataclass(frozen=True, slots=True, eq=False)
class TriedDrives:
    """Drives of the box: their windings, and which of its points they are; the last is the data.

    ``rows`` of ``points`` has shape (M,) for the M ``plants``.
    """

    plants: PhasePlants
    points: BoxPoints
    rows: NDArray[np.int64]

    @property
    def data(self) -> PhasePlants:
        """The drive of the data themselves."""
        every = self.plants
        held = None if every.capacitance is None else every.capacitance[-1:]
        l_d, l_q, l_0 = every.l_d[-1:], every.l_q[-1:], every.l_0[-1:]
        return PhasePlants(every.r_s[-1:], l_d, l_q, l_0, every.gain[-1:], held)

    def worst(self, radii: FloatArray) -> Worst:
        """The largest radius, shape (M,), and where."""
        row = int(np.argmax(radii))
        return Worst(float(radii[row]), self.points.text(int(self.rows[row])))


def judge_loops(
    control: PhaseControl,
    box: DriveBox,
    omega_m_max: float,
    capacitance: float | None,
    *,
    named: bool,
) -> JudgedLoops:
    """Radii of the current control over speeds and tolerances.

    Args:
        control: The current control.
        box: The drive with its tolerances.
        omega_m_max: Largest mechanical speed in rad/s.
        capacitance: Of both halves of a split link together in F.
        named: Whether the design names tolerances.

    Raises:
        NoSolutionError: The loop does not forget at some speed and point; names both.
    """
    drives = _drives(control, box, capacitance, named=named)
    speeds = tuple(_judged(control, drives, share * omega_m_max, named=named) for share in SHARES)
    midpoint = None
    if control.midpoint is not None:
        unlearned = replace(control, harmonics=None)
        slow = radius(unlearned, drives.data, control.pole_pairs * omega_m_max)
        midpoint = _time(control, slow)
    corners = drives.points.corners if named else 0
    return JudgedLoops(speeds, corners, drives.rows.size - 1 - corners if named else 0, midpoint)


def _drives(
    control: PhaseControl, box: DriveBox, capacitance: float | None, *, named: bool
) -> TriedDrives:
    """The drives that are tried, all of the box or the data alone."""
    points = box.phase_points(zero=TOPOLOGIES[control.topology].neutral)
    count = len(points.deviations)
    rows = np.arange(count if named else 0, dtype=np.int64)
    if not turns_at_rest(control):
        rows = rows[: points.corners]
    rows = np.union1d(rows, [count - 1])
    l_d, l_q, l_0 = (
        size * (1.0 + points.of(name)[rows])
        for size, name in zip(control.inductances, ("l_d", "l_q", "l_0"), strict=True)
    )
    held = None if capacitance is None else np.full(rows.size, capacitance)
    gain = 1.0 + points.of("v_dc")[rows]
    plants = PhasePlants(box.resistance(points)[rows], l_d, l_q, l_0, gain, held)
    return TriedDrives(plants, points, rows)


def _judged(
    control: PhaseControl, drives: TriedDrives, omega_m: float, *, named: bool
) -> JudgedSpeed:
    omega_e = control.pole_pairs * omega_m
    currents = _held_midpoint(replace(control, harmonics=None))
    if not turns_at_rest(currents) and omega_e != 0.0:
        omega_e = whole_samples(control, omega_e).omega_e
    if omega_e == 0.0:  # At rest all orders are one integrator.
        control = replace(control, harmonics=None)
    state = loop_state(control, omega_e)
    found = radius(currents, drives.plants, omega_e)
    _require(drives.worst(found), control, omega_e, 1.0)
    if state.plane or state.zero or state.midpoint:
        together = radius(control, drives.plants, omega_e)
        _require(drives.worst(together), control, omega_e, 1.0 + ROUNDING)
    return JudgedSpeed(
        omega_m=omega_e / control.pole_pairs,
        samples=_samples(control, omega_e),
        nominal=float(found[-1]),
        decay_time=_time(control, found[-1:]),
        worst=drives.worst(found) if named else None,
        orders=(tuple(m for m, _ in state.plane), tuple(m for m, _ in state.zero)),
        learning_time=_learning_time(control, drives.data, omega_e),
    )


def _held_midpoint(control: PhaseControl) -> PhaseControl:
    """The same control against a midpoint that stays where it is: legs drive the same currents."""
    if control.midpoint is None:
        return control
    return replace(control, topology="six-leg", midpoint=None)


def _learning_time(control: PhaseControl, data: PhasePlants, omega_e: float) -> float | None:
    """Time in s of the slowest order that runs at more than half of its weight."""
    state, harmonics = loop_state(control, omega_e), control.harmonics
    plane, zero = (
        tuple(m for m, weight in part if weight > 0.5) for part in (state.plane, state.zero)
    )
    if harmonics is None or not (plane or zero):
        return None
    running = replace(control, harmonics=replace(harmonics, plane=plane, zero=zero))
    return _time(control, radius(_held_midpoint(running), data, omega_e))


def _time(control: PhaseControl, radii: FloatArray) -> float:
    """Time in s in which what is multiplied by the radius per sample, shape (1,), falls to 1/e."""
    modulus = float(radii[0])
    return float(-control.t_s / np.log(modulus)) if 0.0 < modulus < 1.0 else float("inf")


def _samples(control: PhaseControl, omega_e: float) -> float:
    """Samples per electrical period."""
    return 2.0 * np.pi / (omega_e * control.t_s) if omega_e else float("inf")


def _require(worst: Worst, control: PhaseControl, omega_e: float, limit: float) -> None:
    """Refuse a loop that does not forget, with speed, point and what to write instead."""
    if worst.value < limit:
        return
    rpm = omega_e / control.pole_pairs * 30.0 / np.pi
    if control.feedforward == "measured":
        advice = "write control.current_loop.feedforward: references, which moves no pole"
    else:
        advice = "lower the gains or machine.max_speed, sample faster, or narrow control.tolerances"
    period = f", {_samples(control, omega_e):.3g} samples per period" if omega_e else ""
    raise NoSolutionError(
        f"control.current_loop: in frame {control.frame} the currents are unstable at {rpm:.5g} "
        f"rpm{period}, {worst.at} (radius {worst.value:.4g} per sample): {advice}"
    )
