"""What ``export.application`` needs of the other sections."""

from __future__ import annotations

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.files.positioned_yaml import YamlDocument


def check_application(
    control: ControlSection, export: ExportSection, document: YamlDocument, *, any_back_emf: bool
) -> None:
    """Check that the program around the functions has what it calls.

    ``any_back_emf`` says that the machine is one of model: waveform. Raises `InputError` with a
    position.
    """
    if export.application is None:
        return
    loop = control.speed_loop
    if any_back_emf:
        message = "the program is for machines with a sinusoidal back-EMF; remove it"
    elif "float32" not in export.control or loop is None:
        message = (
            "the program calls the speed control in float32; write export.control: float32 and "
            "control.speed_loop"
        )
    elif control.six_step is not None or (control.start_up is None and loop.measurement is None):
        message = (
            "the program needs control.start_up, or an encoder by control.speed_loop.measurement; "
            "write one of them"
        )
    else:
        return
    raise document.error(f"export.application: {message}", ("export", "application"))
