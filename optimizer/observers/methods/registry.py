"""The position observers by name: one entry per method, so that another one is one more entry."""

from __future__ import annotations

from dqforge.machines.errors import InputError
from dqforge.optimizer.observers.method import ObserverMethod
from dqforge.optimizer.observers.methods import extended_emf as eemf_observer
from dqforge.optimizer.observers.methods import flux as flux_observer
from dqforge.optimizer.observers.methods import matsui as sampled_observers
from dqforge.optimizer.observers.methods import open_loop_flux
from dqforge.optimizer.observers.methods.ekf import (
    EkfGains,
    design_ekf,
    ekf_sizes,
    ekf_start,
    ekf_step,
    usual_ekf,
)
from dqforge.optimizer.observers.methods.extended_emf import usual_eemf
from dqforge.optimizer.observers.methods.flux import usual_flux
from dqforge.optimizer.observers.methods.matsui import (
    MatsuiCurrentGains,
    MatsuiVoltageGains,
    matsui_current_start,
    matsui_current_step,
    matsui_voltage_sizes,
    matsui_voltage_start,
    matsui_voltage_step,
)
from dqforge.optimizer.observers.methods.open_loop_flux import usual_open_loop

METHODS: dict[str, ObserverMethod] = {
    method.name: method
    for method in (
        ObserverMethod(
            "extended-emf",
            "eemf",
            "extended EMF with phase-locked loop",
            eemf_observer.design,
            eemf_observer.start,
            eemf_observer.step,
            usual_eemf,
            ("bandwidth",),
            eemf_observer.EemfGains,
        ),
        ObserverMethod(
            "flux",
            "flux",
            "flux observer with phase-locked loop on the active flux",
            flux_observer.design,
            flux_observer.start,
            flux_observer.step,
            usual_flux,
            ("bandwidth", "speed_gain"),
            flux_observer.FluxGains,
        ),
        ObserverMethod(
            "open-loop-flux",
            "open_loop_flux",
            "open-loop flux estimator with phase-locked loop on the active flux",
            open_loop_flux.design,
            flux_observer.start,
            open_loop_flux.step,
            usual_open_loop,
            ("bandwidth", "speed_gain"),
            open_loop_flux.OpenLoopGains,
        ),
        ObserverMethod(
            "matsui-voltage",
            "matsui_voltage",
            "Matsui's voltage model",
            sampled_observers.design_matsui_voltage,
            matsui_voltage_start,
            matsui_voltage_step,
            sampled_observers.usual_matsui,
            ("bandwidth",),
            MatsuiVoltageGains,
            300,
            matsui_voltage_sizes,
        ),
        ObserverMethod(
            "matsui-current",
            "matsui_current",
            "Matsui's current model",
            sampled_observers.design_matsui_current,
            matsui_current_start,
            matsui_current_step,
            sampled_observers.usual_matsui_current,
            ("bandwidth",),
            MatsuiCurrentGains,
            300,
        ),
        ObserverMethod(
            "ekf",
            "ekf",
            "extended Kalman filter",
            design_ekf,
            ekf_start,
            ekf_step,
            usual_ekf,
            (),
            EkfGains,
            300,
            ekf_sizes,
        ),
    )
}


def method_named(name: str) -> ObserverMethod:
    """The method of that name.

    Raises
    ------
    InputError
        There is none.
    """
    if name not in METHODS:
        raise InputError(
            f"control.observer.method: {name} is no position observer; write one of "
            f"{', '.join(METHODS)}"
        )
    return METHODS[name]
