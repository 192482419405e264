"""What current control of a machine with any back-EMF consists of, in double precision.

All quantities are amplitude-invariant; the zero-sequence quantity is the mean of the phases, so
that v_0 = R i_0 + L_0 di_0/dt + omega_e f_0 with L_0 = L_s + 2 M_s (and 3 L_n of a choke in the
neutral). Source: paper 002, chapters 3 to 5, as corrected in docs/current-waveforms.md.
"""

from __future__ import annotations

from dataclasses import dataclass

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame, Feedforward, Topology


@dataclass(frozen=True, slots=True, eq=False)
class PhaseShape:
    """Back-EMF over electrical speed as the firmware has it: nodes joined by straight lines.

    Parameters
    ----------
    flux:
        In V s/rad (Wb), shape (1, N) for three equal phases, of which b and c lag by a third and
        two thirds of a period, or (3, N). Node j lies at theta_e = 2 pi turns j / N.
    turns:
        Electrical periods after which the shape repeats: 1, or the pole pairs where they differ.
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

    Parameters
    ----------
    plane:
        Orders in alpha and beta, negative where they turn backwards, such as (-5, 7, -11, 13).
    zero:
        Orders of the zero sequence, such as (3, 9).
    rate:
        Rate of learning in 1/s.
    frequency_max:
        Harmonic frequency in Hz from which on an order is left out; it fades from four fifths on.
    error_max:
        Sum of the magnitudes of the errors of all axes in A above which all of them rest.
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

    The speed at which a link ends a torque goes with its voltage but for the resistance. So the
    table is read at the speed that would load the nominal link as much, |omega_e| v_nominal/v_dc,
    and at v_dc, by straight lines between the nodes; beyond its ends the last values hold.

    Parameters
    ----------
    omega_e:
        Electrical speeds in rad/s at the nominal link voltage, ascending from 0, shape (N,). At
        the last one there is no torque left.
    v_dc:
        Link voltages in V, ascending from 0 to the nominal one, shape (M,).
    torque:
        In N m, of either sign, shape (N, M).
    """

    omega_e: FloatArray
    v_dc: FloatArray
    torque: FloatArray

    @property
    def v_nominal(self) -> float:
        """Link voltage in V at which the speeds are those of the drive."""
        return float(self.v_dc[-1])


@dataclass(frozen=True, slots=True, eq=False)
class PhaseControl:
    """Current control of a phase machine.

    Parameters
    ----------
    frame, feedforward, topology:
        As their words say.
    shape:
        Back-EMF over the angle.
    pole_pairs, r_s, psi_pm:
        Of the machine; the flux is that of the fundamental's positive sequence in Wb, peak.
    inductances:
        (L_d, L_q, L_0) in H; L_d = L_q = L_s - M_s without saliency.
    gains:
        PI controllers of d, q and 0; the last one 0 where nothing drives a zero sequence.
    harmonics:
        Integrators of harmonics, None for none.
    t_s:
        Sampling period in s. Voltages act from the next sample on, for one period.
    torque_max:
        Largest torque in N m that the current limit permits.
    fade:
        Samples per electrical period (from, to): below the first the shape of the references fades
        to its fundamental, which alone is left below the second.
    torque_limit:
        Where the voltage ends, None where nothing limits the torque but the current.
    midpoint:
        For a split link, else None.
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
