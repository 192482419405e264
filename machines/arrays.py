"""Names for the arrays that are passed between functions, and numbers that a public constructor is
given, refused as the design file refuses them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral, Real
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError, shown

if TYPE_CHECKING:  # which works on the arrays that are named here
    pass


BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]


IndexArray = NDArray[np.intp]


FloatArray = NDArray[np.float64]


# Numbers that a public constructor is given, refused as the design file refuses them.


class Wanted(NamedTuple):
    """What a number must be: its unit (``""`` for a whole number), an example, and whether it may
    be zero, missing or negative.
    """

    unit: str
    example: str
    zero: bool = False
    optional: bool = False
    negative: bool = False


# Of every machine in rotor coordinates.
MACHINE = {
    "pole_pairs": Wanted("", "4"),
    "r_s": Wanted("Ohm", "0.5", zero=True),
    "i_max": Wanted("A", "20.0"),
    "inertia": Wanted("kg m^2", "1e-3", optional=True),
    "friction": Wanted("N m s/rad", "1e-4", zero=True),
    "omega_m_max": Wanted("rad/s", "300.0", optional=True),
}


def check_numbers(owner: object, wanted: Mapping[str, Wanted]) -> None:
    """Refuse a field of an object that is no finite number, of the wrong sign, or not whole.

    Raises:
        InputError: Names the field, what is wrong, and what to write.
    """
    for name, one in wanted.items():
        value = getattr(owner, name)
        if value is None and one.optional:
            continue
        if type(value) is not float and type(value) is not int:
            kind = Real if one.unit else Integral
            if not isinstance(value, kind) or isinstance(value, bool):
                _refuse(name, value, one)
        elif not one.unit and type(value) is float:
            _refuse(name, value, one)
        if one.negative and math.isfinite(value):
            continue
        if not (0.0 < value < math.inf or (value == 0.0 and one.zero)):
            _refuse(name, value, one)


def owned_numbers(values: object, name: str) -> FloatArray:
    """A copy of an array of numbers; raises InputError, naming the field, where it is none."""
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected an array of numbers; {error}") from None


def _refuse(name: str, value: object, one: Wanted) -> None:
    what = f"a number in {one.unit}" if one.unit else "a whole number"
    above = "of any sign" if one.negative else "from 0 on" if one.zero else "above 0"
    raise InputError(
        f"{name}: expected {what} {above}, got {shown(value)}; write one, such as "
        f"{name}={one.example}"
    )
