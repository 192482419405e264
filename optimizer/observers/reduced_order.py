"""Reduced-order speed observer: i_q is measured, the speed is estimated from the
voltage and the torque it makes.

Machine with i_d near zero (surface machine, or i_d = 0 control), mechanics without load torque,
u_q free of coupling:

    L_q di_q/dt = u_q - R i_q - p psi omega          u_q = v_q - p omega L_d i_d
    J domega/dt = 3/2 p psi i_q - B omega

Observer with the gain g > 0, from paper 001 (8.15) to (8.25), derived again
(docs/methods/speed-observer.md):

    omega_hat = zeta - g L_q/(p psi) i_q
    dzeta/dt  = -(g + B/J) zeta + g/(p psi) u_q
                + (g^2 L_q/(p psi) + g (B/J L_q - R)/(p psi) + 3/2 p psi/J) i_q

Its error omega_hat - omega decays with exp(-(g + B/J) t).

Deviations from the paper: its p0 is +g in (8.19), (8.20) and -g in (8.22), (8.23), (8.25), while
(8.21) fits neither; (8.20) has zeta for u_q and p0 for p0^2; its 900 in (8.23) is p psi/J, where
3/2 p psi/J = 1350 belongs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.sampled_systems import discretise

# Relative error of the observer's resistance for which the error of its speed is stated.
R_ERROR = 0.3
FASTEST = 1.0  # g t_s: beyond, the voltage of a single sample decides the estimate


@dataclass(frozen=True, slots=True)
class ReducedOrderObserver:
    """The observer, continuous and sampled.

    Continuous, with the pole ``continuous_pole`` in 1/s:

        dzeta/dt = continuous_pole zeta + rate_u u_q + rate_i i_q,
            omega_hat = zeta - c_continuous i_q

    Sampled every ``t_s`` seconds, as the firmware runs it, with the pole ``a`` =
    exp(continuous_pole t_s):

        omega_hat[k] = zeta[k] - c i_q[k]
        zeta[k+1] = a zeta[k] + b_u u_q[k] + b_i i_q[k]

    where i_q[k] is sampled at k t_s and u_q[k] is the voltage that acts from k t_s to (k+1) t_s:
    with a computation delay of one period that is the voltage computed from the samples of instant
    k-1.

    Args:
        g: Observer gain in rad/s (the setting ``pole``).
        t_s: Sampling period in s.
        continuous_pole, a: Pole -(g + B/J) in 1/s, and its image in the z plane.
        rate_u, rate_i: Continuous coefficients in rad/(s^2 V) and rad/(s^2 A).
        c_continuous, c: Coefficient of i_q in the estimate, in rad/(s A).
        b_u, b_i: Sampled coefficients in rad/(s V) and rad/(s A).
        torque_rate: Acceleration per ampere 3/2 p psi/J in rad/(s^2 A).
    """

    g: float
    t_s: float
    continuous_pole: float
    rate_u: float
    rate_i: float
    c_continuous: float
    torque_rate: float
    a: float
    b_u: float
    b_i: float
    c: float


@dataclass(frozen=True, slots=True)
class ObserverSimulation:
    """Time-domain check of an observer, all arrays of shape (N,), sampled every t_s.

    ``times`` in s, ``i_q`` in A, ``omega_m`` and ``omega_hat`` in rad/s (mechanical).
    """

    times: FloatArray
    i_q: FloatArray
    omega_m: FloatArray
    omega_hat: FloatArray

    @property
    def error(self) -> FloatArray:
        """Estimated minus true speed in rad/s, shape (N,)."""
        return self.omega_hat - self.omega_m

    @property
    def final_error(self) -> float:
        """Error at the last sample in rad/s."""
        return float(self.error[-1])


@dataclass(frozen=True, slots=True)
class ObserverError:
    """Steady speed error omega_hat - omega in rad/s at one operating point,
    and what it consists of.

    ``total`` is exact for the sampled observer; ``load`` and ``resistance`` are the closed forms of
    the continuous one, T_L/(J (g + B/J)) and -(R_hat - R) i_q g/((g + B/J) p psi).
    """

    total: float
    load: float
    resistance: float
    i_q: float
    omega_m: float

    @property
    def relative(self) -> float:
        """Error over speed."""
        return self.total / self.omega_m


@dataclass(frozen=True, slots=True)
class SpeedErrorSlopes:
    """Steady error of the estimate per unit of what causes it; with exact parameters
    and no load there is none.

    ``load`` in rad/s per N m of a load torque that the observer does not know of; ``resistance`` in
    rad/s per A of i_q where the observer's resistance is too high by ``r_error``, a share of the
    true one. ``contraction`` is the largest factor per sample of an error, at every speed
    (`speed_error_factor`).
    """

    load: float
    resistance: float
    r_error: float
    contraction: float


@dataclass(frozen=True, slots=True)
class ErrorsAtLoad:
    """Steady errors of the estimate with a load torque in N m that the observer does not know of.

    ``exact`` with exact parameters, ``resistance`` where the observer's resistance is too high by
    ``r_error``, a share of the true one.
    """

    torque_load: float
    exact: ObserverError
    resistance: ObserverError
    r_error: float


def _inertia(machine: Machine) -> float:
    if machine.inertia is None:
        raise InputError(
            "control.observer needs machine.inertia (kg m^2): write it, or leave control.observer "
            "out"
        )
    return machine.inertia


def _check(machine: Machine, g: float, t_s: float) -> None:
    """Refuse what cannot be observed or sampled."""
    if not (g > 0.0 and np.isfinite(g)):
        raise InputError(
            "control.observer.pole must be positive and finite (rad/s; the pole lies at -pole), "
            f"got {g:g}"
        )
    if not machine.psi_pm > 0.0:
        raise NoSolutionError(
            "control.observer: a machine without magnet flux (machine.psi_pm = 0) has no back-EMF "
            "at i_d = 0, so this observer cannot see its speed; leave control.observer out"
        )
    if g * t_s > FASTEST:
        raise NoSolutionError(
            f"control.observer: pole {g:g} rad/s is too fast for t_s = {t_s:g} s (pole t_s = "
            f"{g * t_s:.3g}, at most {FASTEST:g}); write {FASTEST / t_s:g} rad/s or less"
        )


def plant_of(machine: Machine) -> tuple[FloatArray, FloatArray]:
    """Continuous (A, B) with the state (i_q, omega) and the inputs (u_q, load torque)."""
    inertia, back_emf = _inertia(machine), machine.pole_pairs * machine.psi_pm
    a = np.array(
        [
            [-machine.r_s / machine.l_q, -back_emf / machine.l_q],
            [machine.torque_per_ampere / inertia, -machine.friction / inertia],
        ]
    )
    return a, np.array([[1.0 / machine.l_q, 0.0], [0.0, -1.0 / inertia]])


def reduced_order_observer(machine: Machine, g: float, t_s: float) -> ReducedOrderObserver:
    """Design the observer with the gain g and sample it without approximation.

    The sampled machine x[k+1] = Phi x[k] + Gamma u_q[k], x = (i_q, omega), is exact because the
    inverter holds its voltage. On it the observer corrects its speed prediction by the error of its
    current prediction,

        omega_hat[k+1] = phi_21 i_q[k] + phi_22 omega_hat[k] + gamma_2 u_q[k]
                         + l (i_q[k+1] - phi_11 i_q[k] - phi_12 omega_hat[k] - gamma_1 u_q[k]),

    with l such that phi_22 - l phi_12 = a = exp(-(g + B/J) t_s), and zeta = omega_hat - l i_q
    removes the future current. The current is thus not assumed constant within a sample: holding
    i_q[k] in the continuous equation would leave an error proportional to the change of current per
    sample.

    Args:
        machine: The machine; its inertia must be known and psi_pm positive.
        g: Observer gain in rad/s.
        t_s: Sampling period in s.

    References:
        Paper 001, (8.15) to (8.25), corrected; Astroem and Wittenmark, "Computer-Controlled
        Systems", chapter 4 (observers of reduced order).
    """
    _check(machine, g, t_s)
    inertia, back_emf = _inertia(machine), machine.pole_pairs * machine.psi_pm
    damping = machine.friction / inertia
    held = discretise(*plant_of(machine), t_s)
    phi, gamma = held.phi, held.gamma0[:, 0]
    if not phi[0, 1] < 0.0:
        raise NoSolutionError(
            f"control.observer: speed and current of this machine swing faster than t_s = {t_s:g} "
            "s can follow; check machine.inertia and machine.l_q, or sample faster"
        )
    a = float(np.exp(-(g + damping) * t_s))
    gain = float((phi[1, 1] - a) / phi[0, 1])
    return ReducedOrderObserver(
        g=g,
        t_s=t_s,
        continuous_pole=-(g + damping),
        rate_u=g / back_emf,
        rate_i=(g * g * machine.l_q + g * (damping * machine.l_q - machine.r_s)) / back_emf
        + machine.torque_per_ampere / inertia,
        c_continuous=g * machine.l_q / back_emf,
        torque_rate=machine.torque_per_ampere / inertia,
        a=a,
        b_u=float(gamma[1] - gain * gamma[0]),
        b_i=float(a * gain + phi[1, 0] - gain * phi[0, 0]),
        c=-gain,
    )


def estimate_speed(
    observer: ReducedOrderObserver, u_q: FloatArray, i_q: FloatArray, omega_0: float
) -> FloatArray:
    """Run the sampled observer over measured data.

    Args:
        u_q: Voltage in V held from sample k to k+1, shape (N,).
        i_q: Current in A at sample k, shape (N,).
        omega_0: First estimate in rad/s.

    Returns:
        Estimated mechanical speed in rad/s at each sample, shape (N,).
    """
    omega_hat = np.empty(len(i_q))
    zeta = omega_0 + observer.c * i_q[0]
    for k in range(len(i_q)):
        omega_hat[k] = zeta - observer.c * i_q[k]
        zeta = observer.a * zeta + observer.b_u * u_q[k] + observer.b_i * i_q[k]
    return omega_hat


def simulate_observer(
    observer: ReducedOrderObserver,
    machine: Machine,
    u_q: FloatArray,
    torque_load: FloatArray,
    omega_0: float = 0.0,
    error_0: float = 0.0,
) -> ObserverSimulation:
    """Drive the machine (i_d = 0, exact between samples) with held voltages and loads,
    and observe its speed.

    Args:
        observer: The observer, possibly designed for other parameters than the machine has.
        machine: The true machine.
        u_q, torque_load: Voltage in V and load torque in N m held over each sample, shape (N,).
        omega_0, error_0: True speed at the start and error of the first estimate, in rad/s; the
            current starts at 0 A.
    """
    held = discretise(*plant_of(machine), observer.t_s)
    inputs = np.stack([u_q, torque_load], axis=1) @ held.gamma0.T
    states = np.empty((len(u_q), 2))
    state = np.array([0.0, omega_0])
    for k in range(len(u_q)):
        states[k] = state
        state = held.phi @ state + inputs[k]
    return ObserverSimulation(
        times=np.asarray(np.arange(len(u_q)) * observer.t_s, dtype=np.float64),
        i_q=states[:, 0],
        omega_m=states[:, 1],
        omega_hat=estimate_speed(observer, u_q, states[:, 0], omega_0 + error_0),
    )


def steady_state_error(
    machine: Machine,
    g: float,
    t_s: float,
    omega_m: float,
    torque_load: float = 0.0,
    r_error: float = 0.0,
    psi_error: float = 0.0,
    inertia_error: float = 0.0,
) -> ObserverError:
    """Speed error of the observer at a steady operating point with i_d = 0, in closed form
    (constants at zero current).

    Args:
        machine: The true machine; of a saturated one the constants at zero current.
        g, t_s: Observer gain in rad/s and sampling period in s.
        omega_m: True mechanical speed in rad/s.
        torque_load: Load torque in N m, of which the observer knows nothing.
        r_error, psi_error, inertia_error: Relative errors of R, psi_pm and J in the observer, e.g.
            0.3 for 30 % too much.
    """
    inertia, damping = _inertia(machine), machine.friction / _inertia(machine)
    machine = linearised(machine)
    believed = replace(
        machine,
        r_s=machine.r_s * (1.0 + r_error),
        psi_pm=machine.psi_pm * (1.0 + psi_error),
        inertia=inertia * (1.0 + inertia_error),
    )
    observer = reduced_order_observer(believed, g, t_s)
    i_q = (machine.friction * omega_m + torque_load) / machine.torque_per_ampere
    back_emf = machine.pole_pairs * machine.psi_pm
    u_q = machine.r_s * i_q + back_emf * omega_m
    estimate = (observer.b_u * u_q + observer.b_i * i_q) / (1.0 - observer.a) - observer.c * i_q
    return ObserverError(
        total=estimate - omega_m,
        load=torque_load / (inertia * (g + damping)),
        resistance=-r_error * machine.r_s * i_q * g / ((g + damping) * back_emf),
        i_q=i_q,
        omega_m=omega_m,
    )


def speed_error_slopes(
    machine: Machine,
    observer: ReducedOrderObserver,
    omega_m: float,
    v_d: float,
    r_error: float = R_ERROR,
) -> SpeedErrorSlopes:
    """Steady error per unit of its causes, in closed form; errors as `steady_state_error`.

    Args:
        machine: The true machine.
        observer: The observer, made for it.
        omega_m: True mechanical speed in rad/s.
        v_d: Largest voltage in V along d, to either side.
        r_error: Relative error of the resistance.
    """
    error = steady_state_error(machine, observer.g, observer.t_s, omega_m, 1.0, r_error=r_error)
    factor = speed_error_factor(machine, observer, machine.i_max, v_d)
    return SpeedErrorSlopes(error.load, error.resistance / error.i_q, r_error, factor)


def speed_error_factor(
    machine: Machine, observer: ReducedOrderObserver, i_d: float, v_d: float
) -> float:
    """Largest factor by which an error of the estimate changes in a sample of the emitted step.

    The step takes the coupling omega L_d i_d and the angle in the middle of the period by its own
    estimate, so that its pole moves by -b_u p (L_d i_d + v_d t_s/2), affine in both: their ends are
    enough, whatever the speed. One or more: an error need not shrink.

    Args:
        machine: Whose l_d and pole pairs the step knows.
        observer: The observer.
        i_d, v_d: Largest magnitudes of the current in A and of the voltage in V along d.
    """
    l_d = linearised(machine).l_d
    moved = machine.pole_pairs * observer.b_u * (l_d * i_d + 0.5 * observer.t_s * v_d)
    return abs(observer.a) + abs(moved)


def errors_at_loads(
    machine: Machine,
    observer: ReducedOrderObserver,
    omega_m: float,
    torque_loads: tuple[float, ...],
    r_error: float = R_ERROR,
) -> tuple[ErrorsAtLoad, ...]:
    """Steady errors at one mechanical speed in rad/s for load torques in N m.

    Errors as `steady_state_error`.
    """

    def found(torque_load: float, wrong: float) -> ObserverError:
        return steady_state_error(
            machine, observer.g, observer.t_s, omega_m, torque_load, r_error=wrong
        )

    return tuple(
        ErrorsAtLoad(load, found(load, 0.0), found(load, r_error), r_error) for load in torque_loads
    )


# What an observer that learns is trained on, and what its training left: plain records.

Limits = tuple[float, float]  # Least and largest value.

# Relative errors of R that are trained where a design names no tolerances: a cold winding, and one
# at 130 degrees C of a machine whose data were taken at 20.
USUAL_R_S: Limits = (-0.3, 0.4)
USUAL_PSI_PM: Limits = (-0.1, 0.05)  # The same of the magnet: warm, and cold.
USUAL_INDUCTANCE: Limits = (-0.1, 0.1)
LOWEST_SHARE = 0.03  # Share of the largest speed from which on steady states are trained.

# The same up to which they are: a drive at its largest speed still lies within.
HIGHEST_SHARE = 1.1


@dataclass(frozen=True, slots=True)
class TrainingBox:
    """The drives and operating points of a training.

    ``r_s``, ``l_d``, ``l_q``, ``psi_pm`` are relative errors, ``lost`` the voltage in V along the
    current that the inverter takes unknown to the observer. ``i_max`` in A is the largest current
    (peak), ``i_d_low`` in A the least i_d; ``omega_low`` and ``omega_high`` in rad/s (electrical)
    bound the size of the speed.
    """

    r_s: Limits
    l_d: Limits
    l_q: Limits
    psi_pm: Limits
    lost: Limits
    i_max: float
    i_d_low: float
    omega_low: float
    omega_high: float


def usual_training_box(
    lost: float, i_max: float, omega_max: float, i_d: float = 0.0
) -> TrainingBox:
    """The box where nothing is known of the tolerances.

    Args:
        lost: Voltage in V that the whole dead time takes: from none of it to all.
        i_max: Largest current in A (peak).
        omega_max: Largest electrical speed in rad/s.
        i_d: Least i_d in A that the drive needs; half the largest current towards weaker fields is
            trained in any case.
    """
    return TrainingBox(
        USUAL_R_S,
        USUAL_INDUCTANCE,
        USUAL_INDUCTANCE,
        USUAL_PSI_PM,
        (0.0, lost),
        i_max,
        min(-0.5 * i_max, 1.1 * i_d),
        LOWEST_SHARE * omega_max,
        HIGHEST_SHARE * omega_max,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Training:
    """What a training gained on steady states that it has not seen, per band of speeds.

    ``edges`` in rad/s (electrical), shape (B, 2). ``rms`` and ``largest`` map who estimates to
    angle errors in rad, shape (B,); ``outside`` does with R beyond the box, ``beyond`` (two
    relative errors). ``held`` is the share of points at which the observer has a steady state at
    all, ``inside`` the share of those at rest with the correction at which it acts, and
    ``inside_beyond`` the same beyond the box, shape (B,). ``limit`` in rad is the largest
    correction that can come out, and ``rules`` the largest of a rule over its box before that
    limit, None where only the limit is known. ``numbers`` are the constants that were learned,
    ``points`` those it was trained on.
    """

    box: TrainingBox
    edges: FloatArray
    rms: dict[str, FloatArray]
    largest: dict[str, FloatArray]
    outside: dict[str, FloatArray]
    beyond: Limits
    held: FloatArray
    inside: FloatArray
    inside_beyond: FloatArray
    limit: float
    rules: float | None
    numbers: int
    points: int
