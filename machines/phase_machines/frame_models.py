"""Dynamic models of a machine without saliency in the frames, at any angles:
the terms that decoupling needs.

In every frame v = R i + L_f di/dt + omega_e C i + omega_e phi_m e, power-invariant, with the
resistance R of a phase in Ohm. The matrices come from the closed forms of
:mod:`dqforge.machines.phase_machines.frames`; here they take the exact derivative of the back-EMF
shape, where :func:`dqforge.machines.phase_machines.frames.dynamic_model` takes differences on the
grid.

Paper 002, (2.14)-(2.22), (2.30), (2.31), (3.3)-(3.5), (4.10)-(4.18) and appendices B to E.
Where it errs:

========================================= ==============================================================
printed                                   holds
========================================= ==============================================================
(2.22), (C.7), (C.9), (C.12): a speed     none: dT/dtheta has no entry there
term (L_s + 2 M_s) omega i_0
(3.3), (3.4), (4.10), (4.12), (E.27),     (L_s - M_s) sin theta_y, as (E.28) and (E.32) have with cosine
(E.29), (E.47), (E.48):
(L_s + 2 M_s) sin theta_y
(3.4), (4.17), (E.48):                    (L_s + 2 M_s - 3 M_s sin^2 theta_y), as in (E.18)
(L_s + 2 M_s - 3 M_s) sin^2 theta_y
(3.4), (E.48): that term times a'/a alone a'/a omega i_qy, as in (4.17) and (E.13)
(4.16): the term without inductance       times (L_s - M_s), as in (E.47)
(D.19), (E.51): torque without factor     times a_x^2, a_y^2, as in (2.32) and (3.6)
========================================= ==============================================================
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_transforms import frame_rates, matrices, to_frame
from dqforge.machines.phase_machines.frames import (
    DynamicModel,
    Entry,
    Frame,
    coupling_entries,
    inductance_entries,
)


def frame_model(
    frame: Frame,
    theta: FloatArray,
    shape: FloatArray,
    slope: FloatArray,
    l_s: float,
    m_s: float,
    *,
    scaled: bool = False,
) -> DynamicModel:
    """Dynamic model in a frame at any angles, from closed forms.

    ::

        alphabeta0   L_f = diag(L_s - M_s, L_s - M_s, L_s + 2 M_s)          (2.14)-(2.16)
                     C = 0
        dq0, dqx     L_f the same                                           (2.20)-(2.22), (2.30), (2.31)
                     C_qd = -C_dq = (L_s - M_s) (1 + theta_x'), else 0      theta_x' = 0 in dq0
        dqy          L_f,qq = L_s + 2 M_s - 3 M_s sin^2 theta_y             (E.42), in (E.48) misprinted
                     L_f,00 = L_s - M_s + 3 M_s sin^2 theta_y               (E.46)
                     L_f,q0 = L_f,0q = 3/2 M_s sin 2 theta_y                (E.43), (E.45)
                     C_dq = -C_qd = (L_s - M_s) sin theta_y (1 + theta_x')  (E.27), (E.29), misprinted
                     C_0d = -C_d0 = (L_s - M_s) cos theta_y (1 + theta_x')  (E.28), (E.32)
                     C_00 = -C_qq = 3/2 M_s sin 2 theta_y theta_y'          (E.30), (E.34)
                     C_q0 = L_f,qq theta_y', C_0q = -L_f,00 theta_y'        (E.31), (E.33)

    Args:
        frame: The frame.
        theta: Angles in rad, shape (N,).
        shape, slope: Back-EMF shape F at these angles and its derivative by theta in 1/rad, shape
            (3, N).
        l_s, m_s: Self inductance of a phase and mutual inductance of two, in H.
        scaled: Whether currents, voltages and back-EMF are divided by a_x in dqx and a_y in dqy, as
            in paper 002. This adds (da/dtheta) / a times L_f to C, (D.9) and (E.13). The 0 axis of
            dqx, which the paper does without, is divided too.

    Returns:
        DynamicModel, with ``inductance`` and ``coupling`` of shape (N, 3, 3) in H,
        ``emf`` of shape (N, 3) without unit

    Raises:
        InputError: The inductances are not finite, or as
            :func:`dqforge.machines.phase_machines.frame_transforms.to_frame`: dqx and dqy need a
            back-EMF whose alpha-beta vector vanishes at no angle; the first where it does is named.
    """
    if not np.all(np.isfinite([l_s, m_s])):
        raise InputError(f"the inductances must be finite, got l_s = {l_s:g} H and m_s = {m_s:g} H")
    emf = to_frame(frame, theta, shape, shape, scaled=scaled).T
    sine: Entry = 0.0
    cosine: Entry = 1.0
    turn: Entry = 1.0
    rate: Entry = 0.0
    growth: Entry = 0.0
    if frame in ("dqx", "dqy"):
        rates = frame_rates(theta, shape, slope)
        _, size, zero = to_frame("dqx", theta, shape, shape)
        whole = np.hypot(size, zero)
        sine, cosine = -size / whole, zero / whole
        turn, rate = 1.0 + rates.theta_x, rates.theta_y
        growth = rates.growth_x if frame == "dqx" else rates.growth_y
    inductance = matrices(inductance_entries(frame, sine, cosine, l_s, m_s), theta.size)
    coupling = matrices(coupling_entries(frame, sine, cosine, turn, rate, l_s, m_s), theta.size)
    if scaled:
        coupling += np.reshape(growth, (-1, 1, 1)) * inductance
    return DynamicModel(inductance, coupling, emf)
