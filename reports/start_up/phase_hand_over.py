"""What the start-up of a machine of any back-EMF does besides: how its tracker follows the ramp,
and how the control over the angle goes on in the frame of the tracker. As ``phases.j2`` and
``parts.j2`` have it, in single precision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.reports.start_up.float32_model import (
    Drive,
    F,
    StartUpModel,
    Vector,
    angle_of,
    array,
    observer_start,
)

if TYPE_CHECKING:
    from dqforge.reports.phase_control.float32_model import PhaseControlModel, PhaseControlState

_ZERO, _ONE, _HALF = F(0.0), F(1.0), F(0.5)


_STEEPEST = F(0.85)  # sine of the rotor's angle behind the current that is believed


_ALONG, _ACROSS = F(0.90630779), F(0.42261826)  # cosine and sine of 25 degrees


def follow_ramp(model: StartUpModel, s: Any, drive: Drive) -> None:
    """As ``<prefix>_startup_follow_ramp``: the tracker starts behind the current of the ramp.

    Args:
        model, s, drive: What the machine is made of, its settings and its state.
    """
    emf = s.psi_pm_Wb * abs(drive.omega_e)
    left = drive.power - (s.r_s_Ohm * drive.current)
    seen = left / emf if emf > _ZERO else _ZERO
    sine = _STEEPEST if seen > _STEEPEST else (seen if seen > _ZERO else _ZERO)
    delta = angle_of((np.sqrt(_ONE - (sine * sine)), sine))
    delta = -delta if drive.omega_e < _ZERO else delta
    ahead = (drive.theta_e + (s.t_s * drive.omega_e)) + angle_of(drive.along)
    drive.observer = observer_start(model, ahead - delta, drive.omega_e)


def sees_current_ahead(i: Vector, omega_e: Any, size: Any) -> bool:
    """Whether a current in A lies 35 degrees behind to 85 degrees ahead of the tracker's d axis.

    Args:
        i: The current in the tracker's frame.
        omega_e: Speed of the ramp in rad/s, whose sign says what ahead is.
        size: Of the current of the ramp.
    """
    across = -i[1] if omega_e < _ZERO else i[1]
    return bool((_ALONG * i[0]) + (_ACROSS * across) > _HALF * size)


def usual_currents(control: PhaseControlModel, torque: Any) -> tuple[Any, Any]:
    """Current references of a torque in N m, arrays of shape (1,).

    Args:
        control: The control over the angle.
        torque: In N m.
    """
    if control.reference is not None:
        d, q = control.reference.currents(array(torque))
        return d, q
    per_ampere = (F(1.5) * control.gains["pole_pairs"]) * control.gains["psi_pm"]
    return array(0.0), array(torque / per_ampere)


def turned_integrals(
    control: PhaseControlModel, state: PhaseControlState, omega: Any, i: Vector, v: Vector
) -> None:
    """The integrals of the control over the angle in a new frame; those of the harmonics go.

    Args:
        control, state: The control and its state.
        omega: Electrical speed in rad/s.
        i, v: Current in A and voltage in V in that frame.
    """
    gains, fed = control.gains, control.structure.feedforward
    for order in state.harmonic:
        state.harmonic[order] = (array(0.0), array(0.0))
    d, q = v
    if fed == "emf":
        q = v[1] - (omega * gains["psi_pm"])
    elif fed != "none":
        d = v[0] + (omega * (gains["l_q"] * i[1]))
        q = v[1] - (omega * ((gains["l_d"] * i[0]) + gains["psi_pm"]))
        if fed == "references":
            d, q = d - (gains["r_s"] * i[0]), q - (gains["r_s"] * i[1])
    state.d, state.q = array(d), array(q)
