"""Errors of current references against exact currents that owe nothing to
the library's closed forms.

Newton's method in extended precision on the equations of the machine written out here;
mpmath where that is not enough.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import mpmath
import numpy as np
from numpy.typing import NDArray

from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.current_reference.forms import PENALTY_FROM, FixedReference, Reference
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

# Arrays in extended precision (float64 for flux maps, whose splines are doubles).
Wide = NDArray[Any]
NEWTON_STEPS = 2


@dataclass(frozen=True)
class Found:
    """Largest errors, in the units of `Certificate`."""

    i_d: float
    i_q: float
    torque: float
    loss: float
    loss_relative: float
    voltage_excess: float

    def most(self, other: Found) -> Found:
        return Found(
            **{f.name: max(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)}
        )


def wide(machine: Machine, values: Any) -> Wide:
    return np.asarray(
        values, dtype=np.longdouble if isinstance(machine, LinearMachine) else np.float64
    )


def flux_terms(machine: Machine, i_d: Wide, i_q: Wide) -> tuple[Wide, ...]:
    """psi_d, psi_q, their four derivatives, and t_dd, t_dq, t_qq over 3/2 p."""
    if isinstance(machine, LinearMachine):
        l_d, l_q, psi = (
            np.longdouble(value) for value in (machine.l_d, machine.l_q, machine.psi_pm)
        )
        zero = np.zeros_like(i_d)
        return (
            psi + l_d * i_d,
            l_q * i_q,
            l_d + zero,
            zero,
            zero,
            l_q + zero,
            zero,
            l_d - l_q + zero,
            zero,
        )
    jet = machine.jet(i_d, i_q)
    t_dd = jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd
    t_dq = jet.l_dd + jet.d_dq * i_q - jet.l_qq - jet.q_dq * i_d
    t_qq = 2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d
    return jet.psi_d, jet.psi_q, jet.l_dd, jet.l_dq, jet.l_qd, jet.l_qq, t_dd, t_dq, t_qq


def torque_of(machine: Machine, i_d: Wide, i_q: Wide) -> Wide:
    psi_d, psi_q = flux_terms(machine, i_d, i_q)[:2]
    return np.asarray(1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d))


def voltage_share(choice: CurrentChoice, i_d: Wide, i_q: Wide) -> Wide:
    """Square of the phase voltage over that of its limit; zero where there is no speed."""
    speed, machine = choice.speed, choice.machine
    if speed is None:
        return np.zeros_like(i_d)
    omega, limit = wide(machine, machine.pole_pairs * speed.omega_m), wide(machine, speed.v_max)
    psi_d, psi_q = flux_terms(machine, i_d, i_q)[:2]
    r_s = wide(machine, machine.r_s)
    return np.asarray(
        ((r_s * i_d - omega * psi_q) ** 2 + (r_s * i_q + omega * psi_d) ** 2) / limit**2
    )


def _step(
    choice: CurrentChoice, torque: Wide, i_d: Wide, i_q: Wide, limited: Wide
) -> tuple[Wide, Wide]:
    machine = choice.machine
    psi_d, psi_q, l_dd, l_dq, l_qd, l_qq, t_dd, t_dq, t_qq = flux_terms(machine, i_d, i_q)
    k = 1.5 * machine.pole_pairs
    t_d, t_q = l_dd * i_q - l_qd * i_d - psi_q, psi_d + l_dq * i_q - l_qq * i_d
    error = psi_d * i_q - psi_q * i_d - torque / k
    if choice.strategy == "id0":
        c, c_d, c_q = i_d, np.ones_like(i_d), np.zeros_like(i_d)
    else:
        c, c_d, c_q = (
            t_q * i_d - t_d * i_q,
            t_q + t_dq * i_d - t_dd * i_q,
            t_qq * i_d - t_d - t_dq * i_q,
        )
    if choice.speed is not None:
        omega, r_s = (
            wide(machine, machine.pole_pairs * choice.speed.omega_m),
            wide(machine, machine.r_s),
        )
        v_d, v_q = r_s * i_d - omega * psi_q, r_s * i_q + omega * psi_d
        over = v_d**2 + v_q**2 - wide(machine, choice.speed.v_max) ** 2
        over_d = 2.0 * (v_d * (r_s - omega * l_qd) + v_q * omega * l_dd)
        over_q = 2.0 * (v_q * (r_s + omega * l_dq) - v_d * omega * l_qq)
        c, c_d, c_q = (
            np.where(limited, *pair) for pair in ((over, c), (over_d, c_d), (over_q, c_q))
        )
    det = t_d * c_q - t_q * c_d
    det = np.where(det == 0.0, np.inf, det)
    return i_d - (error * c_q - c * t_q) / det, i_q - (c * t_d - error * c_d) / det


def exact_currents(choice: CurrentChoice, torque: Wide) -> tuple[Wide, Wide]:
    """Exact currents for torques >= 0.

    The solver's are the start and say where the voltage limits.
    """
    machine = choice.machine
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0 and choice.speed is None:
        size = np.sqrt(
            torque
            / (
                1.5
                * machine.pole_pairs
                * abs(wide(machine, machine.l_q) - wide(machine, machine.l_d))
            )
        )
        return (-size if machine.l_q > machine.l_d else size), size
    i_d, i_q = (
        wide(machine, current) for current in choice.currents(np.asarray(torque, dtype=np.float64))
    )
    limited = voltage_share(choice, i_d, i_q) > 1.0 - 1e-9
    for _ in range(NEWTON_STEPS):
        i_d, i_q = _step(choice, torque, i_d, i_q, limited)
    return i_d, i_q


def found_errors(choice: CurrentChoice, reference: Reference, torque: NDArray[Any]) -> Found:
    """Largest errors at torques >= 0 that the reference knows, in both contractions."""
    request = wide(choice.machine, torque)
    exact = exact_currents(choice, request)
    plain = reference.currents(torque)
    worst = _errors(choice, reference, request, exact, plain)
    if isinstance(reference, FixedReference):
        return worst
    fused = reference.currents(torque, fused=True)
    other = (fused[0] != plain[0]) | (fused[1] != plain[1])
    if not other.any():
        return worst
    rest = [tuple(current[other] for current in pair) for pair in (exact, fused)]
    return worst.most(_errors(choice, reference, request[other], *rest))


def _errors(
    choice: CurrentChoice, reference: Reference, request: Wide, exact: Any, given: Any
) -> Found:
    machine = choice.machine
    i_d, i_q = (wide(machine, current) for current in given)
    produced = torque_of(machine, i_d, i_q)
    least_d, least_q = exact_currents(choice, np.abs(produced))
    least = least_d**2 + least_q**2
    more = np.abs(i_d**2 + i_q**2 - least)
    loaded = request >= PENALTY_FROM * float(reference.torque_max)
    relative = np.divide(more, least, out=np.zeros_like(more), where=loaded)
    over = float(np.max(np.sqrt(voltage_share(choice, i_d, i_q)))) - 1.0
    return Found(
        i_d=float(np.max(np.abs(i_d - exact[0]))),
        i_q=float(np.max(np.abs(i_q - exact[1]))),
        torque=float(np.max(np.abs(produced - request))),
        loss=1.5 * machine.r_s * float(np.max(more)),
        loss_relative=float(np.max(relative)),
        voltage_excess=max(over, 0.0),
    )


def mpmath_currents(machine: LinearMachine, torque: float) -> tuple[Any, Any]:
    """MTPA currents of a salient machine in 40 digits: the root of paper
    000's quartic next to zero.
    """
    with mpmath.workdps(40):
        dl = mpmath.mpf(machine.l_q) - mpmath.mpf(machine.l_d)
        psi, k = mpmath.mpf(machine.psi_pm), mpmath.mpf(1.5 * machine.pole_pairs)
        t = mpmath.mpf(torque)
        # (psi - dl i_d)^3 i_d + dl (T / k)^2 = 0 with i_d against the sign of dl:
        # one root between 0 and its bound.
        bound = (
            -mpmath.sign(dl) * mpmath.sqrt(t / k / abs(dl)) * 2
            - mpmath.sign(dl) * mpmath.mpf(10) ** -30
        )

        def quartic(i_d: Any) -> Any:
            return (psi - dl * i_d) ** 3 * i_d + dl * (t / k) ** 2

        i_d = (
            mpmath.mpf(0)
            if t == 0
            else mpmath.findroot(quartic, (mpmath.mpf(0), bound), solver="anderson", tol=1e-75)
        )
        return i_d, t / k / (psi - dl * i_d)


def neighbours(values: NDArray[np.float32], reach: int) -> NDArray[Any]:
    """Positive floats and all others within ``reach`` units in the last place,
    ascending bit patterns.
    """
    bits = np.asarray(values, dtype=np.float32).view(np.int32).astype(np.int64)
    near = (bits[:, np.newaxis] + np.arange(-reach, reach + 1)).ravel()
    floats: NDArray[Any] = np.maximum(near, 0).astype(np.int32).view(np.float32)
    return floats


def edges_of(reference: Reference) -> NDArray[Any]:
    """Breakpoints and the end of the domain: floats, or codes in fixed point."""
    if isinstance(reference, FixedReference):
        return np.array([*reference.starts, reference.end])
    parts = [getattr(reference.form, axis, None) for axis in ("d", "q")]
    starts = [part.starts for part in parts if part is not None]
    return np.unique(np.concatenate([*starts, [reference.torque_max]])).astype(np.float32)


def dense_torques(reference: Reference, count: int, seed: int, reach: int = 50) -> NDArray[Any]:
    """Torques from zero to the end: random, log-spaced, and beside every
    breakpoint and both ends.
    """
    generator = np.random.default_rng(seed)
    if isinstance(reference, FixedReference):
        if reference.width <= 16:
            return reference.scale.arguments(np.arange(reference.end + 1))
        random = generator.integers(0, reference.end + 1, count)
        low = np.rint(np.geomspace(1.0, reference.end, count // 8)).astype(np.int64)
        near = (edges_of(reference)[:, np.newaxis] + np.arange(-reach, reach + 1)).ravel()
        codes: NDArray[Any] = np.concatenate([random, low, near])
        return reference.scale.arguments(np.unique(np.clip(codes, 0, reference.end)))
    end = np.float32(reference.torque_max)
    even = (generator.uniform(0.0, 1.0, count) * float(end)).astype(np.float32)
    fine = (np.geomspace(1e-9, 1.0, count // 8) * float(end)).astype(np.float32)
    beside = neighbours(edges_of(reference), reach)
    return np.unique(np.minimum(np.concatenate([even, fine, beside]), end))
