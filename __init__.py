"""dqforge: controller coefficients, loss budgets and checked C headers for permanent-magnet drives.

From Python every function takes and returns SI numbers and arrays (docs/reference/python.md).
Names are loaded when they are first used, so that ``import dqforge`` costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.from_machine import make_design
    from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError, VerificationError
    from dqforge.machines.flux_maps.map_files import make_flux_map, read_flux_map
    from dqforge.machines.phase_machines.phase_machine import PhaseMachine
    from dqforge.reports.session.drives import (
        Characteristics,
        Fit,
        OperatingMap,
        OperatingPoints,
        certify,
        characteristics,
        fit,
        library,
        load_design,
        operating_map,
        operating_points,
    )
    from dqforge.reports.session.firmware import (
        FirmwareExport,
        FirmwareFile,
        design_from_firmware,
        export_for,
        read_firmware,
    )
    from dqforge.reports.session.losses import (
        BackEmf,
        Emission,
        Losses,
        LossMap,
        Solution,
        Verified,
        Waveforms,
        emit,
        loss_map,
        losses,
        read_back_emf,
        solve,
        verify,
        waveforms,
    )
    from dqforge.reports.session.result import SimulatedDrive, Tuning, simulate, tune

__version__ = "0.1.0"

__all__ = [
    "BackEmf",
    "Characteristics",
    "Design",
    "DqforgeError",
    "Emission",
    "FirmwareExport",
    "FirmwareFile",
    "Fit",
    "FluxMap",
    "InputError",
    "LinearMachine",
    "LossMap",
    "Losses",
    "NoSolutionError",
    "OperatingMap",
    "OperatingPoints",
    "PhaseMachine",
    "SaturatedMachine",
    "SimulatedDrive",
    "Solution",
    "Tuning",
    "VerificationError",
    "Verified",
    "Waveforms",
    "certify",
    "characteristics",
    "design_from_firmware",
    "emit",
    "export_for",
    "fit",
    "library",
    "load_design",
    "loss_map",
    "losses",
    "make_design",
    "make_flux_map",
    "operating_map",
    "operating_points",
    "read_back_emf",
    "read_firmware",
    "read_flux_map",
    "simulate",
    "solve",
    "tune",
    "verify",
    "waveforms",
]

_HOMES = {
    "machines.design.design": ("Design",),
    "machines.design.from_machine": ("make_design",),
    "machines.errors": (
        "DqforgeError",
        "InputError",
        "NoSolutionError",
        "VerificationError",
    ),
    "machines.dq_machines.flux_map": (
        "FluxMap",
        "SaturatedMachine",
    ),
    "machines.flux_maps.map_files": (
        "make_flux_map",
        "read_flux_map",
    ),
    "machines.phase_machines.phase_machine": ("PhaseMachine",),
    "machines.dq_machines.synchronous": ("LinearMachine",),
    "reports.session.result": (
        "SimulatedDrive",
        "Tuning",
        "simulate",
        "tune",
    ),
    "reports.session.drives": (
        "Characteristics",
        "Fit",
        "OperatingMap",
        "OperatingPoints",
        "certify",
        "characteristics",
        "fit",
        "library",
        "load_design",
        "operating_map",
        "operating_points",
    ),
    "reports.session.losses": (
        "BackEmf",
        "Emission",
        "LossMap",
        "Losses",
        "Solution",
        "Verified",
        "Waveforms",
        "emit",
        "loss_map",
        "losses",
        "read_back_emf",
        "solve",
        "verify",
        "waveforms",
    ),
    "reports.session.firmware": (
        "FirmwareExport",
        "FirmwareFile",
        "design_from_firmware",
        "export_for",
        "read_firmware",
    ),
}
"""Modules of the public names; the same as above, which only type checkers and editors read."""


if not TYPE_CHECKING:  # a type checker shall refuse names that are not there

    def __getattr__(name: str) -> Any:
        """Load a public name when it is first asked for."""
        from importlib import import_module

        for home, names in _HOMES.items():
            if name in names:
                found = getattr(import_module(f"{__name__}.{home}"), name)
                globals()[name] = found
                return found
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, loaded or not."""
    return sorted((*__all__, "__version__"))
