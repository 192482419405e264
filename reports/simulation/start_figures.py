"""What is read off a simulated start without encoder."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.reports.simulation.recorded_run import Simulation, StartRecord
from dqforge.reports.start_up.float32_model import Fault, State

_NEAR = 0.1  # of the reference: it counts as reached


_SOON = 10  # samples after the hand-over


@dataclass(frozen=True, slots=True)
class StartFigures:
    """A start.

    ``state`` and ``fault`` are those at the end, by their names in C; ``failed`` names the faults
    on the way. ``hand_over`` is the instant in s at which the observer took over first, ``speed``
    in rad/s (mechanical) and ``angle_error`` in rad those at that instant, ``current_step`` in A
    the largest change of the current vector in the rotor's frame over the next ten samples; nan
    where it never did. ``reached`` is the time in s to 10 % of the last reference, nan for never;
    ``back`` the largest electrical angle in rad against the direction of the reference,
    ``crossings`` how often the observer took over or was left.
    """

    state: str
    fault: str
    failed: tuple[str, ...]
    hand_over: float
    speed: float
    angle_error: float
    current_step: float
    reached: float
    back: float
    crossings: int


def _turned(run: Simulation) -> FloatArray:
    """Electrical angle since the start in rad, shape (N,)."""
    angle = np.unwrap(run.theta_e)
    return np.asarray(angle - angle[0])


def start_figures(run: Simulation, record: StartRecord) -> StartFigures:
    """Figures of a start.

    Args:
        run, record: What was recorded.
    """
    state, fault = record.start_state.astype(int), record.start_fault.astype(int)
    running = state == State.RUN
    first = int(np.argmax(running)) if np.any(running) else -1
    last = float(run.reference[-1])
    near = np.abs(run.omega_m - last) <= _NEAR * abs(last)
    close = np.flatnonzero(near) if last else np.empty(0, dtype=np.intp)
    turned = _turned(run) * (-1.0 if last < 0.0 else 1.0)
    gap, step, speed, time = (float("nan"),) * 4
    if first >= 0:
        error = float(run.theta_e_observed[first] - run.theta_e[first])
        gap = float((error + np.pi) % (2.0 * np.pi) - np.pi)
        vector = run.i_d[first : first + _SOON] + 1j * run.i_q[first : first + _SOON]
        step = float(np.max(np.abs(vector - vector[0])))
        speed, time = float(run.omega_m[first]), float(run.t[first])
    return StartFigures(
        state=State(state[-1]).name,
        fault=Fault(fault[-1]).name,
        failed=tuple(Fault(code).name for code in sorted(set(fault.tolist()) - {0})),
        hand_over=time,
        speed=speed,
        angle_error=gap,
        current_step=step,
        reached=float(run.t[close[0]]) if close.size else float("nan"),
        back=float(max(0.0, -np.min(turned))),
        crossings=int(np.count_nonzero(np.diff(running.astype(int)))),
    )


def estimated(run: Simulation, record: StartRecord) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Samples at which the observer ruled, shape (N,).

    Args:
        run, record: What was recorded.
    """
    ruled = (record.start_state == State.RUN) & np.isfinite(run.omega_m_observed)
    return np.asarray(ruled)


def spans(record: StartRecord) -> list[tuple[str, int, int]]:
    """States in turn: name, first sample, first sample of the next.

    Args:
        record: What was recorded.
    """
    state = record.start_state.astype(int)
    edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), state.size]
    return [(State(state[start]).name, start, end) for start, end in pairwise(edges)]
