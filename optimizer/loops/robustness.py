"""Margins of the loops over a box of tolerances: the worst corner of each, checked inside,
and what would hold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.current_loop_proof import CurrentLoopProof
from dqforge.optimizer.loops.integer_gains import CurrentControl, largest_pole
from dqforge.optimizer.loops.loop_gains import LoopGains, speed_delay
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    CURRENT_DELAY,
    BatchMargins,
    PlantBatch,
    Settings,
    batch_margins,
    calmer,
    close_loops,
    current_pi,
    largest_factor,
    loop_advice,
    speed_pi,
    vendor_inductance,
)
from dqforge.optimizer.loops.tolerance_box import Axis, BoxPoints, DriveBox

FloatArray = NDArray[np.float64]


_SPEEDS = 9


@dataclass(frozen=True, slots=True)
class Worst:
    """The worst value of a margin over the box, and where it is: ``l_q -20 %, r_s +30 %``."""

    value: float
    at: str


@dataclass(frozen=True, slots=True)
class LoopRobustness:
    """What one loop keeps over the box.

    Args:
        corners, samples: How many corners and how many points inside were checked.
        phase_margin: Least modulus of the phase margin in rad.
        gain_margin: Least gain margin as a factor.
        delay_margin: Least delay margin in s.
        max_sensitivity: Largest M_s.
        radius: Largest modulus of a closed-loop pole.
        inside_worse: Whether a point inside the box was worse than every corner in any of these.
    """

    corners: int
    samples: int
    phase_margin: Worst
    gain_margin: Worst
    delay_margin: Worst
    max_sensitivity: Worst
    radius: Worst
    inside_worse: bool


@dataclass(frozen=True, slots=True)
class RobustSet:
    """Robustness of both current loops and, where there is one, of the speed loop.

    ``turning`` is the largest pole modulus of both current loops together up to the largest speed,
    None where the machine states none or is judged in its phases. ``limits`` are the parameters
    that deviate, with the least and the largest deviation: relative, of the dead time in s.
    ``i_0`` is the zero-sequence current's, None where nothing drives one. ``proof`` is what is
    proven of both current loops together, None where ``turning`` is.
    """

    i_d: LoopRobustness
    i_q: LoopRobustness
    speed: LoopRobustness | None
    turning: Worst | None = None
    limits: tuple[tuple[str, float, float], ...] = ()
    i_0: LoopRobustness | None = None
    proof: CurrentLoopProof | None = None


def summarise(margins: BatchMargins, points: BoxPoints) -> LoopRobustness:
    """Worst values over the points, each with its place.

    Args:
        margins: Margins of the loop at N points of the box.
        points: The points.
    """
    unstable = margins.radius >= 1.0
    badness = {
        "phase_margin": np.where(unstable, np.inf, -np.abs(margins.phase_margin)),
        "gain_margin": np.where(unstable, np.inf, -margins.gain_margin),
        "delay_margin": np.where(unstable, np.inf, -margins.delay_margin),
        "max_sensitivity": np.where(unstable, np.inf, margins.max_sensitivity),
        "radius": margins.radius,
    }
    inside_worse = False
    worst: dict[str, Worst] = {}
    for name, bad in badness.items():
        row = int(np.argmax(bad))
        value = abs(float(getattr(margins, name)[row]))
        worst[name] = Worst(value, points.text(row))
        inside_worse |= bool(bad[row] > np.max(bad[: points.corners]) + 1e-9 * abs(value))
    return LoopRobustness(
        points.corners, len(points.deviations) - points.corners, inside_worse=inside_worse, **worst
    )


def first_fault(margins: BatchMargins, points: BoxPoints, required: float) -> str | None:
    """What the worst point does not keep, in words, or None.

    Args:
        margins: Margins of the loop at N points of the box.
        points: The points.
        required: Phase margin in rad that the loop must have.
    """
    unstable = margins.radius >= 1.0
    if unstable.any():
        row = int(np.argmax(margins.radius))
        return f"is unstable (largest pole modulus {margins.radius[row]:.4g}) at {points.text(row)}"
    row = int(np.argmin(np.abs(margins.phase_margin)))
    if abs(margins.phase_margin[row]) >= required:
        return None
    return (
        f"has a phase margin of {np.degrees(abs(margins.phase_margin[row])):.1f} deg at "
        f"{points.text(row)}"
    )


def _kept(
    key: str,
    gains: LoopGains,
    settings: Settings,
    plants: PlantBatch,
    points: BoxPoints,
    formula: Callable[[Settings], tuple[float, float]],
) -> LoopRobustness:
    """Robustness of a loop; raises what the corner misses, and what settings would hold."""
    required = settings.min_phase_margin

    def evaluate(pair: tuple[float, float]) -> BatchMargins:
        return batch_margins(close_loops(plants, *pair))

    def holds(factor: float) -> bool:
        try:
            pair = formula(calmer(settings, factor))
        except NoSolutionError:
            return False
        if not min(pair) > 0.0 or np.max(close_loops(plants, *pair).radius) >= 1.0:
            return False  # without the margins, which take far longer
        return first_fault(evaluate(pair), points, required) is None

    margins = evaluate((gains.kp, gains.ki))
    fault = first_fault(margins, points, required)
    if fault is None:
        return summarise(margins, points)
    factor = largest_factor(holds)
    hint = (
        "no smaller gains of this method reach it, narrow control.tolerances"
        if factor is None
        else loop_advice(key, settings, factor)
    )
    raise NoSolutionError(
        f"{key}: within control.tolerances the {gains.loop} loop by method '{gains.method}' "
        f"{fault}, required are {np.degrees(required):.1f} deg; {hint}"
    )


def optimised_current(
    r_s: float, inductance: float, t_s: float, bound: float, plants: PlantBatch
) -> tuple[float, float]:
    """Gains (V/A, V/(A s)) of a current loop by the method ``optimised`` for all plants.

    Arguments in Ohm, H and s.

    Args:
        r_s: Phase resistance in Ohm.
        inductance: Inductance of the axis in H.
        t_s: Sampling period in s.
        bound: Bound of M_s.
        plants: Plants whose M_s is bounded.
    """
    return optimised_pi(
        plants, bound, pi_scale(inductance, r_s, CURRENT_DELAY * t_s), "control.current_loop"
    )


def current_robustness(box: DriveBox, gains: LoopGains, axis: Axis) -> LoopRobustness:
    """Margins of a current loop over the box.

    Args:
        box: The drive with its tolerances.
        gains: The loop.
        axis: Which axis.

    Raises:
        NoSolutionError: The loop is unstable or misses its phase margin at a point of the box;
            names it and says what would hold.
    """
    control, r_s = box.design.control, box.design.machine.r_s
    inductance = box.nominal[0 if axis == "i_d" else 1]
    points = box.current_points(axis)
    plants = box.current_loop_plants(axis, points)
    corners = plants.some(np.arange(points.corners))
    settings = control.current_loop
    if settings.method == "magnitude-optimum":  # no free parameter: offer the same family with one
        settings = replace(settings, method="bandwidth", bandwidth=gains.kp / inductance)

    def formula(trial: CurrentLoopSettings) -> tuple[float, float]:
        if trial.method == "optimised":
            return optimised_current(r_s, inductance, control.t_s, trial.max_sensitivity, corners)
        rule = vendor_inductance(trial.method, box.nominal, 0 if axis == "i_d" else 1)
        return current_pi(r_s, rule, control.t_s, trial)

    return _kept("control.current_loop", gains, settings, plants, points, formula)


def zero_robustness(box: DriveBox, gains: LoopGains) -> LoopRobustness:
    """Margins of the loop of the zero-sequence current over the box; raises as
    `current_robustness`.

    Args:
        box: The drive with its tolerances.
        gains: The loop.
    """
    control, r_s, inductance = box.design.control, box.design.machine.r_s, gains.inductance
    assert inductance is not None
    points = box.zero_points()
    plants = box.zero_plants(points, inductance)
    corners = plants.some(np.arange(points.corners))
    settings = control.current_loop
    if gains.method == "given":
        settings = replace(settings, method="given", kp=gains.kp, ki=gains.ki)
    elif settings.method == "magnitude-optimum":
        settings = replace(settings, method="bandwidth", bandwidth=gains.kp / inductance)

    def formula(trial: CurrentLoopSettings) -> tuple[float, float]:
        if trial.method == "optimised":
            return optimised_current(r_s, inductance, control.t_s, trial.max_sensitivity, corners)
        return current_pi(r_s, inductance, control.t_s, trial)

    return _kept("control.current_loop", gains, settings, plants, points, formula)


def turning_robustness(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> Worst | None:
    """Largest pole modulus of both current loops together over the box, at standstill
    and up to the largest speed.

    None where the machine states no largest speed.

    Args:
        box: The drive with its tolerances.
        i_d, i_q: The current loops.

    Raises:
        NoSolutionError: The loops are unstable at a point; names it with its speed.
    """
    machine, control = box.design.machine, box.design.control
    if machine.omega_m_max is None:
        return None
    points = box.turning_points()
    omega_m = np.linspace(-machine.omega_m_max, machine.omega_m_max, _SPEEDS)
    emitted = CurrentControl(
        (i_d.kp, i_q.kp),
        (i_d.ki_ts, i_q.ki_ts),
        machine.l_d,
        machine.l_q,
        CURRENT_DELAY * control.t_s,
        control.t_s,
    )
    radius = largest_pole(box.turning_machines(points, machine.pole_pairs * omega_m), emitted)
    row, place = divmod(int(np.argmax(radius)), _SPEEDS)
    at = f"{omega_m[place] * 30.0 / np.pi:.4g} rpm, {points.text(row)}"
    if np.max(radius) >= 1.0:
        raise unstable_together(at, float(np.max(radius)))
    return Worst(float(np.max(radius)), at)


def unstable_together(at: str, radius: float) -> NoSolutionError:
    """The refusal of current loops that are unstable together.

    Args:
        at: Speed and drive, in words.
        radius: Largest pole modulus there.
    """
    return NoSolutionError(
        "control.current_loop: within control.tolerances both current loops together are "
        f"unstable at {at} (largest pole modulus {radius:.4g}): the decoupling leaves "
        "too much; lower the gains or machine.max_speed, sample faster, or narrow "
        "control.tolerances"
    )


def speed_robustness(box: DriveBox, gains: LoopGains, current_gains: LoopGains) -> LoopRobustness:
    """Margins of the speed loop over the box; raises as `current_robustness`.

    Args:
        box: The drive with its tolerances.
        gains: The speed loop.
        current_gains: The current loop of the q axis.
    """
    machine, control = box.design.machine, box.design.control
    settings, inertia = control.speed_loop, machine.inertia
    assert settings is not None
    assert inertia is not None
    points = box.speed_points()
    plants = box.speed_loop_plants(points, (current_gains.kp, current_gains.ki))
    corners = plants.some(np.arange(points.corners))
    t_sum = speed_delay(current_gains, control.t_s, settings)

    def formula(trial: SpeedLoopSettings) -> tuple[float, float]:
        if trial.method == "optimised":
            scale = pi_scale(inertia, machine.friction, t_sum)
            return optimised_pi(corners, trial.max_sensitivity, scale, "control.speed_loop")
        return speed_pi(inertia, machine.friction, t_sum, trial)

    return _kept("control.speed_loop", gains, settings, plants, points, formula)
