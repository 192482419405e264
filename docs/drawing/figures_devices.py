"""Figure of the page on devices: conduction and switching of those of the library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices import catalogue
from dqforge.machines.devices.inverter import DeviceModel
from dqforge.reports.pages.figures_style import new_figure, save, style

_TEMPERATURE = 100.0  # degC, junction


@style()
def library(path: Path) -> None:
    """On-state voltage, and energy of a turn-on and a turn-off, over the current, at 100 degC."""
    figure = new_figure("devices", 3.7, "Library devices: on-state voltage and switching energy")
    left, right = (figure.add_axes((x, 0.125, 0.4, 0.62)) for x in (0.085, 0.59))
    for name in catalogue.names():
        device = catalogue.load(name)
        look: dict[str, Any] = {"linestyle": "-" if device.kind == "igbt" else (0, (3.0, 1.5))}
        current = np.geomspace(2.0, device.conduction.reach, 60)
        volts = device.on_voltage(current, _TEMPERATURE).value
        (drawn,) = left.plot(current, volts, **look)
        table = device.turn_on.tables[0].curves[0]
        current = np.geomspace(max(2.0, table.x[0]), table.x[-1], 60)
        energy = 1e3 * _switching_energy(device, current)
        label = f"{name}, {device.turn_on.voltages[0]:g} V"
        right.plot(current, energy, color=drawn.get_color(), label=label, **look)
    left.set(ylabel="On-state voltage in V", ylim=(0.01, 20.0))
    right.set(ylabel="Energy of on, off, recovery in mJ", ylim=(0.001, 300.0))
    for axes in (left, right):
        axes.set(xscale="log", yscale="log", xlabel="Current in A", xlim=(2.0, 700.0))
        axes.set_xticks([2.0, 10.0, 50.0, 200.0, 600.0], ["2", "10", "50", "200", "600"])
        axes.minorticks_off()
    left.set_yticks([0.01, 0.1, 1.0, 10.0], ["0.01", "0.1", "1", "10"])
    right.set_yticks(
        [0.001, 0.01, 0.1, 1.0, 10.0, 100.0], ["0.001", "0.01", "0.1", "1", "10", "100"]
    )
    figure.legend(loc="upper center", ncols=2)
    save(figure, path)


def _switching_energy(device: DeviceModel, current: FloatArray) -> FloatArray:
    """Energy in J of a turn-on, a turn-off and a recovery at the voltage of the data."""
    place = current, device.turn_on.voltages[0], _TEMPERATURE
    of_on, of_off = device.turn_on_energy(*place).value, device.turn_off_energy(*place).value
    return of_on + of_off + device.recovery_energy(*place).value
