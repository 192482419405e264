"""Gains of a control in integers as the bytes of its C structure, for runs that are given their
own.
"""

from __future__ import annotations

import ctypes
import struct

from dqforge.optimizer.fixed_control.step import IDLE, FixedControl, FixedPi
from dqforge.optimizer.loops.integer_gains import FixedGain


def integer_gain_bytes(control: FixedControl) -> bytes:
    """Bytes of what ``simulation/integer_border.h.j2`` takes on this machine: full scales, and
    ``<prefix>_control_gains_q15_t`` or that of another width.

    One compiled program runs all controls that share the modulator, the scale of the dc link and
    the references.
    """
    current, voltage, speed, torque = control.bases
    scales = (current, voltage, voltage * 2.0**control.dc_scale, speed, torque, 1.0)
    return struct.pack("=6d", *scales) + bytes(_gains(control))


def _gains(control: FixedControl) -> ctypes.Structure:
    wide = ctypes.c_int32 if control.width == 16 else ctypes.c_int64
    number = ctypes.c_int16 if control.width == 16 else ctypes.c_int32

    class Gain(ctypes.Structure):
        _fields_ = (("mantissa", ctypes.c_int32), ("shift", ctypes.c_uint32), ("half", wide))

        @classmethod
        def of(cls, gain: FixedGain) -> Gain:
            return cls(gain.mantissa, gain.shift, 2**gain.shift // 2)

    class Pi(ctypes.Structure):
        _fields_ = (
            ("kp", Gain), ("ki", Gain), ("tracking", Gain), ("fraction", ctypes.c_uint32),
            ("half", wide), ("most", wide),
        )  # fmt: skip

        @classmethod
        def of(cls, pi: FixedPi) -> Pi:
            gains = (Gain.of(gain) for gain in (pi.kp, pi.ki, pi.tracking))
            half, most = 2**pi.fraction // 2, control.top << pi.fraction
            return cls(*gains, pi.fraction, half, most)

    class Gains(ctypes.Structure):
        _fields_ = (
            ("d", Pi), ("q", Pi),
            ("x_d", Gain), ("x_q", Gain), ("back_emf", Gain),
            ("voltage_limit", Gain), ("angle_advance", Gain), ("speed_filter", Gain),
            ("speed", Pi),
            ("dc_least", number), ("torque_max", number), ("ratio", ctypes.c_uint32),
        )  # fmt: skip

    loops = (control.i_d, control.i_q, control.speed)
    pis = [Pi.of(IDLE if forms is None else forms["parallel"]) for forms in loops]
    feed = control.decoupling
    gains = (
        feed.x_d, feed.x_q, feed.back_emf, control.limit, control.advance, control.speed_filter,
    )  # fmt: skip
    numbers = (control.dc_least, control.torque_max, control.ratio)
    return Gains(*pis[:2], *(Gain.of(gain) for gain in gains), pis[2], *numbers)
