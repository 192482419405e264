"""The position observers that there are in integers, by name."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dqforge.machines.errors import InputError
from dqforge.optimizer.fixed_observers import (
    fixed_ekf,
    fixed_extended_emf,
    fixed_flux,
    fixed_matsui_current,
    fixed_matsui_voltage,
    fixed_open_loop_flux,
)
from dqforge.optimizer.fixed_observers.fixed_method import FixedMethod

# The methods by name.
FIXED_METHODS: Mapping[str, FixedMethod] = MappingProxyType(
    {
        method.name: method
        for method in (
            fixed_extended_emf.METHOD,
            fixed_flux.METHOD,
            fixed_open_loop_flux.METHOD,
            fixed_matsui_voltage.METHOD,
            fixed_matsui_current.METHOD,
            fixed_ekf.METHOD,
        )
    }
)


def fixed_method_named(name: str) -> FixedMethod:
    """The method of that name.

    Raises:
        InputError: It is not there in integers.
    """
    if name not in FIXED_METHODS:
        raise InputError(
            f"export.control: the observer {name} is not there in fixed point; write "
            "export.control: float32, or one of the observers "
            f"{', '.join(FIXED_METHODS)}"
        )
    return FIXED_METHODS[name]
