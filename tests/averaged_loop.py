"""Phase machines on an averaged inverter, closed by the model of the emitted control.

The plant integrates alpha, beta and the zero sequence in double precision; currents are sampled at
the beginning of each period, the voltage acts one period later.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.float32_model import opened as open_phases

_STEPS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Torque in N m and phase currents in A of N drives, shapes (M, N) and (M, N, 3)."""

    torque: FloatArray
    currents: FloatArray

    def ripple(self, nominal: FloatArray | float) -> FloatArray:
        """Torque ripple, peak to peak over a torque, shape (N,)."""
        return np.asarray(np.ptp(self.torque, axis=0) / nominal)


@dataclass(frozen=True, slots=True, eq=False)
class AveragedDrive:
    """A machine turning at a constant speed on a stiff link.

    ``machine`` has the shape of the plant, ``model`` its control; ``v_dc`` in V. ``emf`` and
    ``inductance`` scale those of the plant, ``offset`` in A is added to the current of phase a.
    """

    machine: PhaseMachine
    model: PhaseControlModel
    v_dc: float = 220.0
    emf: float = 1.0
    inductance: float = 1.0
    offset: float = 0.0

    def run(
        self,
        rpm: FloatArray,
        torque: FloatArray,
        duration: float,
        kept: float,
        opened: int = 0,
        initial: FloatArray | None = None,
    ) -> Trace:
        """Drives at mechanical speeds in rpm with torque references in N m, shape (N,), for a
        ``duration`` in s, of which the last ``kept`` s are returned.

        ``opened`` is the phase without current, 0 for none; ``initial`` currents of alpha, beta
        and 0 in A, shape (3, N).
        """
        machine, model = self.machine, self.model
        made, t_s = model.structure, float(model.gains["t_s"])
        count, omega_m = rpm.size, rpm * np.pi / 30.0
        omega = machine.pole_pairs * omega_m
        l_ab, l_0 = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
        inductances = self.inductance * np.array([[l_ab], [l_ab], [l_0]])
        state = made.at_rest(count)
        if opened:
            chosen = np.ones(count, dtype=np.bool_)
            open_phases(state, np.full(count, opened, dtype=np.uint32), chosen)
        i = np.zeros((3, count)) if initial is None else initial.copy()
        waiting, theta = np.zeros((3, count)), np.linspace(0.0, 1.0, count)
        h = t_s / _STEPS
        decay = np.exp(-machine.r_s * h / inductances)
        gain = (1.0 - decay) / machine.r_s
        wanted = torque.astype(np.float32)
        samples, first = round(duration / t_s), round((duration - kept) / t_s)
        torques, currents = [], []
        for k in range(samples):
            phases = np.stack(
                [i[0], -0.5 * i[0] + np.sqrt(0.75) * i[1], -0.5 * i[0] - np.sqrt(0.75) * i[1]]
            )
            phases = phases + i[2]
            seen = phases + self.offset * np.array([[1.0], [0.0], [0.0]])
            measured = np.stack(
                [*seen, np.mod(theta, 2.0 * np.pi), omega_m, np.full(count, self.v_dc)], axis=1
            ).astype(np.float32)
            model.torque_control(state, measured, wanted)
            for _ in range(_STEPS):
                f = self._shape(theta + 0.5 * omega * h)
                v = waiting - self.emf * omega * f
                before, i = i, decay * i + gain * v
                if not made.neutral:
                    i[2] = 0.0
                theta = theta + omega * h
                if k >= first:
                    mean, f = 0.5 * (before + i), self.emf * f
                    torques.append(
                        machine.pole_pairs
                        * (1.5 * (f[0] * mean[0] + f[1] * mean[1]) + 3.0 * f[2] * mean[2])
                    )
            if k >= first:
                currents.append(phases.T)
            waiting = np.stack([*state.v, state.v_0]).astype(np.float64)
        return Trace(np.array(torques), np.array(currents))

    def _shape(self, theta: FloatArray) -> FloatArray:
        """Back-EMF over electrical speed in alpha, beta and 0, shape (3, N)."""
        nodes = self.machine.angles
        place = np.mod(theta / (2.0 * np.pi), 1.0) * nodes
        k = np.minimum(place.astype(int), nodes - 1)
        share = place - k
        a, b, c = (row[k] + share * (row[(k + 1) % nodes] - row[k]) for row in self.machine.flux)
        return np.stack([(2.0 * a - b - c) / 3.0, (b - c) / np.sqrt(3.0), (a + b + c) / 3.0])
