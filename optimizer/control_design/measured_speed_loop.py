"""The speed loop of a design on the speed that it measures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.control_design.slower_speed_loop import (
    ROUNDED,
    slower_speed_pi,
    speed_advice,
)
from dqforge.optimizer.loops.analysis import inertia_of, speed_model
from dqforge.optimizer.loops.gains import speed_delay
from dqforge.optimizer.loops.pi_methods import largest_factor
from dqforge.optimizer.loops.plants import PiLoop, SpeedLoop
from dqforge.optimizer.sampled_systems import ComplexArray, grid_crossings
from dqforge.optimizer.speed_measurement.edges import Edges

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.settings import SpeedMeasurementSettings
    from dqforge.optimizer.loops.loop_gains import LoopGains

_SHARES = np.array([0.02, 0.05, 0.1, 0.25, 0.5, 1.0])


_POINTS = 4000


_BISECTIONS = 40


_WHERE = "control.speed_loop.measurement"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpeed:
    """What a measurement of the speed is like, and the speed loop with it.

    ``omega_m`` are mechanical speeds in rad/s, ``delay`` in s, ``resolution`` in rad/s,
    ``phase_margin`` in rad of the speed loop with the delay, all of shape (S,). ``lowest`` is the
    speed in rad/s from which the loop has the margin ``required`` in rad up to the largest speed of
    the drive.
    """

    edges: Edges
    omega_m: FloatArray
    delay: FloatArray
    resolution: FloatArray
    phase_margin: FloatArray
    lowest: float
    required: float

    @property
    def settings(self) -> SpeedMeasurementSettings:
        """Encoder and timer."""
        return self.edges.settings


def _margin(delayed: ComplexArray) -> float:
    """Least phase margin in rad of an open loop over a grid; endless without a crossover."""
    _, _, phase = grid_crossings(delayed)
    return float(np.min(phase, initial=np.inf))


class _Judge:
    """Phase margins of one loop over the speed."""

    def __init__(self, loop: PiLoop, edges: Edges) -> None:
        self._edges = edges
        nyquist = np.pi / edges.period
        self._omega = np.geomspace(1e-5 * nyquist, nyquist, _POINTS)
        self._values = loop.open_loop.response(self._omega)

    def __call__(self, omega_m: float) -> float:
        """Phase margin in rad at a mechanical speed in rad/s."""
        return _margin(self._values * self._edges.response(omega_m, self._omega))


def _sampled(loop: PiLoop | SpeedLoop) -> PiLoop:
    return loop.loop if isinstance(loop, SpeedLoop) else loop


def _lowest(judge: _Judge, required: float, bottom: float, top: float) -> float:
    """Least speed in rad/s from which the margin holds, given that it does at ``top``."""
    if judge(bottom) >= required:
        return bottom
    low, high = bottom, top
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if judge(middle) >= required else (middle, high)
    return high


def _advice(design: Design, loops: tuple[LoopGains, LoopGains], edges: Edges) -> str:
    """What to write for a loop that holds; empty where no slower one does."""
    control, (i_q, speed) = design.control, loops
    settings = control.speed_loop
    assert settings is not None
    slower = slower_speed_pi(
        settings,
        speed,
        speed_delay(i_q, control.t_s, settings),
        (inertia_of(design.machine), design.machine.friction),
    )

    def holds(factor: float) -> bool:
        gains = slower(factor)
        if not min(gains) > 0.0:
            return False
        model = _sampled(speed_model(design.machine, i_q, control, gains))
        margin = _Judge(model, edges)(edges.settings.omega_from)
        return bool(np.abs(model.closed.poles[0]) < 1.0) and margin >= settings.min_phase_margin

    factor = largest_factor(holds)
    return "" if factor is None else speed_advice(settings, slower(ROUNDED * factor), factor)


def _require_range(edges: Edges) -> None:
    """Refuse a timer that runs over, and a lowest speed that counts as rest."""
    own, longest = edges.settings, edges.longest_period
    if edges.period > longest:
        raise NoSolutionError(
            f"{_WHERE}: a timer of {own.counter_bits} bits runs over after "
            f"{format_quantity(longest, 's', 3)}, the speed is asked for every "
            f"{format_quantity(edges.period, 's', 3)}; write a clock of "
            f"{format_quantity(longest * own.clock / edges.period, 'Hz', 2)} or less, or "
            "counter_bits: 32"
        )
    if own.omega_from < edges.least:
        raise NoSolutionError(
            f"{_WHERE}: below {format_quantity(edges.least, 'rpm', 3)} the shaft counts as at "
            f"rest, lowest is {format_quantity(own.omega_from, 'rpm', 3)}; write a faster one, or "
            "more lines"
        )


def measured_speed(design: Design, i_q: LoopGains, speed: LoopGains | None) -> MeasuredSpeed | None:
    """The speed loop with the delay of its measurement; None where the speed counts as exact.

    Args:
        design: Its ``control.speed_loop.measurement`` names encoder and timer.
        i_q, speed: The loops as tuned.

    Raises:
        NoSolutionError: The timer runs over within a speed period, or the loop has less margin than
            required at the speed from which it must hold; says what would.
    """
    settings = design.control.speed_loop
    if speed is None or settings is None or settings.measurement is None:
        return None
    edges, required = Edges(settings.measurement, speed.t_s), settings.min_phase_margin
    _require_range(edges)
    judge, lowest = _Judge(_sampled(speed.model), edges), edges.settings.omega_from
    if (reached := judge(lowest)) < required:
        advice = _advice(design, (i_q, speed), edges)
        delay = float(edges.mean_delay(np.array(lowest)))
        raise NoSolutionError(
            f"{_WHERE}: at {format_quantity(lowest, 'rpm', 3)} the speed is known "
            f"{format_quantity(delay, 's', 3)} late, which leaves the speed loop "
            f"{np.degrees(reached):.1f} deg of phase margin, {np.degrees(required):.3g} deg are "
            f"required; " + (advice or "no slower loop of this method has them: more lines")
        )
    machine = design.machine
    top = design.control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    omega_m = _SHARES * top
    return MeasuredSpeed(
        edges,
        omega_m,
        edges.mean_delay(omega_m),
        edges.resolution(omega_m),
        np.array([judge(float(omega)) for omega in omega_m]),
        _lowest(judge, required, min(1e-3 * top, lowest), lowest),
        required,
    )
