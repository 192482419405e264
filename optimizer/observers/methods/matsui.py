"""What Matsui's voltage and current model share: the usual tuning, and what a period showed."""

from __future__ import annotations

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.observers.models.matsui_model import Matsui
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair
from dqforge.optimizer.observers.sampled_gains import (
    SampledGains,
    limited,
    matrix_entries,
    next_currents,
)
from dqforge.optimizer.observers.tuning_numbers import USUAL_WIDTH, ObserverTuning


def usual_matsui(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Angle and speed at 200 rad/s, or 1/20 of the sampling rate in rad/s if less:
    a voltage error costs less so.
    """
    width = min(USUAL_WIDTH, 0.05 / t_s)
    return ObserverTuning(width, width, omega_floor=0.02 * omega_max)


@dataclass(frozen=True, slots=True)
class ShownGains:
    """What the machine shows of the errors: ``salient`` = L_d - L_q in H, ``psi_pm`` in Wb,
    (rad/s)^2.
    """

    salient: float
    psi_pm: float
    omega_min_2: float


def shown_gains(observer: Matsui) -> ShownGains:
    """What the firmware needs to tell the errors.

    Parameters
    ----------
    observer:
        The estimator.
    """
    machine = observer.model.machine
    return ShownGains(machine.l_d - machine.l_q, machine.psi_pm, observer.omega_min**2)


def shown_errors(shown: ShownGains, omega: Reals, v: Pair, i: Pair) -> Pair:
    """Errors of angle in rad and speed in rad/s that a voltage difference shows, shape (N,).

    Parameters
    ----------
    shown:
        Of `shown_gains`.
    omega:
        Electrical speed in rad/s.
    v, i:
        Voltage difference in V and currents in A, in rotor coordinates.
    """
    active, cross = shown.psi_pm + shown.salient * i[0], shown.salient * i[1]
    scale = 1.0 / (active * active + cross * cross)
    share = omega / (omega * omega + shown.omega_min_2)
    return (scale * (cross * v[1] - active * v[0])) * share, scale * (active * v[1] + cross * v[0])


@dataclass(frozen=True, slots=True, eq=False)
class ShownGap:
    """What a period showed: angle ahead, current there, entries, (cos, sin) of half the turn,
    current gap.
    """

    theta: Reals
    now: Pair
    entries: Reals
    cosine: Reals
    half: Reals
    gap: Pair


def shown_gap(
    model: SampledGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ShownGap:
    """What the period before a sample showed.

    Parameters
    ----------
    model:
        The sampled machine.
    state:
        Before the sample.
    v, i:
        Voltage in V that acted over the period, current in A at its end, alpha and beta.
    maths:
        The arithmetic.
    """
    turn = maths.rotation(state.theta_e)
    theta = maths.wrap(state.theta_e + model.t_s * state.omega_e)
    now = park(maths, i, maths.rotation(theta))
    x = limited(model.t_s * state.omega_e, model.x_max)
    half = 0.5 * x
    e = matrix_entries(model, x)
    foretold = next_currents(e, park(maths, state.vectors[0], turn), park(maths, v, turn))
    return ShownGap(
        theta, now, e, 1.0 - 0.5 * (half * half), half, (now[0] - foretold[0], now[1] - foretold[1])
    )
