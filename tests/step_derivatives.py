"""Steps of observers on CasADi's numbers: the derivative of the very text that is emitted."""

from __future__ import annotations

from typing import Any

import casadi
import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.observers.parts import ObserverMethod, ObserverState
from dqforge.optimizer.steps.step_arithmetic import AlphaBeta
from dqforge.optimizer.steps.step_graphs import Graphs, Number, graph


def derivative(method: ObserverMethod, gains: Any) -> casadi.Function:
    """(state (n,), turn, omega, drift, v (2,), i (2,)) -> state after a sample, and its derivatives
    by the state, by i and by v; states as those of `SteadyObserver`.
    """
    count = len(method.members.vectors)
    n = 2 * count + len(method.members.scalars) + 2
    state, v, i = (casadi.SX.sym(name, size) for name, size in (("x", n), ("v", 2), ("i", 2)))
    turn, omega, drift = (casadi.SX.sym(name) for name in ("turn", "omega", "drift"))
    c, s = casadi.cos(turn), casadi.sin(turn)

    def pair(x: Any, y: Any) -> AlphaBeta:
        first: Any = Number(x)
        second: Any = Number(y)
        return AlphaBeta(first, second)

    vectors = tuple(
        pair(
            state[2 * k] * c + state[2 * k + 1] * s,
            state[2 * k + 1] * c - state[2 * k] * s,
        )
        for k in range(count)
    )
    scalars: Any = tuple(Number(state[k]) for k in range(2 * count, n - 2))
    theta: Any = Number(state[n - 2] - turn)
    speed: Any = Number(state[n - 1] + omega - drift)
    before = ObserverState(vectors, theta, speed, True, scalars)
    after = method.step(gains, before, pair(v[0], v[1]), pair(i[0], i[1]), Graphs())
    parts = [part for vector in after.vectors for part in vector] + [*after.scalars, after.theta_e]
    found = casadi.vertcat(*map(graph, parts), graph(after.omega_e) - omega)
    by = [casadi.jacobian(found, part) for part in (state, i, v)]
    return casadi.Function("step", [state, turn, omega, drift, v, i], [found, *by])


def evaluated(function: casadi.Function, *arguments: Any) -> list[FloatArray]:
    return [np.asarray(part, dtype=np.float64) for part in function(*arguments)]
