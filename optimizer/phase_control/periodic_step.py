"""One sample of plant and current controller of a phase machine, as a linear map that repeats with
the back-EMF.

References and back-EMF are inputs and move no multiplier; what remains is linear in the state

    x[k] = (i[k], v_m[k], u[k], I[k-1], s_m[k])

of the currents, the midpoint of a split link, the voltage in flight (computed from sample k - 1, it
acts from k to k + 1), the integrators, and two numbers per order of a harmonic integrator, turned
along with its harmonic: s_m[k] = r_m[k-1] exp(j (m - 1) theta_k) in alpha and beta, with m in place
of m - 1 on the 0 axis. Currents, voltages and s_m are seen from the rotor (d, q and 0 of theta_k),
so that the rotor's saliency is a constant and, where the integrators live in dq0 and no midpoint is
balanced along the back-EMF, the whole step: then its eigenvalues are those of the loop at any
speed, and no period needs to be whole. The voltage stands still in the stator while the rotor turns
on by omega T_s.

    plant        L di/dt = u - R i - omega J L i per axis, exactly over a period; a split link
                 besides C dv_m/dt = 3 i_0, L_0 di_0/dt = u_0 - R i_0 - v_m, u_0 = v_0 + v_m[k-1]
    controller   u[k+1] = kp e + I[k] + harmonic integrators + coupling of measured currents,
                 e = -i (of a split link less balance times v_m, at constant torque)

The voltage limit, the fading of the references and what rests at large errors have no part in it.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.machines.transforms import POWER_INVARIANT, clarke_matrix
from dqforge.optimizer.phase_control.frame_motion import FrameMotion, frame_motion, shape_at
from dqforge.optimizer.phase_control.phase_controller import HarmonicGains, PhaseControl

FADES_FROM = 0.8  # Share of ``frequency_max`` from which on a harmonic integrator fades.

# Power-invariant over amplitude-invariant quantity on d, q and 0.
SCALE = np.array([POWER_INVARIANT, POWER_INVARIANT, np.sqrt(3.0)])
PLAIN = clarke_matrix()  # From phases to alpha, beta and 0, amplitude-invariant.
ADVANCE = 1.5  # Sampling periods from the sample to the middle of what its voltage does.


@dataclass(frozen=True, slots=True, eq=False)
class PhasePlants:
    """M windings and what feeds them, arrays of shape (M,).

    ``r_s`` in Ohm, ``l_d``, ``l_q`` and ``l_0`` in H, ``gain`` of the voltage, ``capacitance`` in F
    of both halves of a split link together, None for all other topologies.
    """

    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    l_0: FloatArray
    gain: FloatArray
    capacitance: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class LoopState:
    """Which rows of the state are what.

    ``axes`` is 2 without and 3 with a zero sequence, ``midpoint`` whether v_m is a state, ``plane``
    and ``zero`` the orders of the harmonic integrators that run, each with its weight.
    """

    axes: int
    midpoint: bool
    plane: tuple[tuple[int, float], ...]
    zero: tuple[tuple[int, float], ...]

    @property
    def plant(self) -> int:
        """Number of states of the plant; those of the controller follow."""
        return self.axes + self.midpoint

    @property
    def size(self) -> int:
        """Number of all states."""
        return self.plant + 2 * self.axes + 2 * (len(self.plane) + len(self.zero))

    @property
    def currents(self) -> slice:
        """Currents in A."""
        return slice(0, self.axes)

    @property
    def voltages(self) -> slice:
        """Voltages in flight in V."""
        return slice(self.plant, self.plant + self.axes)

    @property
    def integrators(self) -> slice:
        """Integrators in V, in their frame."""
        return slice(self.plant + self.axes, self.plant + 2 * self.axes)

    def harmonic(self, place: int) -> slice:
        """Harmonic integrator in A, those of the plane first."""
        first = self.plant + 2 * self.axes + 2 * place
        return slice(first, first + 2)


def weight_of(harmonics: HarmonicGains, frequency: float) -> float:
    """How much of a harmonic integrator runs, 1 to 0, at its frequency in Hz."""
    share = abs(frequency) / harmonics.frequency_max
    return float(np.clip((1.0 - share) / (1.0 - FADES_FROM), 0.0, 1.0))


def loop_state(control: PhaseControl, omega_e: float) -> LoopState:
    """State of the loop at an electrical speed in rad/s; orders that have faded are no part of it.

    Args:
        control: The current control.
        omega_e: Electrical speed in rad/s.
    """
    rule, harmonics = TOPOLOGIES[control.topology], control.harmonics

    def running(orders: tuple[int, ...]) -> tuple[tuple[int, float], ...]:
        assert harmonics is not None
        weights = ((m, weight_of(harmonics, m * omega_e / (2.0 * np.pi))) for m in orders)
        return tuple((m, weight) for m, weight in weights if weight > 0.0)

    plane = () if harmonics is None else running(harmonics.plane)
    zero = () if harmonics is None or not rule.neutral else running(harmonics.zero)
    midpoint = rule.midpoint and control.midpoint is not None
    return LoopState(3 if rule.neutral else 2, midpoint, plane, zero)


def _turns(angle: float) -> FloatArray:
    """Matrix (2, 2) that turns by an angle in rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def _turned(angle: float, axes: int) -> FloatArray:
    """The same on d and q with the 0 axis as it is, where there is one; shape (axes, axes)."""
    matrix = np.eye(axes)
    matrix[:2, :2] = _turns(angle)
    return matrix


def _complex(number: complex) -> FloatArray:
    """What multiplies two real numbers as the complex number does, shape (2, 2)."""
    return np.array([[number.real, -number.imag], [number.imag, number.real]])


def plant_rows(plants: PhasePlants, state: LoopState, omega_e: float, t_s: float) -> FloatArray:
    """Maps of the state to the next currents (and midpoint), shape (M, ``state.plant``, n).

    Args:
        plants: The windings.
        state: Which rows are what.
        omega_e: Electrical speed in rad/s.
        t_s: Sampling period in s.
    """
    from scipy.linalg import expm

    count, own = len(plants.r_s), state.plant
    flow = np.zeros((count, own + state.axes, own + state.axes))
    flow[:, 0, 1] = omega_e * plants.l_q / plants.l_d
    flow[:, 1, 0] = -omega_e * plants.l_d / plants.l_q
    for axis, inductance in enumerate((plants.l_d, plants.l_q, plants.l_0)[: state.axes]):
        flow[:, axis, axis] = -plants.r_s / inductance
        flow[:, axis, own + axis] = plants.gain / inductance
    flow[:, own, own + 1], flow[:, own + 1, own] = omega_e, -omega_e
    if state.midpoint:
        assert plants.capacitance is not None
        flow[:, 2, 3], flow[:, 3, 2] = -1.0 / plants.l_0, 3.0 / plants.capacitance
    rows = np.zeros((count, own, state.size))
    rows[:, :, : own + state.axes] = expm(flow * t_s)[:, :own]
    return rows


def controller_rows(
    control: PhaseControl, state: LoopState, omega_e: float, theta: FloatArray
) -> FloatArray:
    """Maps of the state at K angles to what the controller holds next, shape (K, n - plant, n).

    Args:
        control: The current control.
        state: Which rows are what.
        omega_e: Electrical speed in rad/s.
        theta: Electrical angles of the samples in rad, shape (K,).
    """
    axes, own, t_s = state.axes, state.plant, control.t_s
    step = omega_e * t_s
    here = frame_motion(control.frame, control.shape, theta)
    ahead = frame_motion(control.frame, control.shape, theta + ADVANCE * step)
    error = _errors(control, state, theta)
    kp, ki = (
        np.array([[getattr(gain, name)] for gain in control.gains[:axes]]) for name in ("kp", "ki")
    )
    inward, outward = _into(here, axes), _turned(ADVANCE * step, axes) @ _out_of(ahead, axes)
    rows = np.zeros((theta.size, state.size - own, state.size))
    integral = t_s * ki * (inward @ error)
    integral[:, :, state.integrators] += np.eye(axes)
    rows[:, axes : 2 * axes] = integral
    voltage = kp * error + outward @ integral
    if control.feedforward == "measured":
        # What the currents need that keep their place in the frame, there where the voltage acts.
        needed = omega_e * _coupling(control, ahead, axes) @ _out_of(ahead, axes) @ inward
        voltage[:, :, state.currents] += _turned(ADVANCE * step, axes) @ needed
    if state.midpoint:
        voltage[:, 2, axes] += 1.0  # The duty cycles make up for the midpoint that is measured.
        if control.feedforward == "references":
            voltage[:, :, axes] += _balancing_voltage(control, omega_e, theta)
    _add_harmonics(control, state, omega_e, error, (voltage, rows))
    rows[:, :axes] = _turned(-step, axes) @ voltage
    return rows


def _errors(control: PhaseControl, state: LoopState, theta: FloatArray) -> FloatArray:
    """Maps of the state to the errors of the currents, shape (K, axes, n)."""
    error = np.zeros((theta.size, state.axes, state.size))
    error[:, :, state.currents] = -np.eye(state.axes)
    if state.midpoint:
        error[:, :, state.axes] = _balancing_current(control, theta)
    return error


def _balancing_current(control: PhaseControl, theta: FloatArray) -> FloatArray:
    """Reference in A per volt of the midpoint, in d, q and 0 of the angles, shape (K, 3).

    A zero sequence against the deviation, less its part along the back-EMF, which would make
    torque.
    """
    assert control.midpoint is not None
    alpha, beta, zero = PLAIN @ shape_at(control.shape, theta)[0]
    scale = 3.0 * zero / (1.5 * (alpha**2 + beta**2) + 3.0 * zero**2)
    cosine, sine = np.cos(theta), np.sin(theta)
    d, q = alpha * cosine + beta * sine, beta * cosine - alpha * sine
    return -control.midpoint.balance * np.stack(
        [-scale * d, -scale * q, 1.0 - scale * zero], axis=1
    )


def _balancing_voltage(control: PhaseControl, omega_e: float, theta: FloatArray) -> FloatArray:
    """Voltage in V per volt of the midpoint that is fed forward for its balance, shape (K, 3)."""
    step = omega_e * control.t_s
    found = np.zeros((theta.size, 3))
    for ahead, sign in ((1.0, -1.0), (2.0, 1.0)):
        current = _balancing_current(control, theta + ahead * step)
        part = 0.5 * control.r_s + sign / control.t_s * np.array(control.inductances)
        found += (current * part) @ _turned(ahead * step, 3).T
    return found


def _add_harmonics(
    control: PhaseControl,
    state: LoopState,
    omega_e: float,
    error: FloatArray,
    into: tuple[FloatArray, FloatArray],
) -> None:
    """Adds the harmonic integrators' voltages, and their rows, into (voltage, rows)."""
    voltage, rows = into
    for place, (order, weight) in enumerate(state.plane + state.zero):
        plane, at = place < len(state.plane), state.harmonic(place)
        picked = slice(0, 2) if plane else slice(2, 3)
        assert control.harmonics is not None
        acts = _complex(weight * _inverse_plant(control, order, omega_e, plane=plane))
        voltage[:, picked, at] += acts if plane else acts[:1]
        held = np.zeros((len(error), 2, state.size))
        held[:, : 2 if plane else 1] = (
            control.harmonics.rate * control.t_s * weight * error[:, picked]
        )
        held[:, :, at] += np.eye(2)
        own = slice(at.start - state.plant, at.stop - state.plant)
        rows[:, own] = _turns((order - plane) * omega_e * control.t_s) @ held


def _into(motion: FrameMotion, axes: int) -> FloatArray:
    """From amplitude-invariant d, q and 0 into a frame, over its factors; shape (K, axes, axes)."""
    matrix = motion.axes * SCALE / motion.factor[:, :, np.newaxis]
    return np.asarray(matrix[:, :axes, :axes])


def _out_of(motion: FrameMotion, axes: int) -> FloatArray:
    """The inverse of `_into`, shape (K, axes, axes)."""
    matrix = np.swapaxes(motion.axes / SCALE * motion.factor[:, :, np.newaxis], 1, 2)
    return np.asarray(matrix[:, :axes, :axes])


def _coupling(control: PhaseControl, motion: FrameMotion, axes: int) -> FloatArray:
    """Voltage over electrical speed that currents at rest in the frame induce, in H, on d, q and 0:
    L (a'/a + Omega x) + (J L - L J), the last bracket of the saliency that turns; (K, axes, axes).
    """
    x, y, z = motion.turning.T
    nil = np.zeros_like(x)
    cross = np.moveaxis(np.array([[nil, -z, y], [z, nil, -x], [-y, x, nil]]), -1, 0)
    cross = cross * SCALE / SCALE[:, np.newaxis]
    inductance = np.diag(control.inductances)
    salient = np.zeros((3, 3))
    salient[0, 1] = salient[1, 0] = control.inductances[0] - control.inductances[1]
    grown = np.swapaxes(motion.axes, 1, 2) @ (motion.growth[:, :, np.newaxis] * motion.axes)
    return np.asarray((inductance @ (grown + cross) + salient)[:, :axes, :axes])


def _inverse_plant(control: PhaseControl, order: int, omega_e: float, *, plane: bool) -> complex:
    """Voltage per current of a harmonic in V/A that the closed P loop needs: kp + (R + j m omega L)
    exp(1.5 j m omega T_s), means of d and q in their plane.
    """
    l_d, l_q, l_0 = control.inductances
    d, q, zero = control.gains
    kp, inductance = ((d.kp + q.kp) / 2, (l_d + l_q) / 2) if plane else (zero.kp, l_0)
    turn = order * omega_e
    impedance = control.r_s + 1j * turn * inductance
    return complex(kp + impedance * np.exp(1j * ADVANCE * turn * control.t_s))
