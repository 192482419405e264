"""The loops of another firmware as C that runs in the simulation: our own code for its structure.

Every choice of a `LoopProfile` is a number that the program reads, so that one compiled program
runs all of them; only the modulation is compiled in.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, get_args

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import (
    AntiWindup,
    LimitOrder,
    LoopProfile,
    PiController,
    PiRule,
    SpeedEstimate,
    SpeedKind,
    estimate_ratio,
    filter_share,
    whole_ratio,
)
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.control.control_text import duty_functions
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.machines.names import ModulationName
    from dqforge.optimizer.firmware.configuration import DriveValues

PREFIX = "firmware"  # Prefix of names in the C code: ``firmware_current_control`` and the like.
SAMPLES = 256  # Most periods over which the difference of angles, and the mean of speeds, is taken.
POINTS = 64  # Most points of a table of currents.

# A member of the C structure: its comment, and its value (a whole number is an unsigned one).
Member = tuple[str, float | int]
_LARGEST = 3.4e38
_REFERENCES = ("id-zero", "mtpa-linear", "table")


@dataclass(frozen=True, slots=True)
class LoopNumbers:
    """Members of ``firmware_control_gains_t`` in their order: the controllers, the numbers behind
    them, and the points of the table (command, i_d, i_q in A).
    """

    controllers: tuple[tuple[Member, ...], ...]
    numbers: tuple[Member, ...]
    table: tuple[tuple[float, float, float], ...]


def loop_numbers(profile: LoopProfile, values: DriveValues) -> LoopNumbers:
    """What the C code is given for a profile.

    Args:
        profile: Structure and numbers of the loops.
        values: What the firmware is told of machine and limits; feedforward and references use
            them.

    Raises:
        InputError: The values lack what the structure needs, or the profile has more than fits.
    """
    current, speed = profile.current, profile.speed
    t_s = sampling_period(profile)
    estimate = SpeedEstimate() if speed is None else speed.feedback
    every = 1 if speed is None else estimate_ratio(speed, t_s)
    ratio = speed_ratio(profile)
    idle = PiController(0.0, 0.0, t_s)
    psi_pm = values.psi_pm or 0.0
    pole_pairs = _needed(values.pole_pairs, "pole_pairs")
    salient = profile.reference == "mtpa-linear" and not (values.l_d is None or values.l_q is None)
    numbers: tuple[Member, ...] = (
        ("pole_pairs", pole_pairs),
        ("cross_d, H", _needed(values.l_d, "l_d") if current.cross else 0.0),
        ("cross_q, H", _needed(values.l_q, "l_q") if current.cross else 0.0),
        ("back_emf, Wb", _needed(values.psi_pm, "psi_pm") if current.back_emf else 0.0),
        ("voltage_share", current.voltage_share / math.sqrt(3.0)),
        ("advance, s", current.angle_advance * t_s),
        ("current_max, A", _needed(values.i_max, "i_max")),
        ("torque per ampere, N m/A", torque_per_ampere(pole_pairs, psi_pm)),
        ("psi_pm, Wb", psi_pm),
        ("saliency, H", (values.l_q or 0.0) - (values.l_d or 0.0) if salient else 0.0),
        ("ramp_step, rad/s", _ramp_step(profile)),
        *_estimate_numbers(estimate, every * t_s),
        ("order", get_args(LimitOrder).index(current.order)),
        ("reference", _REFERENCES.index(profile.reference)),
        ("estimate", get_args(SpeedKind).index(estimate.kind)),
        ("estimate_ratio", every),
        ("estimate_samples", _within(estimate.samples if estimate.kind == "difference" else 1)),
        ("estimate_whole", int(estimate.whole)),
        ("averaged", _within(estimate.averaged)),
        ("ratio", 0 if speed is None else ratio),
        ("points", _table_size(profile)),
    )
    controllers = (current.d, current.q, idle if speed is None else speed.pi)
    periods = (t_s, t_s, ratio * t_s)
    found = LoopNumbers(tuple(map(_pi_numbers, controllers, periods)), numbers, profile.table)
    _require_single(found)
    return found


def sampling_period(profile: LoopProfile) -> float:
    """Period in s of both current controllers.

    Raises:
        InputError: They have different ones.
    """
    d, q = profile.current.d.t_s, profile.current.q.t_s
    if d != q or d <= 0.0:
        raise InputError(
            f"both current controllers of {profile.firmware} must run with one period above 0, "
            f"not {d:g} s and {q:g} s"
        )
    return d


def speed_ratio(profile: LoopProfile) -> int:
    """Current samples per sample of the speed controller, 1 without one."""
    t_s = sampling_period(profile)
    return 1 if profile.speed is None else whole_ratio(profile.speed.pi.t_s, t_s)


def loop_bytes(profile: LoopProfile, values: DriveValues) -> bytes:
    """Bytes of ``firmware_control_gains_t`` on this machine.

    Raises:
        InputError: As `loop_numbers`.
    """
    found = loop_numbers(profile, values)
    flat = [value for members in (*found.controllers, found.numbers) for _, value in members]
    packed = b"".join(struct.pack("=I" if isinstance(x, int) else "=f", x) for x in flat)
    points = [x for point in found.table for x in point]
    return packed + struct.pack(f"={3 * POINTS}f", *points, *([0.0] * (3 * POINTS - len(points))))


def loop_files(profile: LoopProfile, values: DriveValues) -> dict[str, bytes]:
    """Name and bytes of the header that `dqforge.reports.simulation.recorded_run` compiles.

    Raises:
        InputError: As `loop_numbers`, or there is no such modulation.
    """
    found = loop_numbers(profile, values)
    lines = [
        ("{ " + ", ".join(_literal(x) for _, x in members) + " }", axis)
        for axis, members in zip(("d", "q", "speed"), found.controllers, strict=True)
    ]
    lines += [(_literal(value), comment) for comment, value in found.numbers]
    lines.append((_table_literal(found.table), "table"))
    context = {
        "prefix": PREFIX,
        "macro": PREFIX.upper(),
        "title": f"loops with the structure of {profile.firmware} {profile.version}",
        "duties": duty_functions(modulation_of(profile), PREFIX),
        "samples": SAMPLES,
        "points": POINTS,
        "gains": lines,
    }
    text = render("firmware/firmware_loop.h.j2", context)
    return {f"{PREFIX}_control.h": text.encode("ascii")}


def modulation_of(profile: LoopProfile) -> ModulationName:
    """The modulator of a profile; raises InputError where there is none of its name."""
    for name in MODULATORS:
        if name == profile.current.modulation:
            return name
    raise InputError(
        f"{profile.firmware} cannot be simulated with the modulation "
        f"{profile.current.modulation!r}; known are {', '.join(MODULATORS)}"
    )


def _require_single(found: LoopNumbers) -> None:
    """Refuse what single precision does not hold."""
    members = [member for part in (*found.controllers, found.numbers) for member in part]
    members += [("table", value) for point in found.table for value in point]
    for name, value in members:
        if not abs(value) <= _LARGEST:
            raise InputError(
                f"the loops of a firmware cannot be simulated with {name} = {value:g}; single "
                "precision does not hold it"
            )


def _needed(value: float | None, name: str) -> float:
    if value is None:
        raise InputError(f"a simulation of the firmware's loops needs {name} of its configuration")
    return float(value)


def _pi_numbers(pi: PiController, t_s: float) -> tuple[Member, ...]:
    return (
        ("kp", pi.kp),
        ("ki_ts", pi.ki * t_s),
        ("tracking_ts", pi.tracking * t_s),
        ("limit", pi.limit or 0.0),
        ("share", filter_share(pi.filter_time, t_s)),
        ("rule", get_args(PiRule).index(pi.rule)),
        ("anti_windup", get_args(AntiWindup).index(pi.anti_windup)),
    )


def _estimate_numbers(estimate: SpeedEstimate, period: float) -> tuple[Member, ...]:
    filter_time = estimate.filter_time if estimate.kind in ("pll", "low-pass") else 0.0
    return (
        ("estimate_s", period),
        ("estimate_kp", estimate.kp),
        ("estimate_ki_ts", estimate.ki * period),
        ("estimate_share", filter_share(filter_time, period)),
    )


def _ramp_step(profile: LoopProfile) -> float:
    speed = profile.speed
    return (
        0.0
        if speed is None or speed.ramp is None
        else speed.ramp * speed_ratio(profile) * sampling_period(profile)
    )


def _within(count: int) -> int:
    """The number of periods, where the program has room for it."""
    if not 1 <= count <= SAMPLES:
        raise InputError(
            f"a speed made of {count} periods cannot be simulated; from 1 to {SAMPLES} can"
        )
    return count


def _table_size(profile: LoopProfile) -> int:
    count = len(profile.table)
    if profile.reference == "table" and not 2 <= count <= POINTS:
        raise InputError(
            f"the table of currents of {profile.firmware} has {count} points; from 2 to {POINTS} "
            "can be simulated"
        )
    return count


def _literal(value: float | int) -> str:
    return f"{value}U" if isinstance(value, int) else float_literal(value)


def _table_literal(points: Sequence[tuple[float, float, float]]) -> str:
    rows = ["{ " + ", ".join(float_literal(x) for x in point) + " }" for point in points]
    return "{ " + ", ".join(rows or ["{ 0.0F, 0.0F, 0.0F }"]) + " }"
