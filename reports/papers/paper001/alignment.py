"""Section 8.3 of paper 001: the rotor is drawn to phase a, its angle is called zero, and the
program starts from there.

The listing sets the compare register of phase a to three quarters of the timer's period and the
others to half of it while an empty loop counts to 800 000, then clears the encoder's counter. How
long the loop takes its compiler decides; ten to twenty clock periods a turn are 0.27 to 0.54 s.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.plants.scenario import Profile
from dqforge.machines.records import dataclass
from dqforge.reports.papers.paper001.program_runs import BAND, TARGET, phase_current
from dqforge.reports.papers.paper001.thesis_program import ProgramBench, program_bench
from dqforge.reports.papers.transients import RPM, settling_time
from dqforge.reports.simulation.recorded_run import Simulation

SECONDS = 0.4  # Of the alignment here.

# Torques in N m that resist the motion; the machine's rated torque is 0.47 N m.
FRICTIONS = (0.0, 0.05, 0.2)
START_ANGLES = tuple(range(0, 360, 15))  # In degrees (electrical), at which the rotor lies before.
_TYPICAL = 105  # of the angles: the one from which the starts are shown
_AFTER = 0.8  # s from the end of the alignment
_STUCK = 90.0  # degrees: the rotor stayed where the torque of the current is nought


@dataclass(frozen=True, slots=True)
class Alignment:
    """Alignments against one friction in N m.

    ``current`` in A is that of phase a at their end; ``error_deg`` the largest electrical angle by
    which the rotor misses zero, ``formula_deg`` the arc sine of friction over the current's torque,
    ``stuck_deg`` the angles at which it stayed half a turn off. ``seconds`` from the end of the
    alignment until the speed stays within 2 % of 1200 rpm, nan where it never does, ``reached_rpm``
    at the end; ``backwards_rpm`` is the speed that a start from half a turn off comes to, nan where
    none lay there.
    """

    friction: float
    current: float
    error_deg: float
    formula_deg: float
    stuck_deg: tuple[int, ...]
    seconds: float
    reached_rpm: float
    backwards_rpm: float


def _run(place: ProgramBench, angle: int, friction: float, after: float) -> Simulation:
    reference = Profile((0.0,), (TARGET * RPM,))
    return place.run(SECONDS + after, reference, theta_e=np.radians(angle), friction=friction)


def _missed(run: Simulation) -> float:
    """Electrical angle in degrees at the end of the alignment."""
    last = int(np.searchsorted(run.t, SECONDS)) - 1
    return float(np.degrees(np.angle(np.exp(1j * run.theta_e[last]))))


def _aligned(place: ProgramBench, friction: float, torque_per_ampere: float) -> Alignment:
    found = {angle: _missed(_run(place, angle, friction, 1e-3)) for angle in START_ANGLES}
    stuck = tuple(angle for angle, missed in found.items() if abs(missed) > _STUCK)
    run = _run(place, _TYPICAL, friction, _AFTER)
    current = float(phase_current(run)[int(np.searchsorted(run.t, SECONDS)) - 1])
    end = SECONDS + _AFTER
    reached = float(run.omega_m[-1]) / RPM
    there = abs(reached - TARGET) < BAND * TARGET
    seconds = settling_time(run, SECONDS, end, TARGET * RPM, BAND) if there else float("nan")
    back = _run(place, stuck[0], friction, _AFTER) if stuck else None
    return Alignment(
        friction,
        current,
        max(abs(missed) for angle, missed in found.items() if angle not in stuck),
        float(np.degrees(np.arcsin(friction / (torque_per_ampere * current)))),
        stuck,
        seconds,
        reached,
        float("nan") if back is None else float(back.omega_m[-1]) / RPM,
    )


def alignments(design: Design) -> tuple[Alignment, ...]:
    """The start of section 8.3 against every friction.

    Args:
        design: The bench.

    Raises:
        VerificationError: There is no compiler for the simulation.
    """
    with program_bench(design, round(SECONDS / design.control.t_s)) as place:
        torque = design.machine.torque_per_ampere
        return tuple(_aligned(place, friction, torque) for friction in FRICTIONS)
