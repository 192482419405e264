"""Current loops that switch the bridge themselves: which keys they take, and what they exclude."""

from __future__ import annotations

from typing import get_args

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import KeyPath
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import FeedbackMethod
from dqforge.machines.records import dataclass

_PATH = ("control", "current_loop")

# The keys that a method takes beside ``method``.
_KEYS: dict[str, tuple[str, ...]] = {
    "hysteresis": ("band",),
    "ramp-comparison": ("kp", "ki", "carrier", "comparator_band"),
    "look-up-table": ("band", "outer_band", "sampling"),
    "trajectory": ("sampling", "pulses"),
    "circle": ("band", "sampling"),
    "predictive": ("sampling",),
}

_NO_RUN = (
    "remove it: 'dqforge simulate' runs such a design at constant speed, at the points of losses"
)

_OWN = ("band", "outer_band", "carrier", "comparator_band", "sampling", "pulses")


@dataclass(frozen=True, slots=True)
class Asked:
    """Sections of a file on which current-feedback PWM bears, and whether it has one for a
    simulation.
    """

    control: ControlSection
    inverter: InverterSection
    operation: OperationSection
    export: ExportSection
    simulated: bool


def check_feedback(
    file: Asked, machine: Machine, document: YamlDocument, *, any_back_emf: bool
) -> None:
    """Check the keys of current-feedback PWM, and what does not go with it.

    Raises `InputError` with a position.
    """
    loop = file.control.current_loop
    if loop.method not in get_args(FeedbackMethod):
        for key in _OWN:
            if getattr(loop, key) is not None:
                users = " or ".join(name for name, keys in _KEYS.items() if key in keys)
                raise document.error(
                    f"control.current_loop: the method '{loop.method}' does not use '{key}'; "
                    f"write method: {users}, or remove the key",
                    (*_PATH, key),
                    key=True,
                )
        return
    _check_keys(file, document)
    _check_drive(file, machine, document, any_back_emf=any_back_emf)
    _check_rest(file, document)


def _check_keys(file: Asked, document: YamlDocument) -> None:
    loop = file.control.current_loop
    used = _KEYS[loop.method]
    for key in sorted(loop.model_fields_set - {"method", *used}):
        raise document.error(
            f"control.current_loop: the method '{loop.method}' does not use '{key}'; remove it (it "
            f"uses {', '.join(used)})",
            (*_PATH, key),
            key=True,
        )
    if loop.band is not None and loop.outer_band is not None and loop.outer_band.si < loop.band.si:
        raise document.error(
            f"control.current_loop.outer_band {loop.outer_band.text} is less than band "
            f"{loop.band.text}; write band or more",
            (*_PATH, "outer_band"),
        )
    if loop.pulses is not None and loop.pulses % 2 == 0:
        raise document.error(
            f"control.current_loop.pulses {loop.pulses} is even; patterns of a leg have odd "
            f"numbers of pulses: write {loop.pulses - 1} or {loop.pulses + 1}",
            (*_PATH, "pulses"),
        )
    if loop.sampling is not None and loop.sampling.si < 2.0 * file.inverter.switching_frequency.si:
        raise document.error(
            f"control.current_loop.sampling {loop.sampling.text} is too slow to switch by; write "
            "twice the switching frequency or more",
            (*_PATH, "sampling"),
        )


def _check_drive(
    file: Asked, machine: Machine, document: YamlDocument, *, any_back_emf: bool
) -> None:
    method = file.control.current_loop.method
    wrong = ""
    if any_back_emf or not isinstance(machine, LinearMachine):
        wrong = "works on a machine of model: linear; write another method"
    elif file.inverter.topology != "three-wire":
        wrong = f"works on topology: three-wire, not {file.inverter.topology}; write another method"
    elif not machine.l_d > 0.0 or not machine.l_q > 0.0:
        wrong = "needs positive inductances"
    if wrong:
        raise document.error(
            f"control.current_loop: the method '{method}' {wrong}", (*_PATH, "method")
        )


def _check_rest(file: Asked, document: YamlDocument) -> None:
    """Sections that need the gains of PI current loops, or a modulator."""
    control, method = file.control, file.control.current_loop.method
    asked: list[tuple[bool, KeyPath, str]] = [
        (control.observer is not None, ("control", "observer"), "remove it"),
        (control.tolerances is not None, ("control", "tolerances"), "remove it"),
        (control.references is not None, ("control", "references"), "remove it"),
        (control.firmware is not None, ("control", "firmware"), "remove it"),
        (control.six_step is not None, ("control", "six_step"), "remove it"),
        (control.start_up is not None, ("control", "start_up"), "remove it"),
        (
            control.speed_loop is not None and control.speed_loop.measurement is not None,
            ("control", "speed_loop", "measurement"),
            "remove it",
        ),
        (bool(file.export.control), ("export", "control"), "remove it"),
        (bool(file.export.firmware), ("export", "firmware"), "remove it"),
        (
            file.simulated,
            ("simulation",),
            _NO_RUN,
        ),
        (file.operation.overmodulation != "none", ("operation", "overmodulation"), "remove it"),
    ]
    for wanted, path, remedy in asked:
        if wanted:
            raise document.error(
                f"{'.'.join(map(str, path))} needs PI current loops and a modulator, and "
                f"control.current_loop is by '{method}'; {remedy}",
                path,
                key=True,
            )
