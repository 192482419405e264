"""What current control of a machine with any back-EMF consists of, in double precision.

All quantities are amplitude-invariant; the zero-sequence quantity is the mean of the phases, so
that v_0 = R i_0 + L_0 di_0/dt + omega_e f_0 with L_0 = L_s + 2 M_s (and 3 L_n of a choke in the
neutral). Source: paper 002, chapters 3 to 5, as corrected in docs/methods/current-waveforms.md.
"""

from __future__ import annotations

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class PhaseShape:
    """Back-EMF over electrical speed as the firmware has it: nodes joined by straight lines.

    Args:
        flux: In V s/rad (Wb), shape (1, N) for three equal phases, of which b and c lag by a third
            and two thirds of a period, or (3, N). Node j lies at theta_e = 2 pi turns j / N.
        turns: Electrical periods after which the shape repeats: 1, or the pole pairs where they
            differ.
    """

    flux: FloatArray
    turns: int = 1


@dataclass(frozen=True, slots=True)
class AxisGains:
    """PI controller of one axis: ``kp`` in V/A, ``ki`` in V/(A s); both 0 where there is none."""

    kp: float
    ki: float


@dataclass(frozen=True, slots=True)
class HarmonicGains:
    """Integrators that turn with harmonics of the electrical angle.

    Args:
        plane: Orders in alpha and beta, negative where they turn backwards, such as (-5, 7, -11,
            13).
        zero: Orders of the zero sequence, such as (3, 9).
        rate: Rate of learning in 1/s.
        frequency_max: Harmonic frequency in Hz from which on an order is left out; it fades from
            four fifths on.
        error_max: Sum of the magnitudes of the errors of all axes in A above which all of them
            rest.
    """

    plane: tuple[int, ...]
    zero: tuple[int, ...]
    rate: float
    frequency_max: float
    error_max: float


@dataclass(frozen=True, slots=True)
class MidpointGains:
    """What keeps the midpoint of a split link.

    ``balance`` in A/V: zero-sequence current (mean of the phases) per volt off half the link.
    ``omega_e_min`` in rad/s (electrical): below it the zero-sequence current of the table fades to
    nothing, in proportion to the speed.
    """

    balance: float
    omega_e_min: float


@dataclass(frozen=True, slots=True, eq=False)
class TorqueLimit:
    """Largest torque that the voltage permits.

    Between the nodes by straight lines; beyond its ends the last values hold. The speed at which a
    link ends a torque goes with its voltage but for the resistance: with ``v_nominal`` the table is
    read at |omega_e| v_nominal/v_dc, the speed that would load the nominal link as much.

    Args:
        omega_e: Electrical speeds in rad/s, ascending, shape (N,).
        v_dc: Link voltages in V, ascending, shape (M,).
        torque: In N m, of either sign, shape (N, M).
        v_nominal: Link voltage in V at which the speeds are those of the drive; None where they are
            at any.
    """

    omega_e: FloatArray
    v_dc: FloatArray
    torque: FloatArray
    v_nominal: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LimitedShapes:
    """Currents where the link ends those in proportion to the torque, motoring.

    At the speed x = |omega_e| v_nominal/v_dc and a torque T from ``plain`` to ``most`` at that
    speed the references are T u + D, with D between the nodes of speed, of the share s = (T -
    plain)/(most - plain), and of the angle by straight lines; below ``plain`` s is 0, and below the
    first speed D vanishes. D makes no torque. In reverse D is that at -theta, b and c exchanged,
    where ``mirrored``; else there is none.

    Args:
        omega_e: Electrical speeds in rad/s at the nominal link voltage, ascending, shape (W,). At
            the last one there is no torque left, nor beyond.
        plain, most: Torques in N m that proportional currents reach, and that these reach, shape
            (W,).
        deviation: D of the phases in A, shape (1, W, S, N) for equal phases, or (3, W, S, N), on
            the nodes of the table of the back-EMF; s = 0 to 1 in even steps.
        v_nominal: Link voltage in V.
        mirrored: Whether reverse motoring is the mirror of forward motoring.
    """

    omega_e: FloatArray
    plain: FloatArray
    most: FloatArray
    deviation: FloatArray
    v_nominal: float
    mirrored: bool


@dataclass(frozen=True, slots=True, eq=False)
class PhaseControl:
    """Current control of a phase machine.

    Args:
        frame, feedforward, topology: As their words say.
        shape: Back-EMF over the angle.
        pole_pairs, r_s, psi_pm: Of the machine; the flux is that of the fundamental's positive
            sequence in Wb, peak.
        inductances: (L_d, L_q, L_0) in H; L_d = L_q = L_s - M_s without saliency.
        gains: PI controllers of d, q and 0; the last one 0 where nothing drives a zero sequence.
        harmonics: Integrators of harmonics, None for none.
        t_s: Sampling period in s. Voltages act from the next sample on, for one period.
        torque_max: Largest torque in N m that the current limit permits.
        fade: Samples per electrical period (from, to): below the first the shape of the references
            fades to its fundamental, which alone is left below the second.
        torque_limit: Where the voltage ends, None where nothing limits the torque but the current.
        midpoint: For a split link, else None.
        limited: Currents beyond the torque limit, None where the torque is reduced instead.
    """

    frame: CurrentFrame
    feedforward: Feedforward
    topology: Topology
    shape: PhaseShape
    pole_pairs: int
    r_s: float
    psi_pm: float
    inductances: tuple[float, float, float]
    gains: tuple[AxisGains, AxisGains, AxisGains]
    harmonics: HarmonicGains | None
    t_s: float
    torque_max: float
    fade: tuple[float, float] = (20.0, 16.0)
    torque_limit: TorqueLimit | None = None
    midpoint: MidpointGains | None = None
    limited: LimitedShapes | None = None
