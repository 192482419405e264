"""How a six-step drive starts: two blocks that turn the rotor to a known angle, blocks at a rising
frequency, then a look at the back-EMF with all legs at rest.

A voltage is applied, not a regulated current: the current that the back-EMF of a swinging rotor
drives damps it, with 3/2 p^2 psi^2/(2 J R) in 1/s where the winding is quick.
"""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SixStepSettings
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.six_step.block_shape import BlockShape

_CURRENT = 0.5  # of the limit


_ACCELERATION = 0.2  # of the torque of the start current


_SWINGS = 3.0  # of the rotor about its block within the ramp, at least


_STEADY = 0.8  # of that torque that a load may take, acceleration included


_ALIGN = (0.3, 3.0)  # in s, and in periods of the swing about the aligned angle


_ABOVE = 1.5  # of the hand-over over the least speed


_TURNED = math.radians(20.0)  # between both looks at the back-EMF


_MOST_TURNED = math.radians(140.0)  # the same at the largest speed, so that the direction shows


@dataclass(frozen=True, slots=True)
class BlockStart:
    """The start of a six-step drive.

    Args:
        current: In A.
        voltage: Of two phases in series for it at rest in V, what the dead time takes included.
        align: Periods of each of the two blocks; ``align_time`` in s of both.
        rise, rate: Blocks per period: rise per period and end of the ramp.
        ramp_time: In s.
        omega: Electrical speed at the hand-over in rad/s.
        load: Largest load torque in N m with which it starts.
        settle, gap: Periods with all legs at rest before the first look, and between both.
        swing: Of the rotor about the aligned angle in rad/s.
    """

    current: float
    voltage: float
    align: int
    align_time: float
    rise: float
    rate: float
    ramp_time: float
    omega: float
    load: float
    settle: int
    gap: int
    swing: float


def plan_start(
    design: Design,
    settings: SixStepSettings,
    shape: BlockShape,
    speeds: tuple[float, float],
    inductance: float,
) -> BlockStart:
    """The start of a design.

    Args:
        design: With the inertia.
        settings: What is given of it.
        shape: Of the waveform.
        speeds: Least and largest electrical speed in rad/s of the estimator.
        inductance: Of a phase in H.

    Raises:
        InputError: The current exceeds the limit.
    """
    machine, t_s, v_dc = design.machine, design.control.t_s, design.inverter.v_dc
    current = _CURRENT * design.i_max if settings.start_current is None else settings.start_current
    if current > design.i_max * (1.0 + 1e-9):
        raise InputError(
            f"control.six_step.start_current: {current:.4g} A is above the limit of the drive, "
            f"{design.i_max:.4g} A; write less"
        )
    inertia = machine.inertia or math.nan
    torque = shape.torque * current
    swing = math.sqrt(machine.pole_pairs * torque / inertia)
    align = max(_ALIGN[0], _ALIGN[1] * 2.0 * math.pi / swing)
    align = align if settings.align_time is None else settings.align_time
    omega = min(_ABOVE * speeds[0], math.sqrt(speeds[0] * speeds[1]))
    slope = machine.pole_pairs * _ACCELERATION * torque / inertia
    slope = min(slope, omega * swing / (_SWINGS * 2.0 * math.pi))
    rate = omega * t_s / (math.pi / 3.0)
    return BlockStart(
        current=current,
        voltage=2.0 * machine.r_s * current + v_dc * design.inverter.dead_time / t_s,
        align=max(1, round(0.5 * align / t_s)),
        align_time=align,
        rise=slope * t_s * t_s / (math.pi / 3.0),
        rate=rate,
        ramp_time=omega / slope,
        omega=omega,
        load=(_STEADY - _ACCELERATION) * torque,
        settle=2 + math.ceil(2.0 * 2.0 * inductance * current / (v_dc * t_s)),
        gap=max(2, min(round(_TURNED / (omega * t_s)), int(_MOST_TURNED / (speeds[1] * t_s)))),
        swing=swing,
    )
