"""A simulated run as it was recorded, and the figures of many."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.plants.scenario import Scenario
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """Figures of N runs, arrays of shape (N,).

    ``status`` is 0, or 1 where the currents left all bounds and the run ended early, at ``t`` in s.
    ``peak_current`` in A is the largest current vector of all integration steps; ``tail_error`` the
    largest deviation from the reference over the last part of the run (rad/s, N m or A),
    ``tail_current`` the largest current vector at the samples there. ``i_d``, ``i_q``, ``omega_m``
    and ``torque`` are those at the end. Integrals over the run: ``i_square`` of the mean square of
    the phase currents in A^2 s, and in J the energy from the inverter (``e_in``), into copper, from
    the air gap (``e_shaft``), into the load and into friction.

    Of phase machines alone, 0 for others: the energy at the end in the inductances (a choke in the
    neutral included) and in the midpoint of a split link off its half, in J; and over the last part
    of the run the mean torque in N m, the peak to peak of its means over control periods
    (``tail_ripple_means``) and of itself (``tail_ripple``), the neutral's current in A r.m.s., the
    mean copper loss of each phase in W, and the largest distance of the midpoint from half the
    link in V.
    """

    status: NDArray[np.intp]
    t: FloatArray
    peak_current: FloatArray
    tail_error: FloatArray
    tail_current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    omega_m: FloatArray
    torque: FloatArray
    i_square: FloatArray
    e_in: FloatArray
    e_copper: FloatArray
    e_shaft: FloatArray
    e_load: FloatArray
    e_friction: FloatArray
    e_magnetic: FloatArray
    e_midpoint: FloatArray
    tail_torque: FloatArray
    tail_ripple_means: FloatArray
    tail_ripple: FloatArray
    tail_neutral_rms: FloatArray
    tail_copper_a: FloatArray
    tail_copper_b: FloatArray
    tail_copper_c: FloatArray
    tail_midpoint: FloatArray

    @property
    def bounded(self) -> NDArray[np.bool_]:
        """Whether the run came to its end, shape (N,)."""
        return np.asarray(self.status == 0)

    @property
    def rms_current(self) -> FloatArray:
        """Root mean square of the phase currents in A, shape (N,)."""
        return np.sqrt(self.i_square / np.maximum(self.t, 1e-300))


@dataclass(frozen=True, slots=True, eq=False)
class PhaseRecord:
    """What is recorded of a phase machine besides, arrays of shape (N,) at the sampling instants.

    ``duty_legs`` has the shape (N, legs), in the order of `TOPOLOGIES`, and acts until the next
    sample; ``i_phases`` (N, 3) are the true currents of a, b and c in A, ``i_neutral`` is their sum
    where a neutral is connected. ``v_midpoint`` in V lies above the negative rail, nan where the
    link is not split. ``torque_mean`` in N m is the mean over the control period that ends.
    """

    duty_legs: FloatArray
    i_phases: FloatArray
    i_neutral: FloatArray
    v_midpoint: FloatArray
    torque_mean: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ApplicationRecord:
    """What the program around the functions records, arrays of shape (N,) at the sampling instants.

    The numbers of its emitted enumerations.
    """

    application_state: FloatArray
    application_fault: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StartRecord:
    """What a start without encoder records besides, arrays of shape (N,) at the sampling instants.

    ``start_state`` and ``start_fault`` are the numbers of the emitted enumerations,
    ``start_reference`` in rad/s (mechanical) is the reference of the speed on its slope.
    """

    start_state: FloatArray
    start_fault: FloatArray
    start_reference: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class BlockRecord:
    """What is recorded of a six-step drive besides, arrays of shape (N,) at the sampling instants.

    ``stage`` and ``fault`` are those of the emitted control, ``sector`` is fed until the next
    sample, nan where all legs rest; ``i_reference`` in A.
    """

    stage: FloatArray
    fault: FloatArray
    sector: FloatArray
    i_reference: FloatArray


@dataclass(frozen=True, slots=True)
class BlockFigures:
    """What a six-step drive did.

    ``started`` is the time in s at which it first ran on its estimator, None where it never did;
    ``fault`` names that at the end, ``stage`` the last one. ``commutations`` is the number of those
    by the estimator, ``error_mean``, ``error_rms`` and ``error_largest`` (rad, electrical) how far
    their instants lie behind those of the waveform, from the twentieth on after each hand-over
    and within the range; None without any. ``predicted`` is the largest error by the formula at the
    speeds of these.
    """

    started: float | None
    stage: str
    fault: str
    commutations: int
    error_mean: float | None
    error_rms: float | None
    error_largest: float | None
    predicted: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A run as it was recorded, arrays of shape (N,) at the sampling instants,
    and (N, 3) for phases a, b, c.

    ``t`` in s; ``i_d``, ``i_q``, ``i_zero`` in A; ``omega_m`` in rad/s, ``theta_e`` in rad;
    ``torque`` and ``torque_load`` in N m; ``duty`` acts until the next sample, shape (N, 3);
    ``v_dc`` in V. ``reference`` and ``reference_d`` are those that the controller saw
    (`Scenario.reference`), ``i_measured`` (N, 3), ``theta_e_measured`` and ``omega_m_measured``
    what its sensors gave, ``i_d_reference``, ``i_q_reference`` and ``torque_reference`` what its
    outer loops asked for. ``theta_e_observed`` and ``omega_m_observed`` are the estimates of the
    design's observers (nan where there is none) from the measured currents and ``v_alpha``,
    ``v_beta`` in V, which the controller made over the period that ends; ``sensorless`` is 1 where
    the controller ran on them, and then ``theta_e_measured`` and ``omega_m_measured`` are theirs.
    ``figures`` are those of the one run, ``phases`` what phase machines have besides, ``start``
    what a start without encoder has, ``blocks`` what six-step drives have,
    ``application`` what the program around the functions has.
    """

    scenario: Scenario
    t: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    i_zero: FloatArray
    omega_m: FloatArray
    theta_e: FloatArray
    torque: FloatArray
    torque_load: FloatArray
    duty: FloatArray
    v_dc: FloatArray
    reference: FloatArray
    reference_d: FloatArray
    i_measured: FloatArray
    theta_e_measured: FloatArray
    omega_m_measured: FloatArray
    i_d_reference: FloatArray
    i_q_reference: FloatArray
    torque_reference: FloatArray
    v_alpha: FloatArray
    v_beta: FloatArray
    theta_e_observed: FloatArray
    omega_m_observed: FloatArray
    sensorless: FloatArray
    figures: Summary
    phases: PhaseRecord | None = None
    start: StartRecord | None = None
    blocks: BlockRecord | None = None
    application: ApplicationRecord | None = None
