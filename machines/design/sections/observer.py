"""The section ``control.observer``: what may be written, and which keys a method takes."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from dqforge.machines.design.settings import SPEED_ERROR
from dqforge.machines.entries.kinds import (
    Bandwidth,
    SampleInterval,
    Section,
)
from dqforge.machines.entries.rules import Quantity, QuantityRule
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    OBSERVER_KEYS,
    SPEED_OBSERVER,
    InjectionWave,
    ObserverMethodName,
    ObserverTuningName,
)
from dqforge.machines.places import KeyPath


def _known(value: Any, words: ValidatorFunctionWrapHandler) -> Any:
    """Let a registered method pass; all else is judged by the words of the package."""
    return value if isinstance(value, str) and value in OBSERVER_KEYS else words(value)


def _users(key: str) -> str:
    """The methods that take a key, in words."""
    return " and ".join(name for name, keys in OBSERVER_KEYS.items() if key in keys)


_Neurons = Annotated[int, Field(ge=1, le=16)]
HiddenLayers = Annotated[tuple[_Neurons, _Neurons], Field(strict=False)]
CorrectionTime = Annotated[Quantity, QuantityRule("time", 1e-3, 1.0)]
CorrectionLimit = Annotated[Quantity, QuantityRule("angle", 1e-3, 2.0)]
SpeedError = Annotated[Quantity, QuantityRule("number", 1e-4, 0.5)]
InjectedVoltage = Annotated[Quantity, QuantityRule("voltage", 1e-3, 2e4)]


class ObserverSection(Section):
    """Speed or position observer."""

    method: Annotated[ObserverMethodName, WrapValidator(_known)] = Field(
        default=SPEED_OBSERVER, description="how speed or position is observed"
    )
    pole: Bandwidth | None = Field(
        default=None,
        description="for reduced-order: the pole lies at -pole (rad/s, or Hz times 2 pi)",
    )
    bandwidth: Bandwidth | None = Field(
        default=None,
        description="of the EMF filter or of the flux correction at rest (rad/s, or Hz times 2 pi)",
    )
    pll_bandwidth: Bandwidth | None = Field(
        default=None,
        description="natural frequency of the phase-locked loop (rad/s, or Hz times 2 pi)",
    )
    damping: Annotated[float, Field(gt=0.0, le=10.0)] | None = Field(
        default=None, description="damping ratio of the phase-locked loop; default 1"
    )
    speed_gain: Annotated[float, Field(ge=0.0, le=10.0)] | None = Field(
        default=None,
        description=f"for {_users('speed_gain')}: share of the speed in the correction of the flux",
    )
    hidden_layers: HiddenLayers | None = Field(
        default=None,
        description="for neural: neurons of both hidden layers, such as [8, 8]; at most 16",
    )
    correction_filter: CorrectionTime | None = Field(
        default=None,
        description=(
            f"for {_users('correction_filter')}: time constant before the correction of the angle "
            "(s); default 20 ms"
        ),
    )
    correction_limit: CorrectionLimit | None = Field(
        default=None,
        description=(
            f"for {_users('correction_limit')}: largest correction of the angle (rad; write deg); "
            "default the largest error of the training"
        ),
    )
    wave: InjectionWave | None = Field(
        default=None,
        description=(
            "for injection: square (half the sampling frequency, the default), sine on the assumed "
            "d axis, or rotating"
        ),
    )
    voltage: InjectedVoltage | None = Field(
        default=None, description=f"for {_users('voltage')}: amplitude of what is injected (V)"
    )
    samples: Annotated[int, Field(ge=2, le=16)] | None = Field(
        default=None, description="for injection: samples per injected period; default 2 or 10"
    )
    period: SampleInterval | None = Field(
        default=None,
        description=f"for {_users('period')}: from one sequence of pulses to the next (s)",
    )
    max_speed_error: SpeedError | None = Field(
        default=None,
        description=(
            "largest error of the speed within the tolerances at which the speed loop counts as "
            f"holding (share or %); default {100.0 * SPEED_ERROR:.3g} %"
        ),
    )
    tuning: ObserverTuningName = Field(
        default="named",
        description="named: what is left open has its usual value; optimised: it is searched for",
    )


_OBSERVER_ENTRIES = (
    *("pole", "bandwidth", "pll_bandwidth", "damping", "speed_gain"),
    *("wave", "voltage", "samples", "period"),
    *("hidden_layers", "correction_filter", "correction_limit"),
)

# Methods whose speed loop is not judged on them.
_TOLD_NO_SPEED = (SPEED_OBSERVER, "zero-crossing", "emf-integration")


def check_observer(
    observer: ObserverSection, document: YamlDocument, path: KeyPath = ("control", "observer")
) -> None:
    """Check that an observer has the keys that its method needs, and no other.

    ``path`` is where it stands. Raises `InputError` with a position.
    """
    used, where = OBSERVER_KEYS[observer.method], ".".join(map(str, path))
    if observer.method == SPEED_OBSERVER and observer.pole is None:
        message = (
            "control.observer: the method 'reduced-order' needs the key 'pole'; write pole: 400 "
            "rad/s"
        )
        raise document.error(message, path, key=True)
    if observer.max_speed_error is not None and (
        path != ("control", "observer") or observer.method in _TOLD_NO_SPEED
    ):
        raise document.error(
            f"{where}.max_speed_error is for a speed loop that runs on control.observer, by a "
            "method that observes the position; remove it",
            (*path, "max_speed_error"),
            key=True,
        )
    for key in _OBSERVER_ENTRIES:
        if getattr(observer, key) is not None and key not in used:
            raise document.error(
                f"{where}: the method '{observer.method}' does not use '{key}'; remove it, or "
                f"write another method (it uses {', '.join(used) or 'no key but tuning'})",
                (*path, key),
                key=True,
            )
