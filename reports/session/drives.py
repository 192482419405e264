"""What a question is asked of: a design, or a machine alone with its limits;
and the checks of what is asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.from_machine import python_values
from dqforge.machines.design.loader import load_design as load_file
from dqforge.machines.design.numerical import located
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.files.yaml_edit import written
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.optimizer.operating_points.drive_points import LimitedDrive, limited_drive
from dqforge.optimizer.operating_points.operating_map import voltage_limit

# Switching frequency in Hz of an inverter of which only the voltage counts; nothing depends on it.
DqMachine = LinearMachine | SaturatedMachine
_NO_CARRIER = 10e3

# What a flux map may say that no machine has; all else is checked where a machine is made.
_MOST_MARGIN = 0.9
_OF_A_MAP = ("l_d", "l_q", "psi_pm")


def load_design(source: str | Path, changes: Mapping[str, Any] | None = None) -> Design:
    """The design in a file, or that of a library drive by its name.

    Args:
        source: Path of a design file, or one of `library`; a file of that name comes first.
        changes: Keys that are set instead of what the file says, as by ``--set``: dotted keys with
            numbers in SI units, names, lists or mappings, such as ``{"fit.degree": 3,
            "inverter.v_dc": 48.0}``.

    Raises:
        InputError: There is neither, or the content is wrong, with file, line and column.
    """
    name = str(source)
    given = {} if changes is None else changes
    settings = [f"{key}={written(python_values(value))}" for key, value in given.items()]
    if not Path(source).exists() and name in catalogue.names():
        return catalogue.load(name, settings)
    return load_file(source, settings)


def library() -> tuple[str, ...]:
    """Names of the drives that come with the package, for `load_design`."""
    return tuple(catalogue.names())


def limited(
    drive: Design | DqMachine,
    *,
    v_dc: float | None,
    i_max: float | None,
    modulation: str,
    margin: float,
) -> LimitedDrive:
    """A design or a machine within its limits.

    Limits that are given count in place of the design's.

    Raises:
        InputError: A limit is missing, or is no number that can be one.
    """
    names = tuple(MODULATORS)
    if modulation not in names:
        raise InputError(f"modulation: expected one of {', '.join(names)}, got {modulation!r}")
    name: ModulationName = next(name for name in names if name == modulation)
    if not 0.0 <= margin < _MOST_MARGIN:
        raise InputError(
            f"margin: expected a share of the voltage from 0 to below {_MOST_MARGIN}, got "
            f"{margin!r}"
        )
    for given, value, unit in (("v_dc", v_dc, "V"), ("i_max", i_max, "A")):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{given}: expected a positive number in {unit}, got {value!r}")
    if isinstance(drive, Design):
        inverter = drive.inverter if v_dc is None else replace(drive.inverter, v_dc=float(v_dc))
        with asked_of(drive, "operation"):
            found = limited_drive(replace(drive, inverter=inverter), name, margin)
        return found if i_max is None else replace(found, i_max=float(i_max))
    check_machine(drive)
    if v_dc is None:
        raise InputError(
            "v_dc: a machine alone has no voltage limit; give v_dc in V, or a design that has one"
        )
    inverter = Inverter(v_dc=float(v_dc), f_sw=_NO_CARRIER)
    limit = voltage_limit(inverter, name, margin)
    return LimitedDrive(drive, inverter, limit, drive.i_max if i_max is None else float(i_max))


def check_machine(machine: DqMachine) -> None:
    """Refuse what is no machine: another type, or a flux map that none can have."""
    if not isinstance(machine, LinearMachine | SaturatedMachine):
        raise InputError(
            "drive: expected a Design, a LinearMachine or a SaturatedMachine, got "
            f"{type(machine).__name__}"
        )
    for name in _OF_A_MAP:
        value = getattr(machine, name)
        least = 0.0 if name == "psi_pm" else np.nextafter(0.0, 1.0)
        if not (np.isfinite(value) and value >= least):
            wanted = "zero or a positive number" if least == 0.0 else "a positive number"
            raise InputError(f"{name}: expected {wanted} in SI units, got {value!r}")


@contextmanager
def asked_of(drive: Design | DqMachine, section: str) -> Iterator[None]:
    """Block that answers a question: numerical trouble ends in one line,
    with its place where the design has a file.
    """
    with located(drive.places if isinstance(drive, Design) else None, section):
        yield


def numbers(values: ArrayLike, name: str, unit: str) -> FloatArray:
    """An array of finite numbers, any shape.

    Raises:
        InputError: It holds texts, or what is not finite.
    """
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers in {unit}, got {_said(values)}") from None
    if not np.all(np.isfinite(array)):
        place = tuple(np.argwhere(~np.isfinite(array))[0].tolist())
        where = f" at index {place}" if array.ndim else ""
        raise InputError(f"{name}: expected finite numbers in {unit}, got {array[place]}{where}")
    return array


def _said(values: object) -> str:
    return repr(values) if isinstance(values, str) else f"{type(values).__name__}"


def together(values: Mapping[str, FloatArray]) -> tuple[int, ...]:
    """The common shape of arrays by their names.

    Raises:
        InputError: They have none.
    """
    try:
        return np.broadcast_shapes(*(array.shape for array in values.values()))
    except ValueError:
        shapes = " and ".join(f"{name} {array.shape}" for name, array in values.items())
        first, second = values
        raise InputError(
            f"{shapes} have no common shape; for a grid write {first}[:, None] and {second}[None, "
            ":]"
        ) from None


def whole(value: Any, name: str, least: int, most: int) -> int:
    """A whole number within bounds; raises `InputError` otherwise."""
    number = value.item() if isinstance(value, np.generic) else value
    if isinstance(number, bool) or not isinstance(number, int) or not least <= number <= most:
        raise InputError(f"{name}: expected a whole number from {least} to {most}, got {value!r}")
    return number
