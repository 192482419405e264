"""The machine from one sample to the next, exactly, in a frame that turns with the rotor:
what observers predict with.

Over one period the inverter holds its voltage in stator coordinates and the speed omega changes
little. In the rotor's frame the held voltage then turns backwards, and currents, voltage and
back-EMF follow one linear equation,

    L_d di_d/dt = v_d - R i_d + omega L_q i_q              dv_d/dt =  omega v_q
    L_q di_q/dt = v_q - R i_q - omega (L_d i_d + psi)      dv_q/dt = -omega v_d

whose matrix exponential gives, without approximation for a constant speed,

    i[k+1] = Phi(omega) i[k] + Gamma(omega) v[k] + h(omega)

with i[k] and v[k] in the frame of the beginning and i[k+1] in that of the end of the period. Phi,
Gamma and h are entire functions of omega; mirrored in the d axis the machine runs backwards, so
that each entry is even or odd. Polynomials of four coefficients in (omega t_s)^2 hold them to some
1e-9 over the speed range, without any function of libm.

References:
    K. J. Astroem, B. Wittenmark, "Computer-Controlled Systems", 3rd edition, 1997, chapter 2; the
    equations are (7.23) and (7.24) of paper 001 with L_d and L_q kept apart.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.scenario import next_flux, plants
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq, Member, Pair

TERMS = 4

# Parity of the rows phi_dd, phi_dq, phi_qd, phi_qq, gamma_dd, gamma_dq, gamma_qd, gamma_qq, h_d,
# h_q in omega.
ODD = np.array([False, True, True, False, False, True, True, False, False, True])

# omega t_s in rad: six samples per electrical turn; beyond, the speed is not constant over a sample
# in any sense.
_NODES = 16
_LARGEST_TURN = 1.0
_RESERVE = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class SampledMachine:
    """Phi, Gamma and h as polynomials of the speed.

    Args:
        machine: The linear machine.
        t_s: Sampling period in s.
        omega_max: Largest electrical speed in rad/s for which the polynomials hold; beyond it the
            speed is limited.
        table: Coefficients of rising powers of (omega t_s)^2 of the ten entries in the order of
            `ODD`, shape (10, 4); an odd entry has the factor omega t_s besides. Phi has no unit,
            Gamma is in A/V, h in A.
        error: Largest deviation from the matrix exponential, over the largest of the entry.
    """

    machine: LinearMachine
    t_s: float
    omega_max: float
    table: FloatArray
    error: float

    def entries(self, omega: FloatArray) -> FloatArray:
        """The ten entries at electrical speeds in rad/s, shape (...) -> (..., 10)."""
        return self.entries_and_slopes(omega)[0]

    def slopes(self, omega: FloatArray) -> FloatArray:
        """Derivatives of the ten entries by the speed, per rad/s, shape (...) -> (..., 10)."""
        return self.entries_and_slopes(omega)[1]

    def entries_and_slopes(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The ten entries with their derivatives, both shapes as of `entries`."""
        limit = self.omega_max
        x = np.minimum(np.maximum(omega, -limit), limit)[..., np.newaxis] * self.t_s
        s = x * x
        c = np.ascontiguousarray(self.table.T)
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        rate = (3.0 * c[3] * s + 2.0 * c[2]) * s + c[1]
        entries = np.where(ODD, x * value, value)
        return entries, np.where(ODD, value + 2.0 * s * rate, 2.0 * x * rate) * self.t_s

    def predict(self, omega: FloatArray, i: FloatArray, v: FloatArray) -> FloatArray:
        """Currents at the end of the period in A, shape (..., 2), from those and the
        voltage at its beginning.
        """
        return applied(self.entries(omega), i, v)


def applied(entries: FloatArray, i: FloatArray, v: FloatArray) -> FloatArray:
    """Phi i + Gamma v + h of ten entries, shape (..., 10), for dq vectors of shape (..., 2)."""
    i_d, i_q, v_d, v_q = i[..., :1], i[..., 1:], v[..., :1], v[..., 1:]
    by_current = entries[..., 0:4:2] * i_d + entries[..., 1:4:2] * i_q
    by_voltage = by_current + entries[..., 4:8:2] * v_d + entries[..., 5:8:2] * v_q
    return np.asarray(by_voltage + entries[..., 8:])


def turned(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """A vector, shape (..., 2), in a frame that is ahead by ``angle`` in rad, shape (...)."""
    c, s = np.cos(angle), np.sin(angle)
    d, q = c * vector[..., 0] + s * vector[..., 1], c * vector[..., 1] - s * vector[..., 0]
    found = np.empty((*np.shape(d), 2))
    found[..., 0], found[..., 1] = d, q
    return found


def wrapped(angle: FloatArray) -> FloatArray:
    """Angle in rad brought to [-pi, pi), any shape."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def exact_entries(machine: LinearMachine, omega: FloatArray, t_s: float) -> FloatArray:
    """The ten entries by matrix exponentials, speeds in rad/s of shape (N,) -> (N, 10)."""
    from scipy.linalg import expm

    omega = np.asarray(omega, dtype=np.float64)
    a = np.zeros((len(omega), 5, 5))
    a[:, 0, 0], a[:, 1, 1] = -machine.r_s / machine.l_d, -machine.r_s / machine.l_q
    a[:, 0, 1], a[:, 1, 0] = omega * machine.l_q / machine.l_d, -omega * machine.l_d / machine.l_q
    a[:, 0, 2], a[:, 1, 3] = 1.0 / machine.l_d, 1.0 / machine.l_q
    a[:, 1, 4] = -omega * machine.psi_pm / machine.l_q
    a[:, 2, 3], a[:, 3, 2] = omega, -omega
    found = np.asarray(expm(a * t_s))
    order = [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (0, 3), (1, 2), (1, 3), (0, 4), (1, 4)]
    return np.stack([found[:, r, c] for r, c in order], axis=1)


def electrical_limit(machine: Machine, t_s: float, omega_max: float | None = None) -> float:
    """Largest electrical speed in rad/s that an observer serves: a fifth above the machine's,
    or six samples per turn.

    ``omega_max`` in rad/s overrides that of the machine.
    """
    most = _LARGEST_TURN / t_s
    if omega_max is None:
        of_machine = machine.omega_m_max
        return most if of_machine is None else min(most, _RESERVE * machine.pole_pairs * of_machine)
    if not 0.0 < omega_max <= most:
        raise NoSolutionError(
            f"control.observer: at {omega_max:g} rad/s (electrical) a turn has fewer than six "
            f"samples of {t_s:g} s; sample faster, or stay below {most:g} rad/s"
        )
    return omega_max


def sampled_machine(machine: Machine, t_s: float, omega_max: float | None = None) -> SampledMachine:
    """Sample a machine without approximation for |omega| up to ``omega_max`` in
    rad/s (`electrical_limit`).

    A saturated machine counts with its constants at zero current.

    Raises:
        InputError: The sampling period is not positive.
        NoSolutionError: The speed is too high for the sampling.
    """
    if not t_s > 0.0:
        raise InputError(f"the sampling period must be positive, got {t_s:g} s")
    linear = linearised(machine)
    limit = electrical_limit(linear, t_s, omega_max)
    most = (limit * t_s) ** 2
    nodes = 0.5 * most * (1.0 + np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES))
    x = np.sqrt(nodes)
    values = exact_entries(linear, x / t_s, t_s) / np.where(ODD, x[:, np.newaxis], 1.0)
    scaled = np.vander(nodes / most, TERMS, increasing=True)
    table = (
        np.linalg.lstsq(scaled, values, rcond=None)[0] / most ** np.arange(TERMS)[:, np.newaxis]
    ).T
    model = SampledMachine(linear, t_s, limit, table, 0.0)
    check = np.linspace(-limit, limit, 65)
    exact = exact_entries(linear, check, t_s)
    scale = np.maximum(np.max(np.abs(exact), axis=0), 1e-300)
    error = float(np.max(np.abs(model.entries(check) - exact) / scale))
    return SampledMachine(linear, t_s, limit, table, error)


# Simulated drives to try observers on: any number at once, integrated between the samples,
# with sensors that err.
#
# The drive is controlled with its true angle, so that all observers see the same currents and
# voltages. Between two samples it moves as `dqforge.machines.plants.scenario` says; unlike
# there, noise acts on the machine itself besides on what is measured, as a Kalman filter assumes.

_GAIN = 0.3  # Share of a current error that the controller of the trials removes in one period.


@dataclass(frozen=True, slots=True)
class CurrentSensor:
    """Current measurement: a converter of ``bits`` over -full_scale .. full_scale in A,
    ``rms`` noise in A before it.

    The noise has to be about half a step or more for the sum of both to be white.
    """

    bits: int
    full_scale: float
    rms: float

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        if not (self.bits >= 4 and self.full_scale > 0.0 and self.rms >= 0.0):
            raise InputError(
                "a current sensor needs 4 bits or more, a positive full scale and no negative "
                f"noise, got {self.bits} bits, {self.full_scale:g} A, {self.rms:g} A"
            )

    @property
    def step(self) -> float:
        """Least difference of two readings in A."""
        return self.full_scale / 2.0 ** (self.bits - 1)

    @property
    def variance(self) -> float:
        """Variance of one reading in A^2: noise and rounding."""
        return self.rms**2 + self.step**2 / 12.0

    def read(self, current: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Readings of currents in A, any shape."""
        noisy = current + self.rms * generator.standard_normal(np.shape(current))
        limited = np.clip(noisy, -self.full_scale, self.full_scale - self.step)
        return np.asarray(np.round(limited / self.step) * self.step)


def usual_sensor(machine: Machine) -> CurrentSensor:
    """What stands for a sensor that the design does not describe: 12 bits over 1.25 times i_max,
    one step of noise.
    """
    full_scale = 1.25 * machine.i_max
    return CurrentSensor(12, full_scale, full_scale / 2.0**11)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What S drives did over K periods.

    Args:
        t_s: Sampling period in s.
        v: Voltage in stator coordinates that acted over each period, as the firmware believes, in
            V, shape (K, S, 2).
        i: Measured current in stator coordinates at the samples in A, shape (K + 1, S, 2).
        theta, omega: True electrical angle in rad (not wrapped) and speed in rad/s at the samples,
            shape (K + 1, S).
        i_dq: True currents in rotor coordinates in A, shape (K + 1, S, 2).
    """

    t_s: float
    v: FloatArray
    i: FloatArray
    theta: FloatArray
    omega: FloatArray
    i_dq: FloatArray


def simulate(
    machine: Machine,
    t_s: float,
    omega: FloatArray,
    i_ref: FloatArray,
    *,
    sensor: CurrentSensor | None = None,
    voltage_rms: float = 0.0,
    theta_0: float | FloatArray = 0.0,
    seed: int = 0,
) -> Trial:
    """Drive machines along given speeds under current control with the true angle.

    Args:
        machine: The true machine; a saturated one counts with its constants at zero current.
        t_s: Sampling period in s.
        omega: Electrical speed at the samples in rad/s, shape (K + 1, S), straight in between.
        i_ref: Current references (i_d, i_q) in A, shape (2,) or (K, S, 2).
        sensor: Current measurement, None for an exact one.
        voltage_rms: Standard deviation in V, per axis and period, of the voltage that acts without
            the firmware's knowledge.
        theta_0: Electrical angle at the start in rad.
        seed: Of the random numbers.
    """
    machine = linearised(machine)
    generator = np.random.default_rng(seed)
    periods, drives = omega.shape[0] - 1, omega.shape[1]
    reference = np.broadcast_to(np.asarray(i_ref, dtype=np.float64), (periods, drives, 2))
    theta = (
        np.concatenate(
            [np.zeros((1, drives)), np.cumsum(0.5 * t_s * (omega[1:] + omega[:-1]), axis=0)]
        )
        + theta_0
    )
    i_dq, v = np.empty((periods + 1, drives, 2)), np.empty((periods, drives, 2))
    plant, inductance = plants(machine, count=drives), np.array([machine.l_d, machine.l_q])
    i_dq[0] = reference[0]
    psi = plant.flux(i_dq[0, :, 0] + 1j * i_dq[0, :, 1]) * np.exp(1j * theta[0])
    for k in range(periods):
        steady = np.stack(
            machine.voltage(reference[k, :, 0], reference[k, :, 1], omega[k]), axis=-1
        )
        wanted = steady + _GAIN / t_s * inductance * (reference[k] - i_dq[k])
        v[k] = turned(wanted, -(theta[k] + 0.5 * t_s * omega[k]))
        acting = v[k] + voltage_rms * generator.standard_normal((drives, 2))
        psi = next_flux(
            plant, psi, acting[:, 0] + 1j * acting[:, 1], theta[k], (omega[k], omega[k + 1]), t_s
        )
        now = plant.current(psi, theta[k + 1]) * np.exp(-1j * theta[k + 1])
        i_dq[k + 1, :, 0], i_dq[k + 1, :, 1] = now.real, now.imag
    i = turned(i_dq, -theta)
    return Trial(t_s, v, i if sensor is None else sensor.read(i, generator), theta, omega, i_dq)


def wandering_speed(
    mean: FloatArray | float, density: float, t_s: float, periods: int, drives: int, seed: int
) -> FloatArray:
    """Speeds in rad/s that change by white acceleration, shape (periods + 1, drives).

    ``density`` is the standard deviation of the change over one second, in rad/s^1.5; ``mean`` in
    rad/s is what it is added to, a number or shape (periods + 1, 1).
    """
    steps = density * np.sqrt(t_s) * np.random.default_rng(seed).standard_normal((periods, drives))
    return np.asarray(np.concatenate([np.zeros((1, drives)), np.cumsum(steps, axis=0)]) + mean)


# The sampled machine as the firmware runs it: what the Kalman filter and Matsui's estimators
# predict with, over numpy arrays of shape (N,) or what else an `Arithmetic` counts with.
#
# In double precision they are compared with a filter in matrices (tests) and
# `dqforge.optimizer.observers.methods.matsui_model`.

EVEN = 5

# Rows of `SampledMachine.table` in the order of the C: the even ones first.
_ORDER = (0, 3, 4, 7, 8, 1, 2, 5, 6, 9)


@dataclass(frozen=True, slots=True)
class SampledGains:
    """The sampled machine, i[k+1] = phi i[k] + gamma v + h in the rotor's frame: each entry is a
    polynomial of omega t_s.
    """

    t_s: Annotated[float, Member("sampling period", "s")]
    x_max: Annotated[float, Member("largest |omega| t_s", "rad")]
    table: Annotated[
        tuple[float, ...],
        Member(
            "four coefficients each of phi_dd phi_qq gamma_dd gamma_qq h_d (even), phi_dq phi_qd"
            " gamma_dq gamma_qd h_q (odd)"
        ),
    ]

    def __post_init__(self) -> None:
        """Refuse another number of coefficients."""
        if len(self.table) != 8 * EVEN:
            raise ValueError


def sampled_gains(model: SampledMachine) -> SampledGains:
    """What the firmware needs of a sampled machine."""
    table = model.table[list(_ORDER)].ravel()
    return SampledGains(
        model.t_s, model.omega_max * model.t_s, tuple(float(value) for value in table)
    )


def _polynomials(o: Arithmetic, model: SampledGains, x: Reals) -> tuple[Reals, Reals, Reals]:
    """x^2 and its four coefficients each: shapes (N,) and (4, 10, 1), and the value, (10, N)."""
    s = o.let("s", x * x)
    table = np.array(o.let("c", model.table)).reshape(2 * EVEN, 4).T
    c = table.reshape(4, 2 * EVEN, *(1,) * np.ndim(x)).copy()
    return s, c, ((c[3] * s + c[2]) * s + c[1]) * s + c[0]


def matrix_entries(o: Arithmetic, model: SampledGains, x: Reals) -> Reals:
    """Entries of the sampled machine at ``x`` = omega_e T_s in rad, (N,) -> (10, N)."""
    _, _, found = _polynomials(o, model, x)
    found[EVEN:] = x * found[EVEN:]
    return o.let("e", found)


def entries_and_slopes(o: Arithmetic, model: SampledGains, x: Reals) -> tuple[Reals, Reals]:
    """Those of `matrix_entries`, and their derivatives by ``x`` = omega_e T_s in rad times the
    period in s, both (10, N).
    """
    s, c, found = _polynomials(o, model, x)
    value = o.let("value", found)
    rate = o.let("rate", ((3.0 * c[3]) * s + 2.0 * c[2]) * s + c[1])
    even = o.let("x_2", 2.0 * x) * rate[:EVEN]
    odd = value[EVEN:] + o.let("s_2", 2.0 * s) * rate[EVEN:]
    slopes = o.let("slope", model.t_s * np.concatenate([even, odd]))
    return o.let("e", np.concatenate([value[:EVEN], x * value[EVEN:]])), slopes


def next_currents(e: Reals, i: Pair, v: Pair) -> Dq:
    """Currents in A one sample after ``i`` in A under the voltage ``v`` in V, with the
    entries ``e``.
    """
    return Dq(
        (((e[0] * i[0] + e[5] * i[1]) + e[2] * v[0]) + e[7] * v[1]) + e[4],
        (((e[6] * i[0] + e[1] * i[1]) + e[8] * v[0]) + e[3] * v[1]) + e[9],
    )


def model_scale(gains: Any) -> tuple[float, float]:
    """``scale`` of gains that hold a sampled machine: its period in s and magnet flux linkage in
    Wb.

    Args:
        gains: With the member ``model``.
    """
    t_s = float(gains.model.t_s)
    # h_q over gamma_qq, to first order in the speed: the back-EMF over the speed.
    return t_s, abs(float(gains.model.table[36])) * t_s / float(gains.model.table[12])
