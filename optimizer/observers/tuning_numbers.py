"""The few numbers by which every position observer is tuned, and the sensible ones of a machine."""

from __future__ import annotations

from dqforge.machines.design.settings import Deviation, both_sides
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

# Largest angle in rad per period for which the observers are made: the omitted terms of their
# series stay small.
LARGEST_TURN = 0.8


@dataclass(frozen=True, slots=True)
class ObserverTuning:
    """Tuning of a position observer.

    Args:
        bandwidth: In rad/s: of the EMF filter, or of the correction of the flux at standstill.
        pll_bandwidth, damping: Natural frequency in rad/s and damping ratio of the phase-locked
            loop.
        speed_gain: Share of the electrical speed that is added to the correction of the flux.
        omega_floor: Electrical speed in rad/s below which no observer by the back-EMF follows at
            full strength.
    """

    bandwidth: float
    pll_bandwidth: float
    damping: float = 1.0
    speed_gain: float = 0.2
    omega_floor: float = 1.0


@dataclass(frozen=True, slots=True)
class Load:
    """A steady load: currents in A, and the machine there.

    ``l_d`` in H is the incremental inductance, ``psi_pm`` in Wb what psi_d has beside l_d i_d,
    ``l_q`` in H the ratio of psi_q and i_q: of a saturated machine these make the flux linkages
    that it has at this very load.
    """

    i_d: float
    i_q: float
    l_d: float
    l_q: float
    psi_pm: float

    @classmethod
    def on(cls, machine: LinearMachine, i_q: float) -> Load:
        """A load of a linear machine with i_d = 0."""
        return cls(0.0, i_q, machine.l_d, machine.l_q, machine.psi_pm)


@dataclass(frozen=True, slots=True)
class Disturbances:
    """What an observer has to live with.

    ``i_noise`` in A and ``v_noise`` in V are r.m.s. values per component; ``r_s``, ``l_d``,
    ``l_q``, ``psi_pm`` relative parameter errors, to either side or from the first to the second;
    ``acceleration`` in rad/s^2 (electrical). ``lost`` in V is the voltage along the current that a
    dead time costs and the observer knows nothing of, ``lost_least`` the least that it may be:
    negative where it may as well be compensated too much. ``loads`` are the steady loads, the
    acceleration at the first of them; none for one of ``i_load`` A with i_d = 0.
    """

    i_noise: float
    v_noise: float
    i_load: float
    acceleration: float
    r_s: Deviation = 0.3
    l_d: Deviation = 0.1
    l_q: Deviation = 0.1
    psi_pm: Deviation = 0.1
    lost: float = 0.0
    lost_least: float = 0.0
    loads: tuple[Load, ...] = ()

    def limits(self, name: str) -> tuple[float, float]:
        """Least and largest relative error of one parameter."""
        return both_sides(getattr(self, name))


def usual_disturbances(machine: LinearMachine, v_dc: float, omega_max: float) -> Disturbances:
    """Noise of 0.5 % of the current limit and 0.2 % of the dc link, R 30 % and the rest 10 % wrong,
    half the current.

    The acceleration is that of the load current, or the one that reaches ``omega_max`` rad/s in 0.2
    s where the inertia is not known.
    """
    i_load = 0.5 * machine.i_max
    acceleration = omega_max / 0.2
    if machine.inertia is not None and machine.psi_pm > 0.0:
        acceleration = machine.pole_pairs * machine.torque_per_ampere * i_load / machine.inertia
    return Disturbances(5e-3 * machine.i_max, 2e-3 * v_dc, i_load, acceleration)


def require_magnet(machine: LinearMachine) -> None:
    """Refuse a machine whose back-EMF or active flux vanishes without current."""
    if not machine.psi_pm > 0.0:
        raise InputError(
            "control.observer: this observer needs a magnet flux (machine.psi_pm); leave the "
            "section out"
        )


USUAL_WIDTH = 200.0
USUAL_SHARE_OF_SPEED = 0.3
