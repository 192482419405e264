"""What drives on an observer are judged at: speeds, loads, and how far they are from their data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.dq_machines.synchronous import LinearMachine

# Relative errors that a drive may have.
RELATIVE = ("r_s", "l_d", "l_q", "psi_pm", "inertia", "v_dc")


@dataclass(frozen=True, slots=True, eq=False)
class DriveCases:
    """M drives, arrays of shape (M,).

    Args:
        omega: Electrical speed in rad/s that the speed controller holds, as its observer tells it.
        load: Torque in N m beside the friction.
        r_s, l_d, l_q, psi_pm, inertia: Of the true machine and shaft, in Ohm, H, H, Wb and kg m^2.
        link: Voltage that acts, over the one that duty cycles are made for.
        lost: Voltage in V along the current that a dead time costs.
    """

    omega: FloatArray
    load: FloatArray
    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    psi_pm: FloatArray
    inertia: FloatArray
    link: FloatArray
    lost: FloatArray

    def _made(self, change: Callable[[str], FloatArray]) -> DriveCases:
        return DriveCases(**{part.name: change(part.name) for part in fields(self)})

    def taken(self, index: NDArray[np.intp]) -> DriveCases:
        """Some of them, by index."""
        return self._made(lambda name: np.asarray(getattr(self, name)[index]))

    def tiled(self, count: int) -> DriveCases:
        """All of them, ``count`` times in a row."""
        return self._made(lambda name: np.tile(getattr(self, name), count))

    def towards(self, other: DriveCases, share: float) -> DriveCases:
        """Drives on the way from these (share 0) to others (share 1)."""
        return self._made(
            lambda name: (1.0 - share) * getattr(self, name) + share * getattr(other, name)
        )


def drive_cases(
    machine: LinearMachine,
    omega: ArrayLike,
    load: ArrayLike = 0.0,
    errors: Mapping[str, ArrayLike] | None = None,
    lost: ArrayLike = 0.0,
) -> DriveCases:
    """Cases of a machine with its inertia; everything is broadcast to one shape (M,).

    Args:
        machine: As the design has it.
        omega: Electrical speeds in rad/s.
        load: Torques in N m beside the friction.
        errors: Relative errors by the names of `RELATIVE`: 0.3 is 30 % more than the data say.
        lost: Voltages in V along the current that the dead time costs.

    Raises:
        InputError: An error of something else is named, or the inertia is not known.
    """
    given = dict(errors or {})
    unknown = sorted(set(given) - set(RELATIVE))
    if unknown:
        raise InputError(f"error of {unknown[0]} is unknown; write one of {', '.join(RELATIVE)}")
    if machine.inertia is None:
        raise InputError("a drive on its observer needs the inertia; write machine.inertia")
    base = {
        "r_s": machine.r_s, "l_d": machine.l_d, "l_q": machine.l_q, "psi_pm": machine.psi_pm,
        "inertia": machine.inertia, "v_dc": 1.0,
    }  # fmt: skip
    parts = {
        name: value * (1.0 + np.asarray(given.get(name, 0.0), dtype=np.float64))
        for name, value in base.items()
    }
    parts |= {"omega": np.asarray(omega), "load": np.asarray(load), "lost": np.asarray(lost)}
    parts["link"] = parts.pop("v_dc")
    shape = np.broadcast_shapes((1,), *(part.shape for part in parts.values()))
    return DriveCases(
        **{
            name: np.array(np.broadcast_to(part, shape), dtype=np.float64)
            for name, part in parts.items()
        }
    )


def exact_cases(machine: LinearMachine, cases: DriveCases) -> DriveCases:
    """The same speeds and loads with exact data and without dead time."""
    return drive_cases(machine, cases.omega, cases.load)
