"""Steady errors of a position observer on the machine as it becomes in operation: its copper and
its magnets warmer than the constants of the firmware.

R grows with the temperature of the copper and psi falls with that of the magnets, both at once and
each by its own coefficient; the magnets are taken to warm up half as much as the winding. Where
the design gives operating temperatures, the firmware's constants hold there, and the machine that
has just been switched on is the one that differs: it is shown beside the warmer ones.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.losses.machine_budget import COPPER_COEFFICIENT
from dqforge.machines.plants.drive_motion import Plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.conditions import loads_at, lost_voltage
from dqforge.optimizer.observers.steady_states import steady_observer
from dqforge.optimizer.observers.tuning import SHOWN, PositionObserver
from dqforge.optimizer.observers.tuning_numbers import Load

LOAD_SHARES = (-1.0, -0.5, 0.0, 0.5, 1.0)  # Torques over the largest one at which errors are shown.

# Relative change of the magnet flux linkage per K where the design gives none: NdFeB.
MAGNET_COEFFICIENT = -0.11e-2
_RISES = (0.0, 40.0, 80.0)
_MAGNET_SHARE = 0.5  # of the rise of the winding
_REFERENCE = 20.0  # degC of constants without a temperature


@dataclass(frozen=True, slots=True)
class WarmState:
    """Rises in K above the temperatures at which the firmware's constants hold, and what they make.

    ``r_s`` and ``psi_pm`` are relative changes of resistance and magnet flux linkage.
    """

    winding: float
    magnet: float
    r_s: float
    psi_pm: float


@dataclass(frozen=True, slots=True, eq=False)
class WarmErrors:
    """Steady errors of an observer, estimate minus truth, inf where the angle is lost.

    Args:
        states: T states of the machine, by rising temperature.
        shares: Torques over the largest one, shape (L,).
        omega: Electrical speeds in rad/s, shape (S,).
        angle, speed: In rad and rad/s by temperature alone, shape (T, L, S).
        angle_with_dead_time, speed_with_dead_time: The same with the dead time that the design
            leaves besides.
    """

    states: tuple[WarmState, ...]
    shares: FloatArray
    omega: FloatArray
    angle: FloatArray
    speed: FloatArray
    angle_with_dead_time: FloatArray
    speed_with_dead_time: FloatArray

    @property
    def shown(self) -> tuple[int, ...]:
        """Indices of the states that a table shows: the cold one where there is one, and the
        hottest.
        """
        cold = (0,) if self.states[0].winding < 0.0 or self.states[0].magnet < 0.0 else ()
        return (*cold, len(self.states) - 1)


def _given(design: Design, key: str, default: float) -> float:
    """A value of the section machine.temperature in SI units (degC), or its default."""
    path = f"machine.temperature.{key}"
    return next((value.si for value in design.values if value.path == path), default)


def warm_states(design: Design) -> tuple[WarmState, ...]:
    """States of the machine from the constants of the firmware up, and the cold one where these
    hold at operating temperatures.
    """
    reference = _given(design, "winding_reference", _REFERENCE)
    winding = _given(design, "winding", reference)
    cold_magnet = _given(design, "magnet_reference", _REFERENCE)
    magnet = _given(design, "magnet", cold_magnet)
    copper = _given(design, "copper_coefficient", COPPER_COEFFICIENT)
    remanence = _given(design, "magnet_coefficient", MAGNET_COEFFICIENT)
    rises = [(rise, _MAGNET_SHARE * rise) for rise in _RISES]
    if (winding, magnet) != (reference, cold_magnet):
        rises.insert(0, (reference - winding, cold_magnet - magnet))
    scale = 1.0 + copper * (winding - reference), 1.0 + remanence * (magnet - cold_magnet)
    # Adding zero turns -0 into 0.
    return tuple(
        WarmState(w, m, copper * w / scale[0] + 0.0, remanence * m / scale[1] + 0.0)
        for w, m in rises
    )


def _plants(design: Design, loads: tuple[Load, ...], states: tuple[WarmState, ...]) -> FloatArray:
    """Rows (R, L_d, L_q, psi) of the true machines, shape (T, L, 4)."""
    linear = linearised(design.machine)
    rows = [
        [
            # Of a saturated machine the magnets' share alone follows their temperature.
            (
                linear.r_s * (1.0 + state.r_s),
                load.l_d,
                load.l_q,
                load.psi_pm + state.psi_pm * linear.psi_pm,
            )
            for load in loads
        ]
        for state in states
    ]
    return np.array(rows)


def warm_errors(
    design: Design, observer: PositionObserver, omega: FloatArray | None = None
) -> WarmErrors:
    """Steady errors over temperature, load and speed.

    Args:
        design: The drive.
        observer: Its position observer.
        omega: Electrical speeds in rad/s, positive, shape (S,); None for those of the tables.
    """
    speeds = np.array(SHOWN) * observer.omega_max if omega is None else omega
    states, loads = warm_states(design), loads_at(design, LOAD_SHARES)
    rows = _plants(design, loads, states)
    shape = (len(states), len(loads), len(speeds))
    spread = np.broadcast_to(rows[:, :, None, :], (*shape, 4)).reshape(-1, 4)
    current = np.array([complex(load.i_d, load.i_q) for load in loads])
    currents = np.broadcast_to(current[None, :, None], shape).ravel()
    every = np.broadcast_to(speeds, shape).ravel()

    def errors(lost: float) -> tuple[FloatArray, FloatArray]:
        found = steady_observer(
            observer.method,
            observer.gains,
            observer.t_s,
            Plants(*spread.T),
            currents,
            every,
            0.0,
            lost,
        )
        holds = found.found & (np.abs(found.poles[:, 0]) < 1.0)
        angle, speed = (
            np.where(holds, part, np.inf).reshape(shape)
            for part in (found.theta_error, found.omega_error)
        )
        return angle, speed

    plain, dead = errors(0.0), errors(lost_voltage(design)[1])
    return WarmErrors(states, np.array(LOAD_SHARES), speeds, *plain, *dead)
