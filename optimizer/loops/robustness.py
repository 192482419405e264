"""Margins of the loops over a box of tolerances: the worst corner of each, checked inside,
and what would hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    SpeedLoopSettings,
    ToleranceName,
    Tolerances,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine, torque_from_flux
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY, in_rpm
from dqforge.machines.units.quantities import signed_percent
from dqforge.optimizer.certificates.current_loop_proof import CurrentLoopProof
from dqforge.optimizer.loops.integer_gains import CurrentControl, TurningMachines, largest_pole
from dqforge.optimizer.loops.loop_gains import LoopGains, speed_delay
from dqforge.optimizer.loops.optimised_pi import optimised_pi, pi_scale
from dqforge.optimizer.loops.pi_methods import (
    BatchMargins,
    DriveVariants,
    PlantBatch,
    Settings,
    batch_margins,
    calmer,
    close_loops,
    current_pi,
    current_plants,
    largest_factor,
    loop_advice,
    speed_pi,
    speed_plants,
    vendor_inductance,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

FloatArray = NDArray[np.float64]


_SPEEDS = 9

# The same on the data alone, where the speed is told from which on they are unstable.
_FINE_SPEEDS = 41


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
        f"{fault}, required: {np.degrees(required):.1f} deg; {hint}"
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


@dataclass(frozen=True, slots=True)
class RotatingAxes:
    """Both current loops together on the machine as its data have it, at the inductances that
    saturation lets appear.

    Args:
        radius: Largest pole modulus per sample up to the largest speed.
        at: Where that is.
        stable_to: Mechanical speed in rad/s up to which all points are stable; None where they are
            up to the largest one.
        needed: Inductances l_d, l_q in H at which they are unstable first.
        decoupled: Those that the decoupling uses.
        better: Whether half of the gains, or twice as much, is stable up to a larger speed; None
            where neither is.
    """

    radius: float
    at: str
    stable_to: float | None
    needed: tuple[float, float]
    decoupled: tuple[float, float]
    better: Literal["lower", "raise"] | None = None


def rotating_axes(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> RotatingAxes:
    """Both current loops together on the data alone, up to the largest speed.

    That of the per-unit speed where the machine states none.

    Args:
        box: The drive, whose tolerances play no part.
        i_d, i_q: The current loops.
    """
    machine, control = box.design.machine, box.design.control
    alone = replace(box, tolerances=Tolerances())
    top = machine.omega_m_max or control.bases.speed
    # Backwards the poles are the same: i_q changes its sign, and the gains do not.
    omega_m = np.linspace(0.0, top, _FINE_SPEEDS)
    drives = alone.turning_machines(alone.turning_points(), machine.pole_pairs * omega_m)
    emitted = _emitted(box, i_d, i_q)
    radius = largest_pole(drives, emitted).reshape(-1, _FINE_SPEEDS)
    limit = _stable_to(radius, omega_m)
    beyond = radius if limit is None else radius[:, omega_m > limit]
    row = int(np.argmax(np.max(beyond, axis=1)))
    l_d, l_q = (part.reshape(radius.shape)[row, 0] for part in (drives.l_d, drives.l_q))
    better: Literal["lower", "raise"] | None = None
    if limit is not None:
        slower, faster = (
            _stable_to(largest_pole(drives, scaled).reshape(radius.shape), omega_m)
            for scaled in (_scaled(emitted, 0.5), _scaled(emitted, 2.0))
        )
        slower, faster = (top if end is None else end for end in (slower, faster))
        if max(slower, faster) > limit:
            better = "lower" if slower > faster else "raise"
    return RotatingAxes(
        float(np.max(radius)),
        f"{in_rpm(omega_m[int(np.argmax(np.max(radius, axis=0)))]):.5g} rpm",
        limit,
        (float(l_d), float(l_q)),
        (machine.l_d, machine.l_q),
        better,
    )


def _stable_to(radius: FloatArray, omega_m: FloatArray) -> float | None:
    """Speed in rad/s (of those that ascend from 0) up to which all poles lie within the unit
    circle, None where all do.
    """
    unstable = np.flatnonzero(np.any(radius >= 1.0, axis=0))
    return float(omega_m[max(unstable[0] - 1, 0)]) if unstable.size else None


def _scaled(control: CurrentControl, factor: float) -> CurrentControl:
    kp, ki_ts = ((factor * part[0], factor * part[1]) for part in (control.kp, control.ki_ts))
    return replace(control, kp=kp, ki_ts=ki_ts)


def _emitted(box: DriveBox, i_d: LoopGains, i_q: LoopGains) -> CurrentControl:
    machine, t_s = box.design.machine, box.design.control.t_s
    return CurrentControl(
        (i_d.kp, i_q.kp),
        (i_d.ki_ts, i_q.ki_ts),
        machine.l_d,
        machine.l_q,
        CURRENT_DELAY * t_s,
        t_s,
    )


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
    machine = box.design.machine
    if machine.omega_m_max is None:
        return None
    points = box.turning_points()
    omega_m = np.linspace(-machine.omega_m_max, machine.omega_m_max, _SPEEDS)
    drives = box.turning_machines(points, machine.pole_pairs * omega_m)
    radius = largest_pole(drives, _emitted(box, i_d, i_q))
    row, place = divmod(int(np.argmax(radius)), _SPEEDS)
    at = f"{in_rpm(omega_m[place]):.4g} rpm, {points.text(row)}"
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


# The box of drives that a design's tolerances allow: its corners, points inside, and the plants at
# them.
#
# How each tolerance enters:
#
# - ``r_s``, ``l_d``, ``l_q``: the winding. Where a machine saturates and its gains do not follow,
#   the inductance reaches from the least to the largest incremental one along the current reference
#   besides.
# - ``v_dc``: gain 1 + d of the voltage; the duty cycles are computed with another dc-link
#   voltage than the one that acts.
# - ``dead_time``: what the compensation gets wrong, t_e, leaves a voltage of f_sw t_e V_dc against
#   (or, if too much is compensated, along) each phase current. Its fundamental, 4/pi of that, is a
#   resistance of 4 f_sw t_e V_dc/(pi I) at the amplitude I (describing function of a relay); it is
#   added with its sign, at the smallest current of the design.
# - ``psi_pm``: the torque that a commanded torque makes, and the back-EMF that
#   the feedforward leaves over.
# - ``inertia``: the mechanics.
#
# Each reaches from its lower to its upper deviation, which need not be of the same size; 0, the
# data, lies between them.

Axis = Literal["i_d", "i_q"]
_NAMES: tuple[ToleranceName, ...] = get_args(ToleranceName)
SAMPLES = 400  # Random points inside the box that are checked besides its corners.
_SEED = 20_261_121


@dataclass(frozen=True, slots=True)
class BoxPoints:
    """Deviations of M drives: relative ones, and the error of the dead time in s.

    ``deviations`` has shape (M, K) for the K ``names``; the first ``corners`` rows are the corners
    of the box, the last of the rows behind them the data themselves. ``loaded`` marks, per row, the
    full current.
    """

    names: tuple[str, ...]
    deviations: FloatArray
    corners: int
    loaded: NDArray[np.bool_]

    def of(self, name: str) -> FloatArray:
        """Deviations of one parameter, shape (M,); zeros where it has none."""
        if name not in self.names:
            return np.zeros(len(self.deviations))
        return np.asarray(self.deviations[:, self.names.index(name)], dtype=np.float64)

    def text(self, row: int) -> str:
        """A point in words, such as ``l_q -20 %, r_s +30 %``."""
        parts = [
            _part(name, float(value))
            for name, value in zip(self.names, self.deviations[row], strict=True)
        ]
        parts += ["full current"] if self.loaded[row] else []
        return ", ".join(parts) or "the data themselves"


def _part(name: str, value: float) -> str:
    if name == "dead_time":
        return f"dead_time {value * 1e6:+.3g} us"
    return f"{name} {signed_percent(value)}"


def box_points(limits: dict[str, tuple[float, float]], *, loads: bool = False) -> BoxPoints:
    """Corners of a box, random points inside it (the same every time), and the data themselves.

    Args:
        limits: Lower and upper deviation by parameter; parameters with none are left out.
        loads: Whether every point is taken at no load and at full current.
    """
    names = tuple(name for name, (low, high) in limits.items() if high > low)
    low, high = (np.array([limits[name][side] for name in names]) for side in (0, 1))
    corners = np.array(list(itertools.product(*zip(low, high, strict=True)))).reshape(
        2 ** len(names), len(names)
    )
    inside = np.random.default_rng(_SEED).uniform(low, high, (SAMPLES if names else 0, len(names)))
    rest = np.vstack([inside, np.zeros((1, len(names)))])
    if not loads:
        return BoxPoints(
            names,
            np.vstack([corners, rest]),
            len(corners),
            np.zeros(len(corners) + len(rest), np.bool_),
        )
    loaded = np.repeat(
        [False, True, False, True], [len(corners), len(corners), len(rest), len(rest)]
    )
    return BoxPoints(names, np.vstack([corners, corners, rest, rest]), 2 * len(corners), loaded)


@dataclass(frozen=True, slots=True)
class DriveBox:
    """Tolerances of a design around the inductances that its loops are tuned for.

    ``nominal`` are l_d and l_q in H, ``spread`` the largest over them along the current reference,
    where the gains do not follow it (1 otherwise).
    """

    design: Design
    tolerances: Tolerances
    nominal: tuple[float, float]
    spread: tuple[float, float] = (1.0, 1.0)

    def inductance_limits(self, axis: Axis) -> tuple[float, float]:
        """Least and largest deviation of an axis's inductance, with what saturation adds."""
        low, high = self.tolerances.limits("l_d" if axis == "i_d" else "l_q")
        spread = self.spread[0 if axis == "i_d" else 1]
        return low, spread * (1.0 + high) - 1.0

    def _limits(self, axis: Axis) -> dict[str, tuple[float, float]]:
        t = self.tolerances
        return {
            "r_s": t.limits("r_s"),
            "l_d" if axis == "i_d" else "l_q": self.inductance_limits(axis),
            "v_dc": t.limits("v_dc"),
            "dead_time": t.limits("dead_time"),
        }

    def named_limits(self) -> tuple[tuple[ToleranceName, float, float], ...]:
        """Parameters that the design lets deviate, with the least and the largest
        deviation (relative, or in s).
        """
        found = ((name, *self.tolerances.limits(name)) for name in _NAMES)
        return tuple((name, low, high) for name, low, high in found if high > low)

    def current_points(self, axis: Axis) -> BoxPoints:
        """Corners and points inside of what the current loop of one axis depends on."""
        return box_points(self._limits(axis))

    def turning_points(self) -> BoxPoints:
        """The same for both current loops together."""
        return box_points({**self._limits("i_d"), **self._limits("i_q")})

    def zero_limits(self) -> dict[str, tuple[float, float]]:
        """What the loop of the zero-sequence current depends on.

        Its inductance has no tolerance of its own; it moves as far as that of d or q may, whichever
        is further.
        """
        limits = self._limits("i_q")
        sides = zip(limits.pop("l_q"), self._limits("i_d")["l_d"], strict=True)
        (low_q, low_d), (high_q, high_d) = sides
        return {**limits, "l_0": (min(low_q, low_d), max(high_q, high_d))}

    def zero_points(self) -> BoxPoints:
        """Corners and points inside of what the loop of the zero-sequence current depends on."""
        return box_points(self.zero_limits())

    def phase_points(self, *, zero: bool) -> BoxPoints:
        """The same for all current loops of a phase machine, with or without a zero sequence."""
        both = {**self._limits("i_d"), **self._limits("i_q")}
        return box_points({**both, **(self.zero_limits() if zero else {})})

    def zero_plants(self, points: BoxPoints, inductance: float) -> PlantBatch:
        """Plants of the loop of the zero-sequence current around an inductance in H."""
        return current_plants(
            self.resistance(points),
            inductance * (1.0 + points.of("l_0")),
            self.design.control.t_s,
            1.0 + points.of("v_dc"),
        )

    def turning_machines(self, points: BoxPoints, omega_e: FloatArray) -> TurningMachines:
        """Windings at M points, each at S electrical speeds in rad/s, points by speeds in one
        row.
        """

        def spread(column: FloatArray) -> FloatArray:
            return np.repeat(column, omega_e.size)

        return TurningMachines(
            r_s=spread(self.resistance(points)),
            l_d=spread(self.nominal[0] * (1.0 + points.of("l_d"))),
            l_q=spread(self.nominal[1] * (1.0 + points.of("l_q"))),
            gain=spread(1.0 + points.of("v_dc")),
            omega_e=np.tile(omega_e, len(points.deviations)),
        )

    def speed_points(self) -> BoxPoints:
        """The same for the speed loop; salient machines at no load and at full current."""
        t = self.tolerances
        salient = self.design.machine.saliency != 0.0 and self.design.strategy == "mtpa"
        both = salient and any(t.limits(name) != (0.0, 0.0) for name in ("l_d", "l_q", "psi_pm"))
        limits = self._limits("i_q")
        limits |= {"l_d": t.limits("l_d")} if salient else {}
        limits |= {"psi_pm": t.limits("psi_pm"), "inertia": t.limits("inertia")}
        return box_points(limits, loads=both)

    @property
    def dead_time_resistance(self) -> float:
        """Resistance in Ohm that each second of the dead time's rest adds at the smallest current
        and a voltage gain of 1.
        """
        return self.design.inverter.lost_per_dead_time / self.tolerances.low_current

    def resistance(self, points: BoxPoints) -> FloatArray:
        """Resistance in Ohm at points, with what the dead time adds, shape (M,)."""
        resistance = self.design.machine.r_s * (1.0 + points.of("r_s"))
        if "dead_time" not in points.names:
            return resistance
        gain = 1.0 + points.of("v_dc")
        return resistance + self.dead_time_resistance * points.of("dead_time") * gain

    def current_loop_plants(
        self, axis: Axis, points: BoxPoints, inductance: float | None = None
    ) -> PlantBatch:
        """Plants of a current loop; around another ``inductance`` in H where that is given."""
        place, name = (0, "l_d") if axis == "i_d" else (1, "l_q")
        middle = self.nominal[place] if inductance is None else inductance
        return current_plants(
            self.resistance(points),
            middle * (1.0 + points.of(name)),
            self.design.control.t_s,
            1.0 + points.of("v_dc"),
        )

    def speed_loop_plants(
        self, points: BoxPoints, current_gains: tuple[float, float]
    ) -> PlantBatch:
        """Plants of the speed loop around a current loop with given gains (V/A and V/(A s))."""
        machine, control = self.design.machine, self.design.control
        assert control.speed_loop is not None
        assert machine.inertia is not None
        constant = (
            machine.torque_per_ampere * machine.pole_pairs * machine.psi_pm * points.of("psi_pm")
        )
        variants = DriveVariants(
            r_s=self.resistance(points),
            l_q=self.nominal[1] * (1.0 + points.of("l_q")),
            inertia=machine.inertia * (1.0 + points.of("inertia")),
            gain=1.0 + points.of("v_dc"),
            torque_factor=self.torque_factor(points),
            back_emf=constant,
        )
        ratio, filter_time = control.speed_loop.ratio, control.speed_loop.filter_time
        return speed_plants(
            variants, machine.friction, control.t_s, current_gains, ratio, filter_time
        )

    def torque_factor(self, points: BoxPoints) -> FloatArray:
        """Torque over commanded torque, shape (M,): by the magnets at no load,
        by all of it at full current.

        A machine without magnets has no torque at no load; its factor there is that
        of its reluctance torque.
        """
        machine = self.design.machine
        by_magnet = 1.0 + points.of("psi_pm")
        if not points.loaded.any():
            return by_magnet
        locus = mtpa_locus(machine, self.design.i_max)
        i_d, i_q = locus.i_d[-1:], locus.i_q[-1:]
        psi_d, psi_q = machine.flux(i_d, i_q)
        changed_d = machine.psi_pm * by_magnet + (psi_d - machine.psi_pm) * (1.0 + points.of("l_d"))
        # The inductance that saturation adds belongs to the loop at low current,
        # not to the torque at full current.
        of_q = np.clip(points.of("l_q"), *self.tolerances.limits("l_q"))
        changed_q = psi_q * (1.0 + of_q)
        before = torque_from_flux(machine.pole_pairs, psi_d, psi_q, i_d, i_q)
        factor = torque_from_flux(machine.pole_pairs, changed_d, changed_q, i_d, i_q) / before
        everywhere = points.loaded if machine.psi_pm > 0.0 else np.ones_like(points.loaded)
        return np.asarray(np.where(everywhere, factor, by_magnet), dtype=np.float64)


def drive_box(
    design: Design, nominal: tuple[float, float], largest: tuple[float, float]
) -> DriveBox:
    """The design's box.

    Of a design without tolerances the inductances that saturation lets appear, alone.

    Args:
        design: The design.
        nominal, largest: (l_d, l_q) in H that the loops are tuned for, and the largest ones along
            the current reference.
    """
    tolerances = design.control.tolerances or Tolerances()
    follows = design.control.current_loop.schedule or isinstance(design.machine, LinearMachine)
    spread = (1.0, 1.0) if follows else (largest[0] / nominal[0], largest[1] / nominal[1])
    return DriveBox(design, tolerances, nominal, spread)
